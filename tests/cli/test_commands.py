"""The command line: results on stdout, notes and progress on stderr, JSON without NaN, nothing imported in vain."""

import dataclasses
import inspect
import json
import math
import os
import pty
import subprocess
import sys
from pathlib import Path
from pkgutil import resolve_name

import pytest

from etendue.cli import main
from etendue.cli.commands import loaded, offered
from etendue.cli.options import Given, Way
from etendue.present.terminal.stored import print_archive
from etendue.present.terminal.terminal import _out, _print_whole, short_axes
from etendue.result_files import finite
from tests.fresh import process

SMALL = """
name = "small"
[camera]
peak_qe = [0.36, 0.44, 0.40]
[[stages]]
use = "slanted_edge"
name = "scene"
white_luminance = "1000 cd m-2"
width = "40 um"
height = "40 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "lens_gaussian"
name = "blur"
[[stages]]
use = "falloff"
[[stages]]
use = "pixel"
rows = 4
columns = 4
[[stages]]
use = "lens_numbers"
[[stages]]
use = "dynamic_range"
[[stages]]
use = "resolution"
[sweep]
f_number = [2, 4]
pixel_pitch = ["3 um", "5 um"]
"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(SMALL)
    return "small.toml"


def strict(text):
    """JSON as the standard has it: NaN and Infinity are no JSON."""

    def refuse(constant):
        raise AssertionError(f"{constant} in JSON")

    return json.loads(text, parse_constant=refuse)


def etendue(*arguments, cwd=None, env=None):
    return process(*arguments, cwd=cwd, env={**os.environ, **(env or {})})


@pytest.fixture
def inside(capsys):
    """Run a command in this process: (exit code, stdout, stderr)."""

    def call(*arguments):
        with pytest.raises(SystemExit) as stopped:
            main(arguments, prog_name="etendue")
        captured = capsys.readouterr()
        return stopped.value.code or 0, captured.out, captured.err

    return call


# -- what is imported -------------------------------------------------------------------------------------


def imported(arguments, cwd):
    """Modules in the process after a command."""
    script = (
        "import sys\nfrom etendue.cli import main\ntry:\n    main(sys.argv[1:], prog_name='etendue')\n"
        "except SystemExit as stop:\n    print(stop.code or 0, *sys.modules, file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, cwd=cwd)
    code, *modules = done.stderr.splitlines()[-1].split()
    return int(code), set(modules)


@pytest.mark.parametrize(
    "arguments", [["--help"], ["-h"], ["run", "--help"], ["plan", "--help"], ["--version"]], ids=" ".join
)
def test_help_costs_no_import_of_arrays_or_drawing(arguments, tmp_path):
    code, modules = imported(arguments, tmp_path)
    assert code == 0
    hooks = (
        {"pluggy"} if arguments[0] in ("-h", "--help") else set()
    )  # which say what commands others bring, without importing them
    assert (
        not modules
        & {"numpy", "scipy", "xarray", "dask", "zarr", "colour", "matplotlib", "rich", "pluggy", "PIL"} - hooks
    )
    assert not [name for name in modules if name.startswith(("etendue_camera.cli", "etendue_lab.cli"))]


def test_looking_at_an_archive_imports_no_plan_and_no_codec(file, tmp_path):
    etendue("run", file, "--archive", "seen", cwd=tmp_path)
    code, modules = imported(["show", "seen"], tmp_path)
    assert code == 0
    assert "etendue.archive.checks.describe" in modules
    assert not modules & {"scipy", "xarray", "zarr", "numcodecs", "pluggy", "etendue.plan.model", "etendue.session"}


@pytest.mark.parametrize("kind", [["map", "dr_emva"], ["pareto", "dr_emva", "dark_charge"]], ids=" ".join)
def test_plots_of_a_metric_import_no_arrays_of_dask(file, tmp_path, kind):
    """xarray imports them for a new variable unless told not to look at its array, which takes a fifth of a second."""
    done = etendue("run", file, "--sweep", "integration_time=0.01,0.02", "--archive", "swept", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    code, modules = imported(["plot", "swept", *kind, "--output", "drawn.png"], tmp_path)
    assert code == 0
    assert "xarray" in modules
    assert "dask.array" not in modules


def test_planning_imports_no_scheduler_no_archive_and_no_colour_science(file, tmp_path):
    etendue(
        "plan", file, cwd=tmp_path
    )  # of a scene that is planned for the first time, what it holds must be looked at
    code, modules = imported(["plan", file], tmp_path)
    assert code == 0
    assert "etendue.plan.planner" in modules
    assert not modules & {"dask", "zarr", "colour", "xarray", "matplotlib", "etendue.session", "etendue.run.parallel"}


def test_a_run_with_nothing_to_do_imports_no_scheduler_and_nothing_of_kernels(file, tmp_path):
    assert etendue("run", file, "--archive", "kept", cwd=tmp_path).returncode == 0
    code, modules = imported(["run", file, "--archive", "kept"], tmp_path)
    assert code == 0
    assert "etendue.archive.write.keeper" in modules
    assert not modules & {
        "dask",
        "colour",
        "xarray",
        "pandas",
        "matplotlib",
        "PIL",
        "scipy.fft",
        "scipy.special",
        "scipy.ndimage",
    }


def test_what_a_command_does_takes_what_is_typed():
    """The body of each stands elsewhere: it is there, and has a place for every argument and option."""
    for name, one in offered().items():
        command = loaded(name, one)
        place = getattr(command.callback, "place", None)
        assert place or one.place.partition(".")[0] not in ("etendue", "etendue_camera", "etendue_lab"), name
        if place:
            body = inspect.signature(resolve_name(place))
            typed = {parameter.name for parameter in command.params}
            for gathered, kind in (("given", Given), ("way", Way)):
                if gathered in body.parameters:
                    typed = typed - {field.name for field in dataclasses.fields(kind)} | {gathered}
            body.bind(**dict.fromkeys(typed))


# -- documents --------------------------------------------------------------------------------------------

STAGE_FIELDS = {"name", "use", "distribution", "axes", "cells", "left_out", "bytes", "seconds"}


def test_the_plan_as_json_has_its_fields(file, inside):
    code, out, err = inside("plan", file, "--json", "--tolerance", "0.1")
    document = strict(out)
    assert (code, err) == (0, "")
    assert {"stages", "cells", "naive_cells", "bytes", "peak_memory"} <= set(document)
    for stage in document["stages"]:
        assert STAGE_FIELDS <= set(stage)
    by_name = {stage["name"]: stage for stage in document["stages"]}
    assert by_name["pixel"]["axes"] == ["f_number", "pixel_pitch"]
    assert by_name["scene"]["left_out"] is None
    assert {"cells", "of", "bound", "why"} <= set(by_name["falloff"]["left_out"])
    assert sum(stage["cells"] for stage in document["stages"]) == document["cells"]


def test_a_run_as_json_has_its_fields_and_names_what_it_wrote(file, inside, tmp_path):
    code, out, err = inside("run", file, "--json", "--archive", "kept")
    document = strict(out)
    assert (code, err) == (0, "")
    assert {"stages", "archive", "store", "computed", "reused", "failed", "seconds", "pictures"} <= set(document)
    for stage in document["stages"]:
        assert STAGE_FIELDS | {"error"} <= set(stage)
    assert (tmp_path / document["archive"]).samefile(tmp_path / "kept")
    assert (tmp_path / document["store"]).samefile(tmp_path / "kept" / "data.zarr")
    assert document["computed"] == sum(stage["cells"] for stage in document["stages"])
    assert (document["reused"], document["failed"]) == (0, 0)
    assert document["pictures"]
    assert all((tmp_path / picture).is_file() for picture in document["pictures"])
    again = strict(inside("run", file, "--json", "--archive", "kept")[1])
    assert (again["computed"], again["reused"]) == (0, document["computed"])


def test_the_stages_as_json_have_their_fields(inside):
    code, out, err = inside("stages", "--json")
    documents = strict(out)
    assert (code, err) == (0, "")
    assert len(documents) > 30
    for document in documents:
        assert {"name", "distribution", "version", "reads", "writes", "parameters"} <= set(document)
    shot_noise = next(d for d in documents if d["name"] == "shot_noise")
    assert shot_noise["reads"] == {"expected_charge": "expected_charge: y x [electron]"}
    assert shot_noise["parameters"]["exact_below"]["units"] == "electron"


def test_what_is_not_known_is_null_and_what_has_no_end_is_text():
    document = {"a": [math.nan, (1.5, math.inf)], "b": -math.inf, 3: {"c": None}}
    assert strict(json.dumps(finite(document))) == {"a": [None, [1.5, "inf"]], "b": "-inf", "3": {"c": None}}


def test_an_axis_that_holds_infinity_is_still_json(file, inside):
    tail = ["--sweep", "diffusion_length=20,inf", "--want", "photon_rate", "--json"]
    document = strict(inside("plan", file, *tail)[1])
    assert next(axis for axis in document["axes"] if axis["name"] == "diffusion_length")["values"] == [20.0, "inf"]


# -- options ----------------------------------------------------------------------------------------------


def planned(inside, file, *options):
    code, out, err = inside("plan", file, "--json", *options)
    assert (code, err) == (0, ""), out + err
    return strict(out)


def values(document):
    return {axis["name"]: axis["values"] for axis in document["axes"]}


def test_set_replaces_a_value_and_the_axis_that_swept_it(file, inside):
    document = planned(inside, file, "--set", "camera.f_number=8", "--set", "blur.sigma=500 nm", "--set", "seed=7")
    assert values(document) == {"pixel_pitch": [3.0, 5.0]}


def test_sweep_adds_or_replaces_an_axis(file, inside):
    texts = ["f_number=1.4,2,2.8", "blur.sigma=0.5 um, 1 um", "focal_length=[5, '7 mm']"]
    document = planned(inside, file, *(part for text in texts for part in ("--sweep", text)))
    assert values(document) == {
        "f_number": [1.4, 2.0, 2.8],
        "pixel_pitch": [3.0, 5.0],
        "blur.sigma": [0.5, 1.0],
        "focal_length": [5.0, 7.0],
    }
    document = planned(inside, file, "--sweep", "f_number={ from = 2, to = 8, steps = 3, spacing = 'log' }")
    assert values(document)["f_number"] == [2.0, 4.0, 8.0]


def test_sweep_swaps_stages(file, inside):
    document = planned(inside, file, "--sweep", "blur.use=lens_gaussian,diffraction")
    blur = next(stage for stage in document["stages"] if stage["name"] == "blur")
    assert blur["use"] == ["lens_gaussian", "diffraction"]
    assert "blur.use" in blur["axes"]


def test_want_computes_this_and_what_it_needs(file, inside):
    document = planned(inside, file, "--want", "airy_diameter")
    assert [stage["name"] for stage in document["stages"]] == ["lens_numbers"]
    document = planned(inside, file, "--want", "blur.irradiance,lens_numbers")
    assert [stage["name"] for stage in document["stages"]] == ["scene", "irradiance", "blur", "lens_numbers"]


def test_tolerance_decides_what_is_left_out_and_nothing_left_out_forbids_it(file, inside):
    def left_out(*options):
        return [stage["name"] for stage in planned(inside, file, *options)["stages"] if stage["left_out"]]

    assert left_out("--tolerance", "0") == []
    assert left_out("--tolerance", "0.1") == ["blur", "falloff"]
    assert left_out("--tolerance", "0.1", "--nothing-left-out") == []


@pytest.mark.parametrize(
    ("options", "fragment"),
    [
        (["--set", "f_number"], "expected name=value"),
        (["--set", "f_numbr=4"], "did you mean 'f_number'?"),
        (["--set", "blurr.sigma=1"], "did you mean 'blur'?"),
        (["--set", "camera.f_number=wide"], "'wide' is not a number"),
        (["--sweep", "f_nubmer=1,2"], "did you mean 'f_number'?"),
        (["--sweep", "f_number="], "expected a number"),
        (["--want", "airy"], "did you mean 'airy_diameter'?"),
        (["--tolerance", "all"], "expected a number of at least 0 and below 1"),
    ],
    ids=str,
)
def test_a_wrong_option_is_a_fault_like_one_in_the_file(file, inside, options, fragment):
    code, out, err = inside("plan", file, *options)
    assert (code, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert fragment in err
    code, out, err = inside("plan", file, *options, "--json")
    assert (code, err) == (2, "")
    assert fragment in strict(out)["faults"][0]["message"]


def test_a_scheduler_that_does_not_exist_is_refused_before_an_archive_exists(file, inside, tmp_path):
    code, out, err = inside("run", file, "--scheduler", "thread")
    assert (code, out) == (2, "")
    assert "did you mean 'threads'?" in err
    assert not (tmp_path / "small").exists()


# -- streams ----------------------------------------------------------------------------------------------


def test_as_a_module_it_is_the_same_command(file, tmp_path):
    done = etendue("plan", file, cwd=tmp_path)
    assert done.returncode == 0
    assert "pixel" in done.stdout
    assert etendue("no-such-command").returncode == 2


def test_stdout_carries_results_and_stderr_notes_and_no_progress_where_it_is_no_terminal(file, tmp_path):
    done = etendue("run", file, "--set", "camera.f_number=1", cwd=tmp_path)
    assert done.returncode == 0
    assert "cells computed" in done.stdout
    assert "note:" not in done.stdout
    notes = done.stderr.splitlines()
    assert notes
    assert all(line.startswith("note: ") for line in notes)
    assert "\x1b" not in done.stdout + done.stderr


def test_progress_is_drawn_on_a_terminal_and_not_when_asked_to_be_quiet(file, tmp_path):
    whole = (
        "--set",
        "pixel.rows=8",
        "--set",
        "pixel.columns=8",
        "--sweep",
        "pixel_pitch=4,5",
    )  # of a cropped scene there is a note

    def drawn(*options):
        """What arrives on stderr when that is a terminal."""
        ours, theirs = pty.openpty()
        child = subprocess.Popen(
            [sys.executable, "-m", "etendue", "run", file, "--archive", f"a{len(options)}", *whole, *options],
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=theirs,
            env={**os.environ, "TERM": "xterm"},
        )
        os.close(theirs)
        seen = b""
        while True:
            try:
                part = os.read(ours, 65536)
            except OSError:  # the terminal is gone with the child
                break
            if not part:
                break
            seen += part
        os.close(ours)
        assert child.stdout is not None
        out = child.stdout.read()
        child.stdout.close()
        assert child.wait() == 0
        assert b"\x1b" not in out
        return seen.decode()

    assert "cells" in drawn()
    assert drawn("--quiet") == ""


@pytest.mark.parametrize("command", ["plan small.toml", "stages", "stages pixel", "run small.toml", "show small"])
def test_tables_fit_eighty_columns_and_cut_no_name(file, tmp_path, command):
    command = command.split()
    if command[0] == "show":
        etendue("run", file, cwd=tmp_path)
    done = etendue(*command, cwd=tmp_path, env={"COLUMNS": "80"})
    assert done.returncode == 0
    lines = done.stdout.splitlines()
    unbroken = (
        "open it:",
        "archive ",
        "contact sheet ",
        "contact_sheet ",
        "plot it ",
        "for smaller errors: ",
    )  # for copying
    assert max(len(line.rstrip()) for line in lines if not line.startswith(unbroken)) <= 80
    first_words = {line.split()[0] for line in lines if line.strip()}
    if command[0] != "stages":
        names = {"scene", "irradiance", "blur", "falloff", "pixel", "lens_numbers", "dynamic_range", "resolution"}
        assert names <= {word.partition("/")[0] for word in first_words}
    elif len(command) == 1:
        assert {"demosaic_colour_difference", "exposure_report", "slanted_edge"} <= first_words
    else:
        assert {"aperture_fraction", "surface_transmission", "window_columns"} <= first_words


@pytest.mark.parametrize("width", [80, 40, 200])
def test_a_wide_table_goes_on_below_itself_with_every_column(width, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(width))
    columns = tuple((f"column {n}", "left" if n == 0 else "right") for n in range(9))
    rows = [tuple(f"{'row' if n == 0 else 'value'} {line}.{n}" for n in range(9)) for line in range(3)]
    _print_whole(_out(), "title", columns, rows)
    lines = capsys.readouterr().out.splitlines()
    assert "…" not in "".join(lines) and max(map(len, lines)) <= width
    for line, row in enumerate(rows):
        own = [text for text in lines if text.startswith(f"row {line}.0")]
        assert [cell for cell in row[1:] if any(cell in text for text in own)] == list(row[1:])
    assert sum("column 0" in text for text in lines) == {200: 1, 80: 2, 40: 8 // 2}[width]


def test_a_stage_of_several_sizes_is_shown_once(capsys):
    """A sensor of one area has as many sizes of frames as pitches."""
    sizes = [20, 24, 30, 40]
    variables = [
        {
            "group": f"pixel/{n}x{n}",
            "variable": "photon_rate",
            "dims": {"pixel_pitch": 1, "channel": 3, "y": n, "x": n},
            "units": "electron/s",
        }
        for n in sizes
    ]
    stage = {"name": "pixel", "variables": variables, "cells": {"done": 4}, "planned": 4, "finished": 4}
    print_archive(
        {
            "archive": "a",
            "pipeline": "p",
            "bytes": 1,
            "runs": 1,
            "running": False,
            "began": "",
            "planned": 4,
            "finished": 4,
            "rate": None,
            "partial": None,
            "axes": {"pixel_pitch": [1.0, 2.0, 3.0, 4.0]},
            "stages": [stage],
            "store": "a/data.zarr",
        }
    )
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if "done" in line or "photon_rate" in line]
    assert lines == [
        ["pixel", "(4", "sizes)", "4", "done", "pitch"],
        ["photon_rate", "channel=3", "y=20..40", "x=20..40", "[electron/s]"],
    ]


def test_short_names_of_axes_are_unique():
    keys = ["f_number", "pixel_pitch", "integration_time", "demosaic.use", "sharpen.strength"]
    assert list(short_axes(keys).values()) == ["f_number", "pitch", "time", "demosaic", "strength"]
    assert list(short_axes(["a.strength", "b.strength"]).values()) == ["a.strength", "b.strength"]
    assert list(short_axes(["depletion_depth", "diffusion_depth"]).values()) == ["depletion_depth", "diffusion_depth"]


# -- stages and show --------------------------------------------------------------------------------------


def test_every_stage_has_its_line_under_what_it_is_for(inside):
    """Scenes first, resolution last, in the order in which light passes; every installed stage once, with its first
    sentence.
    """
    code, out, _ = inside("stages")
    assert code == 0
    places = [
        out.index(f"\n{role} ")
        for role in ("scene", "lens", "pixel", "shot noise", "demosaicing", "display encoding", "resolution")
    ]
    assert places == sorted(places)
    documents = strict(inside("stages", "--json")[1])
    for document in documents:
        assert sum(line.startswith(f"  {document['name']}  ") for line in out.splitlines()) == 1
    assert "(eq. 11)" in " ".join(out.split())  # an abbreviation does not end a sentence


def test_quantities_are_listed_with_what_takes_them(inside):
    code, out, _ = inside("quantities")
    assert code == 0 and "pixel_pitch" in out and "required" in out  # peak_qe has no default
    (document,) = strict(inside("quantities", "pixel_pitch", "--json")[1])
    assert document["units"] == "um" and document["range"] == "above 0 um; computed from 0.01 to 10000"
    assert {"pixel", "exposure"} <= set(document["stages"])
    code, out, err = inside("quantities", "pixel_pich")
    assert code == 2 and "did you mean 'pixel_pitch'" in out + err


def test_one_stage_is_shown_in_full(inside):
    code, out, _ = inside("stages", "uniform")
    assert code == 0
    for text in (
        "Give the same light everywhere.",
        "radiance: wavelength y x [W m-2 sr-1 nm-1]",
        "white_luminance",
        "required",
        "0.25 um",
    ):
        assert text in out
    (document,) = strict(inside("stages", "uniform", "--json")[1])
    assert document["parameters"]["white_luminance"]["required"] is True


def test_a_stage_that_is_not_installed_is_named_with_the_nearest(inside):
    code, out, err = inside("stages", "unifrom")
    assert (code, out) == (2, "")
    assert "did you mean 'uniform'?" in err


def test_show_says_what_is_in_an_archive(file, inside):
    inside("run", file, "--json")
    code, out, err = inside("show", "small")
    assert (code, err) == (0, "")
    for text in (
        "pipeline small",
        "axis f_number",
        "photon_rate",
        "4 done",
        "xarray.open_datatree('small/data.zarr', engine='zarr')",
    ):
        assert text in out
    document = strict(inside("show", "small", "--json")[1])
    assert document["axes"] == {"f_number": [2.0, 4.0], "pixel_pitch": [3.0, 5.0]}


@pytest.mark.parametrize("folder", [".", "nowhere", "small.toml"])
def test_show_of_anything_else_is_a_wrong_request(file, inside, folder):
    code, out, err = inside("show", folder)
    assert (code, out) == (2, "")
    assert "not an archive" in err
    code, out, err = inside("show", folder, "--json")
    assert (code, err) == (2, "")
    told = strict(out)["faults"][0]["message"]
    assert "not an archive" in told and ("does not exist" in told) == (folder == "nowhere")


def test_what_is_asked_for_is_kept_whatever_the_file_keeps(file, inside):
    Path(file).write_text('keep = ["photon_rate"]\n' + Path(file).read_text())
    code, out, err = inside("run", file, "--want", "airy_diameter", "--archive", "asked", "--json")
    assert code == 0, err
    code, out, _ = inside("show", "asked")
    assert "airy_diameter" in out
    code, out, err = inside("reproduce", "asked")  # the run's own text and overrides give what was kept
    assert code == 0, out + err


@pytest.mark.parametrize("more", [(), ("--sweep", 'demosaic.use=["demosaic_bilinear", "demosaic_nearest"]')])
def test_a_run_with_nothing_left_out_is_reproduced_from_its_text_and_overrides(more, inside, tmp_path, monkeypatch):
    """Its knobs, one of them 1e-14, are in the overrides of the record."""
    monkeypatch.chdir(tmp_path)
    assert inside("new", "mine")[0] == 0
    words = ("--set", "camera.f_number=4", "--want", "mosaic_linear" if not more else "demosaic.rgb_camera", *more)
    code, out, err = inside("run", "mine.toml", *words, "--nothing-left-out", "--no-errors", "--archive", "whole")
    assert code == 0, out + err
    code, out, err = inside("reproduce", "whole")
    assert code == 0, out + err
    record = json.loads(Path("whole/runs/0001.json").read_text())
    assert {"precision", "leave_out", "crosstalk.beyond"} <= record["overrides"].keys()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
@pytest.mark.parametrize("words", [("--help",), ("plan", "--help")])
def test_help_that_finds_no_room_says_so_in_one_line(words):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "etendue", *words], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 5
    assert done.stderr.count("\n") == 1 and "No space left" in done.stderr

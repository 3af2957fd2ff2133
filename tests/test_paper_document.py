"""docs/paper.md against the code: commands that exist, blocks that are what their command prints, pictures and
errata.
"""

import dataclasses
import importlib.util
import re
import shlex
from pathlib import Path

import click
import pytest

from etendue.builder.simulating import simulate
from etendue.cli import main
from etendue.contract.registry import installed_stages
from etendue.pipeline.file import read_pipeline
from etendue.plan.planner import make_plan
from etendue_camera.colour import matrices
from etendue_camera.electronics import dynamic_range
from etendue_camera.optics import diffraction
from etendue_camera.sensor import photodiode, silicon

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
FENCE = re.compile(r"^```(bash|console)\n(.*?)^```$", re.M | re.S)
PROSE = FENCE.sub("", TEXT)
SPAN = re.compile(r"`([^`\n]+)`")
CONSOLE = [body.removeprefix("$ ").split("\n", 1) for kind, body in FENCE.findall(TEXT) if kind == "console"]
COMMANDS = [
    *(
        line.partition("  #")[0].strip()
        for kind, body in FENCE.findall(TEXT)
        if kind == "bash"
        for line in body.splitlines()
    ),
    *(command.partition(" | ")[0] for command, _ in CONSOLE),
    *(span for span in SPAN.findall(PROSE) if span.startswith("etendue ")),
]
PICTURES = re.findall(r"!\[[^\]]+\]\((paper/[^)]+)\)", TEXT)
ERRATA = re.findall(r"^\| (E\d+) \|", TEXT, re.M)


def module(name):
    found = importlib.util.spec_from_file_location(name, ROOT / "benchmarks" / f"{name}.py")
    loaded = importlib.util.module_from_spec(found)
    found.loader.exec_module(loaded)
    return loaded


numbers, figures = module("paper_numbers"), module("paper_figures")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_in_the_text_is_one_that_exists(command):
    program, *words = shlex.split(command)
    if program == "etendue":
        name, *rest = words
        context = main.get_command(None, name).make_context(
            name, rest
        )  # raises for options and arguments that are not there
        if name in ("run", "compare"):
            assert (ROOT / context.params["file"]).is_file()
        return
    assert program == "python"
    script, *rest = words
    if script == "-c":
        compile(rest[0], "paper.md", "exec")
    elif script == "benchmarks/paper_numbers.py":
        name, *archives = rest
        asked = {"order": 2, "times": 2, "cost": 1}
        assert name in numbers.SECTIONS or asked.get(name) == len(archives)
    else:
        assert script == "benchmarks/paper_figures.py"
        name, *archives, option, output = rest
        assert option == "-o" and len(archives) == figures.FIGURES[name][1]
        assert output.removeprefix("docs/") in PICTURES


def test_a_command_with_a_wrong_option_would_be_found():
    with pytest.raises(click.UsageError):
        main.get_command(None, "run").make_context("run", ["pipelines/paper.toml", "--swep", "f_number=2"])


@pytest.mark.parametrize("section", numbers.SECTIONS)
def test_the_block_of_a_section_is_what_its_command_prints(section):
    shown = [body for command, body in CONSOLE if command == f"python benchmarks/paper_numbers.py {section}"]
    assert shown == ["\n".join(numbers.lines(numbers.SECTIONS[section]())) + "\n"]


def test_the_resolution_along_the_chain_is_what_the_pipeline_gives():
    shown = next(body for command, body in CONSOLE if "mtf50_lp_mm" in command)
    found = simulate(ROOT / "pipelines" / "paper.toml", want=["resolution"], scheduler="serial")["resolution"]
    assert [float(word) for word in shown.strip("[]\n").split()] == [
        round(float(value), 1) for value in found.mtf50_lp_mm
    ]
    assert list(found.stage.values) == ["lens", "aperture", "diffusion", "pixel"]


def test_the_airy_disc_of_the_pipeline_is_that_of_its_block():
    shown = next(body for command, body in CONSOLE if "airy_diameter" in command)
    found = simulate(ROOT / "pipelines" / "paper.toml", want=["airy_diameter"], scheduler="serial", f_number=8)
    assert shown.split() == ["airy_diameter", f"{float(found['lens_numbers'].airy_diameter):.5g}", "um"]


@pytest.mark.long
def test_the_comparison_of_both_orders_is_what_its_command_prints(tmp_path):
    shown = [
        body for command, body in CONSOLE if command == "python benchmarks/paper_numbers.py order paper paper_order"
    ]
    last = {
        "paper": ["sharpen.rgb_camera", "rgb_display"],
        "paper_order": ["dynamic_range_clip.rgb_camera", "rgb_display"],
    }
    for name, want in last.items():
        simulate(ROOT / "pipelines" / f"{name}.toml", archive=tmp_path / name, want=want, scheduler="serial")
    assert shown == ["\n".join(numbers.lines(numbers.order(tmp_path / "paper", tmp_path / "paper_order"))) + "\n"]


@pytest.mark.long
def test_three_times_in_both_orders_are_what_their_command_prints(tmp_path):
    shown = [
        body for command, body in CONSOLE if command == "python benchmarks/paper_numbers.py times times times_order"
    ]
    wanted = {"paper": ["clipped_fraction", "mean_snr"], "paper_order": ["dynamic_range_clip.rgb_camera"]}
    for name, want in wanted.items():
        given = {"archive": tmp_path / name, "want": want, "integration_time": ["1 ms", "8 ms", "64 ms"]}
        simulate(ROOT / "pipelines" / f"{name}.toml", scheduler="serial", **given)
    assert shown == ["\n".join(numbers.lines(numbers.times(tmp_path / "paper", tmp_path / "paper_order"))) + "\n"]


def headlines():
    """What the prose states, and what the kernels say."""
    nyquist = 0.5 / 5.4
    product = diffraction.circular_otf(nyquist, 0.55, 2.8) * photodiode.aperture_otf(nyquist, 4.0)
    product *= photodiode.collection_mtf(nyquist, float(silicon.absorption(0.55)), 1.8, 10.0, 50.0)
    saddles = [float(diffraction.two_point_saddle(s)[0]) for s in (0.5, 0.6)]
    printed, right = matrices.EQ16_AS_PRINTED.sum(axis=1), matrices.EQ16_CORRECTED.sum(axis=1)
    return {
        "(0.983)": f"({saddles[0]:.3f})",
        "(0.761)": f"({saddles[1]:.3f})",
        "0.473578": f"{diffraction.SPARROW / 2:.6f}",
        "0.578 of the contrast": f"{float(product):.3f} of the contrast",
        "2.22 µm at f/8": f"{0.5 / diffraction.cutoff_frequency(0.555, 8):.2f} µm at f/8",
        "2.4393398": f"{diffraction.AIRY_DIAMETER:.7f}",
        "11 gives 14.89 µm": f"11 gives {diffraction.airy_diameter(0.555, 11):.2f} µm",
        "68.05 dB": f"{float(dynamic_range.dynamic_range_elgamal(6e4, 1e-17 / 1.602176634e-19, 20, 10)):.2f} dB",
        "a Z of 1.298 instead of 1.089": f"a Z of {printed[2]:.3f} instead of {right[2]:.3f}",
    }


@pytest.mark.parametrize(("stated", "found"), headlines().items(), ids=lambda text: text)
def test_a_figure_in_the_prose_is_that_of_the_kernels(stated, found):
    assert stated in PROSE
    assert stated == found


def test_two_points_at_0_4_are_one_spot():
    assert diffraction.two_point_saddle(0.4)[0] == 1.0
    assert "middle over peak: 1)" in PROSE


def test_pictures_are_there_small_and_all_shown():
    folder = ROOT / "docs" / "paper"
    sizes = {f"paper/{file.name}": file.stat().st_size for file in folder.iterdir()}
    assert sorted(sizes) == sorted(set(PICTURES))
    assert max(sizes.values()) < 500_000  # in true colour
    assert sum(sizes.values()) < 3_200_000
    for name in sizes:
        assert (ROOT / "docs" / name).read_bytes().startswith(b"\x89PNG\r\n")


def test_every_picture_has_the_command_that_draws_it():
    drawn = {shlex.split(command)[-1].removeprefix("docs/") for command in COMMANDS if "paper_figures.py" in command}
    assert drawn == set(PICTURES)


def test_all_37_errata_are_listed_once_and_named_in_the_text():
    assert ERRATA == [f"E{n}" for n in range(1, 38)]
    assert set(re.findall(r"\bE\d+\b", PROSE.partition("## Errata")[0])) == set(ERRATA)


def rows_of_options():
    """Of the table of stages: names of stages, and what is set to have what the paper printed."""
    rows = TEXT.partition("| paper | stage |")[2].partition("\n\n")[0].splitlines()[2:]
    return [(SPAN.findall(row.split("|")[2]), SPAN.findall(row.split("|")[3])) for row in rows]


@pytest.mark.parametrize(("stages", "options"), rows_of_options(), ids=lambda names: " ".join(names))
def test_stages_and_options_of_the_table_exist(stages, options):
    installed = installed_stages()
    assert stages and set(stages) <= set(installed.names())
    known = {field.name for name in stages for field in dataclasses.fields(installed.load(name))} | set(stages)
    for option in options:
        name = option.partition(" = ")[0]
        assert name in known or name in installed.names() or option in ("[camera]",) or option.startswith('"')


def test_the_variant_runs_the_papers_stages_in_its_order_with_its_printed_values():
    plan = make_plan(read_pipeline(ROOT / "pipelines" / "paper_order.toml"), installed_stages())
    names = [node.name for node in plan.nodes]
    shown = [stage for panels in figures.PANELS.values() for stage, _ in panels]
    assert [name for name in names if name in shown] == shown
    stage = {name: cell.stage for (name, _), cell in plan.cells.items()}
    assert stage["balance"].gains == "as_printed"
    assert stage["to_xyz"].matrix == "eq16_as_printed"
    assert stage["sharpen"].strength == 1
    assert (stage["encode"].encoding, stage["encode"].exponent) == ("power", 0.45)
    assert stage["falloff"].geometry == "paper"


def pictures():
    """Those that are committed; what the site makes, and its theme's own, are not."""
    docs = ROOT / "docs"
    return sorted(path for path in docs.rglob("*.png") if not {"_build", "made"} & set(path.relative_to(docs).parts))


@pytest.mark.parametrize("path", pictures(), ids=lambda path: path.name)
def test_no_picture_of_the_documents_has_a_palette(path):
    from PIL import Image

    with Image.open(path) as picture:
        assert picture.mode in ("RGB", "RGBA"), (
            f"{path.name} is of mode {picture.mode}: a palette makes contours that no camera has made"
        )


def test_smooth_light_stays_smooth_in_a_written_figure(tmp_path):
    """A ramp of three channels that all 8-bit codes of two of them occur in: a palette of 256 colours holds none of
    it.
    """
    import numpy as np
    from PIL import Image

    y, x = np.mgrid[0:256, 0:256] / 255.0
    drawn = np.stack([x, y, 0.5 * (x + y)], axis=-1)
    figures.written(figures.sheet([[drawn]], [[""]]), tmp_path / "ramp.png")
    with Image.open(tmp_path / "ramp.png") as picture:
        codes = np.asarray(picture.convert("RGB"))
    inside = codes[figures.GAP // 2 + 10 : -30, figures.GAP + 10 : -30].reshape(-1, 3)
    assert len(np.unique(inside, axis=0)) > 0.9 * len(
        inside
    )  # every sample has a colour of its own, but for two codes of a margin

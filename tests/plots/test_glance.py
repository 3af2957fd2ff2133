"""What is seen first is what is there: axes, figures, cells, failures; in memory, in an archive, in one that is
being written.
"""

import fcntl
import math
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser

import pytest
import xarray

import etendue
from etendue.contract.registry import installed_stages
from etendue.errors import ArchiveError
from etendue.pipeline.file import parse_pipeline
from etendue.plan.planner import make_plan
from etendue.present.plots.summary.contents import Metric, glance
from etendue.session import Options, execute
from tests.plots.conftest import PIPELINE

SMALL = """
name = "small"
seed = 1
[camera]
peak_qe = [0.36, 0.44, 0.40]
focal_length = "6.93 mm"
pixel_pitch = "6 um"
[[stages]]
use = "uniform"
name = "scene"
white_luminance = "1000 cd m-2"
width = "48 um"
height = "48 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "pixel"
[[stages]]
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "adc"
[[stages]]
use = "linearise"
[sweep]
f_number = [2, 4]
integration_time = ["2 ms", "8 ms"]
"""
HOSTILE = "<script>alert(1)</script><img src=https://example.org/x onerror=alert(2)>"


@pytest.fixture(scope="module")
def seen(archive):
    return glance(etendue.open_archive(archive))


class Parts(HTMLParser):
    """What a browser would fetch or run of a page."""

    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attrs):
        if tag in ("script", "link", "style", "iframe", "object", "embed", "video", "audio", "base", "meta"):
            self.found.append(tag)
        for name, value in attrs:
            fetched = name in ("src", "href", "srcset", "action", "background", "poster") and not value.startswith(
                "data:image/webp;base64,"
            )
            if name.startswith("on") or fetched or "url(" in (value or ""):
                self.found.append(f"{tag} {name}={value}")


def asked_of_a_network(html):
    parts = Parts()
    parts.feed(html)
    return parts.found


def test_axes_stand_with_values_and_units_and_cells_as_the_ledger_counts_them(seen, tree):
    assert seen.axes == [
        ("f_number", "f/2, f/2.8, f/5.6", 3),
        ("pixel_pitch", "3 µm, 4 µm", 2),
        ("integration_time", "2 ms, 8 ms", 2),
    ]
    status = tree["ledger"].status.values.tolist()
    assert seen.counts == {one: status.count(one) for one in set(status)} and seen.cells == len(status)
    assert seen.stages == 18 and seen.state == "complete"


def test_figures_are_the_archive_s_at_the_cell_that_is_pictured(seen, tree):
    at = tree["frames"].attrs["cell"]
    report = tree["exposure_report"].dataset["mean_snr"]
    snr = next(one for one in seen.figures if one.name == "mean_snr")
    assert (snr.value, snr.least, snr.most) == (float(report.sel(at)), float(report.min()), float(report.max()))
    mtf = next(one for one in seen.figures if one.name == "mtf50_lp_mm")
    own = tree["resolution"].dataset["mtf50_lp_mm"]
    assert mtf.value == float(own.sel({dim: at[dim] for dim in own.dims if dim in at}).isel(stage=-1))
    assert (
        f" after {own['stage'].values[-1]}, without " in mtf.title
        and mtf.units == "cycles/mm"
        and "per mm" not in mtf.title
    )


def test_every_stage_that_has_a_picture_is_shown_and_nothing_is_asked_of_a_network(archive, seen):
    html = etendue.open_archive(archive).etendue._repr_html_()
    assert [one.stage for one in seen.pictures][:3] == ["scene", "irradiance", "diffraction"] and seen.pictures[
        -1
    ].stage == "encode"
    assert html.count("<img ") == len(seen.pictures) and asked_of_a_network(html) == []
    assert len(html) < 200_000  # of a notebook that keeps it


def test_commands_that_are_named_do_what_they_say(archive, seen):
    tree = etendue.open_archive(archive)
    own = [command for command, _ in seen.commands if command.startswith("tree.")]
    assert len(own) == 3
    for command in own:
        assert eval(command, {"tree": tree}).data("csv")
    assert any(command.startswith("etendue report ") and archive.name in command for command, _ in seen.commands)


def test_in_memory_it_is_the_same_without_commands_for_a_folder(seen):
    own = glance(etendue.simulate(PIPELINE))
    assert (own.axes, own.figures, own.counts, own.at, own.state) == (
        seen.axes,
        seen.figures,
        seen.counts,
        seen.at,
        seen.state,
    )
    assert own.place == "" and own.commands == [one for one in seen.commands if one[0].startswith("tree.")]


def test_xarray_s_own_form_of_a_tree_stays(tree):
    assert type(tree)._repr_html_.__module__.startswith("xarray.")


def test_a_stage_alone_is_seen_too(tree):
    own = glance(tree["exposure_report"])
    assert (own.name, own.stages, own.cells) == ("exposure_report", 1, 12)
    assert glance(tree["exposure_report"].to_dataset()).name == "exposure_report"


def test_what_failed_is_named_with_its_place_and_texts_stay_texts(tmp_path, monkeypatch):
    kind = installed_stages().load("linearise")
    run, calls = kind.run, []

    def failing(self, *given, **named):
        calls.append(1)
        if len(calls) == 2:
            raise ArithmeticError(HOSTILE)
        return run(self, *given, **named)

    monkeypatch.setattr(kind, "run", failing)
    outcome = execute(make_plan(parse_pipeline(SMALL), installed_stages()), tmp_path / "failed", Options("serial"))
    (lost,) = outcome.failed
    at = outcome.plan.labels((lost.stage, lost.index))
    html, text = outcome._repr_html_(), repr(outcome)
    assert "1 cell failed" in text and "linearise at f/" in text and "ArithmeticError" in text
    assert asked_of_a_network(html) == [] and "&lt;script&gt;" in html and "1 failed" in html
    seen = glance(etendue.open_archive(tmp_path / "failed"))
    place = f"f/{at['f_number']:g}, {1e3 * at['integration_time']:g} ms"
    assert seen.failed == [("linearise", place, f"ArithmeticError: {HOSTILE}")]
    assert seen.commands[0][0].startswith("etendue run ") and seen.commands[0][0].endswith("/failed")


def test_a_run_that_goes_on_shows_what_is_finished(archive, tmp_path):
    folder = tmp_path / "growing"
    shutil.copytree(archive, folder)
    (folder / "manifest.json").unlink()
    lines = (folder / "journal.jsonl").read_bytes().split(b"\n")
    dropped = [n for n, line in enumerate(lines) if b'"event":"done"' in line and b'"cell":"encode ' in line][4:]
    (folder / "journal.jsonl").write_bytes(b"\n".join(line for n, line in enumerate(lines) if n not in dropped))
    with open(folder / "lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        tree = etendue.open_archive(folder)
        seen = glance(tree)
        assert re.match(r"running: \d+ of \d+ cells", seen.state) and not any(
            c.startswith("etendue run") for c, _ in seen.commands
        )
        assert sum(one.stage == "encode" for one in seen.pictures) == 1  # of a cell that is finished
        assert asked_of_a_network(tree.etendue._repr_html_()) == []
    seen = glance(etendue.open_archive(folder))
    assert seen.state.startswith("interrupted") and seen.commands[0][0].startswith("etendue run ")


def test_a_tree_that_is_closed_or_damaged_says_what_cannot_be_read(archive, tmp_path):
    folder = tmp_path / "damaged"
    shutil.copytree(archive, folder)
    tree = etendue.open_archive(folder)
    tree.close()
    for path in (folder / "data.zarr/exposure_report/mean_snr").rglob("c*"):
        if path.is_file():
            path.write_bytes(b"\0" * path.stat().st_size)
    html = tree.etendue._repr_html_()
    assert "cannot be read" in html and "MTF" not in html.split("Metrics")[-1].split("Next steps")[0]


LOST = (
    "encode",
    *(
        pytest.param(one, marks=pytest.mark.long)
        for one in ("exposure_report/f_number", "ledger/status/c", "zarr.json")
    ),
)


@pytest.mark.parametrize("lost", LOST)
def test_an_archive_that_lost_a_part_is_damaged_and_says_what_mends_it(archive, tmp_path, lost):
    folder = tmp_path / "damaged"
    shutil.copytree(archive, folder)
    whole = etendue.open_archive(folder)
    path = folder / "data.zarr" / lost
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    trees = [whole] if lost == "zarr.json" else [whole, xarray.open_datatree(folder / "data.zarr", engine="zarr")]
    for tree in trees:
        seen, html, text = glance(tree), tree.etendue._repr_html_(), repr(tree.etendue)
        assert seen.state == "damaged" and seen.axes == [] and seen.commands[0][0].endswith("damaged --repair")
        assert all(
            "etendue verify" in shown and "damaged" in shown and "complete" not in shown for shown in (html, text)
        )
        assert "plotted" in text and "0 cells" not in html + text
    with pytest.raises(ArchiveError, match=f"{lost.split('/')[0]}.*etendue verify .* --repair"):
        etendue.open_archive(folder).load()


@pytest.mark.skipif(
    xarray.__version__ < "2026", reason="until then xarray itself reads all texts where it opens a store"
)
def test_a_ledger_that_cannot_be_read_or_has_lost_rows_is_said_to_be_so(archive, tmp_path):
    folder = tmp_path / "elsewhere"  # a store alone, as it is fetched from elsewhere: without manifest and journal
    shutil.copytree(archive / "data.zarr", folder)
    (chunk,) = (folder / "ledger/status/c").iterdir()
    chunk.write_bytes(b"no chunk of any codec")
    tree = xarray.open_datatree(folder, engine="zarr")
    seen = glance(tree)
    assert any("ledger cannot be read" in note for note in seen.notes) and seen.axes and seen.figures
    assert "ledger cannot be read" in repr(tree.etendue) and "ledger cannot be read" in tree.etendue._repr_html_()
    chunk.unlink()
    seen = glance(tree := xarray.open_datatree(folder, engine="zarr"))
    assert seen.counts == {"unknown": seen.cells} and seen.cells > 0
    assert seen.state == f"damaged: no ledger entry for {seen.cells} cells"
    assert "complete" not in repr(tree.etendue)


def test_a_figure_that_is_constant_as_printed_is_said_once():
    own = Metric("fit_residual", "residual", "1", 0.0073312, 0.0073311, 0.0073313)
    assert own.spanned == "" and replace(own, value=math.nan).spanned == "0.007331"
    assert replace(own, most=0.00735).spanned == "0.007331 … 0.00735"


def test_a_run_whose_archive_is_damaged_since_says_so(tmp_path):
    outcome = execute(make_plan(parse_pipeline(SMALL), installed_stages()), tmp_path / "run", Options("serial"))
    assert "; complete; " in repr(outcome)
    shutil.rmtree(tmp_path / "run/data.zarr/ledger")
    assert all(
        "etendue verify" in shown and "cells computed" in shown for shown in (repr(outcome), outcome._repr_html_())
    )


def test_a_tree_of_nobody_is_named_as_it_is():
    tree = xarray.DataTree(xarray.Dataset({"a": ("x", [1.0, 2.0])}), name="odd")
    tree.attrs["pipeline"] = HOSTILE
    assert asked_of_a_network(tree.etendue._repr_html_()) == [] and "&lt;script&gt;" in tree.etendue._repr_html_()

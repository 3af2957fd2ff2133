"""An archive whose axes grow: what is stored stays where it is, only what is new is computed, and it holds what a
fresh run holds.
"""

from __future__ import annotations

import errno
import os
import shutil
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import xarray

from etendue.archive.checks.verify import verify
from etendue.archive.read.reading import open_archive
from etendue.archive.structure.groups import ArchivedLayout, groups_of
from etendue.archive.structure.layout import layout_of
from etendue.archive.structure.naming import Names
from etendue.archive.write.keeper import ArchiveKeeper
from etendue.contract.arrays.grid import Bands, Grid, Line
from etendue.errors import ArchiveError
from tests.archive.dying import Died, dying
from tests.run.small import plan_of
from tests.run.small import run as run_pictured

TEXT = """
name = "growing"

[camera]
peak_qe = [0.36, 0.44, 0.40]
pixel_pitch = "3 um"

[[stages]]
use = "slanted_edge"
name = "scene"
white_luminance = "1000 cd m-2"
width = "70 um"
height = "70 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "pixel"
{frame}
[[stages]]
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "adc"
[[stages]]
use = "lens_numbers"
"""
SAME = "rows = 16\ncolumns = 16"
FIXED = 'sensor_height = "48 um"\nsensor_width = "48 um"'  # 16 x 16 at 3 um, 12 x 12 at 4 um
PITCH, NUMBER, TIME = "sweep.pixel_pitch", "sweep.f_number", "sweep.integration_time"
ROWS, BINS = "sweep.pixel.rows", "sweep.scene.bin_width"
BASE = {PITCH: [3.0], NUMBER: [4.0]}


def plan(frame, axes):
    return plan_of({**BASE, **axes}, TEXT.format(frame=frame))


def run(asked, archive):
    return run_pictured(asked, archive, pictures=False)


def shards(archive):
    """Every shard that there is: of what name, of which inode and time, with which bytes."""
    files = (p for p in (archive / "data.zarr").rglob("c.*") if p.is_file())
    return {p.relative_to(archive).as_posix(): (p.stat().st_ino, p.stat().st_mtime_ns, p.read_bytes()) for p in files}


def contents(archive):
    """Every array of every finished cell, by name."""
    found = open_archive(archive)
    return {
        (name, variable): (a := found.read(cell, variable)).tobytes() + f"{a.dtype}{a.shape}".encode()
        for name, cell in found.cells.items()
        for variable in {chunk.variable for chunk in cell.chunks}
    }


def assert_as_fresh(archive, whole, fresh):
    """An archive holds what a fresh one of the same values holds, cell by cell and as plain xarray reads it; nothing
    is wrong with it.
    """
    assert not verify(archive).damages
    assert contents(archive) == contents(fresh)
    groups = layout_of(whole).groups.values()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        one = xarray.open_datatree(archive / "data.zarr", engine="zarr", chunks=None)
        other = xarray.open_datatree(fresh / "data.zarr", engine="zarr", chunks=None)
    with one, other:
        own = {
            group.node: [n for n in one.subtree if n.path.split("/")[1:2] == [group.node] and not n.children]
            for group in groups
        }
        for group in groups:
            for ref in group.cells:
                at = whole.labels(ref)
                (mine,) = [
                    m for n in own[ref[0]] if (m := taken(n.dataset, at)) is not None and m["status"].item() != 4
                ]
                xarray.testing.assert_identical(mine, taken(other[group.path].dataset, at))


def taken(dataset, at):
    """The cell at some axis values as one dataset; None where they are not all there."""
    if any(value not in dataset[dim].values.tolist() for dim, value in at.items()):
        return None
    found = dataset.sel(at).copy()
    found.attrs = {}  # of a stage they stand at its group, or at that above its shapes
    for name in (*found.coords, *found.data_vars):
        found[name].attrs.pop("coordinates", None)
        found[name].attrs.pop("order", None)
    return found


STEPS = {
    "a pitch is added": [{}, {PITCH: [3.0, 4.0]}],
    "one in front": [{}, {PITCH: [2.4, 3.0]}],
    "one by one": [{}, {PITCH: [3.0, 4.0]}, {PITCH: [3.0, 4.0, 2.4]}],
    "it shrinks": [{PITCH: [3.0, 4.0]}, {PITCH: [4.0]}],
    "it shrinks and grows": [{PITCH: [3.0, 4.0]}, {PITCH: [4.0]}, {PITCH: [4.0, 2.4]}, {PITCH: [3.0, 4.0]}],
    "values are swapped": [{}, {PITCH: [4.0]}],
    "swapped and back": [{}, {PITCH: [4.0]}, {}],
    "another order": [{PITCH: [3.0, 4.0]}, {PITCH: [4.0, 3.0]}],
    "two axes": [{}, {PITCH: [3.0, 4.0], NUMBER: [4.0, 8.0]}],
    "the other axis first": [{}, {NUMBER: [4.0, 8.0]}, {PITCH: [3.0, 4.0], NUMBER: [4.0, 8.0]}],
    "the other axis behind": [{}, {PITCH: [3.0, 4.0]}, {PITCH: [3.0, 4.0], NUMBER: [4.0, 8.0]}],
    "from two to more": [{PITCH: [3.0, 4.0]}, {PITCH: [3.0, 4.0, 2.4]}],
    "some of one shape": [{}, {PITCH: [3.0, 3.01]}, {PITCH: [3.0, 3.01, 4.0]}, {PITCH: [3.0, 4.01]}],
    "wider bins": [{BINS: ["100 nm"]}, {BINS: ["100 nm", "50 nm"]}, {BINS: ["100 nm", "50 nm"], PITCH: [3.0, 4.0]}],
    "rows too": [{ROWS: [16]}, {ROWS: [16], PITCH: [3.0, 4.0]}, {ROWS: [16, 12], PITCH: [3.0, 4.0]}],
    "rows first": [{ROWS: [16]}, {ROWS: [16, 12]}, {ROWS: [16, 12], PITCH: [3.0, 4.0]}],
}


@pytest.fixture(scope="module")
def fresh(tmp_path_factory):
    """Fresh archives by frame and axes, each made once."""
    place, made = tmp_path_factory.mktemp("fresh"), {}

    def archive(frame, axes):
        key = frame, repr(axes)
        if key not in made:
            made[key] = place / str(len(made))
            assert not run(plan(frame, axes), made[key]).failed
        return made[key]

    return archive


QUICK = ("two axes", "some of one shape")


@pytest.mark.parametrize(
    "steps",
    [pytest.param(own, id=name, marks=[] if name in QUICK else [pytest.mark.long]) for name, own in STEPS.items()],
)
@pytest.mark.parametrize("frame", [SAME, FIXED], ids=["rows and columns fixed", "a sensor of fixed size"])
def test_only_what_is_new_is_computed_and_what_is_stored_stays(tmp_path, fresh, frame, steps):
    if frame == FIXED and ROWS in steps[0]:
        frame = 'rows = 16\nsensor_width = "48 um"'  # rows from the axis, columns from the pitch
    archive, done, values = tmp_path / "a", set(), {}
    for axes in steps:
        asked = plan(frame, axes)
        for key, own in {**BASE, **axes}.items():
            values[key] = list(dict.fromkeys([*values.get(key, ()), *own]))
        before, names = shards(archive), set(Names(asked).values())
        outcome = run(asked, archive)
        assert (outcome.computed, len(outcome.reused), outcome.removed) == (len(names - done), len(names & done), 0)
        assert not outcome.reasons or done.isdisjoint(names)
        done |= names
        now = shards(archive)
        stays = {path: state for path, state in before.items() if now.get(path) == state}
        assert set(before.values()) <= set(now.values()), "a shard was written again"
        if frame == SAME and not {ROWS, BINS} & set(axes):
            assert stays == before, "a shard has moved"
    whole = plan(frame, values)
    if set(Names(whole).values()) == done:  # what an archive has never been asked for is missing in it
        assert_as_fresh(archive, whole, fresh(frame, values))
    assert run(asked, archive).computed == 0
    state = {p: p.stat().st_mtime_ns for p in archive.rglob("*") if p.is_file()}
    run(asked, archive)
    assert {p: p.stat().st_mtime_ns for p in archive.rglob("*") if p.is_file()} == state, (
        "a run with nothing to do has written"
    )


@pytest.mark.parametrize("count", [pytest.param(3, id="some"), pytest.param(24, id="many", marks=pytest.mark.long)])
@pytest.mark.parametrize("frame", [SAME, FIXED], ids=["rows and columns fixed", "a sensor of fixed size"])
def test_killed_at_any_change_of_a_file_nothing_stored_is_lost_or_computed_again(
    tmp_path, fresh, monkeypatch, frame, count
):
    """Most of them between the growth of the arrays and the first cell. The next run may also be the one before it
    again.
    """
    old, new = plan(frame, {}), plan(frame, {PITCH: [3.0, 4.0]})
    whole, stored, begun, begin = fresh(frame, {PITCH: [3.0, 4.0]}), contents(fresh(frame, {})), [], ArchiveKeeper.begin

    def copy(name):
        return shutil.copytree(fresh(frame, {}), tmp_path / name)

    with dying(copy("counted")) as operations, monkeypatch.context() as patch:
        patch.setattr(ArchiveKeeper, "begin", lambda *given: (begin(*given), begun.append(len(operations)))[0])
        run(new, tmp_path / "counted")
    chosen = [
        *np.linspace(1, begun[0], count, dtype=int),
        *np.linspace(begun[0] + 1, len(operations), count // 2 + 1, dtype=int),
    ]
    for turn, number in enumerate(dict.fromkeys(chosen)):
        archive, where = copy(f"a{number}"), f"{number}: {operations.names[number - 1]}"
        with dying(archive, number), pytest.raises(Died):
            run(new, archive)
        there = contents(archive)
        assert {key: there.get(key) for key in stored} == stored, where
        if turn % 3 == 0:  # somebody has changed his mind
            again = run(old, archive)
            assert (again.computed, again.removed) == (0, 0), where
        assert run(new, archive).computed <= len(set(Names(new).values()) - set(Names(old).values())), where
        assert not verify(archive).damages, where
        assert contents(archive) == contents(whole), where
        assert not [*archive.rglob("*.part*")], where
    assert_as_fresh(archive, new, whole)


def test_a_second_place_on_a_disk_without_hard_links(tmp_path, fresh, monkeypatch):
    shutil.copytree(fresh(FIXED, {}), tmp_path / "a")

    def link(*_, **__):
        raise OSError(errno.EOPNOTSUPP, "Operation not supported")

    monkeypatch.setattr(os, "link", link)
    new = plan(FIXED, {PITCH: [3.0, 4.0]})
    assert run(new, tmp_path / "a").computed == len(set(Names(new).values()) - set(Names(plan(FIXED, {})).values()))
    assert_as_fresh(tmp_path / "a", new, fresh(FIXED, {PITCH: [3.0, 4.0]}))


def test_what_becomes_an_axis_later_is_refused_and_nothing_changes(tmp_path, fresh):
    """The names of the axes are fixed when an archive is created."""
    archive = shutil.copytree(fresh(SAME, {}), tmp_path / "a")
    before = {p: p.read_bytes() for p in archive.rglob("*") if p.is_file()}
    with pytest.raises(ArchiveError, match="other stages or axes.*another archive"):
        run(plan(SAME, {TIME: ["1 ms"]}), archive)
    assert {p: p.read_bytes() for p in archive.rglob("*") if p.is_file()} == before


def test_another_number_of_rows_is_no_growth(tmp_path, fresh):
    """Cells of another shape in the place of those that are stored: replaced, and named by their own shape."""
    axes = {PITCH: [3.0, 4.0]}
    archive = shutil.copytree(fresh(SAME, axes), tmp_path / "a")
    other = SAME.replace("rows = 16", "rows = 12")
    run(plan(other, axes), archive)
    assert_as_fresh(archive, plan(other, axes), fresh(other, axes))
    assert not (archive / "data.zarr/pixel/16x16").exists()


def test_cells_of_other_bins_never_share_a_group_whatever_the_archive_holds():
    """A group has one coordinate for all of its cells, and both shapes fit what is stored."""
    plane = {"y": Line(4), "x": Line(4)}
    grids = [Grid.of({"wavelength": Bands((edge, 550.0, 700.0)), **plane}) for edge in (400.0, 450.0)]
    cells = [SimpleNamespace(ref=("light", (n,)), grids={"irradiance": grid}) for n, grid in enumerate(grids)]
    node = SimpleNamespace(name="light", writes={"irradiance": SimpleNamespace(dims=("wavelength", "y", "x"))})
    blocks = {"light/old": {"irradiance": {"form": "float32 2x4x4"}}}
    before = ArchivedLayout(["light/old"], blocks, lambda ref: "data.zarr/light/old/irradiance/c.0")
    assert before.of(cells[:1], {"irradiance": (2, 4, 4)}) == ["light/old"]
    home, _ = groups_of(node, cells, ["irradiance"], before)
    assert home["light", (0,)] == "light/old" != home["light", (1,)]

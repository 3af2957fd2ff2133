"""What a run has not finished, or is computing now, is seen through etendue: exactly what the journal vouches for,
and no fill values.
"""

from __future__ import annotations

import shutil
import warnings

import numpy as np
import pytest
import xarray

import etendue
from etendue.archive.checks.describe import describe_archive
from etendue.archive.checks.verify import verify
from etendue.archive.journaling.journal import read
from etendue.archive.read.differences import differences
from etendue.archive.records.names import STATUS, cell_label
from etendue.archive.write.keeper import ArchiveKeeper
from etendue.archive.write.store import ArchiveWriter
from etendue.errors import ArchiveError
from etendue.session import Options, execute
from etendue_camera.export.command import ExportRequest, export
from tests.archive.dying import Died, dying
from tests.archive.tiny import tiny_plan

OTHER = {"camera.pixel_pitch": "4 um"}
GROWN = {"sweep.f_number": [2, 3, 4]}


def run(plan, archive, **options):
    return execute(plan, archive, Options("serial", batch_seconds=0.0, **options))


def groups_of(tree):
    return {node.path.strip("/"): node.to_dataset() for node in tree.subtree if "status" in node.data_vars}


def cells_of(tree):
    """By name of a finished cell and variable: the array."""
    found = {}
    for path, data in groups_of(tree).items():
        axes = list(data["status"].dims)
        variables = [
            v for v in data.data_vars if set(axes) <= set(data[v].dims) and v not in ("status", "wavelength_bounds")
        ]
        arrays = {variable: data[variable].transpose(*axes, ...).values for variable in variables}
        labels = {dim: data[dim].values.tolist() for dim in axes}
        for at in np.argwhere(np.isin(data["status"].values, [STATUS.index("done"), STATUS.index("left_out")])):
            name = cell_label(path.split("/")[0], {dim: labels[dim][i] for dim, i in zip(axes, at, strict=True)})
            found |= {(name, variable): array[tuple(at)] for variable, array in arrays.items()}
    return found


def stored_by(document):
    return sum(stage["cells"].get(status, 0) for stage in document["stages"] for status in ("done", "left_out"))


@pytest.fixture(scope="module")
def other(place):
    run(tiny_plan(place, OTHER), place / "other")
    return place / "other"


def test_of_a_finished_archive_it_is_what_plain_xarray_gives(whole):
    with warnings.catch_warnings(), xarray.open_datatree(whole / "data.zarr", engine="zarr") as plain:
        warnings.simplefilter("error")
        xarray.testing.assert_identical(etendue.open_archive(whole).load(), plain.load())


def test_failed_cells_are_said_to_be_so(plan, tmp_path, monkeypatch):
    from etendue.compute import cell as cells

    made = cells._made

    def fails(job, results, clipped):
        if job.ref[0] == "irradiance" and job.ref[1] == (1,):
            raise ValueError("no light")
        return made(job, results, clipped)

    monkeypatch.setattr(cells, "_made", fails)
    run(plan, tmp_path / "a")
    with xarray.open_datatree(tmp_path / "a/data.zarr", engine="zarr") as plain:
        xarray.testing.assert_identical(etendue.open_archive(tmp_path / "a").load(), plain.load())
    assert set(plain["pixel/4x4/status"].values.ravel().tolist()) == {0, 3}


def instants(begun, plan, tmp_path, count):
    """The folder of a run that was ended at so many of its operations on files, one after the other."""

    def fresh(number):
        archive = tmp_path / f"{number}"
        if begun is not None:
            shutil.copytree(begun, archive)
        return archive

    with dying(fresh(0), 0) as operations:
        run(plan, tmp_path / "0")
    first = 1 if begun is not None else len(operations) // 2  # before that no cell is there
    chosen = np.linspace(first, len(operations), count, dtype=int)
    for number in np.unique([*(np.linspace(1, first, count // 4, dtype=int) if count > 6 else ()), *chosen]):
        archive = fresh(number)
        with dying(archive, int(number)), pytest.raises(Died):
            run(plan, archive)
        yield archive
        shutil.rmtree(archive, ignore_errors=True)


@pytest.mark.parametrize(
    ("begun", "asked", "count"),
    [
        ("whole", GROWN, 4),
        *(pytest.param(*one, 8, marks=pytest.mark.long) for one in ((None, {}), ("whole", GROWN), ("whole", OTHER))),
    ],
)
def test_at_every_instant_of_a_killed_run_what_is_called_stored_is_right(begun, asked, count, place, tmp_path, request):
    plan = tiny_plan(place, asked)
    begun = begun and request.getfixturevalue(begun)
    run(plan, tmp_path / "ended")
    sound = cells_of(etendue.open_archive(tmp_path / "ended"))
    before, partly = cells_of(etendue.open_archive(begun)) if begun else {}, 0
    for archive in instants(begun, plan, tmp_path, count):
        try:
            stored = stored_by(describe_archive(archive))
        except ArchiveError:  # it has no record of a run yet
            assert begun is None
            assert not any(entry.event == "done" for entry in read(archive / "journal.jsonl").entries.values())
            continue
        found = cells_of(etendue.open_archive(archive))
        assert len({name for name, _ in found}) == stored
        partly += 0 < stored < len(plan.cells)
        unchanged = asked == OTHER and b'"event":"outdated"' not in (archive / "journal.jsonl").read_bytes()
        for one, array in found.items():
            np.testing.assert_array_equal(array, (before if unchanged else sound)[one], err_msg=str(one))
    assert partly


def test_an_interrupted_run_gives_up_what_it_has_not_replaced(whole, place, tmp_path, monkeypatch):
    """Its shards are made without them: nobody calls them stored, and nothing is damaged."""
    shutil.copytree(whole, tmp_path / "a")
    plan, finished, left = tiny_plan(place, OTHER), ArchiveKeeper.finished, [3]

    def interrupted(self, reports, arrays):
        found = finished(self, reports, arrays)
        left[0] -= len(reports)
        if left[0] <= 0:
            raise KeyboardInterrupt
        return found

    monkeypatch.setattr(ArchiveKeeper, "finished", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(plan, tmp_path / "a")
    pixels = next(stage for stage in describe_archive(tmp_path / "a")["stages"] if stage["name"] == "pixel")
    assert pixels["cells"] == {"done": 3, "not_computed": 5}
    assert verify(tmp_path / "a").whole
    assert sum(name.startswith("pixel") for name, _ in cells_of(etendue.open_archive(tmp_path / "a"))) == 3


def test_what_is_lost_is_an_error_and_no_fill_value(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "a")
    shard = next((tmp_path / "a/data.zarr/pixel/4x4/photon_rate").glob("c.*"))
    shard.unlink()
    with xarray.open_datatree(tmp_path / "a/data.zarr", engine="zarr") as plain:
        assert np.isnan(plain["pixel/4x4/photon_rate"].values).all()
    tree = etendue.open_archive(tmp_path / "a")
    with pytest.raises(ArchiveError, match=r"photon_rate of pixel f_number=2\.0 .* verify --repair"):
        tree["pixel/4x4/photon_rate"].isel(f_number=0, back=0).values  # noqa: B018


def test_a_run_that_goes_on_is_read_through_its_parts_becoming_shards(plan, whole, tmp_path, monkeypatch):
    """The tree was opened while a cell lay in a part; it is read when the part is a shard."""
    finished, opened, reads = ArchiveKeeper.finished, [], []

    def looked(self, reports, arrays):
        found = finished(self, reports, arrays)
        opened.append(etendue.open_archive(self.folder))
        if len(opened) % 4 == 1:
            reads.append(cells_of(opened[len(opened) // 2]) | cells_of(opened[-1]))
        return found

    monkeypatch.setattr(ArchiveKeeper, "finished", looked)
    run(plan, tmp_path / "a")
    sound = cells_of(etendue.open_archive(whole))
    assert len({name for name, _ in reads[-1]}) == len(plan.cells)
    assert all(np.array_equal(array, sound[one]) for seen in reads for one, array in seen.items())


def test_a_killed_run_can_be_exported_compared_and_verified(plan, whole, tmp_path, monkeypatch):
    archive, reported = tmp_path / "a", ArchiveWriter.reported
    with dying(archive) as operations:

        def dies(self, reports):
            reported(self, reports)
            if len(self.ended) - self.ended.count(0) >= 9:
                operations.at = 1

        monkeypatch.setattr(ArchiveWriter, "reported", dies)
        with pytest.raises(Died):
            run(plan, archive)
    cells = {name for name, entry in read(archive / "journal.jsonl").entries.items() if entry.event == "done"}
    pictures = [name for name in cells if name.startswith("pixel ")]
    assert 0 < len(pictures) < 8
    done = export(ExportRequest(archive, tiff=True, variables=("photon_rate",), output=tmp_path / "out"))
    assert (len(done.files), len(done.skipped)) == (len(pictures), 8 - len(pictures))
    found = differences(archive, whole)
    assert sum(stage.same for stage in found) == len(cells)
    assert not any(stage.differing or stage.only_first for stage in found)
    checked = verify(archive)
    assert checked.cells == len(cells)
    assert {damage.kind for damage in checked.damages} == {"unfinished"}

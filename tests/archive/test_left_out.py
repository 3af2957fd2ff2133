"""What is left out in all cells has no array: readers follow the note to the one that has the values, and a run that
goes on leaves what an uninterrupted one does.
"""

from __future__ import annotations

import json
import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray

import etendue
from etendue.archive.checks.describe import describe_archive
from etendue.archive.checks.verify import verify
from etendue.archive.journaling.journal import NAME, summed
from etendue.archive.read.differences import differences
from etendue.archive.read.following import follow
from etendue.archive.read.left_out import tree_with_left_out
from etendue.archive.read.reading import open_archive
from etendue.archive.read.stored import Stored
from etendue.archive.records import manifest
from etendue.archive.write.compact import compact
from etendue.archive.write.in_place import compact_in_place
from etendue.archive.write.keeper import ArchiveKeeper
from etendue.contract.registry import installed_stages
from etendue.errors import ArchiveError
from etendue.pipeline.file import parse_pipeline
from etendue.plan.planner import make_plan, summary
from etendue.present.plots.holdings import Holdings
from etendue.session import Options, collect, execute
from etendue.trust.repairing import repair
from etendue.trust.reproducing import reproduce
from tests.archive.tiny import store_of

# Three stages that change light in a row, behind one (the lens) that is never left out at these tolerances.
TEXT = """
name = "chain"
seed = 1
tolerance = 1e-9
[camera]
pixel_pitch = "3 um"
peak_qe = [0.36, 0.44, 0.40]
focal_length = "7 mm"
f_number = 2
integration_time = "4 ms"
full_well_density = "2000 electron um-2"
diffusion_depth = "10 um"
diffusion_length = "50 um"
[[stages]]
use = "slanted_edge"
name = "scene"
white_luminance = "1000 cd m-2"
width = "48 um"
height = "48 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "lens_gaussian"
name = "lens"
sigma = "3 um"
[[stages]]
use = "diffraction"
[[stages]]
use = "diffusion"
[[stages]]
use = "falloff"
[[stages]]
use = "pixel"
rows = 8
columns = 8
[[stages]]
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "full_well"
"""
LOOSE = {"tolerance": 0.5}  # all three are left out, and the lens as well
CHAIN = ("lens", "diffraction", "diffusion", "falloff")
NAMES = ("scene", *CHAIN, "pixel", "mosaic", "exposure", "shot_noise", "full_well")  # stages, without ``irradiance``


def plan_of(over=None, leave_out=True):
    return make_plan(parse_pipeline(TEXT, overrides=over or {}), installed_stages(), leave_out)


def run(plan, archive=None, **options):
    outcome = execute(plan, archive, Options(**{"scheduler": "serial", **options}))
    assert not outcome.failed
    return outcome


@pytest.fixture(scope="module")
def plan():
    return plan_of(LOOSE)


@pytest.fixture(scope="module")
def whole(plan, tmp_path_factory):
    folder = tmp_path_factory.mktemp("left") / "whole"
    run(plan, folder)
    return folder


@pytest.fixture
def copy(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "copy")
    return tmp_path / "copy"


def arrays_on_disk(archive, variable="irradiance"):
    return {path.parent.name for path in archive.glob(f"data.zarr/*/{variable}")}


def test_a_chain_of_what_is_left_out_names_the_array_that_is_stored(whole, plan):
    assert {stage for stage, v in plan.same_as if v == "irradiance"} == set(CHAIN)
    assert arrays_on_disk(whole) == {"irradiance"}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plain = xarray.open_datatree(whole / "data.zarr", engine="zarr")
        read = etendue.open_archive(whole)
    for stage in CHAIN:
        assert plain[stage].attrs["same_as"] == "/irradiance/irradiance"
        assert {"status", "wavelength_bounds"} == set(plain[stage].data_vars)
        assert "wavelength" in plain[stage].coords
        xarray.testing.assert_identical(read[stage]["irradiance"], read["irradiance"]["irradiance"])
    xarray.testing.assert_identical(read["full_well"]["charge"], read["shot_noise"]["charge"])
    assert verify(whole).whole


def test_in_memory_it_is_the_array_of_its_input_and_the_tree_is_that_of_the_archive(whole, plan):
    for scheduler in ("serial", "threads"):
        outcome = run(plan, scheduler=scheduler)
        tree = outcome.tree
        for stage in CHAIN:
            assert np.shares_memory(tree[stage]["irradiance"].values, tree["irradiance"]["irradiance"].values)
            assert not tree[stage]["irradiance"].values.flags.writeable
            assert np.shares_memory(
                outcome.arrays[stage, ()]["irradiance"], outcome.arrays["irradiance", ()]["irradiance"]
            )
        wanted = {(stage, ()): ["irradiance"] for stage in ("irradiance", *CHAIN)}
        found = collect(plan, wanted, Options(scheduler=scheduler)).arrays
        assert len({id(own["irradiance"]) for own in found.values()}) == 1
        read = etendue.open_archive(whole)
        for path in ("irradiance", *CHAIN, "pixel", "full_well"):
            assert dict(tree[path].attrs) == dict(read[path].attrs)
            assert set(tree[path].data_vars) == set(read[path].data_vars)
            for name in read[path].data_vars:
                assert np.array_equal(tree[path][name].values, read[path][name].values)


def test_a_named_copy_is_none_in_memory_and_a_known_cell_is_taken_as_it_is(plan):
    named = plan_of({**LOOSE, "keep": ["diffusion.irradiance", "irradiance.irradiance", *NAMES]})
    tree = run(named).tree
    assert np.shares_memory(tree["diffusion"]["irradiance"].values, tree["irradiance"]["irradiance"].values)
    known = np.ones(collect(plan, {("diffusion", ()): ["irradiance"]}).arrays["diffusion", ()]["irradiance"].shape)
    given = {("diffusion", ()): {"irradiance": known.astype(np.float32)}}
    found = collect(plan, {("falloff", ()): ["irradiance"]}, known=given).arrays
    assert (found["falloff", ()]["irradiance"] == 1).all()


def test_nothing_is_computed_drawn_or_told_for_it(whole, plan):
    tree = etendue.open_archive(whole)
    ledger, frames = tree["ledger"].to_dataset(), tree["frames"].to_dataset()
    omitted = ledger["status"].values == "left_out"
    assert omitted.sum() == 5
    seconds = dict(zip(ledger["stage"].values.tolist(), ledger["seconds"].values.tolist(), strict=True))
    assert all(seconds[stage] < 1e-3 for stage in CHAIN)
    pictures = dict(zip(frames["stage"].values.tolist(), frames["preview"].values, strict=True))
    assert all(np.array_equal(pictures[stage], pictures["irradiance"]) for stage in CHAIN)
    stages = {one["name"]: one for one in summary(plan)["stages"]}
    assert stages["diffusion"]["bytes"] == 0 and stages["diffusion"]["left_out"]["copies"] == 0
    assert stages["diffusion"]["variables"]["irradiance"] == {
        "bytes": 0,
        "kept": True,
        "same_as": "irradiance.irradiance",
    }


def test_readers_of_cells_follow_it(whole, tmp_path):
    stored = Stored(whole)
    first = stored.cell("irradiance").read("irradiance")
    for stage in CHAIN:
        assert (stage, "irradiance") in stored.variables()
        assert np.array_equal(stored.cell(stage).read("irradiance"), first)
    shown = {one["name"]: one["variables"] for one in describe_archive(whole)["stages"]}
    assert [v["same_as"] for v in shown["diffusion"]] == ["/irradiance/irradiance"]
    plain = xarray.open_datatree(whole / "data.zarr", engine="zarr")
    assert {f"{stage}.irradiance" for stage in CHAIN} <= {one.name for one in Holdings(plain)}
    again = reproduce(whole, Options("serial"))
    assert again.reproduced, (again.differences, again.damages)
    assert {cell.stage for cell in again.cells} >= set(CHAIN)
    compact(whole, tmp_path / "compacted")
    assert verify(tmp_path / "compacted").whole
    assert all(stage.equal for stage in differences(whole, tmp_path / "compacted"))


def test_keep_writes_the_copy_that_it_names_and_the_two_forms_do_not_differ(whole, tmp_path):
    named = plan_of(
        {**LOOSE, "keep": ["diffusion.irradiance", "irradiance.irradiance", "irradiance.white_irradiance", *NAMES]}
    )
    run(named, tmp_path / "named")
    assert arrays_on_disk(tmp_path / "named") == {"irradiance", "diffusion"}
    assert all(stage.equal for stage in differences(whole, tmp_path / "named"))
    assert reproduce(tmp_path / "named", Options("serial")).reproduced
    # And back: the copy goes, the values stay.
    run(plan_of(LOOSE), tmp_path / "named")
    assert arrays_on_disk(tmp_path / "named") == {"irradiance"}
    assert verify(tmp_path / "named").whole
    assert store_of(tmp_path / "named") == store_of(whole)


def test_an_archive_of_an_earlier_version_has_copies_and_is_read_reproduced_and_continued(whole, plan, tmp_path):
    run(replace(plan, copied=plan.kept), tmp_path / "before")
    assert arrays_on_disk(tmp_path / "before") == {"irradiance", *CHAIN}
    assert verify(tmp_path / "before").whole
    assert reproduce(tmp_path / "before", Options("serial")).reproduced
    assert all(stage.equal for stage in differences(tmp_path / "before", whole))
    assert run(plan, tmp_path / "before").computed == 0
    assert arrays_on_disk(tmp_path / "before") == {"irradiance"}
    assert verify(tmp_path / "before").whole
    read = etendue.open_archive(tmp_path / "before")
    for stage in CHAIN:
        xarray.testing.assert_identical(read[stage]["irradiance"], read["irradiance"]["irradiance"])


def test_without_its_source_the_first_that_is_kept_has_the_copy(tmp_path):
    run(plan_of({**LOOSE, "keep": ["diffraction", "diffusion", "falloff", "pixel"]}), tmp_path / "some")
    assert arrays_on_disk(tmp_path / "some") == {"diffraction"}
    tree = etendue.open_archive(tmp_path / "some")
    assert tree["falloff"].attrs["same_as"] == tree["diffusion"].attrs["same_as"] == "/diffraction/irradiance"
    assert np.array_equal(tree["falloff"]["irradiance"].values, tree["diffraction"]["irradiance"].values)
    assert verify(tmp_path / "some").whole


@pytest.mark.parametrize("order", [(True, False), (False, True)])
def test_with_another_tolerance_a_run_leaves_what_an_uninterrupted_one_does(order, tmp_path):
    for number, leave_out in enumerate(order):
        run(plan_of(LOOSE, leave_out), tmp_path / "grown")
        run(plan_of(LOOSE, leave_out), tmp_path / f"fresh{number}")
        assert store_of(tmp_path / "grown") == store_of(tmp_path / f"fresh{number}")
        assert verify(tmp_path / "grown").whole
        assert run(plan_of(LOOSE, leave_out), tmp_path / "grown").computed == 0


def test_where_only_some_cells_are_left_out_the_copies_stay_and_the_plan_says_what_they_take(tmp_path):
    """Along an axis of a stage of the chain: left out at one value, computed at another."""
    mixed = plan_of({"tolerance": 1e-2, "sweep.diffusion_depth": [1e-3, 20.0]})
    cells = [cell.left_out is not None for cell in mixed.of("diffusion")]
    assert cells == [True, False]
    assert ("diffusion", "irradiance") not in mixed.same_as
    own = next(one for one in summary(mixed)["stages"] if one["name"] == "diffusion")
    assert own["left_out"]["copies"] == own["bytes"] / 2 > 0
    run(mixed, tmp_path / "mixed")
    tree = etendue.open_archive(tmp_path / "mixed")
    assert tree["diffusion"]["irradiance"].sizes["diffusion_depth"] == 2
    assert verify(tmp_path / "mixed").whole
    # Begun with the value at which it is left out: the copies come with the other value, and go with it.
    alone = {"tolerance": 1e-2, "sweep.diffusion_depth": [1e-3]}
    run(plan_of(alone), tmp_path / "grown")
    assert "diffusion" not in arrays_on_disk(tmp_path / "grown")
    run(mixed, tmp_path / "grown")
    assert arrays_on_disk(tmp_path / "grown") == arrays_on_disk(tmp_path / "mixed")
    assert all(stage.equal for stage in differences(tmp_path / "grown", tmp_path / "mixed"))
    run(plan_of(alone), tmp_path / "grown", prune=True)
    assert arrays_on_disk(tmp_path / "grown") == arrays_on_disk(tmp_path / "mixed")  # values stay
    assert verify(tmp_path / "grown").whole


def test_an_axis_that_only_a_stage_left_out_has_repeats_its_source(tmp_path):
    plan = plan_of({**LOOSE, "sweep.diffusion_depth": [5.0, 2.0], "sweep.f_number": [4, 2]})
    assert ("diffusion", "irradiance") in plan.same_as
    run(plan, tmp_path / "axes")
    read, memory = etendue.open_archive(tmp_path / "axes"), run(plan).tree
    far = tree_with_left_out(xarray.open_datatree(tmp_path / "axes" / "data.zarr", engine="zarr"))
    source = read["irradiance"]["irradiance"]
    for tree in (read, memory, far):
        own = tree["diffusion"]["irradiance"]
        assert set(own.dims) == {"diffusion_depth", *source.dims}
        for depth in (2.0, 5.0):
            xarray.testing.assert_equal(own.sel(diffusion_depth=depth, drop=True).transpose(*source.dims), source)
        part = own.isel(diffusion_depth=1, y=slice(3, 9, 2), x=[1, 5], f_number=[1, 0])
        xarray.testing.assert_equal(
            part.drop_vars("diffusion_depth").load(), source.isel(y=slice(3, 9, 2), x=[1, 5], f_number=[1, 0]).load()
        )
    before = read["diffusion"]["irradiance"].load().sortby(["f_number", "diffusion_depth"])
    compact_in_place(tmp_path / "axes")
    assert verify(tmp_path / "axes").whole
    after = etendue.open_archive(tmp_path / "axes")["diffusion"]["irradiance"]
    xarray.testing.assert_equal(after.sortby(["f_number", "diffusion_depth"]), before)


def test_a_run_that_dies_after_any_batch_is_read_so_far_and_finished_by_the_next(whole, plan, tmp_path, monkeypatch):
    """Also in a copy of it in another folder."""
    real, arrays = ArchiveKeeper.finished, etendue.open_archive(whole)
    for ends in range(1, 9):

        def finished(self, reports, found, left=iter(range(ends))):  # noqa: B008  # one for each run
            if next(left, None) is None:
                raise RuntimeError("dies here")
            return real(self, reports, found)

        folder = tmp_path / f"dies{ends}"
        with monkeypatch.context() as patch:
            patch.setattr(ArchiveKeeper, "finished", finished)
            with pytest.raises(RuntimeError):
                run(plan, folder, batch_seconds=0.0)
        try:
            tree = etendue.open_archive(folder)
        except ArchiveError:  # nothing to be read yet
            tree = xarray.DataTree()
        for stage in CHAIN:
            if stage in tree.children and tree[stage]["status"] == 1:
                assert np.array_equal(tree[stage]["irradiance"].values, arrays[stage]["irradiance"].values)
        shutil.copytree(folder, tmp_path / f"elsewhere{ends}")
        for place in (folder, tmp_path / f"elsewhere{ends}"):
            run(plan, place)
            assert store_of(place) == store_of(whole)
            assert verify(place).whole
            assert run(plan, place).computed == 0


def test_schedulers_leave_the_same_archive(whole, plan, tmp_path):
    for scheduler in ("threads", "processes"):
        run(plan, tmp_path / scheduler, scheduler=scheduler, workers=2)
        assert store_of(tmp_path / scheduler) == store_of(whole)


def test_an_object_store_has_the_same(whole, plan, tmp_path, monkeypatch):
    pytest.importorskip("obstore", reason="object stores need obstore: pip install 'etendue[objects]'")
    from etendue.archive import places
    from etendue.archive.remote import objects

    monkeypatch.setenv("ETENDUE_WORK", str(tmp_path / "work"))
    monkeypatch.setattr(objects, "_memory", {})
    url = "memory:///chain"
    run(plan, url)
    with places.reading(url, exact=True) as folder:
        assert verify(folder).whole
        assert all(one.equal for one in differences(whole, folder))
    tree, there = etendue.open_archive(url), etendue.open_archive(whole)
    for stage in (*CHAIN, "full_well"):
        xarray.testing.assert_identical(tree[stage].to_dataset().compute(), there[stage].to_dataset().compute())


def test_each_shape_of_a_stage_names_the_array_of_its_shape_also_when_a_second_one_comes(tmp_path):
    run(plan_of({**LOOSE, "sweep.pixel.rows": [8]}), tmp_path / "grown")
    both = plan_of({**LOOSE, "sweep.pixel.rows": [8, 6]})
    run(both, tmp_path / "grown")
    run(both, tmp_path / "fresh")
    memory = run(both).tree
    for archive in ("grown", "fresh"):
        tree = etendue.open_archive(tmp_path / archive)
        for shape in ("8x8", "6x8"):
            assert tree["full_well"][shape].attrs["same_as"] == f"/shot_noise/{shape}/charge"
            own, source = tree["full_well"][shape]["charge"], tree["shot_noise"][shape]["charge"]
            xarray.testing.assert_identical(own, source)
            assert np.array_equal(own.values, memory["full_well"][shape]["charge"].values)
        assert verify(tmp_path / archive).whole
    assert reproduce(tmp_path / "fresh", Options("serial")).reproduced
    assert {cell.found for cell in reproduce(tmp_path / "grown", Options("serial")).cells} == {"same"}
    assert run(both, tmp_path / "grown").computed == 0


def test_what_follows_a_failed_cell_is_skipped(tmp_path, monkeypatch):
    from etendue_camera.electronics.stages.exposure import ShotNoise

    def fails(self, *arguments, **named):
        raise ValueError("no photons today")

    plan = plan_of(LOOSE)
    monkeypatch.setattr(ShotNoise, "run", fails)
    for archive in (tmp_path / "failed", None):
        outcome = execute(plan, archive, Options("serial"))
        tree = etendue.open_archive(archive) if archive else outcome.tree
        assert int(tree["full_well"]["status"]) == 3
        assert np.isnan(tree["full_well"]["charge"].values).all()
    assert verify(tmp_path / "failed").whole


def test_a_damaged_source_is_repaired_for_all_that_follow_it(copy, whole):
    shard = next((copy / "data.zarr/irradiance/irradiance").glob("c.*"))
    data = bytearray(shard.read_bytes())
    data[100] ^= 1
    shard.write_bytes(bytes(data))
    assert not verify(copy).whole
    with pytest.raises(ArchiveError):
        Stored(copy).cell("falloff").read("irradiance")
    with pytest.raises(ArchiveError):
        etendue.open_archive(copy)["falloff"]["irradiance"].load()
    repair(copy, (), Options("serial"))
    assert verify(copy).whole
    assert store_of(copy) == store_of(whole)


# -- forged notes -----------------------------------------------------------------------------------------------------

FORGED = {
    "a cycle": ("diffraction", "/diffusion/irradiance"),
    "itself": ("diffusion", "/diffusion/irradiance"),
    "a path out of the archive": ("diffusion", "/../../irradiance"),
    "a path that is not there": ("diffusion", "/nowhere/irradiance"),
    "a variable of another shape": ("diffusion", "/scene/irradiance"),
    "another variable": ("diffusion", "/irradiance/white_irradiance"),
    "the status": ("full_well", "/shot_noise/status"),
    "values of another key": ("full_well", "/exposure/charge"),
}


def forged(archive: Path, stage: str, path: str, everywhere: bool) -> None:
    """Put another path into the note of a group; ``everywhere``: also into journal and manifest, with right digests."""
    for name in ("zarr.json", f"{stage}/zarr.json"):
        place = archive / "data.zarr" / name
        document = json.loads(place.read_text())
        nodes = [document] if name != "zarr.json" else [document["consolidated_metadata"]["metadata"][stage]]
        for node in nodes:
            node["attributes"]["same_as"] = path
        place.write_text(json.dumps(document, indent=2))
    if not everywhere:
        return
    lines = []
    for line in (archive / NAME).read_bytes().splitlines():
        one = json.loads(line)
        if one["event"] == "same" and one["group"] == stage:
            one.pop("sum")
            one["same"] = {path.rpartition("/")[2]: path}
            line = summed(json.dumps(one, separators=(",", ":")).encode())
        lines.append(line + b"\n")
    (archive / NAME).write_bytes(b"".join(lines))
    known = manifest.read_manifest(archive)
    files = {p: (archive / p).read_bytes() for p in known.metadata}
    manifest.write_manifest(archive, files, False)


@pytest.mark.parametrize("everywhere", [False, True])
@pytest.mark.parametrize("what", FORGED)
def test_a_forged_note_is_named_and_leads_nowhere(what, everywhere, copy, whole):
    stage, path = FORGED[what]
    forged(copy, stage, path, everywhere)
    found = verify(copy)
    if (what, everywhere) == ("another variable", True):  # of the same cell: only the pipeline tells that it is another
        assert reproduce(copy, Options("serial")).differences
        return
    assert not found.whole
    assert any(stage in (d.path + d.array + d.what + d.cell) for d in found.damages), found.damages
    right = Stored(whole).cell(stage)
    variable = right.variables[0]
    archive = open_archive(copy)
    try:
        own = Stored(copy).cell(stage)
        if variable in own.variables:  # the journal was not forged, or not for this variable
            assert np.array_equal(own.read(variable), right.read(variable))
    except ArchiveError:
        pass
    for one in follow(archive.journal, archive.cells):
        assert all(chunk.variable == one.variable for _, chunks in one.cells.values() for chunk in chunks)
    try:
        read = etendue.open_archive(copy)[stage].to_dataset()
        if variable in read:
            assert np.array_equal(read[variable].values, right.read(variable), equal_nan=True)
    except ArchiveError:
        pass
    plain = tree_with_left_out(xarray.open_datatree(copy / "data.zarr", engine="zarr"))
    assert set(plain[stage].data_vars) <= {variable, "status", "wavelength_bounds", path.rpartition("/")[2]}
    repair(copy, (), Options("serial"))
    assert verify(copy).whole

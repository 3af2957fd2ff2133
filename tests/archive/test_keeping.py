"""Finished results are removed only when that is asked for; what somebody else put into an archive, never."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
import xarray
import zarr

from etendue.cli import main
from etendue.errors import ArchiveError, RequestError
from etendue.session import Options, execute
from tests.archive.tiny import store_of, tiny_file, tiny_plan


@pytest.fixture
def copy(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "copy")
    return tmp_path / "copy"


def run(plan, archive, **options):
    return execute(plan, archive, Options("serial", **options))


def chunks(archive, path):
    """The chunks of an array, by shard and slot."""
    return {name: data for name, data in store_of(archive).items() if name.startswith(f"{path}/c.")}


def test_what_keep_no_longer_names_stays_while_it_is_right(copy, whole, place):
    outcome = run(tiny_plan(place, {"keep": ["pixel"]}), copy)
    assert (outcome.computed, outcome.pruned) == (0, 0)
    assert outcome.stay == ["scene", "irradiance", "lens_numbers"]
    assert store_of(copy) == store_of(whole)


def test_what_keep_no_longer_names_and_is_wrong_now_is_asked_about(copy, place, capsys):
    before = {p: p.read_bytes() for p in copy.rglob("*") if p.is_file()}
    asked = ["--set", 'keep=["pixel"]', "--set", "camera.transmittance=0.5"]
    arguments = ["run", str(tiny_file(place)), "--archive", str(copy), *asked, "--quiet"]
    with pytest.raises(SystemExit) as stopped:
        main(arguments, prog_name="etendue")
    said = capsys.readouterr().err
    assert stopped.value.code == 2
    for word in ("irradiance (2 cells)", "bytes", "--prune"):
        assert word in said
    assert {p: p.read_bytes() for p in copy.rglob("*") if p.is_file()} == before
    with pytest.raises(SystemExit) as stopped:
        main([*arguments, "--prune"], prog_name="etendue")
    assert stopped.value.code == 0
    assert "pruned" in capsys.readouterr().out
    with xarray.open_datatree(copy / "data.zarr", engine="zarr", chunks=None) as tree:
        assert set(tree.children) == {"pixel", "ledger", "summary", "frames"}
    run(tiny_plan(place, {"keep": ["pixel"], "camera.transmittance": 0.5}), copy.parent / "fresh")
    mine, fresh = store_of(copy), store_of(copy.parent / "fresh")
    assert {k: v for k, v in mine.items() if k.startswith("pixel")} == {
        k: v for k, v in fresh.items() if k.startswith("pixel")
    }
    assert set(mine) == set(fresh)


def test_a_stage_of_which_something_is_kept_goes_on_with_all_of_it(copy, place):
    """One status holds for all variables of a stage: none of them may lack what it calls done."""
    run(tiny_plan(place, {"keep": ["irradiance.white_irradiance"], "sweep.f_number": [2, 4, 8]}), copy)
    with xarray.open_datatree(copy / "data.zarr", engine="zarr", chunks=None) as tree:
        found = tree["irradiance"].dataset
        assert (found["status"].values <= 1).all()
        assert np.isfinite(found["irradiance"].values).all()


SWAPPED = """
name = "swapped"
[camera]
peak_qe = [0.36, 0.44, 0.40]
[[stages]]
use = "slanted_edge"
name = "scene"
white_luminance = "1000 cd m-2"
width = "20 um"
height = "20 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "lens_gaussian"
name = "blur"
[sweep]
"blur.use" = [
    { use = "lens_gaussian", label = "sharp", sigma = "1 um" },
    { use = "lens_gaussian", label = "soft", sigma = "2 um" },
]
"""


def test_an_alternative_that_left_the_sweep_stays_while_it_is_right(tmp_path):
    from etendue.contract.registry import installed_stages
    from etendue.plan.planner import make_plan
    from etendue.session import load

    def swapped(**more):
        return make_plan(load(SWAPPED, more), installed_stages())

    one = {"sweep.blur.use": [{"use": "lens_gaussian", "label": "soft", "sigma": "2 um"}]}
    run(swapped(), tmp_path / "a")
    before = chunks(tmp_path / "a", "blur/irradiance")
    assert len(before) == 10  # two alternatives, each in five bands
    outcome = run(swapped(**one), tmp_path / "a")
    assert (outcome.computed, outcome.removed) == (0, 0)
    assert chunks(tmp_path / "a", "blur/irradiance") == before
    # what nobody can say of an alternative whose record is gone: whether it is right
    for path in (tmp_path / "a/runs").iterdir():
        path.unlink()
    with pytest.raises(ArchiveError, match=r"blur \(1 cell\).*--prune"):
        run(swapped(**one), tmp_path / "a", accept_platform=True)
    assert run(swapped(**one), tmp_path / "a", accept_platform=True, prune=True).pruned == 1
    assert len(chunks(tmp_path / "a", "blur/irradiance")) == 5


def test_a_value_that_is_no_longer_possible_is_asked_about(copy, place):
    """Of 5 rows of the wider pixel there is no light any more."""
    wide = {"camera.pixel_pitch": "4.5 um", "sweep.pixel.rows": [4]}
    with pytest.raises(ArchiveError, match=r"pixel \(4 cells\).*--prune"):
        run(tiny_plan(place, wide), copy)
    assert run(tiny_plan(place, wide), copy, prune=True).pruned == 4


def test_a_group_of_somebody_else_stays(copy, plan):
    store = zarr.open_group(str(copy / "data.zarr"), mode="a", zarr_format=3, use_consolidated=False)
    store.create_group("mine").create_array("words", data=np.arange(3.0), dimension_names=["n"])
    (copy / "data.zarr/mine/notes.txt").write_text("words")
    (copy / "data.zarr/scene/notes.txt").write_text("words")
    (copy / "figures").mkdir()
    run(plan, copy, recompute=True, prune=True)
    with xarray.open_datatree(copy / "data.zarr", engine="zarr", chunks=None) as tree:
        assert tree["mine/words"].values.tolist() == [0, 1, 2]
        assert "radiance" in tree["scene"]
    for path in ("data.zarr/mine/notes.txt", "data.zarr/scene/notes.txt", "figures"):
        assert (copy / path).exists()


@pytest.mark.parametrize("where", ["", "scene", "pixel/4x4"])
def test_an_array_of_somebody_else_among_ours_is_refused_by_name(copy, plan, where):
    store = zarr.open_group(str(copy / "data.zarr"), mode="a", zarr_format=3, use_consolidated=False)
    (store[where] if where else store).create_array("mine", data=np.arange(3.0), dimension_names=["n"])
    before = {p: p.read_bytes() for p in copy.rglob("*") if p.is_file()}
    with pytest.raises(ArchiveError, match=rf"{where}/mine was not written by a run"):
        run(plan, copy, prune=True)
    assert {p: p.read_bytes() for p in copy.rglob("*") if p.is_file()} == before


def test_another_shape_removes_its_own_files_only(copy, place):
    (copy / "data.zarr/pixel/5x4/photon_rate/notes.txt").write_text("words")
    run(tiny_plan(place, {"camera.peak_qe": [0.3, 0.3, 0.3], "pixel.columns": 3}), copy)
    assert (copy / "data.zarr/pixel/5x4/photon_rate/notes.txt").read_text() == "words"
    assert not (copy / "data.zarr/pixel/4x4").exists()
    with xarray.open_datatree(copy / "data.zarr", engine="zarr", chunks=None) as tree:
        assert set(tree["pixel"].children) == {"4x3", "5x3"}


# -- names --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ledger", "summary", "frames", "Frames", "__zarr", "a" * 101])
def test_a_stage_named_like_something_of_the_archive_is_refused(place, name):
    text = tiny_file(place).read_text().replace('use = "irradiance"', f'use = "irradiance"\nname = "{name}"')
    from etendue.contract.registry import installed_stages
    from etendue.plan.planner import make_plan
    from etendue.session import load

    with pytest.raises(RequestError, match=r"stages\[2\].name"):
        make_plan(load(text), installed_stages())


@pytest.mark.parametrize("name", ["..", "a/b", ".hidden", "two\\tables", "a\tb", "x" * 101, "-n"])
def test_a_pipeline_whose_name_is_no_folder_is_refused(place, name):
    with pytest.raises(RequestError, match="expected a plain name"):
        tiny_plan(place, {"name": name})


@pytest.mark.parametrize(
    ("sweep", "stage"), [("y", "y"), ("wavelength_bounds", "wavelength_bounds"), ("pixel_rows", "pixel_rows")]
)
def test_an_axis_named_like_a_dim_is_refused(place, sweep, stage):
    text = tiny_file(place).read_text().replace('use = "irradiance"', f'use = "irradiance"\nname = "{stage}"')
    from etendue.contract.registry import installed_stages
    from etendue.plan.planner import make_plan
    from etendue.session import load

    values = ["irradiance", {"use": "irradiance", "label": "again"}]
    with pytest.raises(RequestError, match="give (the|one of the) stages? another 'name'"):
        make_plan(
            load(text.replace("camera.csv", str(place / "camera.csv")), {f"sweep.{sweep}.use": values}),
            installed_stages(),
        )


@pytest.mark.parametrize(
    ("writes", "why"),
    [
        ({"status": "y x [1]"}, "an array with this name"),
        ({"y": "y x [1]"}, "coordinate"),
        ({"y_um": "y x [1]"}, "coordinate"),
        ({"a": "..: y x [1]"}, "letters"),
        ({"a": "zarr.json: y x [1]"}, "letters"),
    ],
)
def test_a_variable_named_like_something_of_the_archive_is_no_stage(writes, why):
    from etendue.contract.stage import Stage, writes_of

    kind = type("Broken", (Stage,), {"writes": writes})
    with pytest.raises(ValueError, match=why):
        writes_of(kind)


# -- how far it is -------------------------------------------------------------------------------------------------


def test_show_says_how_much_of_all_is_done_while_a_run_goes_on(place, plan, tmp_path, capsys, monkeypatch):
    from etendue.archive.checks.describe import describe_archive
    from etendue.archive.write.store import ArchiveWriter

    reported, seen = ArchiveWriter.reported, []

    def look(self, reports):
        reported(self, reports)
        seen.append(describe_archive(tmp_path / "a"))
        main(["show", str(tmp_path / "a")], prog_name="etendue", standalone_mode=False)

    monkeypatch.setattr(ArchiveWriter, "reported", look)
    run(plan, tmp_path / "a", batch_seconds=0.0)
    done = [document["finished"] for document in seen]
    assert done == sorted(done)
    assert done[0] < done[-1] == len(plan.cells)
    assert {document["planned"] for document in seen} == {len(plan.cells)}
    assert all(document["running"] for document in seen)
    assert all(document["rate"] > 0 for document in seen)
    assert seen[0]["left"] > seen[-1]["left"] == 0
    out = capsys.readouterr().out
    assert " cells/s since it started, about " in out
    assert f"cells 1 of {len(plan.cells)} requested by the last run ({100 // len(plan.cells)} %)" in out
    assert f"cells {len(plan.cells)} of {len(plan.cells)}" in out
    # another parameter: what is reused counts, what is computed again does not until it is
    seen.clear()
    run(tiny_plan(place, {"camera.peak_qe": [0.3, 0.3, 0.3]}), tmp_path / "a", batch_seconds=0.0)
    reused = len(plan.cells) - len(plan.of("pixel"))
    assert reused <= seen[0]["finished"] <= reused + 1
    assert seen[-1]["finished"] == len(plan.cells)
    document = json.loads(json.dumps(describe_archive(tmp_path / "a")))
    assert [stage["name"] for stage in document["stages"]] == [node.name for node in plan.nodes]
    assert (document["finished"], document["planned"], document["running"]) == (len(plan.cells), len(plan.cells), False)
    assert (document["rate"], document["left"]) == (None, None)


def test_the_time_that_is_left_follows_what_cells_of_each_stage_have_taken():
    import time

    from etendue.archive.checks.describe import _pace
    from etendue.archive.journaling.entries import Entry
    from etendue.archive.journaling.journal import Going, Read

    took = {"scene []": 4.0, "pixel [0]": 0.25, "pixel [1]": 0.75}  # 5 s; 8 more pixels of 0.5 s are left
    entries = {cell: Entry("done", "", seconds=seconds) for cell, seconds in took.items()}
    read = Read(run=Going({"scene": 1, "pixel": 12}, {"scene": 1, "pixel": 10}, set(took)))
    read.entries.update(entries)
    pace = _pace(read, time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(time.time() - 100)))
    assert pace["rate"] == pytest.approx(3 / 100, rel=0.05)  # the record holds whole seconds
    assert pace["left"] == pytest.approx(100 * 4 / 5, rel=0.05)
    assert _pace(read, "yesterday") == {"rate": None, "left": None}

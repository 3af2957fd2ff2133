"""What an archive is to a stranger with xarray, and what it refuses."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import google_crc32c
import numpy as np
import pytest
import xarray

from etendue.archive.journaling.journal import read
from etendue.archive.read.reading import open_archive
from etendue.archive.sharding import chunks, finding
from etendue.archive.structure.naming import cell_name
from etendue.archive.write.foreign_files import other_stages
from etendue.errors import ArchiveError, ArchiveInUse
from etendue.session import Options, execute
from tests.archive.tiny import index_of, slots_of
from tests.run.small import BARE, SWEEP, assert_same_archives, command, plan_of, run

LOOK = """
import sys, numpy, xarray
from xarray.backends import plugins
found = plugins.entry_points  # those of etendue aside, as where it is not installed
plugins.entry_points = lambda **of: [point for point in found(**of) if not point.value.startswith("etendue")]
tree = xarray.open_datatree(sys.argv[1], engine="zarr")
assert "etendue" not in sys.modules
lazy = tree["shot_noise/32x32/charge"].variable._data
assert not isinstance(lazy, numpy.ndarray), type(lazy)
print(float(tree["shot_noise/32x32/charge"].sel(f_number=5.6, pixel_pitch=2.6, integration_time=0.008).mean()))
"""
WHOLE_CELLS = True  # as they are by default below 64 MB


@pytest.fixture(scope="module")
def plan():
    return plan_of(SWEEP)


@pytest.fixture(scope="module")
def whole(plan, tmp_path_factory):
    """A finished archive; tests that change it take a copy."""
    folder = tmp_path_factory.mktemp("archive") / "whole"
    outcome = run(plan, folder)
    assert not outcome.failed
    return folder


@pytest.fixture
def copy(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "copy")
    return tmp_path / "copy"


@pytest.fixture(scope="module")
def tree(whole):
    with xarray.open_datatree(whole / "data.zarr", engine="zarr", chunks=None) as tree:
        yield tree


# -- to read ---------------------------------------------------------------------------------------------------


def test_it_opens_lazily_without_a_warning_and_without_etendue(whole):
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", LOOK, str(whole / "data.zarr")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) > 0


def test_every_array_says_what_it_is_and_in_which_unit(tree):
    for node in tree.subtree:
        for name, variable in node.dataset.variables.items():
            where = f"{node.path}/{name}"
            assert variable.attrs.get("long_name"), where
            if variable.dtype.kind in "fiu":
                assert variable.attrs.get("units"), where


def test_a_group_with_children_holds_attributes_only(tree):
    parents = [node for node in tree.subtree if node.children and node.path != "/"]
    assert parents
    for node in parents:
        assert not node.dataset.variables, node.path
        assert node.attrs["stage"]


def test_pixels_are_indexed_and_their_positions_stand_beside(tree):
    pixel = tree["pixel/32x32"]
    np.testing.assert_array_equal(pixel["y"].values, np.arange(32))
    assert pixel["y"].attrs["units"] == "1"
    assert "y_um" in pixel["photon_rate"].coords
    assert pixel["y_um"].dims == ("pixel_pitch", "y")
    for pitch in (2.0, 2.6):
        np.testing.assert_allclose(np.diff(pixel["y_um"].sel(pixel_pitch=pitch).values), pitch, rtol=1e-12)


def test_wavelength_bins_have_bounds(tree):
    for group in ("scene", "irradiance", "diffusion"):
        data = tree[group].dataset
        assert data["wavelength"].attrs["bounds"] == "wavelength_bounds"
        np.testing.assert_array_equal(data["wavelength_bounds"].values, [[400, 500], [500, 600], [600, 700]])
        np.testing.assert_array_equal(data["wavelength_bounds"].values.mean(axis=1), data["wavelength"].values)


def test_status_is_done_or_left_out_everywhere(tree):
    for node in tree.subtree:
        if "status" in node and node.path != "/ledger":
            assert set(np.ravel(node["status"].values)) <= {0, 1}, node.path
            assert node["status"].attrs["flag_meanings"].split()[4] == "not_computed"


def test_axes_are_those_that_reach_a_stage(tree):
    assert tree["scene/radiance"].dims == ("wavelength", "y", "x")
    assert tree["diffraction/irradiance"].dims == ("f_number", "wavelength", "y", "x")
    assert tree["adc/32x32/raw"].dims == ("f_number", "pixel_pitch", "integration_time", "y", "x")
    assert tree["adc/32x32/raw"].dtype == np.uint16


def shards_of(folder):
    """The shards of an array, by name, and how many chunks one has room for."""
    slots = slots_of(json.loads((folder / "zarr.json").read_text()))
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.name != "zarr.json"}, slots


def test_a_chunk_is_one_cell(whole, plan):
    for node in plan.nodes:
        for variable in (v for v in node.writes if (node.name, v) in plan.with_arrays):
            folders = [p for p in (whole / "data.zarr" / node.name).rglob(variable) if p.is_dir()]
            assert len(folders) == 1
            shards, slots = shards_of(folders[0])
            assert len(shards) == 1  # the sweep is small
            if slots:
                assert sum(len(index_of(data, slots)) for data in shards.values()) == len(plan.of(node.name)) == slots


def test_every_chunk_of_a_cell_is_where_the_journal_says(whole, plan):
    archive, seen = open_archive(whole), 0
    assert set(archive.cells) == {cell_name(plan, ref) for ref in plan.cells}
    for cell in archive.cells.values():
        for chunk in cell.chunks:
            place = archive.place(chunk)
            with (whole / place.file).open("rb") as file:
                file.seek(place.offset)
                data = file.read(place.size)
            assert (data[-4:], google_crc32c.value(data[:-4])) == (
                chunk.written.digest.to_bytes(4, "little"),
                chunk.written.digest,
            )
            seen += 1
    assert seen == sum(len(plan.of(stage)) for stage, _ in plan.with_arrays)
    assert not list(archive.check())


def test_every_shard_is_in_the_journal(whole, plan):
    named = {file.path for entry in read(whole / "journal.jsonl").entries.values() for file in entry.files}
    kept = {node.name for node in plan.nodes}
    on_disk = {
        str(p.relative_to(whole))
        for p in (whole / "data.zarr").rglob("c*")
        if p.is_file()
        and p.relative_to(whole).parts[1] in kept
        and p.parent.name in plan.node(p.relative_to(whole).parts[1]).writes
    }
    assert on_disk == named


def test_it_names_no_machine_user_or_directory(whole):
    secrets = {
        str(Path.home()),
        os.getcwd(),
        str(whole.parent),
        str(Path(sys.executable).parent),
        socket.gethostname(),
        os.environ.get("USER") or "/home/",
    }
    files = [
        *whole.glob("runs/*.json"),
        *whole.rglob("zarr.json"),
        *(whole / n for n in ("ro-crate-metadata.json", "manifest.json", "journal.jsonl")),
    ]
    assert len(files) > 20
    for path in files:
        text = path.read_text()
        for secret in secrets:
            if len(secret) > 4:
                assert secret not in text, f"{path.name} names {secret}"


def test_a_file_parameter_is_recorded_by_content(tmp_path):
    table = tmp_path / "camera.csv"
    table.write_text(
        "wavelength_nm,R,G,B\n" + "".join(f"{w},{0.1 + w / 4000},{0.2},{0.3}\n" for w in range(380, 781, 10))
    )
    plan = plan_of({"camera.sensitivity": str(table), "wanted": ["pixel"]}, BARE)
    run(plan, tmp_path / "a")
    record = (tmp_path / "a" / "runs" / "0001.json").read_text()
    assert str(tmp_path) not in record
    (kept,) = (tmp_path / "a" / "inputs").iterdir()
    assert kept.read_bytes() == table.read_bytes()
    assert json.loads(record)["shared"]["sensitivity"] == f"sha256:{kept.stem}"


def test_records_are_strict_json_even_with_an_infinite_parameter(tmp_path):
    plan = plan_of({"camera.diffusion_length": "inf", "wanted": ["pixel"]})
    run(plan, tmp_path / "a")

    def refuse(text):
        raise AssertionError(text)

    for path in (tmp_path / "a").rglob("*.json"):
        if "data.zarr" not in path.parts:  # fill values of zarr's own metadata are words already
            json.loads(path.read_text(), parse_constant=refuse)


# -- to resume -------------------------------------------------------------------------------------------------


def test_a_second_run_keeps_figures_that_no_axis_reaches(tmp_path):
    plan = plan_of({"wanted": ["raw", "clipped_fraction", "mtf50"]})
    run(plan, tmp_path / "one")
    run(plan, tmp_path / "two")
    for _ in range(2):
        outcome = run(plan, tmp_path / "two")
        assert outcome.computed == 0
        assert np.isfinite(outcome.arrays[("exposure_report", ())]["clipped_fraction"])
        assert_same_archives(tmp_path / "two", tmp_path / "one")


def test_it_resumes_where_it_was_copied_to(copy, plan):
    assert run(plan, copy).computed == 0


def test_missing_chunks_are_computed_again_and_that_is_said(copy, whole, plan):
    """The shard is gone, and its eight cells with it; or it was cut off in the last of them."""
    path = next((copy / "data.zarr/shot_noise/32x32/charge").glob("c.*"))
    data = path.read_bytes()
    path.unlink()
    again = run(plan, copy)
    assert {r.stage for r in again.reports.values() if r.status == "done"} == {"shot_noise"}
    assert again.computed == len(plan.of("shot_noise"))
    assert again.reasons == {"shot_noise": f"{again.computed} stored cells are missing or damaged on disk"}
    assert_same_archives(copy, whole)
    path.write_bytes(path.read_bytes()[: max(at for at, _ in index_of(data, 8).values()) + 20])
    again = run(plan, copy)
    assert again.computed == 1
    assert again.reasons == {"shot_noise": "1 stored cell is missing or damaged on disk"}
    assert_same_archives(copy, whole)


def test_a_flipped_bit_of_a_cell_is_found_on_reading_and_damages_that_cell_alone(copy, whole, plan):
    path = copy / "data.zarr/pixel/32x32/photon_rate/c.0.0.0.0.0"
    data = bytearray(path.read_bytes())
    at, size = index_of(bytes(data), 4)[2]
    data[at + size // 2] ^= 8
    path.write_bytes(data)
    with xarray.open_datatree(copy / "data.zarr", engine="zarr", chunks=None) as tree:
        for i, j in ((0, 0), (0, 1), (1, 1)):
            tree["pixel/32x32/photon_rate"].isel(f_number=i, pixel_pitch=j).load()
        with pytest.raises(ValueError, match="checksum"):
            tree["pixel/32x32/photon_rate"].isel(f_number=1, pixel_pitch=0).load()
    (damage,) = open_archive(copy).check()
    assert damage.cell == "pixel f_number=5.6 pixel_pitch=2.0"
    assert (damage.variable, damage.slot) == ("photon_rate", 2)


@pytest.mark.parametrize(
    "damage", ["flipped", *(pytest.param(one, marks=pytest.mark.long) for one in ("cut", "behind"))]
)
def test_a_damaged_index_costs_no_cell(copy, whole, plan, damage):
    """The journal knows where every chunk lies."""
    path = copy / "data.zarr/pixel/32x32/photon_rate/c.0.0.0.0.0"
    data = path.read_bytes()
    flipped = bytearray(data)
    flipped[-30] ^= 8
    path.write_bytes({"flipped": bytes(flipped), "cut": data[:-50], "behind": data + b"more"}[damage])
    with (
        xarray.open_datatree(copy / "data.zarr", engine="zarr", chunks=None) as tree,
        pytest.raises(ValueError, match=r".*"),
    ):
        tree["pixel/32x32/photon_rate"].load()
    assert [d.path for d in open_archive(copy).check() if not d.cell] == [
        "data.zarr/pixel/32x32/photon_rate/c.0.0.0.0.0"
    ]
    again = run(plan, copy)
    assert again.computed == 0
    assert again.mended == ["data.zarr/pixel/32x32/photon_rate/c.0.0.0.0.0 (its size or index)"]
    assert_same_archives(copy, whole)
    assert not list(open_archive(copy).check())


def test_a_run_that_has_nothing_to_do_writes_nothing_and_reads_no_chunk(copy, plan, monkeypatch):
    def state():
        return {p: (p.lstat().st_mtime_ns, p.lstat().st_ino) for p in copy.rglob("*")}

    def refuse(*_):
        raise AssertionError("a chunk is read")

    before = state()
    read_bytes = chunks.read_bytes
    seen = []
    monkeypatch.setattr(chunks, "read_bytes", lambda root, place: seen.append(place.size) or read_bytes(root, place))
    monkeypatch.setattr(finding, "holds", refuse)
    outcome = run(plan, copy)
    assert (outcome.computed, outcome.mended) == (0, [])
    assert max(seen) < 200  # figures without dims, for the table at the end
    assert state() == before


def test_a_torn_last_line_counts_as_absent(copy, whole, plan):
    journal = copy / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    last = max(n for n, line in enumerate(lines) if b'"event":"done"' in line)
    journal.write_bytes(b"".join(lines[:last]) + lines[last][: len(lines[last]) // 2])
    assert run(plan, copy).computed > 0
    assert_same_archives(copy, whole)
    assert all(json.loads(line) for line in journal.read_text().splitlines())


def test_done_with_another_key_is_not_done(copy, whole, plan):
    journal = copy / "journal.jsonl"
    lines = [json.loads(line) for line in journal.read_text().splitlines()]
    changed = next(line for line in lines if line["event"] == "done" and line["cell"].startswith("sharpen"))
    changed["key"] = "0" * 32
    journal.write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert run(plan, copy).computed == 1
    assert_same_archives(copy, whole)


def test_done_before_a_later_start_is_not_done(copy, plan):
    """The chunks may have been overwritten since."""
    journal = copy / "journal.jsonl"
    done = next(
        line
        for line in map(json.loads, journal.read_text().splitlines())
        if line["event"] == "done" and line["cell"].startswith("adc")
    )
    with journal.open("a") as handle:
        handle.write(json.dumps({"event": "start", "cell": done["cell"], "key": "1" * 32}) + "\n")
    assert run(plan, copy).computed == 1


def test_a_deleted_journal_trusts_no_file(copy, whole, plan):
    (copy / "journal.jsonl").unlink()
    assert run(plan, copy).computed == len(plan.cells)
    assert_same_archives(copy, whole)


def test_leftovers_of_a_killed_run_are_swept(copy, plan):
    root = copy / "data.zarr/zarr.json"
    document = json.loads(root.read_text())
    del document["consolidated_metadata"]  # as a run that was killed leaves it
    root.write_text(json.dumps(document))
    (copy / "data.zarr/adc/32x32/raw/.c.0.0.0.0.0.12.34.partial").write_bytes(b"half")
    run(plan, copy)
    assert not list(copy.rglob("*.partial"))


# -- to change -------------------------------------------------------------------------------------------------


def test_values_that_left_the_sweep_stay_while_they_are_right(copy, whole):
    outcome = run(plan_of({**SWEEP, "sweep.f_number": [5.6]}), copy)
    assert (outcome.computed, outcome.removed) == (0, 0)
    assert_same_archives(copy, whole)


def test_values_that_left_the_sweep_do_not_read_as_results_of_other_parameters(copy):
    less = plan_of({**SWEEP, "sweep.f_number": [5.6], "camera.transmittance": 0.9})
    assert run(less, copy).removed > 0
    with xarray.open_datatree(copy / "data.zarr", engine="zarr", chunks=None) as tree:
        assert tree["diffraction/f_number"].values.tolist() == [2.0, 5.6]
        for path, name in (("diffraction", "irradiance"), ("sharpen/32x32", "rgb_camera")):
            assert np.isnan(tree[f"{path}/{name}"].sel(f_number=2).values).all()
            assert np.isfinite(tree[f"{path}/{name}"].sel(f_number=5.6).values).all()
            assert (tree[f"{path}/status"].sel(f_number=2).values == 4).all()
            assert (tree[f"{path}/status"].sel(f_number=5.6).values <= 1).all()


def test_a_sweep_that_shrank_and_grew_again_equals_a_fresh_one(copy, whole, plan):
    run(plan_of({**SWEEP, "sweep.f_number": [5.6], "sharpen.strength": 0.4}), copy)
    run(plan, copy)
    assert_same_archives(copy, whole)


def test_a_value_put_in_between_stays_behind_and_is_marked(copy, tmp_path):
    between = plan_of({**SWEEP, "sweep.f_number": [2, 4, 5.6]})
    run(between, copy)
    run(between, tmp_path / "fresh")
    with (
        xarray.open_datatree(copy / "data.zarr", engine="zarr", chunks=None) as grown,
        xarray.open_datatree(tmp_path / "fresh" / "data.zarr", engine="zarr", chunks=None) as fresh,
    ):
        assert grown["adc/32x32/f_number"].values.tolist() == [2.0, 5.6, 4.0]
        assert "sort" in grown["adc/32x32/f_number"].attrs["order"]
        for path in ("diffraction", "pixel/32x32", "adc/32x32"):
            xarray.testing.assert_equal(grown[path].to_dataset().sortby("f_number"), fresh[path].to_dataset())


def test_what_is_no_longer_kept_goes_when_that_is_asked_for(copy, tmp_path):
    less = plan_of({**SWEEP, "keep": ["radiance", "pixel", "resolution.mtf50"]})
    run(less, copy, prune=True)
    run(less, tmp_path / "fresh")
    assert not (copy / "data.zarr/scene/white_radiance").exists()
    assert_same_archives(copy, tmp_path / "fresh", frames=False)


def test_another_frame_size_replaces_the_old_one(copy, tmp_path):
    smaller = plan_of({**SWEEP, "pixel.rows": 24})
    run(smaller, copy)
    run(smaller, tmp_path / "fresh")
    assert not (copy / "data.zarr/pixel/32x32").exists()
    assert_same_archives(copy, tmp_path / "fresh")


def test_another_precision_replaces_the_arrays(copy, tmp_path):
    double = plan_of({**SWEEP, "precision": "float64" if plan_of(SWEEP).precision == "float32" else "float32"})
    run(double, copy)
    run(double, tmp_path / "fresh")
    assert_same_archives(copy, tmp_path / "fresh")


FIXED = {"pixel.rows": 0, "pixel.columns": 0, "pixel.sensor_height": "0.06 mm", "pixel.sensor_width": "0.08 mm"}


def test_a_sensor_of_fixed_size_has_a_child_for_each_shape(tmp_path):
    run(plan_of({**SWEEP, **FIXED}), tmp_path / "a")
    with xarray.open_datatree(tmp_path / "a" / "data.zarr", engine="zarr", chunks=None) as tree:
        assert set(tree["pixel"].children) == {"30x40", "23x30"}
        assert tree["pixel/30x40/photon_rate"].sizes == {
            "f_number": 2,
            "pixel_pitch": 1,
            "channel": 3,
            "y": 30,
            "x": 40,
        }
        assert tree["pixel/30x40/pixel_pitch"].values.tolist() == [2.0]
        assert tree["pixel/23x30/pixel_pitch"].values.tolist() == [2.6]


@pytest.mark.parametrize("kept", [None, ["adc.raw"]], ids=["all", "raw"])
def test_cells_of_another_shape_take_none_away(tmp_path, kept):
    """One shape has no group of its own; the second gives both one: what was finished is there, and stays."""
    for pitch in SWEEP["sweep.pixel_pitch"]:
        outcome = run(plan_of({**FIXED, "sweep.pixel_pitch": [pitch], "keep": kept}), tmp_path / "grown")
    assert not outcome.reasons
    run(plan_of({**FIXED, "sweep.pixel_pitch": SWEEP["sweep.pixel_pitch"], "keep": kept}), tmp_path / "whole")
    assert_same_archives(tmp_path / "grown", tmp_path / "whole", frames=False)


@pytest.mark.parametrize(
    "axis",
    [
        {"sweep.scene.bin_width": ["100 nm", "50 nm"]},
        {"sweep.scene.spacing": ["1 um", "0.5 um"]},
        {"sweep.scene.centre_y": ["0 mm", "1 mm"]},
    ],
    ids=str,
)
def test_axes_that_change_sizes_bins_or_positions_keep_them_apart(tmp_path, axis):
    plan = plan_of({**axis, "wanted": ["diffraction.irradiance", "pixel"]})
    run(plan, tmp_path / "a")
    seen = 0
    with xarray.open_datatree(tmp_path / "a" / "data.zarr", engine="zarr", chunks=None) as tree:
        for cell in plan.of("diffraction"):
            (value,) = plan.labels(cell.ref).values()
            grid = cell.grids["irradiance"]
            (dim,) = plan.labels(cell.ref)
            for node in tree["diffraction"].subtree:
                if dim in node.coords and value in node[dim].values.tolist():
                    own = node.dataset.sel({dim: value})
                    seen += 1
                    assert own["irradiance"].shape == grid.shape(("wavelength", "y", "x"))
                    np.testing.assert_array_equal(own["wavelength"].values, grid["wavelength"].values())
                    positions = own["y_um"] if "y_um" in own else own["y"]
                    np.testing.assert_allclose(positions.values, grid.line("y").values())
                    assert own["status"].item() <= 1
    assert seen == 2


def test_bins_of_the_same_number_at_other_wavelengths_do_not_share_a_group(tmp_path):
    plan = plan_of(
        {
            "sweep.scene.use": [
                {"use": "composite", "label": "low"},
                {"use": "composite", "label": "high", "wavelength_from": "430 nm", "wavelength_to": "730 nm"},
            ],
            "wanted": ["scene"],
        }
    )
    run(plan, tmp_path / "a")
    with xarray.open_datatree(tmp_path / "a" / "data.zarr", engine="zarr", chunks=None) as tree:
        first = {
            node["scene"].values.tolist()[0]: node["wavelength"].values[0] for node in tree["scene"].children.values()
        }
    assert first == {"low": 450.0, "high": 480.0}


# -- to refuse -------------------------------------------------------------------------------------------------


def contents(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_a_directory_that_is_no_archive_is_refused_untouched(tmp_path, plan):
    (tmp_path / "thesis.tex").write_text("words")
    with pytest.raises(ArchiveError, match="--archive"):
        run(plan, tmp_path)
    assert contents(tmp_path) == {"thesis.tex": b"words"}


def test_somebody_elses_store_is_refused_untouched(tmp_path, plan):
    xarray.Dataset({"mine": ("x", [1.0, 2.0])}).to_zarr(tmp_path / "data.zarr", zarr_format=3, consolidated=False)
    before = contents(tmp_path)
    with pytest.raises(ArchiveError, match="not an archive"):
        run(plan, tmp_path)
    assert contents(tmp_path) == before


def test_a_file_is_refused(tmp_path, plan):
    (tmp_path / "a").write_text("")
    with pytest.raises(ArchiveError, match="not an archive"):
        run(plan, tmp_path / "a")


@pytest.mark.parametrize(
    "other", [{"sweep.sharpen.strength": [0.1, 0.2]}, {"wanted": ["raw"]}], ids=["an axis more", "stages less"]
)
def test_other_stages_or_axes_are_refused_with_a_way_out_and_nothing_changes(copy, other):
    before = contents(copy)
    with pytest.raises(ArchiveError, match=r"other stages or axes.*--archive copy-2"):
        run(plan_of({**SWEEP, **other}), copy)
    assert contents(copy) == before


def test_what_to_type_for_other_stages_or_axes_is_said(tmp_path):
    old, new = {"a": ["f"], "b": ["f"]}, {"a": ["f"], "c": ["f"]}
    (tmp_path / "x-2").mkdir()
    record = {"overrides": {"wanted": '["b.one"]'}}
    text = other_stages(tmp_path / "x", old, new, ["c.two"], record)
    assert "not in the archive: c; not in this run: b" in text
    assert "--archive x-3; or get both in one archive: --archive x-3 --want b.one --want c.two" in text
    assert other_stages(tmp_path / "x", old, {"a": ["f"]}, ["a.one"], None).endswith(
        "--archive x-3; or continue in x without --want a.one"
    )
    assert "swept only in this run: g)" in other_stages(tmp_path / "x", old, {"a": ["f"], "b": ["f", "g"]}, None, {})


def test_another_platform_is_refused_and_nothing_changes(copy, plan, monkeypatch):
    from etendue.archive.records import provenance

    there = {**provenance.platform_record(), "cpu_features": "another"}
    monkeypatch.setattr(provenance, "platform_record", lambda: there)
    before = contents(copy)
    with pytest.raises(ArchiveError, match="--accept-platform"):
        run(plan, copy)
    assert contents(copy) == before
    assert run(plan, copy, accept_platform=True).computed == 0


def test_cells_of_an_accepted_platform_stay_and_are_marked(copy, monkeypatch):
    """Keys of random stages, and of what reads them, name the versions of libraries: nothing of them is computed
    again.
    """
    from etendue.archive.records import provenance
    from etendue.plan.expansion import recipes

    def version_of(name):
        return "99.1" if name == "numpy" else versions(name)

    versions = recipes.version_of
    monkeypatch.setattr(recipes, "version_of", version_of)
    monkeypatch.setattr(provenance, "version_of", version_of)
    plan = plan_of(SWEEP)
    arrays = shards_of(copy / "data.zarr/adc/32x32/raw")
    assert run(plan, copy, accept_platform=True).computed == 0
    assert shards_of(copy / "data.zarr/adc/32x32/raw") == arrays
    assert run(plan, copy).computed == 0  # accepted once
    with xarray.open_datatree(copy / "data.zarr", engine="zarr", chunks=None) as tree:
        assert all(f"numpy {versions('numpy')}" in text for text in tree["ledger/platform"].values.tolist())
    grown = {**SWEEP, "sweep.f_number": [2, 5.6, 8]}
    run(plan_of(grown), copy)
    with xarray.open_datatree(copy / "data.zarr", engine="zarr", chunks=None) as tree:
        fresh = tree["ledger/at_f_number"].values == 8
        assert fresh.any()
        assert [text == "" for text in tree["ledger/platform"].values.tolist()] == fresh.tolist()


def test_an_archive_in_use_is_refused(copy, plan):
    handle = os.open(copy / "lock", os.O_RDWR)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        with pytest.raises(ArchiveInUse, match="in use"):
            run(plan, copy)
        (copy.parent / "small.toml").write_text(BARE)
        done = command("run", copy.parent / "small.toml", "--archive", copy)
        assert done.returncode == 4
        assert "in use" in done.stderr
    finally:
        os.close(handle)
    assert run(plan, copy).computed == 0


def test_of_two_runs_at_once_one_is_refused(tmp_path, plan):
    """The first computes nothing before the second has been refused; then it goes on undisturbed."""
    begun, refused = threading.Event(), threading.Event()

    class Slow:
        def begin(self, cells):
            begun.set()
            assert refused.wait(60)

        def starting(self, stages): ...

        def finished(self, reports): ...

        def end(self): ...

    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(execute, plan, tmp_path / "a", Options("serial"), Slow())
        assert begun.wait(60)
        try:
            with pytest.raises(ArchiveInUse):
                run(plan, tmp_path / "a")
        finally:
            refused.set()
        assert not first.result(60).failed


def test_an_archive_that_another_run_is_just_beginning_is_in_use(tmp_path, plan):
    """Its groups are there, the document that makes it an archive is not yet."""
    folder = tmp_path / "a"
    (folder / "data.zarr" / "scene").mkdir(parents=True)
    with open(folder / "lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(ArchiveInUse, match="in use by another run"):
            run(plan, folder)
    with pytest.raises(ArchiveError, match="is not an archive"):
        run(plan, folder)


def test_who_asks_whether_an_archive_is_in_use_keeps_no_run_out(copy, plan):
    """The question takes the lock for an instant."""
    asked = threading.Event()

    def ask():
        with open(copy / "lock") as lock:
            fcntl.flock(lock, fcntl.LOCK_SH)
            asked.set()
            time.sleep(0.02)

    thread = threading.Thread(target=ask)
    thread.start()
    assert asked.wait(60)
    assert run(plan, copy).computed == 0
    thread.join()


def test_a_run_whose_archive_is_taken_over_stops(copy, plan, monkeypatch):
    """On a file system without locks another run may write its id: no chunk is written after that."""
    from etendue.archive.write.store import ArchiveWriter

    reported = ArchiveWriter.reported

    def taken(self, reports):
        (copy / "run.id").write_text("another")
        return reported(self, reports)

    monkeypatch.setattr(ArchiveWriter, "reported", taken)
    with pytest.raises(ArchiveInUse, match="another run"):
        run(plan, copy, recompute=True, batch_seconds=0.0)


def test_an_archive_of_another_owner_that_cannot_be_written_is_the_machines_fault(tmp_path, plan):
    if os.geteuid() == 0:
        pytest.skip("root may write anywhere")
    (tmp_path / "closed").mkdir(mode=0o500)
    from etendue.errors import MachineError

    with pytest.raises(MachineError, match="cannot be written"):
        run(plan, tmp_path / "closed" / "a")

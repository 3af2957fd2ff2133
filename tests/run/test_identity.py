"""The same bits for every scheduler, number of workers, batching and order; alone or swept; resumed or not."""

from __future__ import annotations

import json
import random
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from tests.run.small import (
    DEMOSAICERS,
    SWEEP,
    assert_same_archives,
    assert_same_arrays,
    assert_same_bits,
    by_labels,
    plan_of,
    run,
)

PRECISIONS = ("float32", "float64")


@pytest.fixture(scope="module", params=PRECISIONS)
def reference(request):
    """A plan with all cells computed one after the other, in memory."""
    plan = plan_of({**SWEEP, **DEMOSAICERS, "precision": request.param})
    outcome = run(plan)
    assert not outcome.failed
    return plan, by_labels(plan, outcome.arrays)


def test_the_reference_has_every_stage_noise_and_both_probes(reference):
    plan, arrays = reference
    assert {node.name for node in plan.nodes} == {stage for (stage, _), _ in arrays}
    assert len(plan.cells) == len({key for key, _ in arrays})
    assert {plan.precision} == {str(a.dtype) for (_, variable), a in arrays.items() if variable not in ("raw",)}


@pytest.mark.parametrize(
    "options",
    [
        {"scheduler": "threads", "workers": 1},
        {"scheduler": "threads", "workers": 2},
        {"scheduler": "threads", "workers": 2, "batch_seconds": 0.0},
        {"scheduler": "processes", "workers": 2, "batch_seconds": 0.02},
        {"batch_seconds": 0.0},
        {"batch_seconds": float("inf")},
    ],
    ids=lambda o: "-".join(f"{v}" for v in o.values()),
)
def test_schedulers_workers_and_batches_change_no_bit(reference, options):
    plan, expected = reference
    outcome = run(plan, **options)
    assert not outcome.failed
    assert_same_arrays(by_labels(plan, outcome.arrays), expected)


def test_a_cell_alone_equals_that_cell_of_the_sweep(reference):
    plan, expected = reference
    alone = plan_of(
        {
            "camera.f_number": 5.6,
            "camera.pixel_pitch": "2.6 um",
            "camera.integration_time": "8 ms",
            "demosaic.use": "demosaic_nearest",
            "precision": plan.precision,
        }
    )
    at = {"f_number": 5.6, "pixel_pitch": 2.6, "integration_time": 0.008, "demosaic": "demosaic_nearest"}
    assert not alone.axes
    arrays = by_labels(alone, run(alone).arrays)
    for ((stage, _), variable), array in arrays.items():
        labels = tuple(sorted((dim, at[dim]) for dim in plan.node(stage).axes))
        assert_same_bits(array, expected[((stage, labels), variable)], (stage, variable))


@pytest.mark.parametrize("axis", ["sweep.f_number", "sweep.integration_time", "sweep.demosaic.use"])
def test_a_scalar_made_an_axis_of_one_value_changes_nothing(axis):
    value = {"sweep.f_number": 2.8, "sweep.integration_time": "10 ms", "sweep.demosaic.use": "demosaic_bilinear"}[axis]
    plain, swept = plan_of(), plan_of({axis: [value]})
    dims = (swept.axes[0].dim,)
    assert_same_arrays(by_labels(swept, run(swept).arrays, every=dims), by_labels(plain, run(plain).arrays))


def test_another_axis_beside_it_changes_no_bit_of_a_stage_it_does_not_reach():
    swept = plan_of({"sweep.integration_time": ["2 ms", "8 ms"]})
    plain = plan_of()
    light = {
        key: a
        for key, a in by_labels(plain, run(plain).arrays).items()
        if key[0][0] in ("scene", "diffusion", "pixel", "mosaic")
    }
    both = by_labels(swept, run(swept).arrays)
    assert_same_arrays({key: both[key] for key in light}, light)


@pytest.mark.parametrize(
    "keep", [["pixel"], ["pixel", "scene"], ["diffraction", "pixel"], ["diffusion"], ["demosaic", "resolution"]]
)
def test_what_is_kept_changes_no_bit_of_it(reference, keep):
    """Segments are fixed by the pipeline: storing a plane inside one does not cut it."""
    plan, expected = reference
    less = plan_of({**SWEEP, **DEMOSAICERS, "precision": plan.precision, "keep": keep})
    arrays = by_labels(less, run(less).arrays)
    assert {stage for (stage, _), _ in arrays} == set(keep)
    assert_same_arrays(arrays, {key: array for key, array in expected.items() if key in arrays})


@pytest.mark.parametrize("wanted", [["photon_rate"], ["diffraction.irradiance"], ["raw", "resolution"]])
def test_what_is_wanted_changes_no_bit_of_it(reference, wanted):
    plan, expected = reference
    less = plan_of(_reaching(wanted, plan.precision))
    arrays = by_labels(less, run(less).arrays)
    assert_same_arrays(arrays, {key: expected[key] for key in arrays})


def _reaching(wanted, precision):
    """Only the axes that something wanted depends on: others would be refused as axes of nothing."""
    reach = {"diffraction.irradiance": ("f_number",), "photon_rate": ("f_number", "pixel_pitch")}
    names = reach.get(wanted[0], ("f_number", "pixel_pitch", "integration_time"))
    return {f"sweep.{name}": SWEEP[f"sweep.{name}"] for name in names} | {"wanted": wanted, "precision": precision}


KEPT = {
    "all": None,
    "only planes inside the segment": ["scene", "diffraction", "diffusion"],
    "only the end of the segment": ["pixel"],
    "only the last variables": ["sharpen", "exposure_report", "resolution"],
}


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """An archive of what is kept, made once: (plan, folder)."""

    @cache
    def made(precision, kept):
        keep = {"keep": KEPT[kept]} if KEPT[kept] else {}
        plan = plan_of(
            {"sweep.f_number": [2, 5.6], "sweep.integration_time": ["2 ms", "8 ms"], "precision": precision, **keep}
        )
        folder = tmp_path_factory.mktemp("uninterrupted") / "whole"
        run(plan, folder)
        return plan, folder

    return made


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.long)])
@pytest.mark.parametrize("kept", KEPT)
@pytest.mark.parametrize("damage", ["journal", "chunks"])
def test_a_resumed_archive_equals_an_uninterrupted_one(uninterrupted, tmp_path, precision, kept, damage):
    plan, whole = uninterrupted(precision, kept)
    broken = tmp_path / "broken"
    shutil.copytree(whole, broken)
    lost = _lose(broken, damage, random.Random(f"{precision} {kept}"))
    again = run(plan, broken, scheduler="threads", workers=2, batch_seconds=0.0)
    assert 0 < again.computed < len(plan.cells) or kept != "all"
    assert {r.stage for r in again.reports.values() if r.status in ("done", "left_out")} >= lost
    assert_same_archives(broken, whole, frames=kept == "all")
    assert run(plan, broken).computed == 0


def _lose(archive, damage, chance):
    """Forget a third of what is finished; the stages that lost something."""
    if damage == "chunks":
        files = sorted(
            p
            for p in (archive / "data.zarr").rglob("c.*")
            if p.parent.name not in ("status",) and p.parent.parent.name not in ("ledger", "summary", "frames")
        )
        stages = set()
        for path in chance.sample(files, len(files) // 3):
            if not path.parent.name.endswith("_um"):
                stages.add(path.relative_to(archive / "data.zarr").parts[0])
                path.unlink()
        return stages
    lines = (archive / "journal.jsonl").read_text().splitlines()
    done = [i for i, line in enumerate(lines) if json.loads(line)["event"] == "done"]
    gone = set(chance.sample(done, len(done) // 3))
    (archive / "journal.jsonl").write_text("".join(line + "\n" for i, line in enumerate(lines) if i not in gone))
    return {json.loads(lines[i])["cell"].split(" ")[0] for i in gone}


def test_memory_and_archive_hold_the_same_tree(tmp_path):
    import numpy as np

    import etendue

    plan = plan_of({"sweep.f_number": [2, 5.6], "sweep.pixel_pitch": ["2.0 um", "2.6 um"]})
    memory = run(plan).tree
    run(plan, tmp_path / "a")
    with etendue.open_archive(tmp_path / "a") as stored:
        assert {n.path for n in stored.subtree} == {n.path for n in memory.subtree}
        for node in stored.subtree:
            other = memory[node.path].dataset
            assert set(node.dataset.variables) == set(other.variables), node.path
            for name, variable in node.dataset.variables.items():
                if name == "seconds" or node.path == "/summary":
                    continue
                assert variable.dims == other[name].dims, (node.path, name)
                mine, its = np.asarray(variable.values), np.asarray(other[name].values)
                if mine.dtype.kind in "OTU":
                    assert [str(v) for v in mine.ravel()] == [str(v) for v in its.ravel()], (node.path, name)
                else:
                    np.testing.assert_array_equal(mine, its, err_msg=f"{node.path}/{name}")


@pytest.mark.long
def test_a_cluster_gives_the_same_bits_in_memory_and_in_an_archive(tmp_path):
    distributed = pytest.importorskip("distributed")
    plan = plan_of(SWEEP)
    run(plan, tmp_path / "here")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        there = run(plan, scheduler=address, batch_seconds=0.01)
        run(plan, tmp_path / "there", scheduler=address, batch_seconds=0.0)
    assert_same_arrays(by_labels(plan, there.arrays), by_labels(plan, run(plan).arrays))
    assert_same_archives(tmp_path / "there", tmp_path / "here")


@pytest.mark.long
def test_workers_of_a_cluster_give_one_digest_per_array_whatever_their_number_kills_and_hash_seeds():
    pytest.importorskip("distributed")
    pytest.importorskip("cryptography")
    driver = Path(__file__).parents[2] / "benchmarks" / "identity.py"
    done = subprocess.run(
        [sys.executable, str(driver), "--only", "serial", "distributed"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr

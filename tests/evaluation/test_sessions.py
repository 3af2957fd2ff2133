"""A session gives the bits of a run, whatever changed since, in any thread, with any bound; and it plans what a run
plans.
"""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
import pytest

from etendue.builder.simulating import simulate
from etendue.compute import rows
from etendue.contract.registry import installed_stages
from etendue.errors import ArchiveError, PluginError, RequestError
from etendue.evaluation import archived
from etendue.evaluation.asking import overrides_of
from etendue.evaluation.remembering import MEMORY
from etendue.evaluation.results import BESIDE, Results
from etendue.evaluation.session import Session
from etendue.pipeline.file import overridden
from etendue.plan import cost
from etendue.plan.planner import make_plan, plan_again
from etendue.present.pictures import thumbnails
from etendue.session import load
from tests.documents.pages import ROOT
from tests.run.small import BARE, SWEEP, assert_same_bits, environment, plan_of, run

# One change at every place of the chain, and of every kind: of the scene, shared, of a stage, swapped, swept, global.
CHANGES = {
    "the scene": {"scene__white_luminance": "500 cd m-2"},
    "its grid": {"scene__spacing": "1.5 um"},
    "the lens": {"f_number": 4},
    "the pixel": {"pixel_pitch": "3 um"},
    "the frame": {"pixel__rows": 24},
    "the time": {"integration_time": "3 ms"},
    "the wells": {"full_well_density": "300 electron um-2"},
    "noise": {"read_noise": 9},
    "the converter": {"bits": 8},
    "sharpening": {"sharpen__strength": 0.3},
    "a stage": {"demosaic__use": "demosaic_nearest"},
    "an axis": {"f_number": [2, 8]},
    "two axes": {"f_number": [2, 8], "sharpen__strength": [0, 0.5]},
    "draws": {"seed": 8},
    "tolerance": {"tolerance": 1e-2},
    "nothing left out": {"leave_out": False},
    "precision": {"precision": "float64"},
    "two at once": {"f_number": 11, "sharpen__strength": 0.1},
    "nothing": {},
}


def file_of(changes):
    return overridden(load(BARE), overrides_of(changes)) if changes else load(BARE)


@cache
def alone(name):
    """The arrays of a run of one change, by stage and variable."""
    plan = make_plan(file_of(CHANGES[name]), installed_stages())
    return run(plan, pictures=False).tree


def assert_same_trees(one, other):
    assert {node.path for node in one.subtree} == {node.path for node in other.subtree}
    compared = 0
    for node in one.subtree:
        twin = other[node.path].dataset
        assert set(node.dataset.variables) == set(twin.variables), node.path
        for name, variable in node.dataset.variables.items():
            if name != "seconds" and node.path != "/summary":
                mine, its = variable.values, twin[name].values
                if mine.dtype.kind in "OT":
                    assert mine.tolist() == its.tolist(), (node.path, name)
                else:
                    assert_same_bits(mine, its, (node.path, name))
                compared += 1
    assert compared > 20


@pytest.fixture(scope="module")
def session():
    return Session(load(BARE))


@pytest.mark.parametrize("name", CHANGES)
def test_a_tree_is_that_of_a_run(session, name):
    assert_same_trees(session(**CHANGES[name]), alone(name))


@pytest.mark.parametrize("name", [*reversed(CHANGES)])
def test_a_tree_from_memory_is_that_of_a_run_in_any_order(session, name):
    assert_same_trees(session(**CHANGES[name]), alone(name))


@pytest.mark.parametrize("name", CHANGES)
def test_a_record_has_the_values_of_the_tree(session, name):
    names = ["exposure_report.clipped_fraction", "rgb_camera", "mtf50"]
    record = session.metrics(names, **CHANGES[name])
    tree = alone(name)
    assert list(record) == names
    places = {names[0]: "exposure_report", "rgb_camera": "sharpen", "mtf50": "resolution"}
    for text, stage in places.items():
        whole = tree[stage][text.rpartition(".")[2]].values
        assert np.array_equal(np.asarray(record[text]).reshape(whole.shape), whole), text
        assert np.asarray(record[text]).dtype == whole.dtype or whole.size == 1


@pytest.mark.parametrize("name", ["nothing", "nothing left out", "two axes"])
def test_every_variable_alone_is_that_of_the_tree(session, name):
    """Light within a segment, what is left out, and what only a look at stages gives are among them."""
    tree, names = alone(name), []
    for node in session.plan(None, CHANGES[name]).nodes:
        for variable in node.writes:
            names.append(f"{node.name}.{variable}")
            (found,) = session.metrics(names[-1], **CHANGES[name]).values()
            whole = tree[node.name][variable].values
            assert np.asarray(found).tobytes() == whole.tobytes() or (whole.size == 1 and found == whole), names[-1]
    assert len(names) > 20
    assert list(session.metrics(names, **CHANGES[name])) == names


def test_shapes_that_differ_along_an_axis_are_left_to_the_tree(session):
    with pytest.raises(
        RequestError, match="rgb_camera changes its shape along an axis of the sweep; call the session to get the tree"
    ):
        session.metrics("rgb_camera", pixel__rows=[24, 32])
    assert "24x32" in session(pixel__rows=[24, 32])["sharpen"].children


@pytest.mark.parametrize("most", [0, 20_000, 400_000])
def test_a_small_bound_changes_no_bit_and_is_kept(most):
    small = Session(load(BARE), bytes=most)
    for name in ("nothing", "noise", "the lens", "an axis", "noise"):
        assert_same_trees(small(**CHANGES[name]), alone(name))
        small.metrics("rgb_camera", **CHANGES[name])
        held = sum(array.nbytes for one in small.results._entries.values() for array in one.arrays.values())
        assert held <= small.bytes <= most


def computed(session, wanted, **values):
    """The stages of the cells that an evaluation computes."""
    from etendue.evaluation.evaluating import evaluate

    plan = session.plan(wanted, values)
    refs = {cell.ref: frozenset({variable}) for stage, variable in plan.wanted for cell in plan.of(stage)}
    return [report.stage for report in evaluate(plan, refs, session.results).computed]


def test_a_late_change_runs_late_stages_only():
    own = Session(load(BARE))
    order = [node.name for node in own.plan("rgb_camera", {}).nodes]
    assert set(computed(own, "rgb_camera")) == set(order)
    assert computed(own, "rgb_camera") in ([], [s for s in order if s in computed(own, "rgb_camera")])
    for change, first in (
        ({"sharpen__strength": 0.4}, "sharpen"),
        ({"read_noise": 3.5}, "read_noise"),
        ({"integration_time": "3 ms"}, "exposure"),
    ):
        later = set(order[order.index(first) :])
        once = computed(own, "rgb_camera", **change)
        assert first in once
        assert set(once) <= later
        assert set(computed(own, "rgb_camera", **change)) <= {"full_well"}  # what is left out is passed on


@pytest.mark.parametrize("name", CHANGES)
def test_a_plan_from_an_earlier_one_is_the_plan(name):
    pipeline, registry = file_of(CHANGES[name]), installed_stages()
    fresh = make_plan(pipeline, registry)
    for other in ("nothing", "noise", "the pixel", "an axis", name):
        before = make_plan(file_of(CHANGES[other]), registry)
        growths = [cell.growth for cell in before.cells.values()]
        again = plan_again(pipeline, registry, True, [before])
        assert again.cells == fresh.cells
        assert (again.nodes, again.axes, again.kept, again.precision) == (
            fresh.nodes,
            fresh.axes,
            fresh.kept,
            fresh.precision,
        )
        assert again.warnings == fresh.warnings
        assert [cell.growth for cell in before.cells.values()] == growths  # it is only read
    first, former = (one.cells[one.nodes[0].name, (0,) * len(one.nodes[0].axes)] for one in (again, before))
    assert first.stage is former.stage and first.facts is former.facts


def test_threads_give_the_same_bits():
    own = Session(load(BARE), bytes=300_000)  # so little that they push each other out
    names = [name for name in CHANGES if name not in ("its grid", "two axes")] * 2

    def both(name):
        return name, own(**CHANGES[name]), own.metrics("rgb_camera", **CHANGES[name])["rgb_camera"]

    with ThreadPoolExecutor(8) as pool:
        for name, tree, picture in pool.map(both, names):
            assert_same_trees(tree, alone(name))
            assert_same_bits(np.squeeze(picture), np.squeeze(alone(name)["sharpen"]["rgb_camera"].values), name)


@pytest.mark.parametrize(
    "bad",
    [
        {"f_number": -2},
        {"f_number": "2 kg"},
        {"sharpen__strenght": 1},
        {"sharpen__strength": "much"},
        {"nothing_of_the_kind": 1},
        {"pixel__rows": 2.5},
        {"pixel_pitch": "500 um"},
        {"demosaic__use": "demosaic_unknown"},
        {"f_number": []},
    ],
)
def test_a_bad_value_is_refused_as_by_a_run(session, bad):
    session.metrics("rgb_camera")
    with pytest.raises(RequestError) as own:
        session(**bad)
    with pytest.raises(RequestError) as runs:
        simulate(load(BARE), **bad)
    assert str(own.value) == str(runs.value)
    assert_same_trees(session(), alone("nothing"))  # and leaves nothing behind


def test_a_variable_that_nobody_writes_is_refused(session):
    with pytest.raises(RequestError, match="no stage of this pipeline writes 'mtf500'.*mtf50"):
        session.metrics(["mtf500"])


@pytest.mark.parametrize("large", ["frames", "light"])
def test_what_is_computed_piece_by_piece_is_the_same(monkeypatch, large):
    """Frames in strips, light by band: what is never whole is not kept, and read again from what is."""
    if large == "frames":
        monkeypatch.setattr(rows, "LARGEST_WHOLE", 0)
        monkeypatch.setattr(rows, "STRIP", 1)
        monkeypatch.setattr(rows, "TILE", 8)
    else:
        monkeypatch.setattr(cost, "LARGEST_WHOLE", 1000)
    own = Session(load(BARE))
    for name in ("nothing", "noise", "the lens", "sharpening", "noise"):
        record = own.metrics(["rgb_camera", "clipped_fraction"], **CHANGES[name])
        pipeline = overridden(file_of(CHANGES[name]), {"wanted": ["rgb_camera", "clipped_fraction"]})
        tree = run(make_plan(pipeline, installed_stages()), pictures=False).tree
        assert_same_bits(record["rgb_camera"], tree["sharpen"]["rgb_camera"].values, name)
        assert record["clipped_fraction"] == float(tree["exposure_report"]["clipped_fraction"])


def test_an_archive_of_another_platform_is_refused(tmp_path, monkeypatch):
    run(plan_of({"sweep.f_number": [2]}), tmp_path / "a", pictures=False)
    monkeypatch.setattr(archived, "platform_record", lambda: {"machine": "another"})
    with pytest.raises(ArchiveError, match="another platform, so bits may differ"):
        Session(load(BARE), archive=tmp_path / "a")


def test_an_archive_is_read_and_never_written(tmp_path):
    plan = plan_of(SWEEP)
    run(plan, tmp_path / "a", pictures=False)
    before = sorted((path, path.stat().st_mtime_ns) for path in (tmp_path / "a").rglob("*"))
    own = Session(load(BARE), archive=tmp_path / "a")
    at = {"f_number": 5.6, "pixel_pitch": "2 um", "integration_time": "8 ms"}
    assert set(computed(own, "rgb_camera", **at)) <= {"full_well"}
    fresh = Session(load(BARE))
    for change in (at, {**at, "read_noise": 7}, {**at, "f_number": 3}):
        assert_same_trees(own(**change), fresh(**change))
    assert before == sorted((path, path.stat().st_mtime_ns) for path in (tmp_path / "a").rglob("*"))


def test_a_damaged_chunk_of_an_archive_is_refused(tmp_path):
    run(plan_of({"sweep.f_number": [2]}), tmp_path / "a", pictures=False)
    (shard,) = (tmp_path / "a/data.zarr/sharpen/rgb_camera").glob("c*")
    data = bytearray(shard.read_bytes())
    data[len(data) // 3] ^= 1
    shard.write_bytes(data)
    with pytest.raises(ArchiveError, match="differ from what was written"):
        Session(load(BARE), archive=tmp_path / "a").metrics("rgb_camera", f_number=2)


def test_another_file_of_the_same_name_is_seen(tmp_path):
    table = tmp_path / "light.csv"

    def write(slope):
        table.write_text(
            "wavelength_nm,value\n" + "".join(f"{n},{1 + slope * (n - 380)}\n" for n in range(380, 781, 5))
        )

    own = Session(load(BARE))
    found = []
    for slope in (0.001, 0.01):
        write(slope)
        found.append(own.metrics("rgb_camera", illuminant=str(table))["rgb_camera"])
        fresh = Session(load(BARE)).metrics("rgb_camera", illuminant=str(table))["rgb_camera"]
        assert_same_bits(found[-1], fresh)
    assert not np.array_equal(*found)


# -- the store ---------------------------------------------------------------------------------------------------------


def test_the_least_recently_used_go_first():
    store = Results(3 * (BESIDE + 80))
    for name in "abc":
        store.put(name, None, {"x": np.arange(10.0)})
    store.used("a", None, {"x": store.seen("a").arrays["x"]})
    store.put("d", None, {"x": np.arange(10.0)})
    assert [name for name in "abcd" if store.seen(name)] == ["a", "c", "d"]
    store.put("e", None, {"x": np.arange(1000.0)})  # larger than all: it is not kept, and pushes nothing out
    assert [name for name in "abcde" if store.seen(name)] == ["a", "c", "d"]
    store.put("d", None, {"y": np.arange(10.0)})  # beside the first, which counts too
    assert set(store.seen("d").arrays) == {"x", "y"}
    assert store.bytes == 2 * BESIDE + 240 <= store.most
    store.clear()
    assert (len(store), store.bytes) == (0, 0)


def test_what_is_kept_cannot_be_changed_and_holds_no_more_than_itself():
    store, whole = Results(1 << 20), np.arange(1000.0)
    store.put("a", None, {"x": whole[:10]})
    whole[:] = 7
    kept = store.seen("a").arrays["x"]
    assert kept.tolist() == list(range(10))
    assert not kept.flags.writeable
    assert kept.base is None


# -- simulate in a loop ------------------------------------------------------------------------------------------------


@pytest.fixture
def memory():
    MEMORY.clear(64 << 20)
    yield MEMORY
    MEMORY.clear(0)


def test_simulate_in_a_loop_gives_the_same_trees_and_keeps_results(memory):
    for name in ("nothing", "noise", "the lens", "an axis", "noise"):
        tree = simulate(load(BARE), errors=False, **CHANGES[name])
        held = len(memory.results)
        assert held
        again = simulate(load(BARE), errors=False, **CHANGES[name])
        assert len(memory.results) == held
        bare = tree.to_dict()
        assert bare.keys() == again.to_dict().keys()
        for path, group in alone(name).to_dict().items():
            for variable in group.data_vars:
                if path not in ("/ledger", "/summary"):
                    assert_same_bits(bare[path][variable].values, group[variable].values, (path, variable))
    assert memory.results.bytes <= memory.results.most
    tree["sharpen"]["rgb_camera"].values[:] = 0  # a tree is the caller's
    assert float(abs(simulate(load(BARE), errors=False, **CHANGES["noise"])["sharpen"]["rgb_camera"]).max()) > 0


def test_a_loop_reduces_only_pictures_that_changed(memory, monkeypatch):
    reduced = []
    own = thumbnails.View.of
    monkeypatch.setattr(thumbnails.View, "of", lambda view, array: reduced.append(array.ndim) or own(view, array))
    simulate(load(BARE), errors=False, read_noise=9)
    whole = len(reduced)
    reduced.clear()
    later = simulate(load(BARE), errors=False, sharpen__strength=0.3, read_noise=9)
    assert 0 < len(reduced) < whole
    assert len(reduced) == len({"sharpen", "camera_to_xyz", "balance", "display", "encode"} & set(later.children))
    memory.clear(64 << 20)
    anew = simulate(load(BARE), errors=False, sharpen__strength=0.3, read_noise=9)
    assert len(anew["frames"].data_vars) > 1
    for name, one in anew["frames"].data_vars.items():
        assert_same_bits(one.values, later["frames"][name].values, name)


def test_a_stage_that_fails_is_named_and_its_result_is_not_kept(monkeypatch):
    own, kind = Session(load(BARE)), installed_stages().load("demosaic_bilinear")
    expected = own.metrics("rgb_camera", read_noise=6)["rgb_camera"]
    own.clear()

    def broken(self, **given):
        raise ArithmeticError("not today")

    with monkeypatch.context() as patched:
        patched.setattr(kind, "run", broken)
        for ask in (lambda: own(read_noise=6), lambda: own.metrics("rgb_camera", read_noise=6)):
            with pytest.raises(PluginError, match=r"(?s)1 cells failed; the first: demosaic .*not today"):
                ask()
    assert_same_bits(own.metrics("rgb_camera", read_noise=6)["rgb_camera"], expected)


ROUNDS = """
import resource
from etendue.evaluation.session import Session
from etendue.session import load
from tests.run.small import BARE

def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()

own, early = Session(load(BARE), bytes=2_000_000), 0
for n in range(400):
    own.metrics(["rgb_camera", "mtf50"], f_number=2 + n / 400, read_noise=1 + n / 400)
    early = resident() if n == 99 else early
print(resident() / early)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.long
def test_memory_does_not_grow_with_evaluations():
    """Within 1.1 times of what it is after 100, of which a tenth is more than the bound on results."""
    done = subprocess.run([sys.executable, "-c", ROUNDS], cwd=ROOT, env=environment(), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) < 1.1

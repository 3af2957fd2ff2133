"""A design shares, stores, extends and resumes like a grid, and computes what a grid would at the same values."""

from __future__ import annotations

import shlex
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
import xarray

from etendue.cli.options import Given, overrides
from etendue.errors import ArchiveError, RequestError
from etendue.plan.designs.asked import factors_of
from etendue.plan.designs.told import design_lines
from etendue.plan.planner import summary
from etendue.present.terminal.outcome import replay
from etendue.session import Options
from etendue_camera.export.frames import Shelf, chosen
from tests.archive.tiny import store_of
from tests.designs.given import DESIGN, SERIAL, STAGES, plan_of, ran
from tests.run.small import assert_same_archives, command

FACTORS = {"f_number", "read_noise", "pixel_pitch"}


def group(tree, stage):
    """The dataset of a stage, whose arrays are in one group for each shape if an axis moves its grid."""
    node = tree[stage]
    return (node if node.data_vars else next(iter(node.children.values()))).to_dataset(inherit=False)


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("design") / "a"
    ran(folder)
    return folder


def test_a_stage_is_computed_once_for_each_combination_that_reaches_it():
    plan = plan_of({"design.points": 64})
    count = {node.name: len(plan.of(node.name)) for node in plan.nodes}
    assert count["irradiance"] == count["lens_numbers"] == 3  # levels of the f-number
    assert count["pixel"] == count["shot_noise"] == 3 * 2
    assert count["read_noise"] == 64
    free = plan_of({"design.points": 64, "design.factors.f_number": {"from": 2, "to": 8}})
    assert len(free.of("irradiance")) == 64


def test_a_sample_is_the_cell_of_a_grid_at_the_same_values():
    """Keys hold parameters and inputs: equal keys, equal bits."""
    plan = plan_of()
    sample = plan.axis("sample")
    for row in (0, 5):
        values = {factor.key: sample.column(n)[row] for n, factor in enumerate(sample.factors)}
        grid = plan_of({f"sweep.{key}": [value] for key, value in values.items()}, STAGES)
        at = plan.everywhere({"sample": row})
        for node in plan.nodes:
            cell = plan.cells[node.name, tuple(at[dim] for dim in node.axes)]
            assert cell.key == grid.of(node.name)[0].key, node.name


@pytest.mark.parametrize("method", ["sobol", "halton", "random", "saltelli"])
def test_a_longer_design_begins_with_the_shorter_one(method):
    few, many = (plan_of({"design.method": method, "design.points": points}) for points in (5, 12))
    keys = {f"{ref[0]} {few.labels(ref)}": cell.key for ref, cell in few.cells.items()}
    longer = {f"{ref[0]} {many.labels(ref)}": cell.key for ref, cell in many.cells.items()}
    assert keys.items() <= longer.items()
    assert len(many.axis("sample").values) == 12 * (5 if method == "saltelli" else 1)


def test_points_of_saltelli_differ_in_one_factor_and_share_the_rest():
    plan = plan_of({"design.method": "saltelli", "design.factors.f_number": {"from": 2, "to": 8}})
    whole = plan.axis("sample")
    rows = np.array([[one for one in row] for row in whole.rows]).reshape(8, 5, 3)
    for factor in range(3):
        others = [n for n in range(3) if n != factor]
        assert (rows[:, 2 + factor, others] == rows[:, 0, others]).all()
        assert (rows[:, 2 + factor, factor] == rows[:, 1, factor]).all()
    assert len(plan.of("irradiance")) == 2 * 8  # the f-number of A and of B


def test_an_archive_has_plain_coordinates_for_every_factor(archive):
    with xarray.open_datatree(archive / "data.zarr", engine="zarr") as tree:
        last, first = group(tree, "read_noise"), group(tree, "irradiance")
        assert {"sample", *FACTORS} <= set(last.coords)
        assert all(last[name].dims == ("sample",) for name in FACTORS)
        assert last["read_noise"].attrs["units"] == "electron"
        assert first["irradiance"].sizes["sample_f_number"] == len(set(first["f_number"].values)) == 3
        whole = first["irradiance"].sel(sample_f_number=first["sample_f_number_row"])
        assert whole.dims[0] == "sample"
        assert (whole["f_number"].values == last["f_number"].values).all()
        assert all(index.nlevels == 1 for one in tree.subtree for index in one.indexes.values())


def test_memory_gives_what_an_archive_gives(archive):
    made = ran(None).tree
    with xarray.open_datatree(archive / "data.zarr", engine="zarr") as tree:
        for stage in ("irradiance", "pixel", "read_noise", "lens_numbers"):
            own, stored = group(made, stage), group(tree, stage)
            assert set(own.coords) == set(stored.coords)
            xarray.testing.assert_identical(own.load(), stored.load()[list(own.data_vars)])


def test_an_extended_design_equals_one_drawn_at_once(archive, tmp_path):
    grown = tmp_path / "grown"
    ran(grown)
    outcome = ran(grown, {"design.points": 16})
    at_once, few = plan_of({"design.points": 16}), plan_of()
    assert outcome.computed == len(at_once.cells) - len(few.cells)
    ran(tmp_path / "once", {"design.points": 16})
    assert_same_archives(grown, tmp_path / "once")
    again = ran(grown)  # the shorter design is in the longer one
    assert again.computed == 0
    with xarray.open_datatree(grown / "data.zarr", engine="zarr") as tree:
        assert group(tree, "read_noise").sizes["sample"] == 16


def test_some_rows_first_and_the_rest_later(archive, tmp_path):
    ran(tmp_path / "a", {"design.rows": [5, 2]})
    ran(tmp_path / "a")
    with (
        xarray.open_datatree(tmp_path / "a" / "data.zarr", engine="zarr") as own,
        xarray.open_datatree(archive / "data.zarr", engine="zarr") as whole,
    ):
        for stage in ("irradiance", "pixel", "read_noise"):
            one, other = group(own, stage).load(), group(whole, stage).load()
            dim = next(str(name) for name in one["status"].dims)
            xarray.testing.assert_equal(one.sortby(dim).sortby("sample"), other.sortby(dim).sortby("sample"))


def test_threads_give_what_one_thread_gives(archive, tmp_path):
    ran(tmp_path / "threads", options=Options("threads", 2, pictures=False))
    assert_same_archives(archive, tmp_path / "threads")
    assert store_of(archive).keys() == store_of(tmp_path / "threads").keys()


def test_a_latin_hypercube_cannot_be_extended(tmp_path):
    ran(tmp_path / "a", {"design.method": "lhs"})
    with pytest.raises(ArchiveError, match="every row would change"):
        ran(tmp_path / "a", {"design.method": "lhs", "design.points": 9})
    assert ran(tmp_path / "a", {"design.method": "lhs"}).computed == 0


def test_another_seed_is_another_design(tmp_path):
    ran(tmp_path / "a")
    assert ran(tmp_path / "a", {"design.seed": 4}).computed > 0
    ran(tmp_path / "b", {"design.seed": 4})
    with (
        xarray.open_datatree(tmp_path / "a" / "data.zarr", engine="zarr") as own,
        xarray.open_datatree(tmp_path / "b" / "data.zarr", engine="zarr") as other,
    ):
        xarray.testing.assert_identical(group(own, "read_noise").load(), group(other, "read_noise").load())


def test_a_list_of_samples_of_ones_own(tmp_path):
    (tmp_path / "mine.csv").write_text("f_number,pixel_pitch\n2,3 um\n4,3 um\n2,4000 nm\n")
    over = {"design": {"method": "list", "file": str(tmp_path / "mine.csv")}}
    plan = plan_of(over, STAGES)
    assert [len(plan.of(name)) for name in ("irradiance", "pixel")] == [2, 3]
    ran(tmp_path / "a", over, STAGES)
    (tmp_path / "mine.csv").write_text("f_number,pixel_pitch\n2,3 um\n4,3 um\n2,4000 nm\n8,4 um\n")
    assert ran(tmp_path / "a", over, STAGES).computed == 2 + 5  # what one factor reaches, and what both do


def test_axes_of_one_dim_are_zipped_and_others_multiply(tmp_path):
    sweep = {
        "sweep.f_number": {"values": [2, 4, 2], "dim": "shot"},
        "sweep.integration_time": {"values": ["1 ms", "4 ms", "8 ms"], "dim": "shot"},
        "sweep.pixel_pitch": ["3 um", "4 um"],
    }
    plan = plan_of(sweep, STAGES)
    assert [axis.dim for axis in plan.axes] == ["shot", "pixel_pitch"]
    assert {node.name: node.axes for node in plan.nodes}["exposure"] == ("shot", "pixel_pitch")
    assert len(plan.of("irradiance")) == 2
    ran(tmp_path / "a", sweep, STAGES)
    with xarray.open_datatree(tmp_path / "a" / "data.zarr", engine="zarr") as tree:
        own = group(tree, "exposure")
        assert own["integration_time"].dims == own["f_number"].dims == ("shot",)
        assert own["f_number"].values.tolist() == [2, 4, 2]
    grid = plan_of({"sweep.f_number": [2], "sweep.integration_time": ["8 ms"], "sweep.pixel_pitch": ["4 um"]}, STAGES)
    assert plan.cells["exposure", (2, 1)].key == grid.of("exposure")[0].key


@pytest.mark.parametrize("command_line", ["verify", "reproduce", "show"])
def test_commands_of_an_archive_take_a_design(archive, command_line):
    assert command(command_line, archive).returncode == 0


def test_designs_are_compared_and_reported(archive, tmp_path):
    ran(tmp_path / "b")
    assert command("diff", archive, tmp_path / "b").returncode == 0
    assert command("report", archive, "-o", tmp_path / "report.html").returncode == 0
    assert command("compact", tmp_path / "b", tmp_path / "c").returncode == 0
    assert_same_archives(archive, tmp_path / "c")


FAULTS = {
    "unknown method": ({"design.method": "sobl"}, "did you mean 'sobol'"),
    "no points": ({"design.points": 0}, "whole number of at least 1"),
    "unknown key": ({"design.point": 8}, "did you mean 'points'"),
    "unknown factor": ({"design.factors.f_nummber": {"from": 1, "to": 2}}, "did you mean 'f_number'"),
    "negative": ({"design.factors.read_noise": {"normal": [3, 0.5]}}, "give at_least"),
    "two shapes": ({"design.factors.read_noise": {"normal": [3, 0.3], "uniform": [1, 2]}}, "expected one of"),
    "falling": ({"design.factors.f_number": {"from": 8, "to": 2}}, "ascending numbers"),
    "unit": ({"design.factors.f_number": {"from": "1 um", "to": 2}}, "um"),
    "log of 0": ({"design.factors.read_noise": {"from": 0, "to": 2, "spacing": "log"}}, "above 0"),
    "words": ({"design.factors.back": {"from": 0, "to": 2}}, "list of choices"),
    "an axis too": ({"sweep": {"read_noise": [1, 2]}}, "axis of"),
    "correlation": ({"design.correlation": [["f_number", "pitch", 0.5]]}, "the factors are"),
    "too correlated": (
        {
            "design.correlation": [
                ["f_number", "read_noise", 0.9],
                ["f_number", "pixel_pitch", 0.9],
                ["read_noise", "pixel_pitch", -0.9],
            ]
        },
        "at once",
    ),
    "saltelli": (
        {"design.method": "saltelli", "design.correlation": [["f_number", "read_noise", 0.5]]},
        "independent",
    ),
    "no file": ({"design.method": "list"}, "name of a CSV file"),
    "rows": ({"design.rows": [-1]}, "numbers of rows"),
    "lengths": (
        {
            "sweep.integration_time": {"values": [1, 2], "dim": "shot"},
            "sweep.back": {"values": ["absorbing"], "dim": "shot"},
        },
        "2 values and back has 1",
    ),
    "the dim of designs": ({"sweep.integration_time": {"values": [1, 2], "dim": "sample"}}, "dim of"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_says_what_was_expected(name):
    over, text = FAULTS[name]
    with pytest.raises(RequestError, match=text.replace("[", r"\[")):
        plan_of(over)


def test_a_failed_cell_can_be_run_alone():
    """The command that a run prints asks for the row, in words that the command line reads."""
    plan = plan_of({"design.points": 6, "design.factors.f_number": {"from": 2, "to": 8, "levels": 3}})
    for ref in (("read_noise", (5,)), ("pixel", (2,)), ("scene", ())):
        words = shlex.split(replay(plan, ref))
        given = Given(Path(), tuple(words[n + 1] for n, word in enumerate(words) if word == "--set"))
        alone = plan_of(overrides(given))
        assert [cell.key for cell in alone.of(ref[0])] == [plan.cells[ref].key]


def test_what_nothing_depends_on_is_told():
    plan = plan_of({"wanted": ["irradiance"]})
    assert any("sweep.read_noise is not swept" in text for text in plan.warnings)
    assert len(plan.cells) == 1 + 3  # the scene, and light at every level


def test_an_axis_in_place_of_a_factor_and_a_factor_in_place_of_an_axis():
    plan = plan_of({"sweep.read_noise": [1, 2]})
    assert [axis.key for axis in plan.axes] == ["sample", "read_noise"]
    swept = STAGES + "\n[sweep]\nf_number = [2, 4]\n"
    plan = plan_of({"design.points": 4, "design.factors.f_number": {"from": 2, "to": 4}}, swept)
    assert [axis.key for axis in plan.axes] == ["sample"]


def test_a_design_is_drawn_alike_in_every_place(archive):
    """From the file, and from the record of the run in the archive."""
    from etendue.archive.records.rerun import recorded
    from etendue.contract.registry import installed_stages
    from etendue.plan.planner import make_plan

    again = make_plan(recorded(archive).pipeline(), installed_stages())
    assert {cell.key for cell in again.cells.values()} == {cell.key for cell in plan_of().cells.values()}
    assert SERIAL.scheduler == "serial" and "points = 8" in DESIGN


def test_a_design_for_indices_sets_common_noise_unless_the_pipeline_says_otherwise():
    """Two of its rows differ by their factors alone; the plan says so, and nothing changes for other designs."""
    over = {"design.method": "saltelli", "design.points": 2}
    plan = plan_of(over)
    keys = {ref: cell.key for ref, cell in plan.cells.items()}
    assert {ref: cell.key for ref, cell in plan_of({**over, "camera.noise": "common"}).cells.items()} == keys
    assert plan_of({**over, "camera.noise": "independent"}).cells["read_noise", (0,)].key not in keys.values()
    assert summary(plan)["design"]["compared"] == {"noise": "common"}
    assert any("noise = common in all rows" in line for line in design_lines(summary(plan)))
    assert "noise" not in plan_of().pipeline.shared


@pytest.mark.parametrize(
    ("over", "factors"),
    [
        ({"design.factors.f_number.levels": 2}, {"f_number": {"from": 2, "to": 8, "spacing": "log", "levels": 2}}),
        ({"design.factors.camera.f_number.to": 4}, {"f_number": {"from": 2, "to": 4, "spacing": "log", "levels": 3}}),
        (
            {"design.factors.read_noise.at_most": 3.2},
            {"read_noise": {"normal": ["3 electron", Decimal("0.3")], "at_least": 0, "at_most": 3.2}},
        ),
        (
            {
                "design.factors.dark_current_density": {"from": 1e-10, "to": 3e-10},
                "design.factors.dark_current_density.levels": 2,
            },
            {"dark_current_density": {"from": 1e-10, "to": 3e-10, "levels": 2}},
        ),
    ],
)
def test_one_word_of_a_factor_can_be_set(over, factors):
    own, before = (factors_of(plan_of(one).pipeline.design, plan_of().pipeline) for one in (over, {}))
    assert own == before | factors
    assert own != before


def test_a_picture_is_exported_by_the_sample_or_its_combination_of_factors(archive, tmp_path):
    """A stage that f_number and pixel_pitch reach has six combinations; each of eight rows names one of them."""
    shelf = Shelf(archive)
    rows = shelf.groups("photocurrent", "mosaic")[0].data
    dim = next(str(dim) for dim in rows["photocurrent"].dims if str(dim).startswith("sample_"))
    assert not {"f_number", "pixel_pitch", f"{dim}_row"} & set(shelf.variables)  # coordinates are not variables
    frames = shelf.frames("photocurrent", "mosaic")
    for row, combination in enumerate(rows[f"{dim}_row"].values.tolist()):
        (by_row,) = chosen(frames, {"sample": str(row)})
        (by_combination,) = chosen(frames, {dim: str(combination)})
        assert by_row.labels == by_combination.labels
        assert shelf.white(by_row) > 0
        assert shelf.parameter(by_row, "f_number") == rows["f_number"].sel({dim: combination}).item()
    with pytest.raises(RequestError, match="no such row; sample is 0, 1"):
        chosen(frames, {"sample": "8"})
    done = command(
        "export", archive, "--png", "--variable", "photocurrent", "--at", "sample=3", "-o", tmp_path / "a.png"
    )
    assert done.returncode == 0 and (tmp_path / "a.png").stat().st_size

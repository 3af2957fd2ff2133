"""Camera quantities that an earlier stage writes: known while the run goes on, and what a plan makes of them before."""

from dataclasses import dataclass
from types import ModuleType, SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

import etendue
from etendue.api import Bounded, Facts, Source, Stage, Transfer, ends, hookimpl, quantity
from etendue.compute.cell import compute
from etendue.compute.jobs import make_jobs
from etendue.compute.joined.segments import Result
from etendue.contract.arrays.grid import Bands, Grid, Line
from etendue.contract.registry import Registry
from etendue.contract.values.late_bound import LateValue, NotKnown
from etendue.errors import RequestError
from etendue.pipeline.file import parse_pipeline
from etendue.plan.planner import make_plan, summary
from etendue.plugins.discovery import Discovery
from tests.distributions import distribution

LIGHT = "wavelength y x [W m-2 nm-1]"
GRID = Grid.of({"wavelength": Bands((500.0, 510.0)), "y": Line(6, 0.0, 1.0), "x": Line(8, 0.0, 1.0)})


@dataclass(frozen=True, kw_only=True)
class Lamp(Source):
    writes: ClassVar = {"irradiance": LIGHT}

    def describe(self):
        return Facts(low=1.0, high=1.0, contrast=1.0, uniform=True), {"irradiance": GRID}

    def run(self, y, x, rng):
        return {"irradiance": 1 + rng.random((1, y.size, x.size))}


@dataclass(frozen=True, kw_only=True)
class Iris(Stage):
    """An aperture that follows the light, between f/2 and f/16."""

    reads: ClassVar = {"irradiance": LIGHT}
    writes: ClassVar = {"f_number": "[1]"}

    def carry(self, facts, grid):
        return Facts(low=2.0, high=16.0)

    def run(self, irradiance):
        return {"f_number": np.array(4.0 * irradiance.mean())}


@dataclass(frozen=True, kw_only=True)
class Dimmer(Bounded):
    reads: ClassVar = {"irradiance": LIGHT}
    writes: ClassVar = {"irradiance": LIGHT}

    f_number: float = quantity("f_number")

    def run(self, irradiance):
        return {"irradiance": irradiance / self.f_number**2}

    def negligible(self, facts, grid):
        return (0.0, "wide open") if self.f_number < 1 else None

    def carry(self, facts, grid):
        low, high = ends(self.f_number)
        return Facts(low=1 / high**2, high=1 / low**2)

    def error(self, facts, grid, precision):
        return 1e-6 * self.f_number, "proved"

    def warn(self, facts, grids):
        return [f"at f/{self.f_number:g}"]


@dataclass(frozen=True, kw_only=True)
class Blur(Transfer):
    reads: ClassVar = {"irradiance": LIGHT}
    writes: ClassVar = {"irradiance": LIGHT}

    f_number: float = quantity("f_number")

    def transfer(self, fy, fx, wavelength):
        return np.exp(-self.f_number * (fy**2 + fx**2))[None]


@dataclass(frozen=True, kw_only=True)
class Sized(Dimmer):
    """Its grid depends on what is found."""

    def grid(self, inputs):
        return {"irradiance": inputs["irradiance"].replace(y=Line(int(self.f_number), 0.0, 1.0))}


def registry(**stages):
    manifest = ModuleType("finding")
    manifest.etendue_stages = hookimpl(lambda: stages)
    point = SimpleNamespace(name="finding", value="finding", dist=distribution("finding"), load=lambda: manifest)
    return Registry(Discovery([point]))


KINDS = {"lamp": Lamp, "iris": Iris, "dimmer": Dimmer, "blur": Blur, "sized": Sized}


def plan_of(*uses, head="", tail=""):
    text = f"{head}\n" + "".join(f'[[stages]]\nuse = "{use}"\n' for use in uses) + tail
    return make_plan(parse_pipeline(text), registry(**KINDS))


def arrays_of(plan):
    """Every cell's arrays, computed in order."""
    results = {}
    for ref, job in make_jobs(plan, set(plan.cells), lambda cell: None, deliver_all=True).items():
        results[ref], report = compute(job, results)
        assert report.status in ("done", "left_out"), report.message
    return {ref[0]: result.arrays for ref, result in results.items() if isinstance(result, Result)}


def test_while_planning_a_found_quantity_is_an_interval_and_nothing_is_claimed_of_it():
    plan = plan_of("lamp", "iris", "dimmer")
    (cell,) = plan.of("dimmer")
    assert cell.stage.f_number == LateValue("f_number", 2.0, 16.0)
    assert (cell.facts.low, cell.facts.high) == (1 / 256, 1 / 4)  # what can be said of an interval
    assert cell.left_out is None
    assert cell.error == (None, "unknown")
    assert not [text for text in plan.warnings if "at f/" in text]
    (told,) = [stage for stage in summary(plan)["stages"] if stage["name"] == "dimmer"]
    assert told["found"] == {"f_number": "iris"}


@pytest.mark.parametrize("use", ["dimmer", "blur"])
def test_found_is_fixed_bit_for_bit_for_arrays_and_for_transfer_functions(use):
    found = arrays_of(plan_of("lamp", "iris", use))
    value = float(found["iris"]["f_number"])
    fixed = arrays_of(plan_of("lamp", use, head=f"[camera]\nf_number = {value!r}"))
    assert found[use]["irradiance"].tobytes() == fixed[use]["irradiance"].tobytes()


def test_a_grid_that_depends_on_what_is_found_is_a_fault_of_the_plan():
    with pytest.raises(
        RequestError, match=r"sized of finding 1\.0: Sized\.grid depends on f_number, which an earlier stage finds"
    ):
        plan_of("lamp", "iris", "sized")


def test_from_names_the_stage_that_finds_a_quantity_too():
    tail = '[[stages]]\nuse = "dimmer"\nname = "second"\nfrom = { f_number = "iris" }\n'
    plan = plan_of("lamp", "iris", "dimmer", tail=tail)
    assert plan.node("second").found == {"f_number": "iris"}
    with pytest.raises(RequestError, match="'lamp' writes irradiance, not f_number"):
        plan_of("lamp", "iris", tail=tail.replace('"iris"', '"lamp"'))


@pytest.mark.parametrize(
    "use",
    [float, int, bool, round, abs, str.format, lambda f: f + 1, lambda f: 2 / f, lambda f: f < 3, np.sqrt, np.asarray],
)
def test_who_reckons_with_what_is_not_known_is_stopped(use):
    found = LateValue("f_number", 2.0, 16.0)
    with pytest.raises(NotKnown):
        format(found, "g") if use is str.format else use(found)


def test_an_optional_variable_that_is_only_kept_is_told_to_be_wanted():
    document = {
        "camera": {"peak_qe": [0.4, 0.5, 0.4]},
        "keep": ["mtf50_gain"],
        "stages": [
            {
                "use": "slanted_edge",
                "name": "scene",
                "white_luminance": 100,
                "width": 100,
                "height": 100,
                "bin_width": 100,
            },
            {"use": "irradiance"},
            {"use": "pixel", "rows": 8, "columns": 8},
            {"use": "mosaic"},
            {"use": "ideal_mosaic"},
            {"use": "demosaic_bilinear"},
            {"use": "sharpen"},
        ],
    }
    with pytest.raises(RequestError, match="mtf50_gain is optional: request it under 'wanted'"):
        etendue.simulate(document)

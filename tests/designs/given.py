"""A camera of a few pixels with a design, and ways to run it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray

from etendue.contract.registry import installed_stages
from etendue.contract.values.parameter import Parameter
from etendue.pipeline.file import parse_pipeline
from etendue.plan.designs.asked import Asked
from etendue.plan.designs.distributions import distribution_of
from etendue.plan.designs.points import unit_points
from etendue.plan.planner import make_plan
from etendue.present.plots.holdings import Holdings
from etendue.session import Options, execute
from etendue_lab.designs.samples import Factor, Samples

STAGES = """
name = "tiny"

[camera]
pixel_pitch = "3 um"
peak_qe = [0.36, 0.44, 0.40]
integration_time = "4 ms"

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
use = "pixel"
rows = 4
columns = 4
[[stages]]
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "read_noise"
[[stages]]
use = "lens_numbers"
"""
DESIGN = """
[design]
points = 8
seed = 3
[design.factors]
f_number = { from = 2, to = 8, spacing = "log", levels = 3 }
read_noise = { normal = ["3 electron", 0.3], at_least = 0 }
pixel_pitch = ["3 um", "4 um"]
"""
SERIAL = Options("serial", pictures=False)


def plan_of(over=None, text=STAGES + DESIGN):
    return make_plan(parse_pipeline(text, overrides=over or {}), installed_stages())


def ran(archive: Path | None, over=None, text=STAGES + DESIGN, options=SERIAL):
    outcome = execute(plan_of(over, text), archive, options)
    assert not outcome.failed
    return outcome


def samples(function, method, points, seed, factors, correlated=()):
    """Samples of a function of numbers, as if a run had stored it: ``factors`` as a file writes them."""
    of = {key: distribution_of(own, Parameter(), float, Path()) for key, own in factors.items()}
    asked = Asked(method, points, seed, factors, correlated)
    shares = unit_points(method, points, len(of), seed, correlated)
    columns = [np.array([one.quantile(u) for u in shares[:, n]]) for n, one in enumerate(of.values())]
    rows = np.arange(len(shares))
    data = {name: ("sample", values) for name, values in function(*columns).items()}
    data["status"] = ("sample", np.zeros(len(rows), np.uint8))
    tree = xarray.DataTree(xarray.Dataset(attrs={"pipeline": "made"}))
    tree["found"] = xarray.DataTree(xarray.Dataset(data, {"sample": rows}, {"order": 1}))
    made = [Factor(key, key, "1", values, one) for (key, one), values in zip(of.items(), columns, strict=True)]
    return Samples("made", tuple(map(int, rows)), tuple(made), asked, Holdings(tree))

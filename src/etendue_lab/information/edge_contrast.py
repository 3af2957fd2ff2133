"""Contrast of fine detail from a slanted edge, in any picture of a camera, without noise.

In:  a camera viewing a grey card, the pictures to measure.
Out: by picture and channel the response across the edge at given frequencies, cycles/pixel.

The picture of the edge is divided by that of a uniform field, which removes fall-off. The blur with which the edge is
rendered is divided out too.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from etendue.contract.registry import Registry
from etendue.pipeline.derived import wanting
from etendue.plan.model import Plan, StageVariable
from etendue.plan.planner import make_plan
from etendue.session import Options, collect
from etendue.types.arrays import Array
from etendue.types.documents import Document
from etendue_camera.resolution.edges.slanted_edge import slanted_edge
from etendue_camera.sensor import cfa
from etendue_lab.compare.edge import ANGLE, edge_and_field
from etendue_lab.compare.figures import BORDER
from etendue_lab.information.fine_detail import FineDetail
from etendue_lab.noise.flat_field import MOSAIC

SAMPLES = 129  # of the edge's response up to 1 cycle/pixel


def edge_contrast(
    detail: FineDetail,
    places: list[StageVariable],
    white: float,
    frequency: Array,
    registry: Registry,
    options: Options | None = None,
) -> dict[StageVariable, Document]:
    """Return, by picture and channel, the contrast at the given frequencies along the normal of a slanted edge; the
    normal is `ANGLE` degrees from x.

    ``white``: the largest value of a white surface in units of pixel saturation; the edge is drawn so that it stays
    below saturation.

    Raises
    ------
    ValueError
        There is no single scene to replace, a stage failed, or no edge is visible.
    """
    base, _, sigma = edge_and_field(detail.pipeline, detail.plan.nodes, detail.plan, white, registry)
    plan = make_plan(wanting(base, places, exact=True), registry, leave_out_allowed=False)
    refs = {(s, i): (s, (i,) if plan.node(s).axes else ()) for s, _ in places for i in (0, 1)}
    arrays = collect(
        plan, {refs[s, i]: tuple(v for t, v in places if t == s) for s, v in places for i in (0, 1)}, options
    )
    failed = next((r for r in arrays.reports.values() if r.status == "failed"), None)
    if failed is not None:
        raise ValueError(f"stage {failed.stage!r} failed on the slanted edge: {failed.message.splitlines()[-1]}")
    own = np.exp(-2 * (math.pi * sigma / detail.pitch * frequency) ** 2)
    found: dict[StageVariable, Document] = {}
    for place in places:
        edge, field = (np.asarray(arrays.arrays[refs[place[0], i]][place[1]], np.float64) for i in (0, 1))
        if not (np.isfinite(field).all() and (field > 0).all()):
            raise ValueError(
                f"{place[0]} leaves parts of a uniform field without light; remove it or reduce its effect"
            )
        inside = (..., _rows(edge.shape[-2], detail.mask.shape[0]), slice(BORDER, -BORDER))
        if place[1] == MOSAIC:
            sites = {c: _sites(plan, place, c)[inside] for c in detail.channels}
            picture = (edge / field)[inside]
            found[place] = {c: _response(picture, frequency, own, None if s.all() else s) for c, s in sites.items()}
            continue
        names = detail.names_of(place)
        found[place] = {
            name: _response((edge[i] / field[i])[inside], frequency, own, None) for i, name in enumerate(names)
        }
    return found


def _sites(plan: Plan, place: StageVariable, channel: str) -> Any:
    """Return a mask (y, x) of the pixels of a channel, in the window that shows the edge."""
    node = plan.node(place[0])
    grid = plan.cells[node.name, (0,) * len(node.axes)].grids[MOSAIC]
    y, x = grid.line("y"), grid.line("x")
    mask = cfa.read(str(plan.shared.get("pattern", "mono")))
    index = cfa.channel_index(mask, y.size, x.size, round(y.start), round(x.start))
    return index == list(mask.channels).index(channel)


def _response(picture: Array, frequency: Array, own: Array, sites: Array | None) -> Array:
    found = slanted_edge(picture, samples=SAMPLES, tails=False, sites=sites)
    return np.interp(frequency, found.frequency, found.sfr) / own


def _rows(rows: int, period: int) -> slice:
    """Return the middle rows over which the edge shifts by whole cells of the mosaic, so that artefacts of a demosaicer
    average out.

    Otherwise strong false detail of low frequency leaks into the response near 1/2 cycle/pixel.
    """
    step = period / math.tan(math.radians(ANGLE))
    kept = round(step * max(1, math.floor((rows - 2 * BORDER) / step)))
    start = max(0, (rows - kept) // 2)
    return slice(start, start + kept)

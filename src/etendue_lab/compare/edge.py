"""MTF50 of alternatives: the same camera viewing a slanted edge, noise-free.

In:  a pipeline with its reference, the axis, the plan of its main run.
Out: for each value of the axis, and for the reference, the frequency of half contrast across the edge, cycles/pixel.

The scene becomes an axis of two values, an edge and a uniform field of the same light, so that fall-off divides out.
The contrast that the rendering of the edge removes is known exactly, and divided out too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from etendue.contract.registry import Registry
from etendue.contract.stage import parameters_of
from etendue.errors import EtendueError, RequestError
from etendue.pipeline.derived import wanting, with_values
from etendue.pipeline.file import PipelineFile
from etendue.plan.model import Node, Plan, StageVariable
from etendue.plan.planner import make_plan
from etendue.session import Options, execute
from etendue.types.arrays import Array
from etendue.types.documents import AxisValue
from etendue_camera.resolution.edges.slanted_edge import slanted_edge
from etendue_camera.roles import EdgeScene, FlatScene
from etendue_lab.compare import installed
from etendue_lab.compare.axis import AxisRequest
from etendue_lab.compare.branches import CAMERA, Branched, noise_free, writer
from etendue_lab.compare.figures import BORDER

ANGLE = 5.0  # degrees from the columns
ROWS, COLUMNS, MARGIN = 120, 96, 12  # pixels; the margin is light around the frame
# contrast 4:1 as in ISO 12233; the bright field stays below this fraction of clipping
DARK, BRIGHT, SATURATED = (0.2, 0.8, 0.7)
SAMPLES = 401


@dataclass(frozen=True)
class EdgeFigures:
    """Frequencies in cycles/pixel; NaN if half contrast is not reached."""

    mtf50: dict[int, float]  # by the position on the axis
    reference: dict[int, float]
    note: str = ""


def measure(
    branched: Branched,
    plan: Plan,
    asked: AxisRequest,
    values: Sequence[AxisValue],
    white: float,
    registry: Registry,
    options: Options,
) -> EdgeFigures:
    """Run the cameras on a slanted edge and measure MTF50. A failure becomes a note, not an exception.

    ``white``: the largest value of a white surface over the axis, 1 where pixels saturate; 0: unknown.
    """
    try:
        return _measured(branched, plan, asked, values, white, registry, options)
    except (EtendueError, ValueError) as error:
        text = error.faults[0].message if isinstance(error, RequestError) and error.faults else str(error)
        return EdgeFigures({}, {}, f"no MTF50: {text}")


def _measured(
    branched: Branched,
    plan: Plan,
    asked: AxisRequest,
    values: Sequence[AxisValue],
    white: float,
    registry: Registry,
    options: Options,
) -> EdgeFigures:
    place, reference = branched.linear.ours, branched.linear.reference
    if place[1] == "rgb_display":
        raise ValueError("the stage writes encoded values, for which no transfer function is defined")
    if any(n.name == asked.stage and n.is_source for n in branched.nodes):
        raise ValueError("the scene is the axis, so it cannot be replaced by an edge")
    pipeline, scene, sigma = edge_and_field(branched.pipeline, branched.nodes, plan, white, registry)
    pipeline = replace(pipeline, sweep={**pipeline.sweep, **branched.axes(asked.key, values)})
    wanted = [place, reference]
    matrix = writer(branched.nodes, "colour_matrix"), writer(branched.nodes, "white")
    if place[1] == CAMERA and all(matrix):
        wanted += [(matrix[0].name, "colour_matrix"), (matrix[1].name, "white")]  # type: ignore[union-attr]
    made = make_plan(wanting(pipeline, wanted, kept=True), registry, False)
    outcome = execute(made, None, options)
    if outcome.failed and not any(place[0] == r.stage for r in outcome.failed):
        raise ValueError(outcome.failed[0].message.strip().rpartition("\n")[2])

    def at(where: StageVariable, which: int, position: int) -> Any:
        node = made.node(where[0])
        by_dim = {a.dim: which if a.dim == scene else position for a in made.axes}
        found = outcome.arrays.get((node.name, tuple(by_dim[dim] for dim in node.axes)), {})
        return found.get(where[1])

    def mtf50(where: StageVariable, position: int) -> float | None:
        planes = [at(where, which, position) for which in (0, 1)]
        if any(p is None for p in planes):
            return None
        weights = _luminance(
            where[1], len(planes[0]), *(at((n.name, v), 1, position) if n else None for n, v in _named(matrix))
        )
        edge, flat = (
            np.tensordot(weights, np.asarray(p, np.float64), 1)[BORDER:-BORDER, BORDER:-BORDER] for p in planes
        )
        if not np.all(flat > 0):
            raise ValueError("the uniform field of the same light is dark")
        return crossing(edge / flat, _pixels(sigma, made, position))

    axis = next((a for a in made.axes if a.dim != scene), None)
    if axis is None:  # a noise-free camera does not depend on the compared axis
        both = [dict.fromkeys(range(len(values)), mtf50(where, 0)) for where in (place, reference)]
    else:
        both = [{i: mtf50(where, i) for i in range(len(axis.values))} for where in (place, reference)]
    ours, theirs = ({i: v for i, v in found.items() if v is not None} for found in both)
    return EdgeFigures(ours, theirs)


def _named(matrix: tuple[Any, Any]) -> tuple[tuple[Any, str], ...]:
    return (matrix[0], "colour_matrix"), (matrix[1], "white")


def _luminance(variable: str, channels: int, matrix: Any, white: Any) -> Any:
    """Return the weights of the channels in the luminance Y. If they are unknown, the middle channel has weight 1 and
    the others 0.
    """
    if variable == CAMERA and matrix is not None and white is not None:
        return np.asarray(matrix, np.float64)[1] / np.asarray(white, np.float64)
    return np.eye(channels)[min(1, channels - 1)]


def _pixels(sigma: float, plan: Plan, position: int) -> float:
    """Return the softness of the edge in pixels; the pixel pitch may be the axis."""
    pitches = pitches_of(plan)
    return sigma / pitches[position if len(pitches) > 1 else 0]


def pitches_of(plan: Plan) -> list[float]:
    """Return the pixel pitch (um) of each value of the axis if the pitch or the sensor is swept, else the single pitch
    of the camera.
    """
    for axis in plan.axes:
        if axis.key == "pixel_pitch" or "pixel_pitch" in axis.gives:
            return [float(axis.value("pixel_pitch", position)) for position in range(len(axis.values))]
    return [float(plan.shared["pixel_pitch"])]


def crossing(picture: Array, sigma: float) -> float:
    """Return the lowest frequency (cycles/pixel) of half contrast in a picture of an edge. The edge was drawn with a
    Gaussian of rms width ``sigma`` pixels, which is divided out.

    NaN if the contrast does not fall to half below 1 cycle/pixel. The frequency is interpolated linearly between
    samples 1/400 cycles/pixel apart, with a relative error of 1e-5.
    """
    response = slanted_edge(picture, samples=SAMPLES, tails=False)
    own = np.exp(-2 * (math.pi * sigma * response.frequency) ** 2)
    sfr = response.sfr / np.maximum(own, 1e-3)
    below = np.flatnonzero(sfr < 0.5)
    if below.size == 0:
        return math.nan
    high = int(below[0])
    share = (sfr[high - 1] - 0.5) / (sfr[high - 1] - sfr[high])
    return float(response.frequency[high - 1] + share * (response.frequency[high] - response.frequency[high - 1]))


def edge_and_field(
    base: PipelineFile, nodes: tuple[Node, ...], plan: Plan, white: float, registry: Registry
) -> tuple[PipelineFile, str, float]:
    """Return the pipeline with two scenes, an edge and a uniform field, in place of its own scene. Also return the dim
    of the two scenes, and the rms softness of the edge, um.
    """
    sources = [n for n in nodes if n.is_source and "radiance" in n.writes]
    pixel = next((n for n in nodes if n.ends_in_sum), None)
    if len(sources) != 1 or pixel is None:
        raise ValueError("the pipeline has no single scene that an edge could replace")
    source = sources[0]
    light = plan.of(source.name)[0].grids["radiance"]
    pitches = pitches_of(plan)
    paper = pixel.alternatives[0].values.get("sampling") == "paper"
    spacing, softness = (min(pitches), 0.5) if paper else (min(pitches) / 4, 1.0)
    edges = light.bands().edges
    own = source.alternatives[0].values
    bright = min(BRIGHT, SATURATED / white) if white > 0 else BRIGHT
    common = {
        "white_luminance": 0.0 if own.get("radiance") else own.get("white_luminance") or 1000.0,
        "radiance": own.get("radiance") or 0.0,
        "height": spacing * round((ROWS + 2 * MARGIN) * max(pitches) / spacing),
        "width": spacing * round((COLUMNS + 2 * MARGIN) * max(pitches) / spacing),
        "spacing": spacing,
        "wavelength_from": edges[0],
        "wavelength_to": edges[-1],
        "bin_width": (edges[-1] - edges[0]) / (len(edges) - 1),
        "centre_y": own.get("centre_y") or 0.0,
        "centre_x": own.get("centre_x") or 0.0,
    }
    edge, field = (installed.made_for(registry, base) for base in (EdgeScene, FlatScene))
    scenes = [
        {
            "use": edge,
            "label": "edge",
            "angle": ANGLE,
            "low": bright * DARK / BRIGHT,
            "high": bright,
            "softness": softness,
            **common,
        },
        {"use": field, "label": "field", "reflectance": bright, **common},
    ]
    window = {"rows": ROWS, "columns": COLUMNS}
    if paper or not set(window) <= set(parameters_of(pixel.kind)):
        window = {}
    dropped = ("sensor_height", "sensor_width", "first_row", "first_column", "window_rows", "window_columns")
    pipeline = noise_free(base, nodes, registry)
    if window:
        pipeline = with_values(pipeline, pixel.name, window, dropped)
    return replace(pipeline, sweep={f"{source.name}.use": scenes}), source.name, softness * spacing

"""Metrics of one measured edge, in camera pixels, and their reliability.

In:  an ``Edge`` in samples of its picture.
Out: columns of the probe ``edge_resolution``, flags, the direction across it.
"""

from __future__ import annotations

import math

from etendue_camera.arrays import Array
from etendue_camera.resolution.edges import slanted_edge
from etendue_camera.resolution.stages.edge_pictures import Edge

FLAGS = {"above_nyquist": 1, "not_reached": 2, "clipped": 4, "noisy": 8, "no_edge": 16}
NYQUIST = 0.5  # cycles/pixel of the camera
COLUMNS = (
    "edge_mtf50",
    "edge_mtf50_low",
    "edge_mtf50_high",
    "edge_mtf50_cycles",
    "edge_effective_cycles",
    "edge_mtf10",
    "edge_aliasing",
    "edge_angle",
    "edge_flags",
)


def row(edge: Edge | None, step: float, pitch: float) -> dict[str, float]:
    """Return the columns for an edge measured in samples of ``step`` um, for camera pixels of ``pitch`` um."""
    if edge is None:
        return {**dict.fromkeys(COLUMNS, math.nan), "edge_flags": FLAGS["no_edge"]}
    per_pixel = pitch / step
    cycles = edge.mtf50 * per_pixel
    flags = sum(FLAGS[name] for name in FLAGS if getattr(edge, name, False)) + (
        FLAGS["above_nyquist"] if cycles > NYQUIST else 0
    )
    seen = edge.frequency * per_pixel
    return {
        "edge_mtf50": edge.mtf50 / step,
        "edge_mtf50_low": edge.mtf50_low / step,
        "edge_mtf50_high": edge.mtf50_high / step,
        "edge_mtf50_cycles": cycles,
        "edge_effective_cycles": effective(edge, per_pixel),
        "edge_mtf10": edge.mtf10 / step,
        "edge_aliasing": slanted_edge.folded(seen, edge.sfr) if seen[-1] > NYQUIST else math.nan,
        "edge_angle": edge.angle,
        "edge_flags": flags,
    }


def carry_clipped(rows: dict[str, dict[str, float]], mosaic: list[str], stage: Array, clipped: bool) -> None:
    """Mark every picture derived from a clipped mosaic as clipped."""
    names = [str(name) for name in stage]
    if not mosaic or not (clipped or int(rows[mosaic[0]]["edge_flags"]) & FLAGS["clipped"]):
        return
    for name in names[names.index(mosaic[0]) :]:
        rows[name]["edge_flags"] = int(rows[name]["edge_flags"]) | FLAGS["clipped"]


def effective(edge: Edge, per_pixel: float, spread: float = 1.0) -> float:
    """Return MTF50 in cycles/pixel, capped at Nyquist; NaN if it is above the frequency range of a grid coarser than
    the pixels.

    ``spread``: ratio of MTF50 after charge has moved between pixels to MTF50 before.
    """
    if edge.not_reached:
        return NYQUIST if edge.frequency[-1] * per_pixel >= NYQUIST else math.nan
    return min(edge.mtf50 * per_pixel * spread, NYQUIST)


def normal(edge: Edge) -> tuple[float, float]:
    """Return the unit vector (y, x) across a measured edge."""
    turn = math.radians(edge.angle)
    return (-math.sin(turn), math.cos(turn)) if edge.vertical else (math.cos(turn), -math.sin(turn))


def doubt(edge: Edge, per_pixel: float) -> float:
    """Return the width of the interval of the effective MTF50, with both ends capped at Nyquist, divided by MTF50; 0
    without noise."""
    if math.isnan(edge.mtf50_high):
        return 0.0
    low, high = (min(end * per_pixel, NYQUIST) for end in (edge.mtf50_low, edge.mtf50_high))
    return (high - low) / effective(edge, per_pixel)

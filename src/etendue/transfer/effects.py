"""The effect of a blur on light whose content is known: sums over rings of radial frequency.

In:  transfer stages, edges of bands, the ``Content`` of their input.
Out: bounds on the change if they are left out, as rms over the frame and at the pixel with the largest change; the
     content after them.
"""

from __future__ import annotations

from collections.abc import Hashable
from functools import lru_cache

import numpy as np

from etendue.contract.arrays.facts import Content, Rings
from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import Transfer
from etendue.contract.stage import state_of
from etendue.transfer import peaks
from etendue.transfer import rings as scene_rings
from etendue.transfer.products import Product, alone
from etendue.types.arrays import Array, FloatArray

DIRECTIONS = 8  # over a half turn, in which a non-radial transfer function is evaluated


def change(stage: Transfer, content: Content, grid: Grid) -> peaks.Change:
    """Return an upper bound of the change of the light if this stage is left out. The bound is in the norm
    ``content.norm``, relative to the largest value after the stage.

    Parameters
    ----------
    stage : Transfer
    content : Content
        Content of the input of the stage.
    grid : Grid
        Grid of the input, with bands.
    """
    changed, _, least = _rings(stage, grid.bands().edges, content.edges)
    return peaks.relative(changed, least, content, grid)


def behind(stage: Transfer, edges: tuple[float, ...], content: Content) -> Content:
    """Return the content of the light after a stage."""
    changed, passed, _ = _rings(stage, edges, content.edges)
    return content.filtered(_rows(passed), _rows(peaks.behind(content, changed)))


def _rows(values: Array) -> Rings:
    return tuple(tuple(map(float, row)) for row in values)


def in_directions(stages: tuple[Transfer, ...], edges: tuple[float, ...], frequency: FloatArray) -> FloatArray:
    """Return the product of transfer functions along rays from zero frequency, (direction, band, n); one direction if
    all functions are radial.
    """
    points = tuple(map(float, frequency))
    found: Array = np.ones((1, len(edges) - 1, len(points)))
    for stage in stages:
        found = found * _rays(state_of(stage), edges, points)
    return found


@lru_cache(48)
def _rays(state: tuple[Transfer, Hashable], edges: tuple[float, ...], points: tuple[float, ...]) -> FloatArray:
    """Evaluate one stage; cached, because the same stage precedes many others."""
    product, frequency = Product((state[0],), edges, alone), np.array(points)
    if product.radial:
        return product.along(frequency)[None]
    found = []
    for angle in np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
        grid = product.at(np.sin(angle) * frequency[:, None], np.cos(angle) * frequency[None, :])
        found.append(
            np.diagonal(np.broadcast_to(grid, (len(edges) - 1, frequency.size, frequency.size)), axis1=1, axis2=2)
        )
    return np.stack(found)


def _rings(stage: Transfer, edges: tuple[float, ...], rings: tuple[float, ...]) -> tuple[Array, Array, Array]:
    return _remembered(state_of(stage), edges, rings)


@lru_cache(96)
def _remembered(
    state: tuple[Transfer, Hashable], edges: tuple[float, ...], rings: tuple[float, ...]
) -> tuple[Array, Array, Array]:
    """Return three (band, ring) arrays: the largest |1 - H|, largest |H| and smallest |H| over all directions."""
    found = in_directions((state[0],), edges, scene_rings.frequencies_in(np.array(rings)))
    changed, passed = (scene_rings.largest_in_rings(np.abs(values)).max(axis=0) for values in (1 - found, found))
    least = -scene_rings.largest_in_rings(-np.abs(found)).max(axis=0)
    return changed, passed, least

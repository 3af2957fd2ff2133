"""The error of a pixel stage that combines bands in a few terms and keeps only low frequencies.

In:  weights of the channels, preceding stages, the content of the light, the number of terms and the fraction of
     frequencies kept.
Out: the omitted part, relative to the largest signal of the channel.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from etendue.api import Grid, Transfer
from etendue.contract.arrays.facts import Content
from etendue.transfer import effects, expansion, peaks, sampling
from etendue.transfer import rings as scene_rings
from etendue_camera.arrays import FloatArray
from etendue_camera.sensor import photodiode

PART = 0.25
"""Amplitude assumed for light of unknown content, which may be strong at any frequency. A picture between black and
full scale has at most half of full scale in its waves, rms, and never all of it at the worst frequency. Over random
scenes and spectra, including narrow ones, the maximum is an eighth."""

Weights = tuple[tuple[float, ...], ...]


def of_the_light(
    weights: Weights,
    before: tuple[Transfer, ...],
    light: Grid,
    content: Content | None,
    width: float,
    terms: int,
    kept: float,
) -> float:
    """Return the error of the worst channel.

    Parameters
    ----------
    weights : (channel, wavelength), with a sum of 1 for each channel
    before : stages between the segment's input and the pixel
    light : Grid
        Grid of the light.
    content : Content or None
        Content of the segment's input; None: equally strong in every band, a quarter of full scale at the worst
        frequency.
    width : float
        Width of the light-sensitive square, um.
    terms : int
        Number of expansion terms; 0: every band is read separately.
    kept : float
        Fraction of the grid's Nyquist frequency that is kept.

    Returns
    -------
    float
        Error in the norm of the content: the errors of the bands are added in phase, and divided by a lower bound on
        the largest signal of the channel.
    """
    edges = light.bands().edges
    steps = (light.line("y").step, light.line("x").step)
    corner = 0.5 * math.hypot(1 / steps[0], 1 / steps[1])
    rings = content.edges if content is not None else tuple(np.linspace(0.0, corner, expansion.FITTED))
    missing = _missing(weights, before, edges, corner, rings, terms, _highest(light, kept))
    lost = scene_rings.largest_in_rings(missing * passed(width, rings))
    if content is None:
        return PART * float(lost.sum(axis=1).max())
    return peaks.relative_sums(lost, _full(weights, before, content, light, width), content, light)


@lru_cache(96)
def _full(weights: Weights, before: tuple[Transfer, ...], content: Content, light: Grid, width: float) -> FloatArray:
    """Return a lower bound on the largest signal of every channel, (channel,)."""
    left = _left(before, light.bands().edges, content.edges, width)
    return peaks.largest_of_sums(np.array(weights), left, content, light)


def _highest(light: Grid, kept: float) -> float:
    """Return the frequency up to which all frequencies are kept along both axes, cycles/um."""
    if kept == 1:
        return math.inf
    lines = (light.line("y"), light.line("x"))
    return min(sampling.kept_terms(n.size, kept) / (sampling.padded_size(n.size) * n.step) for n in lines)


@lru_cache(96)
def _left(before: tuple[Transfer, ...], edges: tuple[float, ...], rings: tuple[float, ...], width: float) -> FloatArray:
    """Return the smallest transfer function of stages and aperture together in every ring of frequencies, (band or 1,
    ring).
    """
    points = scene_rings.frequencies_in(np.array(rings))
    found = np.abs(effects.in_directions(before, edges, points)).min(axis=0)
    # along an axis, where the response of a square aperture first reaches its minimum
    aperture = np.abs(photodiode.aperture_otf(points, width))
    return -scene_rings.largest_in_rings(-found * aperture)


@lru_cache(256)
def passed(width: float, rings: tuple[float, ...]) -> FloatArray:
    """Return the aperture's transfer function at radial frequencies, the largest over all directions, (frequency,)."""
    frequency = scene_rings.frequencies_in(np.array(rings))
    found = np.zeros_like(frequency)
    for angle in np.linspace(0, math.pi / 4, 7):
        along, across = math.cos(angle) * frequency, math.sin(angle) * frequency
        found = np.maximum(
            found, np.abs(photodiode.aperture_otf(along, width) * photodiode.aperture_otf(across, width))
        )
    return found


@lru_cache(96)
def _missing(
    weights: Weights,
    before: tuple[Transfer, ...],
    edges: tuple[float, ...],
    corner: float,
    rings: tuple[float, ...],
    terms: int,
    limit: float,
) -> FloatArray:
    """Return the largest fraction that each band loses in any direction, as (channel, wavelength, frequency)."""
    own = np.array(weights)
    own = own[own.max(axis=1) > 0]
    points = scene_rings.frequencies_in(np.array(rings))
    transfer = effects.in_directions(before, edges, points)
    beyond = points > limit
    whole = np.abs(own[:, :, None] * transfer[:, None])
    # In the ring that the limit crosses, most is lost at the limit rather than at the borders of the ring.
    straddling = int(np.searchsorted(np.array(rings), limit)) - 1
    if 0 <= straddling < len(rings) - 1:
        at_limit = np.abs(own[:, :, None] * effects.in_directions(before, edges, np.array([limit]))[:, None])
        whole[..., 2 * straddling + 1] = at_limit[..., 0]
        beyond[2 * straddling + 1] = True
    if not terms:
        found = np.where(beyond, whole, 0.0)
    else:
        basis = basis_of(weights, before, edges, corner, terms)
        residual = np.stack([expansion.expansion_residual(own, one, basis) for one in transfer])
        found = np.where(beyond, whole, residual)
    every = np.zeros((len(weights), *found.shape[2:]))
    every[np.array(weights).max(axis=1) > 0] = found.max(axis=0)
    return every


@lru_cache(64)
def basis_of(
    weights: Weights, before: tuple[Transfer, ...], edges: tuple[float, ...], corner: float, terms: int
) -> FloatArray:
    """Return the functions of wavelength in which the light is expanded, (terms, wavelength)."""
    own = np.array(weights)
    frequency = np.linspace(0.0, corner, expansion.FITTED)
    transfer = effects.in_directions(before, edges, frequency)[0].real
    return expansion.band_basis(own[own.max(axis=1) > 0], terms, transfer, expansion.importance(frequency))

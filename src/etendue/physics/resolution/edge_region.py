"""Where in a picture the strongest straight edge is that can be measured, and a strip about it that holds nothing else.

In:  a linear picture (y, x).
Out: a window (pixels) and the pixels in it that belong to the strip.
Sources: the structure tensor; every other threshold is stated beside its name.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from etendue.physics.resolution.edge_line import FloatArray, Sites, gradient, lost

AROUND = 15  # pixels over which the tensor is averaged
FLATTEST, STEEPEST = 1.0, 43.8  # degrees from the raster
ALIVE = 0.35  # part of the seed's strength down to which the edge goes on
OTHER = 0.02  # part of the edge's strength from which something else begins
NOISE = 10.0  # times the median strength of the picture, which noise alone hardly reaches
FAINT = 1e-9  # of the strongest, below which a gradient has no direction
ENDS = 6.0  # pixels left out at either end
SHORTEST, NARROWEST = 24.0, 8.0  # half of the strip's length, and its half width, pixels


def find_edge(image: FloatArray, sites: Sites | None = None) -> tuple[tuple[int, int, int, int], Sites]:
    """The window (top, bottom, left, right) about the strongest straight edge, and the pixels of it in the window.

    Raises
    ------
    ValueError
        Where no straight edge longer than 48 pixels stands free for 8 pixels on either side.

    Notes
    -----
    The seed is where the squared gradient, times the square of its coherence, is largest at an angle that can be
    measured. The strip goes on along the edge while its strength lasts, and across it until the gradient rises again.
    """
    gy, gx = gradient(image, sites)
    energy = gy**2 + gx**2
    jyy, jxx, jyx = (scipy.ndimage.uniform_filter(part, AROUND, mode="constant") for part in (gy * gy, gx * gx, gy * gx))
    total = jyy + jxx
    if not total.max() > 0:
        raise ValueError(lost("it is even all over"))
    coherent = np.hypot(jxx - jyy, 2 * jyx) / np.maximum(total, FAINT * total.max())
    normal = 0.5 * np.arctan2(2 * jyx, jxx - jyy)
    tilt = np.abs((np.degrees(normal) + 45) % 90 - 45)
    score = np.where((tilt > FLATTEST) & (tilt < STEEPEST), total * coherent**2, 0.0)
    row, column = np.unravel_index(int(score.argmax()), score.shape)
    if not score[row, column] > 0:
        raise ValueError(lost("nothing in it stands at a slant"))
    turn = float(normal[row, column])
    place = _centre(energy, float(row), float(column), turn)
    for _ in range(3):  # a longer strip knows the direction better
        start, stop = _ends(energy, place, turn)
        place, turn = _straightened(energy, place, turn, start, stop)
    if not FLATTEST < abs((math.degrees(turn) + 45) % 90 - 45) < STEEPEST:
        raise ValueError(lost("the strongest straight one stands along the raster"))
    start, stop = _ends(energy, place, turn)
    start, stop = start + ENDS, stop - ENDS
    if stop - start < 2 * SHORTEST:
        raise ValueError(lost("the longest straight one is shorter than 48 pixels"))
    half = _half_width(energy, place, turn, start, stop)
    return _strip(image.shape, place, turn, start, stop, half, sites)


def _sampled(energy: FloatArray, place: tuple[float, float], turn: float, along: FloatArray, across: FloatArray) -> FloatArray:
    """Strength at distances along and across the edge, (along, across); 0 outside the picture."""
    s, c = math.sin(turn), math.cos(turn)
    y = place[0] + along[:, None] * c + across * s
    x = place[1] - along[:, None] * s + across * c
    return np.asarray(scipy.ndimage.map_coordinates(energy, [y, x], order=1, mode="constant"), np.float64)


def _centre(energy: FloatArray, row: float, column: float, turn: float) -> tuple[float, float]:
    """The seed moved across onto the ridge."""
    across = np.arange(-AROUND, AROUND + 0.5, 0.5)
    ridge = _sampled(energy, (row, column), turn, np.arange(-4.0, 5.0), across).sum(0)
    move = float(across[int(ridge.argmax())])
    return row + move * math.sin(turn), column + move * math.cos(turn)


def _ends(energy: FloatArray, place: tuple[float, float], turn: float) -> tuple[float, float]:
    """How far the ridge goes on to either side of a place."""
    reach = math.hypot(*energy.shape)
    along = np.arange(-math.ceil(reach), math.ceil(reach) + 1.0)
    ridge = scipy.ndimage.uniform_filter(_sampled(energy, place, turn, along, np.arange(-6.0, 6.5)).sum(1), 5)
    middle = len(along) // 2
    strength = float(np.median(ridge[middle - 6 : middle + 7]))
    weak = np.flatnonzero(ridge < ALIVE * strength)
    before, after = weak[weak < middle], weak[weak > middle]
    return float(along[before[-1]]) if before.size else float(along[0]), float(along[after[0]]) if after.size else float(along[-1])


def _straightened(
    energy: FloatArray, place: tuple[float, float], turn: float, start: float, stop: float
) -> tuple[tuple[float, float], float]:
    """Middle and direction of the ridge, by a line through the centroids across it."""
    along, across = np.arange(start, stop + 0.5), np.arange(-6.0, 6.5)
    if along.size < 3:
        return place, turn
    ridge = _sampled(energy, place, turn, along, across)
    weight = np.maximum(ridge.sum(1), 1e-300)
    centroid, centre = (ridge @ across) / weight, float(weight @ along / weight.sum())
    spread = float(weight @ (along - centre) ** 2)
    if not spread > 0:
        return place, turn
    slope = float(weight @ ((along - centre) * centroid)) / spread
    shift = float(weight @ centroid / weight.sum()) - slope * centre
    s, c = math.sin(turn), math.cos(turn)
    middle = 0.5 * (start + stop)
    away = shift + slope * middle
    return (place[0] + middle * c + away * s, place[1] - middle * s + away * c), turn - math.atan(float(slope))


def _half_width(energy: FloatArray, place: tuple[float, float], turn: float, start: float, stop: float) -> float:
    """Up to where nothing else begins on either side, on what the picture holds."""
    reach = math.ceil(math.hypot(*energy.shape))
    across = np.arange(-reach, reach + 1.0)
    seen = _sampled(energy, place, turn, np.arange(start, stop + 0.5), across)
    profile = np.sort(seen, axis=0)[-max(3, seen.shape[0] // 20)]  # what a twentieth of the length shows
    peak = float(profile.max())
    least = max(OTHER * peak, min(NOISE * float(np.median(energy)), 0.5 * peak))
    found = []
    for side in (profile[reach:], profile[reach::-1]):
        quiet = np.flatnonzero(side < least)
        begin = int(quiet[0]) if quiet.size else len(side)
        again = np.flatnonzero(side[begin:] >= least)
        found.append(begin + int(again[0]) - 3 if again.size else len(side))
    return float(min(found))


def _strip(
    shape: tuple[int, ...], place: tuple[float, float], turn: float, start: float, stop: float, half: float, sites: Sites | None
) -> tuple[tuple[int, int, int, int], Sites]:
    if half < NARROWEST:
        raise ValueError(lost("something stands within 8 pixels of the strongest one"))
    y, x = np.arange(shape[0])[:, None] - place[0], np.arange(shape[1]) - place[1]
    s, c = math.sin(turn), math.cos(turn)
    along, across = y * c - x * s, y * s + x * c
    inside = (along > start) & (along < stop) & (np.abs(across) < half)
    rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
    window = (int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1)
    cut = np.s_[window[0] : window[1], window[2] : window[3]]
    return window, inside[cut] if sites is None else inside[cut] & sites[cut]

"""Search for measurable straight edges in a picture, and for strips around them that contain nothing else.

In:  a linear picture (y, x).
Out: windows (pixels) and the pixels of the strip in them.
Sources: the structure tensor; every threshold is described at its definition.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy

from etendue_camera.arrays import FloatArray
from etendue_camera.resolution.edges.edge_line import Sites, gradient, lost

AROUND = 15  # pixels over which the tensor is averaged
FLATTEST, STEEPEST = 1.0, 43.8  # degrees from the raster
SLANTED = (1.8, 43.2)  # for one of several edges: 2 to 43 plus its uncertainty
ALIVE = 0.35  # fraction of the seed's strength at which the edge ends
OTHER = 0.02  # fraction of the edge's strength at which other content begins
NOISE = 10.0  # times the median strength of the picture, rarely reached by noise alone
FAINT = 1e-9  # fraction of the strongest gradient below which a gradient has no direction
SMALLEST = 3  # minimum length, in pixels, of a side that has gradients
ENDS = 6.0  # pixels omitted at either end
SHORTEST, NARROWEST = 24.0, 8.0  # half length and half width of the strip, pixels
ROUNDS, STILL = 12, 1e-4  # largest number of iterations for the direction, and tolerance in radians
RAISED = 4.0  # times the strength that four fifths of the picture exceed; weaker seeds are noise


def find_edge(image: FloatArray, sites: Sites | None = None) -> tuple[tuple[int, int, int, int], Sites]:
    """Return the window (top, bottom, left, right) about the strongest straight edge, and the mask of the edge's pixels
    in the window.

    Raises
    ------
    ValueError
        If no straight edge longer than 48 pixels is isolated by 8 pixels on either side.

    Notes
    -----
    The seed is where the squared gradient, times the square of its coherence, is largest at a measurable angle. The
    strip follows the edge until its gradient becomes weak, and extends across it until the gradient rises again.
    """
    survey = _surveyed(image, sites)
    row, column = np.unravel_index(int(survey.score.argmax()), survey.score.shape)
    if not survey.score[row, column] > 0:
        raise ValueError(lost("it has no slanted edge"))
    ridge = _followed(survey, int(row), int(column))
    return _checked_strip(survey, ridge, SHORTEST, sites, (FLATTEST, STEEPEST))


@dataclass(frozen=True)
class FoundEdge:
    """A straight edge: the window about it, its pixels, and its expected quality."""

    window: tuple[int, int, int, int]  # top, bottom, left, right
    strip: Sites
    promise: float  # its length times the square root of its strength


def find_edges(
    image: FloatArray, sites: Sites | None = None, *, most: int = 8, tries: int = 40, shortest: float = SHORTEST
) -> tuple[list[FoundEdge], list[str]]:
    """Return isolated straight edges, the most promising first, and the reasons why other candidates were rejected.

    Parameters
    ----------
    image : (y, x) array, any linear unit
    sites : (y, x) array of bool or None
        The pixels to use; None: all.
    most, tries : int
        Largest number of edges, and of candidates.
    shortest : float, pixels
        Minimum half length of a strip.

    Notes
    -----
    Works as `find_edge`, with one seed after the other: pixels covered by an edge, or by a rejected candidate, are not
    used as seeds.
    """
    try:
        survey = _surveyed(image, sites)
    except ValueError as error:
        return [], [str(error)]
    score, covered = survey.score.copy(), np.zeros(image.shape, bool)
    least = max(RAISED * float(np.percentile(survey.total, 20)), FAINT * float(survey.total.max()))
    found: list[FoundEdge] = []
    why: list[str] = []
    for _ in range(tries):
        row, column = (int(one) for one in np.unravel_index(int(score.argmax()), score.shape))
        if not score[row, column] > 0:
            why = why or [lost("it has no slanted edge")]
            break
        if survey.total[row, column] < least:
            why = why or [lost("its step is lost in noise")]
            break
        score[max(row - AROUND, 0) : row + AROUND + 1, max(column - AROUND, 0) : column + AROUND + 1] = 0.0
        ridge = _followed(survey, row, column)
        middle = tuple(min(max(round(at), 0), size - 1) for at, size in zip(ridge.place, score.shape, strict=True))
        if covered[middle]:
            continue
        covered |= _within(score.shape, ridge, 0.5 * AROUND)
        score[covered] = 0.0
        try:
            window, strip = _checked_strip(survey, ridge, shortest, sites, SLANTED)
        except ValueError as error:
            why.append(str(error))
            continue
        strength = float(np.median(_sampled(survey.energy, ridge, ridge.along, np.zeros(1))))
        found.append(FoundEdge(window, strip, (ridge.stop - ridge.start) * math.sqrt(max(strength, 0.0))))
        if len(found) == most:
            break
    return sorted(found, key=lambda one: -one.promise), why


@dataclass(frozen=True)
class _Ridge:
    """The course of an edge: a place on it (y, x), its direction, and its extent to either side."""

    place: tuple[float, float]
    turn: float  # radians
    start: float = 0.0
    stop: float = 0.0

    @property
    def along(self) -> FloatArray:
        """Return positions along the edge, one per pixel of its length."""
        return np.arange(self.start, self.stop + 0.5)


@dataclass(frozen=True)
class _Survey:
    """By pixel: squared gradient, its mean over a square, direction of the gradient in that square, and score as a
    slanted edge.
    """

    energy: FloatArray
    total: FloatArray
    normal: FloatArray  # radians
    score: FloatArray


def _surveyed(image: FloatArray, sites: Sites | None) -> _Survey:
    if min(image.shape) < SMALLEST:
        raise ValueError(
            lost(f"it has {image.shape[0]} x {image.shape[1]} pixels; at least {SMALLEST} x {SMALLEST} are required")
        )
    gy, gx = gradient(image, sites)
    jyy, jxx, jyx = (
        scipy.ndimage.uniform_filter(part, AROUND, mode="constant") for part in (gy * gy, gx * gx, gy * gx)
    )
    total = jyy + jxx
    if not total.max() > 0:
        raise ValueError(lost("it is uniform"))
    coherent = np.hypot(jxx - jyy, 2 * jyx) / np.maximum(total, FAINT * total.max())
    normal = 0.5 * np.arctan2(2 * jyx, jxx - jyy)
    tilt = np.abs((np.degrees(normal) + 45) % 90 - 45)
    score = np.where((tilt > FLATTEST) & (tilt < STEEPEST), total * coherent**2, 0.0)
    return _Survey(gy**2 + gx**2, total, normal, score)


def _followed(survey: _Survey, row: int, column: int) -> _Ridge:
    """Follow the ridge from a seed: return its centre, direction and ends."""
    turn = float(survey.normal[row, column])
    ridge = _Ridge(_centre(survey.energy, float(row), float(column), turn), turn)
    for _ in range(ROUNDS):  # a longer strip gives a better direction
        before = ridge.turn
        ridge = _straightened(survey.energy, _ended(survey.energy, ridge))
        if abs(ridge.turn - before) < STILL:
            break
    return _ended(survey.energy, ridge)


def _checked_strip(
    survey: _Survey, ridge: _Ridge, shortest: float, sites: Sites | None, slant: tuple[float, float]
) -> tuple[tuple[int, int, int, int], Sites]:
    tilt = abs((math.degrees(ridge.turn) + 45) % 90 - 45)
    if not slant[0] < tilt:
        raise ValueError(lost("the strongest straight edge is parallel to the pixel axes"))
    if not tilt < slant[1]:
        raise ValueError(lost("the strongest straight edge is nearly diagonal"))
    inner = replace(ridge, start=ridge.start + ENDS, stop=ridge.stop - ENDS)
    if inner.stop - inner.start < 2 * shortest:
        raise ValueError(lost(f"the longest straight edge is shorter than {2 * shortest:g} pixels"))
    half = _half_width(survey.energy, inner)
    if half < NARROWEST:
        raise ValueError(lost("there is something within 8 pixels of the strongest edge"))
    inside = _within(survey.energy.shape, inner, half)
    if not inside.any():
        raise ValueError(lost("the candidate is not a single straight edge: it leaves the picture"))
    rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
    window = (int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1)
    cut = np.s_[window[0] : window[1], window[2] : window[3]]
    return window, inside[cut] if sites is None else inside[cut] & sites[cut]


def _within(shape: tuple[int, ...], ridge: _Ridge, half: float) -> Sites:
    """Return the pixels within a distance to either side of a ridge."""
    y, x = np.arange(shape[0])[:, None] - ridge.place[0], np.arange(shape[1]) - ridge.place[1]
    s, c = math.sin(ridge.turn), math.cos(ridge.turn)
    along, across = y * c - x * s, y * s + x * c
    return np.asarray((along > ridge.start) & (along < ridge.stop) & (np.abs(across) < half))


def _sampled(energy: FloatArray, ridge: _Ridge, along: FloatArray, across: FloatArray) -> FloatArray:
    """Return the strength at distances along and across the edge, (along, across); 0 outside the picture."""
    s, c = math.sin(ridge.turn), math.cos(ridge.turn)
    y = ridge.place[0] + along[:, None] * c + across * s
    x = ridge.place[1] - along[:, None] * s + across * c
    return np.asarray(scipy.ndimage.map_coordinates(energy, [y, x], order=1, mode="constant"), np.float64)


def _centre(energy: FloatArray, row: float, column: float, turn: float) -> tuple[float, float]:
    """Return the seed (y, x), moved onto the ridge perpendicular to the edge."""
    across = np.arange(-AROUND, AROUND + 0.5, 0.5)
    strength = _sampled(energy, _Ridge((row, column), turn), np.arange(-4.0, 5.0), across).sum(0)
    move = float(across[int(strength.argmax())])
    return row + move * math.sin(turn), column + move * math.cos(turn)


def _ended(energy: FloatArray, ridge: _Ridge) -> _Ridge:
    """Return the ridge with the positions at which it ends on both sides."""
    reach = math.hypot(*energy.shape)
    along = np.arange(-math.ceil(reach), math.ceil(reach) + 1.0)
    profile = scipy.ndimage.uniform_filter(_sampled(energy, ridge, along, np.arange(-6.0, 6.5)).sum(1), 5)
    middle = len(along) // 2
    strength = float(np.median(profile[middle - 6 : middle + 7]))
    weak = np.flatnonzero(profile < ALIVE * strength)
    before, after = weak[weak < middle], weak[weak > middle]
    start = along[before[-1]] if before.size else along[0]
    stop = along[after[0]] if after.size else along[-1]
    return replace(ridge, start=float(start), stop=float(stop))


def _straightened(energy: FloatArray, ridge: _Ridge) -> _Ridge:
    """Return the ridge with the centre and direction of a line fitted to the centroids of its cross-sections."""
    along, across = ridge.along, np.arange(-6.0, 6.5)
    if along.size < 3:
        return ridge
    strength = _sampled(energy, ridge, along, across)
    weight = np.maximum(strength.sum(1), 1e-300)
    centroid, centre = (strength @ across) / weight, float(weight @ along / weight.sum())
    spread = float(weight @ (along - centre) ** 2)
    if not spread > 0:
        return ridge
    slope = float(weight @ ((along - centre) * centroid)) / spread
    shift = float(weight @ centroid / weight.sum()) - slope * centre
    s, c = math.sin(ridge.turn), math.cos(ridge.turn)
    middle = 0.5 * (ridge.start + ridge.stop)
    away = shift + slope * middle
    place = (ridge.place[0] + middle * c + away * s, ridge.place[1] - middle * s + away * c)
    return _Ridge(place, ridge.turn - math.atan(float(slope)))


def _half_width(energy: FloatArray, ridge: _Ridge) -> float:
    """Return the half width of the strip, pixels, up to which neither side of the edge has other content."""
    reach = math.ceil(math.hypot(*energy.shape))
    across = np.arange(-reach, reach + 1.0)
    seen = _sampled(energy, ridge, ridge.along, across)
    # Other content begins where a twentieth of the length shows it.
    profile = np.sort(seen, axis=0)[-max(3, seen.shape[0] // 20)]
    peak = float(profile.max())
    least = max(OTHER * peak, min(NOISE * float(np.median(energy)), 0.5 * peak))
    found = []
    for side in (profile[reach:], profile[reach::-1]):
        quiet = np.flatnonzero(side < least)
        begin = int(quiet[0]) if quiet.size else len(side)
        again = np.flatnonzero(side[begin:] >= least)
        found.append(begin + int(again[0]) - 3 if again.size else len(side))
    return float(min(found))

"""The sampled exit pupil: the exact open fraction of each cell, and the transfer function of a polygonal aperture.

In:  number of cells, shape of the aperture (circle, annulus, regular polygon with straight or rounded blades).
Out: open fractions of a square grid of cells (1), cell centres and outlines in units of the pupil radius.
Sources: areas between grid lines and arcs or edges, integrated analytically; the covariogram of a convex polygon.

Lengths are in units of the radius of the circle to which the f-number refers. A polygon has the area of that circle, so
that it passes the same light; its corners extend beyond 1 (1.0996 for six blades). An annulus has that circle as its
outer edge.
"""

from dataclasses import dataclass
from math import asin, ceil, cos, pi, sin, sqrt
from typing import Literal

import numpy as np

from etendue import require
from etendue_camera.arrays import FloatArray

Shape = Literal["circular", "annular", "polygonal"]

_FACETS = 256  # chords that approximate the arcs of rounded blades
_TURNS, _CHORDS = 256, 512  # directions and lengths of the table behind `PolygonOtf`


@dataclass(frozen=True)
class Aperture:
    """The outline of a pupil.

    Attributes
    ----------
    shape : {"circular", "annular", "polygonal"}
    obstruction : float, 1
        Radius of a dark central disc, from 0 to below 1; only an annular aperture has one.
    blades : int
        Number of blades of a polygon, 3 to 64.
    rotation : float, rad
        Rotation of the polygon from +x towards +y; at 0 a corner lies on +x.
    rounding : float, 1
        Curvature of the blades: 0 is straight, 1 is the curvature of the circle through the corners.

    Raises
    ------
    ValueError
        For values outside these ranges.
    """

    shape: Shape = "circular"
    obstruction: float = 0.0
    blades: int = 6
    rotation: float = 0.0
    rounding: float = 0.0

    def __post_init__(self) -> None:
        require.must(
            self.shape in ("circular", "annular", "polygonal"),
            "shape",
            repr(self.shape),
            "'circular', 'annular' or 'polygonal'",
        )
        require.must(0.0 <= self.obstruction < 1.0, "obstruction", self.obstruction, "at least 0 and below 1")
        require.that(
            self.shape == "annular" or self.obstruction == 0.0,
            f"obstruction is {self.obstruction}; a {self.shape} aperture is clear: use shape 'annular'",
        )
        if self.shape == "polygonal":
            polygon(self.blades, self.rotation, self.rounding)

    def outline(self) -> FloatArray | None:
        """Return the corners of a polygon, (k, 2) as y and x; None for a circle or an annulus."""
        return polygon(self.blades, self.rotation, self.rounding) if self.shape == "polygonal" else None

    def reach(self) -> float:
        """Return the largest radius of the pupil: 1 for a circle."""
        outline = self.outline()
        return 1.0 if outline is None else float(np.hypot(*outline.T).max())

    def area(self) -> float:
        """Return the open area, in units of pi."""
        return (1.0 - self.obstruction) * (1.0 + self.obstruction)


def cell_edges(samples: int, reach: float = 1.0) -> FloatArray:
    """Return the samples + 1 cell boundaries from -reach to reach, exactly symmetric about 0."""
    require.must(samples >= 2, "samples", samples, "at least 2")
    return (reach / samples) * (2.0 * np.arange(samples + 1) - samples)


def cell_centres(samples: int, reach: float = 1.0) -> FloatArray:
    """Return the centres of the cells between `cell_edges`, exactly symmetric about 0."""
    return (reach / samples) * (2.0 * np.arange(samples) + (1.0 - samples))


def amplitude(aperture: Aperture, samples: int, reach: float | None = None) -> FloatArray:
    """Return the open fraction of each pupil cell, on a grid of samples x samples cells.

    Parameters
    ----------
    aperture : Aperture
    samples : int
        Cells across the pupil, at least 2.
    reach : float, 1
        Half the side of the square covered by the cells; default: the reach of the aperture.

    Returns
    -------
    (samples, samples) array, 1
        In [0, 1], exact. The sum times the area of a cell is the area of the aperture.

    Notes
    -----
    With exact fractions the error of sums over the pupil decreases as samples^-2. With cells that are either open or
    closed it decreases irregularly as samples^-1.5, and is 10-100 times larger at 128 to 512 samples
    (`benchmarks/pupil.py`).
    Error: 1e-16 samples^2 absolute.
    """
    edges = cell_edges(samples, aperture.reach() if reach is None else reach)
    outline = aperture.outline()
    open_ = disc_cover(edges, edges, 1.0) if outline is None else polygon_cover(outline, edges, edges)
    if aperture.obstruction > 0.0:
        open_ = np.maximum(open_ - disc_cover(edges, edges, aperture.obstruction), 0.0)
    return open_


def disc_cover(y_edges: FloatArray, x_edges: FloatArray, radius: float = 1.0) -> FloatArray:
    """Return the fraction of each cell inside a disc about the origin.

    Parameters
    ----------
    y_edges : (ny + 1,) array
    x_edges : (nx + 1,) array
        Ascending; in the unit of the radius.
    radius : float
        Above 0.

    Returns
    -------
    (ny, nx) array, 1

    Raises
    ------
    ValueError
        For a radius that is not above 0.

    Notes
    -----
    The area left of x and below y is the integral over y of x clipped to the half chord sqrt(R^2 - y^2), which has a
    closed form. The area inside a cell is the second difference of this integral. Error: 2e-16 R^2 divided by the cell
    area.
    """
    require.positive("radius", radius)
    y = np.clip(np.asarray(y_edges, float), -radius, radius)[:, None]
    x = np.asarray(x_edges, float)[None, :]
    inside = np.clip(x, -radius, radius)
    half = np.sqrt((radius - inside) * (radius + inside))
    under = np.clip(y, -half, half)  # the part bounded by the line at x rather than by the arc
    arc = _half_disc(y, radius) - np.where(
        np.abs(y) < half, _half_disc(y, radius), np.copysign(_half_disc(half, radius), y)
    )
    corner = inside * under + np.sign(x) * arc
    area = np.diff(np.diff(corner, axis=0), axis=1)
    return np.clip(area / np.outer(np.diff(y_edges), np.diff(x_edges)), 0.0, 1.0)


def polygon(blades: int, rotation: float = 0.0, rounding: float = 0.0) -> FloatArray:
    """Return the outline of a regular polygon with area pi.

    Parameters
    ----------
    blades : int
        3 to 64.
    rotation : float, rad
        Rotation from +x towards +y; at 0 a corner lies on +x.
    rounding : float, 1
        Curvature of the blades relative to the circle through the corners, 0 to 1.

    Returns
    -------
    (k, 2) array
        Corners y, x, in order from +x towards +y. Rounded blades are approximated by at least 256 chords in total,
        which enclose the same area and deviate from the arcs by at most 4e-5 of the radius.

    Raises
    ------
    ValueError
        For values outside these ranges.
    """
    require.must(3 <= blades <= 64 and blades == int(blades), "blades", blades, "a whole number from 3 to 64")
    require.must(0.0 <= rounding <= 1.0, "rounding", rounding, "from 0 to 1")
    require.must(np.isfinite(rotation), "rotation", rotation, "finite")
    straight = rounding < 1e-9
    pieces = 1 if straight else ceil(_FACETS / blades)
    half = sin(pi / blades)  # half the chord between neighbouring corners on the unit circle
    t = np.linspace(-1.0, 1.0, pieces + 1)[:-1]
    if straight:
        along, out = half * t, np.full(t.shape, cos(pi / blades))
    else:
        opening = asin(rounding * half)
        along = np.sin(opening * t) / rounding
        # cos(opening t) - cos(opening) as a product
        out = cos(pi / blades) + 2.0 * np.sin(0.5 * opening * (1.0 + t)) * np.sin(0.5 * opening * (1.0 - t)) / rounding
    turn = rotation + pi / blades * (1.0 + 2.0 * np.arange(blades))[:, None]
    y, x = (out * np.sin(turn) + along * np.cos(turn)).ravel(), (out * np.cos(turn) - along * np.sin(turn)).ravel()
    area = 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    return np.stack([y, x], axis=1) * sqrt(pi / area)


def polygon_cover(outline: FloatArray, y_edges: FloatArray, x_edges: FloatArray) -> FloatArray:
    """Return the fraction of each cell inside a convex polygon.

    Parameters
    ----------
    outline : (k, 2) array
        Corners y, x in order.
    y_edges, x_edges : (ny + 1,) and (nx + 1,) arrays
        Ascending; in the unit of the outline.

    Returns
    -------
    (ny, nx) array, 1

    Notes
    -----
    Between neighbouring corners and grid lines both borders are straight, so the area left of x is quadratic there.
    Error: 1e-15 divided by the cell area.
    """
    y_edges, x_edges = np.asarray(y_edges, float), np.asarray(x_edges, float)
    low, high = max(outline[:, 0].min(), y_edges[0]), min(outline[:, 0].max(), y_edges[-1])
    lines = np.unique(np.clip(np.concatenate([y_edges, outline[:, 0]]), low, high))
    left, right = _borders(outline, lines)
    heights = np.diff(lines)[:, None]
    strips = heights * (_mean_below(right, x_edges) - _mean_below(left, x_edges))
    area = np.zeros((y_edges.size - 1, x_edges.size - 1))
    row = np.clip(np.searchsorted(y_edges, 0.5 * (lines[1:] + lines[:-1])) - 1, 0, y_edges.size - 2)
    np.add.at(area, row, np.diff(strips, axis=1))
    return np.clip(area / np.outer(np.diff(y_edges), np.diff(x_edges)), 0.0, 1.0)


class PolygonOtf:
    """Transfer function of a clear polygonal pupil in focus, from the overlap with its shifted copy.

    Parameters
    ----------
    blades, rotation, rounding
        As for `polygon`.

    Notes
    -----
    Source: the overlap of a convex figure with itself, shifted by s along a direction, is the integral of max(0, L - s)
    over its parallel chords of length L. L is linear between corners, so the integral is exact. Values are tabulated
    for 256 directions of one angular period, and interpolated linearly between directions and cubically in s over the
    largest chord.
    Error: 6e-6 absolute for 3 to 64 blades (measured against the exact integral).
    """

    def __init__(self, blades: int, rotation: float = 0.0, rounding: float = 0.0) -> None:
        outline = polygon(blades, rotation, rounding)
        self.rotation = rotation  # the values have kinks in the directions of corners, which the table hits exactly
        self.period = np.pi / blades * (1 if blades % 2 else 2)
        self.longest = np.empty(_TURNS + 2)
        self.table = np.empty((_TURNS + 2, _CHORDS + 1))
        for i in range(_TURNS):
            lines, chords = _chords(outline, rotation + self.period * i / _TURNS)
            self.longest[i] = chords.max()
            self.table[i] = _shared(lines, chords, self.longest[i] * np.arange(_CHORDS + 1) / _CHORDS)
        self.table[:_TURNS] /= self.table[:_TURNS, :1]
        for values in (self.longest, self.table):
            values[_TURNS:] = values[:2]

    def __call__(self, nu_y: FloatArray, nu_x: FloatArray) -> FloatArray:
        """Return the transfer function at frequencies in units of 1/(lambda N), arrays that broadcast; 0 beyond the
        cut-off.
        """
        return self.at(2.0 * np.hypot(nu_y, nu_x), self.place(nu_y, nu_x))

    def place(self, nu_y: FloatArray, nu_x: FloatArray) -> FloatArray:
        """Return the position of a direction in the table, [0, 256]; it is the same at every wavelength."""
        return np.mod(np.arctan2(nu_y, nu_x) - self.rotation, self.period) * (_TURNS / self.period)

    def at(self, shift: FloatArray, place: FloatArray) -> FloatArray:
        """Return the transfer function at shifts (pupil radii) in directions given by their `place`, arrays of the same
        shape.
        """
        found = np.zeros(shift.shape)
        base = np.minimum(place.astype(np.intp), _TURNS)
        part = place - base
        longest = self.longest[base] * (1.0 - part) + self.longest[base + 1] * part
        inside = shift < longest
        rows, weight = base[inside], part[inside]
        total = np.zeros(rows.shape)
        for offset, share in ((0, 1.0 - weight), (1, weight)):
            # scale by the largest chord of each direction, so that the cut-off stays sharp
            column = np.minimum(shift[inside] / self.longest[rows + offset], 1.0) * _CHORDS
            first = np.clip(column.astype(np.intp) - 1, 0, _CHORDS - 3)
            flat = (rows + offset) * (_CHORDS + 1) + first
            t = column - first
            values = [np.take(self.table.reshape(-1), flat + k) for k in range(4)]
            total += share * sum(w * v for w, v in zip(lagrange_weights(t, 4), values, strict=True))
        found[inside] = np.clip(total, 0.0, 1.0)
        return np.where(shift == 0.0, 1.0, found)


def lagrange_weights(t: FloatArray, points: int) -> list[FloatArray]:
    """Return the weights with which values at 0, 1, ... points - 1 are interpolated at t by a polynomial."""
    weights = []
    for k in range(points):
        weight = np.ones_like(t)
        for other in range(points):
            if other != k:
                weight = weight * ((t - other) / (k - other))
        weights.append(weight)
    return weights


def _half_disc(y: FloatArray, radius: float) -> FloatArray:
    """Return the integral of sqrt(R^2 - t^2) from 0 to y."""
    y = np.clip(y, -radius, radius)
    return 0.5 * (y * np.sqrt((radius - y) * (radius + y)) + radius * radius * np.arcsin(y / radius))


def _borders(outline: FloatArray, lines: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and largest x of a convex outline, ordered from +x towards +y, on each line of constant y."""
    y, x = outline.T
    bottom, top = (np.flatnonzero(np.abs(y - end) < 1e-12) for end in (y.min(), y.max()))
    right, left = (
        _walk(outline, bottom[np.argmax(x[bottom])], top[np.argmax(x[top])]),
        _walk(outline, top[np.argmin(x[top])], bottom[np.argmin(x[bottom])])[::-1],
    )
    return np.interp(lines, *left.T), np.interp(lines, *right.T)


def _walk(outline: FloatArray, start: np.intp, stop: np.intp) -> FloatArray:
    """Return the corners from index ``start`` to index ``stop``, in order around the outline."""
    count = (stop - start) % len(outline) + 1
    return outline[(start + np.arange(count)) % len(outline)]


def _mean_below(border: FloatArray, x: FloatArray) -> FloatArray:
    """Return the mean over each strip of min(x, border), where the border is straight between the two lines of the
    strip.
    """
    low, high = (pick(border[:-1], border[1:])[:, None] for pick in (np.minimum, np.maximum))
    over = np.clip(x, low, high) - low
    width = np.where(high > low, high - low, 1.0)
    return x - 0.5 * over * over / width - np.maximum(x - high, 0.0)


def _chords(outline: FloatArray, angle: float) -> tuple[FloatArray, FloatArray]:
    """Return the offset of every corner across a direction, and the chord length there along it; linear between
    corners.
    """
    turned_y = outline[:, 0] * cos(angle) - outline[:, 1] * sin(angle)
    turned_x = outline[:, 0] * sin(angle) + outline[:, 1] * cos(angle)
    lines = np.unique(turned_y)
    left, right = _borders(np.stack([turned_y, turned_x], axis=1), lines)
    return lines, np.maximum(right - left, 0.0)


def _shared(lines: FloatArray, chords: FloatArray, shifts: FloatArray) -> FloatArray:
    """Return the integral over the lines of max(0, chord - shift)."""
    low, high = (pick(chords[:-1], chords[1:])[:, None] for pick in (np.minimum, np.maximum))
    over = np.clip(high - shifts, 0.0, high - low)
    width = np.where(high > low, high - low, 1.0)
    return np.diff(lines) @ (0.5 * over * over / width + np.maximum(low - shifts, 0.0))

"""Synthetic test charts: reflectance as a function of position, softened by a known Gaussian.

In:  positions y (ny,) and x (nx,) on the image plane (um, 0 in the centre), geometry (um), reflectances.
Out: reflectance (ny, nx), dimensionless, in the dtype of y and x, within the range of the requested levels.
Sources: ISO 12233 (slanted edge, star, wedge), Loebich et al. (2007) (sinusoidal star); Gaussian softening
in closed form.

All charts take positions and a ``Rendering``, and raise ``ValueError`` for an argument outside its range. Softening is
exact for straight edges and Gaussian spots: slanted edge, step wedge, points, patches. For the star and the zone plate,
contrast is multiplied by the transfer at the local frequency, and the rim is softened as if it were straight; each
docstring gives the error relative to the exact convolution.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from etendue import require
from etendue_camera.arrays import FloatArray
from etendue_camera.scene import cell_means

# ------------------------------------------------------------------------------------------ shared pieces


def require_axes(y: npt.ArrayLike, x: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return y and x as floating arrays of one dtype; raise ValueError unless each is one axis of finite positions."""
    y, x = np.asarray(y), np.asarray(x)
    for name, axis in (("y", y), ("x", x)):
        require.that(
            axis.ndim == 1 and axis.size != 0 and np.all(np.isfinite(axis)),
            f"{name} must be one axis of finite positions [um], got shape {axis.shape}",
        )
    dtype = np.result_type(y, x)
    dtype = dtype if np.issubdtype(dtype, np.floating) else np.dtype(np.float64)
    return y.astype(dtype, copy=False), x.astype(dtype, copy=False)


def require_spot_distance(spacing: float, rms_width: float) -> None:
    if spacing < 6 * rms_width:
        raise ValueError(f"spacing must be at least six softened rms widths, {6 * rms_width:g} um, got {spacing} um")


def require_levels(low: float, high: float) -> None:
    require.that(0 <= low <= high < np.inf, f"low and high must satisfy 0 <= low <= high, got low={low}, high={high}")


def require_positive(**lengths: float) -> None:
    for name, value in lengths.items():
        require.that(0 < value < np.inf, f"{name} must be finite and above 0, got {value}")


@dataclass(frozen=True)
class Rendering:
    """How a chart is rendered: its softness, samples or cell means, and its two reflectances.

    Attributes
    ----------
    softness : float, um
        Rms width sigma of the Gaussian with which the ideal chart is convolved. The chart's own transfer is then
        exp(-2 pi^2 sigma^2 f^2), and can be divided out of a measurement; 0 leaves it ideal.
    cell : float, um
        Side of the grid cells over which values are averaged; 0 gives values at points.
    low, high : float, reflectance, 0 <= low <= high
        Reflectance of the darkest and the lightest part, before softening.
    """

    softness: float
    cell: float = 0.0
    low: float = 0.0
    high: float = 1.0

    def __post_init__(self) -> None:
        require_levels(self.low, self.high)
        for name, value in (("softness", self.softness), ("cell", self.cell)):
            require.that(0 <= value < np.inf, f"{name} must be finite and not negative, got {value} um")

    def blend(self, fraction: FloatArray) -> FloatArray:
        """Return low where fraction is 0, and high where it is 1; rounding never exceeds these."""
        low, high = float(self.low), float(self.high)  # numpy scalars would promote float32 positions to float64
        return np.clip(low + (high - low) * fraction, low, high)


def soft_step(distance: FloatArray, softness: float, cell: float = 0.0) -> FloatArray:
    """Return the unit step after softening: 0 far below 0, 1 far above it, and 1/2 at 0 even if softness is 0."""
    if cell > 0:
        return cell_means.step_mean(distance, softness, cell)
    if softness == 0:
        return np.heaviside(distance, distance.dtype.type(0.5))
    with np.errstate(over="ignore"):
        return scipy.special.ndtr(distance / float(softness))


def soft_box(position: FloatArray, start: float, stop: float, softness: float, cell: float = 0.0) -> FloatArray:
    """Return 1 between start and stop, 0 outside, after softening. Adjacent boxes add up to one box."""
    rise = soft_step(position - float(start), softness, cell)
    fall = soft_step(position - float(stop), softness, cell)
    return np.maximum(rise - fall, 0)


# ------------------------------------------------------------------------------------------------ charts


def slanted_edge(
    y: npt.ArrayLike, x: npt.ArrayLike, angle_deg: float, drawn: Rendering, offset: float = 0.0
) -> FloatArray:
    """Return a straight edge, dark on the left and light on the right.

    Parameters
    ----------
    y, x : (ny,), (nx,) arrays, um
    angle_deg : float, degrees, between -90 and 90
        Tilt from the column direction: the edge is the line x = offset + y tan(angle).
    drawn : Rendering
    offset : float, um
        Position at which the edge crosses y = 0.

    Returns
    -------
    (ny, nx) array, reflectance

    Notes
    -----
    Exact: along the normal the profile is the integral of a Gaussian of rms width softness. Means over cells are
    also exact, to 3.2e-10 of the contrast (worst at tilts of 1e-5 degrees): for a hard edge, the area of the half plane
    in each square.
    """
    y, x = require_axes(y, x)
    require.that(-90 < angle_deg < 90, f"angle_deg must lie between -90 and 90 degrees, got {angle_deg}")
    require.that(np.isfinite(offset), f"offset must be finite, got {offset} um")
    angle = np.deg2rad(float(angle_deg))
    distance = (x - float(offset)) * float(np.cos(angle)) - y[:, None] * float(np.sin(angle))
    if drawn.cell > 0:
        return drawn.blend(cell_means.half_plane_mean(distance, float(angle), drawn.softness, drawn.cell))
    return drawn.blend(soft_step(distance, drawn.softness))


def siemens_star(y: npt.ArrayLike, x: npt.ArrayLike, cycles: int, radius: float, drawn: Rendering) -> FloatArray:
    """Return a star whose reflectance is a sinusoid of the angle; mid-grey beyond its radius.

    Parameters
    ----------
    y, x : (ny,), (nx,) arrays, um
    cycles : int, above 0
        Periods per turn. The positive x axis is light.
    radius : float, um, above 0
    drawn : Rendering

    Returns
    -------
    (ny, nx) array, reflectance; (low + high) / 2 at the centre

    Notes
    -----
    Local approximation: contrast at distance r is exp(-2 pi^2 softness^2 f^2) with f = cycles / (2 pi r). The exact
    convolution of an endless star has a contrast given by a pair of Bessel functions; the approximation differs from it
    by less than 1 / cycles^2 (1 to 288 cycles, all radii): 7.6e-4 for 36 cycles. Means over cells are quadratures, see
    ``cell_means.averaged``.
    """
    y, x = require_axes(y, x)
    require_positive(cycles=cycles, radius=radius)
    require.that(cycles == int(cycles), f"cycles must be a whole number, or the star has a seam; got {cycles}")

    def wave(v: FloatArray, u: FloatArray) -> FloatArray:
        distance, angle = np.hypot(v, u), np.arctan2(v, u)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            contrast = np.exp(-0.5 * (float(drawn.softness) * int(cycles) / distance) ** 2)
        contrast = np.where(distance > 0, contrast, 0)
        return np.cos(int(cycles) * angle) * contrast * soft_step(float(radius) - distance, drawn.softness)

    return drawn.blend(0.5 + 0.5 * _painted(wave, y, x, drawn.cell))


def _painted(paint: cell_means.Paint, y: FloatArray, x: FloatArray, cell: float) -> FloatArray:
    return cell_means.averaged(paint, y, x, cell) if cell > 0 else paint(y[:, None], x[None, :])


def zone_plate(
    y: npt.ArrayLike, x: npt.ArrayLike, highest_frequency: float, radius: float, drawn: Rendering
) -> FloatArray:
    """Return rings whose frequency is proportional to the distance from the centre; mid-grey beyond the radius.

    Parameters
    ----------
    y, x : (ny,), (nx,) arrays, um
    highest_frequency : float, cycles/um, above 0
        Local frequency at ``radius``. The centre of the plate is light.
    radius : float, um, above 0
    drawn : Rendering

    Returns
    -------
    (ny, nx) array, reflectance

    Notes
    -----
    Local approximation: the phase is pi highest_frequency r^2 / radius and the contrast
    exp(-2 pi^2 softness^2 f^2) with f = highest_frequency r / radius. The exact convolution of an endless plate is
    exp(q) / (1 - i c) with q = i b r^2 / (1 - i c), b = pi highest_frequency / radius and c = 2 b softness^2; the wave
    differs from it by less than c (c from 1e-3 to 0.5).
    The phase is computed in float64 for any dtype. Means over cells are quadratures, see
    ``cell_means.averaged``.
    """
    y, x = require_axes(y, x)
    require_positive(highest_frequency=highest_frequency, radius=radius)

    def wave(v: FloatArray, u: FloatArray) -> FloatArray:
        squared = v**2 + u**2
        frequency = highest_frequency / radius * np.sqrt(squared)
        contrast = np.exp(-2.0 * (np.pi * drawn.softness * frequency) ** 2)
        return (
            np.cos(np.pi * highest_frequency / radius * squared)
            * contrast
            * soft_step(radius - np.sqrt(squared), drawn.softness)
        )

    found = _painted(wave, y.astype(np.float64), x.astype(np.float64), drawn.cell)
    return drawn.blend((0.5 + 0.5 * found).astype(x.dtype))


def step_wedge(
    y: npt.ArrayLike, x: npt.ArrayLike, levels: npt.ArrayLike, width: float, height: float, drawn: Rendering
) -> FloatArray:
    """Return vertical bars of equal width, one per level from left to right.

    Parameters
    ----------
    y, x : (ny,), (nx,) arrays, um
    levels : (k,) array, reflectance, not negative
    width, height : float, um, above 0
        Size of all bars together. Beyond them the reflectance is the mean of the levels.
    drawn : Rendering
        Its low and high are ignored; the levels apply instead.

    Returns
    -------
    (ny, nx) array, reflectance

    Notes
    -----
    Exact, also for means over cells: the reflectance is a product of integrals of Gaussians.
    """
    y, x = require_axes(y, x)
    require_positive(width=width, height=height)
    level = np.asarray(levels, dtype=x.dtype)
    require.that(
        level.ndim == 1 and level.size != 0 and np.all(np.isfinite(level)) and not np.any(level < 0),
        f"levels must be one row of finite reflectances, none negative, got {levels!r}",
    )
    borders = width * (np.arange(level.size + 1) / level.size - 0.5)
    mean = level.mean(dtype=np.float64).astype(x.dtype)
    profile = np.zeros_like(x)
    for value, start, stop in zip(level, borders[:-1], borders[1:], strict=True):
        profile = profile + (value - mean) * soft_box(x, start, stop, drawn.softness, drawn.cell)
    across = soft_box(y, -0.5 * height, 0.5 * height, drawn.softness, drawn.cell)
    return np.clip(mean + across[:, None] * profile, level.min(), level.max())


def points(y: npt.ArrayLike, x: npt.ArrayLike, spacing: float, spot_sigma: float, drawn: Rendering) -> FloatArray:
    """Return a square grid of light Gaussian spots, one of them in the centre.

    Parameters
    ----------
    y, x : (ny,), (nx,) arrays, um
    spacing : float, um
        Distance between neighbours; at least six times the softened rms width, so that spots stay separate.
    spot_sigma : float, um, above 0
        Rms width of a spot before softening.
    drawn : Rendering
        low between the spots, high in their centres; cells of at most ``spacing``.

    Returns
    -------
    (ny, nx) array, reflectance
        Spots lie at whole multiples of ``spacing`` inside the frame that y and x span.

    Notes
    -----
    Exact: the rms width becomes w = sqrt(spot_sigma^2 + softness^2) and the height falls by
    (spot_sigma / w)^2, so that a spot keeps its volume. Neighbours add at most 6e-8 of the height. Means over cells
    are also exact, however narrow the spot is.
    """
    y, x = require_axes(y, x)
    require_positive(spacing=spacing, spot_sigma=spot_sigma)
    spacing, rms_width = float(spacing), float(np.hypot(spot_sigma, drawn.softness))
    require_spot_distance(spacing, rms_width)
    require.that(not drawn.cell > spacing, f"cell must be at most the spacing, {spacing} um, got {drawn.cell} um")
    fraction = _row_of_spots(y, spacing, rms_width, drawn.cell)[:, None] * _row_of_spots(
        x, spacing, rms_width, drawn.cell
    )
    return drawn.blend(float(spot_sigma / rms_width) ** 2 * fraction)


def _row_of_spots(position: FloatArray, spacing: float, rms_width: float, cell: float) -> FloatArray:
    first, last = np.ceil((position.min() - 0.5 * cell) / spacing), np.floor((position.max() + 0.5 * cell) / spacing)
    nearest = np.round(position / spacing)
    total = np.zeros_like(position)
    for step in (-1, 0, 1):  # the second neighbours are at least nine rms widths away
        index = nearest + step
        away = position - index * spacing
        spot = cell_means.spot_mean(away, rms_width, cell) if cell > 0 else np.exp(-0.5 * (away / rms_width) ** 2)
        total = total + np.where((index >= first) & (index <= last), spot, 0)
    return total

"""Geometric distortion and lateral colour: real image positions, and planes resampled to them.

In:  ideal image heights (um), coefficients or a table of real heights by wavelength; planes on the image grid.
Out: real heights, their inverse, distortion in per cent; planes with every point at its real position.
Sources: radial distortion as a power series (Brown, Photogrammetric Engineering 32, 444, 1966; Conrady 1919); B-spline
interpolation (Unser, IEEE Signal Processing Magazine 16(6), 22, 1999).

Values are moved without regard to the change of area: the lens images radiance, so a uniform scene stays uniform under
any distortion. Falloff of illumination at the real image position is modelled elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from etendue import plain_files, require
from etendue_camera.arrays import FloatArray, Floats

_ROWS = 256  # rows of a plane resampled at a time, to bound the memory of double-precision coordinates
BORDER = 1e-6  # relative to the frame's rms, measured: at the border, light is mirrored here but padded in a transform
_ALIASES = 64  # aliases of a wave in a spline, to either side; those beyond add less than 1e-2 of the sum for order 1
_NODES = 1025  # nodes of the spline through the ratio of ideal to real height
ORDERS = (1, 2, 3, 4, 5)
Table = tuple[FloatArray, FloatArray, FloatArray]  # ideal heights (n,), wavelengths (L,), real heights (n, L), um


@dataclass(frozen=True, eq=False)
class DistortionCurve:
    """Real image height as a function of the ideal height and the wavelength.

    Attributes
    ----------
    coefficients : (k1, k2, k3), 1
        r' = r (1 + k1 q + k2 q^2 + k3 q^3) with q = (r / reference_um)^2. Negative k1 is barrel distortion.
    reference_um : float, um
        Above 0.
    lateral_colour : float, 1
        Relative change of the real height per 100 nm above ``reference_wavelength_um``; applied to a table as well.
    reference_wavelength_um : float, um
    table : (ideal_um (n,), wavelengths_um (L,), real_um (n, L)) or None
        Replaces the coefficients; both heights ascend from (0, 0). Interpolated by cubic splines (odd about the axis)
        between heights, and linearly in 1/wavelength^2 between wavelengths; outside the table's wavelengths the nearest
        wavelength applies. Beyond the last height the curves continue along their tangents.

    Raises
    ------
    ValueError
        For coefficients or heights that are not finite, lengths that are not above 0, or tables that do not ascend.
    """

    coefficients: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reference_um: float = 1000.0
    lateral_colour: float = 0.0
    reference_wavelength_um: float = 0.55
    table: Table | None = None

    def __post_init__(self) -> None:
        require.that(
            len(self.coefficients) == 3 and all(map(math.isfinite, self.coefficients)),
            f"coefficients are {self.coefficients}; they must be three finite numbers",
        )
        for name, value in (
            ("reference_um", self.reference_um),
            ("reference_wavelength_um", self.reference_wavelength_um),
        ):
            require.must(0.0 < value < math.inf, name, value, "finite and above 0 um")
        require.must(math.isfinite(self.lateral_colour), "lateral_colour", self.lateral_colour, "finite")
        if self.table is None:
            return
        require.that(not any(self.coefficients), "coefficients and a table are both given; give only one of them")
        ideal, wavelengths, real = _checked_table(self.table)
        curve = scipy.interpolate.CubicSpline(np.r_[-ideal[:0:-1], ideal], np.r_[-real[:0:-1], real], axis=0)
        object.__setattr__(self, "table", (ideal, wavelengths, real))
        object.__setattr__(self, "_curve", curve)

    def does_nothing(self) -> bool:
        return self.table is None and not any(self.coefficients) and self.lateral_colour == 0

    def scale(self, wavelength_um: float) -> float:
        """Return the image scale due to lateral colour; exactly 1 at the reference wavelength."""
        scale = 1.0 + self.lateral_colour * (wavelength_um - self.reference_wavelength_um) / 0.1
        require.that(scale > 0, f"lateral_colour {self.lateral_colour:g} inverts the image at {wavelength_um:g} um")
        return scale

    def distort(self, radius_um: Floats, wavelength_um: float) -> Floats:
        """Return the real heights of ideal heights, um; odd in the radius."""
        radius = np.asarray(radius_um, dtype=float)
        if self.table is None:
            k1, k2, k3 = self.coefficients
            q = (radius / self.reference_um) ** 2
            return self.scale(wavelength_um) * radius * (1.0 + q * (k1 + q * (k2 + q * k3)))
        last = self.table[0][-1]
        inside = np.clip(radius, -last, last)
        real, slope = self._columns(inside, wavelength_um, 0), self._columns(np.array(last), wavelength_um, 1)
        return self.scale(wavelength_um) * (real + slope * (radius - inside))

    def slope(self, radius_um: Floats, wavelength_um: float) -> Floats:
        """Return the derivative of the real height with respect to the ideal height, 1."""
        radius = np.asarray(radius_um, dtype=float)
        if self.table is None:
            k1, k2, k3 = self.coefficients
            q = (radius / self.reference_um) ** 2
            return self.scale(wavelength_um) * (1.0 + q * (3 * k1 + q * (5 * k2 + q * 7 * k3)))
        last = self.table[0][-1]
        return self.scale(wavelength_um) * self._columns(np.clip(radius, -last, last), wavelength_um, 1)

    def _columns(self, radius: FloatArray, wavelength_um: float, derivative: int) -> FloatArray:
        assert self.table is not None
        inverse = self.table[1] ** -2.0
        values = self._curve(radius, derivative)  # type: ignore[attr-defined]
        if inverse.size == 1:
            return values[..., 0]
        high = int(np.clip(np.searchsorted(-inverse, -(wavelength_um**-2.0)), 1, inverse.size - 1))
        share = float(
            np.clip((inverse[high - 1] - wavelength_um**-2.0) / (inverse[high - 1] - inverse[high]), 0.0, 1.0)
        )
        return (1 - share) * values[..., high - 1] + share * values[..., high]

    def percent(self, radius_um: Floats, wavelength_um: float) -> Floats:
        """Return the distortion 100 (r' / r - 1) in per cent; on the axis, its limit."""
        radius = np.asarray(radius_um, dtype=float)
        safe = np.where(radius == 0, 1.0, radius)
        return 100.0 * (
            np.where(radius == 0, self.slope(0.0, wavelength_um), self.distort(safe, wavelength_um) / safe) - 1.0
        )

    def folds_at(self, wavelength_um: float) -> float:
        """Return the ideal height at which the real height stops increasing, um; inf where it never does."""
        if self.table is None:
            k1, k2, k3 = self.coefficients
            roots = np.roots(np.trim_zeros(np.array([7 * k3, 5 * k2, 3 * k1, 1.0]), "f"))
            real = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)]
            return self.reference_um * math.sqrt(real.min()) if real.size else math.inf
        radius = np.linspace(0.0, self.table[0][-1], 16 * self.table[0].size)
        slope = self.slope(radius, wavelength_um)
        return float(radius[np.argmax(slope <= 0)]) if np.any(slope <= 0) else math.inf

    def undistort(self, real_um: Floats, wavelength_um: float) -> Floats:
        """Return the ideal heights of real heights, um: the inverse of ``distort``.

        Raises
        ------
        ValueError
            If no ideal height below the fold of the image has this real height.

        Notes
        -----
        Bracketed Newton iteration, accurate to a few units in the last place.
        """
        real = np.asarray(real_um, dtype=float)
        size = np.abs(real)
        largest = float(size.max(initial=0.0))
        fold = self.folds_at(wavelength_um)
        high = min(fold, 2.0 * max(largest, 1e-300) / float(self.slope(0.0, wavelength_um)))
        while high < fold and self.distort(high, wavelength_um) < largest:
            high = min(2.0 * high, fold)
        if high == fold and self.distort(fold, wavelength_um) <= largest:
            raise ValueError(
                f"distortion folds the image over {fold:.6g} um from the axis, at a real height of "
                f"{float(self.distort(fold, wavelength_um)):.6g} um, but the image reaches {largest:.6g} um; use "
                f"weaker coefficients"
            )
        low, top = np.zeros(size.shape), np.full(size.shape, high)
        ideal = np.minimum(size / float(self.slope(0.0, wavelength_um)), high)
        for _ in range(100):
            off = self.distort(ideal, wavelength_um) - size
            low, top = np.where(off < 0, ideal, low), np.where(off >= 0, ideal, top)
            with np.errstate(divide="ignore", invalid="ignore"):
                step = ideal - off / self.slope(ideal, wavelength_um)
            better = np.where((step >= low) & (step <= top), step, 0.5 * (low + top))
            if np.all(np.abs(better - ideal) <= 2e-16 * np.abs(better)):
                break
            ideal = better
        return np.copysign(ideal, real)

    def ratio(self, largest_um: float, wavelength_um: float) -> Callable[[FloatArray], FloatArray]:
        """Return ideal over real height as a function of the squared real height, up to ``largest_um``.

        A cubic spline through 1025 exact values: within 1e-11 of ``undistort`` for 30 per cent of distortion.
        """
        if self.table is None and not any(self.coefficients):
            same = 1.0 / self.scale(wavelength_um)
            return lambda square: np.full(np.shape(square), same)
        square = np.linspace(0.0, max(largest_um, 1e-6) ** 2, _NODES)
        real = np.sqrt(square)
        real[0] = 1.0
        values = self.undistort(real, wavelength_um) / real
        values[0] = 1.0 / float(self.slope(0.0, wavelength_um))
        return scipy.interpolate.CubicSpline(square, values)


def _checked_table(table: Table) -> Table:
    """Return the table with a row at 0; raise ValueError where heights do not ascend."""
    ideal, wavelengths, real = (np.array(a, dtype=float) for a in table)
    require.that(
        ideal.ndim == 1
        and wavelengths.ndim == 1
        and real.shape == (ideal.size, wavelengths.size)
        and ideal.size >= 2
        and wavelengths.size,
        f"table has {ideal.shape} ideal heights, {wavelengths.shape} wavelengths and real heights of shape "
        f"{real.shape}",
    )
    require.that(
        all(np.isfinite(a).all() for a in (ideal, wavelengths, real))
        and (np.all(np.diff(wavelengths) > 0) and wavelengths[0] > 0),
        "table must be finite, its wavelengths above 0 and ascending",
    )
    if ideal[0] > 0:
        ideal, real = np.insert(ideal, 0, 0.0), np.insert(real, 0, 0.0, axis=0)
    require.that(
        ideal[0] == 0
        and not np.any(real[0] != 0)
        and (np.all(np.diff(ideal) > 0) and np.all(np.diff(real, axis=0) > 0)),
        "ideal and real heights in table must ascend from 0 on the axis: otherwise the image folds over",
    )
    return ideal, wavelengths, real


def read_table(path: str | Path) -> Table:
    """Read the table of a ``DistortionCurve`` from a CSV file; return heights in um.

    The first line is ``ideal_um`` (or ``ideal_mm``) followed by wavelengths in nm. Each further line holds an ideal
    height and the real heights at these wavelengths, in the same unit.
    """
    path = Path(path)
    rows = [
        line.split(",")
        for line in plain_files.table(path).decode("utf-8").splitlines()
        if line.strip() and not line.startswith("#")
    ]
    head = [cell.strip() for cell in rows[0]] if rows else [""]
    require.that(
        head[0] in ("ideal_um", "ideal_mm") and len(head) >= 2 and len(rows) >= 2,
        f"{path}: the first line must be ideal_um (or ideal_mm) and wavelengths in nm, such as ideal_um,450,550,650",
    )
    try:
        wavelengths = np.array([float(cell) for cell in head[1:]])
        values = np.array([[float(cell) for cell in row] for row in rows[1:]])
        if values.shape[1] != len(head):
            raise ValueError(f"lines have {values.shape[1]} numbers")
    except ValueError as error:
        raise ValueError(f"{path}: {error}; every line needs {len(head)} numbers") from None
    order = np.argsort(wavelengths)
    values = values * (1e3 if head[0] == "ideal_mm" else 1.0)
    return values[:, 0], wavelengths[order] * 1e-3, values[:, 1:][:, order]


def radial(
    plane: FloatArray,
    y_um: FloatArray,
    x_um: FloatArray,
    ratio: Callable[[FloatArray], FloatArray],
    order: int = 5,
    oversampling: int = 1,
) -> FloatArray:
    """Resample a plane radially: each value is read at its position multiplied by ``ratio(r^2)``.

    Parameters
    ----------
    plane : (Y, X) array, any unit
        float32 stays float32.
    y_um, x_um : (Y,), (X,) arrays, um
        Evenly spaced positions relative to the axis.
    ratio : function
        Source radius over real radius, as a function of the squared real radius in um2.
    order : int
        Order of the B-spline, 1 to 5.
    oversampling : int
        Factor by which the plane is oversampled by cosine transform before the spline is fitted, 1 to 8.

    Returns
    -------
    (Y, X) array
        Beyond the border the plane is continued by its mirror image. A uniform plane is returned bit-identical.

    Raises
    ------
    ValueError
        For an order or an oversampling out of range.

    Notes
    -----
    For a band-limited plane the error decreases with the power order + 1 of the spacing; see ``edge_error``.
    """
    require.must(order in ORDERS, "order", order, "from 1 to 5")
    require.must(1 <= oversampling <= 8, "oversampling", oversampling, "from 1 to 8")
    plane = np.asarray(plane)
    base = plane.min()
    table = np.asarray(plane - base, dtype=float)  # a uniform plane stays uniform, whatever the weights sum to
    if oversampling > 1:
        fine = tuple(n * oversampling for n in table.shape)
        wide = np.zeros(fine)
        wide[: table.shape[0], : table.shape[1]] = scipy.fft.dctn(table, norm="ortho", workers=1)
        table = scipy.fft.idctn(wide, norm="ortho", workers=1, overwrite_x=True) * oversampling
    if order > 1:
        table = scipy.ndimage.spline_filter(table, order=order, output=np.float64, mode="reflect")
    starts = [float(line[0]) for line in (y_um, x_um)]
    steps = [float(line[-1] - line[0]) / (line.size - 1) if line.size > 1 else 1.0 for line in (y_um, x_um)]
    out = np.empty(plane.shape, dtype=float)
    for first in range(0, plane.shape[0], _ROWS):
        y = y_um[first : first + _ROWS, None]
        factor = ratio(y * y + x_um * x_um)
        where = np.stack([(factor * y - starts[0]) / steps[0], (factor * x_um - starts[1]) / steps[1]])
        where = (where + 0.5) * oversampling - 0.5
        out[first : first + _ROWS] = scipy.ndimage.map_coordinates(
            table, where, order=order, mode="reflect", prefilter=False
        )
    return (out + base).astype(plane.dtype if plane.dtype in (np.float32, np.float64) else float)


def wave_error(order: int, cycles: FloatArray, oversampling: int = 1) -> FloatArray:
    """Return the largest error of ``radial`` for a wave, at any position and in any direction, relative to its
    amplitude.

    Parameters
    ----------
    order, oversampling : int
        As of ``radial``.
    cycles : (n,) array
        Frequency of the wave, cycles/sample before oversampling; along the axes at most 0.5 is represented.

    Returns
    -------
    (n,) array

    Notes
    -----
    Along one axis, a spline of order n through a wave of u cycles/sample is the sum of the waves u + k with amplitudes
    s(u + k) / sum s, s = sinc^(n + 1) (Unser, section IV). The error is bounded by the missing amplitude of the wave
    itself plus the sum of all other amplitudes. Errors of both axes add; the result is the larger of the errors along
    one axis and along the diagonal, where each axis has a lower frequency.
    """

    def along(u: FloatArray) -> FloatArray:
        terms = np.sinc(np.minimum(u, 0.5)[:, None] / oversampling + np.arange(-_ALIASES, _ALIASES + 1)) ** (order + 1)
        others = np.abs(terms.sum(axis=1) - terms[:, _ALIASES]) + np.abs(terms).sum(axis=1) - terms[:, _ALIASES]
        return np.asarray(others / terms.sum(axis=1))

    one, each = along(np.asarray(cycles, dtype=float)), along(np.asarray(cycles) / math.sqrt(2))
    return np.maximum(one, each * (2 + each))


def edge_error(order: int, softness: float, oversampling: int = 1) -> float:
    """Return the largest error of ``radial`` near a Gaussian edge of rms width ``softness`` (samples), relative to its
    contrast.

    An upper bound, fitted to slanted edges of 0.7 to 4 samples moved by up to a sample: for orders 1, 3 and 5 at 1
    sample 3e-2, 3e-3, 1e-3, at 2 samples 7e-3, 1e-4, 5e-6. The last two terms account for detail that the samples
    cannot represent, and for the kink of the mirror image at the border, which a spline without oversampling follows
    badly: up to 2e-5 rms over small frames of textures.
    """
    share = (0.033, 0.0085, 0.0045, 0.0026, 0.0017)[order - 1] * (softness * oversampling) ** -(order + 1)
    return share + 0.1 * math.exp(-0.5 * (math.pi * softness) ** 2) + (4e-6 if oversampling > 1 else 3e-5)


def missing_um(
    y_um: tuple[float, float], x_um: tuple[float, float], distortion: DistortionCurve, wavelength_um: float
) -> float:
    """Return how far the distorted frame extends beyond the rendered light, um; 0 if the rendered light covers it.

    ``y_um`` and ``x_um`` are the first and last positions of the frame. The distance is evaluated along the frame's
    border.
    """
    t = np.linspace(0.0, 1.0, 65)
    sides = [(y_um[0] + t * (y_um[1] - y_um[0]), np.full(t.size, x)) for x in x_um]
    sides += [(np.full(t.size, y), x_um[0] + t * (x_um[1] - x_um[0])) for y in y_um]
    y, x = (np.concatenate([side[i] for side in sides]) for i in (0, 1))
    radius = np.hypot(y, x)
    ratio = distortion.ratio(float(radius.max()), wavelength_um)(radius * radius)
    beyond = [np.maximum(ends[0] - ratio * a, ratio * a - ends[1]) for a, ends in ((y, y_um), (x, x_um))]
    return max(0.0, float(np.max(beyond)))

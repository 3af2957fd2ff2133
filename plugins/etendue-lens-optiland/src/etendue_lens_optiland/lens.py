"""A lens in use: scaled to a focal length, stopped down to an f-number, focused, and traced field by field.

In:  a ``Prescription``, focal length, f-number, reference wavelength, focus.
Out: chief rays, bundles of rays, image heights, relative illumination, banks of point spread functions.
Sources: geometrical optics; for the light in the cone, Helmholtz's theorem (irradiance per radiance is the area of the
cone in direction cosines, whatever the lens).

Rays are traced in the lens's own unit: scaling a lens keeps directions and scales paths and heights. The f-number is
the focal length over the diameter of the entrance pupil, both at the reference wavelength: the stop is opened until the
real axial ray at half that diameter just passes. The actual cone of light on axis (its working f-number, 1/(2 sin))
follows from the trace.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from etendue_lens_optiland.prescription import Prescription, load
from etendue_lens_optiland.pupil import Bundle, covered, slope

FloatArray = NDArray[np.floating]

FOCUS = ("design", "paraxial", "best")
AIMING = ("stop", "paraxial")
_SCAN, _COARSE = 241, 33


@dataclass(frozen=True, eq=False)
class Lens:
    """A prescription with its f-number and focus; lengths in the lens's own unit.

    Attributes
    ----------
    prescription : Prescription
    focal_length, back_focus : float
        Paraxial, at the reference wavelength; the back focus from the last surface to the paraxial image.
    pupil : float
        Position of the paraxial entrance pupil, from the first vertex.
    f_number : float
    reference : float, um
    stop_radius : float
    shift : float
        Shift of the image plane from its position in the prescription.
    image_distance : float
        Image height over the tangent of the field angle, close to the axis. It is the focal length if the image plane
        is the paraxial image plane, and slightly different otherwise.
    aiming : str
        ``stop``: light fills the stop, as in reality. ``paraxial``: light fills the paraxial entrance pupil at every
        field angle, as in programs without ray aiming.
    scale : float, um per unit
    upright : bool
        Whether the stop is seen upright through the lens before it.
    """

    prescription: Prescription
    focal_length: float
    back_focus: float
    pupil: float
    f_number: float
    reference: float
    stop_radius: float
    shift: float
    image_distance: float
    aiming: str
    scale: float
    upright: bool = True

    @property
    def focal_length_um(self) -> float:
        return self.focal_length * self.scale

    @property
    def image_distance_um(self) -> float:
        return self.image_distance * self.scale

    @property
    def pupil_radius(self) -> float:
        return 0.5 * self.focal_length / self.f_number

    # -- rays

    def rays(self, y: Any, x: Any, tangent: Any, wavelength: float) -> dict[str, Any]:
        """Trace rays of distant points through points (y, x) of the paraxial entrance pupil to the focused image
        plane."""
        y, x, tangent = (np.ravel(a).astype(float) for a in np.broadcast_arrays(y, x, tangent))
        cosine = 1.0 / np.hypot(1.0, tangent)
        direction = np.stack([np.zeros_like(y), tangent * cosine, cosine])
        point = np.stack([x, y, np.full_like(y, self.pupil)])
        far = -4.0 * self.prescription.extent
        back = ((point - np.array([0.0, 0.0, far])[:, None]) * direction).sum(axis=0)
        at_x, at_y, out, path, stop, rims = self.prescription.trace(point - back * direction, direction, wavelength)
        with np.errstate(invalid="ignore", divide="ignore"):
            further = self.shift / out[2]
        return {
            "x": at_x + further * out[0],
            "y": at_y + further * out[1],
            "L": out[0],
            "M": out[1],
            "N": out[2],
            "path": path + further,
            "stop": stop,
            "rims": rims,
        }

    def chief(self, tangent: Any, wavelength: float) -> tuple[FloatArray, FloatArray]:
        """Trace rays through the centre of the stop.

        Parameters
        ----------
        tangent : (k,) array, 1
            Tangents of the field angles, 0 or above.
        wavelength : float, um

        Returns
        -------
        (k,) heights in the entrance pupil, lens unit; (k,) heights on the image plane, um. NaN where no ray passes.
        """
        tangent = np.atleast_1d(np.asarray(tangent, dtype=float))
        entry = np.zeros(tangent.shape)
        if self.aiming == "stop":
            width = np.full(tangent.shape, 0.6 * max(self.prescription.extent, self.focal_length))
            count = _SCAN
            for _ in range(5):
                at = entry[:, None] + np.linspace(-1.0, 1.0, count) * width[:, None]
                height = self.rays(at, 0.0, tangent[:, None], wavelength)["stop"][1].reshape(at.shape)
                lower, upper = height[:, :-1], height[:, 1:]
                crosses = (lower <= 0) & (upper >= 0) if self.upright else (lower >= 0) & (upper <= 0)
                middle = 0.5 * (at[:, :-1] + at[:, 1:])
                nearest = np.where(crosses, np.abs(middle), np.inf).argmin(axis=1)
                rows = np.arange(tangent.size)
                a, b, low, high = at[rows, nearest], at[rows, nearest + 1], lower[rows, nearest], upper[rows, nearest]
                with np.errstate(invalid="ignore", divide="ignore"):
                    share = np.where(high == low, 0.5, low / (low - high))
                entry = np.where(crosses.any(axis=1), a + share * (b - a), np.nan)
                width, count = 0.75 * (b - a), 17
        entry = np.where(tangent == 0.0, 0.0, entry)
        return entry, self.rays(entry, 0.0, tangent, wavelength)["y"] * self.scale

    def bundle(self, tangent: float, wavelength: float, samples: int) -> Bundle:
        """Return the rays of one field point that pass the lens. The pupil is sampled with ``samples`` cells across.

        Raises
        ------
        ValueError
            If no light of this field angle passes.
        """
        angle = math.degrees(math.atan(tangent))
        entry, height = (float(a[0]) for a in self.chief(tangent, wavelength))
        if not math.isfinite(height):
            raise ValueError(
                f"{self.prescription.name}: no ray passes the centre of the stop at {angle:.4g} degrees; use smaller "
                f"fields"
            )
        box = self._box(tangent, wavelength, entry)
        if box is None:
            raise ValueError(
                f"{self.prescription.name}: no light passes at {angle:.4g} degrees and {wavelength:g} um; use smaller "
                f"fields"
            )
        low, high, wide = box
        rows, columns = samples, max(4, samples // 2)
        dy, dx = (high - low) / rows, wide / columns
        y = low + (np.arange(rows) + 0.5) * dy
        x = (np.arange(-1, columns) + 0.5) * dx  # one column beyond the centre, for slopes
        found, share = self._grid(y, x, tangent, wavelength)
        s = self.scale
        across_y, across_x = found["y"] * s - height, found["x"] * s
        to_y, to_x, path = _on_sphere(
            found, across_y, across_x, found["path"] * s, 1.0 / self.pupil_distance(tangent, wavelength)
        )
        jacobian = np.abs(slope(to_x, 1) * slope(to_y, 0) - slope(to_x, 0) * slope(to_y, 1))
        steps = np.array(
            [np.nanmax(np.where(share > 0, np.abs(slope(c, axis)), np.nan)) for c, axis in ((to_y, 0), (to_x, 1))]
        )
        keep = (share > 0) & np.isfinite(jacobian)
        keep[:, 0] = False
        return Bundle(
            wavelength,
            to_x[keep],
            to_y[keep],
            path[keep] - path[keep].mean(),
            share[keep] * dy * dx,
            (share * jacobian)[keep],
            across_y[keep],
            across_x[keep],
            steps,
            height,
        )

    def pupil_distance(self, tangent: float, wavelength: float) -> float:
        """Return the signed distance (um) from the image point back to the exit pupil, where the chief ray crosses the
        axis; it may be inf.
        """
        tangent = max(tangent, 1e-3)
        chief = self.rays(self.chief(tangent, wavelength)[0], 0.0, tangent, wavelength)
        with np.errstate(divide="ignore"):
            return float(chief["y"][0] * self.scale / chief["M"][0])

    def _grid(
        self, y: FloatArray, x: FloatArray, tangent: float, wavelength: float
    ) -> tuple[dict[str, Any], FloatArray]:
        """Trace rays through a grid of cells; return them and the open fraction of each."""
        shape = (y.size, x.size)
        py, px = np.broadcast_arrays(y[:, None], x[None, :])
        found = self.rays(py, px, tangent, wavelength)
        traced = np.isfinite(found["x"]).reshape(shape)
        if self.aiming == "stop":
            levels = [np.hypot(*found["stop"]) / self.stop_radius - 1.0]
        else:
            levels = [np.hypot(py, px).ravel() / self.pupil_radius - 1.0]
        for rim, radius in zip(self.prescription.rims, found["rims"], strict=True):
            if math.isfinite(rim.outer):
                levels.append(radius / rim.outer - 1.0)
            if rim.inner > 0:
                levels.append(1.0 - radius / rim.inner)
        share = np.min([covered(level.reshape(shape)) for level in levels], axis=0)
        arrays = {name: found[name].reshape(shape) for name in ("x", "y", "L", "M", "N", "path")}
        return arrays, np.where(traced, share, 0.0) * self._straight(found["stop"].reshape(2, *shape), share)

    def _straight(self, stop: FloatArray, share: FloatArray) -> NDArray[np.bool_]:
        """Return a mask of pupil cells: the connected part around the centre of the stop that maps to the stop without
        a fold.

        Without rims, a steep surface sends some rays from far outside back through the stop. A mount would block these
        rays.
        """
        seen = slope(stop[0], 1) * slope(stop[1], 0) - slope(stop[0], 0) * slope(stop[1], 1)
        parts, count = scipy.ndimage.label((share > 0) & (seen > 0 if self.upright else seen < 0))
        if count < 2:
            return parts > 0
        distance = np.where(parts > 0, np.hypot(*stop), np.inf)
        return parts == parts[np.unravel_index(int(distance.argmin()), distance.shape)]

    def _box(self, tangent: float, wavelength: float, entry: float) -> tuple[float, float, float] | None:
        """Return the lowest and highest y and largest x of the open pupil, with a margin."""
        low, high, wide = entry - 2.0 * self.pupil_radius, entry + 2.0 * self.pupil_radius, 2.0 * self.pupil_radius
        for step in range(8):
            y, x = np.linspace(low, high, _COARSE), np.linspace(0.0, wide, _COARSE)
            cell_y, cell_x = y[1] - y[0], x[1] - x[0]
            is_open = self._grid(y, x, tangent, wavelength)[1] > 0
            rows, columns = np.flatnonzero(is_open.any(axis=1)), np.flatnonzero(is_open.any(axis=0))
            if rows.size == 0:
                return None
            touches = rows[0] == 0, rows[-1] == _COARSE - 1, columns[-1] == _COARSE - 1
            if any(touches) and step < 7:
                low, high, wide = (
                    low - touches[0] * (high - low),
                    high + touches[1] * (high - low),
                    wide * (1 + touches[2]),
                )
                continue
            low, high, wide = y[rows[0]] - cell_y, y[rows[-1]] + cell_y, x[columns[-1]] + cell_x
            if max(cell_y / (high - low), cell_x / wide) < 0.04:
                break
        return low, high, wide

    # -- tables

    def tangent_for(self, height_um: float, wavelengths: tuple[float, ...]) -> float:
        """Return the tangent of a field angle whose chief rays reach this image height at every wavelength.

        Raises
        ------
        ValueError
            If the lens does not reach so far.
        """
        tangent, passed, reached, dark = height_um / self.image_distance_um, 0.0, 0.0, math.inf
        for _ in range(40):
            heights = [float(self.chief(tangent, wavelength)[1][0]) for wavelength in wavelengths]
            lowest = min(heights) if np.isfinite(heights).all() else math.nan
            if lowest >= height_um:
                return tangent
            if lowest > reached:
                passed, reached, wanted = tangent, lowest, tangent * max(1.005, 1.01 * height_um / lowest)
            else:  # no light, or an image that folds back
                dark, wanted = tangent, 0.0
            tangent = wanted if passed < wanted < dark else 0.5 * (passed + dark)
            if dark - passed <= 1e-3 * passed:
                break
        raise ValueError(
            f"{self.prescription.name} at {self.focal_length_um * 1e-3:.4g} mm reaches image heights of "
            f"{reached * 1e-3:.4g} mm, "
            f"but the frame extends to {height_um * 1e-3:.4g} mm from the axis; use a longer focal_length or a smaller "
            f"frame"
        )

    def heights(self, tangents: FloatArray, wavelengths: tuple[float, ...]) -> FloatArray:
        """Return the image heights of the chief rays, (wavelengths, fields), um."""
        return np.stack([self.chief(tangents, wavelength)[1] for wavelength in wavelengths])

    def illumination(self, tangents: FloatArray, wavelengths: tuple[float, ...], samples: int) -> FloatArray:
        """Return irradiance per radiance (sr) at the image points of the fields, (wavelengths, fields)."""
        return np.array([[self.bundle(float(t), w, samples).solid_angle for t in tangents] for w in wavelengths])


def _on_sphere(
    rays: dict[str, Any], across_y: FloatArray, across_x: FloatArray, path: FloatArray, curvature: float
) -> tuple[FloatArray, ...]:
    """Intersect rays with the reference sphere, which is centred on the image point and passes through the exit pupil.

    In: rays, their intersections with the image plane relative to the image point (um), their paths to the image plane
         (um), the curvature of the sphere (1/um).
    Out: direction cosines y, x from the intersection to the image point, and paths (um) via the intersection.
    """
    along = rays["L"] * across_x + rays["M"] * across_y
    miss_y, miss_x, miss_z = across_y - rays["M"] * along, across_x - rays["L"] * along, -rays["N"] * along
    missed = miss_y**2 + miss_x**2 + miss_z**2
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1.0 - missed * curvature**2)
    return (
        rays["M"] * root - miss_y * curvature,
        rays["L"] * root - miss_x * curvature,
        path - along + missed * curvature / (1.0 + root),
    )


@lru_cache(maxsize=16)
def _loaded(lens: str, file: str, state: Any) -> Prescription:
    return load(lens, file)


@lru_cache(maxsize=64)
def _opened(lens: str, file: str, state: Any, f_number: float, reference: float, focus: str, aiming: str) -> Lens:
    prescription = _loaded(lens, file, state)
    bare = Lens(prescription, 1.0, 1.0, 0.0, f_number, reference, math.inf, 0.0, 1.0, aiming, 1.0)
    focal, to_image = _paraxial(bare)
    if not (math.isfinite(focal) and focal > 0):
        raise ValueError(
            f"{prescription.name} has a focal length of {focal:.4g}: it forms no real image of a distant object"
        )
    last = prescription.surfaces[-2].geometry.cs.z - prescription.surfaces[-1].geometry.cs.z
    pupil = _entrance_pupil(bare, 1e-3 * prescription.extent)
    made = replace(bare, focal_length=focal, back_focus=to_image - float(np.ravel(last)[0]), pupil=pupil)
    edge = made.rays(made.pupil_radius, 0.0, 0.0, reference)
    made = replace(made, upright=bool(edge["stop"][1][0] > 0))
    radius = abs(float(edge["stop"][1][0]))
    if not math.isfinite(edge["y"][0]):
        raise ValueError(
            f"{prescription.name} does not open to f/{f_number:g}: the axial ray at the edge of its pupil is lost; use "
            f"a larger f_number"
        )
    if radius > prescription.stop_radius * 1.0005:
        widest = f_number * radius / prescription.stop_radius
        raise ValueError(
            f"{prescription.name} does not open to f/{f_number:g}: its stop has a radius of "
            f"{prescription.stop_radius:g}, which is about "
            f"f/{widest:.3g}; use a larger f_number"
        )
    made = replace(made, stop_radius=radius)
    if focus == "paraxial" or (focus == "design" and not prescription.image_given):
        return _placed(made, to_image)
    if focus == "best":
        # defocus adds dz N to the path: minimise the variance of path + dz N over the open pupil
        start = _placed(made, to_image)
        bundle = start.bundle(0.0, reference, 64)
        cosine = np.sqrt(1.0 - bundle.cosine_x**2 - bundle.cosine_y**2)
        weight = bundle.open / bundle.open.sum()
        cosine = cosine - weight @ cosine
        return _placed(made, to_image - float((weight * cosine) @ bundle.path / ((weight * cosine) @ cosine)))
    return _placed(made, 0.0)


def _placed(made: Lens, shift: float) -> Lens:
    """Return the lens with the image plane shifted and its image scale updated."""
    made = replace(made, shift=shift)
    tangents = np.array([2e-3, 1e-3])
    coarse, fine = made.chief(tangents, made.reference)[1] / tangents
    return replace(made, image_distance=float(4 * fine - coarse) / 3 / made.scale)


def _paraxial(bare: Lens) -> tuple[float, float]:
    """Return the focal length and the distance from the image plane to the paraxial image, from near-axis real rays."""
    step = 1e-3 * bare.prescription.extent
    found = []
    for height in (step, 0.5 * step):
        ray = bare.rays(height, 0.0, 0.0, bare.reference)
        slope_back = float(ray["N"][0] / ray["M"][0]) if ray["M"][0] else -math.inf
        found.append((-height * slope_back, -float(ray["y"][0]) * slope_back))
    # the error of these rays falls with the square of their height
    (coarse_f, coarse_z), (fine_f, fine_z) = found
    return (4 * fine_f - coarse_f) / 3, (4 * fine_z - coarse_z) / 3


def _entrance_pupil(bare: Lens, step: float) -> float:
    """Return the position of the paraxial image of the stop, from the first vertex."""
    found = []
    for small in (step, 0.5 * step):
        along = float(bare.rays(small, 0.0, 0.0, bare.reference)["stop"][1][0]) / small
        tilted = (
            float(bare.rays(0.0, 0.0, small / bare.prescription.extent, bare.reference)["stop"][1][0])
            * bare.prescription.extent
            / small
        )
        found.append(tilted / along)
    return (4 * found[1] - found[0]) / 3


def open_lens(
    lens: str = "ReverseTelephoto",
    file: str = "",
    focal_length_mm: float = 6.93,
    f_number: float = 2.8,
    reference_um: float = 0.55,
    focus: str = "design",
    aiming: str = "stop",
    state: Any = None,
) -> Lens:
    """Open a lens by name or file, scaled, stopped down and focused.

    Parameters
    ----------
    lens, file : str
        As for `prescription.load`.
    focal_length_mm : float, mm
        Focal length to which the prescription is scaled.
    f_number : float
        Paraxial focal length over the diameter of the entrance pupil.
    reference_um : float, um
        Wavelength at which focal length, f-number and focus are defined.
    focus : {"design", "paraxial", "best"}
        Position of the image plane: from the prescription (the paraxial image if it gives none), at the paraxial image,
        or where the axial wavefront has the smallest rms error.
    aiming : {"stop", "paraxial"}
        See ``Lens``.
    state : hashable
        Identifies the content of the file.

    Raises
    ------
    ValueError
        As for `prescription.load`; for an f-number that the lens cannot reach; for unknown options.
    """
    if focus not in FOCUS or aiming not in AIMING:
        raise ValueError(
            f"focus is {focus!r} and aiming {aiming!r}; they must be one of {', '.join(FOCUS)} and one of "
            f"{', '.join(AIMING)}"
        )
    made = _opened(lens, file, state, f_number, reference_um, focus, aiming)
    return replace(made, scale=1e3 * focal_length_mm / made.focal_length)

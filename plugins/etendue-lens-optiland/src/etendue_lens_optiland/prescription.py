"""Prescriptions: a sample lens of optiland, a Zemax file or a surface table, prepared for tracing.

In:  the name of a sample lens, or the path of a .zmx or .csv file.
Out: a ``Prescription``: optiland's surfaces, the stop among them, and their clear apertures, in the lens's own
     unit.

Surface table
-------------
CSV with a header line; lines that start with ``#`` are comments. One line per surface from object to image, columns in
any order:

    radius_mm         radius of curvature; 0 or inf for a plane
    thickness_mm      distance to the next surface; for the last one to the image, 0 or absent: the paraxial image
    index_after       refractive index after the surface, or ``glass`` with a catalogue name (empty: air)
    abbe              optional: Abbe number V_d for index_after, which is then n_d; empty: no dispersion
    semi_aperture_mm  optional: clear radius; 0 or empty: unbounded
    is_stop           1 for the aperture stop; exactly one surface must be
    conic             optional
"""

from __future__ import annotations

import contextlib
import csv
import importlib
import math
import threading
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

SAMPLES = ("objectives", "simple", "telescopes", "infrared", "eyepieces", "lithography", "microscopes", "miscellaneous")
_ROUND = ("Plane", "StandardGeometry", "EvenAsphere", "OddAsphere")
_LOCK = threading.RLock()


@contextlib.contextmanager
def quietly() -> Iterator[None]:
    """Run optiland in one thread at a time, because it stores rays on its surfaces, and suppress messages of its
    compiler.
    """
    from numba.core.errors import NumbaIRAssumptionWarning  # comes with optiland, and is slow to import

    with _LOCK, np.errstate(all="ignore"):
        warnings.filterwarnings("ignore", category=NumbaIRAssumptionWarning)
        yield


@dataclass(frozen=True, eq=False)
class Rim:
    """A round clear aperture on a surface, in the lens's own unit; opaque inside ``inner``."""

    surface: int
    outer: float
    inner: float = 0.0


@dataclass(frozen=True, eq=False)
class Prescription:
    """A centred lens of rotationally symmetric surfaces in air, with its object at infinity.

    Attributes
    ----------
    name : str
    surfaces : tuple
        optiland's surfaces from the first to the image plane.
    stop : int
        Index of the aperture stop.
    rims : tuple of Rim
        Clear apertures, except the clear aperture of the stop.
    stop_radius : float
        Largest radius of the stop; inf if the prescription does not give it.
    extent : float
        Largest distance of a vertex from the first: the length of the lens.
    image_given : bool
        Whether the prescription gives the image plane; if not, its last surface is used.
    """

    name: str
    surfaces: tuple[Any, ...]
    stop: int
    rims: tuple[Rim, ...]
    stop_radius: float
    extent: float
    image_given: bool

    def trace(self, position: Any, direction: Any, wavelength: float) -> tuple[Any, Any, Any, Any, Any, Any]:
        """Trace rays through the lens to its image plane.

        Parameters
        ----------
        position : (3, n) array, lens unit
            Starting points x, y, z before the lens; z = 0 is the first vertex.
        direction : (3, n) array, 1
            Direction cosines.
        wavelength : float, um

        Returns
        -------
        x, y, cosines, path, stop, rims
            (n,) points on the image plane, (3, n) directions after the lens, (n,) optical path from the start, (2, n) x
            and y in the stop, (rims, n) distances from the axis at the rims; NaN for rays that miss a surface or are
            totally reflected.
        """
        from optiland.rays import RealRays  # slow to import, and needed only for tracing

        count = position.shape[1]
        with quietly():
            x, y, z, (L, M, N) = (
                position[0].copy(),
                position[1].copy(),
                position[2] + self.surfaces[0].geometry.cs.z,
                direction.copy(),
            )
            rays: Any = RealRays(x, y, z, L, M, N, np.ones(count), np.full(count, wavelength))
            stop, radii = np.empty((2, count)), np.full((len(self.rims), count), np.nan)
            for number, surface in enumerate(self.surfaces):
                rays = surface.trace(rays, record=False)
                if number == self.stop:
                    stop = np.stack([rays.x, rays.y])
                for row, rim in enumerate(self.rims):
                    if rim.surface == number:
                        radii[row] = np.hypot(rays.x, rays.y)
        lost = ~np.isfinite(rays.x + rays.y + rays.L + rays.M + rays.N + rays.opd)
        out = [np.where(lost, np.nan, a) for a in (rays.x, rays.y, rays.opd)]
        cosines = np.where(lost, np.nan, np.stack([rays.L, rays.M, rays.N]))
        return out[0], out[1], cosines, out[2], stop, radii


def sample_names() -> tuple[str, ...]:
    """Return the names of the lenses included in optiland."""
    return tuple(sorted(_samples()))


def load(lens: str, file: str = "") -> Prescription:
    """Load a sample lens by name, or the prescription in a file.

    Parameters
    ----------
    lens : str
        Name of one of optiland's sample lenses; ignored if there is a file.
    file : str
        Path of a Zemax file (.zmx) or a surface table (.csv, see the top of this file).

    Raises
    ------
    ValueError
        For unknown names and extensions, unreadable files, and lenses that are not centred, round and in air.
    """
    if not file:
        with quietly():
            known = _samples()
            if lens not in known:
                near = get_close_matches(lens, known, 3, 0.4)
                hint = f"; did you mean {' or '.join(near)}?" if near else f"; known are {', '.join(sorted(known))}"
                raise ValueError(
                    f"lens {lens!r} is not a sample lens of optiland{hint}; to use a file give prescription"
                )
            try:
                optic = known[lens]()
            except TypeError as error:
                raise ValueError(f"lens {lens!r} cannot be created without arguments: {error}") from None
        return _taken(lens, optic, True)
    path = Path(file)
    if path.suffix.lower() == ".zmx":
        from optiland.fileio import load_zemax_file

        with quietly():
            try:
                optic = load_zemax_file(str(path))
            except Exception as error:  # its reader may raise anything
                raise ValueError(
                    f"{path}: optiland could not read it as a Zemax file: {type(error).__name__}: {error}"
                ) from error
        return _taken(path.stem, optic, True)
    if path.suffix.lower() == ".csv":
        return _from_table(path)
    raise ValueError(f"prescription is {path.name!r}; it must be a Zemax file .zmx or a surface table .csv")


def _samples() -> dict[str, type]:
    from optiland.optic import Optic

    found: dict[str, type] = {}
    for module in SAMPLES:
        names = vars(importlib.import_module(f"optiland.samples.{module}"))
        found.update(
            (name, kind)
            for name, kind in names.items()
            if isinstance(kind, type) and issubclass(kind, Optic) and kind is not Optic
        )
    return found


def _taken(name: str, optic: Any, image_given: bool) -> Prescription:
    """Return the parts of optiland's lens that a trace needs. Raise ValueError if this plugin does not support the
    lens.
    """
    everything = tuple(optic.surfaces)
    surfaces = everything[1:]
    if not np.isinf(float(np.ravel(everything[0].geometry.cs.z)[0])):
        raise ValueError(f"{name}: its object is at a finite distance; this plugin supports only objects at infinity")
    stops = [number for number, surface in enumerate(surfaces) if surface.is_stop]
    if len(stops) != 1:
        raise ValueError(f"{name}: {len(stops)} surfaces are aperture stops; exactly one is required")
    rims, stop_radius = [], math.inf
    vertices = [float(np.ravel(surface.geometry.cs.z)[0]) for surface in surfaces]
    for number, surface in enumerate(surfaces):
        place, frame = f"{name}, surface {number + 1}", surface.geometry.cs
        if any(abs(float(np.ravel(getattr(frame, axis))[0])) > 1e-12 for axis in ("x", "y", "rx", "ry", "rz")):
            raise ValueError(f"{place} is tilted or decentred; this plugin supports only centred lenses")
        kind = type(surface.geometry).__name__
        if kind not in _ROUND:
            raise ValueError(f"{place} is a {kind}; this plugin supports only {', '.join(_ROUND)}")
        if surface.interaction_model.is_reflective:
            raise ValueError(f"{place} is a mirror; this plugin supports only refracting lenses")
        if number and vertices[number] < vertices[number - 1] - 1e-12:
            raise ValueError(f"{place} lies before its predecessor")
        rim = _rim(place, number, surface.aperture)
        if rim is not None and number == stops[0]:
            stop_radius = rim.outer
            rim = Rim(number, math.inf, rim.inner) if rim.inner > 0 else None
        if rim is not None:
            rims.append(rim)
    if type(surfaces[-1].geometry).__name__ != "Plane":
        raise ValueError(f"{name}: its image is curved; this plugin supports only flat image planes")
    index = float(np.ravel(surfaces[-2].material_post.n(0.55))[0])
    if abs(index - 1.0) > 1e-3:
        raise ValueError(
            f"{name}: the refractive index in image space is {index:g}; this plugin supports only lenses in air"
        )
    for surface in surfaces:  # rims are handled by partial cell coverage, not by dropping rays
        surface.aperture = None
    return Prescription(name, surfaces, stops[0], tuple(rims), stop_radius, vertices[-1] - vertices[0], image_given)


def _rim(place: str, number: int, aperture: Any) -> Rim | None:
    if aperture is None:
        return None
    if type(aperture).__name__ not in ("RadialAperture", "OffsetRadialAperture"):
        raise ValueError(f"{place} has a {type(aperture).__name__}; this plugin supports only round clear apertures")
    if any(abs(float(getattr(aperture, name, 0.0))) > 1e-12 for name in ("offset_x", "offset_y")):
        raise ValueError(f"{place} has a decentred clear aperture; this plugin supports only centred lenses")
    return Rim(number, float(aperture.r_max), float(aperture.r_min))


def _from_table(path: Path) -> Prescription:
    from optiland.materials import AbbeMaterial, IdealMaterial
    from optiland.optic import Optic

    lines = [
        line for line in path.read_text(encoding="utf-8").splitlines() if line.strip() and not line.startswith("#")
    ]
    rows = list(csv.DictReader(lines, skipinitialspace=True))
    if len(rows) < 1 or "radius_mm" not in rows[0] or not {"index_after", "glass"} & set(rows[0]):
        raise ValueError(
            f"{path.name}: expected a header with radius_mm, thickness_mm, index_after or glass, semi_aperture_mm and "
            f"is_stop, "
            "and one line per surface"
        )

    def number(row: dict[str, str], name: str, otherwise: float) -> float:
        text = (row.get(name) or "").strip()
        try:
            return float(text) if text else otherwise
        except ValueError:
            raise ValueError(f"{path.name}, surface {rows.index(row) + 1}: {name} is {text!r}, not a number") from None

    with quietly():
        optic = Optic(path.stem)
        optic.surfaces.add(index=0, radius=np.inf, thickness=np.inf)
        for place, row in enumerate(rows, 1):
            radius, clear = number(row, "radius_mm", 0.0), number(row, "semi_aperture_mm", 0.0)
            index, abbe = number(row, "index_after", 1.0), number(row, "abbe", 0.0)
            glass = (row.get("glass") or "").strip()
            if not glass and not index >= 1.0:
                raise ValueError(f"{path.name}, surface {place}: index_after is {index:g}; it must be at least 1")
            material = glass or (
                "air" if index == 1.0 else AbbeMaterial(index, abbe, model="buchdahl") if abbe else IdealMaterial(index)
            )
            try:
                optic.surfaces.add(
                    index=place,
                    radius=radius or np.inf,
                    conic=number(row, "conic", 0.0),
                    thickness=number(row, "thickness_mm", 0.0),
                    material=material,
                    is_stop=number(row, "is_stop", 0.0) != 0,
                    aperture=2 * clear if clear > 0 else None,
                )
            except ValueError as error:
                raise ValueError(f"{path.name}, surface {place}: {error}") from None
        optic.surfaces.add(index=len(rows) + 1)
    return _taken(path.stem, optic, number(rows[-1], "thickness_mm", 0.0) > 0)

"""Tables and matrices of colour-science, as bin means. The one module that imports it, at the first call that needs it.

In:  the name of a table and the bin edges of a wavelength axis (n + 1 ascending values, nm).
Out: plain float64 arrays, read-only where they are cached.
Sources: the data and matrices of colour-science; CIE 15:2018 for interpolation.

The interpolant runs through

- the rows themselves for light sources, as CIE 15 asks for its illuminants, and for displays:
  a smooth curve overshoots their lines (Sprague lifts the Apple display's green peak from 1.58 to 1.71);
- for smooth tables (matching functions, cones, cameras, reflectances) values at 1 nm, to which Sprague's
  quintic leads where the table is coarser. What it puts below 0 beside steep feet (at most 1.4e-4 of a
  channel's area) is set to 0.
"""

import importlib.metadata
import sys
import warnings
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from etendue.constants import BOLTZMANN, PLANCK, SPEED_OF_LIGHT
from etendue.discovery import spectrum
from etendue.spectra.bins import Edges, FloatArray, bin_means, checked_edges, csv_rows, frozen, require_name, table_from_csv, with_reach
from etendue.spectra.kept import kept
from etendue.spectra.names import COMPUTED, COMPUTED_ILLUMINANTS, LOWEST_TEMPERATURE, state_of

SECOND_RADIATION_CONSTANT = PLANCK * SPEED_OF_LIGHT / BOLTZMANN * 1e9  # nm K
PLANCK_REFERENCE = 560.0  # nm; where a Planck spectrum is 100, as CIE illuminant A is
UNWANTED_WARNING = "related API features are not available"


# ---------------------------------------------------------------------------------------------- the library


def colour_version() -> str:
    """Version of the installed colour-science, read without importing it."""
    return importlib.metadata.version("colour-science")


def load_library() -> None:
    """Import colour-science now, where it is known that a table will be asked for."""
    colour_science()


@lru_cache(maxsize=1)
def colour_science() -> ModuleType:
    """colour-science, imported late, without its remarks about optional packages we do not use.

    A file ``colour.py`` beside a user's script would be taken for it: folders with one are not looked in.
    """
    kept = sys.path[:]
    sys.path[:] = [folder for folder in kept if not Path(folder, "colour.py").is_file()]
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            import colour
    finally:
        sys.path[:] = kept
    for entry in caught:
        unwanted = issubclass(entry.category, colour.utilities.ColourUsageWarning)
        if not (unwanted and UNWANTED_WARNING in str(entry.message)):
            warnings.warn_explicit(entry.message, entry.category, entry.filename, entry.lineno)
    return colour


def lookup(table: Mapping[str, Any], name: str, kind: str, besides: str = "") -> Any:
    """``table[name]`` for an exact name, or ValueError with the nearest names that exist."""
    require_name(name, table.keys(), kind, besides)
    return table[name]


def rows_of(table: Any) -> tuple[FloatArray, FloatArray]:
    return np.array(table.wavelengths, dtype=np.float64), np.array(table.values, dtype=np.float64)


def smooth_rows(table: Any) -> tuple[FloatArray, FloatArray]:
    """Rows of a smooth table at 1 nm: Sprague where the table is uniform and coarser, else as they are."""
    nodes, values = rows_of(table)
    steps = np.diff(nodes)
    if not np.allclose(steps, steps[0], rtol=1e-9) or steps[0] <= 1.0 or len(nodes) < 6:
        return nodes, values
    fine = np.linspace(nodes[0], nodes[-1], round(nodes[-1] - nodes[0]) + 1)
    columns = values.reshape(len(nodes), -1).T
    curves = np.stack([colour_science().SpragueInterpolator(nodes, column)(fine) for column in columns], axis=1)
    if values.min() >= 0:
        curves = np.maximum(curves, 0.0)
    return fine, curves.reshape((len(fine), *values.shape[1:]))


# ----------------------------------------------------------------------------------------------------- light


def illuminant(name: str, edges: Edges) -> FloatArray:
    """Relative spectral power of a light.

    Parameters
    ----------
    name : str
        A name in ``colour.SDS_ILLUMINANTS`` ("D65", "A", "FL2"); "E", which is 100 at all wavelengths;
        "<T> K", a Planck radiator at T >= 100 K, 100 at 560 nm; "<w> nm", a spectral line; the path of a
        CSV table with one column, or the name under which a distribution brings one.
    edges : (n + 1,) ascending, nm

    Returns
    -------
    (n,) array, relative power per nm
        In the normalisation of the table itself (the CIE's: 100 at 560 nm for A and D65). A line has the
        energy 1, all of it in the bin that holds it, a bin owning its lower edge and the last its upper too.

    Raises
    ------
    ValueError
        Unknown name, a bin that reaches beyond the table, a line outside all bins.

    Notes
    -----
    Source: colour-science; Planck's law with the exact constants of the SI. Planck error: below 8e-15
    relative from 300 to 1e6 K, 2.3e-13 at 100 K (380-1100 nm, bins of 1 to 360 nm, against 20-point panels of
    0.25 nm in 80-bit arithmetic).
    """
    return _illuminant(name, checked_edges(edges), state_of(name))


@lru_cache(maxsize=128)
def _illuminant(name: str, edges: tuple[float, ...], state: tuple[int, int]) -> FloatArray:
    computed = COMPUTED.fullmatch(str(name))
    if computed:
        number = float(computed[1])
        return frozen(_planck(number, edges) if computed[2] == "K" else _line(number, edges))
    if name == "E":
        return frozen(np.full(len(edges) - 1, 100.0))
    nodes, values = illuminant_rows(name)
    if edges[0] < nodes[0] or edges[-1] > nodes[-1]:
        raise ValueError(
            f"illuminant {name!r} is tabulated from {nodes[0]:g} to {nodes[-1]:g} nm, but the bins span "
            f"{edges[0]:g} to {edges[-1]:g} nm; narrow the wavelength axis, or use 'E' or '<T> K'"
        )
    return frozen(bin_means(nodes, values, edges, "zero"))


def illuminant_rows(name: str) -> tuple[FloatArray, FloatArray]:
    """Wavelengths (nm) and relative powers of a tabulated illuminant."""
    if spectrum(name):
        columns, nodes, values = csv_rows(name)
        if len(columns) > 1:
            raise ValueError(f"the illuminant {name!r} has columns {', '.join(columns)}; a light has one")
        return nodes, values[:, 0]
    return rows_of(lookup(colour_science().SDS_ILLUMINANTS, name, "illuminant", COMPUTED_ILLUMINANTS))


def _planck(temperature: float, edges: tuple[float, ...]) -> FloatArray:
    """Gauss-Legendre, five points in each panel of at most 1 nm, or of 1/400 of longer wavelengths."""
    if not LOWEST_TEMPERATURE <= temperature < np.inf:
        raise ValueError(f"illuminant temperature must be {LOWEST_TEMPERATURE:g} K or more, got {temperature:g} K")
    bounds = np.asarray(edges)
    widths = np.diff(bounds)
    panels = int(np.ceil(np.max(widths / np.maximum(1.0, bounds[:-1] / 400.0))))
    points, weights = np.polynomial.legendre.leggauss(5)
    inside = ((np.arange(panels)[:, None] + 0.5 + 0.5 * points) / panels).ravel()
    power = planck_power(temperature, bounds[:-1, None] + widths[:, None] * inside)
    return power @ np.tile(weights, panels) / (2.0 * panels)


def planck_power(temperature: float, wavelength: FloatArray) -> FloatArray:
    """Relative power of a Planck radiator at wavelengths (nm), 100 at 560 nm."""
    x = SECOND_RADIATION_CONSTANT / (wavelength * temperature)
    reference = SECOND_RADIATION_CONSTANT / (PLANCK_REFERENCE * temperature)
    # exp(-x) taken out of both exponentials, so that cold radiators neither overflow nor divide 0 by 0
    ratio = np.exp(reference - x) * np.expm1(-reference) / np.expm1(-x)
    return 100.0 * (PLANCK_REFERENCE / wavelength) ** 5 * ratio


def _line(wavelength: float, edges: tuple[float, ...]) -> FloatArray:
    bounds = np.asarray(edges)
    if not bounds[0] <= wavelength <= bounds[-1]:
        raise ValueError(f"spectral line at {wavelength:g} nm lies outside the bins, {bounds[0]:g} to {bounds[-1]:g} nm")
    held = min(int(np.searchsorted(bounds, wavelength, side="right")) - 1, len(bounds) - 2)
    power = np.zeros(len(bounds) - 1)
    power[held] = 1.0 / (bounds[held + 1] - bounds[held])
    return power


# ------------------------------------------------------------------------------------------------- observers


def luminous_efficiency(edges: Edges) -> FloatArray:
    """V(lambda): y-bar of the CIE 1931 2 degree observer, (n,), dimensionless; 0 outside 360-830 nm."""
    return colour_matching(edges)[:, 1]


def colour_matching(edges: Edges) -> FloatArray:
    """x-bar, y-bar, z-bar of the CIE 1931 2 degree observer, (n, 3), dimensionless; 0 outside 360-830 nm."""
    return observer("CIE 1931 2 Degree Standard Observer", checked_edges(edges))


def cone_fundamentals(edges: Edges) -> FloatArray:
    """L, M, S of Stockman & Sharpe, 2 degrees, energy-based, peak 1, (n, 3); 0 outside 390-830 nm."""
    return observer("Stockman & Sharpe 2 Degree Cone Fundamentals", checked_edges(edges))


@lru_cache(maxsize=128)
def observer(name: str, edges: tuple[float, ...]) -> FloatArray:
    return frozen(bin_means(*smooth_rows(colour_science().MSDS_CMFS[name]), edges, "zero"))


def xyz_to_lms_matrix(edges: Edges) -> FloatArray:
    """Matrix from tristimulus values to cone responses.

    Parameters
    ----------
    edges : (n + 1,) ascending, nm; at least three bins

    Returns
    -------
    (3, 3) array A with ``cone_fundamentals ~ colour_matching @ A.T``, least squares over wavelength.

    Raises
    ------
    ValueError
        Fewer than three independent bins.

    Notes
    -----
    Bins count by their width. No matrix is exact, the 1931 observer being too blind in the blue: the rms
    residual is 0.010, 0.009 and 0.042 of the peak for L, M and S, the largest 0.20 in S at 415 nm
    (380-780 nm in 5 nm).
    """
    return _xyz_to_lms_matrix(checked_edges(edges))


@lru_cache(maxsize=128)
def _xyz_to_lms_matrix(edges: tuple[float, ...]) -> FloatArray:
    weight = np.sqrt(np.diff(edges))[:, None]
    matching, cones = weight * colour_matching(edges), weight * cone_fundamentals(edges)
    solution, _, rank, singular = np.linalg.lstsq(matching, cones, rcond=None)
    if rank < 3 or singular[0] > 1e3 * singular[-1]:
        raise ValueError(f"edges must give at least three bins where the eye responds, got {span(edges)}")
    return frozen(solution.T)


def span(edges: tuple[float, ...]) -> str:
    return f"{len(edges) - 1} bins from {edges[0]:g} to {edges[-1]:g} nm"


# -------------------------------------------------------------------------------- cameras, displays, charts


def camera_sensitivity(name: str, edges: Edges) -> tuple[tuple[str, ...], FloatArray]:
    """Relative spectral sensitivity of a camera.

    Parameters
    ----------
    name : str
        A name in ``colour.MSDS_CAMERA_SENSITIVITIES`` ("Nikon 5100 (NPL)", "Sigma SDMerill (NPL)"), the path of
        a CSV table, or the name under which a distribution brings one.
    edges : (n + 1,) ascending, nm

    Returns
    -------
    channels : ("R", "G", "B"), or the columns of the file
    sensitivity : (n, k) array, relative to the peak of each channel; 0 farther than half a step from the table

    Raises
    ------
    ValueError
        Unknown name.
    """
    if spectrum(name):
        columns, values = table_from_csv(name, edges)
        return tuple(columns), values
    return ("R", "G", "B"), _camera_sensitivity(name, checked_edges(edges))


@lru_cache(maxsize=128)
def _camera_sensitivity(name: str, edges: tuple[float, ...]) -> FloatArray:
    def found() -> FloatArray:
        table = lookup(colour_science().MSDS_CAMERA_SENSITIVITIES, name, "camera")
        return bin_means(*with_reach(rows_of(table)[0], *smooth_rows(table)), edges, "zero")

    return frozen(kept(("camera", name, edges), found))


def camera_rows(name: str) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Channels, wavelengths (rows,) in nm and relative sensitivities (rows, k) of a camera, as its table has them."""
    if spectrum(name):
        columns, nodes, values = csv_rows(name)
        return tuple(columns), nodes, values
    return ("R", "G", "B"), *rows_of(lookup(colour_science().MSDS_CAMERA_SENSITIVITIES, name, "camera"))


def display_primaries(name: str, edges: Edges) -> FloatArray:
    """Spectral power of a display's red, green and blue.

    Parameters
    ----------
    name : str
        A name in ``colour.MSDS_DISPLAY_PRIMARIES`` ("Apple Studio Display", "Typical CRT Brainard 1997").
    edges : (n + 1,) ascending, nm

    Returns
    -------
    (n, 3) array, relative power per nm; 0 outside the table

    Raises
    ------
    ValueError
        Unknown name.
    """
    return _display_primaries(name, checked_edges(edges))


@lru_cache(maxsize=128)
def _display_primaries(name: str, edges: tuple[float, ...]) -> FloatArray:
    table = lookup(colour_science().MSDS_DISPLAY_PRIMARIES, name, "display")
    return frozen(bin_means(*rows_of(table), edges, "zero"))


def colorchecker(edges: Edges) -> tuple[list[str], FloatArray]:
    """Reflectance of the 24 patches of the ColorChecker Classic.

    Parameters
    ----------
    edges : (n + 1,) ascending, nm

    Returns
    -------
    names : list of 24 str, row by row from "dark skin" to "black 2 (1.5 D)"
    reflectance : (24, n) array, dimensionless

    Notes
    -----
    Source: the BabelColor average of 30 charts, 380-730 nm. Outside the table the end value is held, as
    ASTM E308 does: a patch does not turn black where its measurement ends.
    """
    names, reflectance = _colorchecker(checked_edges(edges))
    return list(names), reflectance


@lru_cache(maxsize=32)
def _colorchecker(edges: tuple[float, ...]) -> tuple[tuple[str, ...], FloatArray]:
    patches = colour_science().SDS_COLOURCHECKERS["BabelColor Average"]
    means = [bin_means(*smooth_rows(table), edges, "hold") for table in patches.values()]
    return tuple(patches), frozen(means)


# -------------------------------------------------------------------------------------------- 3 x 3 matrices


def rgb_space_matrix(name: str) -> tuple[FloatArray, FloatArray]:
    """RGB to XYZ matrix (3, 3) and white point xy (2,) of a space in ``colour.RGB_COLOURSPACES``.

    The matrix is the one the standard prints, so for "sRGB" it has four digits. Unknown names raise
    ValueError.
    """
    space = lookup(colour_science().RGB_COLOURSPACES, name, "RGB space")
    return frozen(space.matrix_RGB_to_XYZ), frozen(space.whitepoint)


def rgb_space_primaries(name: str) -> tuple[tuple[tuple[float, float], ...], tuple[float, float]]:
    """Chromaticities xy of red, green, blue, and of the white, of a space in ``colour.RGB_COLOURSPACES``.

    Unknown names raise ValueError.
    """
    space = lookup(colour_science().RGB_COLOURSPACES, name, "RGB space")
    primaries = tuple((float(x), float(y)) for x, y in np.asarray(space.primaries).reshape(3, 2))
    return primaries, (float(space.whitepoint[0]), float(space.whitepoint[1]))


def rgb_space_white(name: str) -> str:
    """Name of the illuminant that is the white of a space in ``colour.RGB_COLOURSPACES``; the space's own name where it is of no other.

    A white counts as an illuminant's where its chromaticity is the published one.
    """
    space = lookup(colour_science().RGB_COLOURSPACES, name, "RGB space")
    published = _published_white(str(space.whitepoint_name))
    own = (float(space.whitepoint[0]), float(space.whitepoint[1]))
    return str(space.whitepoint_name) if published == own else name


def white_chromaticity(name: str) -> tuple[float, float] | None:
    """xy of the white of an RGB space, or of an illuminant as published (CIE 15, 1931 observer); None of a light that has none."""
    if name in list(colour_science().RGB_COLOURSPACES):
        return rgb_space_primaries(name)[1]
    return _published_white(name)


def _published_white(name: str) -> tuple[float, float] | None:
    known = colour_science().CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]
    return (float(known[name][0]), float(known[name][1])) if name in list(known) else None


def adaptation_matrix(name: str) -> FloatArray:
    """XYZ to sharpened cone responses, (3, 3), by name: "Von Kries", "Bradford", "CAT02", "CAT16", ...

    Any name in ``colour.adaptation.CHROMATIC_ADAPTATION_TRANSFORMS``; others raise ValueError.
    """
    transforms = colour_science().adaptation.CHROMATIC_ADAPTATION_TRANSFORMS
    return frozen(lookup(transforms, name, "adaptation transform"))

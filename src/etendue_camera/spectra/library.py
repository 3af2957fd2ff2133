"""Spectral tables as bin means: lights, observers, cameras, displays, a test chart.

In:  the name of a table and the bin edges of a wavelength axis (n + 1 ascending values, nm).
Out: plain float64 arrays, read-only where they are cached.
Sources: the data of colour-science (`shipped`); CIE 15:2018 for interpolation.

The interpolant runs through

- the rows themselves for light sources, as CIE 15 requires for its illuminants, and for displays:
  a smooth curve overshoots their lines (Sprague lifts the Apple display's green peak from 1.58 to 1.71);
- for smooth tables (matching functions, cones, cameras, reflectances) values at 1 nm (`authority`).
"""

from functools import lru_cache

import numpy as np

from etendue import require
from etendue_camera.constants import BOLTZMANN, PLANCK, SPEED_OF_LIGHT
from etendue_camera.spectra import shipped
from etendue_camera.spectra.bins import (
    Edges,
    FloatArray,
    bin_means,
    checked_edges,
    csv_rows,
    frozen,
    table_from_csv,
    with_reach,
)
from etendue_camera.spectra.named import spectrum
from etendue_camera.spectra.names import COMPUTED, COMPUTED_ILLUMINANTS, LOWEST_TEMPERATURE, state_of

SECOND_RADIATION_CONSTANT = PLANCK * SPEED_OF_LIGHT / BOLTZMANN * 1e9  # nm K
PLANCK_REFERENCE = 560.0  # nm; where a Planck spectrum is 100, as CIE illuminant A is


# ----------------------------------------------------------------------------------------------------- light


def illuminant(name: str, edges: Edges) -> FloatArray:
    """Return the relative spectral power of a light.

    Parameters
    ----------
    name : str
        A name in ``colour.SDS_ILLUMINANTS`` ("D65", "A", "FL2"); "E", which is 100 at all wavelengths;
        "<T> K", a Planck radiator at T >= 100 K, 100 at 560 nm; "<w> nm", a spectral line; the path of a
        CSV table with one column, or the name under which a distribution provides one.
    edges : (n + 1,) ascending, nm

    Returns
    -------
    (n,) array, relative power per nm
        In the normalisation of the table itself (the CIE's: 100 at 560 nm for A and D65). A line has the energy 1:
        all its light is in the bin that contains it. A bin includes its lower edge, and the last bin also its
        upper one.

    Raises
    ------
    ValueError
        For an unknown name, a bin outside the table, or a line outside all bins.

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
    """Return wavelengths (nm) and relative powers of a tabulated illuminant."""
    if spectrum(name):
        columns, nodes, values = csv_rows(name)
        require.that(
            len(columns) <= 1, f"the illuminant {name!r} has the columns {', '.join(columns)}; it must have one"
        )
        return nodes, values[:, 0]
    return shipped.curve("illuminant", name, COMPUTED_ILLUMINANTS)


def _planck(temperature: float, edges: tuple[float, ...]) -> FloatArray:
    """Return means of Planck's law over bins by Gauss-Legendre quadrature: five points per panel, which is at most 1 nm
    wide, or 1/400 of the wavelength above 400 nm.
    """
    require.that(
        LOWEST_TEMPERATURE <= temperature < np.inf,
        f"illuminant temperature must be {LOWEST_TEMPERATURE:g} K or more, got {temperature:g} K",
    )
    bounds = np.asarray(edges)
    widths = np.diff(bounds)
    panels = int(np.ceil(np.max(widths / np.maximum(1.0, bounds[:-1] / 400.0))))
    points, weights = np.polynomial.legendre.leggauss(5)
    inside = ((np.arange(panels)[:, None] + 0.5 + 0.5 * points) / panels).ravel()
    power = planck_power(temperature, bounds[:-1, None] + widths[:, None] * inside)
    return power @ np.tile(weights, panels) / (2.0 * panels)


def planck_power(temperature: float, wavelength: FloatArray) -> FloatArray:
    """Return the relative power of a Planck radiator at wavelengths (nm), 100 at 560 nm."""
    x = SECOND_RADIATION_CONSTANT / (wavelength * temperature)
    reference = SECOND_RADIATION_CONSTANT / (PLANCK_REFERENCE * temperature)
    # exp(-x) is factored out of both exponentials, so that cold radiators neither overflow nor divide 0 by 0
    ratio = np.exp(reference - x) * np.expm1(-reference) / np.expm1(-x)
    return 100.0 * (PLANCK_REFERENCE / wavelength) ** 5 * ratio


def _line(wavelength: float, edges: tuple[float, ...]) -> FloatArray:
    bounds = np.asarray(edges)
    if not bounds[0] <= wavelength <= bounds[-1]:
        raise ValueError(
            f"spectral line at {wavelength:g} nm lies outside the bins, {bounds[0]:g} to {bounds[-1]:g} nm"
        )
    held = min(int(np.searchsorted(bounds, wavelength, side="right")) - 1, len(bounds) - 2)
    power = np.zeros(len(bounds) - 1)
    power[held] = 1.0 / (bounds[held + 1] - bounds[held])
    return power


# ------------------------------------------------------------------------------------------------- observers


def luminous_efficiency(edges: Edges) -> FloatArray:
    """Return V(lambda), y-bar of the CIE 1931 2 degree observer, (n,), dimensionless; 0 outside 360-830 nm."""
    return colour_matching(edges)[:, 1]


def colour_matching(edges: Edges) -> FloatArray:
    """Return x-bar, y-bar, z-bar of the CIE 1931 2 degree observer, (n, 3), dimensionless; 0 outside 360-830 nm."""
    return observer("CIE 1931 2 Degree Standard Observer", checked_edges(edges))


def cone_fundamentals(edges: Edges) -> FloatArray:
    """Return L, M, S of Stockman & Sharpe, 2 degrees, energy-based, peak 1, (n, 3); 0 outside 390-830 nm."""
    return observer("Stockman & Sharpe 2 Degree Cone Fundamentals", checked_edges(edges))


@lru_cache(maxsize=128)
def observer(name: str, edges: tuple[float, ...]) -> FloatArray:
    return frozen(bin_means(*shipped.curve("observer", name), edges, "zero"))


def xyz_to_lms_matrix(edges: Edges) -> FloatArray:
    """Return the matrix from tristimulus values to cone responses.

    Parameters
    ----------
    edges : (n + 1,) ascending, nm; at least three bins

    Returns
    -------
    (3, 3) array A with ``cone_fundamentals ~ colour_matching @ A.T``, least squares over wavelength.

    Raises
    ------
    ValueError
        For fewer than three independent bins.

    Notes
    -----
    Bins are weighted by their width. No matrix is exact, since the 1931 observer is not sensitive enough in the blue:
    the rms residual is 0.010, 0.009 and 0.042 of the peak for L, M and S, the largest 0.20 in S at 415 nm (380-780 nm
    in 5 nm).
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
    """Return the relative spectral sensitivity of a camera.

    Parameters
    ----------
    name : str
        A name in ``colour.MSDS_CAMERA_SENSITIVITIES`` ("Nikon 5100 (NPL)", "Sigma SDMerill (NPL)"), the path of
        a CSV table, or the name under which a distribution provides one.
    edges : (n + 1,) ascending, nm

    Returns
    -------
    channels : ("R", "G", "B"), or the columns of the file
    sensitivity : (n, k) array, relative to the peak of each channel; 0 farther than half a step from the table

    Raises
    ------
    ValueError
        For an unknown name.
    """
    if spectrum(name):
        columns, values = table_from_csv(name, edges)
        return tuple(columns), values
    return ("R", "G", "B"), _camera_sensitivity(name, checked_edges(edges))


@lru_cache(maxsize=128)
def _camera_sensitivity(name: str, edges: tuple[float, ...]) -> FloatArray:
    rows = shipped.curve("camera", name)[0]
    return frozen(bin_means(*with_reach(rows, *shipped.curve("smooth camera", name)), edges, "zero"))


def camera_rows(name: str) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Return channels, wavelengths (rows,) in nm and relative sensitivities (rows, k) of a camera's table."""
    if spectrum(name):
        columns, nodes, values = csv_rows(name)
        return tuple(columns), nodes, values
    return ("R", "G", "B"), *shipped.curve("camera", name)


def display_primaries(name: str, edges: Edges) -> FloatArray:
    """Return the spectral power of a display's red, green and blue.

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
        For an unknown name.
    """
    return _display_primaries(name, checked_edges(edges))


@lru_cache(maxsize=128)
def _display_primaries(name: str, edges: tuple[float, ...]) -> FloatArray:
    return frozen(bin_means(*shipped.curve("display", name), edges, "zero"))


def colorchecker(edges: Edges) -> tuple[list[str], FloatArray]:
    """Return the reflectance of the 24 patches of the ColorChecker Classic.

    Parameters
    ----------
    edges : (n + 1,) ascending, nm

    Returns
    -------
    names : list of 24 str, row by row from "dark skin" to "black 2 (1.5 D)"
    reflectance : (24, n) array, dimensionless

    Notes
    -----
    Source: the BabelColor average of 30 charts, 380-730 nm. Outside the table the end value is held, as in ASTM E308: a
    patch does not turn black where its measurement ends.
    """
    names, reflectance = _colorchecker(checked_edges(edges))
    return list(names), reflectance


@lru_cache(maxsize=32)
def _colorchecker(edges: tuple[float, ...]) -> tuple[tuple[str, ...], FloatArray]:
    patches = tuple(shipped.names("patch"))
    means = [bin_means(*shipped.curve("patch", name), edges, "hold") for name in patches]
    return patches, frozen(means)

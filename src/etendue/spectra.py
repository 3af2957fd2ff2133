"""Spectral tables as bin means: lights, eyes, cameras, displays, test charts.

In:  the name of a table (or a CSV file) and the bin edges of a wavelength axis (n + 1 ascending values, nm).
Out: plain float64 arrays, one mean per bin, read-only where they are cached.
Sources: the data and matrices of colour-science; CIE 15:2018 for interpolation; Mallett & Yuksel (2019).

This is the one module that imports colour-science, and it does so at the first call that needs a table: the
import takes a second or more, and a run that reads only files should not pay for it.

A bin mean is the exact integral of a piecewise-linear interpolant, divided by the width of the bin, so that
means over the parts of a bin average back to the mean over the bin. The interpolant runs through

- the rows themselves for light sources, as CIE 15 asks for its illuminants, for displays and for CSV files:
  a smooth curve overshoots their lines (Sprague lifts the Apple display's green peak from 1.58 to 1.71);
- for smooth tables (matching functions, cones, cameras, reflectances) values at 1 nm, to which Sprague's
  quintic leads where the table is coarser. What it puts below 0 beside steep feet (at most 1.4e-4 of a
  channel's area) is set to 0.
"""

import importlib.metadata
import re
import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from etendue.constants import BOLTZMANN, LUMINOUS_EFFICACY, PLANCK, SPEED_OF_LIGHT

FloatArray = npt.NDArray[np.float64]
Edges = Sequence[float] | FloatArray
Outside = Literal["zero", "hold"]

SECOND_RADIATION_CONSTANT = PLANCK * SPEED_OF_LIGHT / BOLTZMANN * 1e9  # nm K
PLANCK_REFERENCE = 560.0  # nm; where a Planck spectrum is 100, as CIE illuminant A is
LOWEST_TEMPERATURE = 100.0  # K; colder spectra overflow float64 towards the infrared
UNWANTED_WARNING = "related API features are not available"
COMPUTED_ILLUMINANTS = "'<T> K' for a Planck radiator, '<w> nm' for a line"


# ---------------------------------------------------------------------------------------------- the library


def colour_version() -> str:
    """Version of the installed colour-science, read without importing it."""
    return importlib.metadata.version("colour-science")


@lru_cache(maxsize=1)
def _colour() -> ModuleType:
    """colour-science, imported late, without its remarks about optional packages we do not use."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        import colour
    for entry in caught:
        unwanted = issubclass(entry.category, colour.utilities.ColourUsageWarning)
        if not (unwanted and UNWANTED_WARNING in str(entry.message)):
            warnings.warn_explicit(entry.message, entry.category, entry.filename, entry.lineno)
    return colour


def _lookup(table: Mapping[str, Any], name: str, kind: str, besides: str = "") -> Any:
    """``table[name]`` for an exact name, or ValueError with the nearest names that exist."""
    _require_name(name, table.keys(), kind, besides)
    return table[name]


def _require_name(name: str, names: Collection[str], kind: str, besides: str = "") -> None:
    if name in list(names):  # a list, because colour's key views also match other spellings
        return
    spelled = {candidate.casefold(): candidate for candidate in names}
    nearest = [spelled[n] for n in get_close_matches(str(name).casefold(), spelled, n=5, cutoff=0.4)]
    shown = nearest or sorted(names)[:12]
    label = "nearest names" if nearest else "known names"
    tail = f"; also {besides}" if besides else ""
    raise ValueError(f"unknown {kind} {name!r}; {label}: {', '.join(map(repr, shown))}{tail}")


# ------------------------------------------------------------------------------------------------ bin means


def _checked_edges(edges: Edges) -> tuple[float, ...]:
    array = np.asarray(edges, dtype=np.float64)
    if array.ndim != 1 or array.size < 2:
        raise ValueError(f"edges must be one axis of at least two wavelengths [nm], got shape {array.shape}")
    if not (np.all(np.isfinite(array)) and array[0] > 0 and np.all(np.diff(array) > 0)):
        raise ValueError(f"edges must be finite, positive and strictly ascending [nm], got {array}")
    return tuple(array.tolist())


def _frozen(array: npt.ArrayLike) -> FloatArray:
    result = np.array(array, dtype=np.float64)
    result.setflags(write=False)
    return result


def _bin_means(
    nodes: FloatArray, values: FloatArray, edges: tuple[float, ...], outside: Outside
) -> FloatArray:
    """Exact means of the piecewise-linear curve through (nodes, values) over each bin.

    Every area is a sum of trapezoids inside its own bin: differences of one running integral would lose the
    small values in the feet of a curve to cancellation.
    """
    bounds = np.asarray(edges)
    grid = np.union1d(nodes, bounds)
    grid = grid[(grid >= bounds[0]) & (grid <= bounds[-1])]
    columns = values.reshape(len(nodes), -1)
    curve = np.stack([np.interp(grid, nodes, column) for column in columns.T], axis=1)
    areas = 0.5 * (curve[1:] + curve[:-1]) * np.diff(grid)[:, None]
    if outside == "zero":
        inside = (grid[:-1] >= nodes[0]) & (grid[1:] <= nodes[-1])
        areas *= inside[:, None]
    sums = np.add.reduceat(areas, np.searchsorted(grid, bounds[:-1]), axis=0)
    return (sums / np.diff(bounds)[:, None]).reshape((len(edges) - 1, *values.shape[1:]))


def _rows(table: Any) -> tuple[FloatArray, FloatArray]:
    return np.array(table.wavelengths, dtype=np.float64), np.array(table.values, dtype=np.float64)


def _smooth_rows(table: Any) -> tuple[FloatArray, FloatArray]:
    """Rows of a smooth table at 1 nm: Sprague where the table is uniform and coarser, else as they are."""
    nodes, values = _rows(table)
    steps = np.diff(nodes)
    if not np.allclose(steps, steps[0], rtol=1e-9) or steps[0] <= 1.0 or len(nodes) < 6:
        return nodes, values
    fine = np.linspace(nodes[0], nodes[-1], round(nodes[-1] - nodes[0]) + 1)
    columns = values.reshape(len(nodes), -1).T
    curves = np.stack([_colour().SpragueInterpolator(nodes, column)(fine) for column in columns], axis=1)
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
        "<T> K", a Planck radiator at T >= 100 K, 100 at 560 nm; or "<w> nm", a spectral line.
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
    return _illuminant(name, _checked_edges(edges))


@lru_cache(maxsize=128)
def _illuminant(name: str, edges: tuple[float, ...]) -> FloatArray:
    computed = re.fullmatch(r"\s*(\d+\.?\d*(?:[eE][+-]?\d+)?)\s*(K|nm)\s*", str(name))
    if computed:
        number = float(computed[1])
        return _frozen(_planck(number, edges) if computed[2] == "K" else _line(number, edges))
    if name == "E":
        return _frozen(np.full(len(edges) - 1, 100.0))
    nodes, values = _rows(_lookup(_colour().SDS_ILLUMINANTS, name, "illuminant", COMPUTED_ILLUMINANTS))
    if edges[0] < nodes[0] or edges[-1] > nodes[-1]:
        raise ValueError(
            f"illuminant {name!r} is tabulated from {nodes[0]:g} to {nodes[-1]:g} nm, but the bins span "
            f"{edges[0]:g} to {edges[-1]:g} nm; narrow the wavelength axis, or use 'E' or '<T> K'"
        )
    return _frozen(_bin_means(nodes, values, edges, "zero"))


def _planck(temperature: float, edges: tuple[float, ...]) -> FloatArray:
    """Gauss-Legendre, five points in each panel of at most 1 nm, or of 1/400 of longer wavelengths."""
    if not LOWEST_TEMPERATURE <= temperature < np.inf:
        raise ValueError(
            f"illuminant temperature must be {LOWEST_TEMPERATURE:g} K or more, got {temperature:g} K"
        )
    bounds = np.asarray(edges)
    widths = np.diff(bounds)
    panels = int(np.ceil(np.max(widths / np.maximum(1.0, bounds[:-1] / 400.0))))
    points, weights = np.polynomial.legendre.leggauss(5)
    inside = ((np.arange(panels)[:, None] + 0.5 + 0.5 * points) / panels).ravel()
    wavelength = bounds[:-1, None] + widths[:, None] * inside
    x = SECOND_RADIATION_CONSTANT / (wavelength * temperature)
    reference = SECOND_RADIATION_CONSTANT / (PLANCK_REFERENCE * temperature)
    # exp(-x) taken out of both exponentials, so that cold radiators neither overflow nor divide 0 by 0
    ratio = np.exp(reference - x) * np.expm1(-reference) / np.expm1(-x)
    power = 100.0 * (PLANCK_REFERENCE / wavelength) ** 5 * ratio
    return power @ np.tile(weights, panels) / (2.0 * panels)


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


def absolute_scale(spd: npt.ArrayLike, edges: Edges, luminance: float) -> float:
    """Factor that gives a relative spectrum a luminance.

    Parameters
    ----------
    spd : (n,) array, any unit per nm
    edges : (n + 1,) ascending, nm
    luminance : float, cd m-2, above 0

    Returns
    -------
    float
        k with 683.002 sum(k spd V width) = luminance, so k spd is a radiance [W m-2 sr-1 nm-1].

    Raises
    ------
    ValueError
        A shape that does not fit the edges, a negative or invisible spectrum, a luminance not above 0.
    """
    bounds = np.asarray(_checked_edges(edges))
    power = np.asarray(spd, dtype=np.float64)
    if power.shape != (len(bounds) - 1,):
        raise ValueError(
            f"spd must have one value for each of {len(bounds) - 1} bins, got shape {power.shape}"
        )
    if not (np.all(np.isfinite(power)) and np.all(power >= 0)):
        raise ValueError("spd must be finite and nowhere negative")
    if not 0 < luminance < np.inf:
        raise ValueError(f"luminance must be finite and above 0 cd m-2, got {luminance}")
    visible = LUMINOUS_EFFICACY * float(np.sum(power * luminous_efficiency(edges) * np.diff(bounds)))
    if visible == 0:
        raise ValueError("spd has no visible power in these bins, so no factor gives it a luminance")
    return luminance / visible


# ------------------------------------------------------------------------------------------------- observers


def luminous_efficiency(edges: Edges) -> FloatArray:
    """V(lambda): y-bar of the CIE 1931 2 degree observer, (n,), dimensionless; 0 outside 360-830 nm."""
    return colour_matching(edges)[:, 1]


def colour_matching(edges: Edges) -> FloatArray:
    """x-bar, y-bar, z-bar of the CIE 1931 2 degree observer, (n, 3), dimensionless; 0 outside 360-830 nm."""
    return _observer("CIE 1931 2 Degree Standard Observer", _checked_edges(edges))


def cone_fundamentals(edges: Edges) -> FloatArray:
    """L, M, S of Stockman & Sharpe, 2 degrees, energy-based, peak 1, (n, 3); 0 outside 390-830 nm."""
    return _observer("Stockman & Sharpe 2 Degree Cone Fundamentals", _checked_edges(edges))


@lru_cache(maxsize=128)
def _observer(name: str, edges: tuple[float, ...]) -> FloatArray:
    return _frozen(_bin_means(*_smooth_rows(_colour().MSDS_CMFS[name]), edges, "zero"))


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
    return _xyz_to_lms_matrix(_checked_edges(edges))


@lru_cache(maxsize=128)
def _xyz_to_lms_matrix(edges: tuple[float, ...]) -> FloatArray:
    weight = np.sqrt(np.diff(edges))[:, None]
    matching, cones = weight * colour_matching(edges), weight * cone_fundamentals(edges)
    solution, _, rank, singular = np.linalg.lstsq(matching, cones, rcond=None)
    if rank < 3 or singular[0] > 1e3 * singular[-1]:
        raise ValueError(f"edges must give at least three bins where the eye responds, got {_span(edges)}")
    return _frozen(solution.T)


def _span(edges: tuple[float, ...]) -> str:
    return f"{len(edges) - 1} bins from {edges[0]:g} to {edges[-1]:g} nm"


# -------------------------------------------------------------------------------- cameras, displays, charts


def camera_sensitivity(name: str, edges: Edges) -> tuple[tuple[str, ...], FloatArray]:
    """Relative spectral sensitivity of a camera.

    Parameters
    ----------
    name : str
        A name in ``colour.MSDS_CAMERA_SENSITIVITIES`` ("Nikon 5100 (NPL)", "Sigma SDMerill (NPL)").
    edges : (n + 1,) ascending, nm

    Returns
    -------
    channels : ("R", "G", "B")
    sensitivity : (n, 3) array, relative to the peak of each channel; 0 outside the table

    Raises
    ------
    ValueError
        Unknown name.
    """
    return ("R", "G", "B"), _camera_sensitivity(name, _checked_edges(edges))


@lru_cache(maxsize=128)
def _camera_sensitivity(name: str, edges: tuple[float, ...]) -> FloatArray:
    table = _lookup(_colour().MSDS_CAMERA_SENSITIVITIES, name, "camera")
    return _frozen(_bin_means(*_smooth_rows(table), edges, "zero"))


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
    return _display_primaries(name, _checked_edges(edges))


@lru_cache(maxsize=128)
def _display_primaries(name: str, edges: tuple[float, ...]) -> FloatArray:
    table = _lookup(_colour().MSDS_DISPLAY_PRIMARIES, name, "display")
    return _frozen(_bin_means(*_rows(table), edges, "zero"))


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
    names, reflectance = _colorchecker(_checked_edges(edges))
    return list(names), reflectance


@lru_cache(maxsize=32)
def _colorchecker(edges: tuple[float, ...]) -> tuple[tuple[str, ...], FloatArray]:
    patches = _colour().SDS_COLOURCHECKERS["BabelColor Average"]
    means = [_bin_means(*_smooth_rows(table), edges, "hold") for table in patches.values()]
    return tuple(patches), _frozen(means)


# ------------------------------------------------------------------------------------- RGB to reflectance


def srgb_to_xyz(edges: Edges) -> FloatArray:
    """Matrix from linear sRGB to XYZ (Y of white = 1) for the primaries of sRGB and the D65 of these bins.

    Parameters
    ----------
    edges : (n + 1,) ascending, nm

    Returns
    -------
    (3, 3) array

    Notes
    -----
    The four digits of IEC 61966-2-1 describe a white of (0.9505, 1, 1.0890); sums over bins give a slightly
    different one. This matrix keeps the chromaticities of the primaries and sends (1, 1, 1) to the white the
    bins have: the largest difference from the standard's is 4.6e-4 (1 nm bins), 6.0e-4 (5 nm) or 1.03e-3
    (10 nm) over 380-780 nm.
    """
    return _srgb_to_xyz(_checked_edges(edges))


@lru_cache(maxsize=32)
def _srgb_to_xyz(edges: tuple[float, ...]) -> FloatArray:
    white = _d65_weights(edges).sum(axis=0)
    x, y = np.asarray(_colour().RGB_COLOURSPACES["sRGB"].primaries, dtype=np.float64).reshape(3, 2).T
    primaries = np.stack([x / y, np.ones(3), (1.0 - x - y) / y])
    return _frozen(primaries * np.linalg.solve(primaries, white))


def _d65_weights(edges: tuple[float, ...]) -> FloatArray:
    """(n, 3) weights with ``reflectance @ weights`` = XYZ under D65.

    colour-science tabulates D65 up to 780 nm. Bins beyond count as dark here (the eye's response there is
    1e-5), so that an axis to 1100 nm can still show photographs.
    """
    nodes, values = _rows(_colour().SDS_ILLUMINANTS["D65"])
    power = _bin_means(nodes, values, edges, "zero") * np.diff(edges)
    weights = power[:, None] * colour_matching(edges)
    total = weights[:, 1].sum()
    if total == 0:
        raise ValueError(f"edges must reach into the visible, got {_span(edges)}")
    return weights / total


def upsampling_basis(edges: Edges) -> FloatArray:
    """Reflectance spectra of linear sRGB: ``reflectance = basis @ rgb``.

    Parameters
    ----------
    edges : (n + 1,) ascending, nm; at least three bins in the visible

    Returns
    -------
    (n, 3) array, dimensionless
        Columns add up to 1 in every bin, so that grey photographs get flat spectra.

    Raises
    ------
    ValueError
        Bins too few or too far from the visible to tell three primaries apart.

    Notes
    -----
    Source: the basis of Mallett & Yuksel (2019, https://doi.org/10.2312/sr.20191216), Sprague to 1 nm, means
    over the bins, held outside 380-780 nm. Two corrections: each row is divided by its sum (which is 1 within
    1e-5), and a 3 x 3 matrix makes the round trip exact in these bins, that is sum(basis x D65 x observer) =
    ``srgb_to_xyz(edges)``. Together they move the basis by at most 1.2e-3 (5 nm bins), 4.6e-3 (10 nm) and
    2.2e-2 (20 nm).
    Error: round trip below 1e-15, sum of columns within 2e-15 of 1. Values within [0.0029, 0.978] for 10 nm
    bins over 380-780 nm, so that RGB inside [0, 1] gives reflectances inside [0, 1]; bins of 20 nm reach
    -0.0064.
    """
    return _upsampling_basis(_checked_edges(edges))


@lru_cache(maxsize=32)
def _upsampling_basis(edges: tuple[float, ...]) -> FloatArray:
    table = _colour().recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019
    raw = _bin_means(*_smooth_rows(table), edges, "hold")
    raw = raw / raw.sum(axis=1, keepdims=True)
    response = _d65_weights(edges).T @ raw
    if np.linalg.cond(response) > 1e3:
        raise ValueError(f"edges must tell the three sRGB primaries apart, got {_span(edges)}")
    return _frozen(raw @ np.linalg.solve(response, srgb_to_xyz(edges)))


# -------------------------------------------------------------------------------------------- 3 x 3 matrices


def rgb_space_matrix(name: str) -> tuple[FloatArray, FloatArray]:
    """RGB to XYZ matrix (3, 3) and white point xy (2,) of a space in ``colour.RGB_COLOURSPACES``.

    The matrix is the one the standard prints, so for "sRGB" it has four digits. Unknown names raise
    ValueError.
    """
    space = _lookup(_colour().RGB_COLOURSPACES, name, "RGB space")
    return _frozen(space.matrix_RGB_to_XYZ), _frozen(space.whitepoint)


def adaptation_matrix(name: str) -> FloatArray:
    """XYZ to sharpened cone responses, (3, 3), by name: "Von Kries", "Bradford", "CAT02", "CAT16", ...

    Any name in ``colour.adaptation.CHROMATIC_ADAPTATION_TRANSFORMS``; others raise ValueError.
    """
    transforms = _colour().adaptation.CHROMATIC_ADAPTATION_TRANSFORMS
    return _frozen(_lookup(transforms, name, "adaptation transform"))


# -------------------------------------------------------------------------------------------------- CSV files


def table_from_csv(
    path: str | Path, edges: Edges, columns: Iterable[str] | None = None
) -> tuple[list[str], FloatArray]:
    """Bin means of a table in a CSV file.

    Parameters
    ----------
    path : str or Path
        Header ``wavelength_nm,a,b,...``, then at least two rows of numbers with ascending wavelengths, in any
        spacing. ``#`` starts a comment; empty lines are skipped; UTF-8.
    edges : (n + 1,) ascending, nm
    columns : names, optional
        Which columns, in which order. All of them by default.

    Returns
    -------
    names : list of k str
    means : (n, k) array in the units of the file; 0 outside the table

    Raises
    ------
    ValueError
        A broken file, naming file and line, or a column it does not have.
    """
    checked = _checked_edges(edges)
    names, nodes, values = _read_csv(Path(path))
    wanted = names if columns is None else list(columns)
    for name in wanted:
        _require_name(name, names, f"column of {path}:")
    return wanted, _bin_means(nodes, values[:, [names.index(name) for name in wanted]], checked, "zero")


def _read_csv(path: Path) -> tuple[list[str], FloatArray, FloatArray]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not a UTF-8 text file ({error.reason} at byte {error.start})") from error
    numbered = enumerate(text.splitlines(), start=1)
    stripped = ((number, line.partition("#")[0].strip()) for number, line in numbered)
    lines = [(number, [cell.strip() for cell in line.split(",")]) for number, line in stripped if line]
    if not lines:
        raise ValueError(f"{path}: no header; expected 'wavelength_nm,a,b,...'")
    first, header = lines[0]
    names = header[1:]
    if header[0] != "wavelength_nm" or not names or not all(names) or len(set(names)) < len(names):
        raise ValueError(
            f"{path}, line {first}: header {','.join(header)!r}; "
            "expected 'wavelength_nm,a,b,...' with distinct names"
        )
    rows = [_csv_row(path, number, cells, header) for number, cells in lines[1:]]
    if len(rows) < 2:
        raise ValueError(f"{path}: {len(rows)} rows of numbers; at least two are needed")
    table = np.array(rows)
    for (number, _), before, after in zip(lines[2:], table[:-1, 0], table[1:, 0], strict=True):
        if not after > before:
            raise ValueError(
                f"{path}, line {number}: wavelength {after:g} nm does not ascend from {before:g} nm"
            )
    return names, table[:, 0], table[:, 1:]


def _csv_row(path: Path, number: int, cells: list[str], header: list[str]) -> list[float]:
    if len(cells) != len(header):
        raise ValueError(f"{path}, line {number}: {len(cells)} cells, but the header has {len(header)}")
    values = []
    for cell, name in zip(cells, header, strict=True):
        try:
            value = float(cell)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise ValueError(f"{path}, line {number}: {cell!r} in column {name!r} is not a finite number")
        values.append(value)
    return values

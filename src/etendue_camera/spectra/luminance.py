"""Luminance of a light over its full spectrum, regardless of the rendered wavelengths.

In:  the name of an illuminant; the luminance of a white diffuser under it (cd m-2).
Out: its spectral radiance as bin means; the fraction of the luminance in a window of wavelengths.
Sources: CIE 15:2018 (luminance is an integral over 360-830 nm; beyond a table the nearest measured value applies).
"""

from functools import lru_cache

import numpy as np

from etendue import require
from etendue_camera.constants import LUMINOUS_EFFICACY
from etendue_camera.spectra import shipped
from etendue_camera.spectra.authority import OBSERVERS
from etendue_camera.spectra.bins import Edges, FloatArray, checked_edges
from etendue_camera.spectra.ends import CONSEQUENCE
from etendue_camera.spectra.library import illuminant, illuminant_rows, planck_power
from etendue_camera.spectra.names import COMPUTED, EYE, MOST_OF_IT, line_of, range_of, state_of

UNMEASURED = 0.01  # fraction of the luminance that may depend on an extended end value


def luminance_of(name: str) -> float:
    """Return the luminance of a light, K_m times the integral of S V.

    Parameters
    ----------
    name : str
        As for `illuminant`.

    Returns
    -------
    float, cd m-2
        Luminance of a radiance that has the values of `illuminant` in W m-2 sr-1 nm-1; 0 for an invisible line.

    Raises
    ------
    ValueError
        For an unknown name, or a table where more than 1 % of the luminance would depend on its end value.

    Notes
    -----
    V is linear between its rows at 1 nm, and a table is linear between its own rows. Three Gauss points per interval of
    both are exact for their product, for any bins of a pipeline. A table that ends inside 360-830 nm keeps its end
    value. Error: 2e-16 for D65, A and FL11 (against exact fractions), 1.2e-15 for Planck radiators of 1000, 3200 and
    1e5 K (40 digits). A sum of products of bin means would differ from the result: for D65 by 2e-5, 8e-5, 2.3e-4, 3e-3
    and 1.1e-2 with bins of 5, 10, 20 (380-780 nm), 50 and 100 nm (400-700 nm), for the lines of FL11 by 2.8e-4, 1.0e-3
    and 3.1e-3 with 5, 10 and 20 nm.
    """
    total, held = _luminance_of(str(name), *EYE, state_of(name))
    if held > UNMEASURED * total:
        rows = illuminant_rows(name)[0]
        raise ValueError(
            f"illuminant {name!r} is tabulated from {rows[0]:g} to {rows[-1]:g} nm. If its end values were "
            f"extended, {100 * held / total:.2g} % of its luminance would lie outside this range; use another light, "
            "or white_luminance = 0 and the scene's radiance"
        )
    return total


@lru_cache(maxsize=256)
def _luminance_of(name: str, lowest: float, highest: float, state: tuple[int, int]) -> tuple[float, float]:
    """Return the luminance (cd m-2) between two wavelengths (nm), and the part of it outside the rows of a table."""
    eye, efficiency = _efficiency()
    lowest, highest = max(lowest, float(eye[0])), min(highest, float(eye[-1]))
    if not lowest < highest:
        return 0.0, 0.0
    line = line_of(name)
    if line is not None:
        inside = lowest <= line <= highest
        return LUMINOUS_EFFICACY * float(np.interp(line, eye, efficiency)) * inside, 0.0
    computed = COMPUTED.fullmatch(name)
    nodes, values = (np.empty(0), np.empty(0)) if computed or name == "E" else illuminant_rows(name)
    grid = np.union1d(eye, [lowest, highest, *nodes])
    grid = grid[(grid >= lowest) & (grid <= highest)]
    points, weights = np.polynomial.legendre.leggauss(5 if computed else 3)
    half = 0.5 * np.diff(grid)[:, None]
    wavelength = grid[:-1, None] + half * (1.0 + points)
    if computed:
        power = planck_power(float(computed[1]), wavelength)
    elif not nodes.size:
        power = np.full_like(wavelength, 100.0)
    else:
        power = np.interp(wavelength, nodes, values)
    parts = LUMINOUS_EFFICACY * (half * power * np.interp(wavelength, eye, efficiency)) @ weights
    held = float(parts[(grid[:-1] < nodes[0]) | (grid[1:] > nodes[-1])].sum()) if nodes.size else 0.0
    return float(parts.sum()), held


@lru_cache(maxsize=1)
def _efficiency() -> tuple[FloatArray, FloatArray]:
    """Return wavelengths (nm) and values of V(lambda), y-bar of the CIE 1931 2 degree observer."""
    nodes, values = shipped.curve("observer", OBSERVERS[0])
    return nodes, values[:, 1]


def light_of_luminance(name: str, edges: Edges, luminance: float) -> FloatArray:
    """Return the spectral radiance of a white diffuser under a light, scaled to a luminance over the light's full
    spectrum.

    Parameters
    ----------
    name : str
        As in `illuminant`.
    edges : (n + 1,) ascending, nm
        The rendered part of the light.
    luminance : float, cd m-2
        Luminance of the whole light, above 0.

    Returns
    -------
    (n,) array, W m-2 sr-1 nm-1
        The value in a bin does not depend on the other bins.

    Raises
    ------
    ValueError
        As for `illuminant` and `luminance_of`; also for an invisible light or a luminance that is not above 0.
    """
    require.that(0 < luminance < np.inf, f"luminance must be finite and above 0 cd m-2, got {luminance}")
    whole = luminance_of(name)
    if not whole > 0:
        raise ValueError(_unseen(name))
    return illuminant(name, edges) * (luminance / whole)


def light_of_radiance(name: str, edges: Edges, radiance: float) -> FloatArray:
    """Return the spectral radiance of a white diffuser under a light, scaled to a radiance over the rendered
    wavelengths.

    Parameters
    ----------
    name, edges
        As in `light_of_luminance`.
    radiance : float, W m-2 sr-1
        Summed over the bins, above 0.

    Returns
    -------
    (n,) array, W m-2 sr-1 nm-1
    """
    require.that(0 < radiance < np.inf, f"radiance must be finite and above 0 W m-2 sr-1, got {radiance}")
    relative = illuminant(name, edges)
    return relative * (radiance / float(relative @ np.diff(checked_edges(edges))))


def check_luminance(name: str) -> None:
    """Raise ValueError for a light whose luminance is 0 or unknown; a table is read only if its range is short."""
    line = line_of(name)
    if line is not None:
        if not EYE[0] <= line <= EYE[1]:
            raise ValueError(_unseen(name))
        return
    first, last = range_of(name)
    if first > MOST_OF_IT[0] or last < MOST_OF_IT[1]:
        luminance_of(name)


def _unseen(name: str) -> str:
    return (
        f"illuminant {name!r} is not visible and has no luminance: set white_luminance = 0 and give the scene's "
        f"radiance (W m-2 sr-1) instead"
    )


def luminance_notes(name: str, lowest: float, highest: float) -> list[str]:
    """Return notes on a light of known luminance of which only ``lowest`` to ``highest`` (nm) is rendered.

    Tables are read only if the light or the rendered range may end within the visible range.
    """
    if line_of(name) is not None:
        return []
    said = []
    first, last = range_of(name)
    if first > MOST_OF_IT[0] - 40 or last < MOST_OF_IT[1] + 40:
        whole, held = _luminance_of(name, *EYE, state_of(name))
        share = held / whole if whole > 0 else 0.0
        if share > CONSEQUENCE:
            said.append(
                f"illuminant {name!r} is tabulated from {first:g} to {last:g} nm: outside, its end values are used, "
                f"which make up {100 * share:.2g} % of its luminance"
            )
    if lowest > MOST_OF_IT[0] or highest < MOST_OF_IT[1]:
        share = rendered_share(name, lowest, highest)
        if share < 1 - UNMEASURED:
            said.append(
                f"{lowest:g} to {highest:g} nm contains {100 * share:.2g} % of the luminance of {name}: "
                "white_luminance refers to the whole light; lux and exposure metrics refer to the rendered part"
            )
    return said


def rendered_share(name: str, lowest: float, highest: float) -> float:
    """Return the fraction of a light's luminance in a window of wavelengths (nm); 0 for invisible light."""
    whole = _luminance_of(str(name), *EYE, state_of(name))[0]
    return _luminance_of(str(name), float(lowest), float(highest), state_of(name))[0] / whole if whole > 0 else 0.0

"""Colours of a ColorChecker in a photograph, compared with the colours of its reflectances under D50.

In:  a photograph, the four corners of the chart.
Out: CIEDE2000 of each patch, as photographed and after one exposure gain, with intervals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from etendue.errors import RequestError
from etendue.types.arrays import Array
from etendue.types.documents import Document
from etendue_camera import spectra
from etendue_camera.colour.difference import lab
from etendue_camera.colour.matrices import von_kries_matrix, xyz_from_xy
from etendue_camera.quality.chart_patches import DRAWS, ColourErrors, Patches, chart_patches, colour_errors, turning
from etendue_lab.measure.photograph import PhotographFile, developed
from etendue_lab.measure.regions import corners

ROWS, COLUMNS = 4, 6
GREYS = slice(18, 24)
# illuminant of the published values; range of the reflectances
WHITE, OBSERVED = ("D50", tuple(float(nm) for nm in range(380, 731)))
CLIPPED = 0.02  # share of clipped pixels above which a patch's colour is unknown
# another order of corners must reduce the mean difference to this share; tried only above this difference
BETTER, BAD = (0.6, 5.0)
STRANGE = 20.0  # mean difference after gain above which the chart is probably not a ColorChecker
ORDER = "dark skin, bluish green, black, white"


@cache
def reference() -> tuple[tuple[str, ...], Array, Array]:
    """Return names, L*a*b* (3, 24) and the XYZ of white: the mean of 30 charts under D50 for the CIE 1931 observer."""
    light = spectra.illuminant(WHITE, OBSERVED) * np.diff(OBSERVED)
    seen = spectra.colour_matching(OBSERVED)
    names, reflectance = spectra.colorchecker(OBSERVED)
    white = light @ seen
    return tuple(names), lab((reflectance * light @ seen).T / white[1], white / white[1]), white / white[1]


def to_lab(space: str) -> Callable[[Array], Array]:
    """Return the conversion from linear RGB of a space to L*a*b* under D50, its white adapted to D50 (Bradford)."""
    matrix, xy = spectra.rgb_space_matrix(space)
    _, _, white = reference()
    adapted = (
        von_kries_matrix(xyz_from_xy((float(xy[0]), float(xy[1]))), white, spectra.adaptation_matrix("Bradford"))
        @ matrix
    )
    return lambda rgb: lab(np.tensordot(adapted, rgb, 1), white)


def measured_chart(photograph: PhotographFile, text: str, space: str, confidence: float) -> Document:
    """Measure the 24 patches.

    Raises
    ------
    RequestError
        The picture is grey; corners are outside it, in the wrong order, or too close.
    """
    places = corners("--chart", text, photograph.columns, photograph.rows)
    if photograph.names == ("grey",):
        raise RequestError(f"--chart: {photograph.path.name} is grey; a chart needs a colour picture")
    notes = []
    (left, top), (right, bottom) = (
        np.floor(np.maximum(places.min(0), 0)).astype(int),
        np.ceil(places.max(0)).astype(int) + 1,
    )
    cut = np.s_[top:bottom, left:right]
    if photograph.is_raw:
        planes = np.moveaxis(developed(photograph.path)[cut], -1, 0) / 65535.0
        clipped = (planes >= 1).any(0)
        space = "sRGB"
        notes.append("colours of the raw file are LibRaw's: linear sRGB, white balance of the camera")
    else:
        planes, clipped = photograph.planes(cut), photograph.clipped(cut)
    convert = to_lab(space)
    names, goal, _ = reference()
    patches, as_is, exposed, gain = _in_order(text, places, (left, top), planes, clipped, convert, confidence)
    if patches.clipped.max() > CLIPPED:
        several = [
            f"{name} ({100 * share:.0f} %)"
            for name, share in zip(names, patches.clipped, strict=True)
            if share > CLIPPED
        ]
        notes.append(f"clipped, so their colours are unknown: {', '.join(several)}")
    if exposed.mean > STRANGE:
        notes.append("the colours hardly match a ColorChecker: check the corners, --encoding and --space")
    rows = [
        {
            "patch": name,
            "lab": as_is.lab[:, i].tolist(),
            "reference": goal[:, i].tolist(),
            "clipped": float(patches.clipped[i]),
            **_between("delta_e", as_is.delta_e[i], as_is.reach[i]),
            **_between("exposed", exposed.delta_e[i], exposed.reach[i]),
        }
        for i, name in enumerate(names)
    ]
    return {
        "corners": text,
        "space": space,
        "white": WHITE,
        "gain": gain,
        "patches": rows,
        "notes": notes,
        "as_is": _summary(as_is, names),
        "exposed": _summary(exposed, names),
    }


def _errors(
    patches: Patches, convert: Callable[[Array], Array], confidence: float, draws: int = DRAWS
) -> tuple[ColourErrors, ColourErrors, float]:
    """Return CIEDE2000 errors as photographed, and after an exposure gain that fits the luminances of the grey patches
    to the reference by least squares.
    """
    _, goal, _ = reference()
    as_is = colour_errors(patches, convert, goal, confidence, draws=draws)
    found, wanted = (_luminance(one[0, GREYS]) for one in (as_is.lab, goal))
    gain = float(found @ wanted / (found @ found)) if (found > 0).any() else 1.0
    exposed = replace(patches, mean=gain * patches.mean, covariance=gain**2 * patches.covariance)
    return as_is, colour_errors(exposed, convert, goal, confidence, draws=draws), gain


def _luminance(lightness: Array) -> Array:
    """Return Y from L*, 1 at white."""
    f = (np.asarray(lightness) + 16) / 116
    return np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29))


def _in_order(
    text: str,
    places: Array,
    first: tuple[int, int],
    planes: Array,
    clipped: Array,
    convert: Callable[[Array], Array],
    confidence: float,
) -> tuple[Patches, ColourErrors, ColourErrors, float]:
    """Measure the patches in the given order of corners; if another order fits much better, refuse and suggest it."""

    def taken(order: Array, draws: int = DRAWS) -> tuple[Patches, ColourErrors, ColourErrors, float]:
        patches = chart_patches(planes, order - np.array(first), ROWS, COLUMNS, clipped)
        return (patches, *_errors(patches, convert, confidence, draws))

    middle = places.mean(0)
    around = places[np.argsort(np.arctan2(*(places - middle).T[::-1]))]  # clockwise as seen, y down
    if turning(around) != (4, 0):
        raise RequestError(f"--chart {text}: the four points are not the corners of a chart")
    orders = [np.roll(one, -start, axis=0) for one in (around, around[::-1]) for start in range(4)]
    try:
        given = taken(places) if turning(places) in ((4, 0), (0, 4)) else None
        if given is not None and given[2].mean <= BAD:
            return given
        best = min(orders, key=lambda order: taken(order, 1)[2].mean)
        other = taken(best, 1)
    except ValueError as error:
        raise RequestError(f"--chart {text}: {error}") from None
    if given is not None and (np.array_equal(best, places) or other[2].mean > BETTER * given[2].mean):
        return given
    written = ",".join(f"{one:g}" for pair in best for one in pair)
    raise RequestError(f"--chart {text}: the corners are not in the order {ORDER}; this order fits: --chart {written}")


def _between(name: str, value: float, reach: float) -> dict[str, float]:
    return {name: float(value), f"{name}_low": max(float(value - reach), 0.0), f"{name}_high": float(value + reach)}


def _summary(found: ColourErrors, names: tuple[str, ...]) -> Document:
    worst = int(found.delta_e.argmax())
    return {
        **_between("mean", found.mean, found.mean_reach),
        **_between("max", found.delta_e[worst], found.max_reach),
        "worst": names[worst],
    }

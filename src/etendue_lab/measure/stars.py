"""MTF of Siemens stars in a photograph, with an interval.

In:  a photograph, the centre and radius of a star.
Out: a row of values with their curve.
"""

from __future__ import annotations

import math

import numpy as np

from etendue.errors import RequestError
from etendue.types.arrays import Array
from etendue.types.documents import Document
from etendue_camera.resolution.star_interval import Bootstrap, count_cycles, star_resolution
from etendue_lab.measure.photograph import PhotographFile
from etendue_lab.measure.regions import Circle, circle

ROOM = 2  # pixels around the star


def measured_star(
    photograph: PhotographFile, text: str, channel: str, cycles: int | None, confidence: float
) -> Document:
    """Measure one star.

    Raises
    ------
    RequestError
        The star is outside the picture, or cannot be measured there.
    """
    place = circle("--star", text, photograph.columns, photograph.rows)
    left, top = (max(math.floor(one - place.radius) - ROOM, 0) for one in (place.x, place.y))
    right, bottom = (math.ceil(one + place.radius) + ROOM + 1 for one in (place.x, place.y))
    cut = np.s_[top:bottom, left:right]
    image, sites = photograph.linear(channel, cut)
    try:
        found = star_resolution(
            image,
            (place.y - top, place.x - left),
            place.radius,
            cycles=cycles,
            sites=sites,
            bootstrap=Bootstrap(confidence=confidence),
        )
    except ValueError as error:
        reason = str(error).partition("; allowed:")[0].removeprefix("picture ")
        raise RequestError(f"--star {place}: {reason}{_cycles(image, place, (left, top), sites, cycles)}") from None
    response = found.response
    return {
        "star": f"{left + response.centre[1]:.2f},{top + response.centre[0]:.2f},{place.radius:g}",
        "channel": channel,
        "cycles": found.cycles,
        "mtf50": response.mtf50,
        "mtf50_low": found.mtf50_low,
        "mtf50_high": found.mtf50_high,
        "mtf10": response.mtf10,
        "mtf10_low": found.mtf10_low,
        "mtf10_high": found.mtf10_high,
        "contrast": response.contrast,
        "clipped": float(photograph.clipped(cut).mean()),
        "flags": [name for name in ("above_nyquist", "not_reached") if getattr(response, name)],
        "frequency": response.frequency.tolist(),
        "sfr": response.sfr.tolist(),
        "doubt": response.doubt.tolist(),
    }


def _cycles(image: Array, place: Circle, first: tuple[int, int], sites: Array | None, given: int | None) -> str:
    """Return advice to end an error message: give the number of cycles per turn, or correct it; '' if there is none."""
    if given is None:
        return "; give its number of periods per turn with --cycles N"
    try:
        found = count_cycles(image, (place.y - first[1], place.x - first[0]), place.radius, sites)
    except ValueError:
        return ""
    return f" of {given} cycles; counted {found}: omit --cycles" if found != given else ""

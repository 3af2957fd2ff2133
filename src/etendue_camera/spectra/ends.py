"""Where tables end: what holds beyond their rows, by one rule for each kind, and what is said of it.

In:  the rows of a table (nm, values), the wavelengths of the light (nm).
Out: how far rows reach, nm; a note, where something hangs on what nobody measured.
Source: CIE 15:2018 and ASTM E308, which hold the nearest measured value; departures are named here.

A row stands for half a step on either side, so that a table to 700 nm in steps of 10 nm covers bins to 705 nm: that far
its end value holds, whatever the table is (steps above 20 nm are a drawn curve, and its ends are its ends). Farther out

- reflectances hold their end value: a surface does not turn black where its measurement ends;
- sensitivities and filters are 0, as what a camera gathers there nobody measured, and an end value held over the
  infrared would be most of the signal; the note says how much hangs on it;
- curves by wavelength of a lens (fall-off, angles, distortion) hold their end columns;
- an illuminant is refused in what is rendered; for the luminance of the whole light it holds its end value
  (`luminance`);
- scales are refused: none of the two would be a scale;
- matching functions and cones are 0, which is how the CIE defines them.
"""

from typing import Any

import numpy as np

from etendue_camera.arrays import FloatArray

WIDEST = 20.0  # nm; rows farther apart are corners of a drawn curve, which ends where it ends
CONSEQUENCE = 1e-4  # share of a signal below which nothing is said
SEEN = 780.0  # nm; up to here an eye still sees what would hang on a held reflectance


def reach_of(rows: FloatArray) -> tuple[float, float]:
    """Lowest and highest wavelength (nm) for which the rows (n >= 2, ascending) of a table stand."""
    before, behind = (0.5 * float(step) if step <= WIDEST else 0.0 for step in (rows[1] - rows[0], rows[-1] - rows[-2]))
    return float(rows[0]) - before, float(rows[-1]) + behind


def beyond(rows: Any, lowest: float, highest: float) -> tuple[float, float]:
    """How much (nm) of the light from ``lowest`` to ``highest`` lies below and above what the rows stand for; 0
    where nothing does.
    """
    first, last = reach_of(rows)
    return max(0.0, min(first, highest) - lowest), max(0.0, highest - max(last, lowest))


HELD_TABLES = {"ColorChecker": (380.0, 730.0, 10.0), "basis of RGB": (380.0, 780.0, 5.0)}  # lowest, highest, step, nm


def held_in_the_infrared(name: str, lowest: float, highest: float) -> list[str]:
    """`held_note` of a table of the library whose end values hold; no word below 780 nm, where what hangs on them is
    hardly seen.
    """
    first, last, step = HELD_TABLES[name]
    return (
        []
        if highest <= SEEN and lowest >= first - step
        else held_note(f"the {name}", np.arange(first, last + 0.5 * step, step), lowest, highest)
    )


def cut_off_note(what: str, names: Any, rows: Any, values: Any, lowest: float, highest: float) -> list[str]:
    """What is said of a table (rows, k) that counts as 0 beyond its rows, though it has not come down to 0 there.

    The share is that of the signal of equally many photons at every wavelength, if the end values held over the light.
    """
    sides = beyond(rows, lowest, highest)
    curves = np.asarray(values, dtype=float).reshape(len(rows), -1)
    first, last = reach_of(rows)
    places = np.concatenate([[first], rows, [last]])
    grid = np.unique(np.clip(np.concatenate([places, [lowest, highest]]), max(lowest, first), min(highest, last)))
    worst, text = CONSEQUENCE, ""
    for name, curve in zip(names, curves.T, strict=True):
        inside = float(np.trapezoid(np.interp(grid, rows, curve), grid))
        lost = sides[0] * float(curve[0]) + sides[1] * float(curve[-1])
        share = lost / (inside + lost) if inside + lost > 0 else 0.0
        if share > worst:
            worst, text = share, str(name)
    if not text:
        return []
    return [
        f"{what} has rows from {rows[0]:g} to {rows[-1]:g} nm, but the light reaches from {lowest:g} to {highest:g} "
        f"nm: beyond "
        f"{first:g} and {last:g} nm it counts as 0; with its end values held, {100 * worst:.2g} % of the signal of "
        f"{text} would lie there; "
        "add rows to the table, or narrow the scene's wavelengths"
    ]


def held_note(what: str, rows: Any, lowest: float, highest: float) -> list[str]:
    """What is said of a table whose end values hold, where the light reaches farther than its rows."""
    below, above = beyond(rows, lowest, highest)
    if below + above <= CONSEQUENCE * (highest - lowest):
        return []
    return [
        f"{what} has rows from {rows[0]:g} to {rows[-1]:g} nm, but the light reaches from {lowest:g} to {highest:g} "
        f"nm: its end values "
        f"hold over the other {100 * (below + above) / (highest - lowest):.2g} % of these wavelengths"
    ]

"""Values beyond the ends of tables, by one rule per kind, and the notes on them.

In:  the rows of a table (nm, values), the wavelengths of the light (nm).
Out: the range covered by the rows; a note if the result depends on unmeasured values.
Source: CIE 15:2018 and ASTM E308, which hold the nearest measured value; departures are documented here.

A row covers half a step on either side, so that a table to 700 nm in steps of 10 nm covers bins to 705 nm: within that
range its end value is used, for any table (with steps above 20 nm a table is a drawn curve that ends at its ends).
Farther out

- reflectances keep their end value: a surface does not turn black where its measurement ends;
- sensitivities and filters are 0, since the camera's response there is unmeasured, and an end value extended over the
  infrared would be most of the signal; the note gives the fraction of the signal concerned;
- lens curves by wavelength (falloff, angles, distortion) keep their end columns;
- an illuminant raises an error for rendered wavelengths; for the luminance of the whole light it keeps its end value
  (`luminance`);
- scales raise an error, because neither 0 nor an end value would be a valid scale;
- matching functions and cones are 0, as the CIE defines them.
"""

from collections.abc import Sequence

import numpy as np

from etendue_camera.arrays import FloatArray

WIDEST = 20.0  # nm; rows farther apart are corners of a drawn curve, which is not extended
CONSEQUENCE = 1e-4  # fraction of a signal below which there is no note
SEEN = 780.0  # nm; up to here the effect of an extended reflectance is visible


def reach_of(rows: FloatArray) -> tuple[float, float]:
    """Return the lowest and highest wavelength (nm) covered by the rows (n >= 2, ascending) of a table."""
    before, behind = (0.5 * float(step) if step <= WIDEST else 0.0 for step in (rows[1] - rows[0], rows[-1] - rows[-2]))
    return float(rows[0]) - before, float(rows[-1]) + behind


def beyond(rows: FloatArray, lowest: float, highest: float) -> tuple[float, float]:
    """Return the widths (nm) of the parts of the rendered range, from ``lowest`` to ``highest``, that lie below and
    above the range of the rows; 0 for a part that does not exist.
    """
    first, last = reach_of(rows)
    return max(0.0, min(first, highest) - lowest), max(0.0, highest - max(last, lowest))


HELD_TABLES = {"ColorChecker": (380.0, 730.0, 10.0), "basis of RGB": (380.0, 780.0, 5.0)}  # lowest, highest, step, nm


def held_in_the_infrared(name: str, lowest: float, highest: float) -> list[str]:
    """Return `held_note` for a library table whose end values are used beyond its range. Return nothing if the bands
    lie below 780 nm and do not begin before the table, because the effect is then hardly visible.
    """
    first, last, step = HELD_TABLES[name]
    return (
        []
        if highest <= SEEN and lowest >= first - step
        else held_note(f"the {name}", np.arange(first, last + 0.5 * step, step), lowest, highest)
    )


def cut_off_note(
    what: str, names: Sequence[str], rows: FloatArray, values: FloatArray, lowest: float, highest: float
) -> list[str]:
    """Return the note on a table (rows, k) that counts as 0 beyond its rows, although it does not end at 0.

    The note gives the fraction of the signal beyond the rows if the end values were extended, for equally many photons
    at every wavelength.
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
        f"{what} has rows from {rows[0]:g} to {rows[-1]:g} nm, but the light extends from {lowest:g} to {highest:g} "
        f"nm: beyond "
        f"{first:g} and {last:g} nm it counts as 0; with its end values extended, {100 * worst:.2g} % of the signal "
        f"of {text} would lie there; add rows to the table, or narrow the scene's wavelengths"
    ]


def held_note(what: str, rows: FloatArray, lowest: float, highest: float) -> list[str]:
    """Return the note on a table with extended end values, where the light extends beyond its rows."""
    below, above = beyond(rows, lowest, highest)
    if below + above <= CONSEQUENCE * (highest - lowest):
        return []
    return [
        f"{what} has rows from {rows[0]:g} to {rows[-1]:g} nm, but the light extends from {lowest:g} to {highest:g} "
        f"nm: its end values "
        f"are used for the other {100 * (below + above) / (highest - lowest):.2g} % of these wavelengths"
    ]

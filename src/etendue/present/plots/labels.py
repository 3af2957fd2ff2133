"""Text of axes, values and units in plots: ``5.4 µm``, ``8 ms``, ``cycles/µm``; with a prefix if the quantity has one.

In:  names of dims, values, units as in the archive (``um-1``, ``V um-2``).
Out: short text.
"""

from __future__ import annotations

import math
import re
from typing import Any

from etendue.contract import wording
from etendue.contract.values.quantities import long_name
from etendue.types.documents import AxisValue

SAID = {
    "1": "",
    "": "",
    "um-1": "cycles/µm",
    "mm-1": "lp/mm",
    "pixel-1": "cycles/pixel",
    "cycles/um": "cycles/µm",
    "s": "s",
    "deg": "°",
    "stop": "stops",
}
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))


def unit_text(units: str) -> str:
    """Return a unit in its usual notation; '' for a plain number."""
    if units in SAID:
        return SAID[units]
    text = re.sub(r"(?<![A-Za-z])um(?![A-Za-z])", "µm", units)
    for name, unit in wording.units().items():
        if unit.said:
            text = re.sub(rf"(?<!\w){re.escape(name)}(?!\w)", unit.said, text)
    return re.sub(r"(?<=[A-Za-zµ])-?\d+", lambda found: found.group().translate(RAISED), text)


def value_text(value: Any, units: str = "", dim: str = "") -> str:
    """Return an axis value with its unit (seconds with an SI prefix), or with the prefix of its quantity instead."""
    if isinstance(value, str) or value is None or not _is_number(value):
        return str(value)
    number = float(value)
    if front := wording.prefix(dim):
        return f"{front}{number:.4g}"
    if units == "s" and number > 0 and math.isfinite(number):
        factor, prefix = next(((f, p) for f, p in PREFIXES if number >= 0.9995 * f), PREFIXES[-1])
        return f"{number / factor:.4g} {prefix}s"
    unit = unit_text(units)
    return f"{number:.4g}{'' if unit in ('', '°') else ' '}{unit}"


def bare_text(value: Any, units: str = "", dim: str = "") -> str:
    """Return an axis value without its unit, for the ticks of an axis whose title states the unit; seconds keep unit
    and SI prefix.
    """
    if isinstance(value, str) or not _is_number(value):
        return str(value)
    return value_text(value, units, dim) if units == "s" or wording.prefix(dim) else f"{float(value):.4g}"


def name_text(name: str, units: str = "") -> str:
    """Return ``pixel pitch, µm`` for ``pixel_pitch`` in um. For seconds the unit is omitted, because ticks show it."""
    unit = "" if units == "s" else unit_text(units)
    words = long_name(name).replace("_", " ")
    return f"{words}, {unit}" if unit else words


def number_text(value: float, digits: int = 3) -> str:
    """Return a number for a cell of a map: at most ``digits`` digits, as short as possible."""
    if not math.isfinite(value):
        return "∞" if value > 0 else "-∞" if value < 0 else ""
    if value == 0:
        return "0"
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, _, exponent = text.partition("e")
        return f"{value:.0f}" if 0 < int(exponent) <= 4 else f"{mantissa}e{int(exponent)}"
    return text.replace("0.", ".", 1) if text.startswith(("0.", "-0.")) else text


def places_text(places: dict[str, AxisValue], units: dict[str, str]) -> str:
    """Return axis values as text: ``5.4 µm, 8 ms``."""
    texts = []
    for dim, value in places.items():
        unit = units.get(dim, "")
        text = value_text(value, unit, dim)
        says_itself = isinstance(value, str) or wording.prefix(dim) or unit_text(unit) not in ("", "°")
        texts.append(text if says_itself else f"{dim.replace('_', ' ')} {text}")
    return ", ".join(texts)


def _is_number(value: Any) -> bool:
    try:
        float(value)
    except (TypeError, ValueError):
        return False
    return not isinstance(value, bool)

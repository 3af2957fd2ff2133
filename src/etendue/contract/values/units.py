"""Units in pipeline files: a small table plus the units of distributions, exact in decimal arithmetic.

In:  text such as ``"5.4 um"``, ``"3e3 um-2"``, ``"100 cd m-2"``.
Out: a float in the declared unit, converted once from the decimal text, so that ``"5400 nm"`` and ``"5.4 um"``
     are the same binary number.
"""

from __future__ import annotations

import re
from decimal import Decimal

from etendue.plugins import discovery

# symbol -> (factor, base dimension symbols with exponents)
_PREFIX = {"": 0, "n": -9, "u": -6, "µ": -6, "μ": -6, "m": -3, "c": -2, "k": 3}  # micro sign and Greek mu
_BASE = {
    "m": "m",
    "s": "s",
    "A": "A",
    "W": "W",
    "sr": "sr",
    "cd": "cd",
    "K": "K",
    "V": "V",
    "Hz": "Hz",
    "lx": "lx",
    "Pa": "Pa",
}
_PLAIN = {
    "pixel": (Decimal(1), {"pixel": 1}),
    "cycle": (Decimal(1), {}),
    "cycles": (Decimal(1), {}),
    "lp": (Decimal(1), {}),  # a line pair is a cycle
    "deg": (Decimal(1), {"deg": 1}),
    "arcmin": (Decimal(1) / 60, {"deg": 1}),
    "stop": (Decimal(1), {"stop": 1}),
    "dB": (Decimal(1), {"dB": 1}),
    "%": (Decimal("0.01"), {}),
    "1": (Decimal(1), {}),
    "in": (Decimal("0.0254"), {"m": 1}),
    "min": (Decimal(60), {"s": 1}),
}
_TOKEN = re.compile(r"(?P<symbol>1|%|[A-Za-zµμ]+)(?:\^?(?P<power>[-+]?\d+))?$")
_NUMBER = re.compile(r"\s*(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(?P<unit>.*?)\s*$")


def as_written(value: object) -> str:
    """Return a value for a message, as written in the file and shortened."""
    if isinstance(value, dict):
        text = "{ " + ", ".join(f"{k} = {as_written(v)}" for k, v in value.items()) + " }"
    elif isinstance(value, list | tuple):
        text = "[" + ", ".join(as_written(v) for v in value) + "]"
    elif isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, str):
        text = repr(value)
    else:
        text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."


class UnitError(ValueError):
    """Text that is not a number with a known, compatible unit."""


def _symbol(symbol: str) -> tuple[Decimal, dict[str, int]]:
    if symbol in _PLAIN:
        return _PLAIN[symbol]
    for prefix, power in _PREFIX.items():
        base = symbol[len(prefix) :]
        if symbol.startswith(prefix) and base in _BASE:
            return Decimal(1).scaleb(power), {_BASE[base]: 1}
    brought = discovery.installed().first("units", symbol)
    if brought is None:
        raise UnitError(f"unknown unit {symbol!r}")
    if not brought.value:
        return Decimal(1), {symbol: 1}
    match = _NUMBER.match(str(brought.value))
    if not match or symbol in match["unit"]:
        raise UnitError(f"the unit {symbol!r} of {brought.origin} cannot be read: {brought.value!r}")
    factor, dimensions = parse_unit(match["unit"])
    return Decimal(match["number"]) * factor, dimensions


def parse_unit(text: str) -> tuple[Decimal, dict[str, int]]:
    """Return the factor to base units and the dimensions of a unit such as ``W m-2 nm-1`` or ``W/um2``."""
    factor, dimensions, sign = Decimal(1), dict[str, int](), 1
    for part in re.split(r"(\s+|/|\*)", text.strip()):
        if part == "/":
            sign = -1
            continue
        if not part.strip() or part == "*":
            continue
        match = _TOKEN.match(part)
        if not match:
            raise UnitError(f"cannot read the unit {text!r}")
        power = sign * int(match["power"] or 1)
        sign = 1
        one, dims = _symbol(match["symbol"])
        factor *= one**power
        for name, exponent in dims.items():
            dimensions[name] = dimensions.get(name, 0) + exponent * power
    return factor, {name: exponent for name, exponent in dimensions.items() if exponent}


def same_unit(one: str, other: str) -> bool:
    """Return whether a number has the same meaning in both units without conversion, as in ``um-1`` and ``cycles/um``.
    Units that are not in the table are compared as text.
    """
    if one == other:
        return True
    try:
        return parse_unit(one) == parse_unit(other)
    except UnitError:
        return False


def to_unit(value: Decimal | int | str, unit: str) -> float:
    """Return a number (already in ``unit``), or text with a compatible unit, as a float in ``unit``.

    Raises
    ------
    UnitError
        If the text is not a number, or has an unknown or incompatible unit.
    """
    try:
        if isinstance(value, str):
            match = _NUMBER.match(value)
            if not match:
                raise UnitError(f"{as_written(value)} is not a number{'' if unit == '1' else ' with a unit'}")
            number = Decimal(match["number"])
            if match["unit"]:
                factor, dims = parse_unit(match["unit"])
                own_factor, own_dims = parse_unit(unit)
                if dims != own_dims:
                    wanted = (
                        "a number without a unit is expected" if unit == "1" else f"which is incompatible with {unit}"
                    )
                    raise UnitError(f"{as_written(value)} has unit {match['unit']}, {wanted}")
                number = number * factor / own_factor
        elif isinstance(value, Decimal | int) and not isinstance(value, bool):
            number = Decimal(value)
        else:
            raise UnitError(f"{as_written(value)} is not a number")
    except ArithmeticError as error:  # the exponent is too large for a decimal
        raise UnitError(f"{as_written(value)} is not a number") from error
    result = float(number)
    return result + 0.0  # turns -0 into 0

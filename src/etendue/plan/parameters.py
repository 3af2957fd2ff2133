"""Values as written in a pipeline file, turned into parameters of a declared type, unit and range.

In:  a value from TOML (or the command line), and a ``Parameter``.
Out: the Python value, or one fault that says what was expected.
"""

from __future__ import annotations

import importlib.util
import math
from decimal import Decimal
from pathlib import Path
from typing import Any, get_args, get_origin

from etendue.errors import nearest
from etendue.spec.stage import Parameter
from etendue.spec.units import UnitError, to_unit


class Unfit(ValueError):
    """A value that does not fit its parameter; the text says what was expected."""


def resolve_file(text: str, folder: Path) -> Path:
    """Absolute path of a file parameter; ``package:matplotlib/...`` names a file in an installed distribution."""
    if text.startswith("package:"):
        package, _, rest = text.removeprefix("package:").partition("/")
        spec = importlib.util.find_spec(package) if package.isidentifier() else None
        if spec is None or not spec.submodule_search_locations:
            raise Unfit(f"there is no installed package {package!r}")
        path = Path(next(iter(spec.submodule_search_locations))) / rest
    else:
        path = (folder / text).absolute()
    if not path.is_file():
        hint = nearest(path.name, [p.name for p in path.parent.iterdir()]) if path.parent.is_dir() else ""
        raise Unfit(f"there is no file {text!r}{hint if 'did you' in hint else ''}")
    return path


def _number(value: Any, parameter: Parameter, whole: bool) -> float | int:
    wanted = f"a {'whole ' if whole else ''}number"
    wanted += f" in {parameter.units}" if parameter.units not in ("1", "") else ""
    limits = parameter.range_text()
    wanted += f", {limits}" if limits else ""
    if isinstance(value, bool):
        raise Unfit(f"expected {wanted}, got {value}")
    if isinstance(value, str) and value.strip().lower() in ("inf", "infinite") and parameter.infinite:
        return math.inf
    try:
        number = to_unit(Decimal(repr(value)) if isinstance(value, float) else value, parameter.units)
    except UnitError as error:
        raise Unfit(f"expected {wanted}: {error}") from None
    except (TypeError, ValueError):
        raise Unfit(f"expected {wanted}, got {value!r}") from None
    if not math.isfinite(number) and not (parameter.infinite and number == math.inf):
        raise Unfit(f"expected {wanted}, got {value}")
    if not parameter.allows(number):
        raise Unfit(f"{value} is out of range: expected {wanted}")
    if whole:
        if number != int(number):
            raise Unfit(f"expected {wanted}, got {value}")
        return int(number)
    return number


def resolve(value: Any, parameter: Parameter, kind: Any, folder: Path) -> Any:
    """The value of one parameter.

    Raises
    ------
    Unfit
        Wrong type, incompatible unit, out of range, unknown choice, missing file.
    """
    if get_origin(kind) is tuple:
        item = get_args(kind)[0]
        if isinstance(value, str | bytes) or not isinstance(value, list | tuple):
            raise Unfit(f"expected a list of {parameter.length or ''} values, got {value!r}".replace("  ", " "))
        if parameter.length is not None and len(value) != parameter.length:
            raise Unfit(f"expected {parameter.length} values, got {len(value)}")
        return tuple(resolve(v, parameter, item, folder) for v in value)
    if kind is bool:
        if not isinstance(value, bool):
            raise Unfit(f"expected true or false, got {value!r}")
        return value
    if kind in (int, float):
        return _number(value, parameter, kind is int)
    if isinstance(value, int | float | Decimal) and not isinstance(value, bool) and not parameter.choices and not parameter.file:
        value = str(value)
    if not isinstance(value, str):
        raise Unfit(f"expected text, got {value!r}")
    if parameter.choices and value not in parameter.choices:
        raise Unfit(f"{value!r} is not allowed{nearest(value, parameter.choices)}")
    if value and (parameter.file or (parameter.table and value.endswith(".csv"))):
        return str(resolve_file(value, folder))
    return value


def axis_values(entry: Any, parameter: Parameter, kind: Any, folder: Path) -> tuple[Any, ...]:
    """The values of a sweep axis: a list, or ``{ from, to, steps, spacing }``.

    Generated values are rounded to 12 significant digits, so that the same axis written twice is the same axis.
    """
    if isinstance(entry, dict):
        unknown = set(entry) - {"from", "to", "steps", "spacing"}
        if unknown or not {"from", "to", "steps"} <= set(entry):
            raise Unfit("expected a list, or a table { from, to, steps, spacing = 'linear' | 'log' }")
        first, last = (float(resolve(entry[k], parameter, float, folder)) for k in ("from", "to"))
        steps, spacing = entry["steps"], entry.get("spacing", "linear")
        if isinstance(steps, bool) or not isinstance(steps, int) or steps < 1:
            raise Unfit(f"steps: expected a whole number of at least 1, got {steps!r}")
        if spacing not in ("linear", "log"):
            raise Unfit(f"spacing: {spacing!r} is not allowed{nearest(str(spacing), ('linear', 'log'))}")
        if spacing == "log" and (first <= 0 or last <= 0):
            raise Unfit("a log spacing needs both ends above 0")
        share = [i / max(steps - 1, 1) for i in range(steps)]
        if spacing == "log":
            raw = [first * (last / first) ** t for t in share]
        else:
            raw = [first + (last - first) * t for t in share]
        return tuple(resolve(Decimal(f"{v:.12g}"), parameter, kind, folder) for v in raw)
    if not isinstance(entry, list | tuple):
        raise Unfit(f"expected a list, or a table {{ from, to, steps }}, got {entry!r}")
    if not entry:
        raise Unfit("an axis needs at least one value")
    values = tuple(resolve(v, parameter, kind, folder) for v in entry)
    if len(set(values)) != len(values):
        raise Unfit(f"a value stands twice: {list(entry)}")
    return values

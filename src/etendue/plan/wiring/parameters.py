"""Convert values as written in a pipeline file to parameters of a declared type, unit and range.

In:  a value from TOML (or the command line), and a ``Parameter``.
Out: the Python value, or one fault that states the expected form.
"""

from __future__ import annotations

import importlib.util
import math
import os
from collections.abc import Sequence
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any, get_args, get_origin

from etendue import plain_files
from etendue.contract.values.parameter import Parameter
from etendue.contract.values.units import UnitError, as_written, to_unit
from etendue.errors import nearest, unprintable
from etendue.plugins.discovery import is_table_file
from etendue.types.documents import Document

# Allowed magnitudes of numbers; products of a few of them stay within the range of 64-bit floats.
SMALLEST, LARGEST = 1e-30, 1e30
MOST_STEPS = 100_000


class Unfit(ValueError):
    """A value that does not fit its parameter; the text states the expected form."""


def resolve_file(text: str, folder: Path, folders: bool = False) -> Path:
    """Return the absolute path of a file parameter (or of a folder, if folders are allowed).

    ``package:matplotlib/...`` names a file in an installed distribution. A pipeline recorded in an archive can name
    only files in that archive's ``inputs/``: an archive may come from anywhere and must not read other files.
    """
    own = inputs_of(folder)
    if text.startswith("package:") and own is None:
        package, _, rest = text.removeprefix("package:").partition("/")
        try:
            spec = importlib.util.find_spec(package) if package.isidentifier() else None
        except ValueError:  # a module without a spec, such as __main__
            spec = None
        if spec is None or not spec.submodule_search_locations:
            raise Unfit(f"package {package!r} is not installed; install it, or give the path of a file")
        if ".." in rest.split("/") or rest.startswith("/"):
            raise Unfit(f"{as_written(text)} points outside the package; name a file inside it")
        path = Path(next(iter(spec.submodule_search_locations))) / rest
    else:
        path = (folder / text).absolute()
    if own is not None and not _lies_in(path, own):
        raise Unfit(f"{as_written(text)} is not in the archive's inputs/; an archive can name no other files")
    try:
        if not path.is_file() and not (folders and path.is_dir()):
            hint = nearest(path.name, [p.name for p in path.parent.iterdir()]) if path.parent.is_dir() else ""
            if "did you" not in hint:
                hint = (
                    ""
                    if text.startswith("package:")
                    else f"; relative paths start at the pipeline's folder, {folder.absolute()}"
                )
            raise Unfit(f"no such file: {as_written(text)}{hint}")
        if not path.is_dir():
            plain_files.check_plain(path)
    except OSError as error:
        raise Unfit(f"{as_written(text)} cannot be read: {error.strerror}") from None
    return path


def inputs_of(folder: Path) -> Path | None:
    """Return the ``inputs`` folder of an archive if ``folder`` is that archive's folder of records, else None."""
    whole = folder.absolute().parent
    ours = folder.name == "runs" and any(
        os.path.lexists(whole / name) for name in ("data.zarr", "journal.jsonl", "manifest.json")
    )
    return whole / "inputs" if ours else None


def _lies_in(path: Path, own: Path) -> bool:
    """Return whether a file, or everything in a folder, is inside another folder after links are resolved."""
    whole = own.parent.resolve() / own.name
    inside = path.resolve().is_relative_to(whole)
    return inside and all(
        one.resolve().is_relative_to(whole) for one in (path.rglob("*") if path.is_dir() else ()) if one.is_symlink()
    )


def expected(parameter: Parameter) -> str:
    """Return the unit and range of a parameter, as ' in um, above 0'; '' if everything is allowed."""
    limits = replace(parameter, units="1").range_text()
    return (f" in {parameter.units}" if parameter.units not in ("1", "") else "") + (f", {limits}" if limits else "")


def _wanted(parameter: Parameter, whole: bool) -> str:
    return f"a {'whole ' if whole else ''}number{expected(parameter)}"


def _number(value: Any, parameter: Parameter, whole: bool) -> float | int:
    """Return a number in the unit of a parameter. The expected form is described only when an error needs it: an axis
    may have 100,000 valid values.
    """
    if hasattr(value, "item"):
        value = value.item()  # a numpy scalar, from Python
    if isinstance(value, bool):
        raise Unfit(f"expected {_wanted(parameter, whole)}, got {as_written(value)}")
    if isinstance(value, str) and value.strip().lower() in ("inf", "infinite") and parameter.infinite:
        return math.inf
    try:
        number = to_unit(Decimal(repr(value)) if isinstance(value, float) else value, parameter.units)
    except UnitError as error:
        hint = "; several values belong under [sweep]" if isinstance(value, list | tuple | dict) else ""
        raise Unfit(f"expected {_wanted(parameter, whole)}; {error}{hint}") from None
    if not math.isfinite(number) and not (parameter.infinite and number == math.inf):
        raise Unfit(f"expected {_wanted(parameter, whole)}, got {value}")
    _refuse_beyond(value, number, parameter, whole)
    if whole and number != int(number):
        raise Unfit(f"expected {_wanted(parameter, whole)}, got {value}")
    return int(number) if whole else number


def _refuse_beyond(value: Any, number: float, parameter: Parameter, whole: bool) -> None:
    """Refuse a number that is too large or small for 64-bit products, not allowed, or outside the range that its stages
    support.
    """
    if number and math.isfinite(number) and not SMALLEST <= abs(number) <= LARGEST:
        raise Unfit(
            f"{as_written(value)} is out of range: a number must be 0, or {SMALLEST:g} to {LARGEST:g} in magnitude; "
            f"expected {_wanted(parameter, whole)}"
        )
    if not parameter.allows(number):
        raise Unfit(f"{value} is out of range: expected {_wanted(parameter, whole)}")
    if parameter.held and math.isfinite(number) and not parameter.held[0] <= number <= parameter.held[1]:
        unit = f" {parameter.units}" if parameter.units not in ("1", "") else ""
        low, high = parameter.held
        raise Unfit(f"{value} is outside the range that the stages using it support, {low:g} to {high:g}{unit}")


def resolve(value: Any, parameter: Parameter, kind: Any, folder: Path) -> Any:
    """Return the value of one parameter.

    Raises
    ------
    Unfit
        Wrong type, incompatible unit, out of range, unknown choice, missing file.
    """
    if get_origin(kind) is tuple:
        return tuple(resolve(one, parameter, get_args(kind)[0], folder) for one in _several(value, parameter))
    if kind is bool:
        if not isinstance(value, bool):
            raise Unfit(f"expected true or false, got {as_written(value)}")
        return value
    if kind in (int, float):
        return _number(value, parameter, kind is int)
    if parameter.numbered:
        return _numbered(value, parameter)
    if (
        isinstance(value, int | float | Decimal)
        and not isinstance(value, bool)
        and not parameter.choices
        and not parameter.file
    ):
        value = str(value)
    if not isinstance(value, str):
        raise Unfit(f"expected text, got {as_written(value)}")
    if unprintable(value):
        raise Unfit(f"{as_written(value)} contains control characters")
    if parameter.choices and value not in parameter.choices:
        raise Unfit(f"{value!r} is not allowed{nearest(value, parameter.choices)}")
    if value and (parameter.file or (parameter.table and is_table_file(value))):
        return str(resolve_file(value, folder, parameter.folder))
    return value


def _numbered(value: Any, parameter: Parameter) -> str:
    """Return one of the choices, or a whole number from 0 as text."""
    if isinstance(value, str) and value in (parameter.choices or ()):
        return value
    try:
        return str(_number(value, Parameter(at_least=0), True))
    except Unfit:
        names = ", ".join(parameter.choices or ())
        raise Unfit(f"expected one of {names}, or a whole number from 0, got {as_written(value)}") from None


def _several(value: Any, parameter: Parameter) -> Sequence[Any]:
    if parameter.one_for_all and not isinstance(value, list | tuple):
        value = (value,)
    if not isinstance(value, list | tuple):
        raise Unfit(f"expected a list of {parameter.length or ''} values, got {as_written(value)}".replace("  ", " "))
    if parameter.length is not None and len(value) != parameter.length:
        raise Unfit(f"expected {parameter.length} values, got {len(value)}")
    return value


def axis_values(entry: Any, parameter: Parameter, kind: Any, folder: Path) -> tuple[Any, ...]:
    """Return the values of a sweep axis: a list, or ``{ from, to, steps, spacing }``.

    Generated values are rounded to 12 significant digits, so that equal axes written differently have equal values.
    """
    if isinstance(entry, dict):
        written: Sequence[Any] = _spaced(entry, parameter, folder)
    elif isinstance(entry, list | tuple):
        if not entry:
            raise Unfit("expected at least one value, got []")
        written = entry
    else:
        raise Unfit(f"expected a list, or a table {{ from, to, steps }}, got {as_written(entry)}")
    values: dict[Any, None] = {}
    for one in written:
        value = resolve(one, parameter, kind, folder)
        if value in values:
            raise Unfit(
                f"expected distinct values, but {as_written(value if isinstance(entry, dict) else one)} appears twice"
            )
        values[value] = None
    return tuple(values)


def _spaced(entry: Document, parameter: Parameter, folder: Path) -> list[Decimal]:
    """Return the values of ``{ from, to, steps, spacing }``, to 12 significant digits."""
    known = ("from", "to", "steps", "spacing")
    for name in entry:
        if name not in known:
            raise Unfit(f"unknown key {name!r}{nearest(name, known)}")
    lacking = [name for name in known[:3] if name not in entry]
    if lacking:
        raise Unfit(f"expected {{ from, to, steps, spacing = 'linear' or 'log' }}; missing: {', '.join(lacking)}")
    first, last = (float(resolve(entry[k], parameter, float, folder)) for k in ("from", "to"))
    steps, spacing = entry["steps"], entry.get("spacing", "linear")
    if isinstance(steps, bool) or not isinstance(steps, int) or not 1 <= steps <= MOST_STEPS:
        raise Unfit(f"steps: expected a whole number from 1 to {MOST_STEPS}, got {as_written(steps)}")
    if spacing not in ("linear", "log"):
        raise Unfit(f"spacing: {as_written(spacing)} is not allowed{nearest(str(spacing), ('linear', 'log'))}")
    if spacing == "log" and (first <= 0 or last <= 0):
        raise Unfit(f"spacing 'log' requires both ends above 0, got {first:g} to {last:g}; use 'linear'")
    share = [i / max(steps - 1, 1) for i in range(steps)]
    if spacing == "log":
        raw = [first * (last / first) ** t for t in share]
    else:
        raw = [first + (last - first) * t for t in share]
    return [Decimal(f"{v:.12g}") for v in raw]

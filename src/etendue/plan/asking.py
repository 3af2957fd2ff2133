"""What a plan asks of a stage, and what may come back: a plugin's method that breaks off or answers nonsense is a fault
of the file.

In:  a stage and what its method is given.
Out: the answer in the form that the contract states; ``PluginError`` that names stage and method. A ``ValueError`` is
     how a stage
refuses, and stays one.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any

from etendue.contract.facts import UNKNOWN, Facts
from etendue.contract.found import NotKnown
from etendue.contract.grid import Grid
from etendue.contract.stage import Stage, writes_of
from etendue.errors import PluginError
from etendue.telling import foreign, plain
from etendue.types.documents import DocumentView

KNOWN_BY = ("proved", "fitted", "measured", "unknown")


def _name(stage: Stage, method: str) -> str:
    return f"{type(stage).__name__}.{method}"


def _nonsense(stage: Stage, method: str, found: Any, expected: str) -> PluginError:
    with foreign(f"the repr of what {_name(stage, method)} gave"):
        text = " ".join(plain(repr(found)).split())
    return PluginError(f"{_name(stage, method)} gave {text[:80]}{'...' if len(text) > 80 else ''}; expected {expected}")


def _is_number(value: Any) -> bool:
    """Of Python or of numpy, and neither NaN nor a bool."""
    if isinstance(value, bool | str | bytes) or not hasattr(value, "__float__"):
        return False
    try:
        return not math.isnan(float(value))
    except Exception:
        return False


def made(kind: type[Stage], values: DocumentView) -> Stage:
    """An instance of a stage. ``ValueError`` and ``TypeError`` are how it refuses its values."""
    with foreign(f"{kind.__name__}.__post_init__"):
        try:
            stage = kind(**values)
        except NotKnown:  # what it would look at is found by a run, which makes it again
            stage = unchecked(kind, values)
        except TypeError as error:
            raise ValueError(str(error)) from error
    if not isinstance(stage, kind):
        raise PluginError(f"{kind.__name__}(...) gives {type(stage).__name__}, which is no {kind.__name__}")
    try:
        hash(stage)
    except Exception as error:
        raise PluginError(
            f"{kind.__name__} is no value: {error}; write @dataclass(frozen=True, kw_only=True)"
        ) from None
    return stage


def unchecked(kind: type[Stage], values: DocumentView) -> Stage:
    """An instance whose values have not been looked at."""
    stage = object.__new__(kind)
    for field in dataclasses.fields(kind):
        object.__setattr__(stage, field.name, values.get(field.name, field.default))
    return stage


def _grids(stage: Stage, method: str, found: Any) -> Mapping[str, Grid]:
    form = "a mapping of the variables it writes to Grid values"
    if not isinstance(found, Mapping) or not all(isinstance(g, Grid) for g in found.values()):
        raise _nonsense(stage, method, found, form)
    unknown = sorted({str(name) for name in found} - {d.variable for d in writes_of(type(stage)).values()})
    if unknown:
        raise PluginError(
            f"{_name(stage, method)} speaks of {', '.join(unknown)}, which {type(stage).__name__} does not write"
        )
    return found


def _facts(stage: Stage, method: str, found: Facts) -> Facts:
    fine = isinstance(found, Facts) and all(
        value is None or _is_number(value) for value in (found.low, found.high, found.contrast, found.band_limit)
    )
    if not fine or found.uniform not in (None, True, False):
        raise _nonsense(stage, method, found, "Facts of numbers, None where something is not known")
    facts: Facts = found
    return facts


RUN = object()  # what depends on what a run finds is refused


def _asked(stage: Stage, method: str, *given: Any, unknown: Any = RUN) -> Any:
    """What a method gives; ``unknown`` where it depends on a value that only a run finds."""
    with foreign(_name(stage, method)):
        try:
            return getattr(stage, method)(*given)
        except NotKnown as error:
            if unknown is not RUN:
                return unknown
            raise PluginError(
                f"{_name(stage, method)} depends on {error}, which an earlier stage finds while the run goes on: what "
                f"a grid depends on is known before; give {error} as a value, behind no stage that writes it"
            ) from None


def described(stage: Stage) -> tuple[Facts, Mapping[str, Grid]]:
    found = _asked(stage, "describe")
    if not isinstance(found, tuple) or len(found) != 2:
        raise _nonsense(stage, "describe", found, "(Facts, {variable: Grid})")
    return _facts(stage, "describe", found[0]), _grids(stage, "describe", found[1])


def grids_of(stage: Stage, inputs: Mapping[str, Grid]) -> Mapping[str, Grid]:
    """What ``grid`` says of what a stage writes; nothing where it has none."""
    if type(stage).grid is Stage.grid:
        return {}
    return _grids(stage, "grid", _asked(stage, "grid", dict(inputs)))


def carried(stage: Stage, facts: Mapping[str, Facts], grids: Mapping[str, Grid]) -> Facts:
    if type(stage).carry is Stage.carry:
        return UNKNOWN
    return _facts(stage, "carry", _asked(stage, "carry", dict(facts), dict(grids), unknown=UNKNOWN))


def negligible(stage: Stage, facts: Facts, grid: Grid) -> tuple[float, str] | None:
    found = _asked(stage, "negligible", facts, grid, unknown=None)
    if found is None:
        return None
    fine = isinstance(found, tuple) and len(found) == 2 and _is_number(found[0]) and isinstance(found[1], str)
    if not fine or found[0] < 0:
        raise _nonsense(stage, "negligible", found, "(a bound from 0, the reason) or None")
    return float(found[0]), plain(found[1])


def variance_of(stage: Any, charge: float) -> float | None:
    """What a source of noise adds at a charge; None where what it depends on is found by a run, or where it refuses."""
    with foreign(_name(stage, "variance")):
        try:
            found = stage.variance(charge)
        except (NotKnown, ValueError):
            return None
    if not _is_number(found):
        raise _nonsense(stage, "variance", found, "a number from 0")
    return max(float(found), 0.0)


def error_of(stage: Stage, method: str, *given: Any) -> tuple[float | None, str]:
    """What ``error`` or ``segment_error`` states."""
    found = _asked(stage, method, *given, unknown=(None, "unknown"))
    fine = isinstance(found, tuple) and len(found) == 2 and isinstance(found[1], str) and found[1] in KNOWN_BY
    if not fine or not (found[0] is None or (_is_number(found[0]) and found[0] >= 0)):
        raise _nonsense(stage, method, found, f"(a bound from 0 or None, how it is known: {', '.join(KNOWN_BY)})")
    return (None if found[0] is None else float(found[0])), found[1]


def texts(stage: Stage, method: str, *given: Any) -> list[str]:
    """What ``warn`` or ``warn_among`` has to say; nothing where there is no such method."""
    with foreign(_name(stage, method)):
        try:
            found = getattr(stage, method)(*given)
        except NotKnown:
            return []
        if isinstance(found, Iterable) and not isinstance(found, str):
            found = list(found)
    if not isinstance(found, list) or not all(isinstance(text, str) for text in found):
        raise _nonsense(stage, method, found, "a list of texts")
    return [plain(text) for text in found]


def common_draws(stage: Stage) -> bool:
    with foreign(_name(stage, "common_draws")):
        found = stage.common_draws
    if not isinstance(found, bool):
        raise _nonsense(stage, "common_draws", found, "True or False")
    return found


def lacking(kind: type[Stage], dim: str, variable: str) -> str:
    """What to say where nobody knows the coordinate of a dim that a stage writes."""
    return (
        f"{kind.__name__} writes {variable} with the dim {dim!r}, which nothing it reads has, and does not say what it "
        f"is: give the class "
        f"creates = {{{dim!r}: RGB}} (or Labels, a Line, Bands), or a method grid(self, inputs) if it depends on what "
        f"is read"
    )

"""Call the methods of stages while planning, and check their answers: a plugin's method that raises or returns an
invalid value is a fault of the file.

In:  a stage and the arguments of its method.
Out: the answer, in the form the contract states; ``PluginError`` naming stage and method. A ``ValueError`` means that
     the stage refuses its values, and is passed on.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any

from etendue.contract.arrays.facts import UNKNOWN, Facts
from etendue.contract.arrays.grid import Grid
from etendue.contract.stage import Stage, writes_of
from etendue.contract.values.late_bound import NotKnown
from etendue.errors import PluginError
from etendue.telling import foreign, plain
from etendue.types.documents import DocumentView

KNOWN_BY = ("proved", "fitted", "measured", "unknown")


def _name(stage: Stage, method: str) -> str:
    return f"{type(stage).__name__}.{method}"


def _nonsense(stage: Stage, method: str, found: Any, expected: str) -> PluginError:
    with foreign(f"the repr of what {_name(stage, method)} returned"):
        text = " ".join(plain(repr(found)).split())
    return PluginError(
        f"{_name(stage, method)} returned {text[:80]}{'...' if len(text) > 80 else ''}; expected {expected}"
    )


def _is_number(value: Any) -> bool:
    """Return whether a value is a number of Python or numpy, and neither NaN nor a bool."""
    if isinstance(value, bool | str | bytes) or not hasattr(value, "__float__"):
        return False
    try:
        return not math.isnan(float(value))
    except Exception:
        return False


def made(kind: type[Stage], values: DocumentView) -> Stage:
    """Return an instance of a stage. ``ValueError`` and ``TypeError`` mean that it refuses the values."""
    with foreign(f"{kind.__name__}.__post_init__"):
        try:
            stage = kind(**values)
        # The check needs a value that only a run finds; the run builds the stage again and repeats the check.
        except NotKnown:
            stage = unchecked(kind, values)
        except TypeError as error:
            raise ValueError(str(error)) from error
    if not isinstance(stage, kind):
        raise PluginError(f"{kind.__name__}(...) returned {type(stage).__name__}, expected {kind.__name__}")
    try:
        hash(stage)
    except Exception as error:
        raise PluginError(
            f"{kind.__name__} is not hashable: {error}; declare it with @dataclass(frozen=True, kw_only=True)"
        ) from None
    return stage


def unchecked(kind: type[Stage], values: DocumentView) -> Stage:
    """Return an instance without checking its values."""
    stage = object.__new__(kind)
    for field in dataclasses.fields(kind):
        object.__setattr__(stage, field.name, values.get(field.name, field.default))
    return stage


def _grids(stage: Stage, method: str, found: Any) -> Mapping[str, Grid]:
    form = "a mapping from the variables it writes to Grid values"
    if not isinstance(found, Mapping) or not all(isinstance(g, Grid) for g in found.values()):
        raise _nonsense(stage, method, found, form)
    unknown = sorted({str(name) for name in found} - {d.variable for d in writes_of(type(stage)).values()})
    if unknown:
        raise PluginError(
            f"{_name(stage, method)} returned {', '.join(unknown)}, which {type(stage).__name__} does not write"
        )
    return found


def _facts(stage: Stage, method: str, found: Facts) -> Facts:
    fine = isinstance(found, Facts) and all(
        value is None or _is_number(value)
        for value in (found.low, found.high, found.mean, found.contrast, found.band_limit)
    )
    if not fine or found.uniform not in (None, True, False):
        raise _nonsense(stage, method, found, "Facts with numbers, or None where a value is unknown")
    facts: Facts = found
    return facts


RUN = object()  # passed as ``unknown``: here an answer that depends on a value found by the run is a fault


def _asked(stage: Stage, method: str, *given: Any, unknown: Any = RUN) -> Any:
    """Return the result of a method; ``unknown`` if it depends on a value that only a run determines."""
    with foreign(_name(stage, method)):
        try:
            return getattr(stage, method)(*given)
        except NotKnown as error:
            if unknown is not RUN:
                return unknown
            raise PluginError(
                f"{_name(stage, method)} depends on {error}, which an earlier stage finds only during the run, but a "
                f"grid must be known before; give {error} as a value and remove the stage that writes it"
            ) from None


def described(stage: Stage) -> tuple[Facts, Mapping[str, Grid]]:
    found = _asked(stage, "describe")
    if not isinstance(found, tuple) or len(found) != 2:
        raise _nonsense(stage, "describe", found, "(Facts, {variable: Grid})")
    return _facts(stage, "describe", found[0]), _grids(stage, "describe", found[1])


def grids_of(stage: Stage, inputs: Mapping[str, Grid]) -> Mapping[str, Grid]:
    """Return the grids that ``grid`` states for the outputs of a stage; empty if the stage has no such method."""
    if type(stage).grid is Stage.grid:
        return {}
    return _grids(stage, "grid", _asked(stage, "grid", dict(inputs)))


def carried(stage: Stage, facts: Mapping[str, Facts], grids: Mapping[str, Grid]) -> Facts:
    if type(stage).carry is Stage.carry:
        return UNKNOWN
    return _facts(stage, "carry", _asked(stage, "carry", dict(facts), dict(grids), unknown=UNKNOWN))


def growth_of(stage: Stage, facts: Mapping[str, Facts]) -> float:
    """Return the factor by which an error of an input may grow in a stage; 1 if the factor depends on a value that only
    a run determines.
    """
    if type(stage).growth is Stage.growth:
        return 1.0
    found = _asked(stage, "growth", dict(facts), unknown=1.0)
    if not _is_number(found) or found < 0:
        raise _nonsense(stage, "growth", found, "a number of at least 0")
    return float(found)


def negligible(stage: Stage, facts: Facts, grid: Grid) -> tuple[float, str] | None:
    found = _asked(stage, "negligible", facts, grid, unknown=None)
    if found is None:
        return None
    fine = isinstance(found, tuple) and len(found) == 2 and _is_number(found[0]) and isinstance(found[1], str)
    if not fine or found[0] < 0:
        raise _nonsense(stage, "negligible", found, "(a bound of at least 0, the reason) or None")
    return float(found[0]), plain(found[1])


def variance_of(stage: Any, charge: float) -> float | None:
    """Return the variance that a noise source adds at a charge; None if a run must find it, or if the stage refuses."""
    with foreign(_name(stage, "variance")):
        try:
            found = stage.variance(charge)
        except (NotKnown, ValueError):
            return None
    if not _is_number(found):
        raise _nonsense(stage, "variance", found, "a number of at least 0")
    return max(float(found), 0.0)


def error_of(stage: Stage, method: str, *given: Any) -> tuple[float | None, str]:
    """Return the error that ``error`` or ``segment_error`` states, and its basis."""
    found = _asked(stage, method, *given, unknown=(None, "unknown"))
    fine = isinstance(found, tuple) and len(found) == 2 and isinstance(found[1], str) and found[1] in KNOWN_BY
    if not fine or not (found[0] is None or (_is_number(found[0]) and found[0] >= 0)):
        raise _nonsense(stage, method, found, f"(a bound of at least 0 or None, its basis: {', '.join(KNOWN_BY)})")
    return (None if found[0] is None else float(found[0])), found[1]


def texts(stage: Stage, method: str, *given: Any) -> list[str]:
    """Return the texts of ``warn`` or ``warn_among``; none if they depend on values that only a run finds."""
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


def common_draws(stage: Stage) -> bool | str:
    with foreign(_name(stage, "common_draws")):
        found = stage.common_draws
    if not isinstance(found, bool | str):
        raise _nonsense(stage, "common_draws", found, "True, False or a text")
    return found


def lacking(kind: type[Stage], dim: str, variable: str) -> str:
    """Return the message for a written dim without a coordinate."""
    return (
        f"{kind.__name__} writes {variable} with the dim {dim!r}, which none of its inputs has, without stating its "
        f"coordinate: give the class "
        f"creates = {{{dim!r}: RGB}} (or Labels, a Line, Bands), or a method grid(self, inputs) if it depends on the "
        f"inputs"
    )

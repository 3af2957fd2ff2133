"""Approximation: for every knob that the file does not set, choose the cheapest setting within the local tolerance.

A knob lists its settings from the cheapest to the reference (``Parameter.settings``); the stage states its error at
each setting (``error``). A setting in the file is part of the model and is never changed. Knobs that only studies vary
are not chosen here.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Any

from etendue.contract.stage import Stage, parameters_of
from etendue.contract.values.parameter import Parameter
from etendue.errors import PluginError
from etendue.plan.expansion.search import Goal, Knob, Search, Settings, Trial, Value
from etendue.plan.model import Approximated
from etendue.plan.stage_calls import made


class WatchedFacts(dict[str, Any]):
    """Facts by port that record whether a stage read them. A result of the stage that was computed without reading them
    is valid for any facts.
    """

    looked = False

    def __iter__(self) -> Iterator[str]:  # so that copies are made by ``__getitem__``
        return iter(self.keys())

    def __or__(self, other: Any) -> Any:
        return {**self} | other

    def copy(self) -> Any:
        return {**self}

    def __getitem__(self, port: str) -> Any:
        self.looked = True
        return super().__getitem__(port)

    def get(self, port: str, default: Any = None) -> Any:
        self.looked = True
        return super().get(port, default)

    def items(self) -> Any:
        self.looked = True
        return super().items()

    def values(self) -> Any:
        self.looked = True
        return super().values()


Asked = Callable[[Stage], tuple[float | None, str]]
Set = Callable[[Stage, Settings], Stage | None]  # ``with_settings``


@dataclass(frozen=True)
class Stated(Trial):
    """A stage with some settings of its knobs, and the error that it states."""

    stage: Stage | None  # None if the stage refuses the settings


def open_knobs(kind: type[Stage], written: Collection[str]) -> tuple[str, ...]:
    """Return the names of the knobs of a stage that the plan may set."""
    return tuple(
        name
        for name, (parameter, _, _) in parameters_of(kind).items()
        if parameter.fidelity and parameter.settings and not parameter.studied and name not in written
    )


def choose(
    stage: Stage, knobs: tuple[str, ...], tolerance: float, asked: Asked, change: Set | None = None
) -> tuple[Stage, tuple[Approximated, ...]]:
    """Return a stage with its open knobs set, and the chosen settings whose error exceeds the error of the reference.

    Knobs are set one after the other, each to its cheapest setting that keeps the whole error of the stage within the
    tolerance. If the error stays above the tolerance, all knobs start from their finest setting. If the error is above
    the tolerance even at the finest settings, coarser settings add at most a tenth of the tolerance, so that the result
    is as close to the tolerance as the knobs allow.

    In this case, a stage with a ``dear`` knob, whose finer settings the plan may not choose, keeps all its settings:
    finer settings of its other knobs would cost time without reaching the tolerance. A stage that does not know its
    error also keeps its settings. A setting that the stage refuses is skipped in favour of a finer one.

    The errors of several settings of one stage are not independent, so the same total is stated for each of them.
    """
    declared = parameters_of(type(stage))
    steps = [Knob("", name, _allowed(declared[name][0], declared[name][2])) for name in knobs]

    def evaluate(settings: Settings) -> Stated:
        own = (change or with_settings)(stage, settings)
        return Stated(settings, None if own is None else asked(own)[0], own)

    search = Search(evaluate)
    found, chosen = search.loosened(steps, Goal(tolerance))
    dear = any(parameter.dear for parameter, _, _ in declared.values())
    if knobs and found.error is not None and found.error > tolerance and not dear:
        best = search.at({knob.key: knob.settings[-1] for knob in steps})
        if best.error is not None:
            found, chosen = search.loosened(steps, Goal(max(tolerance, best.error + 0.1 * tolerance)), best.settings)
    # A setting that adds no error does not count as an approximation.
    coarser = [one for one in chosen if one.error > 0]
    bound = sum(one.error for one in coarser)
    return found.stage or stage, tuple(
        Approximated(one.knob.name, one.value, one.knob.settings[-1], bound) for one in coarser
    )


def _allowed(parameter: Parameter, default: bool | float) -> tuple[Value, ...]:
    """Return the settings that a plan may choose; for a dear knob, none finer than the default."""
    found = parameter.settings
    return found[: found.index(default) + 1] if parameter.dear and default in found else found


def with_settings(stage: Stage, settings: Settings) -> Stage | None:
    """Return a stage with other settings; None if the stage refuses them."""
    if all(getattr(stage, name) == value for name, value in settings.items()):
        return stage
    try:
        return made(type(stage), {**{one: getattr(stage, one) for one in parameters_of(type(stage))}, **settings})
    except (ValueError, PluginError):
        return None

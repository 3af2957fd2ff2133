"""Approximating: for every knob that the file leaves open, choose the cheapest setting within the local tolerance.

A knob lists its settings from the cheapest to the reference (``Parameter.settings``); the stage states its error at
each (``error``). A setting that the file writes is part of the model and stays. A knob that only studies vary is never
chosen here.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any

from etendue.contract.stage import Stage, parameters_of
from etendue.contract.values.parameter import Parameter
from etendue.errors import PluginError
from etendue.plan.model import Approximated
from etendue.plan.stage_calls import made

if TYPE_CHECKING:
    pass


class WatchedFacts(dict[str, Any]):
    """Facts by port that record whether they were looked at: an answer given without a look holds for any facts."""

    looked = False

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


def open_knobs(kind: type[Stage], written: Collection[str]) -> tuple[str, ...]:
    """Return the names of the knobs of a stage that the plan may set."""
    return tuple(
        name
        for name, (parameter, _, _) in parameters_of(kind).items()
        if parameter.fidelity and parameter.settings and not parameter.studied and name not in written
    )


def choose(
    stage: Stage, knobs: tuple[str, ...], tolerance: float, asked: Asked
) -> tuple[Stage, tuple[Approximated, ...]]:
    """Return a stage with its open knobs set, and the settings chosen that add an error to the reference's.

    Knobs are set one after the other, each to its first setting from the cheap end that keeps the stage's whole error
    within the tolerance. If the error stays above the tolerance, all knobs start from their finest setting. If even the
    finest is above it, coarser settings add at most a tenth of the tolerance, so that the result is as close to the
    tolerance as the knobs allow.

    A stage with a ``dear`` knob, whose finer settings the plan may not choose, stays as it is in this case: finer
    settings of its other knobs would cost time without reaching the tolerance. So does a stage that does not know its
    error. A setting that the stage refuses is skipped in favour of a finer one.
    """
    found, chosen = _walked(stage, knobs, tolerance, asked)
    error = asked(found)[0] if knobs else None
    if (
        error is None
        or error <= tolerance
        or any(parameter.dear for parameter, _, _ in parameters_of(type(stage)).values())
    ):
        return found, chosen
    best = _finest(stage, knobs)
    floor = None if best is None else asked(best)[0]
    return (
        (found, chosen)
        if best is None or floor is None
        else _walked(best, knobs, max(tolerance, floor + 0.1 * tolerance), asked)
    )


def _walked(stage: Stage, knobs: tuple[str, ...], most: float, asked: Asked) -> tuple[Stage, tuple[Approximated, ...]]:
    """Return a stage with each knob at its first setting with an error of at most ``most``, if there is one."""
    chosen: list[Approximated] = []
    for name in knobs:
        parameter, _, default = parameters_of(type(stage))[name]
        settings = _allowed(parameter, default)
        reference = _with(stage, name, settings[-1])
        finest = None if reference is None else asked(reference)[0]
        if reference is None or finest is None or finest > most:
            continue
        low, high = 0, len(settings) - 1
        found, bound = reference, finest
        # Bisection finds the first setting that fits, because stated errors never grow towards finer settings.
        while low < high:
            middle = (low + high) // 2
            candidate = _with(stage, name, settings[middle])
            own = None if candidate is None else asked(candidate)[0]
            if candidate is None or own is None or own > most:
                low = middle + 1
            else:
                high, found, bound = middle, candidate, own
        stage = found
        if bound > finest:  # a setting that adds no error is no approximation
            chosen.append(Approximated(name, settings[high], settings[-1], bound - finest))
    return stage, tuple(chosen)


def _finest(stage: Stage, knobs: tuple[str, ...]) -> Stage | None:
    """Return a stage with every open knob at the finest setting a plan may choose; None if it refuses one of them."""
    found: Stage | None = stage
    for name in knobs:
        parameter, _, default = parameters_of(type(stage))[name]
        found = None if found is None else _with(found, name, _allowed(parameter, default)[-1])
    return found


def _allowed(parameter: Parameter, default: bool | float) -> tuple[Any, ...]:
    """Return the settings that a plan may choose; for a dear knob, none finer than the default."""
    found = parameter.settings
    return found[: found.index(default) + 1] if parameter.dear and default in found else found


def _with(stage: Stage, name: str, value: Any) -> Stage | None:
    """Return a stage with another setting; None if it refuses the setting."""
    if getattr(stage, name) == value:
        return stage
    try:
        return made(type(stage), {**{one: getattr(stage, one) for one in parameters_of(type(stage))}, name: value})
    except (ValueError, PluginError):
        return None

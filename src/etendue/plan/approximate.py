"""Approximating: of every knob of fidelity that the file leaves open, the cheapest setting within the local tolerance.

A knob lists its settings from the cheapest to the reference (``Parameter.settings``); the stage says how wrong it is
with each (``error``). What the file writes is the model and stays; a knob that only studies vary is no plan's to
choose.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any

from etendue.contract.parameter import Parameter
from etendue.contract.stage import Stage, parameters_of
from etendue.errors import PluginError
from etendue.plan.asking import made
from etendue.plan.model import Approximated

if TYPE_CHECKING:
    pass


class Seen(dict[str, Any]):
    """Facts by port that know whether anybody has looked at them: an answer without a look holds whatever they are."""

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
    """The knobs of a stage that may be chosen."""
    return tuple(
        name
        for name, (parameter, _, _) in parameters_of(kind).items()
        if parameter.fidelity and parameter.settings and not parameter.studied and name not in written
    )


def choose(
    stage: Stage, knobs: tuple[str, ...], tolerance: float, asked: Asked
) -> tuple[Stage, tuple[Approximated, ...]]:
    """A stage with its open knobs set, one after the other, and what was chosen where that adds something to the
    reference.

    Of each knob the first setting from the cheap end with which the stage's whole error is within the tolerance. Where
    the stage stays above it so, all knobs begin at their finest; where even that is above the tolerance, coarser
    settings add a tenth of the tolerance at most, so that what is asked for is held as far as knobs can. But a stage of
    which finer settings may not be had (``dear``) is not made dearer for what its other knobs cannot mend: it stays as
    it is, and so does one that does not know its error. A setting that the stage refuses is passed over for a finer
    one.
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
    """A stage with each knob at the first setting with which its error is at most so much; as it was where no
    setting is.
    """
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
        while low < high:  # the first setting that fits: along the ladder no stated error grows
            middle = (low + high) // 2
            candidate = _with(stage, name, settings[middle])
            own = None if candidate is None else asked(candidate)[0]
            if candidate is None or own is None or own > most:
                low = middle + 1
            else:
                high, found, bound = middle, candidate, own
        stage = found
        if bound > finest:  # a setting that changes nothing is no approximation
            chosen.append(Approximated(name, settings[high], settings[-1], bound - finest))
    return stage, tuple(chosen)


def _finest(stage: Stage, knobs: tuple[str, ...]) -> Stage | None:
    """A stage with every open knob at the best setting that a plan may choose; None where it refuses one of them."""
    found: Stage | None = stage
    for name in knobs:
        parameter, _, default = parameters_of(type(stage))[name]
        found = None if found is None else _with(found, name, _allowed(parameter, default)[-1])
    return found


def _allowed(parameter: Parameter, default: bool | float) -> tuple[Any, ...]:
    """The settings that a plan may choose: of a dear knob none finer than the default."""
    found = parameter.settings
    return found[: found.index(default) + 1] if parameter.dear and default in found else found


def _with(stage: Stage, name: str, value: Any) -> Stage | None:
    """A stage with another setting; None where it refuses it."""
    if getattr(stage, name) == value:
        return stage
    try:
        return made(type(stage), {**{one: getattr(stage, one) for one in parameters_of(type(stage))}, name: value})
    except (ValueError, PluginError):
        return None

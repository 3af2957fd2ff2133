"""Approximating: of every knob of fidelity that the file leaves open, the cheapest setting within the local tolerance.

A knob lists its settings from the cheapest to the reference (``Parameter.settings``); the stage says how wrong it is with each
(``error``). What the file writes is the model and stays; a knob that only studies vary is no plan's to choose.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection
from typing import Any

from etendue.errors import PluginError
from etendue.plan.model import Approximated
from etendue.spec.stage import Stage, parameters_of

Asked = Callable[[Stage], tuple[float | None, str]]


def open_knobs(kind: type[Stage], written: Collection[str]) -> tuple[str, ...]:
    """The knobs of a stage that may be chosen."""
    return tuple(
        name
        for name, (parameter, _, _) in parameters_of(kind).items()
        if parameter.fidelity and parameter.settings and not parameter.studied and name not in written
    )


def choose(stage: Stage, knobs: tuple[str, ...], tolerance: float, asked: Asked) -> tuple[Stage, tuple[Approximated, ...]]:
    """A stage with its open knobs set, one after the other, and what was chosen where that is not the reference.

    Of each knob the first setting from the cheap end whose error is within the tolerance, or no larger than that of the reference
    setting: then nothing is gained by a finer one. Where a stage does not know its error the knob stays as it is.
    """
    chosen: list[Approximated] = []
    for name in knobs:
        settings = parameters_of(type(stage))[name][0].settings
        reference = _with(stage, name, settings[-1])
        finest = None if reference is None else asked(reference)[0]
        if reference is None or finest is None:
            continue
        for value in settings:
            candidate = reference if value == settings[-1] else _with(stage, name, value)
            if candidate is None:
                continue
            bound = finest if candidate is reference else asked(candidate)[0]
            if bound is not None and bound <= max(tolerance, finest):
                stage = candidate
                if candidate is not reference:
                    chosen.append(Approximated(name, value, settings[-1], max(bound - finest, 0.0)))
                break
    return stage, tuple(chosen)


def _with(stage: Stage, name: str, value: Any) -> Stage | None:
    """A stage with another setting; None where it refuses it."""
    if getattr(stage, name) == value:
        return stage
    try:
        return dataclasses.replace(stage, **{name: value})
    except (ValueError, PluginError):
        return None

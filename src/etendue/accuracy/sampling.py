"""Discretisations as knobs: settings coarser and finer than in the file, and the change by each discretisation alone.

In:  a pipeline with stages that are ``Discretised``.
Out: a knob for each parameter that sets a discretisation; differences between runs on different grids.

A run on a finer grid costs several times as much. Therefore all other knobs are tried on the grid of the file, and each
discretisation is tried with the others as in the file, because the change by one discretisation hardly depends on the
others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from etendue.accuracy.answers.regridding import on_grid
from etendue.accuracy.differences import difference
from etendue.accuracy.measuring import Measurement, shown_names
from etendue.accuracy.orders import Convergence, remaining
from etendue.accuracy.reference import PipelineKnob, with_settings
from etendue.contract.discretised import Discretised
from etendue.contract.stage import parameters_of
from etendue.errors import EtendueError
from etendue.plan.cost import cell_seconds
from etendue.plan.expansion.search import Value
from etendue.plan.model import Plan

COARSER, FINER = (-4, -2), (2, 4)
MOST = 5.0  # factor on the seconds of the reference on the grid of the file; slower grids are not tried


def sampling_knobs(measurement: Measurement) -> tuple[PipelineKnob, ...]:
    """Return a knob for each discretisation that one parameter sets. Its settings range from a quarter of the file's
    fineness to two or four times its fineness, except settings that the stage refuses or that are too slow.
    """
    plan, found = measurement.exact, []
    for node in plan.nodes:
        kind, stage = node.alternatives[0], plan.of(node.name)[0].stage
        if len(node.alternatives) > 1 or not isinstance(stage, Discretised):
            continue
        for name in (one for one, why in stage.discretisations().items() if not why):
            keys = {key for factor in (*COARSER, *FINER) for key in stage.refined(name, factor)}
            key = keys.pop() if len(keys) == 1 else ""  # the parameter that sets it alone
            if key and f"{node.name}.{key}" not in measurement.pipeline.sweep:
                parameter = parameters_of(type(stage))[key][0]
                value = float(getattr(stage, key))
                one = PipelineKnob(
                    node.name,
                    key,
                    (value,),
                    parameter.units,
                    use=kind.use,
                    closed_form=True,
                    value=value,
                    written=True,
                    studied=True,
                    discretisation=name,
                )
                found.append(replace(one, settings=_settings(measurement, one, stage)))
    return tuple(one for one in found if len(one.settings) > 1)


def _settings(measurement: Measurement, knob: PipelineKnob, stage: Discretised) -> tuple[Value, ...]:
    """Return settings from the coarsest to the finest."""

    def planned(factor: int) -> tuple[float, Plan] | None:
        value = stage.refined(knob.discretisation, factor).get(knob.name)
        try:
            own = {(knob.stage, knob.use, knob.name): value}
            return value and (float(value), measurement.plan(with_settings(measurement.reference.pipeline, own)))
        except EtendueError:
            return None

    coarser = [one[0] for factor in COARSER if (one := planned(factor))]
    finer: list[float] = []
    base = _seconds(measurement.exact)
    for factor in FINER:
        one = planned(factor)
        if one is None or (finer and _seconds(one[1]) > MOST * base):
            break
        finer.append(one[0])
    return tuple(dict.fromkeys([*coarser, float(knob.value), *finer])) if finer else ()


def _seconds(plan: Plan) -> float:
    return math.fsum(cell_seconds(plan.node(cell.node), cell, plan.precision) for cell in plan.cells.values())


def moved(one: Measurement, finest: Measurement) -> dict[str, float]:
    """Return the difference between the references on a grid and on a finer grid, by variable: rms relative to full
    scale.

    Variables that cannot be compared are missing.
    """
    plan, exact = one.exact, finest.exact
    shown, found = shown_names(exact), dict[str, float]()
    for stage, name in finest.measured(exact):
        declared, worst = exact.node(stage).writes[name], 0.0
        for ref, _ in finest.cells_of(exact, stage):
            cell, own = exact.cells[ref], plan.cells[ref]
            if name not in one.truth.arrays.get(ref, ()) or name not in finest.truth.arrays.get(ref, ()):
                break
            array = finest.truth.arrays[ref][name]
            same = own.grids[name] == cell.grids[name]
            finer = array if same else on_grid(array, declared.dims, cell.grids[name], own.grids[name])
            away = None if finer is None else difference(one.truth.arrays[ref][name], finer, declared, cell.stage)
            if away is None or away.relative is None:
                break
            worst = max(worst, away.relative)
        else:
            found[shown.get((stage, name), f"{stage}.{name}")] = worst
    return found


def limits(changes: Mapping[Value, Mapping[str, float]], law: Convergence) -> dict[Value, dict[str, float]]:
    """Return the error of each setting, by variable: the change up to the finest setting, plus the remaining error of
    the finest setting, estimated from the last refinement and the observed order.
    """
    settings = list(changes)
    last = changes[settings[-2]]
    left = {name: remaining(settings, change, law) for name, change in last.items()}
    return {value: {n: own + left.get(n, 0.0) for n, own in changes[value].items()} for value in settings}

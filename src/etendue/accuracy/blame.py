"""Attribute an error to stages: undo the decisions for one stage at a time and measure what remains.

In:  a pipeline with its reference, and a plan of it that exceeds the error asked for.
Out: by stage, with what was decided for it, its share of the error.

A stage with a large error of its own may have no share: errors that both runs have in common do not show in their
difference.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from etendue.accuracy.measuring import LEFT_OUT, PRECISION, GlobalError, MeasuredErrors, Measurement, shown_names
from etendue.accuracy.reference import with_settings
from etendue.contract.stage import parameters_of
from etendue.plan.ancestry import in_front
from etendue.plan.model import Plan

SHARE = 0.05  # of the largest share; smaller ones are not listed


def blamed(
    measurement: Measurement,
    plan: Plan,
    found: MeasuredErrors,
    missed: tuple[str, ...],
    limits: Mapping[str, float],
    norm: str,
) -> dict[str, float]:
    """Return what puts the variables in ``missed`` further from the reference than ``limits``, largest share first.

    For variables that are too far off: how much nearer the worst of them comes if all decisions for a stage are as in
    the reference. For variables that are near enough but not held, because the reference itself is uncertain: how far
    the last refinement of each reference stage moves them, or the error it states if it has no finer setting.
    """
    far = [name for name in missed if _error(found.errors[name], norm) > limits[name]]
    shares = _of_decisions(measurement, plan, found, far, norm) if far else {}
    if not far:
        shares = _of_the_reference(measurement, plan, missed, norm)
    most = max(shares.values(), default=0.0)
    return {name: share for name, share in sorted(shares.items(), key=lambda item: -item[1]) if share > SHARE * most}


def _of_decisions(
    measurement: Measurement, plan: Plan, found: MeasuredErrors, far: list[str], norm: str
) -> dict[str, float]:
    """Return, by stage, how much nearer the worst variable comes; if no single stage matters, all stages together."""
    worst = max(_error(found.errors[name], norm) for name in far)
    shares: dict[str, float] = {}
    decisions = decided(measurement, plan, _stages_of(plan, far))
    for (stage, what), name in decisions.items():
        settings = {
            (k.stage, k.use, k.name): k.reference
            for k in measurement.reference.knobs
            if k.stage == stage and k.name in what
        }
        computed = frozenset({stage} if LEFT_OUT in what else ())
        precision = "float64" if PRECISION in what else None
        undone = measurement.errors(plan.pipeline.tolerance, settings, computed, precision)
        shares[name] = worst - max(_error(undone.errors[one], norm) for one in far)
    if max(shares.values(), default=0.0) > SHARE * worst:
        return shares
    return {f"{' and '.join(decisions.values())}, together": worst} if decisions else {}


def decided(measurement: Measurement, plan: Plan, wanted: Iterable[str]) -> dict[tuple[str, tuple[str, ...]], str]:
    """Return what differs from the reference in the stages that ``wanted`` ones depend on: by stage and decisions, a
    name.
    """
    exact, needed = measurement.exact, in_front(plan, wanted)
    found: dict[str, list[str]] = {}
    for ref, cell in plan.cells.items():
        if cell.node not in needed:
            continue
        own = found.setdefault(cell.node, [])
        if cell.left_out:
            what = [LEFT_OUT]
        else:
            other = exact.cells[ref].stage
            knobs = [name for name, (parameter, _, _) in parameters_of(type(cell.stage)).items() if parameter.fidelity]
            what = [name for name in knobs if getattr(cell.stage, name) != getattr(other, name)]
        own += [one for one in what if one not in own]
    names = {(stage, tuple(what)): _name(stage, what) for stage, what in found.items() if what}
    if plan.precision != exact.precision:
        names["", (PRECISION,)] = f"{PRECISION} {plan.precision}"
    return names


def _of_the_reference(measurement: Measurement, plan: Plan, missed: tuple[str, ...], norm: str) -> dict[str, float]:
    """Return the uncertainty of the reference by stage."""
    shares: dict[str, float] = {}
    needed = in_front(plan, _stages_of(plan, missed))
    for node in measurement.exact.nodes:
        if node.name not in needed:
            continue
        dear = [
            n for one in node.alternatives for n, (parameter, _, _) in parameters_of(one.kind).items() if parameter.dear
        ]
        if dear:
            stated = [cell.error[0] or 0.0 for cell in measurement.exact.of(node.name) if not cell.left_out]
            name = f"{_name(node.name, list(dict.fromkeys(dear)))}, which has no finer setting"
            shares[name] = max(stated, default=0.0)
        finite = [
            k
            for k in measurement.reference.knobs
            if k.stage == node.name and k.settings and k.before_reference != k.reference
        ]
        if finite:
            settings = {(k.stage, k.use, k.name): k.before_reference for k in finite}
            lower = measurement.plan(with_settings(measurement.reference.pipeline, settings))
            moved = measurement.compared(lower, measurement.run(lower))
            name = f"the reference's {_name(node.name, [k.name for k in finite])}"
            shares[name] = max(_error(moved.errors[one], norm) for one in missed)
    return shares


def _name(stage: str, what: list[str]) -> str:
    """Return how a message names decisions of one stage."""
    return (
        f"{stage} {LEFT_OUT}"
        if what == [LEFT_OUT]
        else f"{stage}.{what[0]}"
        if len(what) == 1
        else f"{stage} ({', '.join(what)})"
    )


def _stages_of(plan: Plan, names: Sequence[str]) -> list[str]:
    """Return the stages that write the wanted variables named by measured errors."""
    return [stage for (stage, _), name in shown_names(plan).items() if name in names]


def _error(error: GlobalError, norm: str) -> float:
    return error.value(norm) or 0.0

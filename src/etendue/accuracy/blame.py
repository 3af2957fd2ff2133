"""Attribute an error to stages: undo the decisions for one stage at a time and measure what remains.

In:  a pipeline with its reference, and a plan whose error exceeds the requested error.
Out: for each stage and the decisions for it, its share of the error.

A stage with a large error may still have no share, because an error that plan and reference have in common cancels in
their difference.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from etendue.accuracy.measuring import LEFT_OUT, PRECISION, GlobalError, MeasuredErrors, Measurement, shown_names
from etendue.accuracy.reference import with_settings
from etendue.contract.stage import parameters_of
from etendue.plan.ancestry import in_front
from etendue.plan.model import Plan

SHARE = 0.05  # fraction of the largest share; smaller shares are not listed


def blamed(
    measurement: Measurement,
    plan: Plan,
    found: MeasuredErrors,
    missed: tuple[str, ...],
    limits: Mapping[str, float],
    norm: str,
) -> dict[str, float]:
    """Return the stages that cause the variables in ``missed`` to differ from the reference by more than ``limits``,
    largest share first.

    For variables whose error is too large, the share of a stage is the reduction of the largest error if the stage is
    computed as in the reference. Other variables are missed only because the reference itself is uncertain. For these,
    the share is the change by the last refinement of the stage in the reference or, if it has no finer setting, its
    stated error.
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
    """Return, by stage, by how much the largest error falls if the stage's decisions are undone; if no single stage
    reduces it enough, one entry for all stages together.
    """
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
    """Return the decisions that differ from the reference, for the stages on which ``wanted`` depends: a name by stage
    and decisions.
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
    """Return the name of the decisions for one stage in messages."""
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

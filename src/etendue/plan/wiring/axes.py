"""Resolve the axes of a sweep, and the parameters that each axis sets.

In:  the pipeline's ``[sweep]``, the alternatives at every stage, shared quantities, the axes of swapped stages.
Out: axes in the order of the file, and the (dim, parameter) pairs that set each stage directly.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from etendue.contract.stage import parameters_of
from etendue.contract.values import quantities
from etendue.contract.values.parameter import Parameter
from etendue.errors import nearest
from etendue.plan.model import Axis
from etendue.plan.wiring.alternatives import Entries
from etendue.plan.wiring.parameters import Unfit, axis_values
from etendue.plan.wiring.quantities import Quantities
from etendue.plan.wiring.request import Request


class _Target(NamedTuple):
    """The parameter or quantity that one line of a sweep sets, and the stages that use it."""

    parameter: Parameter
    kind: Any
    dim: str
    name: str
    users: list[str]


def resolve_axes(
    request: Request, entries: Entries, shared: Quantities, swapped: list[Axis]
) -> tuple[list[Axis], dict[str, list[tuple[str, str]]]]:
    """Return all axes, including axes of ``.use``, and the parameters that the other axes set, by stage."""
    direct: dict[str, list[tuple[str, str]]] = {}
    by_key = {axis.key: axis for axis in swapped}
    ordered: list[Axis] = []
    for key, value in request.pipeline.sweep.items():
        if key in by_key:
            ordered.append(by_key[key])
            continue
        if key in request.pipeline.table.words():
            if axis := shared.presets.get(key):
                ordered.append(axis)
                for name in axis.gives:
                    for user in users_of(name, entries):
                        direct.setdefault(user, []).append((axis.dim, name))
            continue
        target = _parameter_of(request, key, entries) if "." in key else _quantity_of(request, key, entries, shared)
        if target is None:
            continue
        place = f"sweep.{key}"
        try:
            values = axis_values(value, target.parameter, target.kind, request.pipeline.folder)
        except Unfit as error:
            request.fault(place, str(error))
            continue
        if values and isinstance(values[0], tuple):
            if not (target.parameter.one_for_all and all(len(v) == 1 for v in values)):
                request.fault(place, "an axis takes one value per step, not a list of several")
                continue
            values = tuple(v[0] for v in values)
        ordered.append(Axis(key, target.dim, values, target.parameter.units))
        for user in target.users:
            direct.setdefault(user, []).append((target.dim, target.name))
    return ordered, direct


def _parameter_of(request: Request, key: str, entries: Entries) -> _Target | None:
    """Return the target that ``stage.parameter`` names; None if it does not exist or a fault is reported."""
    stage, _, name = key.partition(".")
    place = f"sweep.{key}"
    if stage not in entries:
        request.fault(place, f"the pipeline has no stage {stage!r}{nearest(stage, entries)}")
        return None
    if name == "use" or not entries[stage]:
        return None
    holders = [one for one in entries[stage] if name in parameters_of(one.kind)]
    if not holders:
        own = [n for n, (p, _, _) in parameters_of(entries[stage][0].kind).items() if not p.shared]
        request.fault(place, f"{stage} has no parameter {name!r}{nearest(name, own)}")
        return None
    parameter, kind, _ = parameters_of(holders[0].kind)[name]
    if parameter.shared:
        request.fault(place, f"{name} is a {request.pipeline.table.name} quantity; sweep it under its own name")
        return None
    return _Target(parameter, kind, f"{stage}_{name}", name, [stage])


def _quantity_of(request: Request, key: str, entries: Entries, shared: Quantities) -> _Target | None:
    """Return the shared quantity that a bare name denotes; None if it does not exist or a fault is reported."""
    place = f"sweep.{key}"
    if key not in shared.declared:
        if not request.whole:
            return None
        if key in quantities.names():
            request.fault(place, "no stage of this pipeline depends on this axis; remove it")
        else:
            known = [*shared.declared, *(f"{s}.use" for s in entries)]
            request.fault(place, f"cannot sweep {key!r}: unknown name{nearest(key, known)}")
        return None
    one = shared.declared[key]
    # the bare name is taken by the variable
    dim = f"{request.pipeline.table.name}_{key}" if key in shared.written else key
    return _Target(one.parameter, one.kind, dim, key, users_of(key, entries))


def users_of(quantity: str, entries: Entries) -> list[str]:
    """Return the names of the stages that take a shared quantity."""
    return [stage for stage, made in entries.items() if any(quantity in parameters_of(one.kind) for one in made)]

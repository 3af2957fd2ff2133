"""Find the stages of the pipeline that affect the subject of a metric but are not included in it.

In:  a plan, a node of it and a variable that it writes.
Out: names of stages, for tables, plots and reports to show beside the metric.
"""

from __future__ import annotations

from etendue.contract.capabilities import Datasheet, Noisy, is_random
from etendue.contract.stage import Stage, looks_at_stages
from etendue.plan.model import Node, Plan


def not_in_it(plan: Plan, node: Node, variable: str) -> tuple[str, ...]:
    """Return the names of the stages that the metric does not include, in the order of the pipeline, without stages
    that do nothing in any cell.
    """
    roles = {role for one in node.alternatives for role in one.kind.unseen.get(variable, ())}
    if not roles:
        return ()
    looked = {what: names for _, what, names in node.looks_at if looks_at_stages(what)}
    seen = {name for names in looked.values() for name in names}
    measured = {
        written for other in plan.nodes if other.name in looked.get("datasheet", ()) for written in other.writes
    }
    found = []
    for other in plan.nodes:
        told = any(one.kind.role in roles or _silent(one.kind, measured) for one in other.alternatives)
        idle = all(cell.left_out is not None and cell.left_out.bound == 0 for cell in plan.of(other.name))
        if told and not idle and other.name not in seen | {node.name} and not other.is_probe:
            found.append(other.name)
    return tuple(found)


def _silent(kind: type[Stage], measured: set[str]) -> bool:
    """Return whether a stage adds random noise to the outputs of the measured stages without stating its size."""
    told = issubclass(kind, Datasheet) or (issubclass(kind, Noisy) and kind.inherent)
    return bool(measured & set(kind.writes)) and is_random(kind) and not told

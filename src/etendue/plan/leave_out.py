"""Leaving out: what a scene does not need, decided per cell, with bounds that add up to the tolerance.

A stage may be left out where it reads and writes the same variable on the same grid and says how wrong that would
be (``negligible``). An exact zero is always taken. A bound above zero is taken when it fits the stage's share of the
tolerance: the tolerance is split evenly over the stages of the pipeline that can be left out, and divided by the
largest gain between the stage and the end of the claim. Nothing here depends on what else is swept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from etendue.plan.asking import negligible
from etendue.plan.model import LeftOut, Node
from etendue.spec.capabilities import Bounded
from etendue.spec.facts import Facts
from etendue.spec.grid import Grid
from etendue.spec.stage import Stage, reads_of, writes_of


def downstream_gain(nodes: Sequence[Node]) -> dict[str, float]:
    """Largest factor by which an error behind each node can grow until the claim ends."""
    worst = {node.name: 1.0 for node in nodes}
    for node in reversed(nodes):
        for one, bound in zip(node.alternatives, node.inputs, strict=True):
            gain = one.kind.gain
            grown = 1.0 if gain is None else max(1.0, gain) * worst[node.name]
            for _, source, _ in bound:
                worst[source] = max(worst[source], grown)
    return worst


def claim_ends(nodes: Sequence[Node]) -> dict[str, str]:
    """For each node whose stages can be left out: the first stage downstream without a declared gain, or ''."""
    ends = {}
    for node in nodes:
        open_, seen, end = [node.name], {node.name}, ""
        while open_ and not end:
            name = open_.pop(0)
            for other in nodes:
                if other.name in seen or not any(s == name for bound in other.inputs for _, s, _ in bound):
                    continue
                if any(one.kind.gain is None for one in other.alternatives):
                    end = other.name
                    break
                seen.add(other.name)
                open_.append(other.name)
        ends[node.name] = end
    return ends


def shares(nodes: Sequence[Node], tolerance: float) -> dict[str, float]:
    """How large a bound each node may spend, in units of its own variable's full scale."""
    able = [n.name for n in nodes if any(issubclass(a.kind, Bounded) for a in n.alternatives)]
    gains = downstream_gain(nodes)
    return {node.name: tolerance / max(len(able), 1) / gains[node.name] for node in nodes}


def decide(
    stage: Stage, inputs: Any, facts: Mapping[str, Facts], grids_in: Mapping[str, Grid], grids: Mapping[str, Grid], share: float
) -> LeftOut | None:
    """Whether one cell is left out, and with which bound."""
    writes = [declaration for declaration in writes_of(type(stage)).values() if not declaration.optional]
    for declaration in writes:
        port = next((p for p, d in reads_of(type(stage)).items() if d.variable == declaration.variable), None)
        if port is None or port not in grids_in or grids_in[port] != grids[declaration.variable]:
            return None
    main = next(p for p, d in reads_of(type(stage)).items() if d.variable == writes[0].variable)
    answer = negligible(stage, facts[main], grids_in[main])
    if answer is None:
        return None
    bound, why = answer
    return LeftOut(bound, why) if bound == 0 or bound <= share else None


def accumulated(stage: Stage, before: Sequence[float | None], decided: LeftOut | None) -> float | None:
    """Error carried by a cell from everything left out up to it; ``None`` where the claim has ended."""
    if any(bound is None for bound in before):
        return None
    total = sum(bound for bound in before if bound)
    if decided:
        return total + decided.bound
    if total == 0:
        return 0.0
    return None if stage.gain is None else total * max(1.0, stage.gain)

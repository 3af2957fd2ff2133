"""One point of a pipeline with other discretisations: bins, spacing, margin, refined or coarsened.

In:  a plan, the axis values of one point.
Out: expected values of the wanted variables there, and what computing them costs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from etendue.accuracy.answers.error import is_number
from etendue.accuracy.pilot import narrowed
from etendue.accuracy.reference import reference_of
from etendue.contract.capabilities import Source
from etendue.contract.discretised import Discretised
from etendue.contract.ports import Progress
from etendue.contract.registry import Registry
from etendue.errors import EtendueError, RequestError
from etendue.pipeline.derived import wanting, with_values
from etendue.pipeline.file import PipelineFile
from etendue.plan.ancestry import ancestry, behind, in_front
from etendue.plan.cost import cell_seconds
from etendue.plan.model import CellRef, Plan, StageVariable
from etendue.plan.planner import make_plan
from etendue.present.terminal.answer_texts import shortened
from etendue.session import Options, collect
from etendue.telling import plain

if TYPE_CHECKING:
    from etendue.types.arrays import Array
    from etendue.types.documents import AxisValues

AS_PLANNED, EXACT, DRAWN = "as planned", "exact", "drawn"
Factors = Mapping[str, int]  # by discretisation: n times as fine, or -n: n times as coarse


class Point:
    """A pipeline at one point of its sweep.

    Parameters
    ----------
    plan : of the whole pipeline
    registry : of installed stages
    place : axis values of the point, by dim
    wanted : variables to compute there
    """

    def __init__(self, plan: Plan, registry: Registry, place: AxisValues, wanted: tuple[StageVariable, ...]) -> None:
        self.registry, self.wanted, self.refusal = registry, wanted, ""
        pipeline = replace(plan.pipeline, leave_out=plan.leaves_out and plan.pipeline.leave_out)
        self.pipeline = wanting(narrowed(pipeline, plan.axes, [dict(place)]), wanted)
        self.at = at = {axis.dim: axis.values.index(place[axis.dim]) for axis in plan.axes}
        here = {node.name: plan.cells[node.name, tuple(at[dim] for dim in node.axes)].stage for node in plan.nodes}
        self.stages = {name: stage for name, stage in here.items() if isinstance(stage, Discretised)}
        self.silent = [name for name, one in here.items() if isinstance(one, Source) and name not in self.stages]

    def fixed(self) -> dict[str, str]:
        """Return the discretisations that cannot be refined, each with the reason."""
        found = {name: why for _, name, why in self._discretisations() if why}
        return found | {f"discretisation of {name}": "the stage does not say how it is refined" for name in self.silent}

    def names(self) -> list[str]:
        """Return the discretisations that can be refined."""
        return list(dict.fromkeys(name for _, name, why in self._discretisations() if not why))

    def remedies(self) -> dict[str, str]:
        """Return, for each discretisation, the parameters that refine it by two, as in the file."""
        found = {}
        for name in self.names():
            values = self.values_of({name: 2}) or {}
            own = [f"{stage}.{key} = {value:.4g}" for stage, some in values.items() for key, value in some.items()]
            found[name] = ", ".join(own)
        return found

    def affected(self, plan: Plan, name: str) -> list[StageVariable]:
        """Return the wanted variables that a discretisation can change."""
        stages = {stage for stage, own, why in self._discretisations() if own == name and not why}
        return [one for one in self.wanted if stages & in_front(plan, [one[0]])]

    def _discretisations(self) -> Iterator[tuple[str, str, str]]:
        for stage, one in self.stages.items():
            yield from ((stage, name, why) for name, why in one.discretisations().items())

    def values_of(self, factors: Factors) -> dict[str, Mapping[str, Any]] | None:
        """Return the parameters of stages that give these discretisations; None if one gets no finer or coarser."""
        found: dict[str, dict[str, Any]] = {}
        for name, factor in factors.items():
            own = {
                s: self.stages[s].refined(name, factor)
                for s, one, why in self._discretisations()
                if one == name and not why
            }
            if not any(own.values()):
                return None
            for stage, values in own.items():
                found.setdefault(stage, {}).update(values)
        return dict(found)

    def with_values(self, values: Mapping[str, Mapping[str, Any]], exact: bool) -> PipelineFile:
        """Return the pipeline with parameters of stages, nothing left out; ``exact``: its reference."""
        pipeline = self.pipeline
        for stage, own in values.items():
            pipeline = _written(pipeline, stage, own)
        return reference_of(pipeline, self.registry).pipeline if exact else replace(pipeline, leave_out=False)

    def planned(self, factors: Factors, how: str = "") -> Plan | None:
        """Return the plan with these discretisations; None if it is refused. ``how``: '' with nothing left out,
        ``AS_PLANNED`` with everything as in the run, ``EXACT`` for the reference, ``DRAWN`` for one more draw.
        """
        try:
            if how == DRAWN:
                drawn = replace(self.pipeline, seed=self.pipeline.seed + factors["draw"])
                return make_plan(drawn, self.registry)
            values = self.values_of(factors)
            if values is None:
                return None
            pipeline = self.pipeline if how == AS_PLANNED else self.with_values(values, how == EXACT)
            plan = make_plan(pipeline, self.registry, expected=True)
        except EtendueError as error:
            faults = error.faults if isinstance(error, RequestError) else ()
            self.refusal = shortened(faults[0].message if faults else plain(str(error)))
            return None
        made = {(stage, name): getattr(plan.of(stage)[0].stage, name) for stage, own in values.items() for name in own}
        return plan if all(made[stage, name] == own[name] for stage, own in values.items() for name in own) else None

    def noisy(self, plan: Plan) -> list[StageVariable]:
        """Return the wanted numbers that depend on noise drawn anew."""
        drawn = behind(plan, (node.name for node in plan.nodes if node.draws_anew))
        return [one for one in self.wanted if one[0] in drawn and is_number(plan.node(one[0]).writes[one[1]])]

    def refs(self, plan: Plan) -> dict[StageVariable, CellRef]:
        return {(stage, name): plan.of(stage)[0].ref for stage, name in self.wanted}

    def seconds(self, plan: Plan) -> float:
        """Return the predicted seconds of a plan of this point."""
        needed = ancestry(plan, set(self.refs(plan).values()))
        return sum(cell_seconds(plan.node(ref[0]), plan.cells[ref], plan.precision) for ref in needed)

    def values(self, plan: Plan, progress: Progress | None = None) -> dict[StageVariable, Array]:
        """Return the values of the wanted variables; those whose cells fail are missing."""
        refs = self.refs(plan)
        asked: dict[CellRef, set[str]] = {}
        for (_, name), ref in refs.items():
            asked.setdefault(ref, set()).add(name)
        found = collect(plan, asked, Options("serial"), progress)
        return {
            one: found.arrays[ref][one[1]]
            for one, ref in refs.items()
            if ref in found.arrays and one[1] in found.arrays[ref]
        }


def _written(pipeline: PipelineFile, stage: str, values: Mapping[str, Any]) -> PipelineFile:
    """Return the pipeline, narrowed to one point, with values of a stage, also where an axis sets them or the stage."""
    use = pipeline.sweep.get(f"{stage}.use")
    if isinstance(use, list | tuple) and len(use) == 1:
        table = {"use": use[0]} if isinstance(use[0], str) else dict(use[0])
        swapped = {**table, **values, "label": table.get("label", table["use"])}
        return replace(pipeline, sweep={**pipeline.sweep, f"{stage}.use": [swapped]})
    swept = {f"{stage}.{name}": [value] for name, value in values.items() if f"{stage}.{name}" in pipeline.sweep}
    own = {name: value for name, value in values.items() if f"{stage}.{name}" not in swept}
    return replace(with_values(pipeline, stage, own), sweep={**pipeline.sweep, **swept})

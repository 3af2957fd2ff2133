"""One point of a pipeline with refined or coarsened discretisations: bins, spacing, margin.

In:  a plan, the axis values of one point.
Out: expected values of the wanted variables at this point, and the plans that compute them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from etendue.accuracy.answers.error import is_number
from etendue.accuracy.pilot import narrowed
from etendue.accuracy.reference import PipelineKnob, reference_of, within
from etendue.contract.capabilities import Sampled, Source
from etendue.contract.discretised import Discretised
from etendue.contract.ports import Progress
from etendue.contract.registry import Registry
from etendue.contract.stage import looks_at_stages, parameters_of
from etendue.errors import EtendueError, RequestError
from etendue.pipeline.derived import wanting
from etendue.plan.ancestry import behind, in_front
from etendue.plan.expansion.search import Value
from etendue.plan.model import CellRef, Plan, StageVariable
from etendue.plan.variants import at_point, variant, with_draw
from etendue.present.terminal.answer_texts import shortened
from etendue.session import Collected, Options, collect
from etendue.telling import plain

if TYPE_CHECKING:
    from etendue.types.arrays import Array
    from etendue.types.documents import AxisValues

EXACT, NEARER, DRAWN = "exact", "nearer", "drawn"  # ``how`` of `Point.planned`; '' is as planned
NOTHING: Mapping[Any, Any] = MappingProxyType({})
Kept = Callable[[CellRef, Collection[str]], Mapping[str, "Array"]]  # returns what a run has kept of a cell
Factors = Mapping[str, int]  # by discretisation: n times as fine, or -n: n times as coarse


class Point:
    """A pipeline at one point of its sweep.

    Parameters
    ----------
    plan : plan of the whole pipeline
    registry : registry of installed stages
    place : axis values of the point, by dim
    wanted : variables to compute at this point
    """

    def __init__(self, plan: Plan, registry: Registry, place: AxisValues, wanted: tuple[StageVariable, ...]) -> None:
        self.registry, self.wanted, self.refusal = registry, wanted, ""
        self.asked = frozenset(plan.wanted)  # the variables among ``wanted`` that the pipeline names as wanted
        pipeline = replace(plan.pipeline, leave_out=plan.leaves_out and plan.pipeline.leave_out)
        self.pipeline = wanting(narrowed(pipeline, plan.axes, [dict(place)]), wanted)
        self.base = at_point(plan, place, wanted)  # plan with everything as in the run, but without noise
        self.at = at = plan.everywhere({axis.dim: axis.values.index(place[axis.dim]) for axis in plan.axes})
        self.here = {node.name: (node.name, tuple(at[dim] for dim in node.axes)) for node in plan.nodes}
        here = {name: plan.cells[ref].stage for name, ref in self.here.items()}
        self.stages = {name: stage for name, stage in here.items() if isinstance(stage, Discretised)}
        self.silent = [name for name, one in here.items() if isinstance(one, Source) and name not in self.stages]

    def fixed(self) -> dict[str, str]:
        """Return the discretisations that cannot be refined, each with the reason; also the knobs whose finer settings
        are too costly, if their stage states an error above the tolerance.
        """
        found = {name: why for _, name, why in self._discretisations() if why}
        for cell in self.base.cells.values():
            knobs = [name for name, (one, _, _) in parameters_of(type(cell.stage)).items() if one.dear]
            error = cell.error[0] or 0.0
            if knobs and cell.left_out is None and error > self.base.pipeline.tolerance:
                costly = f"finer settings are too costly; the stage states an error of {error:.2g} of full scale"
                found[f"{cell.node} ({', '.join(knobs)})"] = costly
        return found | {f"discretisation of {name}": "the stage does not say how to refine it" for name in self.silent}

    def names(self) -> list[str]:
        """Return the discretisations that can be refined."""
        return list(dict.fromkeys(name for _, name, why in self._discretisations() if not why))

    def remedies(self) -> dict[str, str]:
        """Return, for each discretisation, the parameters that refine it by a factor of two, as written in a file."""
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

    def why_no_finer(self) -> str:
        return f"half of this value is refused{f' ({self.refusal})' if self.refusal else ''}"

    def why_no_reference(self) -> str:
        return f"the reference is refused{f' ({self.refusal})' if self.refusal else ''}"

    def _discretisations(self) -> Iterator[tuple[str, str, str]]:
        for stage, one in self.stages.items():
            yield from ((stage, name, why) for name, why in one.discretisations().items())

    def values_of(self, factors: Factors) -> dict[str, Mapping[str, Any]] | None:
        """Return the parameters of stages for these discretisations; None if one of them cannot be made finer or
        coarser.
        """
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

    def planned(self, factors: Factors, how: str = "") -> Plan | None:
        """Return the plan with these discretisations; None if stages refuse it. ``how``: '' for everything else as in
        the run, ``EXACT`` for the reference, ``NEARER`` for settings one step closer to it, ``DRAWN`` for another draw
        of the noise.
        """
        try:
            if not factors and not how:
                return self.base
            if how == DRAWN:
                return with_draw(self.base, factors["draw"])
            values = self.values_of(factors)
            if values is None:
                return None
            settings = {EXACT: self.best, NEARER: self.nearer}[how] if how else {}
            both = {stage: {**settings.get(stage, {}), **values.get(stage, {})} for stage in {*settings, *values}}
            plan = variant(self.base, both, exact=bool(how))
        except EtendueError as error:
            faults = error.faults if isinstance(error, RequestError) else ()
            self.refusal = shortened(faults[0].message if faults else plain(str(error)))
            return None
        made = {(stage, name): getattr(plan.of(stage)[0].stage, name) for stage, own in values.items() for name in own}
        return plan if all(made[stage, name] == own[name] for stage, own in values.items() for name in own) else None

    @cached_property
    def knobs(self) -> list[PipelineKnob]:
        """The knobs that the reference sets for the stages in use, each with the settings that its stage accepts."""
        used = {node.name: node.alternatives[0].use for node in self.base.nodes}
        every = reference_of(self.pipeline, self.registry).knobs
        own = [self._accepted(knob) for knob in every if knob.settings and used.get(knob.stage) == knob.use]
        return [knob for knob in own if knob.settings]

    def _accepted(self, knob: PipelineKnob) -> PipelineKnob:
        """Return a knob whose best setting is the best that its stage accepts (with common draws, ``inf`` is
        refused).
        """
        stage = self.base.of(knob.stage)[0].stage

        def takes(setting: Value) -> bool:
            try:
                replace(stage, **{knob.name: setting})
            except (ValueError, TypeError):
                return False
            return True

        return within(knob, takes)

    @cached_property
    def best(self) -> dict[str, dict[str, Any]]:
        """By stage, the settings of its knobs in the reference."""
        return self._settings(lambda knob, own: knob.reference)

    @cached_property
    def nearer(self) -> dict[str, dict[str, Any]]:
        """For each stage, settings of its knobs one step finer than in the run, or the setting of the reference if the
        reference is a closed form.
        """
        return self._settings(lambda knob, own: knob.reference if knob.closed_form else knob.finer_than(own))

    def _settings(self, chosen: Callable[[PipelineKnob, Any], Any]) -> dict[str, dict[str, Any]]:
        found: dict[str, dict[str, Any]] = {}
        for knob in self.knobs:
            own = getattr(self.base.of(knob.stage)[0].stage, knob.name)
            found.setdefault(knob.stage, {})[knob.name] = chosen(knob, own)
        return found

    @cached_property
    def noisy(self) -> list[StageVariable]:
        """The wanted numbers that differ between draws of the noise."""
        nodes = self.base.nodes
        drawn = behind(self.base, (node.name for node in nodes if node.draws_anew))
        return [one for one in self.wanted if one[0] in drawn and is_number(self.base.node(one[0]).writes[one[1]])]

    @cached_property
    def drawn(self) -> set[str]:
        """The stages whose outputs differ between a run and the noise-free path."""
        nodes = {node.name: node for node in self.base.nodes}
        averaged = (name for name, one in nodes.items() if any(issubclass(a.kind, Sampled) for a in one.alternatives))
        return behind(self.base, [*(name for name, one in nodes.items() if one.draws_anew), *averaged])

    @cached_property
    def before_noise(self) -> Mapping[CellRef, set[str]]:
        """The variables that do not depend on the noise, from which every draw and the noise-free path start."""
        nodes, drawn = {node.name: node for node in self.base.nodes}, self.drawn
        found: dict[CellRef, set[str]] = {}
        for cell in self.base.cells.values():
            if cell.node in drawn:
                what = {port: of for port, of, _ in nodes[cell.node].looks_at if not looks_at_stages(of)}
                seen = [(ref, what[port]) for port, refs in cell.looks_at if port in what for ref in refs]
                read = [(ref, name) for _, ref, name in cell.inputs] + [(w.ref, w.variable) for w in cell.open_words]
                for ref, name in (*read, *seen):
                    if ref[0] not in drawn:
                        found.setdefault(ref, set()).add(name)
        return found

    def computed_before(self, kept: Kept) -> dict[CellRef, Mapping[str, Array]]:
        """Return what a run has kept of the cells that do not depend on the noise: their variables in `before_noise`
        and their wanted variables. A cell is omitted if one of its variables is not kept.
        """
        needed = {ref: set(names) for ref, names in self.before_noise.items()}
        for (stage, name), ref in self.refs(self.base).items():
            if stage not in self.drawn:
                needed.setdefault(ref, set()).add(name)
        found = {}
        for ref, names in needed.items():
            writes = self.base.node(ref[0]).writes
            if all(writes[name].dtype == "float" for name in names):
                arrays = kept(self.here[ref[0]], names)
                if arrays.keys() >= names:
                    found[ref] = arrays
        return found

    def draw_of_run(self, kept: Kept) -> dict[StageVariable, Array]:
        """Return the wanted numbers that differ between draws, as the run has drawn them; empty if one of them is not
        kept.
        """
        found = {(stage, name): kept(self.here[stage], {name}).get(name) for stage, name in self.noisy}
        known = {one: array for one, array in found.items() if array is not None}
        return known if len(known) == len(found) else {}

    def refs(self, plan: Plan, asked: Collection[StageVariable] | None = None) -> dict[StageVariable, CellRef]:
        """Return the cells of the variables to evaluate: the noisy numbers for a draw, otherwise all wanted variables;
        with ``asked``, only these.
        """
        wanted = self.wanted if plan.expected else self.noisy
        return {one: plan.of(one[0])[0].ref for one in wanted if asked is None or one in asked}

    def computed(
        self,
        plan: Plan,
        progress: Progress | None = None,
        known: Mapping[CellRef, Mapping[str, Array]] = NOTHING,
        more: Mapping[CellRef, Collection[str]] = NOTHING,
        asked: Collection[StageVariable] | None = None,
    ) -> Collected:
        """Compute the variables of an evaluation, and ``more``, from the arrays of ``known`` cells."""
        needed = {ref: set(names) for ref, names in more.items()}
        for (_, name), ref in self.refs(plan, asked).items():
            needed.setdefault(ref, set()).add(name)
        needed = {ref: names for ref, names in needed.items() if ref not in known}
        found = collect(plan, needed, Options("serial"), progress, known)
        found.arrays.update({ref: dict(own) for ref, own in known.items()})
        return found

    def values(self, plan: Plan, found: Collected | None = None) -> dict[StageVariable, Array]:
        """Return the values of an evaluation, without the values of failed cells."""
        arrays = (found or self.computed(plan)).arrays
        return {one: arrays[ref][one[1]] for one, ref in self.refs(plan).items() if one[1] in arrays.get(ref, ())}

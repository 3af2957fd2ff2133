"""Measure global errors: the joint effect of all omissions and approximations on the wanted variables.

In:  a pipeline.
Out: for every wanted variable its difference from the reference (`reference`), on some cells of the sweep (`pilot`).

Both runs compute expected values: samplers give their mean and nothing is rounded (`Sampled`). Otherwise the comparison
would be ill-posed: an error d becomes sqrt(d q) after rounding by q, and two draws differ by their noise.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from etendue.accuracy.differences import difference
from etendue.accuracy.pilot import MOST, chosen_places, narrowed
from etendue.accuracy.reference import PipelineKnob, ReferencePipeline, reference_of, with_settings, within
from etendue.archive.read.differing import Difference
from etendue.archive.records.remembered import recall, remember
from etendue.contract.arrays.variables import variable as known
from etendue.contract.capabilities import has_no_mean
from etendue.contract.registry import Registry
from etendue.contract.stage import parameters_of
from etendue.errors import RequestError
from etendue.pipeline.file import PipelineFile
from etendue.plan.ancestry import behind
from etendue.plan.cost import cell_seconds
from etendue.plan.expansion.search import Means, Value
from etendue.plan.identity.keys import digest
from etendue.plan.model import CellRef, Plan, StageVariable
from etendue.plan.planner import make_plan
from etendue.plan.wiring.graph import build_graph
from etendue.result_files import finite
from etendue.run.peak_memory import peak_memory, workers_of
from etendue.session import Collected, Options, collect
from etendue.types.documents import AxisValues, Document, DocumentView

FORM = 1  # version of the cached documents: increase it to discard earlier ones
LEFT_OUT, PRECISION = "left out", "precision"


@dataclass(frozen=True)
class GlobalError:
    """The error of one wanted variable in the worst measured cell. A value is None if it is unknown, for the reason in
    ``why``.

    ``how`` is ``measured``, ``unknown``, or ``unknown below`` followed by the possible error of the reference itself.
    ``below`` is the change by the last refinement of the reference. ``rms`` is taken over the picture and ``max`` at
    the pixel with the largest error, both relative to ``scale``; ``linear`` is (rms, max) of an encoded variable before
    its encoding.
    """

    rms: float | None
    max: float | None
    scale: float | None
    how: str
    at: AxisValues = field(default_factory=dict)
    linear: tuple[float | None, float | None] | None = None
    why: str = ""
    below: float = 0.0  # possible error of the reference itself

    def value(self, norm: str) -> float | None:
        return self.rms if norm == "rms" else self.max

    def held(self, tolerance: float, norm: str = "rms") -> bool | None:
        """Return whether the error is within a tolerance; None if it is unknown, or if the uncertainty of the reference
        reaches the tolerance.
        """
        value = self.value(norm)
        if value is None or (value <= tolerance and self.below > tolerance):
            return None
        return value <= tolerance


@dataclass(frozen=True)
class MeasuredErrors:
    """Measured global errors. ``errors``: by variable name (``stage.name`` if two stages write a variable of that
    name).
    """

    errors: dict[str, GlobalError]
    cells: int  # places of the sweep
    seconds: float  # CPU time of the runs
    remembered: bool = False  # from an earlier run

    def document(self) -> Document:
        """Return the document that is stored."""
        errors = {name: {**asdict(error), "at": dict(error.at)} for name, error in self.errors.items()}
        return {"errors": errors, "cells": self.cells, "seconds": self.seconds}

    @property
    def worst(self) -> float | None:
        """The largest rms error that is known."""
        return max((e.rms for e in self.errors.values() if e.rms is not None), default=None)


def from_document(document: DocumentView) -> MeasuredErrors | None:
    """Return the stored result; None if it has another form."""
    try:
        errors = {
            str(name): GlobalError(**{**own, "linear": None if own["linear"] is None else tuple(own["linear"])})
            for name, own in document["errors"].items()
        }
        return MeasuredErrors(errors, int(document["cells"]), float(document["seconds"]), remembered=True)
    except (KeyError, TypeError, ValueError, AttributeError):
        return None


def measure(
    pipeline: PipelineFile,
    registry: Registry,
    cells: int = MOST,
    options: Options | None = None,
    progress: Any = None,
    archive: Path | None = None,
) -> MeasuredErrors:
    """Return the global error of every wanted variable of a pipeline, at ``cells`` points of its sweep.

    ``archive``: where results are cached; errors are measured again only if the compared cells have changed.
    """
    measurement = Measurement(pipeline, registry, cells, options, progress)
    return measurement.errors() if archive is None else measurement.remembered(archive)


class Measurement:
    """A pipeline with its reference, which is computed once for any number of tolerances.

    Parameters
    ----------
    pipeline : pipeline as read
    registry : registry of installed stages
    cells : largest number of places of the sweep
    options : run options
    progress : ``plan -> Progress``, or None
    reference : replaces the reference of all knobs that the file does not write

    Attributes
    ----------
    also : variables (stage, name) to measure in addition to the wanted ones
    before : called before each run with its expected seconds and bytes; may raise an exception
    """

    also: tuple[StageVariable, ...] = ()
    before: Callable[[Means], None] = staticmethod(lambda need: None)

    def __init__(
        self,
        pipeline: PipelineFile,
        registry: Registry,
        cells: int = MOST,
        options: Options | None = None,
        progress: Any = None,
        reference: ReferencePipeline | None = None,
    ) -> None:
        self.registry, self.options, self.progress = registry, options or Options(), progress
        graph = build_graph(pipeline, registry)
        self.places = chosen_places(graph.axes, cells)
        self.pipeline = narrowed(pipeline, graph.axes, self.places)
        if reference is None:
            reference = self.possible(reference_of(self.pipeline, registry))
        else:
            reference = replace(
                reference,
                pipeline=narrowed(reference.pipeline, graph.axes, self.places),
                coarser=reference.coarser and narrowed(reference.coarser, graph.axes, self.places),
            )
        self.reference = reference
        self.seconds = self.estimated = 0.0  # of all runs

    def plan(self, pipeline: PipelineFile, computed: frozenset[str] = frozenset()) -> Plan:
        return make_plan(pipeline, self.registry, expected=True, computed=computed)

    def possible(self, reference: ReferencePipeline) -> ReferencePipeline:
        """Return the reference; a knob whose best setting is refused by its stage is set to the best accepted setting.

        Raises
        ------
        RequestError
            The pipeline itself is invalid.
        """
        try:
            self.plan(reference.pipeline)
            return reference
        except RequestError:
            self.plan(self.pipeline)  # raises if the pipeline itself is at fault
        return reference_of(self.pipeline, self.registry, [self.within(knob) for knob in reference.knobs])

    def within(self, knob: PipelineKnob) -> PipelineKnob:
        """Return a knob with only the settings with which the pipeline can be planned."""

        def takes(setting: Value) -> bool:
            try:
                self.plan(with_settings(self.pipeline, {(knob.stage, knob.use, knob.name): setting}))
            except RequestError:
                return False
            return True

        return within(knob, takes)

    @cached_property
    def exact(self) -> Plan:
        """The plan of the reference."""
        return self.plan(self.reference.pipeline)

    @cached_property
    def truth(self) -> Collected:
        return self.run(self.exact)

    @cached_property
    def coarser(self) -> tuple[Plan, Collected] | None:
        """The plan and results of the reference with one refinement less; None if every finest setting is exact."""
        if self.reference.coarser is None:
            return None
        plan = self.plan(self.reference.coarser)
        return plan, self.run(plan)

    def run(self, plan: Plan) -> Collected:
        """Compute the wanted variables of a plan at every place, and the variables from which encoded variables are
        made.
        """
        estimate = sum(cell_seconds(plan.node(cell.node), cell, plan.precision) for cell in plan.cells.values())
        # Factor on estimated seconds, from the runs so far.
        longer = self.seconds / self.estimated if self.estimated else 1.0
        workers = workers_of(self.options.scheduler, self.options.workers)
        self.before(Means(longer * estimate, peak_memory(plan, workers, pictures=False).bytes))
        found = collect(plan, self.asked(plan), self.options, self.progress(plan) if self.progress else None)
        self.estimated += estimate
        self.seconds += sum(report.seconds for report in found.reports.values())
        return found

    def measured(self, plan: Plan) -> tuple[StageVariable, ...]:
        """Return the variables to measure in a plan."""
        return tuple(dict.fromkeys((*plan.wanted, *self.also)))

    def asked(self, plan: Plan) -> dict[CellRef, set[str]]:
        asked: dict[CellRef, set[str]] = {}
        for stage, name in self.measured(plan):
            for ref, _ in self.cells_of(plan, stage):
                asked.setdefault(ref, set()).add(name)
                linear = in_front(plan, ref, name)
                if linear:
                    asked.setdefault(linear[0], set()).add(linear[1])
        return asked

    def cells_of(self, plan: Plan, stage: str) -> list[tuple[CellRef, AxisValues]]:
        """Return the cells of a stage at the places, each once, with their axis values."""
        axes = [plan.axis(dim) for dim in plan.node(stage).axes]
        found: dict[CellRef, DocumentView] = {}
        for place in self.places:
            at = plan.everywhere({axis.dim: axis.values.index(place[axis.dim]) for axis in plan.axes})
            ref = (stage, tuple(at[axis.dim] for axis in axes))
            found.setdefault(ref, {axis.key: axis.values[at[axis.dim]] for axis in axes})
        return list(found.items())

    def errors(
        self,
        tolerance: float | None = None,
        settings: Mapping[tuple[str, str, str], Any] = {},
        computed: frozenset[str] = frozenset(),
        precision: str | None = None,
    ) -> MeasuredErrors:
        """Return the global errors of the plan, or of a plan with another local tolerance, with given knobs, or with
        some stages computed instead of left out.
        """
        pipeline = with_settings(self.pipeline, settings)
        pipeline = replace(
            pipeline,
            tolerance=pipeline.tolerance if tolerance is None else tolerance,
            precision=precision or pipeline.precision,
        )
        before = self.seconds
        plan = self.plan(pipeline, computed)
        return self.compared(plan, self.run(plan), before)

    def compared(self, plan: Plan, found: Collected, before: float = 0.0) -> MeasuredErrors:
        """Compare a run of this plan with the reference."""
        errors, truth, coarser = {}, self.truth, self.coarser
        unknown = behind(
            plan, (node.name for node in plan.nodes if any(has_no_mean(a.kind) for a in node.alternatives))
        )
        shown = shown_names(plan)
        for stage, name in self.measured(plan):
            own = self._error(plan, stage, name, found, truth, coarser)
            if stage in unknown:
                who = ", ".join(
                    n.name for n in plan.nodes if n.name in unknown and any(has_no_mean(a.kind) for a in n.alternatives)
                )
                why = f"{who} draws or rounds, and states no mean"
                own = GlobalError(None, None, own.scale, "unknown", own.at, None, why)
            errors[shown.get((stage, name), f"{stage}.{name}")] = own
        return MeasuredErrors(errors, len(self.places), self.seconds - before)

    def unknown(self, plan: Plan, why: str) -> MeasuredErrors:
        """Return the errors of a plan that is not measured: all unknown, with the reason."""
        unknown = GlobalError(None, None, None, "unknown", why=why, below=float("inf"))
        return MeasuredErrors(dict.fromkeys(shown_names(plan).values(), unknown), len(self.places), 0.0)

    def _error(
        self, plan: Plan, stage: str, name: str, found: Collected, truth: Collected, coarser: Any
    ) -> GlobalError:
        """Return the error of the worst cell of one variable."""
        worst: tuple[Difference, CellRef, AxisValues] | None = None
        doubt = self.own_error_behind(stage)
        for ref, at in self.cells_of(plan, stage):
            own = _difference(plan, found, self.exact, truth, ref, name)
            if own.relative is None:
                return GlobalError(None, None, None, "unknown", at, None, own.why)
            if coarser is not None:
                other = _difference(coarser[0], coarser[1], self.exact, truth, ref, name)
                doubt = max(doubt, float("inf") if other.relative is None else other.relative)
            if worst is None or own.relative > (worst[0].relative or 0.0):
                worst = own, ref, at
        assert worst is not None
        rms, largest = worst[0].relative, worst[0].largest_relative
        how = "measured" if doubt <= 0.1 * max(plan.pipeline.tolerance, rms or 0.0) else f"unknown below {doubt:.1g}"
        linear = in_front(plan, worst[1], name)
        beside = _difference(plan, found, self.exact, truth, *linear) if linear else None
        return GlobalError(
            rms,
            largest,
            worst[0].scale,
            how,
            worst[2],
            (beside.relative, beside.largest_relative) if beside else None,
            below=doubt,
        )

    def own_error_behind(self, stage: str) -> float:
        """Return the largest error that earlier stages state in the reference because their finer settings are
        ``dear``: the possible error of the reference itself.
        """
        plan, found = self.exact, 0.0
        for node in plan.nodes:
            dear = any(p.dear for one in node.alternatives for p, _, _ in parameters_of(one.kind).values())
            if dear and stage in behind(plan, [node.name]):
                own = [cell.error[0] or 0.0 for cell in plan.of(node.name) if not cell.left_out]
                found = max([found, *own])
        return found

    def remembered(self, archive: Path) -> MeasuredErrors:
        """Return the errors as planned, taken from the cache of an archive if the same cells were measured before."""
        key = self.key()
        known = from_document(recall(archive, key) or {})
        if known is not None:
            return known
        found = self.errors()
        remember(archive, key, finite(found.document()))
        return found

    def key(self) -> str:
        """Return the key of a measurement: it depends on the keys of all cells that are compared."""
        plans = [self.plan(self.pipeline), self.exact]
        if self.reference.coarser is not None:
            plans.append(self.plan(self.reference.coarser))
        cells = [
            [[ref[0], list(ref[1]), plan.cells[ref].key, sorted(own)] for ref, own in self.asked(plan).items()]
            for plan in plans
        ]
        words = {"form": FORM, "tolerance": self.pipeline.tolerance, "cells": cells, "precision": plans[0].precision}
        return digest(json.dumps(words, sort_keys=True).encode())


def shown_names(plan: Plan) -> dict[StageVariable, str]:
    """Return the wanted variables by name, with the stage if two stages write a variable of that name."""
    names = [name for _, name in plan.wanted]
    return {(stage, name): name if names.count(name) == 1 else f"{stage}.{name}" for stage, name in plan.wanted}


def in_front(plan: Plan, ref: CellRef, name: str) -> tuple[CellRef, str] | None:
    """Return the cell and the variable from which an encoded variable is made; None if the variable is not encoded."""
    cell = plan.cells[ref]
    if known(name).shown != "encoded" or not cell.inputs or known(cell.inputs[0][2]).shown == "encoded":
        return None
    return cell.inputs[0][1], cell.inputs[0][2]


def _difference(plan: Plan, found: Collected, exact: Plan, truth: Collected, ref: CellRef, name: str) -> Difference:
    for run in (found, truth):
        report = run.reports.get(ref)
        if report is None or report.status not in ("done", "left_out"):
            who, what = (
                "the reference" if run is truth else "the cell",
                f"{report.status}: {report.message}" if report else "was not computed",
            )
            return Difference(False, f"{who} {what}")
    if plan.cells[ref].grids[name] != exact.cells[ref].grids[name]:
        return Difference(False, "the reference has another grid")
    cell = exact.cells[ref]
    return difference(found.arrays[ref][name], truth.arrays[ref][name], exact.node(ref[0]).writes[name], cell.stage)

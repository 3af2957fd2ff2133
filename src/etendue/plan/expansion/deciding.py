"""Decide cell by cell whether it is left out and how accurately it is computed, and derive the facts of its output.

In:  a cell before its decisions (``Draft``), and the facts of its inputs.
Out: ``Decisions``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

from etendue.contract.arrays.facts import Facts
from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import Noisy, Summed, Transfer
from etendue.contract.stage import Stage, reads_of
from etendue.plan import stage_calls
from etendue.plan.expansion import leave_out
from etendue.plan.expansion.approximate import WatchedFacts, choose, open_knobs, with_settings
from etendue.plan.expansion.forms import Draft
from etendue.plan.expansion.search import Settings
from etendue.plan.identity.once import Once
from etendue.plan.model import Approximated, Cell, CellRef, LeftOut, Node
from etendue.plan.wiring.graph import Graph
from etendue.plan.wiring.request import Choice
from etendue.transfer import effects


class Decisions(NamedTuple):
    """The decisions of the planner for one cell."""

    stage: Stage
    left_out: LeftOut | None
    approximated: tuple[Approximated, ...]
    error: tuple[float | None, str]
    facts: Facts
    blind: bool  # whether the facts of the inputs affect nothing but the facts


NOT_ASKED: tuple[float | None, str] = (None, "unknown")
StageAt = Callable[[Node, int, Mapping[str, int]], Stage]  # the stage of an alternative at a combination of the axes


class Decider:
    """Makes the decisions. ``cells``: the cells planned so far, which include all inputs of the next cell."""

    def __init__(
        self, graph: Graph, choice: Choice, cells: Mapping[CellRef, Cell], stage_at: StageAt, precision: str
    ) -> None:
        self.nodes, self.choice, self.cells, self.stage_at = graph.nodes, choice, cells, stage_at
        self.precision = precision
        self.rule = leave_out.LeaveOutRule(choice.tolerance if choice.leave_out else None, choice.norm)
        # stages that add noise, the axes that change each, and whether it waits for a value that a run finds
        self.noisy = [
            (node, {dim for dim in (node.use_axis, *(dim for dim, _ in node.direct)) if dim}, bool(node.found))
            for node in graph.nodes
            if all(issubclass(one.kind, Noisy) for one in node.alternatives)
        ]
        self.chosen: dict[Any, Any] = {}  # stages with their knobs set, by what the choice depended on
        self.tried: Once[tuple[Stage | None]] = Once()  # stages with settings of their knobs
        self.stated: Once[tuple[float | None, str]] = Once()  # errors that stages state without reading facts
        # knobs that the file leaves open, by node and alternative
        self.knobs: dict[tuple[str, int], tuple[str, ...]] = {}
        # Without leaving out, the plan must not approximate either.
        for node in graph.nodes if choice.leave_out else ():
            for number, one in enumerate(node.alternatives if not node.is_source else ()):
                written = {*one.written, *(name for _, name in node.direct)}
                self.knobs[node.name, number] = open_knobs(one.kind, written)

    def decide(
        self, draft: Draft, facts_in: Mapping[str, Facts], by_dim: Mapping[str, int], declared: Facts | None
    ) -> Decisions:
        """Decide a cell from the facts of its inputs; ``declared`` are the facts that a source states about its own
        output.
        """
        node, stage, form, watched = draft.node, draft.stage, draft.form, WatchedFacts(facts_in)
        facts = stage_calls.carried(stage, facts_in, form.input_grids) if declared is None else declared
        left_out = None
        approximated: tuple[Approximated, ...] = ()
        decided = self.choice.decided
        earlier = decided.get((node.name, tuple(by_dim[dim] for dim in node.axes))) if decided else None
        if earlier is not None:
            left_out, approximated = earlier.left_out, earlier.approximated
            if leave_out.through(stage, form.whole_grids, form.grids) is None:
                left_out = None
            stage = with_settings(stage, {one.knob: one.value for one in approximated}) or stage
        elif node.name not in self.choice.computed:
            noises = partial(self.noises, by_dim)
            left_out = leave_out.decide(self.rule, stage, watched, form.whole_grids, form.grids, noises)
        # Leaving out comes first: it is cheaper than any setting, and a cell left out needs no setting.
        if not left_out and self.knobs.get((node.name, draft.number)):
            stage, approximated = self.approximate(draft, watched)
        error = self.error(draft, stage, watched) if self.choice.stored else NOT_ASKED
        if self.choice.stored:
            facts = behind(stage, facts_in, form.input_grids, facts)
        if left_out:
            # A cell that is left out passes its input on, so the facts of that input hold for its output.
            main = next(iter(node.writes))
            facts = next((self.cells[ref].facts for _, ref, v in draft.inputs if v == main), facts)
        return Decisions(stage, left_out, approximated, error, facts, not (watched.looked or left_out))

    def noises(self, by_dim: Mapping[str, int]) -> list[Noisy] | None:
        """Return every stage that adds noise, with its parameters at a combination of axis values; None if the
        parameters of one of these stages are found only during the run, or depend on an axis that is not in this
        combination.
        """
        found: list[Noisy] = []
        for node, dims, awaits in self.noisy:
            if awaits or not dims <= by_dim.keys():
                return None
            stage = self.stage_at(node, by_dim[node.use_axis] if node.use_axis else 0, by_dim)
            assert isinstance(stage, Noisy)
            found.append(stage)
        return found

    def approximate(self, draft: Draft, facts: Mapping[str, Facts]) -> tuple[Stage, tuple[Approximated, ...]]:
        """Return a stage with its open knobs set. The choice is cached, because many cells have equal stages and equal
        facts.
        """
        # Most stages state errors without reading facts. Such a choice is valid for any facts, so facts are not in its
        # key.
        place = (draft.stage, self.before(draft), tuple(draft.form.input_grids.items()))
        known = self.chosen.get(place)
        if known is None:
            whole = (*place, tuple(facts.items()))
            known = self.chosen.get(whole)
        if known is None:
            seen, knobs = WatchedFacts(facts), self.knobs[draft.node.name, draft.number]
            stage, set_ = choose(
                draft.stage, knobs, self.choice.tolerance, lambda one: self.error(draft, one, seen), self.with_settings
            )
            # One object for all cells with equal stages: later caches compare stages by identity.
            known = (self.chosen.setdefault(stage, stage), set_)
            self.chosen[whole if seen.looked else place] = known
        return known

    def with_settings(self, stage: Stage, settings: Settings) -> Stage | None:
        """Return a stage with other settings (``with_settings``), cached because many cells request the same."""
        place = (stage,), *settings.items()
        known = self.tried.get(*place)
        if known is None:
            self.tried.put(known := (with_settings(stage, settings),), *place)
        return known[0]

    def error(self, draft: Draft, stage: Stage, facts: Mapping[str, Facts]) -> tuple[float | None, str]:
        """Return the error that ``stage`` states if it replaces the stage of the draft, and its basis."""
        node, grids = draft.node, draft.form.input_grids
        if not node.segment or not isinstance(stage, Summed):
            known = self.stated.get((stage, draft.form))
            if known is not None:
                return known
            seen = facts if isinstance(facts, WatchedFacts) else WatchedFacts(facts)
            looked, seen.looked = seen.looked, False
            found = stage_calls.error_of(stage, "error", seen, grids, self.precision)
            alike = not seen.looked
            seen.looked |= looked
            return self.stated((stage, draft.form), lambda: found) if alike else found
        # A stage that sums over bands ends a segment: its error depends on the light that enters the segment.
        port, before, _ = draft.inputs[0]
        source, _ = segment_input(self.cells, draft) or (before, "")
        facts = {**facts, port: replace(facts[port], content=self.cells[source].facts.content)}
        return stage_calls.error_of(stage, "segment_error", self.before(draft), facts, grids, self.precision)

    def before(self, draft: Draft) -> tuple[Stage, ...]:
        """Return the stages between the input of a segment and this one that are not left out, in light order."""
        found: list[Stage] = []
        at = draft.inputs
        for _ in range(len(draft.node.segment) - 1):
            cell = self.cells[at[0][1]]
            if cell.left_out is None:
                found.append(cell.stage)
            at = cell.inputs
        return tuple(reversed(found))


def segment_input(cells: Mapping[CellRef, Cell], draft: Draft) -> tuple[CellRef, str] | None:
    """Return the cell and variable from which the segment of a transfer stage starts; None for other stages."""
    if not draft.node.segment:
        return None
    _, source, variable = draft.inputs[0]
    return cells[source].segment_input if len(draft.node.segment) > 1 else (source, variable)


def behind(stage: Stage, facts_in: Mapping[str, Facts], grids_in: Mapping[str, Grid], own: Facts) -> Facts:
    """Return the facts after a transfer function: the facts stated by the stage, with the detail that remains after the
    blur and a bound on the range of the light.
    """
    if not isinstance(stage, Transfer) or isinstance(stage, Summed):
        return own
    (port,) = reads_of(type(stage))
    content = facts_in[port].content
    if content is None:
        return own
    try:
        left = effects.behind(stage, grids_in[port].bands().edges, content)
    except ValueError:  # the stage refuses its values, which is reported where it is made
        return own
    low, high = content.range_of_light()
    return replace(
        own, content=left, low=low if own.low is None else own.low, high=high if own.high is None else own.high
    )

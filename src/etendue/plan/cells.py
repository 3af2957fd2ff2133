"""Nodes and axes to cells: parameters, grids, facts, what is left out, keys and seeds of every cell.

In:  a checked ``Graph`` and a pipeline.
Out: cells by reference, in an order in which every cell stands behind what it reads.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from etendue.contract.bounds import MOST_CELLS, beyond, number
from etendue.contract.capabilities import Noisy, Probe, Source, Summed, Transfer
from etendue.contract.facts import UNKNOWN, Facts
from etendue.contract.found import Found
from etendue.contract.grid import Grid
from etendue.contract.stage import Stage, looks_at_stages, parameters_of, quantities_of, reads_of, writes_of
from etendue.errors import Fault, MachineError, PluginError, RequestError
from etendue.pipeline.file import Pipeline
from etendue.plan import asking, leave_out, scenes
from etendue.plan.approximate import Seen, choose, open_knobs
from etendue.plan.forms import Form, output_grid
from etendue.plan.graph import Graph
from etendue.plan.machine import available_memory
from etendue.plan.model import Alternative, Approximated, Cell, CellRef, LeftOut, Node
from etendue.plan.quantities import to_be_found
from etendue.plan.readings import Reading, reading_of
from etendue.plan.recipes import Recipes
from etendue.telling import human_bytes, plain
from etendue.transfer import effects

BYTES_OF_A_CELL = 1300  # of a plan, in memory: benchmarks/scale.py


@dataclass(frozen=True)
class Choice:
    """How the planner was asked to decide."""

    tolerance: float
    leave_out: bool  # whether anything may be left out or approximated
    precision: str  # auto, float32 or float64
    norm: str = "rms"
    expected: bool = False  # means in the place of draws and rounding
    versions: Mapping[str, str] = field(
        default_factory=dict
    )  # of libraries, in keys, in the place of those that are installed
    computed: frozenset[str] = frozenset()  # stages that are not left out, whatever their bound


Told = Callable[[int, int], None]  # how many cells are planned, of how many


def expand(
    graph: Graph, pipeline: Pipeline, choice: Choice, told: Told = lambda done, total: None
) -> tuple[dict[CellRef, Cell], str, float]:
    """All cells, the precision they are computed in, and the seconds that looking at new scenes took."""
    expansion = _Expansion(graph, pipeline, choice, told)
    return expansion.expand(), expansion.precision, expansion.looked


class Decisions(NamedTuple):
    """Of a cell."""

    stage: Stage
    left_out: LeftOut | None
    approximated: tuple[Approximated, ...]
    error: tuple[float | None, str]
    facts: Facts


class _Expansion:
    def __init__(self, graph: Graph, pipeline: Pipeline, choice: Choice, told: Told) -> None:
        self.told = told
        self.graph = graph
        self.pipeline = pipeline
        self.choice = choice
        self.nodes = {node.name: node for node in graph.nodes}
        self.axes = {axis.dim: axis for axis in graph.axes}
        self.cells: dict[CellRef, Cell] = {}
        self.stages: dict[tuple[str, tuple[Any, ...]], Stage] = {}
        self.described: dict[Stage, tuple[Facts, Mapping[str, Grid]]] = {}
        self.readings: dict[tuple[str, int], Reading] = {}
        self.forms: dict[tuple[Any, ...], Form] = {}
        self.decisions: dict[
            tuple[Any, ...], Decisions
        ] = {}  # of cells of one stage and form that read what nothing is known of
        self.grids: dict[Grid, Grid] = {}
        self.recipes = Recipes(self.cells, self.nodes, pipeline.seed, choice.expected, choice.versions)
        self.chosen: dict[Any, Any] = {}  # stages with their knobs set, by what they were chosen from
        self.faults: dict[str, Fault] = {}
        self.rule = leave_out.Rule(choice.tolerance if choice.leave_out else None, choice.norm)
        self.looked = 0.0  # seconds of looking at scenes that were never seen before
        every = [(node, number, one) for node in graph.nodes for number, one in enumerate(node.alternatives)]
        self.knobs = {(node.name, number): self.open_knobs(node, one) for node, number, one in every}

    def reading(self, node: Node, number: int) -> Reading:
        known = self.readings.get((node.name, number))
        if known is None:
            known = self.readings[node.name, number] = reading_of(node, number, self.nodes)
        return known

    def stage_at(self, node: Node, number: int, index: Mapping[str, int], found: tuple[Found, ...] = ()) -> Stage:
        """The stage of an alternative at a combination, with what stands for the quantities that a run finds."""
        key = (node.name, (number, *(index[dim] for dim, _ in node.direct), *found))
        known = self.stages.get(key)
        if known:
            return known
        one = node.alternatives[number]
        values = dict(one.values)
        for name, (parameter, _, _) in parameters_of(one.kind).items():
            if parameter.shared:
                values[name] = self.graph.shared[name]
        for dim, name in node.direct:
            if name in values:
                values[name] = self.axes[dim].value(name, index[dim])
        values.update({one.name: one for one in found})
        try:
            stage = asking.made(one.kind, values)
        except (ValueError, PluginError) as error:
            raise RequestError([Fault(node.place, f"{one.use}: {plain(str(error))}")], self.pipeline.file) from None
        self.stages[key] = stage
        return stage

    def found(self, one: Alternative, inputs: Any) -> tuple[Found, ...]:
        """What stands for the quantities that earlier cells write: between the ends which those know of what they
        write first.
        """
        quantities = quantities_of(one.kind)
        stand = []
        for name, ref, variable in inputs:
            if name in quantities:
                facts = self.cells[ref].facts if next(iter(self.nodes[ref[0]].writes)) == variable else UNKNOWN
                stand.append(to_be_found(name, quantities[name], (facts.low, facts.high)))
        return tuple(stand)

    def expand(self) -> dict[CellRef, Cell]:
        total = self.count()
        self.precision = self.choose_precision()
        places: dict[tuple[str, ...], list[tuple[int, ...]]] = {}  # by axes: each once, for all stages that they reach
        for node in self.graph.nodes:
            if node.axes not in places:
                places[node.axes] = list(itertools.product(*(range(len(self.axes[dim].values)) for dim in node.axes)))
            for index in places[node.axes]:
                self.add(node, index)
                if not len(self.cells) % 500:
                    self.told(len(self.cells), total)
            if self.faults:
                raise RequestError(list(self.faults.values())[:12], self.pipeline.file)
        return self.cells

    def count(self) -> int:
        """The cells there will be, refused where they are too many: before the first of them is made."""
        counts = {node.name: math.prod(len(self.axes[dim].values) for dim in node.axes) for node in self.graph.nodes}
        total = sum(counts.values())
        if total > self.pipeline.most_cells:
            largest = max(self.graph.nodes, key=lambda node: counts[node.name])
            product = " x ".join(f"{self.axes[dim].key} {len(self.axes[dim].values)}" for dim in largest.axes)
            text = beyond(total, "cells", self.pipeline.most_cells, f"{largest.name} alone has {product}")
            hint = (
                f"; shorten an axis, ask for less with 'wanted', or set most_cells = {total}"
                if total < 1e9
                else "; shorten an axis"
            )
            raise RequestError([Fault("sweep", text + hint)], self.pipeline.file)
        free = available_memory()
        if total > MOST_CELLS and free and BYTES_OF_A_CELL * total > free:
            longest = max(self.axes.values(), key=lambda axis: len(axis.values))
            need = (
                f"a plan of {number(total)} cells takes about {human_bytes(BYTES_OF_A_CELL * total)}, "
                f"{human_bytes(free)} are free"
            )
            raise MachineError(
                f"{need}; shorten the axis {longest.key}, which has {len(longest.values)} values, or ask for less with "
                f"'wanted'"
            )
        return total

    def choose_precision(self) -> str:
        """float32 only where a float32 FFT keeps the darkest values of every scene right (error 2e-7 of the range)."""
        if self.choice.precision != "auto":
            return self.choice.precision
        for node in self.graph.nodes:
            if not node.is_source:
                continue
            for position in range(len(node.alternatives)):
                index = {dim: 0 for dim in self.axes}
                if node.use_axis:
                    index[node.use_axis] = position
                dims = list(dict.fromkeys(dim for dim, _ in node.direct))
                for combination in itertools.product(*(range(len(self.axes[dim].values)) for dim in dims)):
                    index.update(zip(dims, combination, strict=True))
                    facts, _ = self.describe(node, self.stage_at(node, position, index))
                    if facts.contrast is None or 2e-7 * facts.contrast > self.choice.tolerance:
                        return "float64"
        return "float32"

    def describe(self, node: Node, stage: Stage) -> tuple[Facts, Mapping[str, Grid]]:
        if stage not in self.described:
            try:
                self.described[stage] = self.seen_before(stage, *asking.described(stage))
            except PluginError as error:
                raise RequestError([Fault(node.place, self.by_whom(node, stage, error))], self.pipeline.file) from None
            except (ValueError, OSError, RequestError) as error:
                raise RequestError([Fault(node.place, plain(str(error)))], self.pipeline.file) from None
        return self.described[stage]

    def seen_before(self, stage: Stage, facts: Facts, grids: Mapping[str, Grid]) -> tuple[Facts, Mapping[str, Grid]]:
        """What a scene says of itself, and what its light holds, where anything may be left out for it."""
        assert isinstance(stage, Source)
        if not self.choice.leave_out or facts.content is not None:
            return facts, grids
        light = {name: grid for name, grid in grids.items() if name == scenes.light_of(type(stage))}
        if not light:
            return facts, grids
        found, seconds = scenes.content_of(stage, grids)
        self.looked += seconds
        if found is None:
            return facts, grids
        low, high = found.range_of_light()
        return replace(facts, content=found, uniform=facts.uniform or found.detail == 0, low=low, high=high), grids

    def add(self, node: Node, index: tuple[int, ...]) -> None:
        cells, by_dim = self.cells, dict(zip(node.axes, index, strict=True))
        number = by_dim[node.use_axis] if node.use_axis else 0
        one, reading = node.alternatives[number], self.reading(node, number)
        inputs = tuple(
            [(port, cells[source, at(index)].ref, variable) for port, source, variable, at in reading.inputs]
        )
        stage = self.stage_at(node, number, by_dim, self.found(one, inputs) if reading.quantities else ())
        looks_at = tuple(
            [(port, tuple([cells[name, at(index)].ref for name, at in seen])) for port, seen in reading.looks_at]
        )
        input_facts = {p: self.cells[ref].facts for p, ref, _ in inputs if p in reading.ports}
        try:
            form = self.form(node, number, stage, inputs)
            input_grids, grids = form.input_grids, form.grids
            like = (
                (node.name, id(stage), id(form))
                if reading.alike and all(f is UNKNOWN for f in input_facts.values())
                else None
            )
            decisions = self.decisions.get(like) if like else None
            if decisions is None:
                decisions = self.decide(node, number, stage, inputs, input_facts, form, by_dim)
                if like:
                    self.decisions[like] = decisions
            stage, decided, approximated, error_bound, facts = decisions
            seed, open_words = self.recipes.seed(node, stage, inputs, looks_at)
        except PluginError as error:
            self.faults.setdefault(str(error), Fault(node.place, self.by_whom(node, stage, error)))
            return
        except (ValueError, RequestError) as error:
            where = ", ".join(f"{d} = {self.axes[d].values[i]}" for d, i in by_dim.items())
            text = "; ".join(f.message for f in error.faults) if isinstance(error, RequestError) else plain(str(error))
            self.faults.setdefault(node.name, Fault(f"{node.place}{f' at {where}' if where else ''}", text))
            return
        versions, key = self.recipes.key(
            node, stage, one, inputs, looks_at, decided, form, seed, open_words, self.precision
        )
        cell = Cell(
            ref=(node.name, index),
            stage=stage,
            use=one.use,
            inputs=inputs,
            looks_at=looks_at,
            key=key,
            versions=versions,
            seed=seed,
            open_words=open_words,
            input_grids=input_grids,
            grids=grids,
            facts=facts,
            left_out=decided,
            approximated=approximated,
            error=error_bound,
            segment_input=self.segment_input(node, inputs),
            mapped=form.mapped,
        )
        self.cells[cell.ref] = cell

    @staticmethod
    def by_whom(node: Node, stage: Stage, error: PluginError) -> str:
        """A fault of a plugin, and which distribution it is of."""
        one = next((a for a in node.alternatives if a.kind is type(stage)), node.alternatives[0])
        return f"{one.use} of {one.distribution} {one.version}: {error}"

    def form(self, node: Node, number: int, stage: Stage, inputs: Any) -> Form:
        """The grids of a cell, found once for all cells of the node that read the same ones (and of one stage, where
        it makes grids).
        """
        ports, own = reads_of(node.alternatives[number].kind), node.is_source or type(stage).grid is not Stage.grid
        whole = {p: self.cells[ref].grids[v] for p, ref, v in inputs}
        place = (node.name, number, stage if own else None, *map(id, whole.values()))
        known = self.forms.get(place)
        if known is not None:
            return known
        input_grids = {p: grid.take(ports[p].dims) if node.mapped else grid for p, grid in whole.items() if p in ports}
        mapped = tuple((dim, next(g[dim] for g in whole.values() if dim in g)) for dim in node.mapped)
        if node.is_source:
            declared, seen = self.describe(node, stage)[1], self.seen(node)
        else:
            declared, seen = asking.grids_of(stage, input_grids), self.seen(node)
        if mapped:
            declared = {
                d.variable: declared.get(d.variable, Grid()).replace(**dict(mapped))
                for d in writes_of(type(stage)).values()
            }
        writes = {**node.writes, **node.optional}
        grids = {v: output_grid(stage, d, declared.get(v), input_grids, seen) for v, d in writes.items()}
        grids = {
            v: self.grids.setdefault(grid, grid) for v, grid in grids.items()
        }  # one of equal ones: told apart by identity
        found = self.forms[place] = Form(whole, input_grids, grids, mapped)
        return found

    def decide(
        self,
        node: Node,
        number: int,
        stage: Stage,
        inputs: Any,
        facts_in: Mapping[str, Facts],
        form: Form,
        by_dim: Mapping[str, int],
    ) -> Decisions:
        """What a scene's facts decide of a cell, and what is known behind it."""
        grids_in = form.input_grids
        facts = self.describe(node, stage)[0] if node.is_source else asking.carried(stage, facts_in, grids_in)
        left_out = None
        if node.name not in self.choice.computed:
            left_out = leave_out.decide(
                self.rule, stage, facts_in, form.whole_grids, form.grids, lambda: self.noises(by_dim)
            )
        approximated: tuple[Approximated, ...] = ()
        if not left_out and self.knobs[node.name, number]:
            stage, approximated = self.approximate(node, number, stage, inputs, facts_in, grids_in)
        error = self.error(node, stage, inputs, facts_in, grids_in)
        facts = self.behind(stage, facts_in, grids_in, facts)
        if left_out:
            main = next(iter(node.writes))
            facts = next((self.cells[ref].facts for _, ref, v in inputs if v == main), facts)
        return Decisions(stage, left_out, approximated, error, facts)

    def noises(self, by_dim: Mapping[str, int]) -> list[Noisy] | None:
        """Every stage that adds noise, as it is at a combination; None where one of them is not known before the
        run.
        """
        found: list[Noisy] = []
        for node in self.graph.nodes:
            if not all(issubclass(one.kind, Noisy) for one in node.alternatives):
                continue
            if (
                node.found
                or (node.use_axis and node.use_axis not in by_dim)
                or any(dim not in by_dim for dim, _ in node.direct)
            ):
                return None
            stage = self.stage_at(node, by_dim[node.use_axis] if node.use_axis else 0, by_dim)
            assert isinstance(stage, Noisy)
            found.append(stage)
        return found

    def open_knobs(self, node: Node, one: Alternative) -> tuple[str, ...]:
        """The knobs of an alternative that the file leaves open: none where nothing may be approximated."""
        if not self.choice.leave_out or node.is_source:
            return ()
        return open_knobs(one.kind, {*one.written, *(name for _, name in node.direct)})

    def approximate(
        self, node: Node, number: int, stage: Stage, inputs: Any, facts: Any, grids: Any
    ) -> tuple[Stage, tuple[Approximated, ...]]:
        """A stage with its open knobs set, found once for cells of equal stage and equal facts."""
        place = (stage, self.before(node, inputs), tuple(grids.items()))
        known = self.chosen.get(place)
        if known is None:
            key = (*place, tuple(facts.items()))
            known = self.chosen.get(key)
        if known is None:
            seen = Seen(facts)
            knobs = self.knobs[node.name, number]
            known = choose(stage, knobs, self.choice.tolerance, lambda one: self.error(node, one, inputs, seen, grids))
            known = (self.chosen.setdefault(known[0], known[0]), known[1])  # one stage for cells of equal choice
            self.chosen[key if seen.looked else place] = known
        return known

    def behind(self, stage: Stage, facts_in: Mapping[str, Facts], grids_in: Mapping[str, Grid], own: Facts) -> Facts:
        """What is known behind a transfer function beside what the stage says: less detail, and nearly the range
        there was.
        """
        if not isinstance(stage, Transfer) or isinstance(stage, Summed):
            return own
        (port,) = reads_of(type(stage))
        content = facts_in[port].content
        if content is None:
            return own
        try:
            left = effects.behind(stage, grids_in[port].bands().edges, content)
        except ValueError:  # it refuses, and says why in its own place
            return own
        low, high = content.range_of_light()
        return replace(
            own, content=left, low=low if own.low is None else own.low, high=high if own.high is None else own.high
        )

    def seen(self, node: Node) -> tuple[tuple[str, tuple[tuple[str, Any], ...]], ...]:
        """Every stage that a node looks at through any port, in the order of the pipeline."""
        beside = node.kind.beside if issubclass(node.kind, Probe) else ()
        found = [(what, name) for port, what, own in node.looks_at for name in own if port not in beside]
        names = {
            name
            for what, name in found
            if not looks_at_stages(what) or (what == "transfer" and self.nodes[name].is_transfer)
        }
        return (("", tuple((name, ()) for name in self.nodes if name in names)),) if node.looks_at else ()

    def segment_input(self, node: Node, inputs: Any) -> tuple[CellRef, str] | None:
        """What the segment of a transfer stage starts from."""
        if not node.segment:
            return None
        _, source, variable = inputs[0]
        return self.cells[source].segment_input if len(node.segment) > 1 else (source, variable)

    def error(self, node: Node, stage: Stage, inputs: Any, facts: Any, grids: Any) -> tuple[float | None, str]:
        if node.segment and isinstance(stage, Summed):
            source, _ = self.segment_input(node, inputs) or (inputs[0][1], "")
            facts = {**facts, inputs[0][0]: replace(facts[inputs[0][0]], content=self.cells[source].facts.content)}
            return asking.error_of(stage, "segment_error", self.before(node, inputs), facts, grids, self.precision)
        return asking.error_of(stage, "error", facts, grids, self.precision)

    def before(self, node: Node, inputs: Any) -> tuple[Stage, ...]:
        """The stages in force between the input of a segment and one of its stages, in the order of the light."""
        found: list[Stage] = []
        cell = self.cells[inputs[0][1]] if node.segment else None
        for _ in range(len(node.segment) - 1):
            assert cell is not None
            if cell.left_out is None:
                found.append(cell.stage)
            cell = self.cells[cell.inputs[0][1]]
        return tuple(reversed(found))

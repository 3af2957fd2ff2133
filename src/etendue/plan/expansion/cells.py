"""Expand nodes and axes to cells: find parameters, grids, facts, omissions, keys and seeds of every cell.

In:  a checked ``Graph`` and a pipeline.
Out: cells by reference; every cell comes after the cells it reads.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from etendue.contract.arrays.facts import UNKNOWN, Facts
from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import Probe, Source
from etendue.contract.stage import Stage, looks_at_stages, parameters_of, quantities_of, reads_of, writes_of
from etendue.contract.values.bounds import MOST_CELLS, beyond, number
from etendue.contract.values.late_bound import LateValue
from etendue.errors import Fault, MachineError, PluginError, RequestError
from etendue.pipeline.file import PipelineFile
from etendue.plan import stage_calls
from etendue.plan.designs.bundles import position_maps
from etendue.plan.expansion import scenes
from etendue.plan.expansion.deciding import Decider
from etendue.plan.expansion.digits import Digits
from etendue.plan.expansion.earlier import nearest_of
from etendue.plan.expansion.forms import CellGrids, output_grid
from etendue.plan.expansion.growth import state_growth
from etendue.plan.expansion.recipes import Recipes
from etendue.plan.expansion.settling import Settling
from etendue.plan.machine import available_memory
from etendue.plan.model import Alternative, Cell, CellRef, Node
from etendue.plan.wiring.graph import Graph
from etendue.plan.wiring.quantities import to_be_found
from etendue.plan.wiring.readings import reading_of
from etendue.plan.wiring.request import Choice
from etendue.telling import human_bytes, plain

BYTES_OF_A_CELL = 400  # bytes of memory per cell of a plan, measured by benchmarks/scale.py


Told = Callable[[int, int], None]  # called with the cells planned so far and the total


def expand(
    graph: Graph, pipeline: PipelineFile, choice: Choice, told: Told = lambda done, total: None
) -> tuple[dict[CellRef, Cell], str, float]:
    """Return all cells, the precision in which they are computed, and the seconds spent on the analysis of scenes that
    were not in the cache.
    """
    expansion = Expansion(graph, pipeline, choice, told)
    cells = expansion.expand()
    if choice.leave_out:
        state_growth(cells)
    return cells, expansion.precision, expansion.looked


class Expansion:
    def __init__(self, graph: Graph, pipeline: PipelineFile, choice: Choice, told: Told) -> None:
        self.told = told
        self.graph = graph
        self.pipeline = pipeline
        self.choice = choice
        self.nodes = {node.name: node for node in graph.nodes}
        self.axes = {**{axis.dim: axis for axis in graph.factors}, **graph.positioned}
        self.maps = position_maps(graph.positioned)
        self.cells: dict[CellRef, Cell] = {}
        self.stages: dict[tuple[str, tuple[Hashable, ...]], Stage] = {}
        self.described: dict[Stage, tuple[Facts, Mapping[str, Grid]]] = {}
        numbered = [(node, number) for node in graph.nodes for number in range(len(node.alternatives))]
        self.readings = {
            (node.name, number): reading_of(node, number, self.nodes, self.maps) for node, number in numbered
        }
        # positions by axes, shared by all nodes with the same axes; cells by node, in this order
        self.places: dict[tuple[str, ...], list[tuple[int, ...]]] = {}
        self.by_node: dict[str, list[Cell]] = {}
        self.wheres: dict[tuple[str, ...], dict[str, tuple[int, tuple[int, ...] | None]]] = {}
        self.between: dict[tuple[tuple[str, ...], tuple[str, ...]], list[int]] = {}
        self.forms: dict[Hashable, CellGrids] = {}
        self.grids: dict[Grid, Grid] = {}
        self.recipes = Recipes(self.cells, self.nodes, pipeline.seed, choice.expected, choice.versions, choice.stored)
        self.faults: dict[str, Fault] = {}
        self.looked = 0.0  # seconds spent on scenes whose content was not in the cache
        self.earlier = nearest_of(choice.earlier, graph, pipeline, choice)

    def stage_at(self, node: Node, number: int, index: Mapping[str, int], found: tuple[LateValue, ...] = ()) -> Stage:
        """Return the stage of an alternative at a combination, with placeholders for quantities found by the run."""
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
            stage = stage_calls.made(one.kind, values)
        except (ValueError, PluginError) as error:
            raise RequestError([Fault(node.place, f"{one.use}: {plain(str(error))}")], self.pipeline.file) from None
        self.stages[key] = stage
        return stage

    def found(self, one: Alternative, inputs: Sequence[tuple[str, CellRef, str]]) -> tuple[LateValue, ...]:
        """Return placeholders for the quantities that earlier cells write, with the range stated by the writing cell if
        the quantity is the first variable it writes (facts describe only the first).
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
        if self.earlier is not None:
            self.grids |= self.earlier.begin(self.precision)
        self.digits = Digits(self.cells, self.nodes, self.choice.digits, self.precision)
        self.decider = Decider(self.graph, self.choice, self.cells, self.stage_at, self.precision)
        self.recipes.precision = self.precision
        sizes = {node.name: math.prod(len(self.axes[dim].values) for dim in node.axes) for node in self.graph.nodes}
        self.recipes.counts |= sizes
        # Nodes are in the order of the file, and a node reads only earlier ones: the cells it reads exist already.
        for node in self.graph.nodes:
            if node.axes not in self.places:
                positions = itertools.product(*(range(len(self.axes[dim].values)) for dim in node.axes))
                self.places[node.axes] = list(positions)
            self.add(node, total)
            # Report all faults of one node and then stop, because the cells that later nodes read do not exist.
            if self.faults:
                raise RequestError(list(self.faults.values())[:12], self.pipeline.file)
        return self.cells

    def count(self) -> int:
        """Return the number of cells; raise an error before the first cell is made if there are too many."""
        counts = {node.name: math.prod(len(self.axes[dim].values) for dim in node.axes) for node in self.graph.nodes}
        total = sum(counts.values())
        if total > self.pipeline.most_cells:
            largest = max(self.graph.nodes, key=lambda node: counts[node.name])
            product = " x ".join(f"{self.axes[dim].key} {len(self.axes[dim].values)}" for dim in largest.axes)
            text = beyond(total, "cells", self.pipeline.most_cells, f"{largest.name} alone has {product}")
            ways = f", request less under 'wanted', or set most_cells = {total}" if total < 1e9 else ""
            raise RequestError([Fault("sweep", f"{text}; shorten an axis{ways}")], self.pipeline.file)
        free = available_memory() if total > MOST_CELLS else 0
        if free and BYTES_OF_A_CELL * total > free:
            longest = max(self.axes.values(), key=lambda axis: len(axis.values))
            need = (
                f"a plan of {number(total)} cells takes about {human_bytes(BYTES_OF_A_CELL * total)}, "
                f"{human_bytes(free)} are free"
            )
            raise MachineError(
                f"{need}; shorten the axis {longest.key}, which has {len(longest.values)} values, or request less "
                f"under 'wanted'"
            )
        return total

    def choose_precision(self) -> str:
        """Return float32 only if its FFT error, 2e-7 of the range, is within the tolerance at the darkest values of
        every scene.
        """
        if self.choice.precision != "auto":
            return self.choice.precision
        if self.earlier is not None and self.earlier.has_sources:
            return self.earlier.precision
        for node in self.graph.nodes:
            if not node.is_source:
                continue
            for position in range(len(node.alternatives)):
                for place in itertools.product(*(range(len(self.axes[dim].values)) for dim in node.axes)):
                    index = self.by_dim(node, place)
                    if node.use_axis and index[node.use_axis] != position:
                        continue
                    facts, _ = self.describe(node, self.stage_at(node, position, index))
                    if facts.contrast is None or 2e-7 * facts.contrast > self.choice.tolerance:
                        return "float64"
        return "float32"

    def describe(self, node: Node, stage: Stage) -> tuple[Facts, Mapping[str, Grid]]:
        if stage not in self.described:
            try:
                self.described[stage] = self.seen_before(stage, *stage_calls.described(stage))
            except PluginError as error:
                raise RequestError([Fault(node.place, self.by_whom(node, stage, error))], self.pipeline.file) from None
            except (ValueError, OSError, RequestError) as error:
                raise RequestError([Fault(node.place, plain(str(error)))], self.pipeline.file) from None
        return self.described[stage]

    def seen_before(self, stage: Stage, facts: Facts, grids: Mapping[str, Grid]) -> tuple[Facts, Mapping[str, Grid]]:
        """Return the facts of a scene, with the content of its light if omissions or digits may depend on it, and its
        grids.
        """
        assert isinstance(stage, Source)
        if not (self.choice.leave_out or self.choice.digits) or facts.content is not None:
            return facts, grids
        light = {name: grid for name, grid in grids.items() if name == scenes.light_of(type(stage))}
        if not light:
            return facts, grids
        found, seconds = scenes.content_of(stage, grids)
        self.looked += seconds
        if found is None:
            return facts, grids
        low, high = found.range_of_light()
        found = replace(found, norm=self.choice.norm)
        facts = replace(facts, white=found.white or None)
        return replace(facts, content=found, uniform=facts.uniform or found.detail == 0, low=low, high=high), grids

    def add(self, node: Node, total: int) -> None:
        """Make the cells of a node."""
        earlier, cells = self.earlier, self.cells
        taken = None if earlier is None else earlier.all_of(node, self.recipes)
        own = self.by_node[node.name] = taken or []
        if taken is not None:
            cells.update((cell.ref, cell) for cell in own)
            return
        settling = Settling(self, node)
        for at, index in enumerate(self.places[node.axes]):
            cell = None if earlier is None else earlier.find(node.name, index, self.recipes)
            cell = cell or settling.cell(at, index)
            if cell is not None:  # else it has a fault
                cells[cell.ref] = cell
                own.append(cell)
                if not len(cells) % 500:
                    self.told(len(cells), total)

    def where(self, axes: tuple[str, ...]) -> Mapping[str, tuple[int, tuple[int, ...] | None]]:
        """Return, for each of these axes and each of their factors, the place in the index of a cell and, for factors,
        the map from positions on the axis to positions on the factor.
        """
        if axes in self.wheres:
            return self.wheres[axes]
        found: dict[str, tuple[int, tuple[int, ...] | None]] = {dim: (at, None) for at, dim in enumerate(axes)}
        for at, dim in enumerate(axes):
            axis = self.axes[dim]
            if axis.rows:
                columns = zip(axis.factors, zip(*axis.rows, strict=True), strict=True)
                found.update((factor.dim, (at, rows)) for factor, rows in columns)
        self.wheres[axes] = found
        return found

    def by_dim(self, node: Node, index: tuple[int, ...]) -> dict[str, int]:
        """Return the positions of a cell on its axes, and on the factors of these axes."""
        own = self.where(node.axes).items()
        return {dim: index[at] if rows is None else rows[index[at]] for dim, (at, rows) in own}

    def unfit(self, node: Node, index: tuple[int, ...], error: Exception) -> None:
        """Note the fault of a stage, at the first combination where it occurs."""
        where = ", ".join(f"{d} = {self.axes[d].values[i]}" for d, i in self.by_dim(node, index).items())
        text = "; ".join(f.message for f in error.faults) if isinstance(error, RequestError) else plain(str(error))
        self.faults.setdefault(node.name, Fault(f"{node.place}{f' at {where}' if where else ''}", text))

    def refused(self, node: Node, stage: Stage, error: PluginError) -> None:
        """Note the fault of a plugin."""
        self.faults.setdefault(str(error), Fault(node.place, self.by_whom(node, stage, error)))

    @staticmethod
    def by_whom(node: Node, stage: Stage, error: PluginError) -> str:
        """Return the text of a plugin's fault, preceded by the stage and the plugin's distribution."""
        one = next((a for a in node.alternatives if a.kind is type(stage)), node.alternatives[0])
        return f"{one.use} of {one.distribution} {one.version}: {error}"

    def form(self, node: Node, number: int, stage: Stage, inputs: Sequence[tuple[str, CellRef, str]]) -> CellGrids:
        """Return the grids of a cell. They are found once for all cells of the node that read the same grids (and have
        the same stage, if the stage makes grids of its own).
        """
        # Grids are unique per value (``self.grids``) and live as long as the plan, so their ids are a safe cache key.
        ports, own = reads_of(node.alternatives[number].kind), node.is_source or type(stage).grid is not Stage.grid
        whole = {p: self.cells[ref].grids[v] for p, ref, v in inputs}
        place = (node.name, number, stage if own else None, *map(id, whole.values()))
        known = self.forms.get(place)
        if known is not None:
            return known
        input_grids = {p: grid.take(ports[p].dims) if node.mapped else grid for p, grid in whole.items() if p in ports}
        mapped = tuple((dim, next(g[dim] for g in whole.values() if dim in g)) for dim in node.mapped)
        declared = self.describe(node, stage)[1] if node.is_source else stage_calls.grids_of(stage, input_grids)
        if mapped:
            declared = {
                d.variable: declared.get(d.variable, Grid()).replace(**dict(mapped))
                for d in writes_of(type(stage)).values()
            }
        writes = {**node.writes, **node.optional}
        seen = self.seen(node)
        grids = {v: output_grid(stage, d, declared.get(v), input_grids, seen) for v, d in writes.items()}
        # One object for equal grids: here and later, grids are told apart by identity.
        grids = {v: self.grids.setdefault(grid, grid) for v, grid in grids.items()}
        found = self.forms[place] = CellGrids(whole, input_grids, grids, mapped)
        return found

    def seen(self, node: Node) -> tuple[tuple[str, tuple[tuple[str, Any], ...]], ...]:
        """Return every stage that a node looks at through any port, in the order of the pipeline."""
        beside = node.kind.beside if issubclass(node.kind, Probe) else ()
        found = [(what, name) for port, what, own in node.looks_at for name in own if port not in beside]
        names = {
            name
            for what, name in found
            if not looks_at_stages(what) or (what == "transfer" and self.nodes[name].is_transfer)
        }
        return (("", tuple((name, ()) for name in self.nodes if name in names)),) if node.looks_at else ()

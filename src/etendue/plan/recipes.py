"""What makes a cell the same cell: its key, and the words of its random numbers.

In:  a stage at a combination of the axes, and the cells that stand before it.
Out: the fields of its key and their digest; the words that key its random numbers.
"""

from __future__ import annotations

import json
from collections.abc import Hashable, Mapping
from typing import Any

from etendue.contract.capabilities import Sampled, draws_anew, is_random
from etendue.contract.stage import Stage, looks, looks_at_stages, parameters_of, quantities_of, reads_of
from etendue.plan import asking, words
from etendue.plan.code import code_digest, libraries_of
from etendue.plan.cost import too_large
from etendue.plan.forms import Draft, Form
from etendue.plan.keys import digest, key_of, parameters_for_key, plain_text, version_of
from etendue.plan.model import Alternative, Cell, CellRef, LeftOut, Node, chains, is_whole, light_of, pixel_of, scene_of
from etendue.types.documents import Document

NONE: Mapping[str, str] = {}  # never written to; a mapping proxy could not be pickled
Lines = frozenset[str]
Head = tuple[str, Mapping[str, str], bool]  # text, versions of libraries, whether draws count
AS_TEXT = json.JSONEncoder(sort_keys=True).encode


class Recipes:
    """``cells`` are those planned so far; ``expected``: means in the place of draws and rounding. ``versions`` of
    libraries stand in the place of those that are installed."""

    def __init__(
        self,
        cells: Mapping[CellRef, Cell],
        nodes: Mapping[str, Node],
        seed: int,
        expected: bool,
        versions: Mapping[str, str],
    ) -> None:
        self.cells, self.nodes, self.pipeline_seed, self.expected = cells, nodes, seed, expected
        self.stated = versions
        self.words: dict[tuple[str, int], tuple[str, ...]] = {}
        # Of the parameters of a stage, by its identity: hashing a stage costs as much again. Whoever plans holds it: no
        # other takes its number.
        self.digests: dict[int, str] = {}
        self.heads: dict[Hashable, Head] = {}
        self.forms: dict[Form, str] = {}  # what counts of grids
        self.looked: dict[Hashable, str] = {}  # of transfer functions that are looked at: the same by many cells
        self.versions: dict[frozenset[str], dict[str, str]] = {}
        self.behind: dict[CellRef, Lines | None] = {}
        self.alike: dict[Hashable, Lines | None] = {}
        self.seeds: dict[Hashable, bytes] = {}

    def parameters(self, stage: Stage) -> str:
        """Digest of a stage's parameters, taken once: a stage serves many cells, and every cell asks twice."""
        known = self.digests.get(id(stage))
        if known is None:
            known = self.digests[id(stage)] = key_of(parameters_for_key(stage))
        return known

    def key(
        self, draft: Draft, left_out: LeftOut | None, seed: bytes, open_words: tuple[words.Open, ...], precision: str
    ) -> tuple[Mapping[str, str], str]:
        """The versions of libraries that stand in a cell's key, and the key."""
        node, inputs = draft.node, draft.inputs
        if left_out:
            main = next(iter(node.writes))
            source = next(ref for _, ref, v in inputs if v == main)
            return NONE, self.cells[source].key
        head, versions, draws = self.head(draft, precision)
        lines = [head, self.text_of_form(draft.form), *(f"{port} {self.cells[ref].key}" for port, ref, _ in inputs)]
        if node.segment:
            lines.append(self.text_of_segment(node, inputs, precision))
        if draws:
            lines.append(seed.decode())  # values of ancestors count here even where a stage is left out
            lines += [f"{word.stage}.{word.name} {self.cells[word.ref].key}" for word in open_words]
        if draft.looks_at:
            lines.append(self.text_of_looked_at(node, draft.one, draft.looks_at))
        return versions, digest("\n".join(lines).encode())

    def head(self, draft: Draft, precision: str) -> Head:
        """What the keys of all cells of a stage at a node begin with."""
        node, stage, one = draft.node, draft.stage, draft.one
        asked = [ref for port, refs in draft.looks_at if looks(reads_of(one.kind)[port]) == "transfer" for ref in refs]
        libraries = frozenset().union(*(libraries_of(type(self.cells[ref].stage)) for ref in asked))
        place = (node.name, id(stage), one.label, libraries if asked else None)
        known = self.heads.get(place)
        if known is not None:
            return known
        averaged = self.expected and isinstance(stage, Sampled)
        bound = is_random(type(stage)) or node.segment or asked
        versions = self.versions_of(libraries.union(libraries_of(type(stage)), ("numpy", "scipy") if bound else ()))
        fields: Document = {
            "stage": one.use,
            "code": one.digest,
            "parameters": self.parameters(stage),
            "precision": precision,
            "versions": versions,
            "expected": averaged,
            "along": {name: q.along for name, q in quantities_of(type(stage)).items() if q.along},
        }
        draws = draws_anew(type(stage)) and not averaged  # fixed patterns follow the serial, a parameter
        if draws:
            fields["seed"], fields["name"] = self.pipeline_seed, node.name
        found = self.heads[place] = AS_TEXT(fields), versions, draws
        return found

    def text_of_form(self, form: Form) -> str:
        """The grids of what a cell writes, and the dims that it is mapped over."""
        known = self.forms.get(form)
        if known is None:
            grids = [[v, plain_text(grid)] for v, grid in form.grids.items()]
            known = self.forms[form] = AS_TEXT([grids, plain_text(form.mapped)])
        return known

    def text_of_segment(self, node: Node, inputs: Any, precision: str) -> str:
        """How far in front of a transfer function its segment begins, and whether the light there is streamed: other
        bits either way.
        """
        first, _, variable = inputs[0][1], None, inputs[0][2]
        for _ in range(len(node.segment) - 1):
            _, first, variable = self.cells[first].inputs[0]
        streamed = too_large(self.nodes[first[0]].writes[variable], self.cells[first].grids[variable], precision)
        return f"segment {len(node.segment)} {streamed}"

    def text_of_looked_at(self, node: Node, one: Alternative, looks_at: Any) -> str:
        """What counts of all that a cell looks at; remembered of transfer functions, since cells look at the same
        ones.
        """
        place = (node.name, one.label, looks_at)
        known = self.looked.get(place)
        if known is None:
            known = AS_TEXT(
                [[port, self.looked_at(one, port, [self.cells[ref] for ref in refs])] for port, refs in looks_at]
            )
            if all(looks_at_stages(looks(reads_of(one.kind)[port])) for port, _ in looks_at):
                self.looked[place] = known
        return known

    def looked_at(self, one: Alternative, port: str, cells: list[Cell]) -> Any:
        """What counts of the cells that a stage looks at: of transfer functions and datasheets the stages, left out
        or not.
        """
        what = looks(reads_of(one.kind)[port])
        if not looks_at_stages(what):
            return [[cell.node, cell.key] for cell in cells]
        stages = [[c.node, c.use, code_digest(type(c.stage)), self.parameters(c.stage)] for c in cells]
        if what == "datasheet":
            return stages
        return [
            stages,
            [list(c.input_grids[c.inputs[0][0]].bands().edges) for c in cells[:1]],
            [scene_of(self.cells, c).facts.rendered for c in cells[:1]],
            [light_of(self.cells, c) for c in pixel_of(cells)],
            [chains([c.node for c in cells], self.nodes), [is_whole(self.cells, c) for c in cells]],
            [plain_text(g) for c in cells for g in c.grids.values()],
        ]

    def versions_of(self, libraries: frozenset[str]) -> dict[str, str]:
        known = self.versions.get(libraries)
        if known is None:
            known = self.versions[libraries] = {
                name: self.stated.get(name) or version_of(name) for name in sorted(libraries)
            }
        return known

    def seed(self, draft: Draft) -> tuple[bytes, tuple[words.Open, ...]]:
        """Words that key the random numbers of a cell: values only, so that a cell alone equals the cell in a sweep."""
        name, stage = draft.node.name, draft.stage
        if not draws_anew(type(stage)) or (self.expected and isinstance(stage, Sampled)):
            return b"", ()
        if asking.common_draws(stage):
            return f"{self.pipeline_seed}|{name}|".encode(), ()
        quantities = quantities_of(type(stage))
        read = [ref for port, ref, _ in draft.inputs if port not in quantities]
        read += [ref for _, refs in draft.looks_at for ref in refs]
        behind = [self.lines_behind(ref) for ref in read]
        if None in behind or any(port in quantities for port, _, _ in draft.inputs):
            return self.open_seed(draft, read)
        place = name, id(stage), *behind
        if place not in self.seeds:
            every = frozenset(self.lines(name, stage)).union(*(lines for lines in behind if lines))
            self.seeds[place] = words.seed_of(self.pipeline_seed, name, every)
        return self.seeds[place], ()

    def open_seed(self, draft: Draft, read: list[CellRef]) -> tuple[bytes, tuple[words.Open, ...]]:
        """The same where a run finds some of the values: the lines that are known, and those that are left open."""
        name, stage = draft.node.name, draft.stage
        cells = words.behind(self.cells, [self.cells[ref] for ref in read])
        lines = set(self.lines(name, stage)).union(*(self.lines(cell.node, cell.stage) for cell in cells))
        quantities = quantities_of(type(stage))
        found = [(name, type(stage), one) for one in draft.inputs if one[0] in quantities]
        found += [(cell.node, type(cell.stage), one) for cell in cells for one in cell.found]
        if not found:
            return words.seed_of(self.pipeline_seed, name, lines), ()
        awaited = tuple(
            words.Open(whose, q, parameters_of(kind)[q][2], ref, variable) for whose, kind, (q, ref, variable) in found
        )
        return "\n".join(sorted(lines)).encode(), awaited

    def lines_behind(self, ref: CellRef) -> Lines | None:
        """The words of a cell and of all that it reads through its ports, at any distance; None where a run finds one
        of their values.

        One set for all cells of a stage that read cells of the same sets.
        """
        if ref in self.behind:
            return self.behind[ref]
        cell = self.cells[ref]
        before = [None] if cell.found else [self.lines_behind(source) for _, source, _ in cell.inputs]
        place = cell.node, id(cell.stage), *before
        if place not in self.alike:
            every = frozenset(self.lines(cell.node, cell.stage)).union(*(lines for lines in before if lines))
            self.alike[place] = None if None in before else every
        found = self.behind[ref] = self.alike[place]
        return found

    def lines(self, name: str, stage: Stage) -> tuple[str, ...]:
        """A stage's words, taken once: it serves many cells."""
        known = self.words.get((name, id(stage)))
        if known is None:
            known = self.words[(name, id(stage))] = words.own_lines(name, stage)
        return known

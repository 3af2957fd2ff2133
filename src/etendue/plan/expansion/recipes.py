"""Build the identity of a cell: its key, and the words that seed its random numbers.

In:  a stage at a combination of the axes, and the cells before it.
Out: the fields of its key and their digest; the words that key its random numbers.
"""

from __future__ import annotations

import json
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

from etendue.contract.capabilities import Sampled, draws_anew, is_random
from etendue.contract.stage import Stage, looks, looks_at_stages, parameters_of, quantities_of, reads_of
from etendue.plan import stage_calls
from etendue.plan.cost import too_large
from etendue.plan.expansion import seed_words
from etendue.plan.expansion.digits import in_words
from etendue.plan.expansion.forms import CellGrids, Draft
from etendue.plan.identity.code import code_digest, libraries_of
from etendue.plan.identity.keys import digest, key_of, parameters_for_key, plain_text, version_of
from etendue.plan.identity.once import Once
from etendue.plan.model import Alternative, Cell, CellRef, LeftOut, Node, chains, is_whole, light_of, pixel_of, scene_of
from etendue.types.documents import Document

NONE: Mapping[str, str] = {}  # never written to; a plain dict, since a mapping proxy cannot be pickled
Lines = frozenset[str]
Head = tuple[str, Mapping[str, str], bool]  # text, library versions, whether the seed is part of the key
AS_TEXT = json.JSONEncoder(sort_keys=True).encode


class Recipes:
    """Makes keys and seeds. ``cells`` are the cells planned so far; ``expected``: means instead of draws and rounding;
    ``versions``: library versions to use instead of the installed ones; without ``keys``, the keys of cells
    are empty.
    """

    def __init__(
        self,
        cells: Mapping[CellRef, Cell],
        nodes: Mapping[str, Node],
        seed: int,
        expected: bool,
        versions: Mapping[str, str],
        keys: bool = True,
    ) -> None:
        self.cells, self.nodes, self.pipeline_seed, self.expected = cells, nodes, seed, expected
        self.stated, self.keys = versions, keys
        self.words: Once[tuple[str, ...]] = Once()
        self.digests: Once[str] = Once()  # digests of parameters
        self.heads: Once[Head] = Once()
        self.forms: dict[CellGrids, str] = {}  # text of the grids
        self.looked: dict[Hashable, str] = {}  # text of the transfer functions looked at; many cells share it
        self.versions: dict[frozenset[str], dict[str, str]] = {}
        self.behind: dict[CellRef, Lines | None] = {}
        self.alike: Once[Lines | None] = Once()
        self.seeds: Once[bytes] = Once()

    def parameters(self, stage: Stage) -> str:
        """Return the digest of a stage's parameters. It is cached because many cells share a stage, and each needs it
        twice.
        """
        return self.digests((stage,), lambda: key_of(parameters_for_key(stage)))

    def key(
        self,
        draft: Draft,
        left_out: LeftOut | None,
        seed: bytes,
        open_words: tuple[seed_words.Open, ...],
        precision: str,
        kept: Mapping[str, int | None],
    ) -> tuple[Mapping[str, str], str]:
        """Return the library versions in a cell's key, and the key; ``kept``: the digits of the variables that the cell
        passes on.
        """
        node, inputs = draft.node, draft.inputs
        if left_out:
            # A cell that is left out passes its input on unchanged: same bits, same key.
            main = next(iter(node.writes))
            source = next(ref for _, ref, v in inputs if v == main)
            return NONE, self.cells[source].key
        if not self.keys:
            return NONE, ""
        head, versions, draws = self.head(draft, precision)
        lines = [head, self.text_of_form(draft.form), *(f"{port} {self.cells[ref].key}" for port, ref, _ in inputs)]
        if node.segment:
            lines.append(self.text_of_segment(node, inputs, precision))
        if draws:
            lines.append(seed.decode())  # includes the values of ancestors that are left out
            lines += [f"{word.stage}.{word.name} {self.cells[word.ref].key}" for word in open_words]
        if kept:
            lines.append(in_words(kept))
        if draft.looks_at:
            lines.append(self.text_of_looked_at(node, draft.one, draft.looks_at))
        return versions, digest("\n".join(lines).encode())

    def head(self, draft: Draft, precision: str) -> Head:
        """Return the common first part of the keys of all cells of a stage at a node."""
        node, stage, one = draft.node, draft.stage, draft.one
        asked = [ref for port, refs in draft.looks_at if looks(reads_of(one.kind)[port]) == "transfer" for ref in refs]
        libraries = frozenset().union(*(libraries_of(type(self.cells[ref].stage)) for ref in asked))
        return self.heads(
            (stage,),
            lambda: self.new_head(draft, precision, libraries, bool(asked)),
            node.name,
            one.label,
            libraries if asked else None,
        )

    def new_head(self, draft: Draft, precision: str, libraries: frozenset[str], asked: bool) -> Head:
        node, stage, one = draft.node, draft.stage, draft.one
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
        # Fixed patterns depend on a serial number, which is a parameter and so in the key already.
        draws = draws_anew(type(stage)) and not averaged
        if draws:
            fields["seed"], fields["name"] = self.pipeline_seed, node.name
        return AS_TEXT(fields), versions, draws

    def text_of_form(self, form: CellGrids) -> str:
        """Return the grids of the outputs of a cell, and the dims over which it is mapped, as text."""
        known = self.forms.get(form)
        if known is None:
            grids = [[v, plain_text(grid)] for v, grid in form.grids.items()]
            known = self.forms[form] = AS_TEXT([grids, plain_text(form.mapped)])
        return known

    def text_of_segment(self, node: Node, inputs: Sequence[tuple[str, CellRef, str]], precision: str) -> str:
        """Return the number of stages between the beginning of its segment and a transfer function, and whether the
        light there is streamed band by band: both change bits of the result.
        """
        first, _, variable = inputs[0][1], None, inputs[0][2]
        for _ in range(len(node.segment) - 1):
            _, first, variable = self.cells[first].inputs[0]
        streamed = too_large(self.nodes[first[0]].writes[variable], self.cells[first].grids[variable], precision)
        return f"segment {len(node.segment)} {streamed}"

    def text_of_looked_at(self, node: Node, one: Alternative, looks_at: Any) -> str:
        """Return the text of all cells that a cell looks at. For transfer functions and datasheets it is cached,
        because many cells look at the same cells; for variables it differs from cell to cell.
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
        """Return the key fields of the cells that a stage looks at. For transfer functions and datasheets these are the
        stages, even if they are left out.
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

    def seed(self, draft: Draft) -> tuple[bytes, tuple[seed_words.Open, ...]]:
        """Return the words that key the random numbers of a cell. They contain values only, no positions on axes, so
        that a cell computed alone equals the same cell in a sweep.
        """
        name, stage = draft.node.name, draft.stage
        if not draws_anew(type(stage)) or (self.expected and isinstance(stage, Sampled)):
            return b"", ()
        if common := stage_calls.common_draws(stage):
            return f"{self.pipeline_seed}|{name}|{common if isinstance(common, str) else ''}".encode(), ()
        quantities = quantities_of(type(stage))
        read = [ref for port, ref, _ in draft.inputs if port not in quantities]
        read += [ref for _, refs in draft.looks_at for ref in refs]
        behind = [self.lines_behind(ref) for ref in read]
        if None in behind or any(port in quantities for port, _, _ in draft.inputs):
            return self.open_seed(draft, read)

        def found() -> bytes:
            every = frozenset(self.lines(name, stage)).union(*(lines for lines in behind if lines))
            return seed_words.seed_of(self.pipeline_seed, name, every)

        return self.seeds((stage,), found, name, *behind), ()

    def open_seed(self, draft: Draft, read: list[CellRef]) -> tuple[bytes, tuple[seed_words.Open, ...]]:
        """Return the seed if a run must find some of its values: the known lines, and the lines left open."""
        name, stage = draft.node.name, draft.stage
        cells = seed_words.behind(self.cells, [self.cells[ref] for ref in read])
        lines = set(self.lines(name, stage)).union(*(self.lines(cell.node, cell.stage) for cell in cells))
        quantities = quantities_of(type(stage))
        found = [(name, type(stage), one) for one in draft.inputs if one[0] in quantities]
        found += [(cell.node, type(cell.stage), one) for cell in cells for one in cell.found]
        if not found:
            return seed_words.seed_of(self.pipeline_seed, name, lines), ()
        awaited = tuple(
            seed_words.Open(whose, q, parameters_of(kind)[q][2], ref, variable)
            for whose, kind, (q, ref, variable) in found
        )
        return "\n".join(sorted(lines)).encode(), awaited

    def lines_behind(self, ref: CellRef) -> Lines | None:
        """Return the words of a cell and of all that it reads through its ports, directly or indirectly; None if a run
        must find one of their values.

        Cells of one stage whose inputs have the same sets share one set.
        """
        if ref in self.behind:
            return self.behind[ref]
        cell = self.cells[ref]
        before = [None] if cell.found else [self.lines_behind(source) for _, source, _ in cell.inputs]

        def union() -> Lines | None:
            every = frozenset(self.lines(cell.node, cell.stage)).union(*(lines for lines in before if lines))
            return None if None in before else every

        found = self.behind[ref] = self.alike((cell.stage,), union, cell.node, *before)
        return found

    def lines(self, name: str, stage: Stage) -> tuple[str, ...]:
        """Return the words of a stage itself. They are cached because many cells share a stage."""
        return self.words((stage,), lambda: seed_words.own_lines(name, stage), name)

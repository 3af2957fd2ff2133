"""Build the identity of cells: their keys, and the words that seed their random numbers.

In:  a stage at a combination of the axes, and the cells before it.
Out: the fields of its key and their digest; the words that key its random numbers.

Files and installed distributions are read when a stage is planned (``head``). The keys and seeds of its cells are made
later, when the first of them is requested.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Hashable, Mapping
from functools import partial
from itertools import islice
from typing import Any

from etendue.contract.capabilities import Sampled, draws_anew, is_random
from etendue.contract.stage import Stage, files_of, looks, looks_at_stages, parameters_of, quantities_of, reads_of
from etendue.plan import stage_calls
from etendue.plan.cost import too_large
from etendue.plan.expansion import seed_words
from etendue.plan.expansion.digits import in_words
from etendue.plan.identity.code import code_digest, libraries_of
from etendue.plan.identity.keys import key_of, parameters_for_key, plain_text, version_of
from etendue.plan.identity.once import Once
from etendue.plan.model import Alternative, Cell, CellRef, Node, chains, is_whole, light_of, pixel_of, scene_of
from etendue.plan.structure.cell import NOT_DRAWN, Drawn, Settled
from etendue.types.documents import Document

NONE: Mapping[str, str] = {}  # never written to; a plain dict, since a mapping proxy cannot be pickled
Lines = frozenset[str]
Head = tuple[str, Mapping[str, str]]  # text, library versions
AS_TEXT = json.JSONEncoder(sort_keys=True).encode


class Recipes:
    """Make the keys and seeds of cells. ``cells`` are the cells planned so far; ``expected``: stages return means
    instead of random draws and rounded values; ``versions``: library versions to use instead of the installed ones;
    without ``keys``, the keys of cells are empty.
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
        self.precision = ""  # known before the first cell
        self.counts: dict[str, int] = {}  # of cells by node, in order
        self.keyed: set[str] = set()  # nodes whose cells have their keys
        self.words: Once[tuple[str, ...]] = Once()
        self.digests: Once[str] = Once()  # digests of parameters
        self.heads: Once[Head] = Once()
        self.forms: Once[str] = Once()  # text of all grids of a cell
        self.grids: Once[str] = Once()  # text of a grid
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

    def key(self, ref: CellRef) -> str:
        """Return the key of a cell. The keys of all cells of its stage, and of earlier stages, are made together."""
        if not self.keys:
            return ""
        first = 0
        for name, count in self.counts.items():
            if name not in self.keyed:
                self.make_keys(self.nodes[name], list(islice(self.cells.values(), first, first + count)))
                self.keyed.add(name)
            if name == ref[0]:
                break
            first += count
        found = self.cells[ref]._key
        assert found is not None
        return found

    def make_keys(self, node: Node, cells: list[Cell]) -> None:
        """Make the keys of the cells of a node; the cells of earlier nodes must already have keys."""
        begun: dict[Settled, hashlib.blake2b] = {}  # digests of what cells have in common
        main, every = next(iter(node.writes), ""), self.cells
        for cell in cells:
            if cell._key is not None:
                continue
            settled, index = cell.settled, cell.ref[1]
            before = [(port, every[source, at(index)]._key, v) for port, source, v, at in settled.reading.inputs]
            if settled.left_out:
                # A cell that is left out passes its input on unchanged: same bits, same key.
                cell._key = next(key for _, key, variable in before if variable == main)
                continue
            if settled not in begun:
                begun[settled] = hashlib.blake2b(self.begin(settled).encode(), digest_size=16)
            found = begun[settled].copy()
            lines = [f"\n{port} {key}" for port, key, _ in before]
            if node.segment:
                lines.append(f"\n{self.text_of_segment(node, cell, self.precision)}")
            if settled.draws:
                lines.append(f"\n{cell.seed.decode()}")  # includes the values of ancestors that are left out
                lines += [f"\n{word.stage}.{word.name} {every[word.ref]._key}" for word in cell.open_words]
            if settled.digits:
                lines.append(f"\n{in_words(settled.digits)}")
            if settled.reading.looks_at:
                lines.append(f"\n{self.text_of_looked_at(node, self.alternative(node, cell), cell.looks_at)}")
            found.update("".join(lines).encode())
            cell._key = found.hexdigest()

    def begin(self, settled: Settled) -> str:
        """Return the first lines of the text whose digest is the key of a cell; ``settled``: the cell's shared
        properties.
        """
        return f"{settled.head}\n{self.text_of_form(settled)}"

    def alternative(self, node: Node, cell: Cell) -> Alternative:
        return node.alternatives[cell.ref[1][node.axes.index(node.use_axis)] if node.use_axis else 0]

    def head(self, node: Node, one: Alternative, stage: Stage, asked: frozenset[type[Stage]]) -> Head:
        """Return the first part of the keys of a stage at a node, the same for all its cells; ``asked``: the classes of
        stages whose transfer functions they look at. All files that keys and seeds depend on are read here.
        """
        if not self.keys:
            return "", NONE
        libraries = frozenset().union(*map(libraries_of, asked))
        if files_of(stage):
            self.lines(node.name, stage)
        return self.heads(
            (stage,),
            lambda: self.new_head(node, one, stage, libraries, bool(asked)),
            node.name,
            one.label,
            libraries if asked else None,
        )

    def draws(self, stage: Stage) -> bool:
        """Return whether a stage draws random numbers that depend on the seed. Fixed patterns depend on a serial
        number, which is a parameter and so in the key already.
        """
        return draws_anew(type(stage)) and not (self.expected and isinstance(stage, Sampled))

    def new_head(self, node: Node, one: Alternative, stage: Stage, libraries: frozenset[str], asked: bool) -> Head:
        bound = is_random(type(stage)) or node.segment or asked
        versions = self.versions_of(libraries.union(libraries_of(type(stage)), ("numpy", "scipy") if bound else ()))
        fields: Document = {
            "stage": one.use,
            "code": one.digest,
            "parameters": self.parameters(stage),
            "precision": self.precision,
            "versions": versions,
            "expected": self.expected and isinstance(stage, Sampled),
            "along": {name: q.along for name, q in quantities_of(type(stage)).items() if q.along},
        }
        if self.draws(stage):
            fields["seed"], fields["name"] = self.pipeline_seed, node.name
        return AS_TEXT(fields), versions

    def text_of_form(self, settled: Settled) -> str:
        """Return as text the grids of the variables that cells write, and the dims over which the cells are mapped."""

        def text() -> str:
            grids = [[v, self.grids((grid,), partial(plain_text, grid))] for v, grid in settled.grids.items()]
            return AS_TEXT([grids, plain_text(settled.mapped)])

        return self.forms((settled.grids, settled.mapped), text)

    def text_of_segment(self, node: Node, cell: Cell, precision: str) -> str:
        """Return as text the number of stages from the beginning of a segment to this transfer function, and whether
        the segment's input is streamed band by band: both change bits of the result.
        """
        _, first, variable = cell.inputs[0]
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
            [self.grids((g,), partial(plain_text, g)) for c in cells for g in c.grids.values()],
        ]

    def versions_of(self, libraries: frozenset[str]) -> dict[str, str]:
        known = self.versions.get(libraries)
        if known is None:
            known = self.versions[libraries] = {
                name: self.stated.get(name) or version_of(name) for name in sorted(libraries)
            }
        return known

    def drawn(self, ref: CellRef) -> Drawn:
        """Return the words that determine the random numbers of a cell, and the words whose values are known only in
        the run. Words contain parameter values but no positions on axes, so that a cell computed alone equals the same
        cell in a sweep.
        """
        cell, name = self.cells[ref], ref[0]
        stage, quantities = cell.stage, cell.settled.reading.quantities
        if not self.draws(stage):
            return NOT_DRAWN
        if common := stage_calls.common_draws(stage):
            return f"{self.pipeline_seed}|{name}|{common if isinstance(common, str) else ''}".encode(), ()
        inputs = cell.settled.reading.inputs
        read = [(source, at(ref[1])) for port, source, _, at in inputs if port not in quantities]
        read += [other for _, refs in cell.looks_at for other in refs]
        behind = [self.lines_behind(source) for source in read]
        if None in behind or any(port in quantities for port, _, _, _ in inputs):
            return self.open_seed(cell, read)

        def found() -> bytes:
            every = frozenset(self.lines(name, stage)).union(*(lines for lines in behind if lines))
            return seed_words.seed_of(self.pipeline_seed, name, every)

        return self.seeds((stage,), found, name, *behind), ()

    def open_seed(self, own: Cell, read: list[CellRef]) -> Drawn:
        """Return the seed if a run must find some of its values: the known lines, and the lines left open."""
        name, stage = own.node, own.stage
        cells = seed_words.behind(self.cells, [self.cells[ref] for ref in read])
        lines = set(self.lines(name, stage)).union(*(self.lines(cell.node, cell.stage) for cell in cells))
        found = [(name, type(stage), one) for one in own.found]
        found += [(cell.node, type(cell.stage), one) for cell in cells for one in cell.found]
        if not found:
            return seed_words.seed_of(self.pipeline_seed, name, lines), ()
        awaited = tuple(
            seed_words.Open(whose, q, parameters_of(kind)[q][2], ref, variable)
            for whose, kind, (q, ref, variable) in found
        )
        return "\n".join(sorted(lines)).encode(), awaited

    def lines_behind(self, ref: CellRef) -> Lines | None:
        """Return the words of a cell and of all cells that it reads through its ports, directly or indirectly; None if
        one of the values in these words is known only in the run.

        Cells of one stage share one set of words if the sets of their inputs are the same.
        """
        if ref in self.behind:
            return self.behind[ref]
        cell = self.cells[ref]
        reading, index = cell.settled.reading, ref[1]
        if any(port in reading.quantities for port, _, _, _ in reading.inputs):
            before: list[Lines | None] = [None]
        else:
            before = [self.lines_behind((source, at(index))) for _, source, _, at in reading.inputs]

        def union() -> Lines | None:
            every = frozenset(self.lines(cell.node, cell.stage)).union(*(lines for lines in before if lines))
            return None if None in before else every

        found = self.behind[ref] = self.alike((cell.stage,), union, cell.node, *before)
        return found

    def lines(self, name: str, stage: Stage) -> tuple[str, ...]:
        """Return the words of a stage itself. They are cached because many cells share a stage."""
        return self.words((stage,), lambda: seed_words.own_lines(name, stage), name)

"""Decide cells of a node that have the same stage and inputs only once, and share the result.

In:  the cells that the cells of a node read.
Out: cells that share the properties decided for them (``Settled``).

Cells of one stage that read equal grids and facts get the same decisions. The decisions for most stages do not depend
on facts: for cells with equal grids, only the facts are then found cell by cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from etendue.contract.arrays.facts import UNKNOWN, Facts
from etendue.contract.stage import Stage
from etendue.errors import PluginError, RequestError
from etendue.plan import stage_calls
from etendue.plan.expansion.forms import Draft
from etendue.plan.expansion.recipes import NONE
from etendue.plan.identity.once import Once
from etendue.plan.model import ALL_DIGITS, Cell, Node
from etendue.plan.structure.cell import PositionMap, Settled

if TYPE_CHECKING:
    from etendue.plan.expansion.cells import Expansion

MOST_UNLIKE = 10_000  # cells of a stage after which results are no longer cached if none was reused


class Settling:
    """Makes the cells of one node. ``expansion`` has the cells of earlier nodes."""

    def __init__(self, expansion: Expansion, node: Node) -> None:
        self.expansion, self.node = expansion, node
        self.use = node.axes.index(node.use_axis) if node.use_axis else None
        own = expansion.where(node.axes) if node.direct else {}
        self.direct = [own[dim] for dim, _ in node.direct]
        self.alone = not node.axes
        self.stages: dict[tuple[int, ...], Stage] = {}
        self.readings = [expansion.readings[node.name, number] for number in range(len(node.alternatives))]
        self.sources = [[self.source(name, at) for _, name, _, at in one.inputs] for one in self.readings]
        self.carries = [one.kind.carry is not Stage.carry for one in node.alternatives]
        self.common: Once[Settled] = Once()
        # By what is read: the shared properties with the facts; if decisions do not depend on facts, the properties
        # alone.
        self.known: Once[tuple[Settled, Facts]] = Once()
        self.blind: Once[Settled] = Once()
        self.hits = self.misses = 0

    def cell(self, number: int, index: tuple[int, ...]) -> Cell | None:
        """Return the cell with a number and position in its node; None if it has a fault, which is noted."""
        choice = 0 if self.use is None else index[self.use]
        read = [cells[number if numbers is None else numbers[number]] for cells, numbers in self.sources[choice]]
        stage, reading = self.stage(choice, index, read), self.readings[choice]
        form: list[object] = [stage, *[cell.settled.grids for cell in read]]
        if reading.asked:
            cells = self.expansion.cells
            form += [type(cells[name, at(index)].stage) for name, at in reading.asked]
        settled = self.blind.get(form, choice)
        if settled is not None and not self.carries[choice]:
            return Cell((self.node.name, index), settled, UNKNOWN)
        place = [*form, *[cell.facts for cell in read]]
        found = self.known.get(place, choice)
        if found is not None:
            self.hits += 1
            return Cell((self.node.name, index), *found)
        self.misses += 1
        made = self.decided(choice, index, stage, read, settled)
        if made is None:
            return None
        settled, facts, blind = made
        if reading.alike and not self.alone and self.are_alike(read):
            if self.hits or self.misses < MOST_UNLIKE:
                self.known.put((settled, facts), place, choice)
            if blind:
                self.blind.put(settled, form, choice)
        return Cell((self.node.name, index), settled, facts)

    def decided(
        self, number: int, index: tuple[int, ...], stage: Stage, read: Sequence[Cell], known: Settled | None
    ) -> tuple[Settled, Facts, bool] | None:
        """Decide a cell. Return the properties that it shares with other cells, its facts, and whether its decisions
        are independent of the facts of its inputs. Return None if the cell has a fault, which is noted. ``known``: the
        shared properties if they are known already.
        """
        reading = self.readings[number]
        pairs = zip(reading.inputs, read, strict=True)
        facts_in = {port: cell.facts for (port, _, _, _), cell in pairs if port in reading.ports}
        try:
            if known is not None:
                return known, stage_calls.carried(stage, facts_in, known.input_grids), True
            return self.settled(number, index, stage, read, facts_in)
        except PluginError as error:
            self.expansion.refused(self.node, stage, error)
        except (ValueError, RequestError) as error:
            self.expansion.unfit(self.node, index, error)
        return None

    def are_alike(self, read: Sequence[Cell]) -> bool:
        """Return whether other cells that read the same grids and facts get the same decisions."""
        expansion = self.expansion
        if expansion.digits.tolerance > 0:  # digits depend on all cells before
            return False
        return not expansion.choice.decided or all(cell.facts is UNKNOWN for cell in read)

    def stage(self, number: int, index: tuple[int, ...], read: Sequence[Cell]) -> Stage:
        """Return the stage of a cell; ``number``: its alternative; ``read``: the cells that it reads."""
        expansion, node, reading = self.expansion, self.node, self.readings[number]
        if reading.quantities:
            inputs = [(name, cell.ref, v) for (name, _, v, _), cell in zip(reading.inputs, read, strict=True)]
            if found := expansion.found(node.alternatives[number], inputs):
                return expansion.stage_at(node, number, expansion.by_dim(node, index), found)
        place = (number, *[index[at] if rows is None else rows[index[at]] for at, rows in self.direct])
        known = self.stages.get(place)
        if known is None:
            known = self.stages[place] = expansion.stage_at(node, number, expansion.by_dim(node, index))
        return known

    def source(self, name: str, at: PositionMap) -> tuple[list[Cell], list[int] | None]:
        """Return the cells of a node from which another node reads and, for each cell of the other node, the number of
        the cell that it reads; None instead of the numbers if both have the same order.
        """
        expansion, axes, own = self.expansion, self.expansion.nodes[name].axes, self.node.axes
        if axes == own:
            return expansion.by_node[name], None
        if (own, axes) not in expansion.between:
            order = {index: number for number, index in enumerate(expansion.places[axes])}
            expansion.between[own, axes] = [order[at(index)] for index in expansion.places[own]]
        return expansion.by_node[name], expansion.between[own, axes]

    def settled(
        self, number: int, index: tuple[int, ...], stage: Stage, read: Sequence[Cell], facts_in: dict[str, Facts]
    ) -> tuple[Settled, Facts, bool]:
        expansion, node, reading = self.expansion, self.node, self.readings[number]
        one, recipes, cells = node.alternatives[number], expansion.recipes, expansion.cells
        inputs = tuple([(p, cell.ref, v) for (p, _, v, _), cell in zip(reading.inputs, read, strict=True)])
        form = expansion.form(node, number, stage, inputs)
        draft = Draft(node, number, stage, inputs, form)
        declared = expansion.describe(node, stage)[0] if node.is_source else None
        decided = expansion.decider.decide(draft, facts_in, expansion.by_dim(node, index), declared)
        stage, left_out, draws = decided.stage, decided.left_out, recipes.draws(decided.stage)
        if draws:
            stage_calls.common_draws(stage)  # checked here; the result is used when the seed is requested
        kept = ALL_DIGITS if left_out else expansion.digits.of(draft._replace(stage=stage), decided.facts)
        asked = frozenset(type(cells[name, at(index)].stage) for name, at in reading.asked)

        def new() -> Settled:
            head, versions = recipes.head(node, one, stage, asked)
            return Settled(
                stage=stage,
                use=one.use,
                reading=reading,
                recipe=recipes,
                head=head,
                versions=NONE if left_out else versions,
                draws=draws,
                input_grids=form.input_grids,
                grids=form.grids,
                mapped=form.mapped,
                left_out=left_out,
                approximated=decided.approximated,
                error=decided.error,
                digits=kept,
            )

        also = (number, left_out, decided.approximated, decided.error, asked)
        return self.common((stage, form, kept), new, *also), decided.facts, decided.blind

"""The error of several discretisations together, for budgets that are too small to measure one after the other.

Evaluations form two chains, one for bins and spacing, and one for margin and omissions; each step of a chain changes
one thing. The difference between the ends of a chain gives the error of all its steps; an evaluation in between
separates the steps.

In:  evaluations of a point.
Out: the parts of the errors of the wanted variables: one part for each chain; with one more evaluation of a chain, one
     part for each of its steps; if the budget allows only one comparison over both chains, one part for everything.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from etendue.accuracy.answers.comparing import (
    COARSE,
    FEW_BANDS,
    Parts,
    Texts,
    Way,
    attempt,
    compare,
    computed_alike,
    is_refinable,
    not_affected,
)
from etendue.accuracy.answers.error import OMISSIONS, Part
from etendue.accuracy.answers.evaluations import PLANNED, Evaluated, Evaluations, TooDear, Which
from etendue.accuracy.answers.one_at_a_time import refinements
from etendue.accuracy.answers.refinement import NEARER, Factors
from etendue.plan.model import Plan, StageVariable

GRIDS = ("spacing", "bins")
# Factors from the change by one step to its error. Where convergence is of first order or higher, the error is at most
# the change by a coarsening; bins converge with second order, edges and points in the scene less regularly.
STEPS: Mapping[str, float] = {"bins": 1.0, "spacing": 2.5}
OTHER_STEPS = 3.0
WHOLE = 2.0  # for all at once: bins converge with second order, so coarser bins change by three times their error
SMALL = 0.1  # seconds of the point as planned below which making tables costs more than computing light
SCARCE = 3.0  # budget, in units of the cost of the point as planned, below which both chains start alike
BASES: tuple[Factors, ...] = ({**FEW_BANDS, **COARSE}, FEW_BANDS, COARSE, {})


class Chain(NamedTuple):
    """A chain of evaluations, each of which refines one discretisation of the evaluation before it."""

    names: tuple[str, ...]  # names of the steps
    which: tuple[Which, ...]  # the evaluations: one more than steps

    @property
    def ends(self) -> tuple[Which, Which]:
        return self.which[0], self.which[-1]

    def steps(self) -> list[Chain]:
        return [Chain((name,), pair) for name, pair in zip(self.names, itertools.pairwise(self.which), strict=True)]

    def label(self, affected: Mapping[str, list[StageVariable]], one: StageVariable) -> str:
        """Return the names of the steps that can change a variable."""
        return " and ".join(sorted(name for name in self.names if one in affected[name]))

    def factor(self, label: str) -> float:
        """Return the factor by which the change of all steps of a label is multiplied to give their error."""
        names = label.split(" and ")
        if "bins" in names and not {*names} <= {*GRIDS}:
            return WHOLE
        return max(STEPS.get(name, OTHER_STEPS) for name in names)


class Together:
    """Measures the parts of the errors at a point.

    Parameters
    ----------
    plan : plan of the whole pipeline
    evaluations : evaluations of the point
    parts, missing : mappings by variable to which parts and texts are added
    fixed : mapping to which discretisations that cannot be refined are added
    """

    def __init__(
        self, plan: Plan, evaluations: Evaluations, parts: Parts, missing: Texts, fixed: dict[str, str]
    ) -> None:
        self.evaluations, self.parts, self.missing, self.fixed = evaluations, parts, missing, fixed
        point = evaluations.point
        self.affected = {name: point.affected(plan, name) for name in point.names()} | {OMISSIONS: [*point.wanted]}
        self.dear = 0.0  # seconds of evaluations that were too costly
        self.measured: list[tuple[Chain, list[Chain]]] = []  # chains with their pieces
        self.apart: list[str] = []  # discretisations that can be refined, but not as a step of a chain

    def measure(self) -> None:
        """Add the parts of both chains that fit into the budget. The caller measures discretisations in ``apart``."""
        names = self.evaluations.point.names()
        try:
            grids = self._grids(names)
            chains = [grids, self._rest(names, grids)]
        except TooDear as error:
            self._lack(names, error)
            return
        chains = [chain for chain in chains if chain.names]
        for name in (name for chain in chains for name in chain.names):
            not_affected(self.parts, self.affected[name], name)
        if len(chains) == 2 and self._at_once(*chains):
            return
        for chain in chains:
            if self._ends(chain):
                self._to_split(chain)

    def split(self, once: bool = False) -> None:
        """Measure the pieces of each chain separately, as far as the budget allows; ``once``: of the first only."""
        while self.measured:
            chain, pieces = self.measured[0]
            if not self._split(chain, pieces):
                return
            del self.measured[0]
            if once:
                return

    def refine(self) -> None:
        """Replace the parts of spacing and bins by the change of one refinement, the largest part first, as far as the
        budget allows. A coarsening overstates the error of a discretisation that converges with higher order.
        """
        shares = dict.fromkeys(GRIDS, 0.0)
        for own in self.parts.values():
            total = sum(part.rms for part in own.values()) or 1.0
            for name in shares.keys() & own:
                shares[name] += own[name].rms / total
        for name in sorted(GRIDS, key=lambda name: -shares[name]):
            which = refinements(name) if shares[name] else ()
            pair = next(filter(None, (self.evaluations.most_of(*one) for one in which)), None)
            finer: Parts = {one: {} for one in self.parts}
            if pair is not None:
                made = pair[0][1].keys() & pair[1][1].keys()
                known = [one for one in self.affected[name] if name in self.parts[one] and one in made]
                compare(finer, self.missing, pair, name, known)
                for one, own in self.parts.items():
                    own.update(finer[one])

    def _grids(self, names: list[str]) -> Chain:
        """Return the chain from coarser bins and spacing to the bins and spacing of the pipeline."""
        own = [name for name in GRIDS if name in names]
        for chosen in (own, *([name] for name in own[::-1])):
            coarse = dict.fromkeys(chosen, -2)
            if chosen and self.evaluations.plan(coarse) is not None:
                steps = [({name: -2 for name in chosen[at:]}, "") for at in range(1, len(chosen))]
                self._set_apart(name for name in own if name not in chosen)
                return Chain(tuple(chosen), ((coarse, ""), *steps, PLANNED))
        self._set_apart(own)
        return Chain((), ())

    def _set_apart(self, names: Iterable[str]) -> None:
        """Record, for discretisations that cannot be coarsened, whether they can be refined or are fixed."""
        for name in names:
            if is_refinable(self.evaluations, name):
                self.apart.append(name)
            else:
                self.fixed[name] = self.evaluations.point.why_no_finer()

    def _rest(self, names: list[str], grids: Chain) -> Chain:
        """Return the chain to a wider margin, knobs one step finer and no omissions. It starts from few bands or, if
        light is cheap to compute or the budget too small for both chains, from the coarser grids of the first chain.
        """
        evaluations = self.evaluations
        planned = evaluations.planned_seconds
        cheap = planned < SMALL or evaluations.left < SCARCE * planned
        coarse = [grids.which[0][0]] if grids.which and cheap else []
        bases = (one for one in (*coarse, *BASES) if not one.keys() & {*self.fixed, *self.apart})
        base = next(one for one in bases if evaluations.plan(one) is not None)
        found, chosen = list[str](), base
        for name in (name for name in names if name not in GRIDS):
            if evaluations.plan({**chosen, name: 2}) is not None:
                found.append(name)
                chosen = {**chosen, name: 2}
            else:
                self._set_apart([name])
        steps: list[Which] = [({**base, **{name: 2 for name in found[:at]}}, "") for at in range(len(found) + 1)]
        own, nearer = evaluations.plan(chosen), evaluations.plan(chosen, NEARER)
        if nearer is None:
            for text in self.missing.values():
                text[OMISSIONS] = evaluations.point.why_no_reference()
        elif own is not None and computed_alike(own, nearer):
            for parts in self.parts.values():
                parts[OMISSIONS] = Part(0.0, 0.0)
        else:
            found, steps = [*found, OMISSIONS], [*steps, (chosen, NEARER)]
        return Chain(tuple(found), tuple(steps))

    def _at_once(self, grids: Chain, rest: Chain) -> bool:
        """If both chains start from the same evaluation, measure both at once, with one evaluation less than
        separately. Return whether they do. A variable that does not fit into the budget gets no part.
        """
        if rest.which[0] != grids.which[0]:
            return False
        whole = Chain((*grids.names, *rest.names), (rest.which[-1], PLANNED))
        if not self._ends(whole):
            return True
        *others, nearest = grids.steps()
        if others:  # the error of bins has the smallest factor and is often the largest part
            remaining = Chain((*others[0].names, *rest.names), (rest.which[-1], nearest.which[0]))
            self.measured += [(whole, [nearest, remaining]), (remaining, [*others, rest])]
        else:
            self.measured.append((whole, [grids, rest]))
        self._to_split(rest)
        return True

    def _to_split(self, chain: Chain) -> None:
        if len(chain.names) > 1:
            self.measured.append((chain, chain.steps()))

    def _ends(self, chain: Chain) -> bool:
        """Compare the ends of a chain; return whether this was affordable for any variable."""
        wanted = [one for one in self.parts if chain.label(self.affected, one)]
        unmet: Texts = {one: {} for one in self.parts}
        pair, seconds = attempt(self.evaluations, unmet, "", wanted, [Way(chain.ends)])
        self.dear += seconds
        for one in wanted:
            if unmet[one]:
                self.missing[one][chain.label(self.affected, one)] = unmet[one][""]
            elif pair is not None and pair.made:
                self._compare(self.parts, self.missing, pair.made, chain, one)
        return pair is not None and bool(pair.made)

    def _split(self, whole: Chain, pieces: list[Chain]) -> bool:
        """Replace the part of a chain by the parts of its pieces; return False if the budget does not allow it."""
        every = [one for piece in pieces for one in piece.ends]
        which = [one for number, one in enumerate(every) if one not in every[:number]]
        made = self.evaluations.most_of(*which)
        if made is None:
            return False
        pairs = [[made[which.index(one)] for one in piece.ends] for piece in pieces]
        for one, own in self.parts.items():
            label = whole.label(self.affected, one)
            apart: Parts = {one: {}}
            lacking: Texts = {one: {}}
            for piece, pair in zip(pieces, pairs, strict=True):
                self._compare(apart, lacking, pair, piece, one)
            if label in own and not lacking[one]:
                del own[label]
                own.update(apart[one])
        return True

    def _compare(self, parts: Parts, missing: Texts, pair: list[Evaluated], chain: Chain, one: StageVariable) -> None:
        if label := chain.label(self.affected, one):
            compare(parts, missing, pair, label, [one], chain.factor(label))

    def _lack(self, names: list[str], error: TooDear) -> None:
        """Record that planning alone exceeds the budget."""
        self.dear += error.seconds
        for name in (*names, OMISSIONS):
            for one in self.affected[name]:
                self.missing[one][name] = str(error)

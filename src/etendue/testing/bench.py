"""The test bench of a stage: grids, arrays, coordinates and random generators made from its declaration alone.

In:  an instance of a stage.
Out: ``BenchTrial`` values: the results of the engine's own ``compute.cell.compute`` for one cell.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import sys
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController

from etendue.archive.read.differing import apart, full_scale
from etendue.compute.cell import compute, smallest
from etendue.compute.job import Job, Looking, Walk
from etendue.compute.joined.segments import Result
from etendue.compute.strips import in_strips
from etendue.contract import wording
from etendue.contract.arrays import dims, variables
from etendue.contract.arrays.facts import Facts
from etendue.contract.arrays.grid import RGB, XYZ, Bands, Coordinate, Grid, Labels, Line
from etendue.contract.arrays.variables import Declaration
from etendue.contract.capabilities import is_random, is_source
from etendue.contract.class_checks import no_coordinates
from etendue.contract.ports import CellReport
from etendue.contract.stage import Stage, looks, looks_at_stages, reads_of, writes_of
from etendue.contract.values import quantities
from etendue.plan.expansion.forms import output_grid
from etendue.plan.model import CellRef
from etendue.testing import kept
from etendue.testing.examples import GUESSED, BlurAndSum, GaussianTransfer, edges, edges_of, exemplary, sheet
from etendue.types.arrays import Array

Frame = tuple[int, int]
Arrays = Mapping[str, Any]

PRECISIONS = ("float32", "float64")
FRAME: Frame = (9, 12)
SMALL: Frame = (4, 5)
LARGE: Frame = (119, 160)  # large enough for sums to lose digits
ODD_FRAMES: tuple[Frame, ...] = ((1, 1), (1, 7), (6, 1), (2, 2), (7, 5))
PLANE = ("y", "x")
SPACING = 2.0  # um, for light by band: a few samples of anything else fit into a frame
EXTREMES = ("zeros", "tiny", "huge", "uniform", "point", "hole", "hot")
HOT = 1e4  # value of one place among ordinary ones, in units of full scale
CLEAR = ("ValueError:", "OverflowError:", "ArithmeticError:")  # what a stage may raise if it cannot compute
ROUNDING = 1e-12  # error in double precision of a stage that states none


_pools = ThreadpoolController()  # thread pools of the libraries that the engine has loaded


class LawBroken(AssertionError):
    """A stage breaks its own declaration."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """One law that one stage breaks."""

    law: str
    message: str

    def __str__(self) -> str:
        return f"{self.law.removeprefix('test_').replace('_', ' ')}: {self.message}"


@dataclasses.dataclass(frozen=True)
class BenchTrial:
    """The result of computing one cell."""

    arrays: dict[str, Array]
    report: CellReport
    touched: tuple[str, ...]  # inputs that were changed

    @property
    def done(self) -> bool:
        return self.report.status == "done"

    @property
    def last_line(self) -> str:
        return self.report.message.strip().rpartition("\n")[2]

    @property
    def undefined(self) -> bool:
        """Whether the stage returned NaN or infinity without declaring it."""
        return not self.done and " wrote " in self.last_line and "NaN or infinite" in self.last_line

    @property
    def refused_in_words(self) -> bool:
        """Whether the stage refused the cell with a message of its own, instead of failing with another error."""
        return not self.undefined and (
            self.last_line.startswith(CLEAR) or self.last_line == self.report.message.strip()
        )


class Bench:
    """Makes grids, arrays and jobs for one instance of a stage, from its declaration."""

    def __init__(
        self,
        stage: Stage,
        grids: Mapping[str, Grid] | None = None,
        scales: Mapping[str, float] | None = None,
        coordinates: Mapping[str, Coordinate] | None = None,
    ) -> None:
        self.stage, self.kind = stage, type(stage)
        self.given_grids, self.scales, self.coordinates = dict(grids or {}), dict(scales or {}), dict(coordinates or {})
        self._grids: dict[Frame, dict[str, Grid]] = {}
        if wrong := no_coordinates(self.kind):
            raise LawBroken(wrong)

    @property
    def name(self) -> str:
        return repr(self.stage)

    @cached_property
    def reads(self) -> dict[str, Declaration]:
        """The ports that get arrays, without the ports through which a probe sees other stages."""
        return {port: d for port, d in reads_of(self.kind).items() if not looks(d)}

    @cached_property
    def looks(self) -> dict[str, str]:
        return {port: looks(d) for port, d in reads_of(self.kind).items() if looks(d)}

    @cached_property
    def writes(self) -> dict[str, Declaration]:
        return {d.variable: d for d in writes_of(self.kind).values()}

    @cached_property
    def steady(self) -> bool:
        """Whether the result is independent of the seed: no random argument, or a random argument without effect."""
        if not is_random(self.kind):
            return True
        first, second = (self.run(self.arrays("ordinary"), seed=seed) for seed in (b"one", b"two"))
        return first.done and second.done and digests(first.arrays) == digests(second.arrays)

    @cached_property
    def one_array(self) -> str | None:
        """The port of a stage that reads exactly one frame; None for other stages."""
        if len(self.reads) != 1 or self.looks:
            return None
        (port,) = self.reads
        return port if {"y", "x"} <= set(self.reads[port].dims) else None

    def coordinate(self, dim: str, declaration: Declaration, frame: Frame) -> Coordinate:
        if dim in self.coordinates:
            return self.coordinates[dim]
        if dims.dim(dim).bins:
            return Bands(edges_of(dim))
        if dim in ("y", "x"):
            size = frame[0 if dim == "y" else 1]
            if dims.banded((*declaration.dims, *_usual(declaration))):
                return Line(size, -0.5 * (size - 1) * SPACING, SPACING)
            name = dims.dim(dim).spacing  # the quantity that states it: the stage's value, else the default
            pitch = float(getattr(self.stage, name, quantities.declared(name).default)) if name else 1.0
            return Line(size, 0.0, 1.0, "1", (-0.5 * (size - 1) * pitch, pitch))
        if dim == "channel":
            return XYZ if declaration.variable.startswith("xyz") else RGB
        if dim == "component":
            return XYZ
        return self._made_elsewhere.get(dim) or exemplary(dim) or GUESSED

    @cached_property
    def _made_elsewhere(self) -> dict[str, Coordinate]:
        """The coordinates of dims that other stages of the same module create."""
        own = vars(sys.modules[self.kind.__module__]).values() if self.kind.__module__ in sys.modules else ()
        kinds = [
            one for one in own if isinstance(one, type) and issubclass(one, Stage) and isinstance(one.creates, Mapping)
        ]
        return {
            dim: one for kind in kinds for dim, one in kind.creates.items() if isinstance(one, Line | Bands | Labels)
        }

    def guessed(self) -> str:
        """Return a hint if the size of an input dim had to be guessed."""
        guessed = [dim for d in self.reads.values() for dim in d.dims if self.coordinate(dim, d, FRAME) is GUESSED]
        if not guessed or self.given_grids:
            return ""
        return (
            f". The dim {guessed[0]!r} is not declared, and was tested with three entries; if it has others, state "
            f"them next to "
            f"'stage' in the test: coordinates = {{{guessed[0]!r}: Labels((0.0, 45.0, 90.0, 135.0))}}"
        )

    def input_grids(self, frame: Frame = FRAME) -> dict[str, Grid]:
        if frame not in self._grids:
            self._grids[frame] = {
                port: self.given_grids.get(port) or Grid.of({dim: self.coordinate(dim, d, frame) for dim in d.dims})
                for port, d in self.reads.items()
            }
        return dict(self._grids[frame])

    def job(
        self, precision: str = "float64", frame: Frame = FRAME, seed: bytes = b"conformance", summed: bool = False
    ) -> Job:
        """Return the job of one cell, as the engine would make it."""
        looks_at = tuple(
            (port, what, tuple((n, (n, ())) for n in ("first", "second"))) for port, what in self.looks.items()
        )
        names = tuple((port, pairs) for port, _, pairs in looks_at)
        inputs = self.input_grids(frame)
        declared = self.stage.describe()[1] if is_source(self.kind) else self.stage.grid(inputs)  # type: ignore[attr-defined]
        grids = {v: output_grid(self.stage, d, declared.get(v), inputs, names) for v, d in self.writes.items()}
        transfers = "transfer" in self.looks.values()
        looking = Looking(
            ports=looks_at,
            transfers=(GaussianTransfer(), BlurAndSum() if summed else GaussianTransfer()) if transfers else (),
            bands=edges(),
            channel_weights=BlurAndSum() if summed and transfers else None,
            grids={
                port: (self.seen_grid(port, frame),) * 2
                for port, what in self.looks.items()
                if not looks_at_stages(what)
            },
            sheets=(sheet(),) * 2 if "datasheet" in self.looks.values() else (),
        )
        return Job(
            ref=("stage", ()),
            task="compute",
            stage=self.stage,
            writes=self.writes,
            grids=grids,
            input_grids=inputs,
            inputs=tuple((port, (port, ()), d.variable) for port, d in self.reads.items()),
            left_out=False,
            seed=seed,
            pattern_of=seed,
            precision=precision,
            store=(),
            deliver=tuple(self.writes),
            target=None,
            seconds=0.0,
            looking=looking if self.looks else None,
        )

    def scale(self, port: str) -> float:
        declaration = self.reads[port]
        return self.scales.get(port, wording.units().get(declaration.unit, wording.Unit()).full)

    def array(self, port: str, what: str, frame: Frame = FRAME, factor: float = 1.0) -> Array:
        """Return one input in double precision; ``what``: 'ordinary' values, 'decades' (six), or an extreme such as
        'point'.
        """
        declaration, grid = self.reads[port], self.input_grids(frame)[port]
        shape = grid.shape(declaration.dims)
        random = np.random.default_rng([1, *map(ord, port + what)])
        full = self.scale(port) * factor
        spread = random.uniform(0.1, 1.0, shape)
        whole = declaration.dtype != "float"
        if what == "decades":
            values = 10.0 ** random.uniform(-6, 0, shape)
        elif what in ("zeros", "point"):
            values = np.zeros(shape)
        elif what in ("uniform", "hole"):
            values = np.ones(shape)
        elif what == "faint":
            values = 1 + 1e-4 * (spread - 0.5)
        else:
            values = spread
        values = np.asarray(values * {"tiny": 1e-30 / full, "huge": 1e6}.get(what, 1.0))
        if what in ("point", "hole") and values.size:
            values[tuple(size // 2 for size in shape)] = 1.0 if what == "point" else 0.0
        if what == "hot" and values.size:
            values[tuple(size // 2 for size in shape)] = HOT
        values = np.asarray(values * full)
        return np.clip(np.rint(values), 0, np.iinfo(declaration.dtype).max) if whole else values

    def seen(self, port: str, precision: str, frame: Frame) -> Any:
        """Return the array that a probe sees through a port; it has the same value everywhere."""
        declaration = reads_of(self.kind)[port]
        shape = self.seen_grid(port, frame).shape(self._seen_dims(declaration))
        whole = declaration.dtype != "float"
        return np.full(shape, 100 if whole else 0.01, dtype=declaration.dtype if whole else precision)

    def seen_grid(self, port: str, frame: Frame) -> Grid:
        declaration = reads_of(self.kind)[port]
        return Grid.of({dim: self.coordinate(dim, declaration, frame) for dim in self._seen_dims(declaration)})

    @staticmethod
    def _seen_dims(declaration: Declaration) -> tuple[str, ...]:
        return declaration.dims or _usual(declaration) or PLANE

    def arrays(self, what: str, frame: Frame = FRAME, factor: float = 1.0) -> dict[str, Array]:
        return {port: self.array(port, what, frame, factor) for port in self.reads}

    def given(self, inputs: Arrays, precision: str) -> dict[str, Array]:
        """Return inputs as a stage gets them: read-only, in the given precision or the declared integer type."""
        found = {}
        for port, values in inputs.items():
            kind = precision if self.reads[port].dtype == "float" else self.reads[port].dtype
            array = np.array(values, dtype=kind, order="C")
            array.flags.writeable = False
            found[port] = array
        return found

    def run(
        self,
        inputs: Arrays,
        precision: str = "float64",
        frame: Frame = FRAME,
        seed: bytes = b"conformance",
        summed: bool = False,
        rows: int = 0,
    ) -> BenchTrial:
        """Compute one cell with the engine. With ``rows``, compute it in strips of that many rows; errors are then
        raised.
        """
        given = self.given(inputs, precision)
        before = digests(given)
        grids = tuple(self.input_grids(frame).items())
        key = (self.stage, tuple(before.items()), grids, precision, frame, seed, summed, rows)
        return kept.once(
            key, lambda: self._computed(self.job(precision, frame, seed, summed), given, before, precision, frame, rows)
        )

    def _computed(
        self, job: Job, given: Arrays, before: dict[str, str], precision: str, frame: Frame, rows: int
    ) -> BenchTrial:
        results: dict[CellRef, Result] = {
            (port, ()): Result(
                {self.reads[port].variable: a}, {self.reads[port].variable: smallest(a)} if a.dtype.kind == "f" else {}
            )
            for port, a in given.items()
        }
        planes = {
            port: self.seen(port, precision, frame) for port, what in self.looks.items() if not looks_at_stages(what)
        }
        for number, name in enumerate(("first", "second") if planes else (), 1):
            results[(name, ())] = Result(
                {self.looks[port]: (plane / number).astype(plane.dtype) for port, plane in planes.items()}
            )
        with _pools.limit(limits=1), np.errstate(all="ignore"):
            if rows:
                job.walk = Walk(0, 1, rows, tuple(job.writes))
                ((result, report),) = in_strips([job], results)
            else:
                result, report = compute(job, results)
        after = digests(given)
        return BenchTrial(result.arrays, report, tuple(port for port in given if before[port] != after[port]))

    def result(self, inputs: Arrays, precision: str = "float64", frame: Frame = FRAME, **how: Any) -> BenchTrial:
        """Compute one cell; raise ``LawBroken`` if it fails."""
        trial = self.run(inputs, precision, frame, **how)
        if not trial.done:
            raise LawBroken(f"{self.name} fails on ordinary input: {trial.report.message}{self.guessed()}")
        return trial

    def facts(self, inputs: Arrays) -> dict[str, Facts]:
        """Return the facts of these arrays."""
        return {port: facts_of(array, self.reads[port].dims) for port, array in inputs.items()}

    def full_scale(self, variable: str, array: Array, frame: Frame = FRAME) -> float:
        """Return the full scale of a result: its largest value; for integers, also the largest code that the stage
        writes for a far too bright input.
        """
        if self.writes[variable].dtype == "float" or not self.reads:
            return full_scale(array)
        brightest = self.run(self.arrays("huge", frame), frame=frame)
        return max(full_scale(array), full_scale(brightest.arrays.get(variable, array)))

    def own_error(self, inputs: Arrays, precision: str, frame: Frame = FRAME) -> float | None:
        """Return the error bound that the stage states."""
        if self.kind.error is Stage.error:
            return None
        facts = self.stage.describe()[0] if is_source(self.kind) else self.facts(inputs)  # type: ignore[attr-defined]
        return self.stage.error(facts, self.input_grids(frame), precision)[0]


def _usual(declaration: Declaration) -> tuple[str, ...]:
    """Return the declared dims of the variable that a probe looks at, if the probe itself names no dims."""
    seen = "" if declaration.dims else looks(declaration)
    return tuple(variables.variable(seen).dims) if seen else ()


def digests(arrays: Arrays) -> dict[str, str]:
    return {
        name: hashlib.sha256(f"{a.dtype.str}{a.shape}".encode() + a.tobytes()).hexdigest() for name, a in arrays.items()
    }


def facts_of(array: Array, dims: tuple[str, ...]) -> Facts:
    """Return the facts of an array: its range, and the uniformity and largest contrast over positions in any band or
    channel.
    """
    array = np.asarray(array, dtype=float)
    places = tuple(i for i, dim in enumerate(dims) if dim in ("y", "x"))
    if not array.size:
        return Facts()
    low, high = array.min(axis=places), array.max(axis=places)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(high == low, 1.0, high / low)
    positive = bool(np.all((low > 0) | (high == low)))
    return Facts(
        uniform=bool(np.all(low == high)) if places else None,
        low=float(array.min()),
        high=float(array.max()),
        contrast=float(ratios.max()) if positive else math.inf,
    )


def largest_difference(one: Array, other: Array) -> float:
    """Return the largest absolute difference of two arrays; infinite if a value is undefined in only one of them."""
    return float(apart(one, other).max(initial=0.0))

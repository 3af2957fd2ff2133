"""The conformance kit: every stage, ours or a stranger's, is held against its own declaration.

A plugin's test file is all of this (``tests/test_conformance.py``)::

    from etendue.testing import StageConformance
    from my_plugin.stages import MyStage

    class TestMyStage(StageConformance):
        stage = MyStage(iterations=5)

    class TestMyStageInTheDark(StageConformance):
        stage = MyStage(iterations=0)        # parameters for which `negligible` says more
        scales = {"charge": 10.0}            # full scale of a port, where the usual one is not the one that matters

From the declaration alone the kit makes grids, arrays, coordinates and random generators, and computes cells with the
engine's own ``run.cell.compute``, so that the two cannot disagree. Each test method is one law; a broken law names
the stage, the values and what to change. ``check_stage`` runs all laws of one instance without pytest and gives
``Finding`` values. A source is checked on the grid it describes: give it a small one. ``grids`` replaces the grid of
a port whose dims the kit cannot guess.

In:  an instance of a stage.
Out: nothing, or what it declares and does not do.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import math
import pickle
import threading
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from threadpoolctl import ThreadpoolController

from etendue.plan.cells import output_grid
from etendue.plan.model import CellRef
from etendue.plan.parameters import Unfit, resolve
from etendue.run.cell import Result, compute, prepared_of, smallest, transfer_of
from etendue.run.jobs import Job
from etendue.spec import camera
from etendue.spec.facts import Facts
from etendue.spec.grid import RGB, XYZ, Bands, Coordinate, Grid, Labels, Line
from etendue.spec.ports import CellReport
from etendue.spec.stage import (
    MISSING,
    Parameter,
    Probe,
    Stage,
    arguments_of,
    is_random,
    is_source,
    is_transfer,
    parameters_of,
    reads_of,
    writes_of,
)
from etendue.spec.units import UnitError, parse_unit
from etendue.spec.variables import Declaration

Frame = tuple[int, int]
Arrays = Mapping[str, Any]

PRECISIONS = ("float32", "float64")
FRAME: Frame = (9, 12)
SMALL: Frame = (4, 5)
LARGE: Frame = (119, 160)  # where sums are long enough to lose digits
ODD_FRAMES: tuple[Frame, ...] = ((1, 1), (1, 7), (6, 1), (2, 2), (7, 5))
EDGES = (500.0, 520.0, 540.0, 560.0, 580.0, 600.0)  # inside every table of silicon, colour and cameras
SPACING = 2.0  # um, of the light on the image plane: a few pixels fit into a frame
FULL_SCALE = {  # of an ordinary exposure, by unit
    "W m-2 sr-1 nm-1": 0.1,
    "W m-2 nm-1": 0.01,
    "electron/s": 1e6,
    "electron": 1e4,
    "DN": 4095.0,
}
EXTREMES = ("zeros", "tiny", "huge", "uniform", "point", "hole")
CLEAR = ("ValueError:", "OverflowError:", "ArithmeticError:")  # what a stage may raise where it cannot compute
ROUNDING = 1e-12  # of double precision, where a stage states no error of its own


_pools = ThreadpoolController()  # of the libraries which the engine has loaded


class LawBroken(AssertionError):
    """A stage does not do what it declares."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """One law that one stage breaks."""

    law: str
    message: str

    def __str__(self) -> str:
        return f"{self.law.removeprefix('test_').replace('_', ' ')}: {self.message}"


@dataclasses.dataclass(frozen=True)
class Trial:
    """What came of one cell."""

    arrays: dict[str, Any]
    report: CellReport
    touched: tuple[str, ...]  # inputs that were changed

    @property
    def done(self) -> bool:
        return self.report.status == "done"

    @property
    def last_line(self) -> str:
        return self.report.message.strip().rpartition("\n")[2]


class _Blur(Stage):
    """What probes look at: a Gaussian transfer function."""

    def transfer(self, fy: Any, fx: Any, wavelength: Any) -> Any:
        return np.exp(-4.0 * (fy**2 + fx**2)) * np.ones_like(wavelength)


class _Sum(Stage):
    """The same, ending in a sum over wavelength."""

    def transfer(self, fy: Any, fx: Any, wavelength: Any, prepared: Any) -> Any:
        return np.exp(-4.0 * (fy**2 + fx**2)) * np.ones_like(wavelength)

    def prepare(self, coordinates: Any) -> Any:
        return np.stack([np.linspace(low, 1.0, coordinates["wavelength"].size) for low in (0.1, 0.5, 0.9)])

    def weights(self, prepared: Any) -> Any:
        return prepared


# -- the environment of one stage -------------------------------------------------------------------------


class Bench:
    """Grids, arrays and jobs for one instance of a stage, from its declaration."""

    def __init__(self, stage: Stage, grids: Mapping[str, Grid] | None = None, scales: Mapping[str, float] | None = None) -> None:
        self.stage, self.kind = stage, type(stage)
        self.given_grids, self.scales = dict(grids or {}), dict(scales or {})

    @property
    def name(self) -> str:
        return repr(self.stage)

    @cached_property
    def reads(self) -> dict[str, Declaration]:
        """Ports that are given arrays; what a probe looks at is not among them."""
        return {port: d for port, d in reads_of(self.kind).items() if not d.variable.startswith("*.")}

    @cached_property
    def looks(self) -> dict[str, str]:
        return {port: d.variable[2:] for port, d in reads_of(self.kind).items() if d.variable.startswith("*.")}

    @cached_property
    def writes(self) -> dict[str, Declaration]:
        return {d.variable: d for d in writes_of(self.kind).values()}

    @cached_property
    def steady(self) -> bool:
        """Whether the result does not hang on the seed: no random argument, or one without effect."""
        if not is_random(self.kind):
            return True
        first, second = (self.run(self.arrays("ordinary"), seed=seed) for seed in (b"one", b"two"))
        return first.done and second.done and digests(first.arrays) == digests(second.arrays)

    @cached_property
    def one_array(self) -> str | None:
        """The port of a stage that reads one frame and nothing else."""
        if len(self.reads) != 1 or self.looks:
            return None
        (port,) = self.reads
        return port if {"y", "x"} <= set(self.reads[port].dims) else None

    def coordinate(self, dim: str, declaration: Declaration, frame: Frame) -> Coordinate:
        if dim == "wavelength":
            return Bands(EDGES)
        if dim in ("y", "x"):
            size = frame[0 if dim == "y" else 1]
            if "wavelength" in declaration.dims:
                return Line(size, -0.5 * (size - 1) * SPACING, SPACING)
            pitch = float(getattr(self.stage, "pixel_pitch", camera.default("pixel_pitch")))
            return Line(size, 0.0, 1.0, "1", (-0.5 * (size - 1) * pitch, pitch))
        if dim == "channel":
            return XYZ if declaration.variable.startswith("xyz") else RGB
        return XYZ if dim == "component" else Labels((0.0, 1.0, 2.0))

    def input_grids(self, frame: Frame = FRAME) -> dict[str, Grid]:
        grids = {}
        for port, declaration in self.reads.items():
            dims = [dim for dim in declaration.dims if dim != "..."]
            grids[port] = self.given_grids.get(port) or Grid.of({dim: self.coordinate(dim, declaration, frame) for dim in dims})
        return grids

    def job(self, precision: str = "float64", frame: Frame = FRAME, seed: bytes = b"conformance", summed: bool = False) -> Job:
        """The job of one cell, as the engine would make it."""
        looks_at = tuple((port, what, tuple((n, (n, ())) for n in ("first", "second"))) for port, what in self.looks.items())
        names = tuple((port, pairs) for port, _, pairs in looks_at)
        inputs = self.input_grids(frame)
        if is_source(self.kind):
            declared = self.stage.describe()[1]  # type: ignore[attr-defined]
        else:
            declared = self.stage.grid(inputs) if hasattr(self.stage, "grid") else {}
        grids = {v: output_grid(self.stage, d, declared.get(v), inputs, names) for v, d in self.writes.items()}
        transfers = "transfer" in self.looks.values()
        return Job(
            ref=("stage", ()), task="compute", stage=self.stage, writes=self.writes, grids=grids, input_grids=inputs,
            inputs=tuple((port, (port, ()), d.variable) for port, d in self.reads.items()), looks_at=looks_at,
            transfers=(_Blur(), _Sum() if summed else _Blur()) if transfers else (), bands=EDGES if self.looks else (),
            channel_weights=_Sum() if summed and transfers else None, previous=None, left_out=False, seed=seed, sensor_seed=seed,
            precision=precision, store=(), deliver=tuple(self.writes), spectrum=False, target=None, seconds=0.0,
        )  # fmt: skip

    def scale(self, port: str) -> float:
        declaration = self.reads[port]
        return self.scales.get(port, FULL_SCALE.get(declaration.unit, 1.0))

    def array(self, port: str, what: str, frame: Frame = FRAME, factor: float = 1.0) -> Any:
        """One input, in double precision: ordinary values, six decades of them, or an extreme."""
        declaration, grid = self.reads[port], self.input_grids(frame)[port]
        shape = grid.shape(tuple(dim for dim in declaration.dims if dim != "..."))
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
        else:
            values = spread
        values = values * {"tiny": 1e-30 / full, "huge": 1e6}.get(what, 1.0)
        if what in ("point", "hole") and values.size:
            values[tuple(size // 2 for size in shape)] = 1.0 if what == "point" else 0.0
        values = np.asarray(values * full)
        return np.clip(np.rint(values), 0, np.iinfo(declaration.dtype).max) if whole else values

    def arrays(self, what: str, frame: Frame = FRAME, factor: float = 1.0) -> dict[str, Any]:
        return {port: self.array(port, what, frame, factor) for port in self.reads}

    def given(self, inputs: Arrays, precision: str) -> dict[str, Any]:
        """Inputs as a stage gets them: in the plan's precision or the declared integers, read-only."""
        found = {}
        for port, values in inputs.items():
            kind = precision if self.reads[port].dtype == "float" else self.reads[port].dtype
            array = np.array(values, dtype=kind, order="C")
            array.flags.writeable = False
            found[port] = array
        return found

    def run(
        self, inputs: Arrays, precision: str = "float64", frame: Frame = FRAME, seed: bytes = b"conformance", summed: bool = False
    ) -> Trial:
        """Compute one cell with the engine."""
        job = self.job(precision, frame, seed, summed)
        given = self.given(inputs, precision)
        results: dict[CellRef, Result] = {
            (port, ()): Result({self.reads[port].variable: a}, {self.reads[port].variable: smallest(a)} if a.dtype.kind == "f" else {})
            for port, a in given.items()
        }
        planes = {what: np.full((len(EDGES) - 1, *frame), 0.01, dtype=precision) for what in self.looks.values() if what != "transfer"}
        for number, name in enumerate(("first", "second") if planes else (), 1):
            results[(name, ())] = Result({what: plane / number for what, plane in planes.items()})
        before = digests(given)
        with _pools.limit(limits=1), np.errstate(all="ignore"):
            result, report = compute(job, results)
        after = digests(given)
        return Trial(result.arrays, report, tuple(port for port in given if before[port] != after[port]))

    def result(self, inputs: Arrays, precision: str = "float64", frame: Frame = FRAME, **how: Any) -> Trial:
        """The same, where it must succeed."""
        trial = self.run(inputs, precision, frame, **how)
        if not trial.done:
            raise LawBroken(f"{self.name} fails on ordinary input: {trial.report.message}")
        return trial

    def facts(self, inputs: Arrays) -> dict[str, Facts]:
        """What is true of these arrays."""
        return {port: facts_of(array, self.reads[port].dims) for port, array in inputs.items()}

    def full_scale(self, variable: str, array: Any, frame: Frame = FRAME) -> float:
        """The largest value of a result; of whole numbers the largest code which the stage gives to too bright an input."""
        if self.writes[variable].dtype == "float" or not self.reads:
            return full_scale(array)
        brightest = self.run(self.arrays("huge", frame), frame=frame)
        return max(full_scale(array), full_scale(brightest.arrays.get(variable, array)))

    def own_error(self, inputs: Arrays, precision: str, frame: Frame = FRAME) -> float | None:
        """The bound the stage states for itself."""
        if not hasattr(self.stage, "error"):
            return None
        facts = self.stage.describe()[0] if is_source(self.kind) else self.facts(inputs)  # type: ignore[attr-defined]
        return self.stage.error(facts, self.input_grids(frame), precision)[0]


def digests(arrays: Arrays) -> dict[str, str]:
    return {name: hashlib.sha256(f"{a.dtype}{a.shape}".encode() + a.tobytes()).hexdigest() for name, a in arrays.items()}


def facts_of(array: Any, dims: tuple[str, ...]) -> Facts:
    """Facts of an array: uniform and contrast over positions, at every wavelength and channel."""
    array = np.asarray(array, dtype=float)
    names = [dim for dim in dims if dim != "..."]
    places = tuple(i for i, dim in enumerate(names) if dim in ("y", "x"))
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


def full_scale(array: Any) -> float:
    found = np.abs(np.asarray(array, dtype=float))
    return float(np.nanmax(found)) if found.size and not np.isnan(found).all() else 0.0


def largest_difference(one: Any, other: Any) -> float:
    """Largest absolute difference; infinite where only one of the two is undefined."""
    one, other = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    if np.any(np.isnan(one) != np.isnan(other)):
        return math.inf
    with np.errstate(invalid="ignore"):
        return full_scale(np.where(one == other, 0.0, one - other))  # equal infinities differ by nothing


# -- the laws ---------------------------------------------------------------------------------------------


class StageConformance:
    """Subclass it, set ``stage``, and pytest holds the stage against each law.

    Attributes
    ----------
    stage : the instance to check (set it in a fixture when it needs files)
    grids : grids by port, for dims the kit cannot guess
    scales : full scale by port, in its unit
    """

    stage: Stage
    grids: ClassVar[Mapping[str, Grid]] = {}
    scales: ClassVar[Mapping[str, float]] = {}

    @property
    def bench(self) -> Bench:
        return Bench(self.stage, self.grids, self.scales)

    # -- what it says

    def test_the_declaration_is_well_formed(self) -> None:
        """Ports, dims and units are readable, arguments are named, policies are words the engine knows."""
        kind, name = type(self.stage), type(self.stage).__name__
        try:
            reads, writes = reads_of(kind), writes_of(kind)
            arguments_of(kind), parameters_of(kind)
        except (TypeError, ValueError) as error:
            raise LawBroken(f"{name}: {error}") from None
        _hold(bool(writes), f"{name} writes nothing")
        _hold(hasattr(kind, "run") != hasattr(kind, "transfer"), f"{name} needs either run or transfer")
        _hold(kind.nan in ("error", "keep"), f"{name}.nan is {kind.nan!r}; allowed are 'error' and 'keep'")
        _hold(kind.negative in ("error", "clip", "keep"), f"{name}.negative is {kind.negative!r}; allowed are 'error', 'clip' and 'keep'")
        _hold(kind.gain is None or 0 <= kind.gain < math.inf, f"{name}.gain is {kind.gain}; allowed are None and finite numbers from 0")
        looks = [d.variable for d in reads.values() if d.variable.startswith("*.")]
        _hold(not looks or issubclass(kind, Probe), f"{name} looks at all stages ({', '.join(looks)}), which only a Probe may")
        _hold(not is_source(kind) or not reads, f"{name} has describe, as a source has, but reads {', '.join(reads)}")
        _hold(not is_transfer(kind) or len(reads) == 1 == len(writes), f"{name} has transfer: it reads and writes one variable each")
        for library in kind.libraries:
            try:
                importlib.metadata.version(library)
            except importlib.metadata.PackageNotFoundError:
                raise LawBroken(f"{name}.libraries names {library!r}, which is no installed distribution") from None

    def test_it_is_a_value(self) -> None:
        """Frozen, hashable, equal to its copy, and its repr and its pickle give it back."""
        stage, kind = self.stage, type(self.stage)
        for field in dataclasses.fields(stage):
            try:
                setattr(stage, field.name, getattr(stage, field.name))
            except dataclasses.FrozenInstanceError:
                continue
            raise LawBroken(f"{kind.__name__}.{field.name} can be changed: write @dataclass(frozen=True, kw_only=True)")
        try:
            hash(stage)
        except TypeError as error:
            raise LawBroken(f"{stage!r} is not hashable: {error}") from None
        _hold(dataclasses.replace(stage) == stage, f"a copy of {stage!r} is not equal to it")
        try:
            same = pickle.loads(pickle.dumps(stage)) == stage
        except Exception as error:
            raise LawBroken(f"{stage!r} cannot travel to another process: {error}") from None
        _hold(same, f"pickle gives {stage!r} back as another value: other processes would compute something else")
        text = repr(stage)
        try:
            again = eval(text.replace(kind.__qualname__, kind.__name__, 1), {"inf": math.inf, kind.__name__: kind})
        except Exception as error:
            raise LawBroken(f"the repr {text} cannot be read back: {error}") from None
        _hold(again == stage, f"the repr {text} gives back another value")

    def test_every_parameter_has_a_unit_and_refuses_what_is_out_of_range(self) -> None:
        for name, (parameter, kind, default) in parameters_of(type(self.stage)).items():
            _check_parameter(f"{type(self.stage).__name__}.{name}", name, parameter, kind, default, self.stage)

    def test_the_grid_is_a_pure_function(self) -> None:
        """Asked twice it says the same, of grids it leaves alone, for any size of frame or with a clear refusal."""
        stage = self.stage
        if is_source(type(stage)):
            _hold(stage.describe() == stage.describe(), f"{stage!r} describes itself differently when asked twice")  # type: ignore[attr-defined]
            return
        if not hasattr(stage, "grid"):
            return
        for frame in (FRAME, *ODD_FRAMES):
            given = self.bench.input_grids(frame)
            kept = dict(given)
            try:
                first, second = stage.grid(given), stage.grid(dict(given))
            except ValueError as error:
                _hold(frame != FRAME, f"{stage!r}.grid refuses an ordinary grid: {error}")
                continue
            _hold(given == kept, f"{stage!r}.grid changes the mapping it is given")
            _hold(first == second, f"{stage!r}.grid gives another grid when asked again")
            unknown = sorted(set(first) - set(self.bench.writes))
            _hold(not unknown, f"{stage!r}.grid speaks of {', '.join(unknown)}, which it does not write")
            _hold(all(isinstance(g, Grid) for g in first.values()), f"{stage!r}.grid gives something that is no Grid")

    # -- what it does

    def test_it_writes_what_it_declares(self) -> None:
        """Names, shape, dtype, and finite values unless declared otherwise: the engine's own check, in both precisions."""
        bench = self.bench
        for precision in PRECISIONS:
            for summed in (False, True) if bench.looks else (False,):
                trial = bench.result(bench.arrays("ordinary"), precision, summed=summed)
                for variable, declaration in bench.writes.items():
                    wanted, found = precision if declaration.dtype == "float" else declaration.dtype, trial.arrays[variable].dtype
                    _hold(found == wanted, f"{bench.name} wrote {variable} as {found}, not {wanted}")

    def test_inputs_are_left_alone(self) -> None:
        bench = self.bench
        for precision in PRECISIONS:
            trial = bench.run(bench.arrays("ordinary"), precision)
            _hold("read-only" not in trial.last_line, f"{bench.name} writes into its input: {trial.last_line}")
            _hold(not trial.touched, f"{bench.name} changes its input {', '.join(trial.touched)}")

    def test_bits_do_not_depend_on_repetition_company_or_thread(self) -> None:
        """The same cell again, after others, as an equal instance in a fresh thread: the same bits."""
        bench = self.bench
        for precision in PRECISIONS:
            inputs = bench.arrays("ordinary")
            first = digests(bench.result(inputs, precision).arrays)
            again = digests(bench.result(inputs, precision).arrays)
            _hold(again == first, f"{bench.name} gives other bits when run again in {precision}")
            for other in ("decades", "uniform", "zeros"):
                bench.run(bench.arrays(other), precision)
            if not is_source(bench.kind):
                for frame in (SMALL, (FRAME[0] + 1, FRAME[1])):
                    try:
                        bench.run(bench.arrays("ordinary", frame), precision, frame)
                    except ValueError:
                        continue  # a grid it refuses: another law's subject
            again = digests(bench.result(inputs, precision).arrays)
            _hold(again == first, f"{bench.name} gives other bits after other cells in {precision}")
            twin = Bench(dataclasses.replace(bench.stage), bench.given_grids, bench.scales)
            again = digests(_in_a_fresh_thread(twin, inputs, precision).arrays)
            _hold(again == first, f"{bench.name} gives other bits in a fresh thread in {precision}")

    def test_extremes_stay_finite_or_are_refused_clearly(self) -> None:
        """Zeros, 1e-30, a million times full scale, a point, a hole; frames of one pixel, one row, one column, odd sizes."""
        bench = self.bench
        for precision in PRECISIONS:
            for what in EXTREMES if bench.reads else ():
                _survives(bench, bench.arrays(what), precision, FRAME, what)
                for port in bench.reads if len(bench.reads) > 1 else ():
                    _survives(bench, {**bench.arrays("ordinary"), port: bench.array(port, what)}, precision, FRAME, f"{what} in {port}")
            for frame in ODD_FRAMES if bench.reads and not bench.given_grids else ():
                for what in ("ordinary", "zeros"):
                    _survives(bench, bench.arrays(what, frame), precision, frame, f"{what} on {frame[0]} x {frame[1]}")

    # -- policies

    def test_undefined_input_meets_the_declared_policy(self) -> None:
        bench = self.bench
        for port, declaration in bench.reads.items():
            for bad in (math.nan, math.inf) if declaration.dtype == "float" else ():
                trial = bench.run({**bench.arrays("ordinary"), port: _with(bench.array(port, "ordinary"), bad)})
                if bench.stage.nan == "keep":
                    _hold(trial.done, f"{bench.name} declares nan = 'keep', but fails on {bad} in {port}: {trial.last_line}")
                else:
                    _hold(not trial.done, f"{bench.name} lets {bad} in {port} pass; declare nan = 'keep' if that is meant")

    def test_negative_input_meets_the_declared_policy(self) -> None:
        bench = self.bench
        policy = bench.stage.negative
        for port, declaration in bench.reads.items():
            if declaration.dtype != "float":
                continue
            ordinary = bench.arrays("ordinary")
            below = _with(ordinary[port], -0.01 * bench.scale(port))
            trial = bench.run({**ordinary, port: below})
            if policy == "keep":
                clear = trial.done or trial.last_line.startswith(CLEAR)
                _hold(clear, f"{bench.name} declares negative = 'keep', but fails on it in {port}: {trial.last_line}")
            elif policy == "clip":
                same = bench.result({**ordinary, port: np.maximum(below, 0)})
                kept = trial.done and digests(trial.arrays) == digests(same.arrays) and trial.report.clipped > 0
                _hold(kept, f"{bench.name} declares negative = 'clip', but negative {port} is not as if it were 0, and counted")
            else:
                hint = "; a transfer function is applied to any sign: declare negative = 'keep'" if is_transfer(bench.kind) else ""
                _hold(not trial.done, f"{bench.name} lets negative {port} pass{hint or '; declare negative = keep if that is meant'}")

    # -- claims

    def test_the_stated_error_is_true_of_single_against_double_precision(self) -> None:
        """Bound and how it is known; two results within their bounds lie within the sum of the bounds.

        Relative to full scale: the largest value of the result in double precision, or a converter's top code.
        """
        bench = self.bench
        if not hasattr(bench.stage, "error"):
            return
        bounds: dict[str, float] = {}
        for precision in PRECISIONS:
            bound, how = _stated_error(bench, precision)
            _hold(how in ("proved", "fitted", "measured", "unknown"), f"{bench.name}.error says {how!r}; allowed: proved, fitted, measured")
            _hold(bound is None or 0 <= bound < math.inf, f"{bench.name}.error gives {bound}; allowed are None and finite numbers from 0")
            if bound is not None:
                bounds[precision] = bound
        if len(bounds) < 2 or not bench.steady:
            return
        _hold(bounds["float64"] <= bounds["float32"], f"{bench.name}.error is larger in double precision than in single: {bounds}")
        large = [("ordinary", 1.0, LARGE)] if bench.reads and not bench.given_grids else []
        for what, factor, frame in (*((*level, FRAME) for level in _levels(bench)), *large):
            inputs = bench.given(bench.arrays(what, frame, factor), "float32")
            allowed = sum(_bound(bench, inputs, precision, frame=frame) for precision in PRECISIONS)
            single, double = bench.run(inputs, "float32", frame), bench.run(inputs, "float64", frame)
            if not (single.done and double.done):
                continue  # refused: another law's subject
            for variable, exact in double.arrays.items():
                apart, scale = largest_difference(single.arrays[variable], exact), bench.full_scale(variable, exact, frame)
                _hold(
                    apart <= allowed * scale,
                    f"{bench.name}: single and double precision of {variable} differ by {_ratio(apart, scale):.2g} of full scale on {what} "
                    f"input x {factor:g} of {frame[0]} x {frame[1]}, but error() allows {allowed:.2g}; "
                    "state what is true, or find where the digits go",
                )

    def test_leaving_it_out_is_no_worse_than_negligible_says(self) -> None:
        bench = self.bench
        if not hasattr(bench.stage, "negligible"):
            return
        main = next(iter(bench.writes))
        port = next((p for p, d in bench.reads.items() if d.variable == main), None)
        _hold(port is not None, f"{bench.name} has negligible, but does not read {main}, which it writes")
        assert port is not None
        for what, factor in (*_levels(bench), ("point", 1.0), ("hole", 1.0)):
            inputs = bench.arrays(what, factor=factor)
            answer = bench.stage.negligible(bench.facts(inputs)[port], bench.input_grids()[port])  # type: ignore[attr-defined]
            if answer is None:
                continue
            bound, why = answer
            _hold(bound >= 0 and bool(why), f"{bench.name}.negligible gives {answer}, not (a bound from 0, the reason)")
            if bound > 0 and not bench.steady:
                continue
            trial = bench.result(inputs)
            for variable in bench.writes:
                own = next(p for p, d in bench.reads.items() if d.variable == variable)
                scale = full_scale(inputs[own])
                apart = largest_difference(trial.arrays[variable], inputs[own])
                slack = _bound(bench, inputs, "float64", ROUNDING)
                _hold(
                    apart <= (bound + slack) * scale,
                    f"{bench.name}: leaving it out changes {variable} by {_ratio(apart, scale):.2g} of full scale on {what} input, "
                    f"but negligible() says {bound:.2g} ({why})",
                )

    def test_errors_grow_by_no_more_than_the_gain(self) -> None:
        """Pairs of inputs: random, shifted, and with the signs that hurt most, at several levels and sizes of error.

        Errors are relative to full scale: the largest value of what is read; of what is written, its largest value
        for this input or for a uniform field as bright as its brightest point. The stage's own error comes on top.
        """
        bench = self.bench
        port = bench.one_array
        if bench.stage.gain is None or port is None or not bench.steady:
            return
        main = next(iter(bench.writes))
        frames = (FRAME, SMALL)
        for frame in frames:
            worst = _worst_signs(bench, port, main) if frame == SMALL else None
            for level in (1e-2, 1.0, 1e2):
                for what in ("ordinary", "decades"):
                    inputs = bench.arrays(what, frame, level)
                    for size in (0.1, 1e-4):
                        for signs in _perturbations(inputs[port].shape, worst):
                            _check_gain(bench, port, main, inputs, size * signs, frame)

    def test_a_transfer_function_keeps_the_mean_and_a_real_image_real(self) -> None:
        """1 at zero frequency, Hermitian, and never above 1 unless a larger ``gain`` says so."""
        bench = self.bench
        if not is_transfer(bench.kind):
            return
        grids = bench.input_grids()
        prepared = prepared_of(bench.stage, grids, bench.job().grids)
        axis = np.array([-0.7, -0.31, -0.05, 0.0, 0.05, 0.31, 0.7])
        value = np.asarray(transfer_of(bench.stage, axis[:, None], axis[None, :], EDGES, prepared))
        _hold(value.shape[-2:] == (7, 7) and value.ndim in (2, 3), f"{bench.name}.transfer has shape {value.shape}, not (wavelength, y, x)")
        _hold(value.ndim == 2 or value.shape[0] in (1, len(EDGES) - 1), f"{bench.name}.transfer has {value.shape[0]} planes for 5 bands")
        _hold(bool(np.isfinite(value).all()), f"{bench.name}.transfer is not finite")
        centre = np.abs(value[..., 3, 3] - 1).max()
        _hold(centre <= 1e-12, f"{bench.name}.transfer is 1 {'+-'} {centre:.2g} at zero frequency: it makes or loses light")
        uneven = np.abs(value[..., ::-1, ::-1] - np.conj(value)).max()
        _hold(uneven <= 1e-12, f"{bench.name}.transfer(-f) is {uneven:.2g} from the conjugate of transfer(f): a real image turns complex")
        wide = np.linspace(-3.0, 3.0, 61)
        highest = np.abs(transfer_of(bench.stage, wide[:, None], wide[None, :], EDGES, prepared)).max()
        limit = max(1.0, bench.stage.gain or 1.0)
        _hold(highest <= limit * (1 + 1e-9), f"|{bench.name}.transfer| reaches {highest:.6g}; declare a gain if it may amplify")
        if hasattr(bench.stage, "weights"):
            weights = np.asarray(bench.stage.weights(prepared))
            right = weights.ndim == 2 and weights.shape[1] == len(EDGES) - 1 and bool(np.isfinite(weights).all())
            _hold(right, f"{bench.name}.weights has shape {weights.shape}, not (channel, {len(EDGES) - 1}), or is not finite")

    def test_carried_facts_are_true_of_what_is_written(self) -> None:
        """Range, uniformity and contrast of the first variable; of a source, what ``describe`` says."""
        bench = self.bench
        main = next(iter(bench.writes))
        if is_source(bench.kind):
            facts, grids = bench.stage.describe()  # type: ignore[attr-defined]
            _hold(set(grids) <= set(bench.writes), f"{bench.name}.describe speaks of variables it does not write")
            trial = bench.result({})
            _facts_hold(bench, facts, trial.arrays[main], 1e-9, "what it draws")
            return
        if not hasattr(bench.stage, "carry") or not bench.steady:
            return
        for what, factor in (*_levels(bench), ("point", 1.0), ("hole", 1.0)):
            inputs = bench.arrays(what, factor=factor)
            trial = bench.run(inputs)
            if trial.done:
                facts = bench.stage.carry(bench.facts(inputs), bench.input_grids())  # type: ignore[attr-defined]
                _facts_hold(bench, facts, trial.arrays[main], _bound(bench, inputs, "float64", ROUNDING), f"{what} input")


def laws() -> list[str]:
    """The names of the laws, in order."""
    return [name for name in vars(StageConformance) if name.startswith("test_")]


def check_stage(stage: Stage, grids: Mapping[str, Grid] | None = None, scales: Mapping[str, float] | None = None) -> list[Finding]:
    """Hold one stage against every law; the findings, none when it conforms."""
    one = type("Conformance", (StageConformance,), {"stage": stage, "grids": grids or {}, "scales": scales or {}})()
    findings = []
    for law in laws():
        try:
            getattr(one, law)()
        except Exception as error:  # a stage may break anywhere, in grid or describe too
            text = str(error) if isinstance(error, LawBroken) else f"{type(error).__name__}: {error}"
            findings.append(Finding(law, text))
    return findings


# -- parts of the laws ------------------------------------------------------------------------------------


def _hold(condition: bool, otherwise: str) -> None:
    if not condition:
        raise LawBroken(otherwise)


def _ratio(apart: float, scale: float) -> float:
    return apart / scale if scale else math.inf


def _in_a_fresh_thread(bench: Bench, inputs: Arrays, precision: str) -> Trial:
    found: list[Trial] = []
    thread = threading.Thread(target=lambda: found.append(bench.run(inputs, precision)))
    thread.start()
    thread.join()
    _hold(bool(found), f"{bench.name} cannot be computed in a fresh thread")
    return found[0]


def _with(array: Any, value: float) -> Any:
    """A copy with one value replaced."""
    changed = np.array(array, dtype=float)
    changed.flat[changed.size // 2] = value
    return changed


def _levels(bench: Bench) -> Iterator[tuple[str, float]]:
    if not bench.reads:
        yield "ordinary", 1.0
        return
    yield from (("ordinary", 1.0), ("decades", 1.0), ("uniform", 1.0), ("ordinary", 1e-3), ("ordinary", 1e2))


def _stated_error(bench: Bench, precision: str) -> tuple[float | None, str]:
    inputs = bench.arrays("ordinary")
    facts = bench.stage.describe()[0] if is_source(bench.kind) else bench.facts(inputs)  # type: ignore[attr-defined]
    answer = bench.stage.error(facts, bench.input_grids(), precision)  # type: ignore[attr-defined]
    _hold(isinstance(answer, tuple) and len(answer) == 2, f"{bench.name}.error gives {answer!r}, not (bound, how)")
    return answer


def _bound(bench: Bench, inputs: Arrays, precision: str, otherwise: float = 0.0, frame: Frame = FRAME) -> float:
    bound = bench.own_error(inputs, precision, frame)
    return max(otherwise, bound or 0.0)


def _survives(bench: Bench, inputs: Arrays, precision: str, frame: Frame, what: str) -> None:
    try:
        trial = bench.run(inputs, precision, frame)
    except ValueError:
        return  # the grid is refused, before anything runs
    if trial.done:
        return
    message = trial.last_line
    wrote = message.startswith(f"{type(bench.stage).__name__} wrote ") or message.startswith(f"{type(bench.stage).__name__} gave ")
    clear = message.startswith(CLEAR) or (trial.report.message == message and not wrote)
    _hold(clear, f"{bench.name} on {what} input in {precision}: {message}")


def _perturbations(shape: tuple[int, ...], worst: Any) -> Iterator[Any]:
    random = np.random.default_rng(7)
    yield random.uniform(-1.0, 1.0, shape)
    yield np.ones(shape)
    if worst is not None:
        yield worst
        yield -worst


def _worst_signs(bench: Bench, port: str, main: str) -> Any:
    """Signs of the row with the largest sum in the derivative of the result by the input, on a small frame."""
    base = np.full_like(bench.array(port, "uniform", SMALL), 0.5 * bench.scale(port))
    step = 1e-2 * bench.scale(port)
    reference = bench.result({port: base}, frame=SMALL).arrays[main].astype(float)
    columns = []
    for place in range(base.size):
        moved = base.copy()
        moved.flat[place] += step
        columns.append((bench.result({port: moved}, frame=SMALL).arrays[main].astype(float) - reference).ravel())
    derivative = np.array(columns)
    row = int(np.abs(derivative).sum(axis=0).argmax())
    return np.where(derivative[:, row] < 0, -1.0, 1.0).reshape(base.shape)


def _check_gain(bench: Bench, port: str, main: str, inputs: Arrays, change: Any, frame: Frame) -> None:
    brightest = full_scale(inputs[port])
    other = inputs[port] + change * brightest
    if bench.reads[port].dtype != "float":
        other = np.clip(np.rint(other), 0, np.iinfo(bench.reads[port].dtype).max)
    elif bench.stage.negative != "keep":
        other = np.maximum(other, 0.0)
    apart_in = largest_difference(inputs[port], other) / brightest
    trials = [bench.run({port: array}, frame=frame) for array in (inputs[port], other, np.full_like(other, brightest))]
    if not all(trial.done for trial in trials):
        return
    first, second, uniform = (trial.arrays[main] for trial in trials)
    scale = max(bench.full_scale(main, first, frame), full_scale(uniform))
    apart = largest_difference(first, second)
    own = 2 * _bound(bench, inputs, "float64", ROUNDING, frame)
    gain = bench.stage.gain
    assert gain is not None
    _hold(
        apart <= (gain * apart_in * (1 + 1e-9) + own) * scale,
        f"{bench.name}: an error of {apart_in:.2g} of full scale in {port} became {_ratio(apart, scale):.2g} of full scale in {main}, "
        f"{_ratio(apart, scale * apart_in):.3g} times as large, but gain is {gain:g}; declare a larger one, or None",
    )


def _facts_hold(bench: Bench, facts: Facts, array: Any, slack: float, where: str) -> None:
    _hold(isinstance(facts, Facts), f"{bench.name} gives {facts!r} as facts")
    true = facts_of(array, bench.writes[next(iter(bench.writes))].dims)
    assert true.low is not None
    assert true.high is not None
    room = (slack + ROUNDING) * full_scale(array)
    if facts.low is not None:
        _hold(true.low >= facts.low - room, f"{bench.name} says at least {facts.low:g}, but on {where} it writes {true.low:g}")
    if facts.high is not None:
        _hold(true.high <= facts.high + room, f"{bench.name} says at most {facts.high:g}, but on {where} it writes {true.high:g}")
    if facts.uniform:
        spread = np.ptp(np.asarray(array, dtype=float), axis=(-2, -1)).max() if np.ndim(array) >= 2 else 0.0
        _hold(spread <= 2 * room, f"{bench.name} says uniform, but on {where} it writes values {spread:g} apart")
    if facts.contrast is not None and true.contrast is not None:
        _hold(
            true.contrast <= facts.contrast * (1 + 1e-9 + 4 * slack),
            f"{bench.name} says contrast {facts.contrast:g}, but on {where} it writes {true.contrast:g}",
        )


def _check_parameter(place: str, name: str, parameter: Parameter, kind: Any, default: Any, stage: Stage) -> None:
    field = next(f for f in dataclasses.fields(stage) if f.name == name)
    _hold("parameter" in field.metadata, f"{place} is declared without param() or quantity(): no unit, no range")
    try:
        parse_unit(parameter.units or "1")
    except UnitError as error:
        raise LawBroken(f"{place}: {error}") from None
    _hold(not parameter.fidelity or bool(parameter.reference), f"{place} is a fidelity parameter without a reference")
    if parameter.camera and name in camera.names():
        shared = _standard(name)
        _hold(shared.units == parameter.units, f"{place} is in {parameter.units}, the camera's {name} in {shared.units}; use quantity()")
    folder = Path.cwd()
    if default is not MISSING and not parameter.file and default != "":
        try:
            same = resolve(list(default) if isinstance(default, tuple) else default, parameter, kind, folder)
        except Unfit as error:
            raise LawBroken(f"{place}: its own default is refused: {error}") from None
        _hold(same == default, f"{place}: its default {default!r} reads as {same!r}")
    for value in _outside(parameter, kind):
        try:
            resolve(value, parameter, kind, folder)
        except Unfit:
            continue
        raise LawBroken(f"{place} accepts {value!r}, which is out of its range ({parameter.range_text()})")


def _standard(name: str) -> Parameter:
    return camera.quantity(name).metadata["parameter"]


def _outside(parameter: Parameter, kind: Any) -> Iterator[Any]:
    """Values that must be refused."""
    numbers: list[Any] = []
    if parameter.above is not None:
        numbers.append(parameter.above)
    if parameter.below is not None:
        numbers.append(parameter.below)
    if parameter.at_least is not None:
        numbers.append(parameter.at_least - 1)
    if parameter.at_most is not None:
        numbers.append(parameter.at_most + 1)
    if parameter.choices:
        yield "no such choice"
    elif kind in (int, float):
        yield from (math.nan, "3 furlong", "text", True)
        if not parameter.infinite:
            yield math.inf
        yield from numbers
    elif parameter.length is not None:
        yield from ([number] * parameter.length for number in numbers)
        yield [0.5] * (parameter.length + 1)

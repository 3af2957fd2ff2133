"""One cell: hand plain arrays to a stage, check what it gives back, keep it.

In:  a ``Job`` and the results it reads.
Out: its ``Result`` and a ``CellReport``; a failure is a report, not an exception.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from etendue.errors import ArchiveInUse, EtendueError, PluginError
from etendue.physics import sampling
from etendue.physics.noise import philox, sensor_normal
from etendue.plan.model import CellRef
from etendue.run.jobs import Job
from etendue.spec.grid import Bands, Grid, Line
from etendue.spec.ports import CellReport
from etendue.spec.stage import Stage, arguments_of, state_of

LARGEST_CACHE = 256 << 20


@dataclass
class Result:
    """What later cells read: arrays, the spectrum inside a segment, and the smallest value of an array once somebody asked (NaN:
    it holds undefined values).

    ``untouched`` is the segment's input where all of the segment was left out so far: then it is the result, bit by bit.
    """

    arrays: dict[str, Any] = field(default_factory=dict)
    lowest: dict[str, float] = field(default_factory=dict)
    spectrum: Any = None
    untouched: Any = None
    failed: str = ""

    def read_only(self) -> Result:
        """Forbid writing into the arrays: a trip to another process forgets it."""
        for array in (*self.arrays.values(), self.spectrum, self.untouched):
            if array is not None:
                array.flags.writeable = False
        return self


class _Cache:
    """Values by key, least recently used dropped first, bounded in bytes. Shared by the threads of a process."""

    def __init__(self, largest: int) -> None:
        self.largest, self.held = largest, 0
        self.entries: OrderedDict[Any, tuple[Any, int]] = OrderedDict()
        self.lock = threading.Lock()
        self.making: dict[Any, threading.Lock] = {}

    def get(self, key: Any, make: Callable[[], Any]) -> Any:
        with self.lock:
            if key in self.entries:
                self.entries.move_to_end(key)
                return self.entries[key][0]
            making = self.making.setdefault(key, threading.Lock())
        with making:
            with self.lock:
                if key in self.entries:
                    return self.entries[key][0]
            value = make()
            size = _size(value)
            with self.lock:
                self.entries[key] = (value, size)
                self.held += size
                while self.held > self.largest and len(self.entries) > 1:
                    _, (_, dropped) = self.entries.popitem(last=False)
                    self.held -= dropped
                self.making.pop(key, None)
        return value


def _size(value: Any) -> int:
    """Bytes of the arrays in a value, containers looked into."""
    if isinstance(value, Mapping):
        value = tuple(value.values())
    if isinstance(value, tuple | list):
        return 256 + sum(_size(v) for v in value)
    return int(getattr(value, "nbytes", 256))


_tables = _Cache(LARGEST_CACHE)


def coordinates_of(grids: Mapping[str, Grid], prefix: str = "") -> dict[str, Any]:
    """Coordinates as arrays: ``y`` ``x`` as they stand on the grid, ``y_um`` ``x_um`` on the image plane."""
    found: dict[str, Any] = {}
    for grid in grids.values():
        for dim, coordinate in grid.entries:
            if f"{prefix}{dim}" in found:
                continue
            if isinstance(coordinate, Bands):
                found[f"{prefix}wavelength_edges"] = np.array(coordinate.edges)
                found[f"{prefix}{dim}"] = np.array(coordinate.values())
            elif isinstance(coordinate, Line):
                start, step = coordinate.um()
                found[f"{prefix}{dim}"] = coordinate.start + coordinate.step * np.arange(coordinate.size)
                found[f"{prefix}{dim}_um"] = start + step * np.arange(coordinate.size)
            else:
                found[f"{prefix}{dim}"] = np.array(coordinate.values())
    for array in found.values():
        array.flags.writeable = False
    return found


class SensorRandom:
    """Standard normals that belong to the pixels of one sensor: the same in every cell, frame and window."""

    def __init__(self, words: bytes, grid: Grid, precision: str) -> None:
        self.words, self.rows, self.columns, self.precision = words, grid.line("y"), grid.line("x"), precision

    def normal(self, stream: str) -> Any:
        """(y, x) array for a named stream such as ``"prnu"``."""
        window = (round(self.rows.start), round(self.columns.start), self.rows.size, self.columns.size)
        words = self.words + b"|" + stream.encode()

        def make() -> Any:
            pattern = sensor_normal(words, *window, np.dtype(self.precision))
            pattern.flags.writeable = False
            return pattern

        return _tables.get(("sensor", words, window, self.precision), make)


def prepared_of(stage: Stage, input_grids: Mapping[str, Grid], grids: Mapping[str, Grid]) -> Any:
    """``stage.prepare``, once per (parameters, coordinates) and process."""
    if not hasattr(stage, "prepare"):
        return None
    key = ("prepare", state_of(stage), tuple(sorted(input_grids.items())), tuple(sorted(grids.items())))
    return _tables.get(
        key, lambda: stage.prepare({**coordinates_of(grids), **coordinates_of(input_grids), **coordinates_of(grids, "out_")})
    )


# -- transfer functions -----------------------------------------------------------------------------------


def transfer_of(stage: Stage, fy: Any, fx: Any, edges: tuple[float, ...], prepared: Any) -> Any:
    """The transfer function at separable frequencies, (wavelength, y, x) or without wavelength."""
    bands = Bands(edges)
    wavelength = np.array(bands.values())[:, None, None] * 1e-3
    return stage.transfer(fy, fx, wavelength) if prepared is None else stage.transfer(fy, fx, wavelength, prepared)  # type: ignore[attr-defined]


def _grid_transfer(job: Job) -> Any:
    grid = job.input_grids[job.inputs[0][0]]
    y, x = grid.line("y"), grid.line("x")
    edges = grid.bands().edges

    def make() -> Any:
        fy = sampling.frequencies(y.size, y.step, half=False)[:, None]
        fx = sampling.frequencies(x.size, x.step, half=True)[None, :]
        value = transfer_of(job.stage, fy, fx, edges, prepared_of(job.stage, job.input_grids, job.grids))
        kind = np.result_type(np.dtype(job.precision), np.complex64) if np.iscomplexobj(value) else np.dtype(job.precision)
        return np.ascontiguousarray(value, dtype=kind)

    return _tables.get(("transfer", state_of(job.stage), y, x, edges, job.precision), make)


def _transfer(job: Job, results: Mapping[CellRef, Result]) -> tuple[Result, dict[str, Any]]:
    port, ref, variable = job.inputs[0]
    grid = job.input_grids[port]
    y, x = grid.line("y"), grid.line("x")
    if job.previous is not None:
        spectrum, untouched = results[ref].spectrum, results[ref].untouched
    else:
        untouched = results[ref].arrays[variable]
        spectrum = sampling.spectrum(untouched)
    (name,) = job.writes
    if hasattr(job.stage, "weights"):
        prepared = prepared_of(job.stage, job.input_grids, job.grids)
        otf = _grid_transfer(job)
        if otf.ndim == 3 and otf.shape[0] > 1:
            spectrum = spectrum * otf
        channels = sampling.sum_over_wavelength(np.asarray(job.stage.weights(prepared)), np.ascontiguousarray(spectrum))
        if not (otf.ndim == 3 and otf.shape[0] > 1):
            channels = channels * otf
        out = job.grids[name]
        where = []
        for dim, line in (("y", y), ("x", x)):
            start, step = out.line(dim).um()
            where.append(((start - line.start) / line.step, step / line.step, out.line(dim).size))
        return Result(), {name: sampling.sample(channels, y.size, x.size, where[0], where[1])}
    if not job.left_out:
        spectrum, untouched = spectrum * _grid_transfer(job), None
    arrays = {}
    if job.store or job.deliver:
        arrays = {name: sampling.planes_of(spectrum, y.size, x.size) if untouched is None else untouched}
    return (Result(spectrum=spectrum, untouched=untouched) if job.spectrum else Result()), arrays


# -- ordinary stages and probes ---------------------------------------------------------------------------


class Otf:
    """The transfer function up to one stage along x, for probes: ``otf(f)`` is (wavelength, frequency)."""

    def __init__(self, stages: tuple[Stage, ...], edges: tuple[float, ...]) -> None:
        self.stages, self.edges = stages, edges

    def __call__(self, frequency: Any) -> Any:
        fx = np.asarray(frequency, dtype=float)[None, :]
        product = np.ones((len(self.edges) - 1, 1, fx.size))
        for stage in self.stages:
            product = product * (self._at(stage, fx) if fx.size < 256 else self._remembered(stage, fx))
        return product[:, 0, :]

    def _at(self, stage: Stage, fx: Any) -> Any:
        prepared = None
        if hasattr(stage, "prepare"):
            grid = Grid.of({"wavelength": Bands(self.edges)})
            prepared = prepared_of(stage, {"irradiance": grid}, {})
        return transfer_of(stage, np.zeros((1, 1)), fx, self.edges, prepared)

    def _remembered(self, stage: Stage, fx: Any) -> Any:
        """The coarse grid of a search is the same in every cell of a sweep."""
        return _tables.get(("otf", state_of(stage), self.edges, fx.tobytes()), lambda: self._at(stage, fx))


def _arguments(job: Job, results: Mapping[CellRef, Result], clipped: list[tuple[float, float]]) -> dict[str, Any]:
    wanted = arguments_of(type(job.stage))
    given: dict[str, Any] = {}
    policy = job.stage.negative
    for port, ref, variable in job.inputs:
        array = results[ref].arrays[variable]
        if job.stage.nan != "keep" and array.dtype.kind == "f" and not np.isfinite(results[ref].lowest.get(variable, 0.0)):
            raise PluginError(
                f"{variable} from {ref[0]!r} holds NaN or infinite values, which {job.ref[0]!r} refuses; "
                "look for the stage that made them, or use one that declares nan = 'keep'"
            )
        if policy != "keep" and array.dtype.kind == "f" and array.size:
            known = results[ref].lowest
            if variable not in known:  # looked for once, and only where somebody minds
                known[variable] = float(array.min())
        if policy != "keep" and results[ref].lowest.get(variable, 0.0) < 0:
            if policy == "error":
                raise PluginError(
                    f"{variable} from {ref[0]!r} holds negative values (smallest {results[ref].lowest[variable]:.3g}), which "
                    f"{job.ref[0]!r} refuses; look for the stage that made them, or use one that keeps or clips them"
                )
            below = array < 0
            total = float(np.abs(array).sum(dtype=np.float64))
            clipped.append((float(below.mean()), float(-array[below].sum(dtype=np.float64)) / total if total else 0.0))
            array = np.maximum(array, 0)
        given[port] = array
    for port, what, pairs in job.looks_at:
        if what == "transfer":
            given[port] = [(name, Otf(job.transfers[: i + 1], job.bands)) for i, (name, _) in enumerate(pairs)]
        else:
            given[port] = [(name, results[ref].arrays[what]) for name, ref in pairs]
    others = [name for name in wanted if name not in given]
    if "prepared" in others:
        given["prepared"] = prepared_of(job.stage, job.input_grids, job.grids) if not job.transfers else _probe_prepared(job)
    if "rng" in others:
        given["rng"] = philox(job.seed)
    if "rng_sensor" in others:
        given["rng_sensor"] = SensorRandom(job.sensor_seed, next(iter(job.grids.values())), job.precision)
    if any(name not in given for name in others):
        key = ("coordinates", tuple(sorted(job.input_grids.items())), tuple(sorted(job.grids.items())))
        found = _tables.get(
            key, lambda: {**coordinates_of(job.grids), **coordinates_of(job.input_grids), **coordinates_of(job.grids, "out_")}
        )
        for name in others:
            if name not in given:
                if name not in found:
                    raise PluginError(f"{type(job.stage).__name__}.run asks for {name}, which its grids do not have")
                given[name] = found[name]
    return {name: given[name] for name in wanted}


def _probe_prepared(job: Job) -> Any:
    """A probe of transfer functions is given the weights of the channels, (channel, wavelength), or None."""
    if job.channel_weights is None:
        return None
    grid = Grid.of({"wavelength": Bands(job.bands)})
    return np.asarray(job.channel_weights.weights(prepared_of(job.channel_weights, {"irradiance": grid}, {})))  # type: ignore[attr-defined]


def check(job: Job, arrays: Any) -> dict[str, Any]:
    """What a stage gave back, held against its declaration; floats are brought to the plan's precision."""
    name = type(job.stage).__name__
    if not isinstance(arrays, dict):
        raise PluginError(f"{name}.run gave {type(arrays).__name__}, not a dict of the variables it writes")
    if set(arrays) != set(job.writes):
        raise PluginError(f"{name}.run gave {sorted(arrays)}, but declares {sorted(job.writes)}")
    checked = {}
    for variable, declaration in job.writes.items():
        grid = job.grids[variable]
        leading = declaration.dims[1:] if declaration.dims[:1] == ("...",) else declaration.dims
        shape = grid.shape(leading)
        array = np.asarray(arrays[variable])
        if array.shape != shape:
            raise PluginError(f"{name} gave {variable} with shape {array.shape}, but declares {leading} = {shape}")
        wanted = np.dtype(job.precision if declaration.dtype == "float" else declaration.dtype)
        if wanted.kind == "f":
            if array.dtype.kind not in "fiub":
                raise PluginError(f"{name} gave {variable} as {array.dtype}, but declares floats")
            array = array.astype(wanted, copy=False)
        elif array.dtype != wanted:
            raise PluginError(f"{name} gave {variable} as {array.dtype}, but declares {wanted}")
        array.flags.writeable = False
        checked[variable] = array
    return checked


def smallest(array: Any) -> float:
    """Smallest value of an array; NaN if any of its values is NaN or infinite."""
    low, high = float(array.min()), float(array.max())
    return low if np.isfinite(low) and np.isfinite(high) else float("nan")


def finite(array: Any) -> bool:
    """Whether no value is NaN or infinite: one pass of the sum of squares, looked at closely only where that overflows."""
    flat = array.reshape(-1)
    return bool(np.isfinite(np.dot(flat, flat)) or np.isfinite(flat).all())


def _undefined(job: Job, arrays: Mapping[str, Any]) -> dict[str, float]:
    """NaN for each float array that holds undefined values; refuses those that were not declared."""
    found = {}
    for variable, array in arrays.items():
        if array.dtype.kind != "f" or array.size == 0 or finite(array):
            continue
        if not job.writes[variable].nan:
            bad = int(array.size - np.isfinite(array).sum())
            raise PluginError(
                f"{type(job.stage).__name__} wrote {bad} of {array.size} values of {variable} that are NaN or infinite; likely causes: "
                "an input beyond the declared range, an ill-conditioned step, missing data. A stage that means it declares '[unit] nan'"
            )
        found[variable] = float("nan")
    return found


def compute(job: Job, results: Mapping[CellRef, Result], began: float | None = None) -> tuple[Result, CellReport]:
    """Compute or load one cell. Exceptions of stages become a failed report.

    ``began`` is the thread's time at the end of the cell before: reading the clock costs 5 us.
    """
    began = time.thread_time() if began is None else began
    for ref in job.needs:
        if results[ref].failed:
            return Result(failed=results[ref].failed), CellReport(*job.ref, "skipped", message=f"{results[ref].failed} failed")
    clipped: list[tuple[float, float]] = []
    try:
        if job.task == "load":
            result, arrays = _load(job, results)
            result.arrays, result.lowest = arrays, _undefined(job, arrays)
            return result, CellReport(*job.ref, "loaded")
        if hasattr(job.stage, "transfer"):
            result, arrays = _transfer(job, results)
        elif job.left_out:
            sources = {variable: results[ref].arrays[variable] for _, ref, variable in job.inputs}
            result, arrays = Result(), {name: sources[name] for name in job.writes}
        else:
            result, arrays = Result(), job.stage.run(**_arguments(job, results, clipped))  # type: ignore[attr-defined]
        if arrays:
            arrays = check(job, arrays)
            result.lowest = _undefined(job, arrays)
        seconds = time.thread_time() - began
        written = job.target.write({v: arrays[v] for v in job.store}) if job.target and job.store else ()
        result.arrays = {v: arrays[v] for v in job.deliver} if arrays else {}
        share, flux = clipped[0] if clipped else (0.0, 0.0)
        status = "left_out" if job.left_out else "done"
        return result, CellReport(*job.ref, status, seconds, tuple(written), clipped=share, clipped_flux=flux)
    except (OSError, ArchiveInUse):
        raise  # the machine's fault, or another run owns the archive now: not the stage's, ends the run
    except Exception as error:
        text = str(error) if isinstance(error, EtendueError) else "".join(traceback.format_exception(error, limit=-3)).strip()
        return Result(failed=job.ref[0]), CellReport(*job.ref, "failed", time.thread_time() - began, message=text)


def _load(job: Job, results: Mapping[CellRef, Result]) -> tuple[Result, dict[str, Any]]:
    """A finished cell: its arrays read back, or its spectrum rebuilt from the segment's input."""
    if job.spectrum:
        result, _ = _transfer(job, results)
    else:
        result = Result()
    assert job.target is not None
    arrays = {variable: job.target.read(variable) for variable in job.deliver}
    for array in arrays.values():
        array.flags.writeable = False
    return result, arrays

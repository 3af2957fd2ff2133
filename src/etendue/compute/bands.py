"""Variables too large to hold in memory: arrays that are computed one band at a time.

In:  a job whose stage supports single bands, and its inputs.
Out: an object that computes band i as a plain array each time it is asked for.

Code that needs a plain array can call ``numpy.asarray``, which holds all bands in memory.
"""

from __future__ import annotations

import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from etendue.compute.job import Job
from etendue.compute.ownership import for_reading, frozen, guests_of, handed
from etendue.compute.tables import prepared_of
from etendue.contract.arrays.coordinates import coordinates_of
from etendue.contract.arrays.grid import Bands, Grid
from etendue.contract.capabilities import Banded, is_source
from etendue.contract.stage import arguments_of, reads_of
from etendue.errors import PluginError, refused_by_the_machine
from etendue.telling import foreign
from etendue.types.arrays import Array, CellArrays, FloatArray

SMALL_BAND = 1 << 14  # pixels that are computed sooner than a thread is started: 0.2 ms
EVERY = slice(None)
LARGE_BAND = 64 << 20  # bytes; two bands of this size would take too much memory


class BandArray(ABC):
    """A (band, y, x) array that is computed band by band."""

    shape: tuple[int, ...]
    dtype: np.dtype[np.generic]
    ndim = 3
    on_demand = True  # each access computes the band
    in_rows = False  # whether some rows of a band may be computed alone

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))

    @property
    def nbytes(self) -> int:
        return self.size * int(np.dtype(self.dtype).itemsize)

    def __len__(self) -> int:
        return self.shape[0]

    @abstractmethod
    def __getitem__(self, band: int) -> Array:
        """Return one band, (y, x)."""

    def rows(self, bands: slice, rows: slice) -> Array:
        """Return some rows of some bands, (band, y, x)."""
        return np.stack([self[band][rows] for band in range(*bands.indices(len(self)))])

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> FloatArray:
        whole = np.empty(self.shape, dtype=dtype or self.dtype)
        for band in range(self.shape[0]):
            whole[band] = self[band]
        return whole


@dataclass(eq=False)
class StoredBands(BandArray):
    """Bands read back from storage."""

    job: Job
    variable: str
    on_demand = False

    def __post_init__(self) -> None:
        self.shape = _shape(self.job, self.variable)
        self.dtype = np.dtype(self.job.precision)

    def __getitem__(self, band: int) -> Array:
        assert self.job.target is not None
        with refused_by_the_machine():
            return self.job.target.read_band(self.variable, band)


@dataclass(eq=False)
class StageBands(BandArray):
    """Bands computed by a stage's ``run`` from the same bands of its input."""

    job: Job
    variable: str
    given: Mapping[str, Array | BandArray]  # by port: arrays, or bands of them

    def __post_init__(self) -> None:
        self.shape = _shape(self.job, self.variable)
        self.dtype = np.dtype(self.job.precision)
        assert isinstance(self.job.stage, Banded)
        self.in_rows = self.job.stage.in_rows() and all(
            array.in_rows for array in self.given.values() if isinstance(array, BandArray)
        )

    def __getitem__(self, band: int) -> Array:
        found: Array = self.rows(slice(band, band + 1), EVERY)[0]
        return found

    def rows(self, bands: slice, rows: slice) -> Array:
        arrays = run_bands(self.job, self.given, bands, rows=rows)
        count = bands.stop - bands.start
        said = f"band {bands.start}" if count == 1 else f"bands {bands.start} to {bands.stop - 1}"
        if not isinstance(arrays, Mapping) or self.variable not in arrays:
            raise PluginError(f"{self.job.ref[0]!r} gave no {self.variable} for {said}")
        with foreign(f"{self.job.ref[0]!r}"):
            planes = np.asarray(arrays[self.variable])
        expected = count, len(range(self.shape[1])[rows]), self.shape[2]
        if planes.shape != expected:
            own, right = (planes.shape[1:], expected[1:]) if len(planes) == count == 1 else (planes.shape, expected)
            raise PluginError(f"{self.job.ref[0]!r} gave {said} of {self.variable} with shape {own}, not {right}")
        found: Array = planes.astype(self.dtype, copy=False)
        flat = found.reshape(-1)
        if not np.isfinite(np.dot(flat, flat)) and not np.isfinite(flat).all():
            raise PluginError(f"{self.job.ref[0]!r} wrote NaN or infinite values into {said} of {self.variable}")
        return found


def _shape(job: Job, variable: str) -> tuple[int, ...]:
    return job.grids[variable].shape(job.writes[variable].dims)


def _cut(grid: Grid, bands: slice) -> Grid:
    if not grid.banded:
        return grid
    return grid.replace(**{grid.banded: Bands(grid.bands().edges[bands.start : bands.stop + 1])})


def _of_bands(array: Array | BandArray, dims: tuple[str, ...], grid: Grid, bands: slice, rows: slice) -> Any:
    banded = grid.banded and dims[:1] == (grid.banded,)
    if isinstance(array, BandArray):
        if not banded:
            return array
        return array[bands.start][None] if rows == EVERY and bands.stop - bands.start == 1 else array.rows(bands, rows)
    own = array[bands] if banded else array
    return own if rows == EVERY or dims[-2:] != ("y", "x") else own[..., rows, :]


def run_bands(
    job: Job, given: Mapping[str, Array | BandArray], bands: slice, pixels: bool = True, rows: slice = EVERY
) -> Mapping[str, Any]:
    """Call ``run`` of a stage on some bands of light, or on some rows of these bands. Without ``pixels``, call it on
    one pixel, for outputs without y and x.
    """
    stage: Any = job.stage
    declared = reads_of(type(stage))
    inputs = {p: _cut(g, bands) for p, g in job.input_grids.items()}
    outputs = {v: _cut(g, bands) for v, g in job.grids.items()}
    with foreign(f"{type(stage).__name__}.by_band"):
        prepared = stage.by_band(prepared_of(stage, job.input_grids, job.grids), bands)
    known = {
        **coordinates_of(outputs),
        **coordinates_of(inputs),
        **coordinates_of(outputs, "out_"),
        "prepared": prepared,
    }
    if not pixels:
        known |= {
            name: value[:1] for name, value in known.items() if name.removeprefix("out_").split("_")[0] in ("y", "x")
        }
    if rows != EVERY:
        known |= {name: value[rows] for name, value in known.items() if name.removeprefix("out_") in ("y", "y_um")}
    for port, array in given.items():
        dims = declared[port].dims
        if not pixels and dims[-2:] == ("y", "x"):
            known[port] = np.zeros((bands.stop - bands.start, 1, 1), dtype=job.precision)
            continue
        cut = _of_bands(array, dims, job.input_grids[port], bands, rows)
        if (
            stage.negative != "keep"
            and dims[-2:] == ("y", "x")
            and cut.dtype.kind == "f"
            and cut.size
            and cut.min() < 0
        ):
            if stage.negative == "error":
                raise PluginError(
                    f"{port} holds negative values (smallest {cut.min():.3g}), which {job.ref[0]!r} refuses"
                )
            cut = np.maximum(cut, 0)
        known[port] = cut if isinstance(cut, BandArray) else frozen(cut)
    own = handed(stage, {name: for_reading(known[name]) for name in arguments_of(type(stage))})
    with foreign(f"{type(stage).__name__}.run"), guests_of(job):
        found: Mapping[str, Any] = stage.run(**own)
        return found


def made_by_band(job: Job, given: Mapping[str, Array | BandArray]) -> CellArrays:
    """Return what a stage writes: large variables as bands that are computed on demand, small variables as arrays."""
    arrays: CellArrays = {}
    small = [v for v in job.writes if v not in job.by_band]
    bands = max(g.bands().size for g in job.grids.values() if g.banded)
    if small and is_source(type(job.stage)):
        found = job.stage.constants(prepared_of(job.stage, job.input_grids, job.grids))  # type: ignore[attr-defined]
        arrays = {v: found[v] for v in small}
    elif small:
        found = run_bands(job, given, slice(0, bands), pixels=False)
        arrays = {v: found[v] for v in small}
    return arrays | {v: StageBands(job, v, given) for v in job.by_band}


def is_dark(plane: Array) -> bool:
    """Return whether a plane is exactly zero everywhere; most other planes are recognised by one value."""
    return not (plane[plane.shape[0] // 2, plane.shape[1] // 2] or plane.any())


def lit_bands(light: Array) -> slice:
    """Return the range of bands from the first to the last that is not exactly zero; the first band if all are zero."""
    count = light.shape[0]
    first = next((band for band in range(count) if not is_dark(light[band])), count)
    if first == count:
        return slice(0, min(1, count))
    last = next(band for band in reversed(range(count)) if not is_dark(light[band]))
    return slice(first, last + 1)


def among_all(lit: Array, bands: slice, count: int) -> Array:
    """Return an array of light in all bands, given the light in some of them. The other bands are zero and take no
    memory until they are read.
    """
    if len(lit) == count:
        return lit
    found = np.zeros((count, *lit.shape[1:]), dtype=lit.dtype)
    found[bands] = lit
    return found


def of_lit_bands(job: Job, given: Mapping[str, Array | BandArray]) -> CellArrays | None:
    """Return the output of a stage that multiplies light by factors, computed only in bands with light. Return None if
    the stage does not multiply light by factors, or if all bands have light.
    """
    stage, declared = job.stage, reads_of(type(job.stage))
    if not (isinstance(stage, Banded) and stage.pointwise and stage.negative != "clip"):
        return None
    planes = [port for port in given if len(declared[port].dims) == 3 and job.input_grids[port].banded]
    light = given[planes[0]] if len(planes) == 1 else None
    if not isinstance(light, np.ndarray):
        return None
    count, lit = len(light), lit_bands(light)
    if lit.stop - lit.start == count:
        return None
    arrays = dict(run_bands(job, given, lit))
    if small := [v for v in job.writes if v in arrays and job.writes[v].dims[-2:] != ("y", "x")]:
        whole = run_bands(job, given, slice(0, count), pixels=False)
        arrays |= {v: whole[v] for v in small}
    return {v: a if v in small else among_all(np.asarray(a), lit, count) for v, a in arrays.items()}


class Timed:
    """Bands that are computed while they are stored; their time is charged to their cell."""

    def __init__(self, bands: BandArray) -> None:
        self.bands, self.seconds = bands, 0.0

    def __getitem__(self, band: int) -> Array:
        began = time.thread_time()
        try:
            return self.bands[band]
        finally:
            self.seconds += time.thread_time() - began


class _Elsewhere(threading.local):
    """Thread time (s) that a cell spends in other threads."""

    seconds = 0.0


elsewhere = _Elsewhere()


def in_order(light: Array | BandArray) -> Iterator[Array]:
    """Yield every band. The next band is computed in another thread while the present one is used, if the computation
    takes long enough and needs little memory. No reference to a band is kept once it was yielded, so its memory is
    freed as soon as the reader drops it.
    """
    pixels = math.prod(light.shape[1:])
    if isinstance(light, np.ndarray) or pixels <= SMALL_BAND or pixels * light.dtype.itemsize > LARGE_BAND:
        yield from (light[band] for band in range(light.shape[0]))
        return

    def made(band: int) -> tuple[Array, float]:
        began = time.thread_time()
        return light[band], time.thread_time() - began

    with ThreadPoolExecutor(1) as ahead:
        coming = ahead.submit(made, 0)
        for band in range(light.shape[0]):
            plane, seconds = coming.result()
            found = [plane]
            del plane
            elsewhere.seconds += seconds
            if band + 1 < light.shape[0]:
                coming = ahead.submit(made, band + 1)
            yield found.pop()

"""The law of windows: the result for a window is the window of the result for the whole frame.

In:  an instance of a stage.
Out: nothing, or a broken law: a mask, a pattern or a shading that begins at the window instead of at the whole frame.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from etendue.archive.read.differing import apart, full_scale
from etendue.compute.rows import has_rows
from etendue.contract.arrays import dims
from etendue.contract.arrays.colouring import Pattern
from etendue.contract.arrays.grid import Coordinate, Line
from etendue.contract.arrays.variables import Declaration
from etendue.contract.capabilities import draws_anew, halo_of, is_transfer
from etendue.testing.behaviour.geometry import pattern_of
from etendue.testing.bench import Bench, BenchTrial, Frame
from etendue.testing.measured import hold, ratio_of, untried, within
from etendue.types.arrays import Array

FIRST: tuple[Frame, ...] = ((1, 0), (0, 1), (1, 1))  # first pixels of the windows
FARTHEST = 40  # pixels of reach up to which windows and strips are tried; frames grow with its square
AT_LEAST = 12  # pixels of a window in each direction
COLOURS = (0.8, 0.35, 0.1, 0.6, 0.2, 0.5)  # values of the channels of a mask
EVEN = 0.02  # of full scale: a method must not change uniform colours, and another channel differs by ten times as much
SAME = 1e-9  # of full scale: the same arithmetic on the same values


class WindowLaws:
    """Mix-in of ``StageConformance``."""

    bench: Bench

    def test_a_window_of_the_whole_is_read_where_it_stands(self) -> None:
        """Windows that start at odd rows and columns are tested: of uniform colours, and also of a picture if the stage
        states its reach.
        """
        bench = self.bench
        if bench.given_grids or is_transfer(bench.kind) or draws_anew(bench.kind) or not _pixel_by_pixel(bench):
            return
        pattern, halo = pattern_of(bench), halo_of(bench.stage)
        if (halo or 0) > FARTHEST:
            untried(f"it reaches {halo} pixels: windows are tried up to {FARTHEST}")
            return
        down, across = (-(-(AT_LEAST + 2 * (halo or 0)) // period) * period for period in pattern.period)
        frame, whole = (down, across), (down + pattern.period[0], across + pattern.period[1])
        for what in ("even colours", "a picture") if halo is not None else ("even colours",):
            inputs = {port: _array(bench, port, what, pattern, whole) for port in bench.reads}
            full = bench.run(inputs, frame=whole)
            for first in FIRST if full.done else ():
                cut = {port: _cut(array, bench.reads[port], first, frame) for port, array in inputs.items()}
                found = _Window(bench, first, whole).run(cut, frame=frame)
                where = f"a window from row {first[0]}, column {first[1]} on"
                hold(found.done or found.refused_in_words, f"{bench.name} failed on {where}: {found.last_line}")
                if found.done:
                    self._stands_there(found, full, first, frame, halo if what == "a picture" else None)

    def _stands_there(self, found: BenchTrial, full: BenchTrial, first: Frame, frame: Frame, halo: int | None) -> None:
        """Compare the result for a window with the same place of the result for the whole; without ``halo``, for
        uniform colours.
        """
        bench, what = self.bench, "even colours" if halo is None else "a picture"
        for variable, declaration in bench.writes.items():
            if has_rows(declaration.dims):
                off = _off(found.arrays[variable], _cut(full.arrays[variable], declaration, first, frame), halo)
                within(
                    off,
                    EVEN if halo is None else SAME,
                    f"{bench.name}: {variable} of a window from row {first[0]}, column {first[1]} on, of "
                    f"{what}, differs by {off:.2g} of full scale from the result for the whole; masks and "
                    "patterns must begin at the same place as for the whole: ask for y and x in run, y[0] and "
                    "x[0] are the window's first row and column",
                )


def _off(found: Array, expected: Array, halo: int | None) -> float:
    """Return the difference between a window and the same place of the whole, relative to full scale: the maximum
    farther than ``halo`` from the window's border; without ``halo``, the median.
    """
    away = apart(found, expected)
    if halo is None:  # each method fills borders by its own rule, as far as it reaches
        off = float(np.median(away, axis=(-2, -1)).max(initial=0.0))
    else:
        off = float(np.max(away[..., halo : away.shape[-2] - halo, halo : away.shape[-1] - halo], initial=0.0))
    return ratio_of(off, full_scale(expected))


class _Window(Bench):
    """A bench whose frames are windows of a larger frame."""

    def __init__(self, bench: Bench, first: Frame, whole: Frame) -> None:
        super().__init__(bench.stage, None, bench.scales)
        self.first, self.whole = first, whole

    def coordinate(self, dim: str, declaration: Declaration, frame: Frame) -> Coordinate:
        line = super().coordinate(dim, declaration, self.whole)
        if dim not in ("y", "x") or not isinstance(line, Line):
            return line
        axis = int(dim == "x")
        start, step = line.um()
        position = line.position and (start + self.first[axis] * step, step)
        return replace(line, size=frame[axis], start=line.start + self.first[axis] * line.step, position=position)


def _pixel_by_pixel(bench: Bench) -> bool:
    """Return whether the outputs of a stage have the same pixels as its inputs; False if it reads light by band, which
    is never cut by rows.
    """
    if any(dims.banded(declaration.dims) for declaration in bench.reads.values()):
        return False
    read = [bench.input_grids()[port] for port, d in bench.reads.items() if has_rows(d.dims)]
    grids = bench.job().grids
    written = [grids[variable] for variable, d in bench.writes.items() if has_rows(d.dims)]
    places = {(grid.line("y"), grid.line("x")) for grid in (*read, *written)}
    return bool(read and written) and len(places) == 1


def _array(bench: Bench, port: str, what: str, pattern: Pattern, frame: Frame) -> Array:
    """Return an input for the whole frame. For uniform colours, every pixel of a frame with a filter pattern has the
    level of its filter's colour, and every plane of several has its own level.
    """
    declaration = bench.reads[port]
    if what == "a picture" or not has_rows(declaration.dims):
        return bench.array(port, "ordinary", frame)
    even = bench.array(port, "uniform", frame)
    if even.ndim == 2:
        colours = dict(zip(pattern.tints, itertools.cycle(COLOURS), strict=False))
        tile = np.array([[colours[letter] for letter in row] for row in pattern.rows])
        found = even * np.tile(tile, (frame[0] // tile.shape[0], frame[1] // tile.shape[1]))
    else:
        found = even * np.resize(COLOURS, even.shape[:-2])[..., None, None]
    return np.rint(found) if declaration.dtype != "float" else found


def _cut(array: Array, declaration: Declaration, first: Frame, frame: Frame) -> Array:
    return (
        array[..., first[0] : first[0] + frame[0], first[1] : first[1] + frame[1]]
        if has_rows(declaration.dims)
        else array
    )

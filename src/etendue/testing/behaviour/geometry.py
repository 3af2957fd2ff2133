"""Checks of places: uniform light up to the border, mirrored pictures, shifted pictures, the far corner of a large
frame.

In:  a ``Bench``.
Out: nothing, or ``LawBroken``.

A stage that gets no positions (``run`` has no argument for a coordinate, and ``prepare`` gets none) must treat every
place equally. A stage that gets positions may vary over the frame, but its result must not depend on where the border
of its input is.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from etendue.archive.read.differing import apart, full_scale
from etendue.compute.rows import has_rows
from etendue.contract.arrays import colouring, dims, variables
from etendue.contract.arrays.colouring import Pattern
from etendue.contract.arrays.grid import Coordinate, Line
from etendue.contract.arrays.variables import Declaration
from etendue.contract.capabilities import is_random, is_transfer
from etendue.contract.stage import Stage, arguments_of
from etendue.contract.values import quantities
from etendue.plugins import discovery
from etendue.testing.bench import Arrays, Bench, BenchTrial, Frame
from etendue.testing.checks import bound_of
from etendue.testing.measured import ratio_of, untried, within
from etendue.types.arrays import Array

OWN = 1e-9  # of full scale: roundings of transforms, for a stage that states no error
ODD: Frame = (11, 13)  # odd, so that a mirror image of a mask has the same phase
EVEN: Frame = (12, 24)  # a multiple of the factors by which a stage may bin pixels
WIDE: Frame = (35, 37)
PLACES = ("y", "x")
STEPS = ((0, 1), (1, 0), (3, 2))
LARGE: Frame = (10_000, 10_000)
FAR: Frame = (9_984, 9_972)
PERIOD = 12  # a multiple of the periods of all masks
MARGIN = 8  # pixels from the border in which the filling beyond the border may have an effect


PLAIN = Pattern(
    ("ab", "bc"), {"a": (1.0, 0.0, 0.0), "b": (0.0, 1.0, 0.0), "c": (0.0, 0.0, 1.0)}
)  # used if no distribution declares any


def pattern_of(bench: Bench) -> Pattern:
    """Return the pattern that a variable of the stage declares, else one that any installed variable declares, else a
    plain pattern.
    """
    own = (d.variable for d in (*bench.reads.values(), *bench.writes.values()))
    every = itertools.chain(own, discovery.installed().names("variables"))
    name = next((found for one in every if (found := variables.variable(one).pattern)), "")
    return colouring.pattern(str(getattr(bench.stage, name, quantities.declared(name).default))) if name else PLAIN


def told_where(bench: Bench) -> bool:
    """Return whether a stage gets the positions of its values in the frame."""
    asked = () if is_transfer(bench.kind) else arguments_of(bench.kind)
    named = any(name.removeprefix("out_").split("_")[0] in PLACES for name in asked)
    return named or (bench.kind.prepare is not Stage.prepare and not is_transfer(bench.kind))


def frames(bench: Bench, same: bool = True) -> bool:
    """Return whether a stage reads and writes frames and draws no random numbers and, with ``same``, whether input and
    output have the same pixels.
    """
    if is_random(bench.kind) or bench.looks or bench.given_grids:
        return False
    read = [d for d in bench.reads.values() if {*PLACES} <= set(d.dims)]
    written = [d for d in bench.writes.values() if {*PLACES} <= set(d.dims)]
    if not read or not written:
        return False
    if not same:
        return True
    grids, job = bench.input_grids(), bench.job()
    places = {
        (grid.line("y"), grid.line("x"))
        for grid in (
            *(grids[port] for port, d in bench.reads.items() if has_rows(d.dims)),
            *(job.grids[v] for v, d in bench.writes.items() if has_rows(d.dims)),
        )
    }
    return len(places) == 1


def room(bench: Bench, inputs: Arrays, frame: Frame) -> float:
    """Return the allowed difference of two results: twice the error that the stage states for double precision."""
    return 2 * max(bound_of(bench, inputs, "float64", 0.0, frame), OWN)


def uniform_to_the_rim(bench: Bench) -> None:
    """Check that uniform input gives uniform output up to the last row and column. If the stage gets positions, its
    output must equal the output of a larger uniform frame at the same places.
    """
    if not frames(bench, same=told_where(bench)):
        return
    if told_where(bench):
        of_a_larger_frame(bench)
        return
    for level in (1e-3, 0.3, 1.0):
        for frame in (ODD, (1, 9), WIDE):
            inputs = bench.arrays("uniform", frame, level)
            trial = tried(bench, inputs, frame)
            for variable, values in places_of(bench, trial).items():
                spread = float(np.ptp(values, axis=(-2, -1)).max(initial=0.0))
                off = ratio_of(spread, bench.full_scale(variable, values, frame))
                within(
                    off,
                    room(bench, inputs, frame),
                    f"{bench.name}: {variable} of a uniform {frame[0]} x {frame[1]} frame varies by {off:.2g} of full "
                    f"scale, most in row {worst_of(values)[0]}, column {worst_of(values)[1]}: light is lost or gained "
                    "at the rim, or by place; ask for y and x in run if that is intended",
                )


def of_a_larger_frame(bench: Bench) -> None:
    """Compare the result for a uniform frame with the same places of the result for a larger uniform frame."""
    inner, outer, edge = (25, 27), (37, 39), 6
    large, small = Places(bench, (0, 0), outer), Places(bench, (edge, edge), outer)
    of_large, of_small = bench.arrays("uniform", outer, 0.3), bench.arrays("uniform", inner, 0.3)
    whole, part = tried(large, of_large, outer), tried(small, of_small, inner)
    if whole is None or part is None:
        return
    for variable, values in places_of(bench, part).items():
        same = np.asarray(whole.arrays[variable], float)[..., edge : edge + inner[0], edge : edge + inner[1]]
        allowed = max(room(bench, of_small, inner), 1e-6)
        middle = apart(values, same)[..., 6:-6, 6:-6]
        if ratio_of(float(middle.max(initial=0.0)), full_scale(same)) > allowed:
            # The stage scales positions to the size of the frame, so the difference does not come from the border.
            continue
        off = ratio_of(float(apart(values, same).max(initial=0.0)), full_scale(same))
        within(
            off,
            allowed,
            f"{bench.name}: {variable} of a uniform frame differs by {off:.2g} of full scale from the same places of a "
            f"larger uniform frame, most in row {worst_of(values - same)[0]}, column {worst_of(values - same)[1]} of "
            f"{inner[0]} x {inner[1]}: light is lost or gained at the border",
        )


def mirror_images(bench: Bench) -> None:
    """Check that a mirrored picture gives the mirrored result. This reveals pictures that are shifted by half a pixel
    or more, and borders that are treated differently.
    """
    if not frames(bench, same=False) or is_transfer(bench.kind) or bench.kind.handed:
        return
    if max(pattern_of(bench).period) > 2:
        untried(
            "mirror images were not tried: the mirror image of a mask with a period above two pixels is another mask"
        )
        return
    frame = ODD if frames(bench) else EVEN
    for what in ("ordinary", "decades", "point"):
        inputs = bench.arrays(what, frame)
        if bench.kind.negative != "keep":
            inputs = {port: np.abs(array) for port, array in inputs.items()}
        base = tried(bench, inputs, frame)
        for axis, word in ((-2, "up and down"), (-1, "left and right")):
            turned = {
                port: np.flip(array, axis) if {*PLACES} <= set(bench.reads[port].dims) else array
                for port, array in inputs.items()
            }
            other = tried(bench, turned, frame)
            if other is None:
                continue
            for variable, values in places_of(bench, base).items():
                found = np.flip(np.asarray(other.arrays[variable], float), axis)
                off = ratio_of(float(apart(found, values).max(initial=0.0)), bench.full_scale(variable, values, frame))
                within(
                    off,
                    room(bench, inputs, frame),
                    f"{bench.name}: {variable} of {what} input mirrored {word} is {off:.2g} of full scale from the "
                    f"mirror image of {variable}, most in row {worst_of(found - values)[0]}, column "
                    f"{worst_of(found - values)[1]} of {frame[0]} x {frame[1]}: the picture is moved by a "
                    "fraction of a pixel, or a border is off by one; declare handed = True if the stage treats "
                    "left and right differently",
                )


def shifted_pictures(bench: Bench) -> None:
    """Check that a spot on a uniform background gives the same picture at every place. Places near the border are not
    compared.
    """
    if not frames(bench) or is_transfer(bench.kind) or told_where(bench):
        return
    frame, middle = WIDE, (17, 18)

    def spotted(step: Frame) -> Arrays:
        inputs = dict(bench.arrays("uniform", frame, 0.3))
        for port, array in inputs.items():
            if {*PLACES} <= set(bench.reads[port].dims):
                array[..., middle[0] + step[0], middle[1] + step[1]] *= 2.0
                array[..., middle[0] + step[0] + 1, middle[1] + step[1]] *= 0.5
        return inputs

    base = tried(bench, spotted((0, 0)), frame)
    for step in STEPS if base else ():
        other = tried(bench, spotted(step), frame)
        if other is None:
            continue
        for variable, values in places_of(bench, base).items():
            found = np.asarray(other.arrays[variable], float)
            inside = [slice(MARGIN, size - MARGIN) for size in frame]
            there = [slice(MARGIN + by, size - MARGIN + by) for by, size in zip(step, frame, strict=True)]
            off = ratio_of(
                float(apart(found[..., there[0], there[1]], values[..., inside[0], inside[1]]).max(initial=0.0)),
                bench.full_scale(variable, values, frame),
            )
            within(
                off,
                max(room(bench, spotted((0, 0)), frame), 1e-7),
                f"{bench.name}: {variable} of a spot {step[0]} rows and {step[1]} columns further differs by "
                f"{off:.2g} of full scale from the result for the spot itself: it depends on the place in the "
                "frame; ask for y and x in "
                "run if that is intended",
            )


def far_corner(bench: Bench) -> None:
    """Check that the last rows and columns of a frame of a hundred million places are computed like the first rows and
    columns. Applies to stages whose result repeats with the period of a mask.
    """
    if not frames(bench) or is_transfer(bench.kind) or not told_where(bench):
        return
    if any(dims.banded(d.dims) for d in bench.reads.values()):
        return
    frame, inputs = (16, 24), bench.arrays("ordinary", (16, 24))
    near, next_to_it, far = (Places(bench, first, LARGE) for first in ((0, 0), (PERIOD, PERIOD), FAR))
    results = [tried(one, inputs, frame) for one in (near, next_to_it, far)]
    first, second, last = (places_of(bench, one) for one in results)
    for variable, values in first.items():
        repeats = variable in second and float(apart(values, second[variable]).max(initial=0.0)) == 0.0
        if not repeats or variable not in last:
            continue
        off = ratio_of(float(apart(values, last[variable]).max(initial=0.0)), full_scale(values))
        within(
            off,
            room(bench, inputs, frame),
            f"{bench.name}: {variable} of the same input differs by {off:.2g} of full scale from the result for "
            f"the first rows if it is placed at row {FAR[0]}, column {FAR[1]} of {LARGE[0]} x {LARGE[1]}: "
            "places are computed with too few digits",
        )


class Places(Bench):
    """A bench whose frames are windows of a larger frame."""

    def __init__(self, bench: Bench, first: Frame, whole: Frame) -> None:
        super().__init__(bench.stage, None, bench.scales, bench.coordinates)
        self.first, self.whole = first, whole

    def coordinate(self, dim: str, declaration: Declaration, frame: Frame) -> Coordinate:
        line = super().coordinate(dim, declaration, self.whole)
        if dim not in PLACES or not isinstance(line, Line):
            return line
        axis = int(dim == "x")
        start, step = line.um()
        position = line.position and (start + self.first[axis] * step, step)
        return replace(line, size=frame[axis], start=line.start + self.first[axis] * line.step, position=position)


def tried(bench: Bench, inputs: Arrays, frame: Frame) -> BenchTrial | None:
    """Return the result for these inputs; None if the stage refuses the frame or an input (other laws test this)."""
    try:
        trial = bench.run(inputs, frame=frame)
    except ValueError:
        return None
    return trial if trial.done else None


def places_of(bench: Bench, trial: BenchTrial | None) -> Mapping[str, Array]:
    """Return, as floats, the finite outputs that have positions; {} without a result."""
    if trial is None:
        return {}
    return {
        variable: np.asarray(trial.arrays[variable], dtype=float)
        for variable, d in bench.writes.items()
        if d.dims[-2:] == PLACES and variable in trial.arrays and np.isfinite(trial.arrays[variable]).all()
    }


def worst_of(values: Array) -> Frame:
    """Return the row and the column in which values are farthest from their median."""
    plane = np.abs(np.asarray(values, float) - np.median(values)).reshape(-1, *values.shape[-2:]).max(axis=0)
    row, column = divmod(int(plane.argmax()), plane.shape[1])
    return row, column

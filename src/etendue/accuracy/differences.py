"""Measure the difference of a variable between two runs, relative to full scale.

In:  the same variable of two runs, its declaration, the stage that writes it.
Out: ``Difference``; its relative values are the rms over the picture and the largest error of a pixel.

Full scale is 1 for pictures without a unit, white - black for codes with a black level (``Variable.black``), and else
the largest value of the reference. For values without a position, errors of a metric per stage are relative to the
metric, and errors of vectors and matrices to their largest element. ``Variable.full`` overrides this; for example, a
share of pixels is relative to the whole frame.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from etendue.archive.read.differing import Difference, apart, between, full_scale
from etendue.contract.arrays.variables import Declaration, variable
from etendue.contract.stage import Stage
from etendue.contract.wording import Unit, units

if TYPE_CHECKING:
    from etendue.types.arrays import Array


def difference(found: Array, reference: Array, declaration: Declaration, stage: Stage) -> Difference:
    """Return the difference of two arrays of one variable that ``stage`` has written.

    Values that are undefined in both runs are ignored; if a value is undefined in only one run, the arrays cannot be
    compared. For codes without a unit (flags, maps, positions in a list) the rms is the square root of the fraction of
    values that differ.
    """
    found, reference = np.asarray(found, np.float64), np.asarray(reference, np.float64)
    if found.shape != reference.shape:
        return between(reference, found)
    if (declaration.dtype != "float" and declaration.unit == "1") or variable(declaration.variable).index:
        return between(np.zeros(found.shape), np.sign(apart(found, reference)), 1.0)
    scale = scale_of(reference, declaration, stage)
    largest = float(np.max(scale, initial=0.0))
    own = between(reference * (largest / scale), found * (largest / scale), largest)  # each value has its own scale
    return replace(own, why="undefined at other places than in the reference") if own.undefined else own


def scale_of(reference: Array, declaration: Declaration, stage: Stage) -> float | Array:
    """Return the full scale of a variable: a number, or one per value."""
    said = variable(declaration.variable)
    if said.full is not None:
        return said.full
    largest = full_scale(reference) or 1.0
    if {"y", "x"} <= set(declaration.dims):
        if name := units().get(declaration.unit, Unit()).bits:
            codes, black = getattr(stage, name, None), getattr(stage, said.black, 0.0)
            return largest if codes is None else float(2**codes - 1 - black)
        return 1.0 if declaration.unit == "1" else largest
    if set(declaration.dims) - {"stage"}:
        return largest
    own = np.abs(np.where(np.isfinite(reference), reference, largest))
    return np.where(own > 0, own, 1.0 if declaration.unit == "1" else largest)

"""Measure how far a variable of one run is from another run, relative to full scale.

In:  the same variable of two runs, its declaration, the stage that writes it.
Out: ``Difference``: rms over the picture and the largest pixel.

Full scale is 1 for pictures without a unit, white - black for codes with a black level (``Variable.black``), and else
the largest value of the reference. Values without a place are relative: metrics per stage each to itself, vectors and
matrices to their largest element. ``Variable.full`` overrides this: a share of pixels is a share of the frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from etendue.contract.arrays.variables import Declaration, variable
from etendue.contract.stage import Stage
from etendue.contract.wording import Unit, units

if TYPE_CHECKING:
    from etendue.types.arrays import Array


@dataclass(frozen=True)
class VariableError:
    """``rms`` and ``largest`` relative to ``scale``; None if the two cannot be compared, for the reason in ``why``."""

    rms: float | None
    largest: float | None
    scale: float
    why: str = ""


def difference(found: Array, reference: Array, declaration: Declaration, stage: Stage) -> VariableError:
    """Return the difference of two arrays of one variable that ``stage`` has written.

    Values that are undefined in both runs are ignored; if a value is undefined in only one, the arrays cannot be
    compared. For codes without a unit (flags, maps, positions in a list) the rms is the root of the share that differs.
    """
    found, reference = np.asarray(found), np.asarray(reference)
    if found.shape != reference.shape:
        return VariableError(None, None, math.nan, f"shape {found.shape}, but the reference has {reference.shape}")
    if (declaration.dtype != "float" and declaration.unit == "1") or variable(declaration.variable).index:
        same = (found == reference) | ((found != found) & (reference != reference))
        share = 1.0 - float(np.mean(same)) if found.size else 0.0
        return VariableError(math.sqrt(share), float(share > 0), 1.0)
    found, reference = found.astype(np.float64), reference.astype(np.float64)
    known = np.isfinite(reference)
    if not np.array_equal(known, np.isfinite(found)):
        return VariableError(None, None, math.nan, "undefined at different places than the reference")
    if not known.any():
        return VariableError(0.0, 0.0, 1.0)
    scale = full_scale(reference, known, declaration, stage)
    away = np.abs(found - reference)[known] / np.broadcast_to(scale, known.shape)[known]
    largest = float(away.max())
    rms = largest * float(np.sqrt(np.mean((away / largest) ** 2))) if largest > 0 else 0.0
    return VariableError(rms, largest, float(np.max(scale)))


def full_scale(reference: Array, known: Array, declaration: Declaration, stage: Stage) -> float | Array:
    """Return the full scale of a variable: a number, or one per value."""
    said = variable(declaration.variable)
    if said.full is not None:
        return said.full
    largest = float(np.abs(reference[known]).max()) or 1.0
    if {"y", "x"} <= set(declaration.dims):
        if name := units().get(declaration.unit, Unit()).bits:
            codes, black = getattr(stage, name, None), getattr(stage, said.black, 0.0)
            return largest if codes is None else float(2**codes - 1 - black)
        return 1.0 if declaration.unit == "1" else largest
    if set(declaration.dims) - {"stage"}:
        return largest
    own = np.abs(np.where(known, reference, 1.0))
    return np.where(own > 0, own, 1.0 if declaration.unit == "1" else largest)

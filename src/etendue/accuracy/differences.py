"""How far one run of a variable is from another, relative to full scale.

In:  the same variable of two runs, its declaration, the stage that writes it.
Out: ``Difference``: rms over the picture and the largest pixel.

Full scale is 1 for pictures without a unit, white - black for codes that have a black (``Variable.black``), and the
largest value of the reference for all else. What has no place is relative: figures by stage each to itself, vectors and
matrices to their largest element. ``Variable.full`` says otherwise: a share of pixels is a share of the frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from etendue.contract.arrays.variables import Declaration, variable
from etendue.contract.stage import Stage
from etendue.contract.wording import Unit, units


@dataclass(frozen=True)
class VariableError:
    """``rms`` and ``largest`` relative to ``scale``; None where the two cannot be compared, and ``why``."""

    rms: float | None
    largest: float | None
    scale: float
    why: str = ""


def difference(found: Any, reference: Any, declaration: Declaration, stage: Stage) -> VariableError:
    """Of two arrays of one variable that ``stage`` has written.

    Values that are undefined in both runs do not count; where only one of them is undefined, nothing can be said. Of
    codes without a unit (flags, maps, places in a list) the error is the share that differs, as its root.
    """
    found, reference = np.asarray(found), np.asarray(reference)
    if found.shape != reference.shape:
        return VariableError(None, None, math.nan, f"{found.shape} values beside {reference.shape} of the reference")
    if (declaration.dtype != "float" and declaration.unit == "1") or variable(declaration.variable).index:
        same = (found == reference) | ((found != found) & (reference != reference))
        share = 1.0 - float(np.mean(same)) if found.size else 0.0
        return VariableError(math.sqrt(share), float(share > 0), 1.0)
    found, reference = found.astype(np.float64), reference.astype(np.float64)
    known = np.isfinite(reference)
    if not np.array_equal(known, np.isfinite(found)):
        return VariableError(None, None, math.nan, "undefined at other places than the reference")
    if not known.any():
        return VariableError(0.0, 0.0, 1.0)
    scale = full_scale(reference, known, declaration, stage)
    away = np.abs(found - reference)[known] / np.broadcast_to(scale, known.shape)[known]
    largest = float(away.max())
    rms = largest * float(np.sqrt(np.mean((away / largest) ** 2))) if largest > 0 else 0.0
    return VariableError(rms, largest, float(np.max(scale)))


def full_scale(reference: Any, known: Any, declaration: Declaration, stage: Stage) -> Any:
    """What errors of a variable are relative to: a number, or one for each value."""
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

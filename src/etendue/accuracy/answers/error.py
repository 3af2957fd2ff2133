"""The error of an answer: the difference between a wanted variable and the result of the same pipeline with everything
refined.

In:  differences between evaluations of one point (`refinement`).
Out: the error of a variable and its parts: omissions, bins, spacing, margin.

The error of a picture is relative to full scale: rms over the frame, and at the pixel with the largest error. The error
of a number is in its unit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from etendue.accuracy.differences import difference
from etendue.archive.read.differing import apart
from etendue.contract.arrays.variables import Declaration, variable
from etendue.contract.stage import Stage
from etendue.types.documents import AxisValues, Document, DocumentView

if TYPE_CHECKING:
    from etendue.types.arrays import Array

OMISSIONS = "omissions"


@dataclass(frozen=True)
class Part:
    """One source of error. ``rms`` and ``max`` are relative to full scale for pictures, and in the unit of the variable
    for numbers.
    """

    rms: float
    max: float
    basis: str = "refined"  # how it was determined: 'refined', 'reference' (omissions) or 'bound'

    def __mul__(self, factor: float) -> Part:
        return replace(self, rms=self.rms * factor, max=self.max * factor)


@dataclass(frozen=True)
class AnswerError:
    """The error of one wanted variable.

    ``parts``: contributions to the total by name. ``fixed``: discretisations that cannot be refined, with the reason.
    ``open``: parts that were not measured, with the reason; if there are any, the total is a lower limit.
    """

    stage: str
    variable: str
    unit: str  # unit of rms and max; '' for relative to full scale
    parts: Mapping[str, Part] = field(default_factory=dict)
    fixed: Mapping[str, str] = field(default_factory=dict)
    open: Mapping[str, str] = field(default_factory=dict)
    points: int = 1  # number of points of the sweep that were measured
    # Half width of the 95 % interval about one draw of the noise; None without noise, or if not measured.
    noise: float | None = None
    scaled: float = 1.0  # factor on the errors for points of the sweep that were not measured

    @property
    def rms(self) -> float:
        """The total error: the sum of all parts."""
        return math.fsum(part.rms for part in self.parts.values())

    @property
    def max(self) -> float:
        return math.fsum(part.max for part in self.parts.values())

    def document(self) -> Document:
        """Return the document that is stored and printed by ``--json``."""
        return {**asdict(self), "rms": self.rms, "max": self.max}


def error_of(document: DocumentView) -> AnswerError:
    """Return the stored error."""
    own = {name: value for name, value in document.items() if name not in ("rms", "max", "parts")}
    parts = {
        name: Part(_number(part["rms"]), _number(part["max"]), str(part["basis"]))
        for name, part in document["parts"].items()
    }
    return AnswerError(**own, parts=parts)


def _number(stored: float | None) -> float:
    return math.nan if stored is None else float(stored)


@dataclass(frozen=True)
class AnswerErrors:
    """The errors of all wanted variables.

    ``errors``: the errors over the whole sweep, by name of the variable (``stage.name`` if two stages write it).
    ``shown``: the errors at the one point of the sweep that the contact sheet and the headline metrics show; ``at``:
    the axis values of this point.
    """

    errors: Mapping[str, AnswerError]
    shown: Mapping[str, AnswerError]
    at: AxisValues
    points: int = 1  # of the sweep, measured
    seconds: float = 0.0
    dear: float = 0.0  # predicted seconds of evaluations that exceeded the budget
    budget: float = 0.0  # budget, seconds
    remembered: bool = False
    why: str = ""  # reason why nothing could be measured; '' otherwise
    # By discretisation, the parameters that refine it by a factor of two.
    remedies: Mapping[str, str] = field(default_factory=dict)

    def document(self) -> Document:
        """Return the document that is stored and printed by ``--json``."""
        return {
            "errors": {name: error.document() for name, error in self.errors.items()},
            "shown": {name: error.document() for name, error in self.shown.items()},
            "at": dict(self.at),
            "points": self.points,
            "seconds": self.seconds,
            "dear": self.dear,
            "budget": self.budget,
            "remembered": self.remembered,
            "why": self.why,
            "remedies": dict(self.remedies),
        }


def answers_of(document: DocumentView) -> AnswerErrors | None:
    """Return the stored errors; None if the document has another form."""
    try:
        errors, shown = ({n: error_of(one) for n, one in document[name].items()} for name in ("errors", "shown"))
        remedies = {str(name): str(text) for name, text in document.get("remedies", {}).items()}
        seconds, dear, budget = (_number(document[name]) for name in ("seconds", "dear", "budget"))
        return AnswerErrors(
            errors, shown, document["at"], int(document["points"]), seconds, dear, budget, True, "", remedies
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        return None


def is_number(declaration: Declaration) -> bool:
    """Return whether a variable is one quantity, or one per stage, rather than a picture, a curve or a code."""
    return (
        set(declaration.dims) <= {"stage"} and declaration.dtype == "float" and not variable(declaration.variable).index
    )


def part_between(found: Array, reference: Array, declaration: Declaration, stage: Stage) -> Part | str:
    """Return the difference between two evaluations of a variable; a text with the reason if they cannot be compared.

    For a number per stage, ``rms`` is the error after the last stage and ``max`` the largest error over all stages.
    """
    if not is_number(declaration):
        own = difference(found, reference, declaration, stage)
        if own.relative is None or own.largest_relative is None:
            return own.why or "undefined at other places than in the reference"
        return Part(own.relative, own.largest_relative)
    one, other = (np.ravel(np.asarray(array, dtype=float)) for array in (found, reference))
    if one.shape != other.shape:
        return "it has another shape"
    away = apart(one, other)
    known = np.isfinite(other)
    if not np.isfinite(away[known]).all():
        return "it is undefined in one of the two results"
    if not known.any() and np.array_equal(one, other):
        return Part(0.0, 0.0)  # infinite in both evaluations
    if not known.any():
        return "it is undefined in the noise-free or in the present result"
    return Part(float(away[-1] if known[-1] else away[known].max()), float(away[known].max()))


def worst(errors: Iterable[AnswerError]) -> AnswerError:
    """Return the error of a variable over several points: the largest value of each part."""
    every = list(errors)
    parts: dict[str, Part] = {}
    for one in every:
        for name, part in one.parts.items():
            known = parts.get(name)
            parts[name] = (
                part if known is None else replace(part, rms=max(part.rms, known.rms), max=max(part.max, known.max))
            )
    missing = {name: why for one in every for name, why in one.open.items()}
    fixed = {name: why for one in every for name, why in one.fixed.items()}
    noise = max((one.noise for one in every if one.noise is not None), default=None)
    return replace(every[0], parts=parts, open=missing, fixed=fixed, points=len(every), noise=noise)


def scaled(errors: Mapping[str, AnswerError], factor: float) -> dict[str, AnswerError]:
    """Return errors multiplied by a factor, for points that were not measured."""
    return {
        name: replace(one, parts={part: own * factor for part, own in one.parts.items()}, scaled=factor)
        for name, one in errors.items()
    }

"""``Pipeline.compare``: rank alternatives from Python."""

from __future__ import annotations

from typing import TYPE_CHECKING

from etendue.builder.pipeline import number
from etendue_lab.compare.axis import parse_axis
from etendue_lab.compare.study import compare as ranked

if TYPE_CHECKING:
    from etendue.builder.pipeline import Pipeline
    from etendue_lab.compare.study import Comparison


def compare(pipeline: Pipeline, axis: str, *, repeat: int = 5, noise_free: bool = False) -> Comparison:
    """Rank alternatives by quality against run time, as ``etendue compare --axis`` does."""
    return ranked(pipeline.written(), parse_axis(axis, number), repeat, noise_free)

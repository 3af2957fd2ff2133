"""``Pipeline.quality``: compare a camera with the ideal one, from Python."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from etendue.contract.registry import installed_stages
from etendue_lab.quality.study import quality as measured

if TYPE_CHECKING:
    from etendue.builder.pipeline import Pipeline
    from etendue_lab.quality.study import IdealComparison


def quality(pipeline: Pipeline, **how: Any) -> IdealComparison:
    """Compare the camera with the ideal camera, as ``etendue quality`` does."""
    return measured(pipeline.written(), installed_stages(), **how)

"""Values given as keyword arguments, as overrides of a pipeline file.

In:  ``NAME=4``, ``STAGE__PARAMETER=2``, ``NAME=[2, 4]``, ``seed=2``.
Out: ``{"TABLE.NAME": 4, "STAGE.PARAMETER": 2, "sweep.NAME": [2, 4], "seed": 2}``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from etendue.contract.ports import CellReport
from etendue.contract.values.tables import SHARED
from etendue.errors import PluginError
from etendue.pipeline.overrides import TOP
from etendue.plan.model import Plan
from etendue.types.documents import Document


def overrides_of(parameters: Mapping[str, Any], want: str | Iterable[str] | None = None) -> Document:
    """Convert keyword arguments to overrides of a pipeline file; ``want``: variable or variables to compute."""
    overrides: Document = {}
    for name, value in parameters.items():
        key = name.replace("__", ".")
        if type(value).__module__ == "numpy":
            value = value.tolist()
        if key in TOP:
            overrides[key] = value
        elif isinstance(value, list | tuple | dict):
            overrides[f"sweep.{key}"] = list(value) if not isinstance(value, dict) else value
        else:
            overrides[key if "." in key else f"{SHARED}.{key}"] = value
    if want is not None:
        overrides["wanted"] = [want] if isinstance(want, str) else list(want)
    return overrides


def raise_failed(plan: Plan, failed: list[CellReport]) -> None:
    """Raise an error that names the first failed cell."""
    if failed:
        first = failed[0]
        ref = (first.stage, first.index)
        raise PluginError(
            f"{len(failed)} cells failed; the first: {first.stage} {plan.labels(ref)}, {plan.origin(ref)}: "
            f"{first.message}"
        )

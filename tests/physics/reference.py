"""The high-precision cases: inputs as exact binary64, outputs computed with 60 digits, and the fair tolerance.

``cond`` of a case is the largest relative sensitivity to an input, so that ``1e-14 * max(1, cond)`` is what a
good float64 kernel can hold, and ``3e-7 * max(1, cond)`` a good float32 one.
"""

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

FILE = Path(__file__).parent.parent / "data" / "physics_reference.json"


@cache
def document() -> dict[str, Any]:
    return json.loads(FILE.read_text())


def number(value: Any) -> Any:
    if isinstance(value, list):
        return [number(item) for item in value]
    return float(value)


def cases(group: str, unit_tolerance: float = 1e-14) -> Iterator[tuple[dict[str, float], Any, float]]:
    """Inputs, output and relative tolerance of every case of a group."""
    for entry in document()["groups"]:
        if entry["name"] == group:
            for case in entry["cases"]:
                rtol = unit_tolerance * max(1.0, float(case.get("cond") or 0.0))
                yield {k: float(v) for k, v in case["in"].items()}, number(case["out"]), rtol
            return
    raise KeyError(group)


def extra(name: str) -> Any:
    return document()["extra"][name]

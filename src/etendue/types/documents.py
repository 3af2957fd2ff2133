"""Names of document types for annotations: tables of JSON or TOML, as Python's own types.

Out: names of types.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Document = dict[str, Any]  # texts, numbers, booleans, None, and lists and documents of them
DocumentView = Mapping[str, Any]  # the same, read-only
Scalar = str | float | bool | None  # a single value of a document
AxisValue = Scalar | tuple[Scalar, ...]
AxisValues = Mapping[str, AxisValue]  # values by axis

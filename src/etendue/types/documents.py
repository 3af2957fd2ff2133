"""What documents are called in annotations: tables of JSON or TOML, as Python's own types.

Out: names of types.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Document = dict[str, Any]  # texts, numbers, truth, nothing, and lists and documents of them
DocumentView = Mapping[str, Any]  # the same, to be read
Scalar = str | float | bool | None  # of a document
AxisValue = Scalar | tuple[Scalar, ...]
AxisValues = Mapping[str, AxisValue]  # a value for each of some axes

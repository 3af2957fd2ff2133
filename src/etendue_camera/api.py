"""API for plugins about cameras, in addition to ``etendue.api``: roles of stages, and the base classes that belong to
them.

Import ``spectra`` (illuminants, observers, cameras, tables as bin means) separately if needed.
"""

import importlib
from typing import Any

from etendue_camera.roles import Displaying, EdgeScene, FlatScene, InSilicon, Scaled

__all__ = ["Displaying", "EdgeScene", "FlatScene", "InSilicon", "Scaled"]


def __getattr__(name: str) -> Any:
    if name == "spectra":
        return importlib.import_module("etendue_camera.spectra")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

"""The door for plugins that know a camera: roles of its stages and their typed bases, beside what ``etendue.api``
gives.

``spectra`` (lights, eyes, cameras, tables as bin means) is imported by who asks for it.
"""

import importlib
from typing import Any

from etendue_camera.roles import Displaying, EdgeScene, FlatScene, InSilicon, Scaled

__all__ = ["Displaying", "EdgeScene", "FlatScene", "InSilicon", "Scaled"]


def __getattr__(name: str) -> Any:
    if name == "spectra":
        return importlib.import_module("etendue_camera.spectra")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

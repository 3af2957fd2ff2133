"""The door for plugins: everything a stage from another distribution needs, besides ``etendue.physics``."""

import importlib
from typing import Any

from etendue.errors import EtendueError, Fault, PluginError, RequestError
from etendue.hookspecs import hookimpl
from etendue.labelled import labelled
from etendue.spec.camera import quantity
from etendue.spec.capabilities import (
    Banded,
    Bounded,
    ChannelTransfer,
    Haloed,
    Probe,
    Sampled,
    Source,
    Summed,
    Tinting,
    Transfer,
    Viewed,
    moves_light,
)
from etendue.spec.facts import UNKNOWN, Facts
from etendue.spec.found import ends
from etendue.spec.grid import RGB, XYZ, Bands, Grid, Labels, Line
from etendue.spec.parameter import param
from etendue.spec.roles import Datasheet, Displaying, EdgeScene, FlatScene, InSilicon, Noisy, Scaled
from etendue.spec.stage import Stage, file_state
from etendue.spec.stated import fitted, measured, proved

__all__ = [
    "RGB", "UNKNOWN", "XYZ", "Banded", "Bands", "Bounded", "ChannelTransfer", "Datasheet", "Displaying", "EdgeScene", "EtendueError",
    "Facts", "Fault", "FlatScene", "Grid", "Haloed", "InSilicon", "Labels", "Line", "Noisy", "PluginError", "Probe", "RequestError",
    "Sampled", "Scaled", "Source", "Stage", "Summed", "Tinting", "Transfer", "Viewed", "ends", "file_state", "fitted", "hookimpl",
    "labelled", "measured", "moves_light", "param", "proved", "quantity",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """``spectra`` (lights, eyes, cameras, tables as bin means) is imported by who asks for it."""
    if name == "spectra":
        return importlib.import_module("etendue.spectra")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

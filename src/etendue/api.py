"""The door for plugins: everything a stage from another distribution needs, besides ``etendue_camera``."""

import importlib
from typing import Any

from etendue.contract.capabilities import (
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
from etendue.contract.facts import UNKNOWN, Facts
from etendue.contract.found import ends
from etendue.contract.grid import RGB, XYZ, Bands, Grid, Labels, Line
from etendue.contract.labelled import labelled
from etendue.contract.parameter import param
from etendue.contract.quantities import quantity
from etendue.contract.roles import Datasheet, Displaying, EdgeScene, FlatScene, InSilicon, Noisy, Scaled
from etendue.contract.stage import Stage, file_state
from etendue.contract.stated import fitted, measured, proved
from etendue.errors import EtendueError, Fault, PluginError, RequestError
from etendue.plugins.hookspecs import hookimpl

__all__ = [
    "RGB", "UNKNOWN", "XYZ", "Banded", "Bands", "Bounded", "ChannelTransfer", "Datasheet", "Displaying", "EdgeScene", "EtendueError",
    "Facts", "Fault", "FlatScene", "Grid", "Haloed", "InSilicon", "Labels", "Line", "Noisy", "PluginError", "Probe", "RequestError",
    "Sampled", "Scaled", "Source", "Stage", "Summed", "Tinting", "Transfer", "Viewed", "ends", "file_state", "fitted", "hookimpl",
    "labelled", "measured", "moves_light", "param", "proved", "quantity",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """``spectra`` (lights, eyes, cameras, tables as bin means) is imported by who asks for it."""
    if name == "spectra":
        return importlib.import_module("etendue_camera.spectra")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

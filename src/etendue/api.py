"""The door for plugins: everything a stage from another distribution needs of the engine."""

from etendue.contract.capabilities import (
    Banded,
    Bounded,
    ChannelTransfer,
    Datasheet,
    Haloed,
    Noisy,
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
from etendue.contract.stage import Stage, file_state
from etendue.contract.stated import fitted, measured, proved
from etendue.errors import EtendueError, Fault, PluginError, RequestError
from etendue.plugins.hookspecs import hookimpl

__all__ = [
    "RGB", "UNKNOWN", "XYZ", "Banded", "Bands", "Bounded", "ChannelTransfer", "Datasheet", "EtendueError", "Facts", "Fault", "Grid",
    "Haloed", "Labels", "Line", "Noisy", "PluginError", "Probe", "RequestError", "Sampled", "Source", "Stage", "Summed", "Tinting",
    "Transfer", "Viewed", "ends", "file_state", "fitted", "hookimpl", "labelled", "measured", "moves_light", "param", "proved", "quantity",
]  # fmt: skip

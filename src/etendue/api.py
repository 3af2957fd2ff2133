"""The door for plugins: everything a stage from another distribution needs, besides ``etendue.physics``."""

from etendue.errors import EtendueError, Fault, PluginError, RequestError
from etendue.hookspecs import hookimpl
from etendue.spec.camera import quantity
from etendue.spec.facts import UNKNOWN, Facts
from etendue.spec.found import ends
from etendue.spec.grid import RGB, XYZ, Bands, Grid, Labels, Line
from etendue.spec.roles import Adapting, Displaying, EdgeScene, FlatScene, InSilicon, Noisy, Scaled
from etendue.spec.stage import Probe, Stage, param
from etendue.spec.stated import fitted, measured, proved

__all__ = [
    "RGB", "UNKNOWN", "XYZ", "Adapting", "Bands", "Displaying", "EdgeScene", "EtendueError", "Facts", "Fault", "FlatScene", "Grid",
    "InSilicon", "Labels", "Line", "Noisy", "PluginError", "Probe", "RequestError", "Scaled", "Stage", "ends", "fitted", "hookimpl",
    "measured", "param", "proved", "quantity",
]  # fmt: skip

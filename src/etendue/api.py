"""The door for plugins: everything a stage from another distribution needs, besides ``etendue.physics``."""

from etendue.errors import EtendueError, Fault, PluginError, RequestError
from etendue.hookspecs import hookimpl
from etendue.spec.camera import quantity
from etendue.spec.facts import UNKNOWN, Facts
from etendue.spec.found import ends
from etendue.spec.grid import RGB, XYZ, Bands, Grid, Labels, Line
from etendue.spec.stage import Probe, Stage, moves_light, param
from etendue.spec.stated import fitted, measured, proved

__all__ = [
    "RGB", "UNKNOWN", "XYZ", "Bands", "EtendueError", "Facts", "Fault", "Grid", "Labels", "Line", "PluginError",
    "Probe", "RequestError", "Stage", "ends", "fitted", "hookimpl", "measured", "moves_light", "param", "proved", "quantity",
]  # fmt: skip

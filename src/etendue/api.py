"""The API for plugins: everything that a stage of another distribution needs from the engine.

Names are imported on first use, because every ``etendue --help`` reads manifests, and those need only ``hookimpl``.
"""
# ruff: noqa: F401 - imported here to be re-exported

from typing import TYPE_CHECKING, Any

from etendue.plugins.hookspecs import hookimpl

if TYPE_CHECKING:
    from etendue.contract.arrays.facts import UNKNOWN, Facts
    from etendue.contract.arrays.grid import RGB, XYZ, Bands, Grid, Labels, Line
    from etendue.contract.capabilities import (
        Banded,
        Bounded,
        ChannelTransfer,
        Datasheet,
        Discretised,
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
    from etendue.contract.labelled import labelled
    from etendue.contract.stage import Stage, file_state
    from etendue.contract.stated import fitted, measured, proved
    from etendue.contract.values.late_bound import ends
    from etendue.contract.values.parameter import param
    from etendue.contract.values.quantities import quantity
    from etendue.errors import EtendueError, Fault, PluginError, RequestError

__all__ = [
    "RGB",
    "UNKNOWN",
    "XYZ",
    "Banded",
    "Bands",
    "Bounded",
    "ChannelTransfer",
    "Datasheet",
    "Discretised",
    "EtendueError",
    "Facts",
    "Fault",
    "Grid",
    "Haloed",
    "Labels",
    "Line",
    "Noisy",
    "PluginError",
    "Probe",
    "RequestError",
    "Sampled",
    "Source",
    "Stage",
    "Summed",
    "Tinting",
    "Transfer",
    "Viewed",
    "ends",
    "file_state",
    "fitted",
    "hookimpl",
    "labelled",
    "measured",
    "moves_light",
    "param",
    "proved",
    "quantity",
]


def _imported() -> dict[str, Any]:
    """Return all names. They are in import statements so that ``plan.identity.code`` finds their definitions in this
    file.
    """
    from etendue.contract.arrays.facts import UNKNOWN, Facts
    from etendue.contract.arrays.grid import RGB, XYZ, Bands, Grid, Labels, Line
    from etendue.contract.capabilities import (
        Banded,
        Bounded,
        ChannelTransfer,
        Datasheet,
        Discretised,
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
    from etendue.contract.labelled import labelled
    from etendue.contract.stage import Stage, file_state
    from etendue.contract.stated import fitted, measured, proved
    from etendue.contract.values.late_bound import ends
    from etendue.contract.values.parameter import param
    from etendue.contract.values.quantities import quantity
    from etendue.errors import EtendueError, Fault, PluginError, RequestError

    return locals()


def __getattr__(name: str) -> Any:
    if name in __all__:
        globals().update(_imported())
        return globals()[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

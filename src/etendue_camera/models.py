"""Built-in stages as base classes for other stages: ``from etendue_camera.models import DemosaicBilinear``.

In:  the name of a class.
Out: the class; its module is imported on access. Class names are as stable as stage names; modules may move.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import Any

from etendue.errors import nearest
from etendue.plugins import discovery

OWN = "etendue"  # the distribution of the package


def _places() -> dict[str, str]:
    """Return ``module:Class`` of each built-in stage, by class name."""
    found = discovery.installed()
    brought = (found.all("stages", name)[0] for name in found.names("stages"))
    return {
        one.value.rpartition(":")[2]: one.value
        for one in brought
        if one.distribution == OWN and isinstance(one.value, str)
    }


def __getattr__(name: str) -> Any:
    """Return the class from its module. The registry is not used, because it may be loading the plugin that imports
    this class.
    """
    if name.startswith("__"):
        raise AttributeError(name)
    places = _places()
    if name not in places:
        raise AttributeError(f"no built-in stage has a class {name!r}{nearest(name, places)}")
    return EntryPoint(name, places[name], "").load()


def __dir__() -> list[str]:
    return sorted(_places())

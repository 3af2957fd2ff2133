"""Make pages of the public Python names: ``etendue``, the plugin interface, its tests, and the camera's kernels by
subject.
"""

import importlib
import pkgutil
from inspect import isclass, isfunction

import etendue
import etendue.api
from making.markdown import shown, toctree

WINGS = (
    "scene",
    "light",
    "optics",
    "field",
    "sensor",
    "electronics",
    "mosaic",
    "restoration",
    "colour",
    "resolution",
    "quality",
)


def pages() -> dict[str, str]:
    """Return pages by name."""
    own = [_said("etendue", name) for name in etendue.__all__ if name != "stages"]
    made = {
        "python/etendue": "\n\n".join(
            [
                "# etendue",
                "Public names of `import etendue`. `etendue.stages` has a function per [stage](../stages/index.md).",
                *own,
            ]
        ),
        "python/api": "\n\n".join(
            [
                "# etendue.api",
                "Names for stages of other distributions; [a stage of your own](../../plugins.md) shows their use.",
                *[_said("etendue.api", name) for name in etendue.api.__all__],
            ]
        ),
        "python/testing": "\n\n".join(
            [
                "# etendue.testing",
                "The laws that every stage must obey, for its tests.",
                _module("etendue.testing.conformance"),
            ]
        ),
    }
    for wing in WINGS:
        package = importlib.import_module(f"etendue_camera.{wing}")
        modules = [
            f"{package.__name__}.{found.name}"
            for found in pkgutil.iter_modules(package.__path__)
            if found.name != "stages"
        ] or [package.__name__]
        parts = [f"# etendue_camera.{wing}", "Kernels: plain functions on arrays."]
        made[f"python/{wing}"] = "\n\n".join(
            [*parts, *[f"## {shown(name.rpartition('.')[2])}\n\n{_module(name)}" for name in modules]]
        )
    names = [name.removeprefix("python/") for name in made]
    return {**made, "python/index": "\n\n".join(["# Python", "From the docstrings.", toctree(names, ":maxdepth: 1")])}


def _said(module: str, name: str) -> str:
    thing = getattr(importlib.import_module(module), name)
    if isclass(thing):
        return _directive("autoclass", f"{module}.{name}", ":members:", ":exclude-members: __init__, __new__")
    if isfunction(thing):
        return _directive("autofunction", f"{module}.{name}")
    return _directive("autodata", f"{module}.{name}", ":no-value:")


def _module(name: str) -> str:
    return _directive("automodule", name, ":members:")


def _directive(kind: str, name: str, *options: str) -> str:
    lines = [f".. {kind}:: {name}", *[f"   {option}" for option in options]]
    return "\n".join(["```{eval-rst}", *lines, "```"])

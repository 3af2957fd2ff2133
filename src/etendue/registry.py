"""Find stages by entry-point metadata, load those that are used.

Names, near-misses and clashes come from metadata alone; a plugin that cannot be imported fails only what uses it.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points

import pluggy

from etendue import hookspecs
from etendue.errors import PluginError
from etendue.interrupts import is_ours
from etendue.spec.stage import Stage, arguments_of, check_class, parameters_of, reads_of, writes_of
from etendue.telling import here, plain, said

OWN = "etendue"  # the distribution of the package


@dataclass(frozen=True)
class Installed:
    """A stage that is installed: its name, where it comes from, and its module."""

    name: str
    distribution: str
    version: str
    module: str


class Registry:
    """Stages by name. Built once per process with ``installed_stages``; tests may build their own."""

    def __init__(self, points: dict[str, list[EntryPoint]]) -> None:
        self._points = points
        self._manager = pluggy.PluginManager(hookspecs.PROJECT)
        self._manager.add_hookspecs(hookspecs)
        self._loaded: dict[str, type[Stage]] = {}
        self._installed: dict[str, Installed] = {}
        self._lock = threading.Lock()

    def names(self) -> list[str]:
        return sorted(self._points)

    def __contains__(self, name: object) -> bool:
        return name in self._points

    def clash(self, name: str) -> list[str]:
        """The distributions that offer this name, when more than one does."""
        points = self._points.get(name, [])
        return [point.dist.name if point.dist else "?" for point in points] if len(points) > 1 else []

    def fitting(self, fits: Callable[[type[Stage]], bool]) -> Iterator[str]:
        """The stages that can be loaded and of which something holds, those of the package first."""
        for name in sorted(self._points, key=lambda name: (self.installed(name).distribution != OWN, name)):
            with contextlib.suppress(PluginError):
                if not self.clash(name) and fits(self.load(name)):
                    yield name

    def makers(self, variable: str) -> Iterator[str]:
        """The stages that write a variable without reading it."""
        return self.fitting(
            lambda kind: variable in {d.variable for d in writes_of(kind).values()} - {d.variable for d in reads_of(kind).values()}
        )

    def installed(self, name: str) -> Installed:
        known = self._installed.get(name)
        if known is None:  # once: a name and a version each parse all metadata of their distribution
            point = self._points[name][0]
            dist = point.dist
            known = Installed(name, dist.name if dist else "?", dist.version if dist else "?", point.value)
            self._installed[name] = known
        return known

    def load(self, name: str) -> type[Stage]:
        """Import the module of one stage and return its class.

        Raises
        ------
        PluginError
            The module cannot be imported, has no hook, or the class breaks the form of a stage.
        """
        with self._lock:
            if name not in self._loaded:
                self._loaded[name] = self._load(name)
            return self._loaded[name]

    def _load(self, name: str) -> type[Stage]:
        point = self.installed(name)
        folder = here()
        origin = f"stage {name!r} of {point.distribution} {point.version}"
        try:
            # The entry point is loaded directly: pluggy's own loader walks all distributions at every call.
            module = self._points[name][0].load()
            if not self._manager.is_registered(module):
                self._manager.register(module, name=point.module)
            impls = [impl for impl in self._manager.hook.etendue_stages.get_hookimpls() if impl.plugin is module]
            if not impls:
                raise PluginError(f"{point.module} has no @hookimpl etendue_stages")
            kind = impls[0].function()[name]  # type: ignore[index]
        except BaseException as error:  # a module that ends the process at import is broken like any other
            if is_ours(error):
                raise
            reason = " ".join(said(error).split())[:300]
            raise PluginError(f"{origin} cannot be loaded: {reason}") from error
        finally:
            if folder and here() != folder:  # the rest of a request is read where it was made
                os.chdir(folder)
        try:
            reads_of(kind), writes_of(kind), parameters_of(kind), arguments_of(kind)
            check_class(kind)
        except BaseException as error:
            if is_ours(error):
                raise
            reason = plain(str(error)) if isinstance(error, TypeError | ValueError) else said(error)
            raise PluginError(f"{origin} is not a valid stage: {reason}") from error
        return kind


@cache
def installed_stages() -> Registry:
    """The stages of all installed distributions."""
    points: dict[str, list[EntryPoint]] = {}
    for point in entry_points(group=hookspecs.GROUP):
        known = points.setdefault(point.name, [])
        if not any((p.dist and point.dist and p.dist.name == point.dist.name and p.value == point.value) for p in known):
            known.append(point)
    return Registry(points)

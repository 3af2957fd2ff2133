"""Stages by name: known from the manifests of installed distributions, and loaded on first use.

Names, suggestions and clashes need no stage module, and a stage that cannot be imported affects only pipelines that use
it.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from functools import cache
from importlib.metadata import EntryPoint

from etendue.contract.class_checks import check_class
from etendue.contract.stage import Stage, arguments_of, parameters_of, reads_of, writes_of
from etendue.errors import PluginError
from etendue.interrupts import is_ours
from etendue.plugins import discovery
from etendue.plugins.discovery import Brought, Discovery, foreign
from etendue.telling import plain, said

OWN = "etendue"  # the distribution of the package


class Registry:
    """Stages by name. ``installed_stages`` builds it once per process; tests may build their own."""

    def __init__(self, found: Discovery) -> None:
        self.found = found
        self._loaded: dict[str, type[Stage]] = {}
        self._lock = threading.Lock()

    def names(self) -> list[str]:
        return sorted(self.found.names("stages"))

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self.found.first("stages", name) is not None

    def fitting(self, fits: Callable[[type[Stage]], bool]) -> Iterator[str]:
        """Yield the loadable stages that satisfy a condition, stages of this package first."""
        for name in sorted(self.names(), key=lambda name: (self.installed(name).distribution != OWN, name)):
            with contextlib.suppress(PluginError):
                if fits(self.load(name)):
                    yield name

    def makers(self, variable: str) -> Iterator[str]:
        """Yield the stages that write a variable without reading it."""
        return self.fitting(
            lambda kind: (
                variable
                in {d.variable for d in writes_of(kind).values()} - {d.variable for d in reads_of(kind).values()}
            )
        )

    def installed(self, name: str) -> Brought:
        """Return the place where a stage is defined, and its distribution."""
        return self.found.all("stages", name)[0]

    def load(self, name: str) -> type[Stage]:
        """Import the module of one stage and return its class.

        Raises
        ------
        PluginError
            If two distributions provide the stage, its module cannot be imported or has no such class, or the class is
            not a valid stage.
        """
        with self._lock:
            if name not in self._loaded:
                self._loaded[name] = self._load(name)
            return self._loaded[name]

    def _load(self, name: str) -> type[Stage]:
        brought = self.installed(name)
        kind, origin = brought.value, f"stage {name!r} of {brought.origin}"
        if clash := self.found.clash("stages", name):
            raise PluginError(f"the stage {name!r} is {clash}")
        if isinstance(kind, str):
            if ":" not in kind:
                raise PluginError(
                    f"{origin} cannot be loaded: its entry is {kind!r}; expected 'module:Class' or the class itself"
                )
            with foreign(
                f"{origin} cannot be loaded", "" if brought.distribution == OWN else f"{origin}, when it was imported,"
            ):
                kind = EntryPoint(name, kind, "").load()
        try:
            reads_of(kind), writes_of(kind), parameters_of(kind), arguments_of(kind)
            check_class(kind)
        except BaseException as error:
            if is_ours(error):
                raise
            reason = plain(str(error)) if isinstance(error, TypeError | ValueError) else said(error)
            raise PluginError(f"{origin} is not a valid stage: {reason}") from error
        return kind  # type: ignore[no-any-return]


@cache
def installed_stages() -> Registry:
    """Return the stages of all installed distributions."""
    return Registry(discovery.installed())

"""What everybody who computes must have in common with the owner of a run: libraries, processor, code of stages, the
archive.

In:  what the owner has.
Out: for a worker, in words, in what it differs; bits would differ with it, or results be lost.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from etendue.contract.stage import Stage
from etendue.errors import MachineError, shortened
from etendue.plan.code import code_digest
from etendue.plan.keys import version_of
from etendue.run.memory import keep_freed_memory
from etendue.telling import said
from etendue.types.documents import Document, DocumentView

Platform = Callable[[], Mapping[str, Any]]  # what bits depend on, of the process that asks
Mark = tuple[str, bytes]  # a file that all who compute must see, and what it holds


@dataclass(frozen=True)
class Common:
    """What the owner of a run has, to be held against what a worker has. Travels."""

    run: str  # a name that no other run has
    platform: Platform
    has: DocumentView  # what ``platform`` gave the owner, and the version of etendue
    code: Mapping[
        tuple[str, str], tuple[str, str]
    ]  # of each stage, by module and class: the digest of its code, its distribution
    mark: Mark | None = None

    def differences(self) -> list[str]:
        """In what the process that asks differs, in words; [] where it may compute."""
        found = []
        for name, there in _has(self.platform).items():
            if there != self.has.get(name):
                found.append(
                    "other processor features"
                    if name == "cpu_features"
                    else f"{name} {there} (here {self.has.get(name)})"
                )
        for (module, kind), (digest, brought) in self.code.items():
            try:
                own = getattr(importlib.import_module(module), kind)
                if code_digest(own) != digest:
                    found.append(f"another code of the stage {kind} of {_brought_by(module)} (here of {brought})")
            except Exception as error:
                found.append(f"no stage {kind} of {brought}: {shortened(said(error), 120)}")
        if self.mark is not None:
            path, content = self.mark
            found += _sees(path, content)
        return found if len(found) <= 4 else [*found[:4], f"and {len(found) - 4} differences more"]


def common_of(run: str, stages: Iterable[type[Stage]], platform: Platform, mark: Mark | None) -> Common:
    """What the owner has. A class that no module holds travels whole, and is not looked for."""
    code = {}
    for kind in dict.fromkeys(stages):
        if kind.__module__ != "__main__" and "." not in kind.__qualname__ and kind is not Stage:
            code[kind.__module__, kind.__qualname__] = (code_digest(kind), _brought_by(kind.__module__))
    return Common(run, platform, _has(platform), code, mark)


def _has(platform: Platform) -> Document:
    return {**platform(), "etendue": version_of("etendue")}


def _brought_by(module: str) -> str:
    """'etendue 0.1.0': the distribution that holds a module, as its files say."""
    top = module.partition(".")[0]
    if top == "etendue":
        return f"etendue {version_of('etendue')}"
    names = importlib.metadata.packages_distributions().get(top, [])
    return f"{names[0]} {version_of(names[0])}" if names else top


def _sees(path: str, content: bytes) -> list[str]:
    """Whether the archive is there, is the one of the run, and can be written."""
    folder = os.path.dirname(path)
    try:
        with open(path, "rb") as file:
            if file.read() != content:
                return [f"another folder at {folder}, the path of the archive"]
    except OSError as error:
        return [f"no archive at {folder} ({error.strerror}): it must see the same folder at the same path"]
    return [] if os.access(folder, os.W_OK | os.X_OK) else [f"an archive at {folder} into which it may not write"]


_sound: set[str] = set()  # the runs for which this process has been found to be sound


def be_alike(common: Common) -> None:
    """In a worker, in front of its first batch of a run: it may have joined late, or stand in the place of one that
    died.

    Raises
    ------
    MachineError
        It differs: who, and in what.
    """
    if common.run in _sound:
        return
    keep_freed_memory()
    if found := common.differences():
        import distributed

        raise MachineError(refused({str(distributed.get_worker().address): found}))
    _sound.add(common.run)


def refused(found: Mapping[str, list[str]]) -> str:
    """Who is refused, and why: the first worker by name, and how many more."""
    address, differences = next(iter(found.items()))
    more = f" (and {len(found) - 1} more {'worker' if len(found) == 2 else 'workers'})" if len(found) > 1 else ""
    return (
        f"the worker {address}{more} cannot compute for this run; it has {'; '.join(differences)}. What is finished is "
        f"kept: "
        "end that worker or give it what this process has, and run again"
    )

"""Compare a worker with the owner of a run: libraries, processor, code of stages and archive must agree.

In:  the owner's state.
Out: for a worker, its differences in words. With any of them, bits would differ or results would be lost.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from etendue.contract.stage import Stage
from etendue.errors import MachineError, shortened
from etendue.plan.identity.code import code_digest
from etendue.plan.identity.keys import version_of
from etendue.run.memory import keep_freed_memory
from etendue.telling import said
from etendue.types.documents import Document, DocumentView

Platform = Callable[[], DocumentView]  # returns the properties of the calling process on which bits depend
Mark = tuple[str, bytes]  # a file that all workers must see, and its content


@dataclass(frozen=True)
class Common:
    """The state of the owner of a run, to be compared with the state of a worker. Sent to the workers."""

    run: str  # a unique name
    platform: Platform
    has: DocumentView  # the result of ``platform`` in the owner, and the version of etendue
    # by module and class of each stage: the digest of its code, its distribution
    code: Mapping[tuple[str, str], tuple[str, str]]
    mark: Mark | None = None

    def differences(self) -> list[str]:
        """Return texts that say how the calling process differs; [] if it may compute."""
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
                    found.append(f"different code of the stage {kind} in {_brought_by(module)} (here {brought})")
            except Exception as error:
                found.append(f"no stage {kind} of {brought}: {shortened(said(error), 120)}")
        if self.mark is not None:
            path, content = self.mark
            found += _sees(path, content)
        return found if len(found) <= 4 else [*found[:4], f"and {len(found) - 4} more differences"]


def common_of(run: str, stages: Iterable[type[Stage]], platform: Platform, mark: Mark | None) -> Common:
    """Return the owner's state. A class that workers cannot import is sent as a whole, so its code is not compared."""
    code = {}
    for kind in dict.fromkeys(stages):
        if kind.__module__ != "__main__" and "." not in kind.__qualname__ and kind is not Stage:
            code[kind.__module__, kind.__qualname__] = (code_digest(kind), _brought_by(kind.__module__))
    return Common(run, platform, _has(platform), code, mark)


def _has(platform: Platform) -> Document:
    return {**platform(), "etendue": version_of("etendue")}


def _brought_by(module: str) -> str:
    """Return the distribution that holds a module, such as 'etendue 0.1.0'."""
    top = module.partition(".")[0]
    if top == "etendue":
        return f"etendue {version_of('etendue')}"
    names = importlib.metadata.packages_distributions().get(top, [])
    return f"{names[0]} {version_of(names[0])}" if names else top


def _sees(path: str, content: bytes) -> list[str]:
    """Check that the archive exists at this path, belongs to the run and can be written."""
    folder = os.path.dirname(path)
    try:
        with open(path, "rb") as file:
            if file.read() != content:
                return [f"another folder at {folder}, the path of the archive"]
    except OSError as error:
        return [f"no archive at {folder} ({error.strerror}): it must have the same folder at the same path"]
    return [] if os.access(folder, os.W_OK | os.X_OK) else [f"no write access to the archive at {folder}"]


_sound: set[str] = set()  # the runs for which this process has passed the check


def be_alike(common: Common) -> None:
    """Check a worker before its first batch of a run: it may have joined late or replaced a worker that died.

    Raises
    ------
    MachineError
        The worker differs; the message names the worker and the differences.
    """
    if common.run in _sound:
        return
    keep_freed_memory()
    if found := common.differences():
        import distributed

        raise MachineError(refused({str(distributed.get_worker().address): found}))
    _sound.add(common.run)


def refused(found: Mapping[str, list[str]]) -> str:
    """Return the error about refused workers: the name and differences of the first, and the number of the others."""
    address, differences = next(iter(found.items()))
    more = f" (and {len(found) - 1} more {'worker' if len(found) == 2 else 'workers'})" if len(found) > 1 else ""
    return (
        f"the worker {address}{more} cannot compute for this run; it has {'; '.join(differences)}. Finished results "
        f"are kept: "
        "stop this worker or install the versions of this process on it, and run again"
    )

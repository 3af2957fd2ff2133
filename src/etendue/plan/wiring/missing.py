"""Distributions that a pipeline needs and that are not installed: each named once, with the command that installs it.

In:  the pipeline's ``requires`` and the stages it uses, the registry.
Out: faults; where there are any, nothing else can be said of the pipeline.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from etendue.contract.registry import Registry
from etendue.contract.values.units import as_written
from etendue.errors import Fault
from etendue.pipeline.file import PipelineFile
from etendue.plugins import discovery

_NAME = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9._\-]*[A-Za-z0-9])?")


@cache
def known_plugins() -> dict[str, str]:
    """The distribution of every stage that comes with a known one."""
    found = discovery.installed()
    brought = ((name, found.first("elsewhere", name)) for name in found.names("elsewhere"))
    return {stage: name for name, one in brought if one is not None for stage in one.value["stages"]}


def lacking(pipeline: PipelineFile, registry: Registry) -> list[Fault]:
    """One fault for each distribution that the pipeline names under ``requires``, or a stage of which it uses, and
    that is not there.
    """
    faults, named = [], dict[str, str]()
    for name in pipeline.requires:
        if not _NAME.fullmatch(name):
            faults.append(Fault("requires", f"expected the name of a distribution, got {as_written(name)}"))
        else:
            named.setdefault(name, "requires")
    used: dict[str, list[str]] = {}
    for place, use in _uses(pipeline):
        if use not in registry and use in known_plugins():
            named.setdefault(known_plugins()[use], place)
            used.setdefault(known_plugins()[use], []).append(use)
    for name, place in named.items():
        if not _installed(name) or name in used:
            of = f", which has {', '.join(dict.fromkeys(used[name]))}," if name in used else ""
            faults.append(Fault(place, f"{name}{of} is not installed: pip install {_where(name, pipeline.folder)}"))
    return faults


def _uses(pipeline: PipelineFile) -> Iterator[tuple[str, str]]:
    for entry in pipeline.stages:
        yield entry.place, entry.use
        swept = pipeline.sweep.get(f"{entry.name}.use", ())
        for value in swept if isinstance(swept, list | tuple) else ():
            use = value.get("use") if isinstance(value, dict) else value
            if isinstance(use, str):
                yield f"sweep.{entry.name}.use", use


def _installed(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True


def _where(name: str, folder: Path) -> str:
    """What to give to pip: the folder of the distribution in the repository that a pipeline lies in, else its name."""
    for parent in list(folder.absolute().parents)[:8]:
        found = parent / "plugins" / name
        if (found / "pyproject.toml").is_file():
            here = os.path.relpath(found)
            return str(found) if here.startswith("..") else here
    return name

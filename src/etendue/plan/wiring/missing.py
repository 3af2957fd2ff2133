"""Report distributions that a pipeline needs and that are not installed: each distribution once, with the command that
installs it.

In:  the pipeline's ``requires`` and the stages it uses, the registry.
Out: faults; if there are any, the rest of the pipeline cannot be checked.
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
    """Return the distribution of every stage that a known plugin provides."""
    found = discovery.installed()
    brought = ((name, found.first("elsewhere", name)) for name in found.names("elsewhere"))
    return {stage: name for name, one in brought if one is not None for stage in one.value["stages"]}


def lacking(pipeline: PipelineFile, registry: Registry) -> list[Fault]:
    """Return one fault for each distribution that is missing, although ``requires`` names it or the pipeline uses one
    of its stages.
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
            of = f", which provides {', '.join(dict.fromkeys(used[name]))}," if name in used else ""
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
    """Return the argument for pip: the plugin's folder in the repository that holds the pipeline, else its name."""
    for parent in list(folder.absolute().parents)[:8]:
        found = parent / "plugins" / name
        if (found / "pyproject.toml").is_file():
            here = os.path.relpath(found)
            return str(found) if here.startswith("..") else here
    return name

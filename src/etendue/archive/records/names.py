"""Names in an archive; they can be derived without a plan.

In:  stages and axis values, attributes of groups, the folder of an archive.
Out: names of cells, statuses, files and folders.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from etendue.types.documents import AxisValues

STATUS = ("done", "left_out", "failed", "skipped", "not_computed")
ROOT = "zarr.json"
SAME_AS = "same_as"  # attribute of a group: the arrays that hold the values of its variables that are left out
ROW = "_row"  # suffix to the name of a dim of combinations: the combination of every row
COMPACTED = ".compact.partial"


def cell_label(stage: str, labels: AxisValues) -> str:
    """Return the name of a cell in the journal."""
    return stage + "".join([label_of(dim, value) for dim, value in labels.items()])


def label_of(dim: str, value: object) -> str:
    return f" {dim}={value!r}" if isinstance(value, str) else f" {dim}={value}"


def paths_of(attrs: Mapping[Any, Any]) -> list[str]:
    """Return the paths of the arrays that the attribute ``same_as`` of a group names."""
    given = attrs.get(SAME_AS, ())
    return [str(path) for path in ([given] if isinstance(given, str) else given if isinstance(given, list) else ())]


def aside_of(folder: Path) -> Path:
    """Return the folder beside an archive into which ``compact --in-place`` rewrites it."""
    whole = folder.resolve()
    return whole.with_name(f".{whole.name}{COMPACTED}")


def left_by_compact(folder: Path) -> str:
    """Return the folder that a killed ``compact --in-place`` left; '' if there is none."""
    aside = aside_of(folder)
    return str(aside) if aside.is_dir() and not aside.is_symlink() else ""

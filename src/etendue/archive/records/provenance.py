"""The record that makes a run reproducible: inputs by content, versions, platform, and the pipeline as given and as
resolved.

No user, host or path of the machine is recorded.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import math
import os
import platform
import sys
import time
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from etendue.archive.records import disk
from etendue.archive.records.indented import indented
from etendue.archive.records.inputs import Resolved, as_recorded
from etendue.contract.values.late_bound import LateValue
from etendue.pipeline.file import PipelineFile
from etendue.pipeline.form import DIGITS
from etendue.pipeline.presets import preset_at
from etendue.plan.expansion.digits import is_rounded
from etendue.plan.identity.code import code_of
from etendue.plan.identity.keys import canonical, file_digest, parameters_for_key, version_of
from etendue.plan.model import Node, Plan
from etendue.plugins.discovery import named
from etendue.types.documents import Document, DocumentView

OTHER_CODE = "its code has changed"
ALL_DIGITS = DIGITS[0]  # of stages that round nothing, and of records that do not state digits
LIBRARIES = ("etendue", "numpy", "scipy", "xarray", "dask", "zarr", "numcodecs", "pluggy", "colour-science", "msgspec")


def platform_record() -> Document:
    """Return the properties of the platform that bits depend on: processor features and versions of the numerical
    libraries.
    """
    import numpy

    features = numpy._core._multiarray_umath.__cpu_features__  # type: ignore[attr-defined]
    enabled = sorted(name for name, on in features.items() if on)
    return {
        "machine": platform.machine(),
        "system": platform.system(),
        "python": ".".join(map(str, sys.version_info[:2])),
        "numpy": version_of("numpy"),
        "scipy": version_of("scipy"),
        "cpu_features": hashlib.blake2b(" ".join(enabled).encode(), digest_size=8).hexdigest(),
    }


def node_records(plan: Plan) -> Document:
    """Return, for each stage, everything that enters the keys of its cells, except axis values. Comparing these records
    between runs shows why cells are recomputed.
    """
    records = {}
    for node in plan.nodes:
        cell = plan.of(node.name)[0]
        swept = {name for _, name in node.direct}
        parameters = {k: v for k, v in parameters_for_key(cell.stage).items() if k not in swept}
        rounds = plan.digits > 0 and any(map(is_rounded, node.writes.values()))
        records[node.name] = {
            "stage": [a.use for a in node.alternatives],
            "role": [a.kind.role for a in node.alternatives],
            "code": [a.digest for a in node.alternatives],
            "distributions": [f"{a.distribution} {a.version}" for a in node.alternatives],
            "parameters": canonical(parameters),
            "shown": {k: _plain(v) for k, v in parameters.items()},
            "precision": plan.precision,
            "digits": f"stated, tolerance {plan.digits:g}" if rounds else ALL_DIGITS,
            "seed": plan.pipeline.seed if node.draws_anew else None,
            "inputs": sorted({source for bound in node.inputs for _, source, _ in bound}),
            "versions": dict(cell.versions),
        }
    return records


def _plain(value: Any) -> Any:
    """Return a value as JSON: files by content, infinity as text."""
    if isinstance(value, LateValue):
        return "found while running"
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    if isinstance(value, str) and os.path.isabs(value) and os.path.exists(value):
        return f"sha256:{file_digest(value)}"
    return value


def write_record(
    folder: Path, plan: Plan, asked: Plan, resolved: Resolved, options: DocumentView, durable: bool = False
) -> str:
    """Record a run before it starts, as ``runs/<number>.json`` with its pipeline in ``runs/<number>.toml``; return the
    path of the record.

    ``plan`` also holds the axis values of earlier runs, ``asked`` only the values of this run; ``resolved`` is the
    resolved pipeline.
    """
    number = max((int(p.stem) for p in (folder / "runs").glob("*.*") if p.stem.isdigit()), default=0) + 1
    record = record_of(plan, asked, resolved, options)
    disk.write(folder, f"runs/{number:04d}.toml", resolved.text.encode(), durable)
    disk.write(folder, f"runs/{number:04d}.json", indented(record, 1, sort_keys=True), durable)
    return f"runs/{number:04d}.json"


def record_of(plan: Plan, asked: Plan, resolved: Resolved, options: DocumentView) -> Document:
    """Return the record of a run. ``trust.checked`` compares it with a recomputed record, so new fields are checked
    without further code.
    """
    text = asked.pipeline.text
    for written, copy in resolved.written.items():
        text = text.replace(written, copy) if os.path.isabs(written) else text
    return {
        "pipeline": plan.pipeline.name,
        "resolved": resolved.text,
        "text": text,
        "overrides": {key: as_recorded(value, resolved.written) for key, value in asked.pipeline.overrides},
        "table": plan.pipeline.table.name,
        "preset": preset_said(plan.pipeline),
        "stated": stated_values(plan.pipeline),
        "shared": {k: _plain(v) for k, v in plan.shared.items()},
        "axes": {a.key: _plain(a.values) for a in plan.positioned},
        "order": [node.name for node in plan.nodes],
        "stages": {node.name: list(node.axes) for node in plan.nodes},
        "nodes": node_records(plan),
        "sources": sources_of(plan.nodes),
        "options": dict(options),
        "platform": platform_record(),
        "libraries": {name: version_of(name) for name in LIBRARIES},
        "distributions": dict(_distributions(tuple(map(_changed, sys.path)))),
        "began": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }


def _changed(folder: str) -> tuple[str, int]:
    """Return a folder of the import path, and the time (ns) at which a distribution was last added to it or removed
    from it.
    """
    try:
        return folder, os.stat(folder or ".").st_mtime_ns
    except OSError:
        return folder, 0


@lru_cache(maxsize=1)
def _distributions(path: tuple[tuple[str, int], ...]) -> DocumentView:
    """Return the version of every installed distribution; ``path``: the folders that contain them."""
    return {name: version for name, version in map(named, importlib.metadata.distributions()) if name}


def preset_said(pipeline: PipelineFile) -> str:
    """Return the name of the preset that the first preset key selects. For a preset in a file, return its title,
    because the file has another name in the archive.
    """
    name = pipeline.preset_name
    if not name:
        return name
    found = preset_at(name, pipeline.table, pipeline.folder)
    return found.title if found.file else name


def stated_values(pipeline: PipelineFile) -> Document:
    """Return the origin of the values of every preset in a file, by the key and title of the preset: source, licence
    and note of each quantity. The origins of packaged presets are in the distribution.
    """
    found: Document = {}
    for kind in pipeline.table.kinds():
        axis = pipeline.sweep.get(kind.preset)
        entries = axis if isinstance(axis, list | tuple) else [pipeline.named.get(kind.preset, "")]
        names = [one.get(kind.preset, "") if isinstance(one, Mapping) else one for one in entries]
        for one in (preset_at(str(name), kind, pipeline.folder) for name in names if name):
            if not one.file:
                continue
            found.setdefault(kind.preset, {})[one.title] = {
                name: {word: text for word, text in value.words().items() if text}
                for name, value in sorted(one.shared.items())
            }
    return found


def reasons(old: DocumentView | None, plan: Plan) -> dict[str, str]:
    """Return the reason why each stage would be recomputed: the field that changed, with its old and new value."""
    if not old:
        return {}
    found = node_changes(old["nodes"], node_records(plan))
    before = old.get("sources")
    for node in plan.nodes:
        if found.get(node.name) == OTHER_CODE and isinstance(before, dict):
            other = [name for name, own in sources_of([node]).items() if before.get(name) != own]
            found[node.name] += f": {', '.join(other[:3])}" * bool(other) + f" and {len(other) - 3} more" * (
                len(other) > 3
            )
    return found


def sources_of(nodes: Iterable[Node]) -> dict[str, str]:
    """Return the digests, by module, of all code that some stages use."""
    every = [code_of(one.kind).sources for node in nodes for one in node.alternatives]
    return dict(sorted(pair for one in every for pair in one.items()))


def node_changes(old: DocumentView, new: DocumentView) -> dict[str, str]:
    """Return, for each stage whose keys have changed, the ingredient that differs, with old and new value; for stages
    after such a stage, the input that has changed.
    """
    found: dict[str, str] = {}
    for name, after in new.items():
        before = old.get(name)
        if before is None:
            found[name] = "the stage is new"
            continue
        for field in ("stage", "precision", "digits", "seed", "code", "versions"):
            was = before.get(field, ALL_DIGITS if field == "digits" else None)
            if was != after[field]:
                shown = ("", "") if field == "code" else (f": {was}", f" -> {after[field]}")
                found[name] = OTHER_CODE if field == "code" else field + shown[0] + shown[1]
                break
        else:
            changed = [k for k in after["parameters"] if before["parameters"].get(k) != after["parameters"][k]]
            if changed:
                found[name] = "; ".join(
                    f"{k}: {before['shown'].get(k)} -> {after['shown'].get(k)}" for k in changed[:3]
                )
            else:
                source = next((s for s in after["inputs"] if s in found), None)
                if source:
                    found[name] = f"its input {source} has changed"
    return found

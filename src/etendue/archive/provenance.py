"""What makes a run reproducible: inputs by content, versions, platform, the pipeline as given and as resolved.

No user, host or path of the machine is recorded.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
import os
import platform
import shutil
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from etendue.plan.keys import canonical, file_digest, parameters_for_key, version_of
from etendue.plan.model import Plan
from etendue.spec.stage import file_state, parameters_of

LARGEST_COPY = 256 << 20  # a larger input is described, not copied
LIBRARIES = ("etendue", "numpy", "scipy", "xarray", "dask", "zarr", "numcodecs", "pluggy", "colour-science", "msgspec")


def platform_record() -> dict[str, Any]:
    """What bits depend on: processor features and the versions of the numerical libraries."""
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


def node_records(plan: Plan) -> dict[str, Any]:
    """For each stage what its keys are made of, axis values aside: compared to say why a cell is computed again."""
    records = {}
    for node in plan.nodes:
        cell = plan.of(node.name)[0]
        swept = {name for _, name in node.direct}
        parameters = {k: v for k, v in parameters_for_key(cell.stage).items() if k not in swept}
        records[node.name] = {
            "stage": [a.use for a in node.alternatives],
            "code": [a.digest for a in node.alternatives],
            "parameters": canonical(parameters),
            "shown": {k: _plain(v) for k, v in parameters.items()},
            "precision": plan.precision,
            "seed": plan.pipeline.seed if node.is_random else None,
            "inputs": sorted({source for bound in node.inputs for _, source, _ in bound}),
            "versions": cell.key_fields.get("versions", {}),
        }
    return records


def _plain(value: Any) -> Any:
    """A value as JSON: files by content, infinity in words."""
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    if isinstance(value, str) and os.path.isabs(value) and os.path.isfile(value):
        return f"sha256:{file_digest(value)}"
    return value


def latest_record(folder: Path) -> dict[str, Any] | None:
    """The record of the newest run of an archive."""
    records = sorted((folder / "runs").glob("*.json")) if (folder / "runs").is_dir() else []
    for path in reversed(records):
        try:
            return json.loads(path.read_text())
        except ValueError:
            continue
    return None


def write_record(folder: Path, plan: Plan, options: Mapping[str, Any]) -> Path:
    """Record a run before it starts: ``runs/<number>.json``."""
    runs = folder / "runs"
    runs.mkdir(exist_ok=True)
    number = max((int(p.stem) for p in runs.glob("*.json") if p.stem.isdigit()), default=0) + 1
    record = {
        "pipeline": plan.pipeline.name,
        "text": plan.pipeline.text,
        "overrides": {key: str(_plain(value)) for key, value in plan.pipeline.overrides},
        "sensor": plan.pipeline.sensor,
        "camera": {k: _plain(v) for k, v in plan.camera.items()},
        "axes": {a.key: _plain(a.values) for a in plan.axes},
        "nodes": node_records(plan),
        "options": dict(options),
        "platform": platform_record(),
        "libraries": {name: version_of(name) for name in LIBRARIES},
        "distributions": {d.name: d.version for d in importlib.metadata.distributions() if d.name},
        "began": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
    path = runs / f"{number:04d}.json"
    temporary = path.with_suffix(".partial")
    temporary.write_text(json.dumps(record, indent=1, sort_keys=True))
    os.replace(temporary, path)
    return path


def copy_inputs(folder: Path, plan: Plan) -> None:
    """Every file parameter into ``inputs/``, named by its SHA-256; of folders and very large files, what they are."""
    inputs = folder / "inputs"
    for cell in {id(c.stage): c for c in plan.cells.values()}.values():
        for name, (parameter, _, _) in parameters_of(type(cell.stage)).items():
            value = getattr(cell.stage, name)
            if isinstance(value, str) and value and (parameter.file or (parameter.table and value.endswith(".csv"))):
                inputs.mkdir(exist_ok=True)
                copy = inputs / f"{file_digest(value)}{Path(value).suffix}"
                if copy.exists():
                    continue
                temporary = copy.with_suffix(".partial")
                if Path(value).is_dir() or Path(value).stat().st_size > LARGEST_COPY:
                    copy = copy.with_name(f"{copy.name}.json")
                    known = {"name": Path(value).name, "sha256": file_digest(value), "bytes": file_state(value)[1], "copied": False}
                    temporary.write_text(json.dumps(known))
                else:
                    shutil.copyfile(value, temporary)
                os.replace(temporary, copy)


def reasons(old: Mapping[str, Any] | None, plan: Plan) -> dict[str, str]:
    """Why each stage would be computed again: the field that changed, old and new."""
    if not old:
        return {}
    found: dict[str, str] = {}
    now = node_records(plan)
    for node in plan.nodes:
        before, after = old["nodes"].get(node.name), now[node.name]
        if before is None:
            found[node.name] = "the stage is new"
            continue
        for field in ("stage", "precision", "seed", "code", "versions"):
            if before[field] != after[field]:
                shown = ("", "") if field == "code" else (f": {before[field]}", f" -> {after[field]}")
                found[node.name] = "its code has changed" if field == "code" else field + shown[0] + shown[1]
                break
        else:
            changed = [k for k in after["parameters"] if before["parameters"].get(k) != after["parameters"][k]]
            if changed:
                k = changed[0]
                found[node.name] = f"{k}: {before['shown'].get(k)} -> {after['shown'].get(k)}"
            else:
                source = next((s for s in after["inputs"] if s in found), None)
                if source:
                    found[node.name] = f"its input {source} has changed"
    return found


def write_manifest(folder: Path) -> None:
    """SHA-256 of every metadata file of the store."""
    root = folder / "data.zarr"
    files = {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(root.rglob("zarr.json"))}
    temporary = folder / "manifest.partial"
    temporary.write_text(json.dumps({"metadata": files}, indent=1))
    os.replace(temporary, folder / "manifest.json")


def write_crate(folder: Path, plan: Plan) -> None:
    """A minimal RO-Crate description, so that the directory can be published as it is."""
    parts = [{"@id": "data.zarr/"}, {"@id": "journal.jsonl"}, {"@id": "manifest.json"}]
    crate = {
        "@context": "https://w3id.org/ro/crate/1.1/context",
        "@graph": [
            {
                "@id": "ro-crate-metadata.json",
                "@type": "CreativeWork",
                "conformsTo": {"@id": "https://w3id.org/ro/crate/1.1"},
                "about": {"@id": "./"},
            },
            {
                "@id": "./",
                "@type": "Dataset",
                "name": plan.pipeline.name,
                "description": plan.pipeline.description or f"Camera simulation '{plan.pipeline.name}'",
                "datePublished": time.strftime("%Y-%m-%d", time.gmtime()),
                "license": "not stated",
                "hasPart": parts,
            },
            {"@id": "data.zarr/", "@type": "Dataset", "name": "all variables of all stages, Zarr v3"},
            {"@id": "journal.jsonl", "@type": "File", "encodingFormat": "application/jsonl", "name": "what is finished"},
            {"@id": "manifest.json", "@type": "File", "encodingFormat": "application/json", "name": "digests of the metadata"},
            {"@id": "#etendue", "@type": "SoftwareApplication", "name": "etendue", "version": version_of("etendue")},
        ],
    }
    (folder / "ro-crate-metadata.json").write_text(json.dumps(crate, indent=1))

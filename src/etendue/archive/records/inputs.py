"""The pipeline of a run with all overrides, and the files it names: with them, an archive can be rerun from its own
files.

In:  a plan.
Out: the pipeline as TOML, with every override applied and each file replaced by its copy in ``inputs/``, which is named
     by its SHA-256; the copies.
"""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any

from etendue import plain_files
from etendue.archive.records import disk
from etendue.contract.registry import installed_stages
from etendue.contract.stage import file_behind, file_state, parameters_of
from etendue.contract.values.parameter import Parameter
from etendue.errors import ArchiveError
from etendue.pipeline import toml
from etendue.pipeline.file import PipelineFile
from etendue.pipeline.form import ARCHIVE, DIGITS
from etendue.pipeline.presets import COPY, preset_at
from etendue.pipeline.zipped import put_together
from etendue.plan.designs.asked import factors_of
from etendue.plan.identity.keys import file_digest
from etendue.plan.model import Plan
from etendue.plan.wiring.parameters import resolve_file
from etendue.types.documents import Document, DocumentView

LARGEST_COPY = 256 << 20  # a larger input is described, not copied


@dataclass
class Resolved:
    """A pipeline that depends only on files in its archive."""

    text: str
    inputs: dict[str, str] = field(default_factory=dict)  # name below inputs/ -> path of the original file or folder
    written: dict[str, str] = field(default_factory=dict)  # name of a file in the pipeline -> its name in this text


class _Resolver:
    """A resolver of values: it replaces the names of files by the names of their copies."""

    def __init__(self, pipeline: PipelineFile) -> None:
        self.pipeline = pipeline
        self.inputs: dict[str, str] = {}
        self.written: dict[str, str] = {}
        registry = installed_stages()
        self.kinds = {entry.name: dict(parameters_of(registry.load(entry.use))) for entry in pipeline.stages}
        self.shared = {n: p for own in self.kinds.values() for n, p in own.items() if p[0].shared}
        for key, values in pipeline.sweep.items():
            if key.endswith(".use") and isinstance(values, list | tuple):
                for one in values:
                    own = parameters_of(registry.load(one if isinstance(one, str) else one["use"]))
                    self.shared.update({n: p for n, p in own.items() if p[0].shared})

    def value(self, value: Any, parameter: Parameter | None) -> Any:
        """Return a value; the name of a file is replaced by a name derived from its content."""
        if isinstance(value, list | tuple):
            return [self.value(one, parameter) for one in value]
        if parameter is None or not isinstance(value, str) or not value:
            return value
        behind = file_behind(value, parameter)
        if not behind:
            return value
        brought = behind != value  # by a distribution: no file that the pipeline names
        path = behind if brought else str(resolve_file(behind, self.pipeline.folder, parameter.folder))
        name = f"{file_digest(path)}{Path(path).suffix}"
        self.inputs[name] = path
        if not brought:
            self.written[value] = f"../inputs/{name}"
        return f"../inputs/{name}"

    def table(self, values: DocumentView, own: DocumentView) -> Document:
        return {name: self.value(value, own[name][0] if name in own else None) for name, value in values.items()}

    def named(self, name: str, word: str) -> str:
        """Return the name of a preset as written in an archive: for a file, the name of its copy."""
        path = preset_at(name, self.pipeline.table.kind_of(word), self.pipeline.folder).file
        if not path:
            return name
        copy = f"{file_digest(path)}.toml"
        self.inputs[copy] = path
        return f"../inputs/{copy}"

    def preset(self, table: DocumentView, word: str) -> Document:
        """Return an axis preset with its values written out, because a later version may define the name
        differently.
        """
        whose = self.pipeline.table.kind_of(word)
        named = preset_at(table[word], whose, self.pipeline.folder).values() if word in table else {}
        known = {
            name: value for name, value in named.items() if name in self.shared and name not in self.pipeline.shared
        }
        if word in table and (copy := self.named(table[word], word)) != table[word]:
            table = {"label": table[word], **table, word: copy}
        return {
            name: self.value(value, self.shared.get(name, (None,))[0]) for name, value in {**known, **table}.items()
        }

    def axis(self, key: str, values: Any) -> Any:
        stage, _, name = key.partition(".")
        if name == "use" and isinstance(values, list | tuple):
            registry = installed_stages()
            return [v if isinstance(v, str) else self.table(v, parameters_of(registry.load(v["use"]))) for v in values]
        if key in self.pipeline.table.words() and isinstance(values, list | tuple):
            return [self.preset({key: v} if isinstance(v, str) else v, key) for v in values]
        own = self.kinds.get(stage, {}) if name else self.shared
        parameter = own.get(name or key, (None,))[0]
        if isinstance(values, Mapping):
            return dict(values)
        return self.value(list(values) if isinstance(values, list | tuple) else values, parameter)


def resolve_pipeline(plan: Plan) -> Resolved:
    """Return the pipeline of a plan with all overrides applied, to be run from ``runs/`` in its archive."""
    pipeline = plan.pipeline
    found = _Resolver(pipeline)
    document: Document = {"name": pipeline.name}
    if pipeline.description:
        document["description"] = pipeline.description
    if pipeline.variant:
        document["variant"] = pipeline.variant
    document |= {
        "seed": pipeline.seed,
        "tolerance": pipeline.tolerance,
        "norm": pipeline.norm,
        "precision": pipeline.precision,
    }
    if not plan.leaves_out:
        document["leave_out"] = False
    if not pipeline.stand_ins:
        document["stand_ins"] = False
    if pipeline.digits != DIGITS[0]:
        document[ARCHIVE] = {"digits": pipeline.digits}
    if pipeline.wanted is not None:
        document["wanted"] = list(pipeline.wanted)
    if pipeline.keep is not None:
        document["keep"] = list(pipeline.keep)
    if said := pipeline.about.document():
        document["about"] = said
    # Write out the values that the preset's name stands for: a later version may define it differently.
    given = {
        name: value for name, value in pipeline.preset.items() if name in found.shared and name not in pipeline.sweep
    }
    shared = found.table({**given, **pipeline.shared}, found.shared)
    named = {word: found.named(name, word) for word, name in pipeline.named.items() if word not in pipeline.sweep}
    document[pipeline.table.name] = named | shared
    document["stages"] = [
        {
            "use": entry.use,
            "name": entry.name,
            **({"from": dict(entry.origin)} if entry.origin else {}),
            **found.table(entry.values, found.kinds[entry.name]),
        }
        for entry in pipeline.stages
    ]
    if pipeline.sweep:
        swept = {key: found.axis(key, values) for key, values in pipeline.sweep.items()}
        document["sweep"] = put_together(swept, pipeline.zipped)
    if pipeline.design:
        document["design"] = _design(pipeline, found)
    return Resolved(toml.dumps(document), found.inputs, found.written)


def _design(pipeline: PipelineFile, found: _Resolver) -> Document:
    """Return the table of the design, with each file named by the digest of its content."""
    factors = {
        key: found.axis(key, written) if isinstance(written, list | tuple) else written
        for key, written in factors_of(pipeline.design, pipeline).items()
    }
    own = {key: value for key, value in pipeline.design.items() if not key.startswith("factors.")}
    own |= {"factors": factors} if factors else {}
    if isinstance(name := own.get("file"), str):
        path = str(resolve_file(name, pipeline.folder))
        own["file"] = f"../inputs/{file_digest(path)}.csv"
        found.inputs[Path(own["file"]).name] = path
        found.written[name] = own["file"]
    return own


def as_recorded(value: Any, written: Mapping[str, str]) -> str:
    """Return an override in the notation of the pipeline file, with files named by content."""
    if isinstance(value, str):
        found = written.get(value, value)
        return toml.value(Path(found).name if os.path.isabs(found) else found)
    if isinstance(value, Mapping):
        return (
            "{ "
            + ", ".join(f"{toml.key(str(name))} = {as_recorded(one, written)}" for name, one in value.items())
            + " }"
        )
    if isinstance(value, list | tuple):
        return f"[{', '.join(as_recorded(one, written) for one in value)}]"
    return (
        toml.value(value)
        if isinstance(value, bool | int | float | Decimal) or hasattr(value, "item")
        else toml.value(str(value))
    )


def copy_inputs(folder: Path, inputs: Mapping[str, str], durable: bool = False) -> list[str]:
    """Copy every file and folder that a pipeline names into ``inputs/``; of a very large file, only a description is
    stored. Return the damaged copies that were replaced.
    """
    mended = []
    for name, path in inputs.items():
        digest, source = file_digest(path), Path(path)
        state = file_state(path)
        links = (p for p in source.rglob("*") if p.is_symlink()) if source.is_dir() else ()
        if state[1] > LARGEST_COPY or any(not p.resolve().is_relative_to(source.resolve()) for p in links):
            why = {"why": "it holds a link that leads out of it"} if state[1] <= LARGEST_COPY else {}
            known = {"name": source.name, "sha256": digest, "bytes": state[1], "copied": False, **why}
            disk.write(folder, f"inputs/{name}.json", json.dumps(known).encode(), durable)
            continue
        copy = folder / "inputs" / name
        if copy.exists():
            try:
                if file_digest(str(copy)) == digest:
                    continue
            except OSError:
                pass
            mended.append(f"inputs/{name}")
        for part in _parts(source) if source.is_dir() else [""]:
            disk.write(
                folder,
                f"inputs/{name}/{part}" if part else f"inputs/{name}",
                _read(source / part if part else source),
                durable,
            )
        if digest_now(copy) != digest:
            raise ArchiveError(f"{source.name} changed while it was copied into {folder / 'inputs'}; run again")
    return mended


def digest_now(copy: Path) -> str:
    """Return the SHA-256 of a file or folder as it is on disk now, bypassing the cache."""
    return file_digest(str(copy)) if copy.is_dir() else plain_files.sha256(copy, None, links=False)


def _read(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while part := file.read(1 << 20):
            yield part


def _parts(folder: Path) -> list[str]:
    """Return the files of a folder, including links to files, by path below it."""
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


def sweep_of(record: DocumentView, folder: Path, table: str = "sweep") -> DocumentView:
    """Return the sweep, or another table, of an earlier run from its record, with the copies in the archive in place of
    the original files; empty if the record cannot be read.
    """
    text = record.get("resolved")
    try:
        found = tomllib.loads(text, parse_float=Decimal).get(table, {}) if isinstance(text, str) else {}
    except (ValueError, RecursionError):
        return {}
    return _in_place(found, folder) if isinstance(found, dict) and not _names_others(found) else {}


def _names_others(value: Any) -> bool:
    """Return True if a recorded sweep names files outside ``inputs/``, which no run writes."""
    if isinstance(value, dict | list):
        return any(map(_names_others, value.values() if isinstance(value, dict) else value))
    leads = isinstance(value, str) and (
        os.path.isabs(value) or value.startswith("package:") or ".." in value.split("/")
    )
    return leads and not COPY.fullmatch(value)


def _in_place(value: Any, folder: Path) -> Any:
    if isinstance(value, dict):
        return {name: _in_place(one, folder) for name, one in value.items()}
    if isinstance(value, list):
        return [_in_place(one, folder) for one in value]
    return (
        str(folder / value.removeprefix("../")) if isinstance(value, str) and value.startswith("../inputs/") else value
    )

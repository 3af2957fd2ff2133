"""Recompute everything in an archive except its cells, with the functions that a run uses: metadata, coordinates,
status, tables, pictures, records.

In:  a plan over everything an archive has, the places of cells according to its journal, and the results of recomputing
     them.
Out: documents, arrays and texts by path, where a run writes them. Nothing is written.

Values that cannot be recomputed (seconds, accepted platform, the cells that a run did not request) are taken from the
archive; ``trust.comparing`` lists them as not checked.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from math import prod
from typing import Any

import numpy as np

from etendue.archive.journaling.journal import is_done
from etendue.archive.read import earlier_pictures
from etendue.archive.read.earlier_pictures import FRAMES
from etendue.archive.read.stored import LEDGER, Stored
from etendue.archive.read.tree import Tree
from etendue.archive.records import disk
from etendue.archive.records.inputs import resolve_pipeline, sweep_of
from etendue.archive.records.manifest import DATA
from etendue.archive.records.names import ROOT, STATUS
from etendue.archive.records.provenance import preset_said, record_of
from etendue.archive.records.rerun import Recorded
from etendue.archive.sharding.chunks import decode
from etendue.archive.structure.metadata import texts_of
from etendue.archive.write.placement import Laid
from etendue.contract.ports import CellReport, ContactSheet
from etendue.contract.registry import installed_stages
from etendue.contract.values.tables import preset_keys
from etendue.errors import ArchiveError, RequestError
from etendue.pipeline.file import from_document
from etendue.pipeline.overrides import apply_overrides
from etendue.plan.identity.keys import file_digest
from etendue.plan.model import CellRef, Plan
from etendue.plan.planner import make_plan
from etendue.plan.reports import Reports
from etendue.plan.resume import is_of_names, with_stored_values
from etendue.plugins.discovery import table_file
from etendue.present.terminal import tables
from etendue.types.documents import Document, DocumentView


@dataclass(frozen=True)
class Again:
    """A recomputed plan: ``names`` and ``keys`` of its cells, and, by name, the reports of computed cells."""

    plan: Plan
    names: Mapping[CellRef, str]
    keys: Mapping[CellRef, str]
    reports: Mapping[str, CellReport]
    sheet: ContactSheet | None = None


def store_files(stored: Stored, again: Again, ended: bool) -> dict[str, bytes]:
    """Return every file of the store except chunks of cells, by path below it; ``ended``: including the files that a
    run writes when it ends normally.
    """
    plan, journal = again.plan, stored.journal
    laid = Laid(plan, journal.axes, journal.blocks, journal.said)
    tree, number = laid.tree(journal.said, ()), plan.numbers.of
    if not ended:
        return {path: data for path, data in tree.held.items() if path != "zarr.json" and "/status/c/" not in path}
    computed, reports = bytearray(plan.numbers.count), reports_of(stored, again, laid)
    for ref, name in again.names.items():
        entry = journal.entries.get(name)
        if name in again.reports and entry is not None and (entry.event == "failed" or is_done(entry, again.keys[ref])):
            computed[number(ref)] = STATUS.index(again.reports[name].status) + 1
    laid.put_status(tree, journal.said, (), computed)
    as_then = plan  # the plan with the keys that its cells had
    if any(plan.cells[ref].key != key for ref, key in again.keys.items()):
        as_then = replace(plan, cells={ref: cell.changed(key=again.keys[ref]) for ref, cell in plan.cells.items()})
    own = {"ledger": tables.ledger(as_then, reports), "summary": tables.summary(plan, reports)}
    for name, table in own.items():
        _put_table(tree, name, table)
    if again.sheet is not None and again.sheet.table:
        _put_table(tree, FRAMES, again.sheet.table)
        tree.take(earlier_pictures.sealed(tree.files(FRAMES), again.sheet.table["attrs"]))
    return {**tree.held, "zarr.json": tree.consolidated({})}


def _put_table(tree: Tree, name: str, table: DocumentView) -> None:
    for column, (dims, values, attrs) in table["arrays"].items():
        tree.put_array(name, column, values, dims, attrs)
    tree.put_group(name, table.get("attrs", {}))


def reports_of(stored: Stored, again: Again, laid: Laid) -> Reports:
    """Return the reports of all cells as in the tables: the recomputed result, with the archived seconds and bytes.

    The tables give an unfinished cell the state from the last run. The last run may not have requested the cell, so
    both states are valid.
    """
    found, said = Reports(again.plan), _said_of_unfinished(stored, again)
    for ref, name in again.names.items():
        entry, fresh = stored.journal.entries.get(name), again.reports.get(name)
        if entry is not None and is_done(entry, again.keys[ref]):
            slots = {(path, slot) for path, slot, _ in laid.slots(ref)}
            size = sum(file.size for file in entry.files if (file.path, file.slot) in slots)
            told = fresh or CellReport(
                *ref, entry.status, clipped=entry.clipped, clipped_flux=entry.clipped_flux, floored=entry.floored
            )
            found.take(
                [replace(told, written=(), seconds=entry.seconds, platform=entry.platform, size=size, message="")]
            )
        elif name in said and entry is not None:
            status, message = said[name]
            told = fresh or CellReport(*ref, entry.status)
            message = message if told.status == status else ""
            found.take([replace(told, written=(), seconds=entry.seconds, message=message)])
    return found


def _said_of_unfinished(stored: Stored, again: Again) -> dict[str, tuple[str, str]]:
    """Return status and message in the ledger by name of an unfinished cell; empty if the ledger has another form."""
    open_ = {
        (ref[0], again.keys[ref]): name
        for ref, name in again.names.items()
        if not is_done(stored.journal.entries.get(name), again.keys[ref])
    }
    if not open_:
        return {}
    columns = [column(stored, f"{LEDGER}/{name}") for name in ("stage", "key", "status", "message")]
    if any(one is None or one.ndim != 1 for one in columns):
        return {}
    rows = zip(*(one.tolist() for one in columns if one is not None), strict=False)
    return {
        open_[s, key]: (status, message)
        for s, key, status, message in rows
        if (s, key) in open_ and status != "not_computed"
    }


def column(stored: Stored, array: str) -> Any:
    """Return a whole small array of the store; None if it is not readable."""
    folder = stored.folder / DATA / array
    node = as_document(disk.content_of(folder / ROOT))
    try:
        shape = tuple(int(n) for n in node["shape"])
        return array_of(disk.content_of(folder.joinpath("c", *"0" * len(shape))), node["data_type"], shape)
    except (ArchiveError, KeyError, TypeError, ValueError):
        return None


def array_of(data: bytes | None, dtype: str, shape: tuple[int, ...]) -> Any:
    """Return a whole small array from the bytes of its single chunk.

    Raises
    ------
    ArchiveError
        The bytes do not contain such an array.
    """
    if data is None and 0 not in shape:
        raise ArchiveError("its chunk is missing")
    if dtype != "string":
        return decode(data, dtype, shape) if data else np.empty(shape, dtype)
    texts = texts_of(data) if data else []
    if len(texts) != prod(shape):
        raise ArchiveError(f"the array has {len(texts)} strings, not {prod(shape)}")
    return np.array([*texts, None], dtype=object)[:-1].reshape(shape)


# -- records
# --------------------------------------------------------------------------------------------------------------


def record_again(
    run: Recorded, earlier: Sequence[Recorded] = (), most_cells: int | None = None
) -> tuple[Document, dict[str, set[Any]]]:
    """Return the record of a run, rebuilt from its resolved pipeline and its axis values; and, by axis, the values that
    the run itself requested.

    ``earlier``: the earlier runs, newest first, whose records define the tables for names on an axis.

    Raises
    ------
    ArchiveError, RequestError
        An input is lost, or the pipeline is refused by this installation.
    """
    asked = make_plan(run.pipeline(most_cells), installed_stages())
    resolved, record = resolve_pipeline(asked), run.record
    over = {a.dim: _numbers(record["axes"].get(a.key, ()), a.values) for a in asked.axes}
    named = any(is_of_names(a.key) for a in asked.axes)
    sweeps = [sweep_of(one.record, run.path.parent.parent) for one in (run, *earlier)] if named else []
    plan = with_stored_values(asked, {"": over}, sweeps)
    told = {"tolerance": plan.pipeline.tolerance, "scheduler": (record.get("options") or {}).get("scheduler")}
    made = record_of(plan, asked, replace(resolved, text=run.text), told)
    text, overrides = record.get("text"), record.get("overrides")
    made |= {"text": text, "overrides": overrides}
    given = _given(text, overrides, asked, run.text) if isinstance(text, str) and isinstance(overrides, dict) else None
    made["shared"] = {name: _as_named(value, record["shared"].get(name)) for name, value in made["shared"].items()}
    if resolved.text != run.text:
        made["resolved"] = resolved.text
    if given is None or _words(resolve_pipeline(given).text) != _words(run.text):
        made["text"] = "a text that gives the resolved pipeline, with the overrides"
    elif asked.pipeline.presets_swept:  # the preset outside the sweep is not in the resolved text, and has no effect
        made["preset"] = preset_said(given.pipeline)
    return made, {a.key: set(map(str, a.values)) for a in asked.positioned}


def _as_named(made: Any, recorded: Any) -> Any:
    """Return the recorded text of a shared value if it names the same table as the recomputed value; otherwise, return
    the recomputed value.
    """
    if made == recorded or not isinstance(recorded, str) or not isinstance(made, str):
        return made
    try:
        path = table_file(recorded)
        return recorded if path and made == f"sha256:{file_digest(path)}" else made
    except (ValueError, OSError):
        return made


def _numbers(values: Any, own: tuple[Any, ...]) -> list[Any]:
    """Return axis values of a record, with infinity converted from text."""
    text = any(isinstance(v, str) for v in own)
    return [float(v) if isinstance(v, str) and not text else v for v in values]


def _given(text: str, overrides: Mapping[str, str], asked: Plan, resolved: str) -> Plan | None:
    """Return the plan of the user's text with the overrides, in which files are the copies that the resolved pipeline
    names; None if the text is invalid.
    """
    try:
        document = tomllib.loads(text, parse_float=Decimal)
        given = {key: tomllib.loads(f"v = {value}", parse_float=Decimal)["v"] for key, value in overrides.items()}
        apply_overrides(document, given)
        document = _placed(document, tomllib.loads(resolved, parse_float=Decimal))
        made = from_document(document, asked.pipeline.file, asked.pipeline.folder)
        made = replace(
            made, folder=asked.pipeline.folder, most_cells=asked.pipeline.most_cells, overrides=tuple(given.items())
        )
        return make_plan(made, installed_stages())
    except (RequestError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None


def _words(text: str) -> Document:
    """Return a text as a document, independent of key order and of the pipeline's name."""
    return {**tomllib.loads(text, parse_float=Decimal), "name": ""}


def _placed(value: Any, other: Any) -> Any:
    """Return a value in which names of files are replaced by the names in the resolved pipeline, ``other``."""
    if isinstance(value, str) and isinstance(other, str) and other.startswith("../inputs/"):
        return other
    if isinstance(value, str) and isinstance(other, dict) and other.get("label") == value:
        return other  # a preset on an axis, as a table with its copy
    if isinstance(value, dict) and isinstance(other, dict):
        named = preset_keys() & value.keys() & other.keys()
        if named and "label" not in value and "label" in other:
            value = {**value, "label": other["label"]}
        return {key: _placed(one, other.get(key)) for key, one in value.items()}
    if isinstance(value, list) and isinstance(other, list) and len(value) == len(other):
        return [_placed(one, two) for one, two in zip(value, other, strict=True)]
    return value


def chunks_out_of_place(stored: Stored, again: Again) -> Iterator[tuple[str, str]]:
    """Yield the names and places of finished cells that have a chunk at a place to which no run writes it."""
    journal = stored.journal
    laid = Laid(again.plan, journal.axes, journal.blocks, journal.said)
    for ref, name in again.names.items():
        entry = journal.entries.get(name)
        if entry is None or entry.event != "done" or not entry.files:
            continue
        slots = {(path, slot) for path, slot, _ in laid.slots(ref)}
        for file in entry.files:
            group, variable = file.path.removeprefix("data.zarr/").rsplit("/", 2)[:2]
            if (file.path, file.slot) not in slots and stored.keeps(group, variable):
                yield name, f"{file.path} {file.slot}"
                break


def as_document(data: bytes | None) -> Any:
    """Return parsed JSON; None if it is invalid."""
    try:
        return json.loads(data) if data is not None else None
    except (ValueError, RecursionError):
        return None

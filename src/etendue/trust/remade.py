"""What an archive must hold beside its cells, made again as a run makes it: metadata, coordinates, status, tables,
pictures, records.

In:  a plan over all that an archive has, where its journal says that cells lie, and what became of each when it was
     computed again.
Out: documents, arrays and texts by path, in the places where a run writes them. Nothing is written.

What only a run can know (seconds, which platform was accepted, what was not asked for) is taken from the archive;
``trust.checked`` says of it that it is not checked.
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

from etendue.archive import disk, frames
from etendue.archive.again import Recorded
from etendue.archive.chunks import decode
from etendue.archive.frames import FRAMES
from etendue.archive.inputs import resolve_pipeline, sweep_of
from etendue.archive.journal import is_done
from etendue.archive.laid import Laid
from etendue.archive.layout import STATUS
from etendue.archive.manifest import DATA
from etendue.archive.metadata import texts_of
from etendue.archive.provenance import record_of
from etendue.archive.stored import LEDGER, Stored
from etendue.archive.tree import ROOT, Tree
from etendue.contract.ports import CellReport, Sheet
from etendue.contract.registry import installed_stages
from etendue.errors import ArchiveError, RequestError
from etendue.pipeline.file import from_document
from etendue.pipeline.overrides import apply_overrides
from etendue.plan.model import CellRef, Plan
from etendue.plan.planner import make_plan
from etendue.plan.reports import Reports
from etendue.plan.resume import is_of_names, with_stored_values
from etendue.present.terminal import tables
from etendue.types.documents import Document


@dataclass(frozen=True)
class Again:
    """A plan computed again: ``names`` and ``keys`` of its cells, and what became of those that were computed, by
    name.
    """

    plan: Plan
    names: Mapping[CellRef, str]
    keys: Mapping[CellRef, str]
    reports: Mapping[str, CellReport]
    sheet: Sheet | None = None


def store_files(stored: Stored, again: Again, ended: bool) -> dict[str, bytes]:
    """Every file of the store that is no chunk of a cell, by path below it; ``ended``: with what a run writes when
    it ends in order.
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
    as_then = plan  # with the keys that its cells had
    if any(plan.cells[ref].key != key for ref, key in again.keys.items()):
        as_then = replace(plan, cells={ref: replace(cell, key=again.keys[ref]) for ref, cell in plan.cells.items()})
    own = {"ledger": tables.ledger(as_then, reports), "summary": tables.summary(plan, reports)}
    for name, table in own.items():
        _put_table(tree, name, table)
    if again.sheet is not None and again.sheet.table:
        _put_table(tree, FRAMES, again.sheet.table)
        tree.take(frames.sealed(tree.files(FRAMES), again.sheet.table["attrs"]))
    return {**tree.held, "zarr.json": tree.consolidated({})}


def _put_table(tree: Tree, name: str, table: Mapping[str, Any]) -> None:
    for column, (dims, values, attrs) in table["arrays"].items():
        tree.put_array(name, column, values, dims, attrs)
    tree.put_group(name, table.get("attrs", {}))


def reports_of(stored: Stored, again: Again, laid: Laid) -> Reports:
    """What the tables say of every cell: as it came out now, with the seconds and bytes of then.

    A cell that is not finished stands in the tables as what the last run made of it, which may not have asked for it:
    either is right.
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
    """Of cells that are not finished what the ledger says: status and message. Nothing where it has another form."""
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
    """A whole small array of the store; None where it is none."""
    folder = stored.folder / DATA / array
    node = as_document(disk.content_of(folder / ROOT))
    try:
        shape = tuple(int(n) for n in node["shape"])
        return array_of(disk.content_of(folder.joinpath("c", *"0" * len(shape))), node["data_type"], shape)
    except (ArchiveError, KeyError, TypeError, ValueError):
        return None


def array_of(data: bytes | None, dtype: str, shape: tuple[int, ...]) -> Any:
    """A whole small array from the bytes of its one chunk.

    Raises
    ------
    ArchiveError
        They are none.
    """
    if data is None and 0 not in shape:
        raise ArchiveError("its chunk is missing")
    if dtype != "string":
        return decode(data, dtype, shape) if data else np.empty(shape, dtype)
    texts = texts_of(data) if data else []
    if len(texts) != prod(shape):
        raise ArchiveError(f"it has {len(texts)} texts, not {prod(shape)}")
    return np.array([*texts, None], dtype=object)[:-1].reshape(shape)


# -- records
# --------------------------------------------------------------------------------------------------------------


def record_again(
    run: Recorded, earlier: Sequence[Recorded] = (), most_cells: int | None = None
) -> tuple[Document, dict[str, set[Any]]]:
    """The record of a run made anew from its resolved pipeline and its axis values; by axis the values that it asked
    for itself.

    ``earlier`` runs, the newest first, say what the names on an axis stand for.

    Raises
    ------
    ArchiveError, RequestError
        An input is lost, or its pipeline is refused here.
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
    if resolved.text != run.text:
        made["resolved"] = resolved.text
    if given is None or _words(resolve_pipeline(given).text) != _words(run.text):
        made["text"] = "what makes the resolved pipeline, with the overrides"
    elif asked.pipeline.preset_swept:  # what was named beside it is not resolved: none of it counts
        made["preset"] = given.pipeline.preset_name
    return made, {a.key: set(map(str, a.values)) for a in asked.axes}


def _numbers(values: Any, own: tuple[Any, ...]) -> list[Any]:
    """Axis values of a record: infinity stands there in words."""
    text = any(isinstance(v, str) for v in own)
    return [float(v) if isinstance(v, str) and not text else v for v in values]


def _given(text: str, overrides: Mapping[str, str], asked: Plan, resolved: str) -> Plan | None:
    """The plan of the text that a user wrote, with the overrides; its files are those of the resolved one. None
    where it is none.
    """
    try:
        document = tomllib.loads(text, parse_float=Decimal)
        given = {key: tomllib.loads(f"v = {value}", parse_float=Decimal)["v"] for key, value in overrides.items()}
        apply_overrides(document, given)
        document = _placed(document, tomllib.loads(resolved, parse_float=Decimal))
        made = from_document(document, asked.pipeline.file)
        made = replace(
            made, folder=asked.pipeline.folder, most_cells=asked.pipeline.most_cells, overrides=tuple(given.items())
        )
        return make_plan(made, installed_stages())
    except (RequestError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None


def _words(text: str) -> Document:
    """A text as a document, in whatever order its keys stand; a name that stands in the file's own is no difference."""
    return {**tomllib.loads(text, parse_float=Decimal), "name": ""}


def _placed(value: Any, other: Any) -> Any:
    """Names of files as the resolved pipeline has them."""
    if isinstance(value, str) and isinstance(other, str) and other.startswith("../inputs/"):
        return other
    if isinstance(value, dict) and isinstance(other, dict):
        return {key: _placed(one, other.get(key)) for key, one in value.items()}
    if isinstance(value, list) and isinstance(other, list) and len(value) == len(other):
        return [_placed(one, two) for one, two in zip(value, other, strict=True)]
    return value


def chunks_out_of_place(stored: Stored, again: Again) -> Iterator[tuple[str, str]]:
    """Finished cells of which a chunk lies where no run puts it: their names, and where."""
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
    """JSON as it is; None where it is none."""
    try:
        return json.loads(data) if data is not None else None
    except (ValueError, RecursionError):
        return None

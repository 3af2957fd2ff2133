"""Compare an archive's metadata with recomputed metadata, completely, except for a list of contents that cannot be
recomputed.

In:  an archive, and its plan computed again (``trust.remade``).
Out: ``Difference``: file, place in it, its value, and the expected value. Everything that is not in ``NOT_CHECKED`` is
     compared, including future fields.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

from etendue.archive.read.stored import LEDGER, Stored
from etendue.archive.records import crate, disk
from etendue.archive.records.manifest import DATA
from etendue.archive.records.past_runs import record_paths
from etendue.archive.records.rerun import Recorded, every_record
from etendue.contract.values.names import TABLES
from etendue.errors import ArchiveError, RequestError
from etendue.trust import sayings
from etendue.trust.comparing import ELSEWHERE, differences, of_array, shown, skipped
from etendue.trust.remade import Again, array_of, as_document, chunks_out_of_place, record_again, store_files
from etendue.trust.sayings import Deviation
from etendue.types.documents import Document, DocumentView

OF_CODE = ("code", "distributions", "versions")  # of a stage: what was installed at the time of the run


# -- the store
# ------------------------------------------------------------------------------------------------------------


def of_store(stored: Stored, again: Again, elsewhere: bool) -> Iterator[Deviation]:
    """Compare metadata, coordinates, status, tables and pictures."""
    ended, loose = stored.manifest is not None, ELSEWHERE if elsewhere else 0.0
    try:
        own = store_files(stored, again, ended)
        out = list(chunks_out_of_place(stored, again))
    except (ArithmeticError, LookupError, TypeError, ValueError, MemoryError, AttributeError) as error:
        yield Deviation("journal.jsonl", "axes, blocks, cells", f"{type(error).__name__}: {error}", "a valid layout")
        return
    yield from (Deviation("journal.jsonl", name, place, "another place") for name, place in out)
    # compared by content instead of file by file
    apart = {LEDGER} if any(path.startswith("frames/") for path in own) else {LEDGER, "frames"}
    for path in sorted(own.keys() | _said(stored, own)):
        top = path.split("/")[0]
        # If the last run did not end normally, these files may still be those of an earlier run.
        if top in apart or (not ended and (path == "zarr.json" or "/status/c" in path or top in TABLES)):
            continue
        has, data = own.get(path), disk.content_of(stored.folder / DATA / path)
        if has != data:
            yield from _of_file(path, data, has, own, loose)
    yield from sayings.of_the_rest(stored, again, own)
    if ended:
        yield from _of_ledger(stored, own, elsewhere)


def _said(stored: Stored, own: Mapping[str, bytes]) -> set[str]:
    """Return the files of groups and tables that runs have written, without chunks of cells, by path below the
    store.
    """
    ours = {*TABLES, *(path.split("/")[0] for path in own if "/" in path)}
    # cells without axes
    alone = {f"{group}/{name}/c" for group, names in stored.journal.blocks.items() for name in names}
    files = {path.removeprefix(f"{DATA}/") for path in disk.Listing(stored.folder).below(DATA)} - alone
    return {
        path
        for path in files
        if path == "zarr.json"
        or (path.split("/")[0] in ours and (path.endswith(("/zarr.json", "/c")) or "/c/" in path))
    }


def _of_file(
    path: str, data: bytes | None, has: bytes | None, own: Mapping[str, bytes], loose: float
) -> Iterator[Deviation]:
    file = f"{DATA}/{path}"
    if skipped(file, ""):
        return
    if has is None or data is None:
        yield Deviation(file, "", "" if data is None else "it is there", "" if has is None else "it is there")
    elif path.endswith("zarr.json"):
        says, made = as_document(data), as_document(has)
        if path == "zarr.json":
            says = _of_ours(says, made)
        yield from differences(file, says, made, loose)
    else:
        array = path[: re.search(r"/c(/\d+)*$", path).start()]  # type: ignore[union-attr]
        node = as_document(own[f"{array}/zarr.json"])
        form = node["data_type"], tuple(node["shape"])
        fresh = array_of(has, *form)
        try:
            old = array_of(data, *form)
        except ArchiveError as error:
            yield Deviation(file, "", str(error), shown(fresh.tolist()))
            return
        yield from of_array(file, old, fresh, loose)


def _of_ours(says: Any, made: Any) -> Any:
    """Return the metadata of the root without the entries of foreign groups and, if pictures are not compared, of
    pictures.
    """
    try:
        held, own = says["consolidated_metadata"]["metadata"], made["consolidated_metadata"]["metadata"]
        ours = {path.split("/")[0] for path in own}
        kept = {
            path: one for path, one in held.items() if path.split("/")[0] in (ours | set(TABLES)) - ({"frames"} - ours)
        }
        return {**says, "consolidated_metadata": {**says["consolidated_metadata"], "metadata": kept}}
    except (KeyError, TypeError, AttributeError):
        return says


def _of_ledger(stored: Stored, own: Mapping[str, bytes], elsewhere: bool) -> Iterator[Deviation]:
    """Compare the ledger row by row, in any order: sorting axes does not reorder the rows."""
    nodes = {
        path.split("/")[1]: as_document(data)
        for path, data in own.items()
        if re.fullmatch(rf"{LEDGER}/\w+/zarr.json", path)
    }
    listed = disk.Listing(stored.folder)
    there = {path.split("/")[2] for path in listed.below(f"{DATA}/{LEDGER}") if path.count("/") > 2}
    for name in sorted(nodes.keys() ^ there):
        yield Deviation(f"{DATA}/{LEDGER}/{name}", "", *(("it is there", "") if name in there else ("", "it is there")))
    columns: dict[str, tuple[Any, Any]] = {}
    for path in sorted(path for path in own if path.startswith(f"{LEDGER}/") and path.endswith("zarr.json")):
        name, file = path.split("/")[1], f"{DATA}/{path}"
        yield from differences(file, as_document(disk.content_of(stored.folder / file)), as_document(own[path]), 0.0)
        if name == "zarr.json" or name not in there:
            continue
        chunk, form = f"{LEDGER}/{name}/c/0", (nodes[name]["data_type"], tuple(nodes[name]["shape"]))
        try:
            columns[name] = (
                array_of(disk.content_of(stored.folder / DATA / chunk), *form),
                array_of(own.get(chunk), *form),
            )
        except ArchiveError as error:
            yield Deviation(f"{DATA}/{chunk}", "", str(error), "its column")
    yield from _of_columns(columns, elsewhere)


def _of_columns(columns: Mapping[str, tuple[Any, Any]], elsewhere: bool) -> Iterator[Deviation]:
    """Compare columns (archived, recomputed), with the rows of both sorted by the columns that identify them."""
    told = [name for name in columns if name in ("stage", "key") or name.startswith("at_")]
    if not told:
        return
    old_order, fresh_order = (
        sorted(range(len(columns[told[0]][n])), key=_row([columns[name][n].tolist() for name in told])) for n in (0, 1)
    )
    for name, (old, fresh) in columns.items():
        if not (elsewhere and name.startswith("clipped")):
            loose = ELSEWHERE if elsewhere else 0.0
            yield from of_array(f"{DATA}/{LEDGER}/{name}", old[old_order], fresh[fresh_order], loose)


def _row(columns: list[list[Any]]) -> Any:
    return lambda n: tuple(
        ("", 0.0) if v != v else (v, 0.0) if isinstance(v, str) else ("", float(v)) for v in (c[n] for c in columns)
    )


# -- the journal
# ----------------------------------------------------------------------------------------------------------


def of_journal(stored: Stored, again: Again, elsewhere: bool, code: bool) -> Iterator[Deviation]:
    """Compare the journal lines of ended cells, except the places of their chunks; ``code``: whether the code is
    unchanged.
    """
    for ref, name in again.names.items():
        entry, fresh = stored.journal.entries.get(name), again.reports.get(name)
        if entry is None or entry.event not in ("done", "failed"):
            continue
        own, done = entry.key == again.keys[ref], entry.event == "done"
        if name in stored.journal.outdated:
            if code and own:
                yield Deviation("journal.jsonl", f"{name} outdated", entry.key, "another key")
            continue
        if code and done and not own:
            yield Deviation("journal.jsonl", f"{name} key", entry.key, again.keys[ref])
        if not done and entry.files:
            yield Deviation("journal.jsonl", f"{name} files", entry.files[0].path, "")
        if fresh is None or elsewhere or (fresh.status == "failed" if done else not own):
            continue
        for word in ("status", "clipped", "clipped_flux", "floored"):
            if getattr(entry, word) != getattr(fresh, word):
                yield Deviation(
                    "journal.jsonl", f"{name} {word}", shown(getattr(entry, word)), shown(getattr(fresh, word))
                )


# -- records
# --------------------------------------------------------------------------------------------------------------


def of_records(stored: Stored, elsewhere: bool, again: Again, most_cells: int | None) -> Iterator[Deviation]:
    """Compare every run record with its copy in the journal, with the pipeline file beside it, and with a record
    recomputed from its pipeline and earlier runs.
    """
    folder, known = stored.folder, dict[str, set[str]]()
    readable = {run.path.name: run for run in every_record(folder)}
    newest, made = list(readable.values()), Document()
    place = {run.path.name: number for number, run in enumerate(newest)}
    for path in record_paths(folder):
        file, run = f"runs/{path.name}", readable.get(path.name)
        if run is None:
            yield Deviation(file, "", "unreadable", "a record")
            continue
        kept, text = stored.journal.records.get(file), (disk.content_of(path) or b"").decode(errors="replace")
        if kept is not None and kept != text:
            yield Deviation(file, "", "different text", "the copy in the journal")
        beside = disk.content_of(path.with_suffix(".toml"))
        if beside != run.text.encode():
            yield Deviation(
                f"runs/{path.stem}.toml", "", "" if beside is None else "another pipeline", f"'resolved' of {file}"
            )
        own = json.dumps([run.record.get(word) for word in ("resolved", "text", "overrides", "axes", "options")])
        if own not in made:  # records with the same request give the same result
            try:
                made[own] = record_again(run, newest[place[path.name] + 1 :], most_cells)
            except (ArchiveError, RequestError) as error:
                yield Deviation(file, "resolved", str(error).split("\n")[0], "a pipeline that can be read here")
                continue
            except (
                ArithmeticError,
                AttributeError,
                LookupError,
                TypeError,
                ValueError,
            ) as error:  # fields of another form
                yield Deviation(
                    file, "axes, options", f"{type(error).__name__}: {error}", "the content of a record of a run"
                )
                continue
        yield from _of_record(file, run, made[own], known, elsewhere)
    for name in sorted(stored.journal.records.keys() - {f"runs/{path.name}" for path in record_paths(folder)}):
        yield Deviation(name, "", "", "it is there: the journal has it")
    if stored.manifest is not None:
        yield from _of_axes(stored, again, known)


def _of_axes(stored: Stored, again: Again, known: Mapping[str, set[str]]) -> Iterator[Deviation]:
    """Compare the axis values in the journal with ``known``, the values that runs have requested."""
    keys = {axis.dim: axis.key for axis in again.plan.positioned}
    for dim, values in (pair for axes in stored.journal.axes.values() for pair in axes.items()):
        for value in sorted(set(map(str, values)) - known.get(keys.get(dim, dim), set())):
            yield Deviation("journal.jsonl", f"axes {dim}", value, "a value that a run has asked for")


def _of_record(
    file: str, run: Recorded, again: Any, known: dict[str, set[str]], elsewhere: bool
) -> Iterator[Deviation]:
    made, asked = again
    made, other = _with_the_code_of_then(run.record, made)
    yield from differences(file, run.record, made, ELSEWHERE if elsewhere or other else 0.0)
    for key, values in asked.items():
        there = set(map(str, run.record["axes"].get(key, ())))
        for value in sorted(there - values - known.get(key, set())):
            yield Deviation(file, f"axes.{key}", value, "a value that this run or an earlier run has requested")
        for value in sorted(values - there):
            yield Deviation(file, f"axes.{key}", "", value)
        known.setdefault(key, set()).update(there)


def _with_the_code_of_then(says: DocumentView, made: DocumentView) -> tuple[DocumentView, bool]:
    """Return the recomputed record, and whether the code has changed since the run; if it has, the recorded code fields
    replace the present ones.
    """
    nodes, other = dict(made["nodes"]), False
    for name, then in says["nodes"].items():
        now: Any = nodes.get(name)
        for word in OF_CODE if now is not None else ():
            if then.get(word) == now[word]:
                continue
            other = True
            if then.get(word) is not None and isinstance(now[word], type(then[word])):
                nodes[name] = now = {**now, word: then[word]}
    return ({**made, "nodes": nodes, "sources": says.get("sources")}, True) if other else (made, False)


# -- the RO-Crate
# ----------------------------------------------------------------------------------------


def of_crate(stored: Stored, again: Again, software: bool) -> Iterator[Deviation]:
    """Compare the crate with the recomputed crate, entity by entity."""
    if stored.manifest is None:
        return
    if crate.NAME not in stored.manifest.files:
        yield Deviation(crate.NAME, "", "", "it is there")
        return
    says, made = disk.read_document(stored.folder / crate.NAME), crate.crate_of(stored.folder, again.plan)
    held, own = _entities(says), _entities(made)
    for name in dict.fromkeys((*own, *held)):
        if software:
            for one in (held.get(name, {}), own.get(name, {})):
                one.pop("identifier", None)
        if name in held and name in own:
            yield from differences(crate.NAME, held[name], own[name], 0.0, name)
        elif not skipped(crate.NAME, f"{name}."):
            yield Deviation(
                crate.NAME, name, "it is there" if name in held else "", "it is there" if name in own else ""
            )
    rest = [{key: value for key, value in (one or {}).items() if key != "@graph"} for one in (says, made)]
    yield from differences(crate.NAME, rest[0], rest[1], 0.0)


def _entities(document: DocumentView | None) -> dict[str, Document]:
    graph = (document or {}).get("@graph")
    found: dict[str, Document] = {}
    for number, one in enumerate(graph if isinstance(graph, list) else ()):
        name = str(one.get("@id")) if isinstance(one, dict) else str(number)
        found[name if name not in found else f"{name} again"] = dict(one) if isinstance(one, dict) else {"": one}
    return found

"""An archive's metadata held against what is made again: as wholes, but for a list of what no computing can tell.

In:  an archive, its plan computed again (``studies.remade``).
Out: ``Difference``: file, place in it, what it says, what it has to say. What is not in ``NOT_CHECKED`` is compared, a
     new field too.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from etendue.archive import crate, disk
from etendue.archive.again import Recorded, every_record
from etendue.archive.manifest import DATA
from etendue.archive.provenance import record_paths
from etendue.archive.stored import LEDGER, Stored
from etendue.contract.names import TABLES
from etendue.errors import ArchiveError, RequestError
from etendue.trust import sayings
from etendue.trust.remade import Again, array_of, as_document, chunks_out_of_place, record_again, store_files
from etendue.trust.sayings import Difference

ELSEWHERE = 1e-6  # relative: how far numbers of metadata may be on another platform
OF_CODE = ("code", "distributions", "versions")  # of a stage: what was installed then


@dataclass(frozen=True)
class NotChecked:
    """What is not compared, and why not; ``pattern``: of file and place in it, ``FILE#WHERE``."""

    what: str
    why: str
    pattern: str = ""


NOT_CHECKED = (
    NotChecked(
        "seconds",
        "another run takes others; ledger and journal are held against each other, the summary's are of the last run "
        "alone",
        rf"{DATA}/summary/seconds/c/.*",
    ),
    NotChecked(
        "dates",
        "nobody else has seen the clock",
        r"runs/\d+\.json#began|ro-crate-metadata\.json#.*\b(endTime|datePublished)",
    ),
    NotChecked(
        "versions, platform and code of then",
        "what differs from what is installed here is said, and not judged",
        r"runs/\d+\.json#(platform|libraries|distributions)\b.*"
        rf"|(runs/\d+\.json#nodes|{DATA}/zarr\.json#consolidated_metadata\.metadata|{DATA})\b.*[./#]distributions?\b.*"
        r"|ro-crate-metadata\.json#.*\b(softwareVersion|version)",
    ),
    NotChecked("how a run was done", "the scheduler changes no bit", r"runs/\d+\.json#options\.scheduler"),
    NotChecked(
        "names, texts, licence and authors",
        "what an author says of a pipeline nothing computes",
        rf"{DATA}/zarr\.json#attributes\.(etendue\.pipeline|variant)|ro-crate-metadata\.json#(\./|#run-\d+|runs/\d+\.toml)?"
        r"\.(name|description|license|author)\b.*|ro-crate-metadata\.json#.*\.(agent|license|author)\b.*|ro-crate-metadata\.json#(https?:|#author|"
        r"#affiliation|#license|CITATION).*",
    ),
    NotChecked("messages of failed cells", "a cell that fails again may say so in other words"),
    NotChecked(
        "what was reused or accepted", "a cell of an earlier platform stands in the tables as the journal has it"
    ),
    NotChecked(
        "contact_sheet.png, CITATION.cff, measured.json",
        "drawings and texts of what is compared; run --measure measures again",
    ),
    NotChecked("what is beside it", "files and groups that no run has written, strays/"),
)


def unchecked(stored: Stored, again: Again, elsewhere: bool, software: bool, into: bool) -> list[NotChecked]:
    """Of one archive: the list, and what else of it cannot be compared, with how much."""
    found = list(NOT_CHECKED)
    entries, gone = stored.journal.entries, stored.journal.outdated
    lacking = [
        name
        for name in again.names.values()
        if (one := entries.get(name)) is None or one.event != "done" or name in gone
    ]
    if lacking:
        found.append(
            NotChecked(
                f"{len(lacking)} cells that it does not hold",
                f"{lacking[0]} ...: not asked for, broken off, failed, or removed",
            )
        )
    known = set(again.names.values())
    said = stored.journal.said
    strange = [
        name for name in said if name not in known and not said.first_file(name) and said[name].event != "removed"
    ]
    if strange:
        found.append(
            NotChecked(
                f"{len(strange)} lines of cells that its pipeline does not have",
                f"{strange[0]} ...: they have no files",
            )
        )
    if stored.manifest is None:
        found.append(NotChecked("status, tables, pictures", "its last run was broken off: etendue rerun ends it"))
    elif again.sheet is None:
        why = (
            "it has none"
            if f"{DATA}/frames/zarr.json" not in stored.manifest.metadata
            else "another platform"
            if elsewhere
            else "--into"
            if into
            else "they are of cells that it no longer holds, or not all of them came out"
        )
        found.append(NotChecked("pictures (frames)", why))
    if software:
        found.append(NotChecked("keys, and digests of code", "the code is another than then"))
    if elsewhere:
        found.append(NotChecked("what was clipped", "another platform; other numbers may differ by 1e-6 of themselves"))
    return found


# -- comparing documents
# --------------------------------------------------------------------------------------------------


def _skipped(file: str, where: str) -> bool:
    return any(one.pattern and re.fullmatch(one.pattern, f"{file}#{where}" if where else file) for one in NOT_CHECKED)


def _differences(file: str, says: Any, has: Any, loose: float, *at: str) -> Iterator[Difference]:
    """Of two documents, field by field; ``at``: the fields on the way from the whole document to these."""
    if len(at) == 1 and repr(says) == repr(has):
        return  # most parts are the same, down to the sign of a zero
    if isinstance(says, Mapping) and isinstance(has, Mapping):
        for key in dict.fromkeys((*has, *says)):
            yield from _differences(file, says.get(key, _NOTHING), has.get(key, _NOTHING), loose, *at, str(key))
    elif isinstance(says, list) and isinstance(has, list) and len(says) == len(has):
        for number, (one, other) in enumerate(zip(says, has, strict=True)):
            yield from _differences(file, one, other, loose, *at, str(number))
    elif type(says) is not type(has) or not _alike(says, has, loose):
        # Asked of what differs alone: of documents by the thousand most is the same.
        if not any(_skipped(file, ".".join(at[:depth])) for depth in range(len(at) + 1)):
            yield Difference(file, ".".join(at), _shown(says), _shown(has))


_NOTHING = object()


def _alike(one: Any, other: Any, loose: float) -> bool:
    """Whether two values are one; 0 and -0 are two."""
    if isinstance(one, float):
        if one == other:
            return loose > 0 or math.copysign(1, one) == math.copysign(1, other)
        return (one != one and other != other) or (loose > 0 and math.isclose(one, other, rel_tol=loose, abs_tol=1e-30))
    return bool(one == other)


def _shown(value: Any) -> str:
    text = "" if value is _NOTHING else value if isinstance(value, str) else repr(value)
    return text if len(text) <= 120 else f"{text[:117]}..."


# -- the store
# ------------------------------------------------------------------------------------------------------------


def of_store(stored: Stored, again: Again, elsewhere: bool) -> Iterator[Difference]:
    """Metadata, coordinates, status, tables and pictures."""
    ended, loose = stored.manifest is not None, ELSEWHERE if elsewhere else 0.0
    try:
        own = store_files(stored, again, ended)
        out = list(chunks_out_of_place(stored, again))
    except (ArithmeticError, LookupError, TypeError, ValueError, MemoryError, AttributeError) as error:
        yield Difference(
            "journal.jsonl", "axes, blocks, cells", f"{type(error).__name__}: {error}", "what can be laid out"
        )
        return
    yield from (Difference("journal.jsonl", name, place, "another place") for name, place in out)
    files = {path.removeprefix(f"{DATA}/") for path in disk.Listing(stored.folder).below(DATA)}
    ours = {path.split("/")[0] for path in own if "/" in path}
    alone = {
        f"{group}/{name}/c" for group, names in stored.journal.blocks.items() for name in names
    }  # chunks of cells without axes
    said = {
        path
        for path in files
        if path == "zarr.json" or (path.split("/")[0] in ours | set(TABLES) and _is_metadata(path))
    } - alone
    pictured = any(path.startswith("frames/") for path in own)
    for path in sorted(own.keys() | said):
        if (
            (path.split("/")[0] == "frames" and not pictured)
            or (not ended and _of_the_end(path))
            or path.startswith(f"{LEDGER}/")
        ):
            continue
        has, data = own.get(path), disk.content_of(stored.folder / DATA / path)
        if has != data:
            yield from _of_file(path, data, has, own, loose)
    yield from sayings.of_the_rest(stored, again, own)
    if ended:
        yield from _of_ledger(stored, own, elsewhere)


def _is_metadata(path: str) -> bool:
    return path.endswith("/zarr.json") or "/c/" in path or path.endswith("/c")


def _of_the_end(path: str) -> bool:
    """What is written when a run ends."""
    return path == "zarr.json" or "/status/c" in path or path.split("/")[0] in TABLES


def _of_file(
    path: str, data: bytes | None, has: bytes | None, own: Mapping[str, bytes], loose: float
) -> Iterator[Difference]:
    file = f"{DATA}/{path}"
    if _skipped(file, ""):
        return
    if has is None or data is None:
        yield Difference(file, "", "" if data is None else "it is there", "" if has is None else "it is there")
    elif path.endswith("zarr.json"):
        says, made = as_document(data), as_document(has)
        if path == "zarr.json":
            says = _of_ours(says, made)
        yield from _differences(file, says, made, loose)
    else:
        array = path[: re.search(r"/c(/\d+)*$", path).start()]  # type: ignore[union-attr]
        node = as_document(own[f"{array}/zarr.json"])
        form = node["data_type"], tuple(node["shape"])
        fresh = array_of(has, *form)
        try:
            old = array_of(data, *form)
        except ArchiveError as error:
            yield Difference(file, "", str(error), _shown(fresh.tolist()))
            return
        yield from _of_array(file, old, fresh, loose)


def _of_array(file: str, old: Any, fresh: Any, loose: float) -> Iterator[Difference]:
    pairs = zip(old.ravel().tolist(), fresh.ravel().tolist(), strict=True)
    off = [n for n, (one, other) in enumerate(pairs) if not _alike(one, other, loose)]
    if off:
        at = [int(n) for n in np.unravel_index(off[0], fresh.shape)] if fresh.ndim else []
        more = f" and {len(off) - 1} more" if len(off) > 1 else ""
        yield Difference(
            file, f"{at}{more}", _shown(old.ravel().tolist()[off[0]]), _shown(fresh.ravel().tolist()[off[0]])
        )


def _of_ours(says: Any, made: Any) -> Any:
    """The root without what it says of groups that no run has written, and of pictures that are not compared."""
    try:
        held, own = says["consolidated_metadata"]["metadata"], made["consolidated_metadata"]["metadata"]
        ours = {path.split("/")[0] for path in own}
        kept = {
            path: one for path, one in held.items() if path.split("/")[0] in (ours | set(TABLES)) - ({"frames"} - ours)
        }
        return {**says, "consolidated_metadata": {**says["consolidated_metadata"], "metadata": kept}}
    except (KeyError, TypeError, AttributeError):
        return says


def _of_ledger(stored: Stored, own: Mapping[str, bytes], elsewhere: bool) -> Iterator[Difference]:
    """The row of every cell, in whatever order they stand: sorted axes leave them where they are."""
    nodes = {
        path.split("/")[1]: as_document(data)
        for path, data in own.items()
        if re.fullmatch(rf"{LEDGER}/\w+/zarr.json", path)
    }
    listed = disk.Listing(stored.folder)
    there = {path.split("/")[2] for path in listed.below(f"{DATA}/{LEDGER}") if path.count("/") > 2}
    for name in sorted(nodes.keys() ^ there):
        yield Difference(
            f"{DATA}/{LEDGER}/{name}", "", *(("it is there", "") if name in there else ("", "it is there"))
        )
    columns: dict[str, tuple[Any, Any]] = {}
    for path in sorted(path for path in own if path.startswith(f"{LEDGER}/") and path.endswith("zarr.json")):
        name, file = path.split("/")[1], f"{DATA}/{path}"
        yield from _differences(file, as_document(disk.content_of(stored.folder / file)), as_document(own[path]), 0.0)
        if name == "zarr.json" or name not in there:
            continue
        form = nodes[name]["data_type"], tuple(nodes[name]["shape"])
        try:
            old = array_of(disk.content_of(stored.folder / DATA / LEDGER / name / "c" / "0"), *form)
        except ArchiveError as error:
            yield Difference(f"{DATA}/{LEDGER}/{name}/c/0", "", str(error), "its column")
            continue
        columns[name] = old, array_of(own.get(f"{LEDGER}/{name}/c/0"), *form)
    told = [name for name in columns if name in ("stage", "key") or name.startswith("at_")]
    if not told:
        return
    orders = [
        sorted(range(len(columns[told[0]][n])), key=_row([columns[name][n].tolist() for name in told])) for n in (0, 1)
    ]
    for name, (old, fresh) in columns.items():
        if elsewhere and name.startswith("clipped"):
            continue
        yield from _of_array(
            f"{DATA}/{LEDGER}/{name}", old[orders[0]], fresh[orders[1]], ELSEWHERE if elsewhere else 0.0
        )


def _row(columns: list[list[Any]]) -> Any:
    return lambda n: tuple(
        ("", 0.0) if v != v else (v, 0.0) if isinstance(v, str) else ("", float(v)) for v in (c[n] for c in columns)
    )


# -- the journal
# ----------------------------------------------------------------------------------------------------------


def of_journal(stored: Stored, again: Again, elsewhere: bool, code: bool) -> Iterator[Difference]:
    """What the line of each cell says beside its place, if it has ended; ``code``: whether it is the code of then."""
    for ref, name in again.names.items():
        entry, fresh = stored.journal.entries.get(name), again.reports.get(name)
        if entry is None or entry.event not in ("done", "failed"):
            continue
        own, done = entry.key == again.keys[ref], entry.event == "done"
        if name in stored.journal.outdated:
            if code and own:
                yield Difference("journal.jsonl", f"{name} outdated", entry.key, "another key")
            continue
        if code and done and not own:
            yield Difference("journal.jsonl", f"{name} key", entry.key, again.keys[ref])
        if not done and entry.files:
            yield Difference("journal.jsonl", f"{name} files", entry.files[0].path, "")
        if fresh is None or elsewhere or (fresh.status == "failed" if done else not own):
            continue
        for word in ("status", "clipped", "clipped_flux", "floored"):
            if getattr(entry, word) != getattr(fresh, word):
                yield Difference(
                    "journal.jsonl", f"{name} {word}", _shown(getattr(entry, word)), _shown(getattr(fresh, word))
                )


# -- records
# --------------------------------------------------------------------------------------------------------------


def of_records(stored: Stored, elsewhere: bool, again: Again, most_cells: int | None) -> Iterator[Difference]:
    """Every record against the pipeline in it, its copy in the journal, the file beside it, and the runs in front of
    it.
    """
    folder, known = stored.folder, dict[str, set[str]]()
    readable = {run.path.name: run for run in every_record(folder)}
    newest, made = list(readable.values()), dict[str, Any]()
    place = {run.path.name: number for number, run in enumerate(newest)}
    for path in record_paths(folder):
        file, run = f"runs/{path.name}", readable.get(path.name)
        if run is None:
            yield Difference(file, "", "it cannot be read", "a record")
            continue
        kept, text = stored.journal.records.get(file), (disk.content_of(path) or b"").decode(errors="replace")
        if kept is not None and kept != text:
            yield Difference(file, "", "another text", "that of the journal")
        beside = disk.content_of(path.with_suffix(".toml"))
        if beside != run.text.encode():
            yield Difference(
                f"runs/{path.stem}.toml", "", "" if beside is None else "another pipeline", f"'resolved' of {file}"
            )
        own = json.dumps([run.record.get(word) for word in ("resolved", "text", "overrides", "axes", "options")])
        if own not in made:  # the same again asks for the same
            try:
                made[own] = record_again(run, newest[place[path.name] + 1 :], most_cells)
            except (ArchiveError, RequestError) as error:
                yield Difference(file, "resolved", str(error).split("\n")[0], "a pipeline that can be read here")
                continue
            except (
                ArithmeticError,
                AttributeError,
                LookupError,
                TypeError,
                ValueError,
            ) as error:  # words of another form
                yield Difference(file, "axes, options", f"{type(error).__name__}: {error}", "what a run records")
                continue
        yield from _of_record(file, run, made[own], known, elsewhere)
    for name in sorted(stored.journal.records.keys() - {f"runs/{path.name}" for path in record_paths(folder)}):
        yield Difference(name, "", "", "it is there: the journal has it")
    for dim, values in _values(stored) if stored.manifest is not None else ():
        key = next((axis.key for axis in again.plan.axes if axis.dim == dim), dim)
        for value in sorted(values - known.get(key, set())):
            yield Difference("journal.jsonl", f"axes {dim}", value, "a value that a run has asked for")


def _values(stored: Stored) -> Iterator[tuple[str, set[str]]]:
    for axes in stored.journal.axes.values():
        for dim, values in axes.items():
            yield dim, set(map(str, values))


def _of_record(
    file: str, run: Recorded, again: Any, known: dict[str, set[str]], elsewhere: bool
) -> Iterator[Difference]:
    made, asked = again
    made, other = _with_the_code_of_then(run.record, made)
    yield from _differences(file, run.record, made, ELSEWHERE if elsewhere or other else 0.0)
    for key, values in asked.items():
        there = set(map(str, run.record["axes"].get(key, ())))
        for value in sorted(there - values - known.get(key, set())):
            yield Difference(file, f"axes.{key}", value, "a value that it, or a run in front of it, has asked for")
        for value in sorted(values - there):
            yield Difference(file, f"axes.{key}", "", value)
        known.setdefault(key, set()).update(there)


def _with_the_code_of_then(says: Mapping[str, Any], made: Mapping[str, Any]) -> tuple[Mapping[str, Any], bool]:
    """What is made now, with what a record says of its code where that is another; whether it is."""
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


# -- the description for strangers
# ----------------------------------------------------------------------------------------


def of_crate(stored: Stored, again: Again, software: bool) -> Iterator[Difference]:
    """Every entity by its name."""
    if stored.manifest is None:
        return
    if crate.NAME not in stored.manifest.files:
        yield Difference(crate.NAME, "", "", "it is there")
        return
    says, made = disk.read_document(stored.folder / crate.NAME), crate.crate_of(stored.folder, again.plan)
    held, own = _entities(says), _entities(made)
    for name in dict.fromkeys((*own, *held)):
        if software:
            for one in (held.get(name, {}), own.get(name, {})):
                one.pop("identifier", None)
        if name in held and name in own:
            yield from _differences(crate.NAME, held[name], own[name], 0.0, name)
        elif not _skipped(crate.NAME, f"{name}."):
            yield Difference(
                crate.NAME, name, "it is there" if name in held else "", "it is there" if name in own else ""
            )
    rest = [{key: value for key, value in (one or {}).items() if key != "@graph"} for one in (says, made)]
    yield from _differences(crate.NAME, rest[0], rest[1], 0.0)


def _entities(document: Mapping[str, Any] | None) -> dict[str, dict[str, Any]]:
    graph = (document or {}).get("@graph")
    found: dict[str, dict[str, Any]] = {}
    for number, one in enumerate(graph if isinstance(graph, list) else ()):
        name = str(one.get("@id")) if isinstance(one, dict) else str(number)
        found[name if name not in found else f"{name} again"] = dict(one) if isinstance(one, dict) else {"": one}
    return found


def both(ones: Iterator[Difference]) -> list[Difference]:
    """Each difference once, in order."""
    return list(dict.fromkeys(ones))

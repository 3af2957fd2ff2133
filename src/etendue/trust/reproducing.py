"""Reproduce an archive from the archive alone, and compare cell by cell while it is computed.

In:  the folder of an archive: its resolved pipeline, inputs by digest, the versions and digests of stages, seeds,
     platform.
Out: a ``Reproduction``: for each stage the number of cells with the same bits, the deviation of the others and the
     verdict on it; other contents that were not reproduced (``trust.checked``), damaged files, and the list of what was
     not checked.

On the same platform (processor features, numpy, scipy, Python) every bit must agree. On another platform a cell may
differ by the errors that its stage and the stages before it state: their sum, relative to full scale, rms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from etendue.archive.checks.verify import verify
from etendue.archive.journaling.accepting import former_of
from etendue.archive.read import earlier_pictures
from etendue.archive.read.comparing import Comparing, ComparingKeeper
from etendue.archive.read.stored import Stored
from etendue.archive.records import disk
from etendue.archive.records.inputs import sweep_of
from etendue.archive.records.manifest import NAME as MANIFEST
from etendue.archive.records.manifest import digest_of
from etendue.archive.records.owner import is_running
from etendue.archive.records.provenance import node_records, platform_record
from etendue.archive.records.rerun import Recorded, every_record, recorded
from etendue.archive.structure.naming import Names, cell_name
from etendue.archive.write.keeping import staying
from etendue.contract.ports import CellReport, ContactSheet, Progress
from etendue.contract.registry import installed_stages
from etendue.errors import ArchiveError, ArchiveInUse, Fault, RequestError
from etendue.plan.identity.keys import version_of
from etendue.plan.model import CellRef, Plan
from etendue.plan.planner import make_plan
from etendue.plan.resume import is_of_names, with_stored_values
from etendue.plan.shown import where_shown
from etendue.session import Options, execute
from etendue.trust import checked
from etendue.trust.comparing import unchecked
from etendue.trust.remade import Again, column
from etendue.trust.sayings import Deviation
from etendue.trust.verdict import CellResult, Reproduction, judged_cell
from etendue.types.documents import Document

WORST = 20  # cells that are listed


def reproduce(
    folder: Path,
    options: Options | None = None,
    progress: Callable[[Plan], Progress] | None = None,
    into: Path | None = None,
) -> Reproduction:
    """Recompute every finished cell of an archive and compare. The archive is not changed; ``into``: folder in which to
    keep the recomputed archive.

    Raises
    ------
    RequestError
        A stage is not installed, or this installation refuses the recorded pipeline; every reason is given.
    ArchiveError
        The folder is not an archive, or its record or an input is damaged or missing.
    ArchiveInUse
        A run is writing to it.
    """
    if is_running(folder):
        raise ArchiveInUse(f"{folder}: a run is writing to it; reproduce it after the run has ended")
    run, state = recorded(folder), _state(folder)
    _refuse_missing(run)
    most_cells = options.most_cells if options else None
    pipeline = run.pipeline(most_cells)
    stored = Stored(folder)
    plan = _plan_of(make_plan(pipeline, installed_stages()), stored)
    was, now = run.record["platform"], platform_record()
    platform = {name: (was.get(name), value) for name, value in now.items() if was.get(name) != value}
    found = Reproduction(folder, run.record, platform, software(run, plan), [node.name for node in plan.nodes])
    keys = {ref: cell.key for ref, cell in plan.cells.items()}
    if platform or any(version_of(name) != version for name, version in run.record["libraries"].items()):
        keys |= former_of(plan, run.record).keys  # the keys at the time of the run
    again = Again(plan, dict(Names(plan)), keys, {})
    asked = _asked(stored, again)
    told = progress(plan) if progress else None
    if into is None:
        again, damaged, found.seconds = _computed(stored, again, asked, options, told, not platform)
    else:
        if into.resolve() == folder.resolve():
            raise ArchiveError(f"--into {into}: this is the archive itself; choose another folder")
        outcome = execute(plan, into, options, told)
        found.seconds = outcome.seconds
        kept = {cell_name(plan, ref): one for ref, one in outcome.reports.items()}
        reports, damaged = _held_against(stored, Stored(into), asked, kept)
        again = replace(again, reports=reports)
    found.cells += _judged(stored, again, asked, damaged, bool(platform))
    _compare_the_rest(found, stored, again, into is not None, most_cells)
    if is_running(folder) or _state(folder) != state:
        raise ArchiveInUse(f"{folder}: a run has started writing to it; reproduce it after the run has ended")
    return found


def _asked(stored: Stored, again: Again) -> list[str]:
    """Return the cells to recompute: finished and failed cells, except cells that were stopped."""
    entries, outdated = stored.journal.entries, stored.journal.outdated
    ended = {name: one.event for name in again.names.values() if (one := entries.get(name)) and name not in outdated}
    stopped = _stopped(stored, again)
    return [name for name, event in ended.items() if event in ("done", "failed") and name not in stopped]


def _computed(
    stored: Stored, again: Again, asked: list[str], options: Options | None, told: Progress | None, pictures: bool
) -> tuple[Again, Mapping[str, str], float]:
    """Recompute and compare every cell; return the results, the unreadable parts of the archive, and the seconds."""
    shown = _shown(stored, again) if pictures else {}
    keeper = ComparingKeeper(stored, asked, shown, _drawn(stored))
    outcome = execute(again.plan, None, options, told, keeper)
    made = replace(again, reports=keeper.reports, sheet=_told(keeper.sheet, again, shown))
    return made, keeper.damaged, outcome.seconds


def _judged(
    stored: Stored, again: Again, asked: Iterable[str], damaged: Mapping[str, str], elsewhere: bool
) -> Iterator[CellResult]:
    """Yield the verdict on every finished cell."""
    refs = {name: ref for ref, name in again.names.items()}
    for name in asked:
        entry, report = stored.journal.entries[name], again.reports.get(name)
        held = name in stored.archive.cells and stored.archive.chunks_of(stored.archive.cells[name])
        if entry.event == "done" and (entry.files or held or report is None):
            yield from judged_cell(again.plan, refs[name], name, report, damaged.get(name, ""), elsewhere)
    for name, entry in stored.finished.items():
        if name not in refs and entry.files:
            yield CellResult(name.split(" ")[0], name, "", "unknown", why="the pipeline has no such cell")


def _compare_the_rest(found: Reproduction, stored: Stored, again: Again, into: bool, most_cells: int | None) -> None:
    """Compare metadata, tables, journal, records and the crate, and verify every file."""
    elsewhere = bool(found.platform)
    code = any(row["what"] != "distributions" for row in found.software)
    found.differences = list(
        dict.fromkeys(
            [
                *checked.of_store(stored, again, elsewhere),
                *checked.of_journal(stored, again, elsewhere, not code),
                *checked.of_records(stored, elsewhere, again, most_cells),
                *checked.of_crate(stored, again, bool(found.software)),
                *_of_code(found, stored, again),
            ]
        )
    )
    named = {cell.cell for cell in found.cells if cell.found == "damaged"}
    found.damages = [
        one
        for one in verify(found.folder, journal=stored.journal).damages
        if one.kind != "unfinished" and one.cell not in named
    ]
    found.not_checked = unchecked(stored, again, elsewhere, code, into)


def _of_code(found: Reproduction, stored: Stored, again: Again) -> Iterable[Deviation]:
    """Yield contradictions about code: stages whose keys match the present code, while the record states other code."""
    other = {row["stage"]: row for row in found.software if row["what"] == "code"}
    for ref, name in again.names.items():
        entry = stored.journal.entries.get(name)
        if ref[0] in other and entry is not None and entry.event == "done" and entry.key == again.plan.cells[ref].key:
            row = other.pop(ref[0])
            yield Deviation(
                "runs", f"nodes.{ref[0]}.code", str(row["then"]), f"{row['now']}, from which its keys are made"
            )


def _state(folder: Path) -> tuple[str, str]:
    return digest_of(folder / "run.id"), digest_of(folder / MANIFEST)


def _stopped(stored: Stored, again: Again) -> set[str]:
    """Return the cells that failed because they were stopped or their worker died: they need not fail again."""
    entries = stored.journal.entries
    named = ((ref, entries.get(name), name) for ref, name in again.names.items())
    failed = {(ref[0], again.keys[ref]): name for ref, entry, name in named if entry and entry.event == "failed"}
    columns = [column(stored, f"ledger/{name}") for name in ("stage", "key", "message")] if failed else []
    if any(one is None for one in columns):
        return set()
    rows = zip(*(one.ravel().tolist() for one in columns), strict=False)
    return {failed[stage, key] for stage, key, message in rows if (stage, key) in failed and "its worker" in message}


def _shown(stored: Stored, again: Again) -> dict[str, CellRef]:
    """Return, by stage, the cells that the pictures of an archive show; empty if it has none, or if a shown cell is not
    among the recomputed ones.
    """
    nodes = again.plan.nodes
    held = earlier_pictures.attributes(
        {"frames/zarr.json": disk.content_of(stored.folder / "data.zarr/frames/zarr.json") or b"{}"}
    ).get("shown")
    held = held if isinstance(held, list) and len(held) == len(nodes) else []
    by_key = {(ref[0], key): ref for ref, key in again.keys.items()}
    found = {
        node.name: by_key.get((node.name, key)) for node, key in zip(nodes, held, strict=False) if isinstance(key, str)
    }
    return {} if None in found.values() else {name: ref for name, ref in found.items() if ref is not None}


def _drawn(stored: Stored) -> list[tuple[str, str]]:
    """Return the (stage, variable) pairs of which an archive has a picture; a run draws only computed or stored
    results.
    """
    stages, variables = (column(stored, f"frames/{name}") for name in ("stage", "variable"))
    if stages is None or variables is None or stages.shape != variables.shape:
        return []
    return [
        (str(stage).split(".")[0], str(name)) for stage, name in zip(stages.ravel(), variables.ravel(), strict=True)
    ]


def _told(sheet: ContactSheet | None, again: Again, shown: Mapping[str, CellRef]) -> ContactSheet | None:
    """Return the pictures with the attributes that a run adds."""
    if sheet is None or not sheet.table:
        return None
    at = where_shown(again.plan, shown)
    attrs = {**sheet.table.get("attrs", {}), "shown": [again.keys[ref] for ref in sheet.shown], "at": at}
    return replace(sheet, table={**sheet.table, "attrs": attrs}, at=at)


def _held_against(
    stored: Stored, other: Stored, asked: Iterable[str], reports: Mapping[str, CellReport]
) -> tuple[dict[str, CellReport], dict[str, str]]:
    """Compare the cells of two archives; return the result in the form of a run's reports."""
    found, damaged = dict[str, CellReport](), dict[str, str]()
    for name in asked:
        report = reports.get(name)
        if report is None or name not in other.finished:
            continue
        try:
            target, fresh = Comparing(stored.cell(name)), other.cell(name)
            written = target.write({variable: fresh.read(variable) for variable in target.cell.variables})
            found[name] = replace(report, status="done", written=written)
        except ArchiveError as error:
            damaged[name] = str(error)
    return found, damaged


def _plan_of(plan: Plan, stored: Stored) -> Plan:
    """Return the plan over the axis values of all runs, which keeps the stored variables."""
    swapped = any(is_of_names(axis.key) for axis in plan.axes)
    sweeps = [sweep_of(run.record, stored.folder) for run in every_record(stored.folder)] if swapped else []
    whole = with_stored_values(plan, stored.journal.axes, sweeps)
    there = stored.variables() | _laid_out(whole, stored)
    kept, _, _ = staying(replace(whole, kept=frozenset(there)), stored.journal.said, there)
    # Archives of earlier versions have copies of what is left out.
    copies = {(path.split("/")[0], v) for path, own in stored.journal.blocks.items() for v in own}
    return replace(kept, copied=kept.copied | (kept.same_as.keys() & copies))


def _laid_out(plan: Plan, stored: Stored) -> set[tuple[str, str]]:
    """Return the (stage, variable) pairs that have an array, even if none of their cells was computed."""
    writes = {node.name: node.writes for node in plan.nodes}
    pairs = (
        (group, name) for group, names in stored.journal.blocks.items() for name in names if stored.keeps(group, name)
    )
    return {(stage, name) for group, name in pairs if name in writes.get(stage := group.split("/")[0], ())}


def _refuse_missing(run: Recorded) -> None:
    """Raise an error that lists every stage not installed here, with its distribution."""
    registry, faults = installed_stages(), []
    for name, node in run.record["nodes"].items():
        known = node.get("distributions") or [None] * len(node.get("stage", ()))
        for use, distribution in zip(node.get("stage", ()), known, strict=False):
            if use not in registry:
                was = f" of {distribution}" if distribution else ""
                way = f"; install it: pip install {distribution.replace(' ', '==')}" if distribution else ""
                faults.append(
                    Fault(
                        f"stage {name}",
                        f"{use!r}{was} is not installed here, but the archive was computed with it{way}",
                    )
                )
    if faults:
        raise RequestError(faults)


def software(run: Recorded, plan: Plan) -> list[Document]:
    """Return the differences between the installed stages and the stages that computed the archive, one document per
    difference.
    """
    rows = []
    now = node_records(plan)
    for name, before in run.record["nodes"].items():
        after = now.get(name)
        if after is None:
            continue
        for what in ("distributions", "code", "versions"):
            if before.get(what) is not None and before[what] != after[what]:
                rows.append({"stage": name, "what": what, "then": before[what], "now": after[what]})
    return rows


def document(found: Reproduction) -> Document:
    """Return the result as the document that ``--json`` prints."""
    return {
        "archive": str(found.folder),
        "pipeline": found.record["pipeline"],
        "began": found.record["began"],
        "verdict": found.verdict,
        "reproduced": found.reproduced,
        "platform": {
            "same": not found.platform,
            "differs": {k: {"then": a, "now": b} for k, (a, b) in found.platform.items()},
        },
        "software": found.software,
        "compared": len(found.cells),
        "stages": [_stage(name, own) for name in found.order if (own := [c for c in found.cells if c.stage == name])],
        "not_the_same": [vars(cell) for cell in found.cells if cell.found != "same"][:WORST],
        "differences": [
            {"file": one.file, "where": one.where, "says": one.says, "is": one.is_} for one in found.differences
        ],
        "damages": [{name: value or None for name, value in vars(damage).items()} for damage in found.damages],
        "not_checked": [{"what": one.what, "why": one.why} for one in found.not_checked],
        "seconds": found.seconds,
    }


def _stage(name: str, own: list[CellResult]) -> Document:
    counts = {
        kind: sum(cell.found == kind for cell in own)
        for kind in ("same", "within", "beyond", "unknown", "damaged", "failed")
    }
    return {
        "name": name,
        "compared": len(own),
        **counts,
        "largest": max((c.largest for c in own if c.largest is not None), default=None),
        "relative": max((c.relative for c in own if c.relative is not None), default=None),
        "allowed": min((c.allowed for c in own if c.allowed is not None), default=None),
    }

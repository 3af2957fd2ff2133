"""Does an archive come out again? Computed from the archive alone, and compared cell by cell while it is computed.

In:  the folder of an archive: its resolved pipeline, inputs by digest, the versions and digests of stages, seeds, platform.
Out: a ``Reproduction``: by stage how many cells have the same bits, how far the others are, and what that means.

On the same platform (processor features, numpy, scipy, Python) every bit has to agree. On another one a cell may differ by the
errors that its stage and those in front of it state: their sum, relative to full scale, rms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from etendue.archive.again import Recorded, every_record, recorded
from etendue.archive.comparing import Compared, Comparing, ComparingKeeper
from etendue.archive.inputs import sweep_of
from etendue.archive.keeping import staying
from etendue.archive.naming import cell_name
from etendue.archive.owner import is_running
from etendue.archive.provenance import node_records, platform_record
from etendue.archive.stored import Stored
from etendue.errors import ArchiveError, ArchiveInUse, Fault, RequestError
from etendue.plan.ancestry import ancestry
from etendue.plan.model import CellRef, Plan
from etendue.plan.planner import make_plan
from etendue.plan.resume import is_of_names, with_stored_values
from etendue.registry import installed_stages
from etendue.session import Options, execute
from etendue.spec.ports import CellReport, Progress

WORST = 20  # cells that are named


@dataclass(frozen=True)
class CellResult:
    """What became of one variable of one cell."""

    stage: str
    cell: str
    variable: str
    found: str  # same | within | beyond | unknown | damaged | failed
    largest: float | None = None
    relative: float | None = None
    allowed: float | None = None
    why: str = ""


@dataclass
class Reproduction:
    """What was found.

    Attributes
    ----------
    platform : the fields that differ, as (then, now); nothing on the same platform
    software : by stage what differs from the archive's: its distribution and version, or its code
    """

    folder: Path
    record: Mapping[str, Any]
    platform: dict[str, tuple[Any, Any]]
    software: list[dict[str, Any]]
    order: list[str]
    cells: list[CellResult] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def verdict(self) -> str:
        found = {cell.found for cell in self.cells}
        if not found:
            return "nothing to compare"
        if found == {"same"}:
            return "the same bits"
        return "within the stated errors" if found <= {"same", "within"} else "not reproduced"

    @property
    def reproduced(self) -> bool:
        return self.verdict in ("the same bits", "within the stated errors")


def reproduce(
    folder: Path, options: Options | None = None, progress: Callable[[Plan], Progress] | None = None, into: Path | None = None
) -> Reproduction:  # fmt: skip
    """Compute every finished cell of an archive again and compare. The archive is not changed; ``into``: keep the new one there.

    Raises
    ------
    RequestError
        A stage is not installed, or the recorded pipeline is refused here: every reason.
    ArchiveError
        The folder is no archive, or its record or an input is damaged or missing.
    ArchiveInUse
        A run is writing to it.
    """
    if is_running(folder):
        raise ArchiveInUse(f"{folder}: a run is writing to it; reproduce it when it has ended")
    run = recorded(folder)
    _refuse_missing(run)
    pipeline = run.pipeline(options.most_cells if options else None)
    stored = Stored(folder)
    plan = _plan_of(make_plan(pipeline, installed_stages()), stored)
    was, now = run.record["platform"], platform_record()
    platform = {name: (was.get(name), value) for name, value in now.items() if was.get(name) != value}
    found = Reproduction(folder, run.record, platform, software(run, plan), [node.name for node in plan.nodes])
    asked = [name for ref in plan.cells if (name := cell_name(plan, ref)) in stored.finished and stored.finished[name].files]
    told = progress(plan) if progress else None
    if into is None:
        keeper = ComparingKeeper(stored, asked)
        found.seconds = execute(plan, None, options, told, keeper).seconds
        reports, damaged = keeper.reports, keeper.damaged
    else:
        if into.resolve() == folder.resolve():
            raise ArchiveError(f"--into {into}: that is the archive itself; name another folder")
        outcome = execute(plan, into, options, told)
        found.seconds = outcome.seconds
        reports, damaged = _held_against(stored, Stored(into), asked, {cell_name(plan, r): o for r, o in outcome.reports.items()})
    refs = {cell_name(plan, ref): ref for ref in plan.cells}
    for name in asked:
        found.cells += _judged(plan, refs[name], name, reports.get(name), damaged.get(name, ""), bool(platform))
    gone = [name for name, entry in stored.finished.items() if name not in refs and entry.files]
    found.cells += [CellResult(n.split(" ")[0], n, "", "unknown", why="its pipeline has no such cell") for n in gone]
    return found


def _held_against(
    stored: Stored, other: Stored, asked: Iterable[str], reports: Mapping[str, CellReport]
) -> tuple[dict[str, CellReport], dict[str, str]]:
    """The cells of two archives compared, in the form of the reports of a run."""
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
    """The plan over the axis values of all runs, which keeps what is stored."""
    swapped = any(is_of_names(axis.key) for axis in plan.axes)
    sweeps = [sweep_of(run.record, stored.folder) for run in every_record(stored.folder)] if swapped else []
    whole = with_stored_values(plan, stored.journal.axes, sweeps)
    there = stored.variables()
    kept, _, _ = staying(replace(whole, kept=frozenset(there)), stored.journal.said, there)
    return kept


def _refuse_missing(run: Recorded) -> None:
    """Every stage that is not installed here, with the distribution it was of."""
    registry, faults = installed_stages(), []
    for name, node in run.record["nodes"].items():
        known = node.get("distributions") or [None] * len(node.get("stage", ()))
        for use, distribution in zip(node.get("stage", ()), known, strict=False):
            if use not in registry:
                was = f" of {distribution}" if distribution else ""
                way = f"; install it: pip install {distribution.replace(' ', '==')}" if distribution else ""
                faults.append(Fault(f"stage {name}", f"{use!r}{was} is not installed here, and the archive was computed with it{way}"))
    if faults:
        raise RequestError(faults)


def software(run: Recorded, plan: Plan) -> list[dict[str, Any]]:
    """What of the stages differs from those the archive was computed with."""
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


def _judged(plan: Plan, ref: CellRef, name: str, report: CellReport | None, damage: str, elsewhere: bool) -> Iterable[CellResult]:
    """What a cell's comparison means."""
    stage = ref[0]
    if damage:
        yield CellResult(stage, name, "", "damaged", why=damage)
    elif report is None or report.status in ("failed", "skipped"):
        yield CellResult(stage, name, "", "failed", why=report.message if report else "it was not computed")
    else:
        allowed = _allowed(plan, ref) if elsewhere and not all(_is_same(one) for one in report.written) else None
        for one in report.written:
            if isinstance(one, Compared):
                yield judged(stage, name, one, allowed, elsewhere)


def _is_same(one: Any) -> bool:
    return isinstance(one, Compared) and one.difference is not None and one.difference.same


def judged(stage: str, name: str, one: Compared, allowed: float | None, elsewhere: bool) -> CellResult:
    """What the difference of one variable means: bits on the same platform, stated errors ``elsewhere``."""
    found = one.difference
    if found is None:
        return CellResult(stage, name, one.path, "damaged", why=one.damage)
    if found.same:
        return CellResult(stage, name, one.path, "same", 0.0, 0.0)
    told = (stage, name, one.path)
    if found.shapes:
        return CellResult(*told, "beyond", why=f"shape or type: {found.shapes}")
    if found.undefined:
        return CellResult(*told, "beyond", found.largest, None, allowed, f"{found.undefined} values are undefined in one alone")
    if not elsewhere:
        return CellResult(*told, "beyond", found.largest, found.relative, None, "on the same platform every bit has to agree")
    if allowed is None:
        return CellResult(*told, "unknown", found.largest, found.relative, None, "it, or a stage in front of it, states no error")
    inside = found.relative is not None and found.relative <= allowed
    return CellResult(*told, "within" if inside else "beyond", found.largest, found.relative, allowed)


def _allowed(plan: Plan, ref: CellRef) -> float | None:
    """The errors stated by a cell and by all that it depends on, together; None where one states none."""
    stated = [plan.cells[one].error[0] for one in ancestry(plan, [ref])]
    return None if None in stated else sum(error for error in stated if error is not None)


def document(found: Reproduction) -> dict[str, Any]:
    """As ``--json`` says it."""
    return {
        "archive": str(found.folder),
        "pipeline": found.record["pipeline"],
        "began": found.record["began"],
        "verdict": found.verdict,
        "reproduced": found.reproduced,
        "platform": {"same": not found.platform, "differs": {k: {"then": a, "now": b} for k, (a, b) in found.platform.items()}},
        "software": found.software,
        "compared": len(found.cells),
        "stages": [_stage(name, own) for name in found.order if (own := [c for c in found.cells if c.stage == name])],
        "not_the_same": [vars(cell) for cell in found.cells if cell.found != "same"][:WORST],
        "seconds": found.seconds,
    }


def _stage(name: str, own: list[CellResult]) -> dict[str, Any]:
    counts = {kind: sum(cell.found == kind for cell in own) for kind in ("same", "within", "beyond", "unknown", "damaged", "failed")}
    return {
        "name": name, "compared": len(own), **counts,
        "largest": max((c.largest for c in own if c.largest is not None), default=None),
        "relative": max((c.relative for c in own if c.relative is not None), default=None),
        "allowed": min((c.allowed for c in own if c.allowed is not None), default=None),
    }  # fmt: skip

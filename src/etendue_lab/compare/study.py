"""Alternatives compared: quality against run time, on the pipeline's own camera.

In:  a pipeline, an axis (`axis.Asked`), how often stages are timed, whether noise counts.
Out: a ``Comparison``: a row for each alternative, best first, and the pictures to look at.

The alternatives are one axis of one run: everything in front of them, its random numbers too, is computed once and the
same for all. The reference (`branches`) is what the same pixels would give without noise and mosaic. Where the axis
reaches the reference too, each value has one of its own, and the rank goes by what can be held side by side: the
finished pictures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from etendue.compute.cell import compute
from etendue.compute.jobs import make_jobs
from etendue.compute.joined.segments import Result
from etendue.contract.capabilities import Viewed, is_source, is_transfer
from etendue.contract.registry import Registry, installed_stages
from etendue.errors import Fault, RequestError
from etendue.pipeline.file import Pipeline
from etendue.pipeline.presets import preset_names
from etendue.plan.model import CellRef, Plan
from etendue.plan.planner import make_plan
from etendue.present.pictures.crops import Plane
from etendue.run.one_thread import ONE_THREAD
from etendue.session import Options, execute
from etendue_camera.colour.matrices import D65_XY, xyz_from_xy
from etendue_lab.compare import edge
from etendue_lab.compare.axis import Asked, candidates, check_axis, check_writes, labels_of, own_value, without_sweep
from etendue_lab.compare.branches import Branched, Place, nodes_of, noise_free, with_reference, writer
from etendue_lab.compare.compared import Reader, Row
from etendue_lab.compare.figures import BORDER, by_its_own_white, colour_figures, display_figures, linear_figures

SENSOR = "sensor"  # the word for presets of a camera


@dataclass
class Comparison:
    """What came of it."""

    pipeline: str
    key: str
    rows: list[Row]
    variable: Place  # where psnr and mtf50 are measured
    reference: Place
    without: str
    noise: str  # 1 frame, or expected values
    size: tuple[int, int]  # pixels along y and x, of the best
    at: dict[str, Any]  # what the file's own sweep would have changed: the values that hold
    notes: list[str]
    first: tuple[str, ...] = ()  # those of ``at`` that are the sweep's first, as the file gives no other
    units: str = ""  # of the axis
    rank_by: str = "psnr"  # the figure that rows are ranked by
    own_reference: bool = False  # whether each value has a reference of its own
    named: bool = False  # whether the values were asked for one by one, not found among what is installed
    pictures: dict[int, Any] = field(default_factory=dict)  # by position: (3, y, x), encoded
    reference_pictures: dict[int, Any] = field(default_factory=dict)
    planes: dict[int, Plane] = field(default_factory=dict)  # where their pixels lie

    @property
    def failed(self) -> bool:
        return any(row.status == "failed" for row in self.rows)

    @property
    def lacking(self) -> bool:
        """Whether a value that was asked for is refused, or all of several but one: what was asked was not compared."""
        refused, left = (sum((row.status == "refused") == which for row in self.rows) for which in (True, False))
        return refused > 0 and (self.named or left < 2)


def compare(
    pipeline: Pipeline,
    asked: Asked,
    repeat: int = 5,
    expected: bool = False,
    options: Options | None = None,
    progress: Any = None,
    edges: bool = True,
    ready: Callable[[], None] | None = None,
) -> Comparison:
    """Run the alternatives and measure them.

    Parameters
    ----------
    pipeline : as read; of a sweep in it the values that the file gives beside it are taken, else the first
    asked : the axis
    repeat : how often each alternative is timed; the fastest counts
    expected : whether noise and rounding are left out (expected values)
    options : how the run is done
    progress : ``plan -> Progress`` for the main run, or None
    edges : whether MTF50 is measured, on a second run in front of an edge
    ready : called once the request is known to be right, before anything is computed

    Raises
    ------
    RequestError
        The pipeline or the axis is wrong. An alternative that cannot serve or breaks off is a row with the reason.
    """
    options, registry = replace(options or Options(), pictures=False), installed_stages()
    asked = check_axis(asked, pipeline)
    base, at = without_sweep(pipeline)
    at.pop(asked.key, None)
    nodes = nodes_of(base, registry)
    if expected:
        base = noise_free(base, nodes, registry)
        nodes = nodes_of(base, registry)
    if asked.stage and asked.stage not in [n.name for n in nodes]:
        what = "expected values take no part of it" if expected else "nothing that is computed depends on it"
        raise RequestError([Fault(f"--axis {asked.key}", f"{asked.stage} has no effect here: {what}")], pipeline.file)
    notes: list[str] = []
    values: Any = asked.values
    if values is None and asked.key == SENSOR:
        values = preset_names()
    elif values is None:
        found, broken = candidates(next(n for n in nodes if n.name == asked.stage), registry)
        values, notes = tuple(found), [f"not looked at: {text}" for text in broken]
        if len(found) == 1:
            notes.append(
                f"no other installed stage writes what {asked.stage} writes and reads no more: etendue stages lists "
                f"them all"
            )
    elif asked.stage:
        check_writes(asked, next(n for n in nodes if n.name == asked.stage), registry)
    first = tuple(key for key in at if own_value(pipeline, key) is None)
    branched = with_reference(base, nodes, asked.key, registry)
    notes += branched.notes
    wanted = _wanted(branched)
    plan, values, refused = _planned(branched, wanted, asked, values, registry)
    plan = _keeping_inputs(plan, asked)
    if ready:
        ready()
    outcome = execute(plan, None, options, progress(plan) if progress else None)
    reader = Reader(plan, outcome, asked, branched)
    texts = (
        reader.axis.values
        if asked.named
        else labels_of(values if isinstance(values, tuple) else reader.axis.values, reader.axis.units)
    )
    measured = [_row(reader, branched, i, str(text), repeat) for i, text in enumerate(texts)]
    if edges and any(row.status == "done" for row in measured):
        whites = (reader.of(("white", writer(nodes, "white")), i) for i in range(reader.count))
        white = max((float(np.max(w)) for w in whites if w is not None), default=0.0)
        found_there = edge.measure(branched, plan, asked, values, white, registry, options)
        for i, row in enumerate(measured):
            if row.status == "done":
                row.mtf50, row.mtf50_reference = found_there.mtf50.get(i), found_there.reference.get(i)
        notes += [found_there.note] if found_there.note else []
    references = {i: reader.at(branched.linear.reference, i) for i in range(reader.count)}
    if all(r is None for r in references.values()):
        broke = next((r.message.strip().rpartition("\n")[2] for r in outcome.failed), "no reference")
        raise RequestError(f"the pipeline itself fails, whatever stands at {asked.key}: {broke}", pipeline.file)
    by = rank_by(measured) if reader.own_reference else "psnr"
    for row in refused if not asked.swaps else ():
        row.label = labels_of([row.value], reader.axis.units)[0]
    rows = ranked([*measured, *refused], by)
    for row in rows:
        decibels = getattr(row, by)
        row.error = None if decibels is None else 10 ** (-decibels / 20)
    known = {
        row.position: references[row.position]
        for row in rows
        if row.position is not None and references[row.position] is not None
    }
    shown = {row.position: row.label if reader.own_reference else "" for row in rows if row.position in known}
    notes += [*_on_the_references(known, shown, branched, asked), *reader.shared_faults()]
    if len(rows) - sum(row.status == "refused" for row in rows) == 1:
        notes.insert(
            0,
            f"there is nothing to hold it against: "
            f"{'the others are refused' if len(rows) > 1 else 'it is the only one'}",
        )
    pictures = reader.pictures(branched, measured)
    return Comparison(
        pipeline.name,
        asked.key,
        rows,
        branched.linear.ours,
        branched.linear.reference,
        branched.without,
        "expected values, without noise and rounding"
        if expected
        else "1 frame, the same draws for all where they stand behind the noise",
        tuple(next(iter(known.values())).shape[-2:]),
        at,
        notes,
        first,
        reader.axis.units,
        by,
        reader.own_reference,
        asked.values is not None,
        *pictures,
        reader.planes(branched, pictures[0]),
    )


def rank_by(rows: Iterable[Row]) -> str:
    """What rows are ranked by whose references differ: a dark picture has little to lose on a linear scale that all
    share.
    """
    return "psnr_encoded" if all(row.psnr_encoded is not None for row in rows if row.psnr is not None) else "psnr_white"


def ranked(rows: list[Row], by: str = "psnr") -> list[Row]:
    """Best first; those without a figure last. Marks the rows that no other is both better and faster than."""

    def order(row: Row) -> tuple[bool, float, float, str]:
        found = getattr(row, by)
        return (found is None, -(found or 0.0), row.seconds or 0.0, row.label)

    ordered = sorted(rows, key=order)
    fastest = math.inf
    for row in ordered:
        time = row.seconds_per_mpixel
        row.pareto = getattr(row, by) is not None and time is not None and time < fastest
        fastest = time if row.pareto and time is not None else fastest
    return ordered


def _wanted(branched: Branched) -> tuple[str, ...]:
    """What is measured, and what the colours are seen by."""
    places = [*branched.places()]
    for variable in ("white_xyz", "white"):
        node = writer(branched.nodes, variable)
        if node is not None:
            places.append((node.name, variable))
    return tuple(dict.fromkeys(f"{stage}.{variable}" for stage, variable in places))


def _keeping_inputs(plan: Plan, asked: Asked) -> Plan:
    """What the compared stage reads stays in memory, so that the stage can be run again."""
    node = next((n for n in plan.nodes if n.name == asked.stage), None)
    if node is None or node.is_transfer:
        return plan
    return replace(
        plan, kept=plan.kept | {(source, variable) for bound in node.inputs for _, source, variable in bound}
    )


def _planned(
    branched: Branched, wanted: tuple[str, ...], asked: Asked, values: Any, registry: Registry
) -> tuple[Plan, Any, list[Row]]:
    """The plan of all alternatives that can serve, and rows of those that cannot."""
    pipeline = replace(branched.pipeline, wanted=wanted, keep=wanted)

    def plan_of(chosen: Any) -> Plan:
        return make_plan(replace(pipeline, sweep=branched.axes(asked.key, chosen)), registry, False)

    try:
        return plan_of(values), values, []
    except RequestError as whole:
        if not isinstance(values, tuple) or _asked_wrongly(whole, asked):
            raise _as_asked(whole, asked) from None
        good, refused, last = [], [], whole
        for value in values:
            try:
                plan_of((value,))
                good.append(value)
            except RequestError as error:
                last = error
                refused.append(
                    _refused(value, asked, registry, "; ".join(dict.fromkeys(f.message for f in error.faults)))
                )
        if not good:
            raise _as_asked(last, asked) from None
        return plan_of(tuple(good)), tuple(good), refused


def _asked_wrongly(error: RequestError, asked: Asked) -> bool:
    """Whether somebody wrote a word that does not exist, or a value that does not fit: not the stage's affair."""
    return asked.values is not None and any(fault.place.startswith(f"sweep.{asked.key}") for fault in error.faults)


def _as_asked(error: RequestError, asked: Asked) -> RequestError:
    """The same faults, at the place where the axis was written."""
    key = f"sweep.{asked.key}"
    own = f"--axis {asked.key}"
    wrong = [f for f in error.faults if f.place.startswith(key)]
    faults = [replace(f, place=f.place.replace(key, own, 1), line=None) for f in wrong] or list(error.faults)
    return RequestError(faults, "" if all(f.place.startswith("--axis") for f in faults) else error.file)


def _refused(value: Any, asked: Asked, registry: Registry, reason: str) -> Row:
    table = value if isinstance(value, dict) else {"use": value}
    use = str(table.get("use", "")) if asked.swaps else ""
    row = Row(
        use or value, str(table.get("label", use)) if asked.swaps else str(value), use, status="refused", reason=reason
    )
    if use in registry:
        row.distribution, row.version = registry.installed(use).distribution, registry.installed(use).version
    return row


def _row(reader: Reader, branched: Branched, position: int, label: str, repeat: int) -> Row:
    value, one = reader.axis.values[position], reader.alternative(position)
    row = Row(value, label, position=position)
    if one is not None:
        row.use, row.distribution, row.version = one.use, one.distribution, one.version
        row.value = one.use if reader.asked.swaps else value
    picture, reference = reader.at(branched.linear.ours, position), reader.at(branched.linear.reference, position)
    if picture is None or reference is None:
        row.status, row.reason = "failed", reader.why(position)
        return row
    if picture.shape != reference.shape:
        row.status, row.reason = (
            "refused",
            f"it gives {picture.shape}, but the reference has {reference.shape} (channel, y, x)",
        )
        return row
    found = linear_figures(picture, reference)
    if reader.own_reference:
        found["psnr_white"] = by_its_own_white(picture, reference)
    for pair in (branched.display, branched.colour):
        ours, theirs = (reader.at(pair.ours, position), reader.at(pair.reference, position)) if pair else (None, None)
        if ours is None or theirs is None:
            row.reason = row.reason or reader.why(position)
        elif pair is branched.display:
            found |= display_figures(ours, theirs)
        else:
            found |= colour_figures(ours, theirs, _viewing_white(reader, branched, position))
    for name, number in found.items():
        setattr(row, name, number)
    if row.reason:
        row.status = "failed"
    if reader.asked.stage:
        row.seconds = seconds_of(reader, position, repeat)
        pixels = math.prod(picture.shape[-2:])
        row.mpixel_per_second = 1e-6 * pixels / row.seconds if row.seconds else None
        row.seconds_per_mpixel = 1e6 * row.seconds / pixels if row.seconds else None
    return row


def _viewing_white(reader: Reader, branched: Branched, position: int) -> Any:
    """White of the eye that looks at the tristimulus values: of the balance's target, else that of the scene."""
    assert branched.colour is not None
    name = branched.colour.ours[0]
    stage = reader.plan.cells[reader.ref(name, position)].stage
    white = stage.viewing_white() if isinstance(stage, Viewed) else None
    if white is None:
        white = reader.of(("white_xyz", writer(branched.nodes, "white_xyz")), position)
    return np.asarray(xyz_from_xy(D65_XY) if white is None else white, dtype=np.float64)


def seconds_of(reader: Reader, position: int, repeat: int) -> float | None:
    """Thread time of the compared stage alone: the fastest of several runs on what it was given."""
    ref = reader.ref(reader.asked.stage, position)
    report, cell = reader.outcome.reports.get(ref), reader.plan.cells[ref]
    best = report.seconds if report is not None and report.status == "done" else math.inf
    inputs: dict[CellRef, Result] = {}
    if not is_transfer(type(cell.stage)) and not is_source(type(cell.stage)):
        job = make_jobs(reader.plan, {ref}, lambda cell: None)[ref]
        for _, source, variable in job.inputs:
            array = reader.outcome.arrays.get(source, {}).get(variable)
            if array is None:
                break
            inputs.setdefault(source, Result()).arrays[variable] = array
        else:
            if all(needed in inputs for needed in job.needs):
                with ONE_THREAD:
                    again = [compute(job, inputs)[1] for _ in range(repeat)]
                best = min([best, *(r.seconds for r in again if r.status == "done")])
    return best if math.isfinite(best) else None


def _on_the_references(
    references: dict[int, Any], labels: dict[int, str], branched: Branched, asked: Asked
) -> list[str]:
    """What a reader of the table should know about the pictures it was measured on."""
    notes, variable = [], branched.linear.reference[1]
    over = {i: float((r > 1).any(axis=0).mean()) if variable == "rgb_camera" else 0.0 for i, r in references.items()}
    worst = max(over, key=lambda i: over[i])
    if over[worst] > 1e-3:
        where = f" at {labels[worst]}" if labels[worst] else ""
        share = f"{100 * over[worst]:.2g} % of the pixels{where}"
        notes.append(f"{share} are beyond clipping, which no alternative restores: lower the exposure to see more")
    sizes = {r.shape[-2:] for r in references.values()}
    if min(min(size) for size in sizes) <= 4 * BORDER:
        notes.append(f"the picture is too small to drop a border of {BORDER} pixels")
    if len(sizes) > 1:
        sized = ", ".join(f"{x} x {y}" for y, x in sorted(sizes))
        notes.append(f"the pictures have sizes of their own ({sized} pixels): what they show differs too")
    if variable == "rgb_display" and any(labels.values()):
        notes.append(
            f"each {asked.key} gives the same light other numbers: PSNR holds each against a reference in its own "
            f"numbers"
        )
    return notes

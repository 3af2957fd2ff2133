"""Comparison of alternatives: quality against run time, on the pipeline's own camera.

In:  a pipeline, an axis (`axis.AxisRequest`), the number of timing runs, whether noise is included.
Out: a ``Comparison``: a row for each alternative, best first, and the pictures to show.

The alternatives are one axis of one run: everything before them, including its random numbers, is computed once and
shared. The reference (`branches`) is the picture that the same pixels would give without noise and mosaic. If the axis
also affects the reference, each value has its own reference, and the ranking compares the encoded pictures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.compute.cell import compute
from etendue.compute.jobs import make_jobs
from etendue.compute.joined.segments import Result
from etendue.contract.capabilities import Viewed, is_source, is_transfer
from etendue.contract.registry import Registry, installed_stages
from etendue.errors import RequestError
from etendue.pipeline.file import PipelineFile
from etendue.plan.model import CellRef, StageVariable
from etendue.present.pictures.crops import Plane
from etendue.run.one_thread import ONE_THREAD
from etendue.session import Options, execute
from etendue.types.arrays import Array
from etendue.types.documents import AxisValue
from etendue_camera.colour.matrices import D65_XY, xyz_from_xy
from etendue_lab.compare import edge
from etendue_lab.compare.alternatives import camera_of, keeping_inputs, planned, values_of, wanted_of
from etendue_lab.compare.axis import (
    AxisRequest,
    check_axis,
    labels_of,
    own_value,
    without_sweep,
)
from etendue_lab.compare.branches import Branched, with_reference, writer
from etendue_lab.compare.compared import ComparedRow, Reader
from etendue_lab.compare.figures import BORDER, colour_figures, display_figures, linear_figures

if TYPE_CHECKING:
    from etendue.contract.ports import Progress
    from etendue.plan.model import Plan


@dataclass
class Comparison:
    """The result of a comparison."""

    pipeline: str
    key: str
    rows: list[ComparedRow]
    variable: StageVariable  # where psnr and mtf50 are measured
    reference: StageVariable
    without: str
    noise: str  # 1 frame, or expected values
    size: tuple[int, int]  # pixels along y and x, of the best alternative
    at: dict[str, AxisValue]  # values used in place of the file's own sweep
    notes: list[str]
    first: tuple[str, ...] = ()  # keys of ``at`` that have the sweep's first value: the file gives no other
    units: str = ""  # of the axis
    rank_by: str = "psnr"  # metric that ranks the rows
    own_reference: bool = False  # whether each value has its own reference
    named: bool = False  # whether the request names the values; otherwise they are all installed alternatives
    pictures: dict[int, Array] = field(default_factory=dict)  # by position: (3, y, x), encoded
    reference_pictures: dict[int, Array] = field(default_factory=dict)
    planes: dict[int, Plane] = field(default_factory=dict)  # positions of the pixels of these pictures

    @property
    def failed(self) -> bool:
        return any(row.status == "failed" for row in self.rows)

    @property
    def lacking(self) -> bool:
        """Whether a requested value, or all alternatives but one, were refused, so that the requested comparison is
        incomplete.
        """
        refused, left = (sum((row.status == "refused") == which for row in self.rows) for which in (True, False))
        return refused > 0 and (self.named or left < 2)


def compare(
    pipeline: PipelineFile,
    asked: AxisRequest,
    repeat: int = 5,
    expected: bool = False,
    options: Options | None = None,
    progress: Callable[[Plan], Progress] | None = None,
    edges: bool = True,
    ready: Callable[[], None] | None = None,
) -> Comparison:
    """Run the alternatives and measure them.

    Parameters
    ----------
    pipeline : as read; a sweep is replaced by the values that the file gives outside it, otherwise by its first values
    asked : the requested axis
    repeat : number of timing runs of each alternative; the fastest is kept
    expected : whether noise and rounding are left out (expected values)
    options : scheduler, workers and other run options
    progress : ``plan -> Progress`` for the main run, or None
    edges : whether MTF50 is measured, in a second run with a slanted edge
    ready : called once the request is known to be valid, before anything is computed

    Raises
    ------
    RequestError
        The pipeline or the axis is invalid. An alternative that is incompatible or fails is a row with the reason.
    """
    options, registry = replace(options or Options(), pictures=False), installed_stages()
    asked = check_axis(asked, pipeline)
    base, at = without_sweep(pipeline)
    at.pop(asked.key, None)
    base, nodes = camera_of(base, asked, expected, registry)
    values, notes = values_of(asked, nodes, registry)
    first = tuple(key for key in at if own_value(pipeline, key) is None)
    branched = with_reference(base, nodes, asked.key, registry)
    notes += branched.notes
    wanted = wanted_of(branched)
    plan, values, refused = planned(branched, wanted, asked, values, registry)
    plan = keeping_inputs(plan, asked)
    if ready:
        ready()
    outcome = execute(plan, None, options, progress(plan) if progress else None)
    reader = Reader(plan, outcome, asked, branched)
    own = values if isinstance(values, tuple) else reader.axis.values
    texts = reader.axis.values if asked.named else labels_of(own, reader.axis.units)
    measured = [_row(reader, branched, i, str(text), repeat) for i, text in enumerate(texts)]
    if edges:
        notes += _with_edges(measured, reader, branched, values, registry, options)
    references = _references(reader, branched, pipeline.file)
    by = rank_by(measured) if reader.own_reference else "psnr"
    for row in refused if not asked.swaps else ():
        row.label = labels_of([row.value], reader.axis.units)[0]
    rows = ranked([*measured, *refused], by)
    there = [row.position for row in rows if row.position is not None]
    known = {position: references[position] for position in there if references[position] is not None}
    if sum(row.status != "refused" for row in rows) == 1:
        why = ("it is the only alternative", "the other alternatives are refused")[len(rows) > 1]
        notes = [f"nothing to compare with: {why}", *notes]
    notes += _on_the_references(known, rows, reader, branched) + reader.shared_faults()
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
        else "1 frame; alternatives after the noise share the same draws",
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


def _with_edges(
    measured: list[ComparedRow], reader: Reader, branched: Branched, values: Any, registry: Registry, options: Options
) -> list[str]:
    """Add MTF50 from a second run to the finished rows; return a note if there is none."""
    done = {i: row for i, row in enumerate(measured) if row.status == "done"}
    if not done:
        return []
    whites = (reader.of(("white", writer(branched.nodes, "white")), i) for i in range(reader.count))
    white = max((float(np.max(w)) for w in whites if w is not None), default=0.0)
    found = edge.measure(branched, reader.plan, reader.asked, values, white, registry, options)
    for i, row in done.items():
        row.mtf50, row.mtf50_reference = found.mtf50.get(i), found.reference.get(i)
    return [found.note] if found.note else []


def _references(reader: Reader, branched: Branched, file: str) -> dict[int, Array]:
    """Return the reference of each value; None where it was not computed.

    Raises
    ------
    RequestError
        None was computed.
    """
    found = {i: reader.at(branched.linear.reference, i) for i in range(reader.count)}
    if all(r is None for r in found.values()):
        broke = next((r.message.strip().rpartition("\n")[2] for r in reader.outcome.failed), "no reference")
        raise RequestError(f"the pipeline fails for every value of {reader.asked.key}: {broke}", file)
    return found


def rank_by(rows: Iterable[ComparedRow]) -> str:
    """Return the metric that ranks rows whose references differ: PSNR of the encoded picture if all rows have it, else
    `psnr_white`. On a common linear scale a darker picture would have smaller errors.
    """
    return "psnr_encoded" if all(row.psnr_encoded is not None for row in rows if row.psnr is not None) else "psnr_white"


def ranked(rows: list[ComparedRow], by: str = "psnr") -> list[ComparedRow]:
    """Sort rows, best first; rows without the metric come last. Set the error of each row, and mark the rows on the
    Pareto front of quality and speed.
    """

    def order(row: ComparedRow) -> tuple[bool, float, float, str]:
        found = getattr(row, by)
        return (found is None, -(found or 0.0), row.seconds or 0.0, row.label)

    ordered = sorted(rows, key=order)
    fastest = math.inf
    for row in ordered:
        decibels = getattr(row, by)
        row.error = None if decibels is None else 10 ** (-decibels / 20)
        time = row.seconds_per_mpixel
        row.pareto = getattr(row, by) is not None and time is not None and time < fastest
        fastest = time if row.pareto and time is not None else fastest
    return ordered


def _row(reader: Reader, branched: Branched, position: int, label: str, repeat: int) -> ComparedRow:
    value, one = reader.axis.values[position], reader.alternative(position)
    row = ComparedRow(value, label, position=position)
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
            f"its shape is {picture.shape}, but the reference has {reference.shape} (channel, y, x)",
        )
        return row
    found = linear_figures(picture, reference, reader.own_reference)
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


def _viewing_white(reader: Reader, branched: Branched, position: int) -> Array:
    """Return the white to which the viewer's eye is adapted: the target of the white balance, else the white of the
    scene.
    """
    assert branched.colour is not None
    name = branched.colour.ours[0]
    stage = reader.plan.cells[reader.ref(name, position)].stage
    white = stage.viewing_white() if isinstance(stage, Viewed) else None
    if white is None:
        white = reader.of(("white_xyz", writer(branched.nodes, "white_xyz")), position)
    return np.asarray(xyz_from_xy(D65_XY) if white is None else white, dtype=np.float64)


def seconds_of(reader: Reader, position: int, repeat: int) -> float | None:
    """Return the CPU time of the compared stage alone: the fastest of several runs on the same inputs."""
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
    references: dict[int, Array], rows: list[ComparedRow], reader: Reader, branched: Branched
) -> list[str]:
    """Return notes on pictures that are clipped, too small, or cannot be compared directly."""
    labels = {row.position: row.label if reader.own_reference else "" for row in rows if row.position in references}
    notes, variable = [], branched.linear.reference[1]
    over = {i: float((r > 1).any(axis=0).mean()) if variable == "rgb_camera" else 0.0 for i, r in references.items()}
    worst = max(over, key=lambda i: over[i])
    if over[worst] > 1e-3:
        where = f" at {labels[worst]}" if labels[worst] else ""
        share = f"{100 * over[worst]:.2g} % of the pixels{where}"
        notes.append(
            f"{share} are clipped, which no alternative restores: use a shorter exposure to compare highlights"
        )
    sizes = {r.shape[-2:] for r in references.values()}
    if min(min(size) for size in sizes) <= 4 * BORDER:
        notes.append(f"the picture is too small to drop a border of {BORDER} pixels")
    if len(sizes) > 1:
        sized = ", ".join(f"{x} x {y}" for y, x in sorted(sizes))
        notes.append(f"the pictures differ in size ({sized} pixels) and therefore in content")
    if variable == "rgb_display" and any(labels.values()):
        notes.append(
            f"each {reader.asked.key} encodes the same light differently: PSNR compares each picture with a "
            "reference in its own encoding"
        )
    return notes

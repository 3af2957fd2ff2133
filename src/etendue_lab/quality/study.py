"""``etendue quality``: every cell of a camera's sweep compared with the ideal camera of the same scene.

In:  a pipeline as written, the viewing condition.
Out: one row of metrics for each cell; as JSON, CSV, and side-by-side pictures.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from etendue.contract.ports import Progress
from etendue.contract.registry import Registry
from etendue.errors import RequestError
from etendue.pipeline.derived import wanting
from etendue.pipeline.file import PipelineFile
from etendue.plan.designs.drawing import with_design
from etendue.plan.model import Plan
from etendue.plan.planner import make_plan
from etendue.present.terminal.tables import floored
from etendue.result_files import check_folder, finite, write_whole
from etendue.session import Options, Outcome, execute
from etendue.types.documents import AxisValues, Document
from etendue_camera.colour.matrices import RGB_TO_XYZ_SRGB
from etendue_camera.roles import Displaying
from etendue_lab.quality.figures import FLAT_SIZES, UNITS, Shot, figures
from etendue_lab.quality.ideal import Ideal, ideal_of

PICTURES = ("rgb_camera", "rgb_linear", "rgb_display")
# included if the pipeline has them
SCALARS = {"mean_snr": "1", "clipped_fraction": "1", "dr_emva": "dB", "dr_elgamal": "dB"}
# the camera applies these to rgb_camera; the ideal camera does not, or does so differently
APPLIED = ("balance_gains", "integration_time")
SAMPLES_PER_DEGREE = 34.0  # a display of 100 dpi at 50 cm
MOST = 12  # default maximum number of pictures
Show = Callable[[int, AxisValues, Shot, Shot, Any], tuple[str, bytes]]


@dataclass
class IdealComparison:
    """A camera compared with the ideal camera: a row for each cell, and the compared pictures."""

    pipeline: str
    ideal: Ideal
    samples_per_degree: float
    axes: dict[str, str]  # key -> unit
    rows: list[Document] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    pictures: dict[str, bytes] = field(default_factory=dict)  # PNG by file name

    @property
    def failed(self) -> int:
        return sum(row["status"] != "done" for row in self.rows)

    def document(self) -> Document:
        """Return the comparison as JSON. Unknown metrics are NaN in the rows; they become null in files."""
        return {
            "pipeline": self.pipeline,
            "ideal": {"left_out": list(self.ideal.left_out), "replaced": dict(self.ideal.replaced)},
            "samples_per_degree": self.samples_per_degree,
            "axes": [{"name": key, "units": unit or None} for key, unit in self.axes.items()],
            "figures": {**UNITS, **SCALARS},
            "rows": self.rows,
            "notes": self.notes,
            "files": self.files,
        }


def quality(
    pipeline: PipelineFile,
    registry: Registry,
    samples_per_degree: float = SAMPLES_PER_DEGREE,
    without: Collection[str] = (),
    keep: Collection[str] = (),
    leave_out: bool = True,
    options: Options | None = None,
    progress: Callable[[Plan], Progress] | None = None,
    show: Show | None = None,
    folder: Path | None = None,
    most: int = MOST,
) -> IdealComparison:
    """Run a camera and the ideal camera, and measure their differences.

    Parameters
    ----------
    pipeline : Pipeline
        Its sweep is the sweep of the comparison; ``wanted`` and ``keep`` of the file are ignored.
    registry : Registry
    samples_per_degree : float, greater than 0
        Pixels per degree of visual angle, for S-CIELAB and visible noise.
    without, keep : names of stages
        See `ideal_of`.
    leave_out : bool
        Whether stages may be left out where their effect on the scene is within the tolerance of the pipeline.
    progress : callable
        Returns the progress display of a plan; called for the camera and then for the ideal camera.
    show : callable
        Called for each chosen row with its number, the axis values, the two pictures, the map of differences.
        Returns the name of a PNG and its bytes.
    folder : Path
        Where the result will be written; it is created before anything is computed.
    most : int
        Maximum number of rows with pictures. They are spread evenly over the available rows; a note gives the number of
        the others.

    Raises
    ------
    RequestError
        The pipeline is invalid, there is nothing to compare, or the folder is not writable.
    """
    if not 0 < samples_per_degree < math.inf:
        raise RequestError(f"--samples-per-degree {samples_per_degree:g}: must be greater than 0")
    make_plan(pipeline, registry, leave_out)  # the planner reports every fault of the file
    if both := sorted(set(without) & set(keep)):
        raise RequestError(f"--without {both[0]} and --keep {both[0]}: give only one of them")
    pipeline = replace(with_design(pipeline, registry), design={})  # keep its samples, also with fewer stages
    ideal = ideal_of(pipeline, registry, without, keep)
    camera_plan = _plan_of(pipeline, registry, leave_out, (*PICTURES, *SCALARS))
    plans = camera_plan, _plan_of(ideal.pipeline, registry, leave_out, PICTURES)
    if folder is not None:
        check_folder(folder)
    camera, perfect = (execute(plan, None, options, progress(plan) if progress else None) for plan in plans)
    axes = {axis.key: axis.units for axis in camera_plan.axes}
    notes = list(dict.fromkeys([*camera_plan.warnings, *ideal.notes]))
    result = IdealComparison(pipeline.name, ideal, float(samples_per_degree), axes, notes=notes)
    drawable = 0
    places = list(_places(camera_plan))
    whys = [_why_not(camera, place) or _why_not(perfect, place) for place in places]
    chosen = evenly([number for number, why in enumerate(whys) if not why], most)
    for number, (place, why) in enumerate(zip(places, whys, strict=True)):
        at = {axis.key: axis.values[place[axis.dim]] for axis in camera_plan.axes}
        row: Document = {
            **at,
            "status": "done",
            "reason": "",
            **dict.fromkeys((*UNITS, *SCALARS), math.nan),
            "flat": None,
        }
        result.rows.append(row)
        if why:
            row |= {"status": "failed", "reason": why}
            continue
        shot, reference = _shot(camera, place), _shot(perfect, place)
        shown = _measured(row, shot, reference, samples_per_degree)
        if row["status"] != "done":
            continue
        row |= _scalars(camera, place)
        drawable += shown is not None
        if show is not None and shown is not None and number in chosen:
            result.pictures |= dict([show(number, at, shot, reference, shown)])
    result.notes += [*_notes(result, camera_plan, registry), *floored(camera_plan, camera.reports)]
    if show is not None and len(result.pictures) < drawable:
        result.notes.append(
            f"drew {len(result.pictures)} of {drawable} pictures, spread evenly over the sweep; --pictures "
            f"{drawable} draws all"
        )
    return result


def _measured(row: Document, shot: Shot, reference: Shot, samples_per_degree: float) -> Any:
    """Add metrics to a row, or the reason why there are none; return the map of differences, if any."""
    try:
        found, shown, flat = figures(shot, reference, samples_per_degree)
    except ValueError as error:
        row |= {"status": "failed", "reason": str(error)}
        return None
    row |= {**found, "flat": flat._asdict() if flat else None}
    return shown


def evenly(rows: list[int], most: int) -> set[int]:
    """Return at most ``most`` rows, evenly spaced, with the first and the last row if ``most`` is at least 2."""
    count = min(most, len(rows))
    return {rows[round(i * (len(rows) - 1) / max(1, count - 1))] for i in range(count)}


def write(result: IdealComparison, folder: Path) -> None:
    """Write ``quality.csv``, ``quality.json`` and the pictures to a folder, each completely or not at all; remove
    pictures of an earlier comparison.
    """
    keys = [*result.axes, *UNITS, *SCALARS, "status", "reason"]
    units = {**result.axes, **UNITS, **SCALARS}
    lines = [",".join(_quoted(f"{key} [{units[key]}]" if units.get(key) else key) for key in keys)]
    lines += [",".join(_quoted(_cell(row[key])) for key in keys) for row in result.rows]
    names = [*result.pictures, "quality.json", "quality.csv"]
    result.files = [str(folder / name) for name in names]
    table, document = "\n".join(lines) + "\n", json.dumps(finite(result.document()), indent=1, allow_nan=False) + "\n"
    write_whole(folder, result.pictures | {"quality.json": document.encode(), "quality.csv": table.encode()})
    for old in folder.glob("quality_[0-9][0-9][0-9]*.png"):
        if old.name not in names and old.stem.removeprefix("quality_").isdigit():
            old.unlink()


# -- running ------------------------------------------------------------------------------------------------------


def _plan_of(pipeline: PipelineFile, registry: Registry, leave_out: bool, variables: Collection[str]) -> Plan:
    """Return the plan of the compared variables; nothing else is kept."""
    whole = make_plan(replace(wanting(pipeline), faults=()), registry, leave_out)
    places = [(writer, variable) for variable in variables if (writer := _writer(whole, variable))]
    places += [(name, variable) for variable in APPLIED for name in _behind(whole, "rgb_camera", variable)]
    return make_plan(wanting(pipeline, places, kept=True), registry, leave_out)


def _writer(plan: Plan, variable: str) -> str | None:
    return next((node.name for node in reversed(plan.nodes) if variable in node.writes), None)


def _behind(plan: Plan, picture: str, variable: str) -> list[str]:
    """Return the stages that write ``variable`` and on which ``picture`` depends."""
    found, last = set(), _writer(plan, picture)
    open_ = {last} if last else set()
    while open_:
        found |= open_
        open_ = {source for name in open_ for bound in plan.node(name).inputs for _, source, _ in bound} - found
    return [node.name for node in plan.nodes if node.name in found and variable in node.writes]


def _places(plan: Plan) -> Iterator[dict[str, int]]:
    """Yield every combination of positions on the axes; the position on the last axis varies fastest."""
    dims = [axis.dim for axis in plan.axes]
    for index in product(*(range(len(axis.values)) for axis in plan.axes)):
        yield dict(zip(dims, index, strict=True))


def _ref(outcome: Outcome, name: str, place: Mapping[str, int]) -> Any:
    at = outcome.plan.everywhere(place)
    return name, tuple(at[dim] for dim in outcome.plan.node(name).axes)


def _why_not(outcome: Outcome, place: Mapping[str, int]) -> str:
    """Return the reason why a cell has no pictures; '' if it has pictures."""
    lacking = [v for v in PICTURES if _writer(outcome.plan, v) and _array(outcome, place, v) is None]
    if not lacking:
        return ""
    reports = (outcome.reports.get(_ref(outcome, node.name, place)) for node in outcome.plan.nodes)
    failed = [
        f"{report.stage}: {report.message}" for report in reports if report is not None and report.status == "failed"
    ]
    return failed[0] if failed else f"{lacking[0]} was not computed"


def _array(outcome: Outcome, place: Mapping[str, int], variable: str) -> Any:
    name = _writer(outcome.plan, variable)
    return None if name is None else outcome.arrays.get(_ref(outcome, name, place), {}).get(variable)


def _scalars(outcome: Outcome, place: Mapping[str, int]) -> dict[str, float]:
    found = {name: _array(outcome, place, name) for name in SCALARS}
    return {name: math.nan if own is None else float(own) for name, own in found.items()}


def _shot(outcome: Outcome, place: Mapping[str, int]) -> Shot:
    pictures = {variable: _array(outcome, place, variable) for variable in PICTURES}
    gains, times = (
        [
            outcome.arrays.get(_ref(outcome, name, place), {}).get(variable)
            for name in _behind(outcome.plan, "rgb_camera", variable)
        ]
        for variable in APPLIED
    )
    # of the first frame
    known = [np.reshape(np.asarray(one, np.float64), (-1, np.shape(one)[-1]))[0] for one in gains if one is not None]
    time = next((float(one) for one in reversed(times) if one is not None and np.ndim(one) == 0), None)
    return Shot(
        **pictures,
        gains=np.prod(known, axis=0) if known else None,
        time=time,
        to_xyz=_display_matrix(outcome.plan, place),
    )


def _display_matrix(plan: Plan, place: Mapping[str, int]) -> Any:
    """Return the matrix from linear RGB to XYZ of the display for which the picture is made; the sRGB matrix if no
    stage declares a display.
    """
    if _writer(plan, "rgb_linear") is None:
        return None
    writers = [node for node in reversed(plan.nodes) if "rgb_linear" in node.writes]
    at = plan.everywhere(place)
    stages = (plan.cells[node.name, tuple(at[dim] for dim in node.axes)].stage for node in writers)
    return next(
        (stage.to_xyz() for stage in stages if isinstance(stage, Displaying)), RGB_TO_XYZ_SRGB
    )  # some stages only decode


def _notes(result: IdealComparison, plan: Plan, registry: Registry) -> list[str]:
    notes = []
    done, flats = len(result.rows) - result.failed, sum(row["flat"] is not None for row in result.rows)
    if done and _writer(plan, "rgb_linear") is None:
        notes.append("no stage writes rgb_linear, so there are no colour metrics: put 'display' after the demosaicer")
    elif flats < done:
        notes.append(
            f"{done - flats} of {done} pictures have no uniform region of {FLAT_SIZES[-1]} x {FLAT_SIZES[-1]} pixels: "
            "SNR flat and visible noise are unknown"
        )
    for variable in ("mean_snr", "dr_emva"):
        if done and _writer(plan, variable) is None:
            stage = next(registry.makers(variable), "")
            notes.append(
                f"{variable} is unknown: the pipeline has no stage {stage!r}" if stage else f"{variable} is unknown"
            )
    return notes


# -- files --------------------------------------------------------------------------------------------------------


def _cell(value: Any) -> str:
    if isinstance(value, float) and math.isnan(value):
        return ""
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"\n') else text

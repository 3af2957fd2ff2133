"""``etendue quality``: every cell of a camera's sweep against the ideal camera of the same scene.

In:  a pipeline as written, how far away the picture is looked at.
Out: one row of figures for each cell; as JSON, CSV, and pictures side by side.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from etendue import spectra
from etendue.errors import RequestError
from etendue.physics import colour
from etendue.plan.model import Plan
from etendue.plan.planner import make_plan
from etendue.registry import Registry
from etendue.session import Options, Outcome, execute
from etendue.spec.pipeline import Pipeline
from etendue.spec.ports import Progress
from etendue.studies.ideal import Ideal, ideal_of
from etendue.studies.quality_figures import FLAT_SIZES, UNITS, Shot, figures

PICTURES = ("rgb_camera", "rgb_linear", "rgb_display")
SCALARS = {"mean_snr": "1", "clipped_fraction": "1", "dr_emva": "dB", "dr_elgamal": "dB"}  # taken where the pipeline has them
DISPLAY_EDGES = tuple(float(w) for w in range(380, 785, 5))
SAMPLES_PER_DEGREE = 34.0  # a display of 100 dpi at 50 cm
Show = Callable[[tuple[int, int], Mapping[str, Any], Shot, Shot, Any], Path | None]


@dataclass
class Comparison:
    """A camera against its ideal: a row for each cell, and what was compared."""

    pipeline: str
    ideal: Ideal
    samples_per_degree: float
    axes: dict[str, str]  # key -> unit
    rows: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)

    @property
    def failed(self) -> int:
        return sum(row["status"] != "done" for row in self.rows)

    def document(self) -> dict[str, Any]:
        """As JSON holds it. Unknown figures are NaN here and null there."""
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
    pipeline: Pipeline,
    registry: Registry,
    samples_per_degree: float = SAMPLES_PER_DEGREE,
    without: Collection[str] = (),
    keep: Collection[str] = (),
    leave_out: bool = True,
    options: Options | None = None,
    progress: Callable[[Plan], Progress] | None = None,
    show: Show | None = None,
) -> Comparison:
    """Run a camera and its ideal, and measure how they differ.

    Parameters
    ----------
    pipeline : Pipeline
        Its sweep is the sweep of the comparison; ``wanted`` and ``keep`` of the file do not matter.
    registry : Registry
    samples_per_degree : float, above 0
        Pixels per degree of visual angle, for S-CIELAB and visible noise.
    without, keep : names of stages
        See `ideal_of`.
    leave_out : bool
        Whether what the scene does not need may be left out, within the pipeline's tolerance.
    progress : callable
        Makes the progress of a plan; the camera's and the ideal one's run one after the other.
    show : callable
        Given for each finished row: its number and the number of rows, the axis values, the two pictures, the map of differences.
        What it returns is the path of a file, or nothing.

    Raises
    ------
    RequestError
        Faults of the pipeline, or nothing to compare.
    """
    if not 0 < samples_per_degree < math.inf:
        raise RequestError(f"--samples-per-degree {samples_per_degree:g}: expected a number above 0")
    make_plan(pipeline, registry, leave_out)  # with every fault of the file, in its own words
    ideal = ideal_of(pipeline, registry, without, keep)
    camera_plan = _plan_of(pipeline, registry, leave_out, (*PICTURES, *SCALARS))
    ideal_plan = _plan_of(ideal.pipeline, registry, leave_out, PICTURES)
    camera, perfect = (execute(plan, None, options, progress(plan) if progress else None) for plan in (camera_plan, ideal_plan))
    axes = {axis.key: axis.units for axis in camera_plan.axes}
    result = Comparison(pipeline.name, ideal, float(samples_per_degree), axes, notes=list(ideal.notes))
    flats = 0
    places = list(_places(camera_plan))
    for number, place in enumerate(places):
        row: dict[str, Any] = {a.key: a.values[place[a.dim]] for a in camera_plan.axes}
        row |= {"status": "done", "reason": ""} | dict.fromkeys((*UNITS, *SCALARS), math.nan) | {"flat": None}
        result.rows.append(row)
        why = _why_not(camera, place) or _why_not(perfect, place)
        if why:
            row |= {"status": "failed", "reason": why}
            continue
        shot, reference = _shot(camera, place), _shot(perfect, place)
        try:
            found, shown, flat = figures(shot, reference, samples_per_degree)
        except ValueError as error:
            row |= {"status": "failed", "reason": str(error)}
            continue
        row |= found | {name: _scalar(camera, place, name) for name in SCALARS}
        row["flat"] = flat._asdict() if flat else None
        flats += flat is not None
        if show is not None and (path := show((number, len(places)), {key: row[key] for key in axes}, shot, reference, shown)):
            result.files.append(str(path))
    result.notes += _notes(result, camera_plan, flats)
    return result


def write(result: Comparison, folder: Path) -> None:
    """``quality.json`` and ``quality.csv`` in a folder, each whole or not at all; older ones are replaced."""
    folder.mkdir(parents=True, exist_ok=True)
    keys = [*result.axes, *UNITS, *SCALARS, "status", "reason"]
    units = {**result.axes, **UNITS, **SCALARS}
    lines = [",".join(_quoted(f"{key} [{units[key]}]" if units.get(key) else key) for key in keys)]
    lines += [",".join(_quoted(_cell(row[key])) for key in keys) for row in result.rows]
    result.files += [str(folder / "quality.json"), str(folder / "quality.csv")]
    _write(folder / "quality.csv", "\n".join(lines) + "\n")
    _write(folder / "quality.json", json.dumps(_plain(result.document()), indent=1, allow_nan=False) + "\n")


def pictures_to(folder: Path, name: str, most: int) -> Show:
    """Draws camera, ideal camera and their difference into a folder, for at most so many cells, spread over the sweep."""

    def show(which: tuple[int, int], at: Mapping[str, Any], shot: Shot, ideal: Shot, shown: Any) -> Path | None:
        from etendue.report.quality import side_by_side

        number, count = which
        chosen = {round(i * (count - 1) / max(1, most - 1)) for i in range(min(most, count))}
        if shown is None or number not in chosen:
            return None
        where = ", ".join(f"{key} = {_cell(value)}" for key, value in at.items())
        path = folder / f"quality_{number:03d}.png"
        side_by_side(shot.xyz(), ideal.xyz(), shown, shot.to_xyz.sum(axis=1), f"{name}  {where}".strip(), path)
        return path

    return show


# -- running ------------------------------------------------------------------------------------------------------


def _plan_of(pipeline: Pipeline, registry: Registry, leave_out: bool, variables: Collection[str]) -> Plan:
    """The plan of what is compared, and nothing else kept."""
    whole = make_plan(replace(pipeline, wanted=None, keep=None, faults=()), registry, leave_out)
    texts = [f"{writer}.{variable}" for variable in variables if (writer := _writer(whole, variable))]
    texts += [f"{white}.white" for white in [_white_in_use(whole)] if white]
    return make_plan(replace(pipeline, wanted=tuple(texts), keep=tuple(texts)), registry, leave_out)


def _writer(plan: Plan, variable: str) -> str | None:
    return next((node.name for node in reversed(plan.nodes) if variable in node.writes), None)


def _white_in_use(plan: Plan) -> str | None:
    """The stage whose white belongs to the last camera primaries: what the stage reads that reads both."""
    for node in reversed(plan.nodes):
        for bound in node.inputs:
            read = {variable: source for _, source, variable in bound}
            if "rgb_camera" in read and "white" in read:
                return read["white"]
    return None


def _places(plan: Plan) -> Iterator[dict[str, int]]:
    """Positions on all axes, the last one fastest."""
    dims = [axis.dim for axis in plan.axes]
    for index in product(*(range(len(axis.values)) for axis in plan.axes)):
        yield dict(zip(dims, index, strict=True))


def _ref(outcome: Outcome, name: str, place: Mapping[str, int]) -> Any:
    return name, tuple(place[dim] for dim in outcome.plan.node(name).axes)


def _why_not(outcome: Outcome, place: Mapping[str, int]) -> str:
    """What kept a cell's pictures from being made; '' where nothing did."""
    lacking = [v for v in PICTURES if _writer(outcome.plan, v) and _array(outcome, place, v) is None]
    if not lacking:
        return ""
    reports = (outcome.reports.get(_ref(outcome, node.name, place)) for node in outcome.plan.nodes)
    failed = [f"{report.stage}: {report.message}" for report in reports if report is not None and report.status == "failed"]
    return failed[0] if failed else f"{lacking[0]} was not computed"


def _array(outcome: Outcome, place: Mapping[str, int], variable: str) -> Any:
    name = _writer(outcome.plan, variable) if variable != "white" else _white_in_use(outcome.plan) or _writer(outcome.plan, "white")
    return None if name is None else outcome.arrays.get(_ref(outcome, name, place), {}).get(variable)


def _scalar(outcome: Outcome, place: Mapping[str, int], name: str) -> float:
    array = _array(outcome, place, name)
    return math.nan if array is None else float(array)


def _shot(outcome: Outcome, place: Mapping[str, int]) -> Shot:
    pictures = {variable: _array(outcome, place, variable) for variable in (*PICTURES, "white")}
    return Shot(**pictures, to_xyz=_display_matrix(outcome.plan, place))


def _display_matrix(plan: Plan, place: Mapping[str, int]) -> Any:
    """Of the display that the picture is meant for; one that is not known by name has the primaries of sRGB."""
    name = _writer(plan, "rgb_linear")
    if name is None:
        return None
    stage = plan.cells[name, tuple(place[dim] for dim in plan.node(name).axes)].stage
    display = getattr(stage, "display", "sRGB")
    return colour.RGB_TO_XYZ_SRGB if display == "sRGB" else _measured(display)


def _measured(display: str) -> Any:
    matrix = spectra.colour_matching(DISPLAY_EDGES).T @ spectra.display_primaries(display, DISPLAY_EDGES)
    return matrix / matrix[1].sum()


def _notes(result: Comparison, plan: Plan, flats: int) -> list[str]:
    notes = []
    done = len(result.rows) - result.failed
    if done and _writer(plan, "rgb_linear") is None:
        notes.append("no stage writes rgb_linear, so there are no figures of colour: put 'display' behind the demosaicer")
    elif flats < done:
        notes.append(
            f"{done - flats} of {done} pictures have no uniform region of {FLAT_SIZES[-1]} x {FLAT_SIZES[-1]} pixels: SNR flat and visible "
            "noise are not known"
        )
    lacking = {"mean_snr": "exposure_report", "dr_emva": "dynamic_range"}
    for variable, stage in lacking.items():
        if done and _writer(plan, variable) is None:
            notes.append(f"{variable} is not known: the pipeline has no stage {stage!r}")
    return notes


# -- files --------------------------------------------------------------------------------------------------------


def _cell(value: Any) -> str:
    if isinstance(value, float) and math.isnan(value):
        return ""
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"\n') else text


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "inf" if value > 0 else "-inf"
    return value


def _write(path: Path, text: str) -> None:
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)

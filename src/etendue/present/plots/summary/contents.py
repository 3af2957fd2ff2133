"""Summary of an archive or of a run in memory: its name, progress, axes, metrics, pictures, and failures.

In:  an ``xarray.DataTree`` from ``open_archive``, xarray or ``simulate``, of a run that is finished, interrupted or in
     progress.
Out: a ``Glance``: numbers, texts and small pictures. Texts are untrusted: escape them before display.
"""

from __future__ import annotations

import itertools
import math
import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray

from etendue.archive.checks.describe import refuse_changed
from etendue.archive.journaling.journal import NAME as JOURNAL
from etendue.archive.journaling.journal import read
from etendue.archive.read.vouched.verified_store import open_archive
from etendue.archive.records.manifest import DATA
from etendue.archive.records.owner import is_running
from etendue.archive.records.past_runs import latest_record
from etendue.contract.wording import first
from etendue.errors import ArchiveError, EtendueError
from etendue.present.plots import pictures
from etendue.present.plots.drawing.strip import Tile, drawn_of, of_frames, picture_of, white_of
from etendue.present.plots.holdings import FINISHED, HeldVariable, Holdings
from etendue.present.plots.kinds import shown_at
from etendue.present.plots.labels import places_text, unit_text, value_text
from etendue.present.plots.summary.cells import counts_of, failed_cells, omissions, stages_of, state_of
from etendue.types.documents import AxisValues, Document

if TYPE_CHECKING:
    from etendue.types.documents import AxisValue

MOST_FIGURES, MOST_PICTURES, MOST_ROWS, MOST_VALUES = 6, 24, 8, 8
OMITTED = ("stage", "why_left_out", "approximated", "bound", "seconds_saved")
RANGED = 50_000  # largest number of cells of which min and max are read
LARGEST = 16 * 2**20  # largest number of elements of an array shown as a picture
# what xarray, zarr and its codecs raise on damaged bytes
UNREADABLE = (EtendueError, OSError, ValueError, KeyError, RuntimeError)


@dataclass(frozen=True)
class Metric:
    """The value of one metric in one cell, with its minimum and maximum over the sweep; unknown numbers are NaN."""

    name: str
    title: str
    units: str
    value: float
    least: float = math.nan
    most: float = math.nan

    @property
    def said(self) -> str:
        return f"{self.value:.4g} {unit_text(self.units)}".strip() if math.isfinite(self.value) else "–"

    @property
    def spanned(self) -> str:
        """Return minimum and maximum over the sweep as text; '' if they are unknown, or both equal the value of the
        cell.
        """
        ends = list(dict.fromkeys(f"{end:.4g}" for end in (self.least, self.most)))
        known = math.isfinite(self.least) and (len(ends) > 1 or not math.isfinite(self.value))
        return f"{' … '.join(ends)} {unit_text(self.units)}".strip() if known else ""


@dataclass(frozen=True)
class Glance:
    """The summary.

    Attributes
    ----------
    place : the folder or address, quoted for a shell; '' in memory
    state : progress of the run, in words
    counts : number of cells by status
    axes : (name, values, how many)
    at : axis values of the cell whose metrics and pictures are shown
    omitted : what was left out or approximated, a row per stage and reason
    failed : (stage, where, message)
    commands : commands and their descriptions
    """

    name: str
    place: str
    state: str
    stages: int
    counts: Mapping[str, int]
    axes: list[tuple[str, str, int]]
    at: str
    figures: list[Metric]
    pictures: list[Tile]
    omitted: list[Document]
    failed: list[tuple[str, str, str]]
    commands: list[tuple[str, str]]
    notes: list[str]

    @property
    def cells(self) -> int:
        return sum(self.counts.values())


def glance(tree: xarray.DataTree | xarray.Dataset) -> Glance:
    """Return the summary of a tree; parts that cannot be read become notes."""
    place, folder = place_of(tree)
    why = _damage(folder) if folder else ""
    if not why:
        try:
            return _whole(tree, place, folder)
        except UNREADABLE as error:
            why = f"cannot be read: {error}"
    return _broken(_named(tree, folder), place if folder else "", why)


def glance_at(folder: Path) -> Glance:
    """Return the summary of an archive in a folder, even if it is too damaged to open as a tree."""
    try:
        return glance(open_archive(folder))
    except ArchiveError as error:
        record = latest_record(folder) or {}
        return _broken(str(record.get("pipeline", "") or folder.resolve().name), shlex.quote(str(folder)), str(error))


def _broken(name: str, place: str, why: str) -> Glance:
    mend = [(f"etendue verify {place} --repair", "recompute only what is damaged")] if place else []
    return Glance(name, place, "damaged", 0, {}, [], "", [], [], [], [], mend, [why])


def _whole(tree: xarray.DataTree | xarray.Dataset, place: str, folder: Path | None) -> Glance:
    """Return the summary of an archive whose metadata are intact; single arrays may still be unreadable."""
    holdings = Holdings(tree)
    notes: list[str] = []
    whole = isinstance(tree, xarray.DataTree) and tree.parent is None
    ledger = _ledger(holdings, notes) if whole else None
    journal = read(folder / JOURNAL) if folder and whole and ledger is None else None
    at = _cell(holdings)
    found: dict[str, list[Any]] = {}
    for what, make in (("figures", lambda: _figures(holdings, at)), ("pictures", lambda: _pictures(holdings, at))):
        try:
            found[what] = make()
        except UNREADABLE as error:
            found[what] = []
            notes.append(f"{what} cannot be read: {error}")
    units = {dim: next(one.units_of(dim) for one in holdings if dim in one.axes) for dim in holdings.axes}
    omitted = omissions({n: ledger[n].values for n in OMITTED}) if ledger is not None else []
    failed = failed_cells(holdings, ledger, journal, units)
    counts = counts_of(holdings, ledger, journal)
    record = (latest_record(folder) or {}) if folder else {}
    state = state_of(folder if whole else None, record, counts)
    commands = [*_going_on(place, folder, state), *_commands(holdings, place, at)]
    names = (
        *((holdings.pipeline, record.get("pipeline")) if whole else ()),
        getattr(tree, "name", ""),
        tree.attrs.get("stage"),
    )
    return Glance(
        str(next(filter(None, names), "")),
        place,
        state,
        len(stages_of(holdings, ledger)),
        counts,
        [(dim, _values(values, units[dim], dim), len(values)) for dim, values in holdings.axes.items()],
        places_text(at, units),
        found["figures"],
        found["pictures"],
        omitted,
        failed,
        commands,
        notes,
    )


def place_of(tree: xarray.DataTree | xarray.Dataset) -> tuple[str, Path | None]:
    """Return the place from which a tree was read, quoted for a shell, and the folder of its archive; ('', None) in
    memory.
    """
    source = str((tree.root if isinstance(tree, xarray.DataTree) else tree).encoding.get("source", ""))
    if "://" in source:
        return shlex.quote(source.rstrip("/").removesuffix(f"/{DATA}")), None
    folder = Path(source).parent if Path(source).name == DATA else Path(source)
    if not source or not (folder / JOURNAL).is_file():
        return "", None
    near = os.path.relpath(folder)
    return shlex.quote(str(folder) if near.startswith("..") else near), folder


def _ledger(holdings: Holdings, notes: list[str]) -> xarray.Dataset | None:
    """Load the ledger; return None and add a note if it cannot be read."""
    try:
        ledger = holdings.table("ledger")
        return ledger.load() if ledger is not None else None
    except UNREADABLE as error:
        notes.append(f"the ledger cannot be read: {error}")
        return None


def _named(tree: xarray.DataTree | xarray.Dataset, folder: Path | None) -> str:
    """Return the name of the pipeline, even if the metadata of the store are lost."""
    own = tree.attrs.get("etendue", {})
    said = own.get("pipeline") if isinstance(own, Mapping) else ""
    record = (latest_record(folder) or {}) if folder else {}
    return str(said or record.get("pipeline", "") or getattr(tree, "name", "") or "")


def _damage(folder: Path) -> str:
    """Return the changes in an archive since it was written, apart from chunks of cells, and the command that repairs
    them; '' if there are none.
    """
    try:
        refuse_changed(folder, is_running(folder))
    except ArchiveError as error:
        return str(error)
    return ""


# -- one cell
# -------------------------------------------------------------------------------------------------------------


def _cell(holdings: Holdings) -> Document:
    """Return the axis values of the cell to show: the cell of the run's pictures; else, among the cells finished up to
    the latest stage, the one nearest the middle of the sweep.
    """
    said = shown_at(holdings)
    if said:
        return {dim: value for dim, value in said.items() if dim in holdings.axes}
    axes = holdings.axes
    middle = {dim: values[len(values) // 2] for dim, values in axes.items()}
    off = {
        dim: {value: abs(place - len(values) // 2) for place, value in enumerate(values)}
        for dim, values in axes.items()
    }
    for one in [*reversed(holdings.of_kind("picture")), *reversed(list(holdings))]:
        there = _finished(one)
        if there and one.axes:
            away = [sum(off[dim][v] for dim, v in place.items()) for place in there]
            return {**middle, **there[away.index(min(away))]}
    return middle


def _finished(one: HeldVariable) -> list[Document]:
    """Return the axis values of each finished cell of a stage; only the status array is read."""
    found = []
    for group in one.groups:
        if "status" in group:
            status = group["status"]
            labels = [status[dim].values.tolist() for dim in status.dims]
            for place in np.argwhere(np.isin(status.values, FINISHED)):
                found.append({str(dim): own[i] for dim, own, i in zip(status.dims, labels, place, strict=True)})
    return found


def _is_finished(one: HeldVariable, at: AxisValues) -> bool:
    """Return whether the cell at these axis values is finished; a variable that no axis affects counts as finished."""
    place = {dim: at[dim] for dim in one.axes}
    for group in one.groups:
        if "status" in group and all(value in group[dim].values.tolist() for dim, value in place.items()):
            if int(group["status"].sel(place)) in FINISHED:
                return True
    return not one.axes


def _figures(holdings: Holdings, at: AxisValues) -> list[Metric]:
    """Return the preferred metrics; then all others with one number per cell."""
    able: dict[str, HeldVariable] = {}
    for one in holdings.of_kind("figure"):
        if one.dims in ((), ("stage",)) and not one.known.counted and not one.known.index and not one.known.quiet:
            able[one.variable] = one
    front = first("glance")
    names = [
        *(name for name in front if name in able),
        *(name for name in able if name not in front and able[name].axes),
    ]
    found = (own for name in names if (own := _figure(able[name], at)) is not None)
    return list(itertools.islice(found, MOST_FIGURES))


def _figure(one: HeldVariable, at: AxisValues) -> Metric | None:
    """Return the value of a metric in one cell and the range over the sweep; None if neither is known."""
    cells = math.prod(len(one.values_of(dim)) for dim in one.axes)
    ranged = cells <= RANGED
    place = {dim: value for dim, value in at.items() if dim in one.axes}
    if not ranged and not _is_finished(one, at):
        return None
    values = one.values({} if ranged else place)
    values = values.isel(stage=-1) if one.dims else values
    own = float(values.sel(place if ranged else {}).values)
    finite = values.values[np.isfinite(values.values)] if ranged and cells > 1 else np.empty(0)
    if not (math.isfinite(own) or finite.size):
        return None
    least, most = (float(finite.min()), float(finite.max())) if finite.size else (math.nan, math.nan)
    behind = f" after {one.values_of('stage')[-1]}" if one.dims else ""
    name, without, rest = one.title.partition(", without ")  # such as 'level after filter, without sharpen'
    return Metric(one.variable, f"{name}{behind}{without}{rest}", one.units, own, least, most)


def _pictures(holdings: Holdings, at: AxisValues) -> list[Tile]:
    """Return a small picture of every stage at one cell."""
    frames = holdings.table("frames")
    if frames is not None:
        return of_frames(frames)
    tiles = []
    for one in holdings.of_kind("picture"):
        own = {dim: value for dim, value in at.items() if dim in one.axes}
        if not drawn_of(one).shown or not _is_finished(one, at):
            continue
        array, _ = picture_of(one, own)
        if array.size <= LARGEST:
            picture = pictures.drawn(array, white_of(holdings, one, own), small=True)
            tiles.append(Tile(one.stage, one.variable, picture, (int(array.sizes["y"]), int(array.sizes["x"]))))
    return tiles


def _values(values: list[AxisValue], units: str, dim: str) -> str:
    texts = [value_text(value, units, dim) for value in values]
    return ", ".join(texts) if len(texts) <= MOST_VALUES else f"{', '.join(texts[:3])}, …, {texts[-1]}"


# -- what to do next
# ------------------------------------------------------------------------------------------------------


def _going_on(place: str, folder: Path | None, state: str) -> list[tuple[str, str]]:
    """Return the command that computes the missing cells of an unfinished run."""
    files = sorted((folder / "runs").glob("*.toml")) if folder else []
    if not files or state == "complete" or state.startswith("running"):
        return []
    return [
        (
            f"etendue run {shlex.quote(f'{shlex.split(place)[0]}/runs/{files[-1].name}')} --archive {place}",
            "compute what is missing",
        )
    ]


def _places(one: HeldVariable, at: AxisValues) -> str:
    """Return the values of the swept axes as keyword arguments in the text of a call."""
    axes = {dim: one.values_of(dim) for dim in one.axes if dim.isidentifier()}
    return "".join(f", {dim}={at.get(dim, values[0])!r}" for dim, values in axes.items() if len(values) > 1)


def _commands(holdings: Holdings, place: str, at: AxisValues) -> list[tuple[str, str]]:
    """Return next steps: in Python for any tree, and as commands for a stored one."""
    varying = [one for one in holdings.of_kind("figure") if any(len(one.values_of(dim)) > 1 for dim in one.axes)]
    names = [one.variable for one in varying]
    named = next((name for name in first("glance") if name in names), names[-1] if names else "")
    pictured = {one.variable: one for one in holdings.of_kind("picture")}
    front = [name for name in first("picture") if name in pictured]
    picture = next((name for name in (*front, *reversed(pictured)) if _is_finished(pictured[name], at)), "")
    found = [(f'tree.etendue.plot.map("{named}")', "a metric over the sweep")] if named else []
    found += (
        [("tree.etendue.plot.strip()", "every stage, with an enlarged detail")]
        if picture or holdings.table("frames") is not None
        else []
    )
    if picture:
        places = _places(pictured[picture], at)
        found.append((f'tree.etendue.show("{picture}"{places})', "one picture of one cell"))
    if not place:
        return found
    return [
        *found,
        (f"etendue plot {place} --list", "list all possible plots"),
        (f"etendue report {place} -o report.html", "one self-contained HTML page"),
        (f"etendue view {place}", "every pixel of every stage, live"),
    ]

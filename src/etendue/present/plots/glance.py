"""An archive, or a run in memory, at a glance: what it is, how far it is, its axes, figures, pictures, and what went
wrong.

In:  an ``xarray.DataTree`` as ``open_archive``, xarray or ``simulate`` give it, of a run that has ended, was broken off
     or goes on.
Out: a ``Glance``: numbers, texts and small pictures. Texts may be a stranger's: whoever shows them escapes them.
"""

from __future__ import annotations

import itertools
import math
import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray

from etendue.archive.describe import refuse_changed
from etendue.archive.journal import NAME as JOURNAL
from etendue.archive.journal import read
from etendue.archive.manifest import DATA
from etendue.archive.owner import is_running
from etendue.archive.provenance import latest_record
from etendue.archive.vouched import open_archive
from etendue.contract.drawn import Pictured
from etendue.contract.wording import first
from etendue.errors import ArchiveError, EtendueError
from etendue.present.plots import pictures
from etendue.present.plots.glance_cells import counts_of, failed_cells, omitted_cells, stages_of, state_of
from etendue.present.plots.holdings import FINISHED, Held, Holdings
from etendue.present.plots.kinds import shown_at
from etendue.present.plots.labels import places_text, unit_text, value_text
from etendue.present.plots.strip import Tile, drawn_of, of_frames, picture_of
from etendue.types.documents import Document, Place

MOST_FIGURES, MOST_PICTURES, MOST_ROWS, MOST_VALUES = 6, 24, 8, 8
RANGED = 50_000  # cells of a figure, up to which its least and most are read
LARGEST = 16 * 2**20  # numbers of an array that is made small for its picture
SAMPLES = 256  # along a side, of which a small picture is made
UNREADABLE = (
    EtendueError,
    OSError,
    ValueError,
    KeyError,
    RuntimeError,
)  # what xarray, zarr and its codecs say of bytes that are damaged


@dataclass(frozen=True)
class Figure:
    """One number of one cell, and its least and most over the sweep; unknown: NaN."""

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
        """Least and most over the sweep, as they are printed; '' where they are not known or are that of the cell."""
        ends = list(dict.fromkeys(f"{end:.4g}" for end in (self.least, self.most)))
        known = math.isfinite(self.least) and (len(ends) > 1 or not math.isfinite(self.value))
        return f"{' … '.join(ends)} {unit_text(self.units)}".strip() if known else ""


@dataclass(frozen=True)
class Glance:
    """What is seen first.

    Attributes
    ----------
    place : the folder or address, as a command takes it; '' in memory
    state : how far the run is, in words
    counts : cells by what became of them
    axes : (name, values, how many)
    at : axis values of the cell whose figures and pictures these are
    omitted : (stage, cells, of, why, what it adds at most, seconds saved)
    failed : (stage, where, message)
    commands : what to type, and what for
    """

    name: str
    place: str
    state: str
    stages: int
    counts: Mapping[str, int]
    axes: list[tuple[str, str, int]]
    at: str
    figures: list[Figure]
    pictures: list[Tile]
    omitted: list[tuple[str, int, int, str, float, float]]
    failed: list[tuple[str, str, str]]
    commands: list[tuple[str, str]]
    notes: list[str]

    @property
    def cells(self) -> int:
        return sum(self.counts.values())


def glance(tree: xarray.DataTree | xarray.Dataset) -> Glance:
    """All that is seen first; what cannot be read is a note."""
    place, folder = place_of(tree)
    why = _damage(folder) if folder else ""
    if not why:
        try:
            return _whole(tree, place, folder)
        except UNREADABLE as error:
            why = f"it cannot be read: {error}"
    return _broken(_named(tree, folder), place if folder else "", why)


def glance_at(folder: Path) -> Glance:
    """The same of an archive in a folder, though it is so damaged that no tree can be made of it."""
    try:
        return glance(open_archive(folder))
    except ArchiveError as error:
        record = latest_record(folder) or {}
        return _broken(str(record.get("pipeline", "") or folder.resolve().name), shlex.quote(str(folder)), str(error))


def _broken(name: str, place: str, why: str) -> Glance:
    mend = [(f"etendue verify {place} --repair", "computes what is lost, and nothing else")] if place else []
    return Glance(name, place, "damaged", 0, {}, [], "", [], [], [], [], mend, [why])


def _whole(tree: xarray.DataTree | xarray.Dataset, place: str, folder: Path | None) -> Glance:
    """A glance at what is as it was written, single arrays aside."""
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
    omitted = omitted_cells(ledger) if ledger is not None else []
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
    """Where a tree was read from, as a command takes it, and the folder of its archive; ('', None) in memory."""
    source = str((tree.root if isinstance(tree, xarray.DataTree) else tree).encoding.get("source", ""))
    if "://" in source:
        return shlex.quote(source.rstrip("/").removesuffix(f"/{DATA}")), None
    folder = Path(source).parent if Path(source).name == DATA else Path(source)
    if not source or not (folder / JOURNAL).is_file():
        return "", None
    near = os.path.relpath(folder)
    return shlex.quote(str(folder) if near.startswith("..") else near), folder


def _ledger(holdings: Holdings, notes: list[str]) -> xarray.Dataset | None:
    """The ledger, read at once; None and a note where it cannot be."""
    try:
        ledger = holdings.table("ledger")
        return ledger.load() if ledger is not None else None
    except UNREADABLE as error:
        notes.append(f"the ledger cannot be read: {error}")
        return None


def _named(tree: xarray.DataTree | xarray.Dataset, folder: Path | None) -> str:
    """The name of a pipeline, of which the metadata of the store may be lost."""
    own = tree.attrs.get("etendue", {})
    said = own.get("pipeline") if isinstance(own, Mapping) else ""
    record = (latest_record(folder) or {}) if folder else {}
    return str(said or record.get("pipeline", "") or getattr(tree, "name", "") or "")


def _damage(folder: Path) -> str:
    """What of an archive is not as it was written, chunks of cells aside, and how to mend it; '' where all is."""
    try:
        refuse_changed(folder, is_running(folder))
    except ArchiveError as error:
        return str(error)
    return ""


# -- one cell
# -------------------------------------------------------------------------------------------------------------


def _cell(holdings: Holdings) -> Document:
    """The cell that is looked at: that of the pictures of a run; else, of those that have come furthest, the one in
    the middle.
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


def _finished(one: Held) -> list[Document]:
    """Where a stage is finished, by its status alone: none of its arrays is read."""
    found = []
    for group in one.groups:
        if "status" in group:
            status = group["status"]
            labels = [status[dim].values.tolist() for dim in status.dims]
            for place in np.argwhere(np.isin(status.values, FINISHED)):
                found.append({str(dim): own[i] for dim, own, i in zip(status.dims, labels, place, strict=True)})
    return found


def _is_finished(one: Held, at: Place) -> bool:
    """Whether the cell at some values of the sweep is there; what no axis reaches is."""
    place = {dim: at[dim] for dim in one.axes}
    for group in one.groups:
        if "status" in group and all(value in group[dim].values.tolist() for dim, value in place.items()):
            if int(group["status"].sel(place)) in FINISHED:
                return True
    return not one.axes


def _figures(holdings: Holdings, at: Place) -> list[Figure]:
    """What goes first; then what else is one number a cell."""
    able: dict[str, Held] = {}
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


def _figure(one: Held, at: Place) -> Figure | None:
    """A figure of one cell and its range over the sweep; None where neither is known."""
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
    behind = f" behind {one.values_of('stage')[-1]}" if one.dims else ""
    name, without, rest = one.title.partition(", without ")  # 'level behind filter, without sharpen'
    return Figure(one.variable, f"{name}{behind}{without}{rest}", one.units, own, least, most)


def _pictures(holdings: Holdings, at: Place) -> list[Tile]:
    """Every stage of one cell, small."""
    frames = holdings.table("frames")
    if frames is not None:
        return of_frames(frames)
    kept, thin = [], []
    for one in holdings.of_kind("picture"):
        own = {dim: value for dim, value in at.items() if dim in one.axes}
        if not drawn_of(one).shown or not _is_finished(one, at):
            continue
        array, _ = picture_of(one, own)
        if array.size > LARGEST:
            continue
        step = 1 if pictures.drawn_as(array).pattern else max(1, -(-max(array.sizes["y"], array.sizes["x"]) // SAMPLES))
        kept.append((one, (int(array.sizes["y"]), int(array.sizes["x"]))))
        thin.append(array.isel(y=slice(None, None, step), x=slice(None, None, step)).load())
    order = [Pictured(one.variable, one.dims, drawn_of(one), one.axes) for one, _ in kept]
    whites = [
        pictures.bright_among(order, number, lambda other: pictures.bright_in(thin[other]))
        for number in range(len(order))
    ]
    return [
        Tile(one.stage, one.variable, pictures.drawn(array, white), size)
        for (one, size), array, white in zip(kept, thin, whites, strict=True)
    ]


def _values(values: list[Any], units: str, dim: str) -> str:
    texts = [value_text(value, units, dim) for value in values]
    return ", ".join(texts) if len(texts) <= MOST_VALUES else f"{', '.join(texts[:3])}, …, {texts[-1]}"


# -- what to do next
# ------------------------------------------------------------------------------------------------------


def _going_on(place: str, folder: Path | None, state: str) -> list[tuple[str, str]]:
    """Of a run that lacks something: the command that computes what is not there, and nothing else."""
    files = sorted((folder / "runs").glob("*.toml")) if folder else []
    if not files or state == "complete" or state.startswith("running"):
        return []
    return [
        (
            f"etendue run {shlex.quote(f'{shlex.split(place)[0]}/runs/{files[-1].name}')} --archive {place}",
            "computes what is not there",
        )
    ]


def _places(one: Held, at: Place) -> str:
    """The values of what is swept, as words of a call."""
    axes = {dim: one.values_of(dim) for dim in one.axes if dim.isidentifier()}
    return "".join(f", {dim}={at.get(dim, values[0])!r}" for dim, values in axes.items() if len(values) > 1)


def _commands(holdings: Holdings, place: str, at: Place) -> list[tuple[str, str]]:
    """In Python for any tree; as commands for what is stored."""
    varying = [one for one in holdings.of_kind("figure") if any(len(one.values_of(dim)) > 1 for dim in one.axes)]
    names = [one.variable for one in varying]
    named = next((name for name in first("glance") if name in names), names[-1] if names else "")
    pictured = {one.variable: one for one in holdings.of_kind("picture")}
    front = [name for name in first("picture") if name in pictured]
    picture = next((name for name in (*front, *reversed(pictured)) if _is_finished(pictured[name], at)), "")
    found = [(f'tree.etendue.plot.map("{named}")', "a figure over the sweep")] if named else []
    found += (
        [("tree.etendue.plot.strip()", "every stage, with a part enlarged")]
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
        (f"etendue plot {place} --list", "all that can be drawn"),
        (f"etendue report {place} -o report.html", "one page to read and send on"),
        (f"etendue view {place}", "every pixel of every stage, live"),
    ]

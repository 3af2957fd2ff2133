"""The pictures of an archive, one at a time, with their metadata: camera values, white, colour matrix, key.

In:  the folder of an archive.
Out: a ``Shelf`` for an archive, with its pictures by axis values; arrays are read on demand.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import xarray

from etendue.archive.checks.describe import describe_archive
from etendue.archive.read.reading import metadata_of
from etendue.archive.read.stored import Stored
from etendue.archive.read.vouched.verified_store import VouchedStore
from etendue.archive.records.names import ROW, STATUS, cell_label
from etendue.archive.records.past_runs import latest_record
from etendue.errors import ArchiveError, Fault, RequestError, nearest
from etendue.present.plots.drawing.strip import white_of
from etendue.present.plots.holdings import Holdings, rows_of
from etendue.present.plots.opening import opened
from etendue.present.plots.places import is_called, is_value
from etendue.types.documents import AxisValues, Document, DocumentView
from etendue_camera.arrays import Array, FloatArray

PLANE = ("channel", "y", "x")
FINISHED = ("done", "left_out")
MEND = "repair it with: etendue verify --repair"


@dataclass(frozen=True)
class StageGroup:
    """One group of the store that holds a variable: a stage's output, or its cells of one array shape."""

    stage: str
    path: str
    data: xarray.Dataset

    @property
    def parameters(self) -> dict[str, str]:
        """Return the parameter that each axis sets: ``{"f_number": "f_number", "pixel_rows": "pixel.rows"}``."""
        return {
            str(dim): str(self.data[dim].attrs.get("parameter", dim))
            for dim in self.data.coords
            if dim in self.data.dims
        }

    def row_dim(self, dim: str) -> str:
        """Return the dim of a design's rows if the combinations of their factors lie along ``dim``; '' otherwise."""
        rows = rows_of(self.data, dim)
        return "" if rows is None else str(rows.dims[0])


@dataclass(frozen=True)
class ArchivedFrame:
    """One picture of one cell: its place in the archive, and whether it has been stored."""

    group: StageGroup
    variable: str
    labels: AxisValues  # axis values, and the position along leading dims such as ``frame``
    status: str
    stored: Stored

    def picture(self) -> Array:
        """Return the array: (y, x) or (channel, y, x).

        Raises
        ------
        ArchiveError
            If the array is missing or differs from the recorded digest; fill values are never returned.
        """
        return stored_array(self.stored, self.group.stage, self.group.data, self.variable, self.labels)

    def where(self) -> str:
        return ", ".join(f"{dim}={plain(value)}" for dim, value in self.labels.items())


def stored_array(stored: Stored, stage: str, data: xarray.Dataset, variable: str, labels: AxisValues) -> FloatArray:
    """Return a variable of one cell, checked against its digest, at the labels of its other dims."""
    axes = _cell_axes(data)
    name = cell_label(stage, {dim: labels[dim] for dim in axes})
    if name not in stored.finished:
        raise ArchiveError(
            f"{stored.folder}: the journal does not list {name} as finished, although its status does; {MEND} "
            f"{stored.folder}"
        )
    try:
        array = stored.cell(name).read(variable)
    except ArchiveError as error:
        raise ArchiveError(f"{stored.folder}: {error}; {MEND} {stored.folder}") from None
    inner = xarray.DataArray(array, dims=[dim for dim in data[variable].dims if dim not in axes])
    rest = {
        str(dim): _values(data[variable], str(dim)).index(labels[str(dim)]) for dim in inner.dims if str(dim) in labels
    }
    return inner.isel(rest).to_numpy()


def plain(value: Any) -> str:
    """Return a value of an axis as short text."""
    return f"{value:.12g}" if isinstance(value, float) else str(value)


class Shelf:
    """An archive opened for reading. Nothing in it is changed."""

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        described = describe_archive(self.folder)
        record = latest_record(self.folder)
        assert record is not None  # describe_archive has rejected such a folder
        self.record: Document = record
        self.stages: list[str] = [stage["name"] for stage in described["stages"]]
        self.variables: dict[str, list[tuple[str, str]]] = {}
        for stage in described["stages"]:
            for found in stage["variables"]:
                self.variables.setdefault(found["variable"], []).append((stage["name"], found["group"]))
        self.opened: dict[str, xarray.Dataset] = {}

    @cached_property
    def stored(self) -> Stored:
        return Stored(self.folder)

    @cached_property
    def store(self) -> Any:
        return VouchedStore.of(self.stored.archive)

    # -- pictures -------------------------------------------------------------------------------------

    def groups(self, variable: str, stage: str = "") -> list[StageGroup]:
        """Return the groups of the last stage that wrote a variable, or of the given one."""
        written = self.variables.get(variable)
        if not written:
            pictures = [name for name, places in self.variables.items() if self._is_picture(places[0][1], name)]
            raise RequestError(
                f"{self.folder} has no {variable!r}{nearest(variable, pictures)}; it may have been left out by 'keep'"
            )
        stages = list(dict.fromkeys(name for name, _ in written))
        if stage and stage not in stages:
            raise RequestError(f"--stage {stage}: it wrote no {variable!r} here{nearest(stage, stages)}")
        chosen = stage or stages[-1]
        return [StageGroup(chosen, path, self._open(path)) for name, path in written if name == chosen]

    def frames(self, variable: str, stage: str = "", light: bool = False) -> list[ArchivedFrame]:
        """Return every picture of a variable, in stored axis order; with ``light``, the bands of light together also
        form one picture.
        """
        found = [frame for group in self.groups(variable, stage) for frame in self._frames_of(group, variable, light)]
        there = [frame.labels for frame in found if frame.status != "not_computed"]
        # The cell belongs to the group of another shape of this stage.
        return [f for f in found if f.status != "not_computed" or f.labels not in there]

    def _frames_of(self, group: StageGroup, variable: str, light: bool) -> Iterator[ArchivedFrame]:
        array = group.data[variable]
        flat = array.dims[-2:] == ("y", "x")
        if not flat or not (light or self._is_picture(group.path, variable)):
            way = "; use --png to render it" if flat else "; plot it with etendue plot"
            raise RequestError(f"{variable} has dims {', '.join(map(str, array.dims))}: it is not a picture{way}")
        axes = [str(dim) for dim in array.dims if dim not in PLANE and not (light and dim == "wavelength")]
        values = [_values(array, dim) for dim in axes]
        status = group.data["status"].to_numpy() if "status" in group.data else None
        for index in product(*(range(len(own)) for own in values)):
            flag = "done" if status is None else STATUS[int(status[index[: status.ndim]])]
            labels = {dim: own[i] for dim, own, i in zip(axes, values, index, strict=True)}
            yield ArchivedFrame(group, variable, labels, flag, self.stored)

    def _is_picture(self, path: str, variable: str) -> bool:
        array = self._open(path).get(variable)
        return array is not None and array.dims[-2:] == ("y", "x") and "wavelength" not in array.dims

    def _open(self, path: str) -> xarray.Dataset:
        if path not in self.opened:
            with metadata_of(self.folder):
                self.opened[path] = xarray.open_dataset(
                    self.store, engine="zarr", group=path, chunks=None, consolidated=False
                )
        return self.opened[path]

    @cached_property
    def holdings(self) -> Holdings:
        return Holdings(opened(self.folder))

    def white(self, frame: ArchivedFrame) -> float:
        """Return the linear value shown as white in a picture, as in plots."""
        held = self.holdings.find(f"{frame.group.stage}.{frame.variable}", "picture")
        labels = {**frame.labels, **_first_rows(frame)}
        return white_of(self.holdings, held, {dim: labels[dim] for dim in held.axes})

    # -- metadata of a picture -----------------------------------------------------------------------

    def parameter(self, frame: ArchivedFrame, name: str, default: Any = None) -> Any:
        """Return a parameter in the cell of a frame: from its axis, its stage, the camera, or any other stage."""
        for coordinate in frame.group.data.coords.values():
            key = str(coordinate.attrs.get("parameter", coordinate.name))
            if key.rpartition(".")[2] == name and set(coordinate.dims) <= set(frame.labels):
                return coordinate.sel({dim: frame.labels[str(dim)] for dim in coordinate.dims}).item()
        nodes = self.record["nodes"]
        own = [nodes.get(frame.group.stage, {}), *nodes.values()]
        for shown in [own[0].get("shown", {}), self.record["shared"], *(node["shown"] for node in own[1:])]:
            if shown.get(name) is not None:
                return float(shown[name]) if shown[name] in ("inf", "nan") else shown[name]
        return default

    def roles(self, stage: str) -> list[str]:
        """Return the roles of a stage of the archive.

        Raises
        ------
        ArchiveError
            If the archive was written before roles were recorded.
        """
        node = self.record["nodes"].get(stage, {"role": []})
        if "role" not in node:
            raise ArchiveError(
                f"{self.folder} does not record the roles of its stages: rerun its pipeline with this version"
            )
        return list(node["role"])

    def beside(self, frame: ArchivedFrame, variable: str, other_than: str = "") -> Any:
        """Return another variable of the same cell, such as ``white`` for a ``raw``, or None if the archive has none.

        If several stages write it, the variable of the last stage is returned; stages of the role ``other_than`` are
        ignored.
        """
        for stage, path in reversed(self.variables.get(variable, [])):
            if other_than and other_than in self.roles(stage):
                continue
            data = self._open(path)
            cell = _finished_cell(data, frame.labels)
            if cell is not None:
                inner = {str(dim): frame.labels[str(dim)] for dim in data[variable].dims if dim in frame.labels}
                return stored_array(self.stored, stage, data, variable, {**inner, **cell})
        return None

    def key(self, frame: ArchivedFrame) -> str:
        """Return the key that identifies the recipe of a frame's cell; '' if the journal does not list the cell."""
        axes = _cell_axes(frame.group.data)
        labels = {dim: value for dim, value in frame.labels.items() if dim in axes}
        entry = self.stored.journal.entries.get(cell_label(frame.group.stage, labels))
        return entry.key if entry is not None else ""


def _cell_axes(data: xarray.Dataset) -> list[str]:
    """Return the axes along which a stage was computed cell by cell."""
    return [str(dim) for dim in data["status"].dims] if "status" in data else []


def _finished_cell(data: xarray.Dataset, known: DocumentView) -> Document | None:
    """Return the labels of the only finished cell at known labels; None if there is not exactly one, or it is
    unfinished.
    """
    axes = _cell_axes(data)
    for rows in (data[f"{dim}{ROW}"] for dim in axes if dim not in known and f"{dim}{ROW}" in data):
        own = str(rows.dims[0])  # of a design: its rows have combinations of factors in common
        if own in known:
            known = {**known, str(rows.name).removesuffix(ROW): rows.sel({own: known[own]}).item()}
    labels = {dim: known[dim] for dim in axes if dim in known}
    open_ = [dim for dim in axes if dim not in labels and data.sizes[dim] > 1]
    if open_ or any(value not in _values(data, dim) for dim, value in labels.items()):
        return None
    cell = data.sel(labels).squeeze([dim for dim in axes if dim not in labels])
    whole = {dim: labels[dim] if dim in labels else _values(data, dim)[0] for dim in axes}
    return whole if STATUS[int(cell["status"])] in FINISHED else None


def _first_rows(frame: ArchivedFrame) -> Document:
    """Return, by the dim of a design's rows, the first row that has the factor combination of a frame."""
    found = {}
    for dim, value in frame.labels.items():
        if row := frame.group.row_dim(dim):
            rows = frame.group.data[f"{dim}{ROW}"]
            found[row] = rows[row].values[rows.values == value][0].item()
    return found


def _values(data: xarray.Dataset | xarray.DataArray, dim: str) -> list[Any]:
    if dim not in data.coords:
        return list(range(data.sizes[dim]))
    return [value.item() if hasattr(value, "item") else value for value in data[dim].to_numpy()]


# -- selection ------------------------------------------------------------------------------------------------


def chosen(frames: list[ArchivedFrame], at: Mapping[str, str]) -> list[ArchivedFrame]:
    """Return the frames at the given axis values; an axis that is not given is kept whole.

    Raises
    ------
    RequestError
        If an axis, or a value on it, does not exist.
    """
    left, faults = frames, []
    for name, text in at.items():
        found = _place(frames, name, text)
        if isinstance(found, Fault):
            faults.append(found)
        else:
            dim, values = found
            left = [frame for frame in left if frame.labels.get(dim) in values]
    if faults:
        raise RequestError(faults)
    if not left:
        raise RequestError(
            f"--at {' '.join(f'{k}={v}' for k, v in at.items())}: no cell of {frames[0].variable} has this combination "
            f"of values"
        )
    return left


def _place(frames: list[ArchivedFrame], name: str, text: str) -> tuple[str, list[Any]] | Fault:
    """Return the axis with this name, and its values that match a text."""
    axes = _axes(frames)
    if combined := next((dim for dim in axes if name == frames[0].group.row_dim(dim)), ""):
        return _row_place(frames[0].group, combined, name, text)
    dim = next((dim for dim, key in axes.items() if is_called(name, dim, key)), "")
    if not dim:
        why = nearest(name, axes) if axes else "; nothing was swept"
        return Fault(f"--at {name}", f"{frames[0].variable} has no such axis{why}")
    values = list(dict.fromkeys(frame.labels[dim] for frame in frames if dim in frame.labels))
    unit = next((str(f.group.data[dim].attrs.get("units", "1")) for f in frames if dim in f.group.data.coords), "1")
    match = [value for value in values if is_value(value, text, unit)]
    if match:
        return dim, match
    shown = ", ".join(map(plain, values[:12])) + (", ..." if len(values) > 12 else "")
    return Fault(f"--at {name}={text}", f"not computed; {dim} is {shown}{'' if unit == '1' else ' ' + unit}")


def _axes(frames: list[ArchivedFrame]) -> dict[str, str]:
    """Return the parameter that each axis of some frames sets; an axis that sets no parameter has its own name."""
    axes = {dim: key for frame in frames for dim, key in frame.group.parameters.items() if dim in frame.labels}
    return axes | {dim: dim for frame in frames for dim in frame.labels if dim not in axes}


def _row_place(group: StageGroup, dim: str, name: str, text: str) -> tuple[str, list[Any]] | Fault:
    """Return the dim of factor combinations, and the combination of one design row; a fault if the row is missing."""
    rows = group.data[f"{dim}{ROW}"]
    of_row = dict(zip(map(str, _values(rows, name)), rows.values.tolist(), strict=True))
    if text in of_row:
        return dim, [of_row[text]]
    return Fault(f"--at {name}={text}", f"no such row; {name} is {', '.join(list(of_row)[:12])}, ...")


def described(shelf: Shelf, frame: ArchivedFrame) -> str:
    """Return one line of provenance for a file: pipeline, stage, axis values, key of the cell."""
    facts = {
        "pipeline": shelf.record["pipeline"],
        "stage": frame.group.stage,
        "variable": frame.variable,
        "at": frame.where(),
        "cell": shelf.key(frame),
        "etendue": shelf.record["libraries"].get("etendue", ""),
    }
    return json.dumps({name: text for name, text in facts.items() if text}, ensure_ascii=True)

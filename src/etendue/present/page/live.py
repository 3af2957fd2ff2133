"""Requests of the live page: progress, pictures, values under the pointer, lines, histograms.

In:  the folder of an archive; a request and its parameters.
Out: JSON or pixels. Arrays are read from the store and checked against its digests; for a run in progress, every
     finished cell is available.
"""

from __future__ import annotations

import json
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from etendue.archive.journaling.journal import NAME as JOURNAL
from etendue.contract.arrays.colouring import flat_dims
from etendue.contract.arrays.dims import banded
from etendue.contract.wording import Unit, units
from etendue.errors import ArchiveError
from etendue.present.page.brought import sections
from etendue.present.page.document import document, plain
from etendue.present.page.html import page
from etendue.present.page.looks import Picture, picture, pictured
from etendue.present.page.opened import FINISHED, Opened
from etendue.present.page.report import about_stages
from etendue.present.page.shots import strip
from etendue.types.documents import Document

if TYPE_CHECKING:
    from etendue.types.arrays import Array

HELD = 768 * 2**20  # bytes of arrays kept in memory
PATIENCE = 2.0  # minimum seconds between two refreshes of a growing archive
SHARE = 6.0  # and at least this multiple of the duration of a refresh, so that refreshing never dominates
BINS = 96
LONGEST = 16384  # samples of a line
Words = Mapping[str, str]


class HttpRefusal(Exception):
    """A request that cannot be answered: its HTTP status, and the reason."""

    def __init__(self, status: int, why: str) -> None:
        super().__init__(why)
        self.status = status


class Missing(HttpRefusal):
    """A cell that is missing; it may still be computed."""


class Live:
    """An archive, refreshed while its run goes on."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.opened = Opened(folder)
        self.about = about_stages(self.opened)
        self.serial = 1
        self._lock = threading.RLock()
        self._drawn: tuple[int, Document] | None = None
        self._pictures: OrderedDict[tuple[Hashable, ...], Picture] = OrderedDict()
        self._seen, self._state, self._cost = time.monotonic(), self._stat(), 0.5
        self._made()
        self.answers: dict[str, Callable[[Words], tuple[str, bytes, dict[str, str]]]] = {
            "": lambda _: ("text/html; charset=utf-8", page(self.shown("server"), live=True).encode(), {}),
            "state": self._now,
            "document": self._document,
            "picture": self._picture,
            "probe": self._probe,
            "line": self._line,
            "histogram": self._histogram,
        }

    def _stat(self) -> tuple[int, int]:
        found = (self.folder / JOURNAL).stat()
        return found.st_size, found.st_mtime_ns

    @property
    def gone(self) -> bool:
        """Whether the archive is no longer in its place."""
        return not (self.folder / JOURNAL).is_file()

    def refresh(self) -> None:
        """Read the archive again if the last refresh was long enough ago and something was written since."""
        with self._lock:
            if time.monotonic() - self._seen < max(PATIENCE, SHARE * self._cost):
                return
            state = self._stat()
            if state == self._state and not self.opened.running:
                self._seen = time.monotonic()
                return
            begun = time.monotonic()
            try:
                fresh = Opened(self.folder)
            except ArchiveError:  # a run is starting, or files are being moved into place: keep the last state
                self._seen = time.monotonic()
                return
            _ = fresh.progress  # read now, so that its rate belongs to the state shown
            self.opened, self._state = fresh, state
            self.serial += 1
            self._pictures.clear()
            self._seen, self._cost = time.monotonic(), time.monotonic() - begun

    # -- answers --------------------------------------------------------------------------------------

    def shown(self, through: str) -> Document:
        """Return the current document; ``through``: where the page sends its requests, ``server`` or ``frame``."""
        made = self._made()
        return {**made, "live": {**made["live"], "through": through}}

    def _made(self) -> Document:
        with self._lock:
            if self._drawn is None or self._drawn[0] != self.serial:
                made = document(self.opened, self.about)
                if self.opened.ended:
                    made["pictures"] = {"strip": strip(self.opened, made["start"])[0]}
                    made["sections"] = sections(self.opened)
                self._drawn = self.serial, {**made, "live": {"serial": self.serial}}
            return self._drawn[1]

    def _document(self, words: Words) -> tuple[str, bytes, dict[str, str]]:
        return _json(self._made())

    def _now(self, words: Words) -> tuple[str, bytes, dict[str, str]]:
        self.refresh()
        with self._lock:
            failed = sum(1 for _ in self.opened.stored.journal.said.having("failed"))
            return _json(
                {
                    **self.opened.progress,
                    "running": self.opened.running,
                    "ended": self.opened.ended,
                    "serial": self.serial,
                    "failed": failed,
                }
            )

    def _picture(self, words: Words) -> tuple[str, bytes, dict[str, str]]:
        try:
            one = self._asked(words)
        except Missing as error:  # not an error of the caller
            return "application/octet-stream", b"", {"X-Picture": json.dumps({"why": str(error)})}
        gain = 2.0 ** min(20.0, max(-20.0, _number(words, "stops", 0.0)))
        pixels = one.eight_bit(gain)
        rgba = np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)])
        said = {
            "width": one.size[1],
            "height": one.size[0],
            "y": one.origin[0],
            "x": one.origin[1],
            "dy": one.step[0],
            "dx": one.step[1],
            "plane": one.on_plane,
            "scaled": one.scaled,
            "white": one.bright,
            "units": one.units,
        }
        return "application/octet-stream", rgba.tobytes(), {"X-Picture": json.dumps(plain(said), allow_nan=False)}

    def _probe(self, words: Words) -> tuple[str, bytes, dict[str, str]]:
        """Return the values after every stage at one place: at ``y``, ``x`` (um, or samples), or at the fractions
        ``v``, ``u`` of the picture's height and width.
        """
        at, on_plane = self._at(words), words.get("plane") == "1"
        rows = []
        for stage, variable in pictured(self.opened):
            row: Document = {"stage": stage, "variable": variable}
            try:
                one = self._shown(stage, variable, at)
            except ArchiveError as error:
                rows.append({**row, "why": str(error)})
                continue
            if one is None:
                rows.append({**row, "why": self._why(stage, at)})
                continue
            if one.on_plane == on_plane:
                place = one.sample(_number(words, "y"), _number(words, "x"))
            else:
                v, u = _number(words, "v", -1.0), _number(words, "u", -1.0)
                inside = 0 <= v < 1 and 0 <= u < 1
                place = (int(v * one.size[0]), int(u * one.size[1])) if inside else None
            if place is None:
                rows.append({**row, "why": "outside the picture"})
                continue
            values, letters = np.asarray(one.array[..., place[0], place[1]]).ravel(), one.filter_letters()
            rows.append(
                {
                    **row,
                    "row": place[0],
                    "column": place[1],
                    "units": one.units,
                    "filter": "" if letters is None else str(letters[place]),
                    "values": values.tolist(),
                    "labels": _labels(one),
                    "dims": list(one.dims),
                }
            )
        return _json({"rows": rows})

    def _line(self, words: Words) -> tuple[str, bytes, dict[str, str]]:
        """Return the values along a row or column by channel, or by filter letter if the plane has a pattern."""
        one = self._asked(words)
        upright = words.get("along") == "y"
        number = int(_number(words, "at_sample"))
        if not 0 <= number < one.size[1 if upright else 0]:
            raise HttpRefusal(404, "outside the picture")
        series = {}
        for name, plane, mask in _planes(one):
            values = plane[:, number] if upright else plane[number]
            own = mask[:, number] if upright else mask[number]
            if own.any():
                series[name] = [
                    v if keep else None
                    for v, keep in zip(values[:LONGEST].astype(float).tolist(), own[:LONGEST].tolist(), strict=True)
                ]
        axis = 0 if upright else 1
        return _json(
            {
                "series": series,
                "start": one.origin[axis],
                "step": one.step[axis],
                "plane": one.on_plane,
                "units": one.units,
            }
        )

    def _histogram(self, words: Words) -> tuple[str, bytes, dict[str, str]]:
        """Return a histogram of some rows and columns for each channel, with mean, standard deviation, and the
        fractions of samples at 0 and at saturation.
        """
        one = self._asked(words)
        bounds = [
            int(_number(words, name, default))
            for name, default in zip(("y0", "y1", "x0", "x1"), (0, 1e9, 0, 1e9), strict=True)
        ]
        region = (slice(max(0, bounds[0]), max(0, bounds[1])), slice(max(0, bounds[2]), max(0, bounds[3])))
        planes = [(name, plane[region][mask[region]]) for name, plane, mask in _planes(one)]
        planes = [(name, values[np.isfinite(values)].astype(float)) for name, values in planes]
        planes = [(name, values) for name, values in planes if values.size]
        if not planes:
            return _json({"channels": [], "low": 0, "high": 1, "units": one.units})
        low, high = min(v.min() for _, v in planes), max(v.max() for _, v in planes)
        ceiling = self._ceiling(one)
        channels = []
        for name, values in planes:
            counts, _ = np.histogram(values, BINS, (low, high if high > low else low + 1))
            channels.append(
                {
                    "name": name,
                    "counts": counts.tolist(),
                    "samples": int(values.size),
                    "mean": float(values.mean()),
                    "deviation": float(values.std()),
                    "at_zero": float((values <= 0).mean()),
                    "at_top": None if ceiling is None else float((values >= ceiling * (1 - 1e-6)).mean()),
                }
            )
        return _json({"channels": channels, "low": low, "high": high, "units": one.units, "ceiling": ceiling})

    def _ceiling(self, one: Picture) -> float | None:
        """Return the value at which a picture saturates: the largest code, or 1 for values without a unit (relative to
        clipping or white); None if unknown.
        """
        if name := units().get(one.units, Unit()).bits:
            shown = self.opened.record["nodes"].get(one.group.stage, {}).get("shown", {})
            bits = shown.get(name, self.opened.record["shared"].get(name))
            return float(2 ** int(bits) - 1) if isinstance(bits, int) else None
        return 1.0 if one.units == "" else None

    # -- what is asked for ------------------------------------------------------------------------------

    def _at(self, words: Words) -> dict[str, int]:
        """Parse ``gain:2,spacing:0`` into positions on the axes; axes that are not named take their first value."""
        found = {axis.dim: 0 for axis in self.opened.axes}
        for part in filter(None, words.get("at", "").split(",")):
            dim, _, text = part.rpartition(":")
            if dim not in found or not text.isdecimal() or int(text) >= len(self.opened.axis(dim).values):
                raise HttpRefusal(404, "no such position on the axes")
            found[dim] = int(text)
        return found

    def _asked(self, words: Words) -> Picture:
        at, stage, variable = self._at(words), words.get("stage", ""), words.get("variable", "")
        if (stage, variable) not in pictured(self.opened):
            raise HttpRefusal(404, "no such picture")
        try:
            found = self._shown(stage, variable, at)
        except ArchiveError as error:
            raise HttpRefusal(404, str(error)) from None
        if found is None:
            raise Missing(404, self._why(stage, at))
        return found

    def _why(self, stage: str, at: Mapping[str, int]) -> str:
        """Return the reason why there is no picture of a cell."""
        status = self.opened.status(stage, at)
        return "too large to show, or no longer stored" if status.replace(" ", "_") in FINISHED else status

    def _shown(self, stage: str, variable: str, at: Mapping[str, int]) -> Picture | None:
        with self._lock:
            opened = self.opened
            key = (stage, variable, *(at[dim] for dim in opened.reaching(stage)))
            if key in self._pictures:
                self._pictures.move_to_end(key)
                return self._pictures[key]
            found = picture(opened, stage, variable, at)
            if found is not None:
                self._pictures[key] = found
                while sum(own.array.nbytes for own in self._pictures.values()) > HELD and len(self._pictures) > 1:
                    self._pictures.popitem(last=False)
            return found


def _json(value: object) -> tuple[str, bytes, dict[str, str]]:
    return "application/json", json.dumps(plain(value), allow_nan=False, separators=(",", ":")).encode(), {}


def _number(words: Words, name: str, default: float | None = None) -> float:
    try:
        found = float(words[name]) if name in words else default
    except ValueError:
        found = None
    if found is None or not np.isfinite(found):
        raise HttpRefusal(400, f"{name} is not a number")
    return found


def _labels(one: Picture) -> list[str]:
    """Return a label for each value of one sample: its channel, band or frame."""
    found = [""]
    for dim in one.dims:
        found = [f"{before} {label}".strip() for before in found for label in one.labels(dim)]
    return found


def _planes(one: Picture) -> list[tuple[str, Array, Array]]:
    """Return (name, plane, mask) of each channel. For a plane with a pattern, return the plane once per filter letter,
    with the mask of this letter; for bands, return only their mean.
    """
    array = one.array
    for dim in one.dims:
        if dim not in flat_dims():
            array = array[len(array) // 2]
    everywhere = np.ones(one.size, bool)
    if array.ndim == 3:
        if banded(one.dims):
            return [("mean of all bands", np.asarray(array).mean(axis=0), everywhere)]
        return [(name, np.asarray(plane), everywhere) for name, plane in zip(one.labels("channel"), array, strict=True)]
    letters = one.filter_letters()
    if letters is None:
        return [("", np.asarray(array), everywhere)]
    return [
        (str(letter), np.asarray(array), letters == letter)
        for letter in dict.fromkeys(letters.ravel()[: 64 * one.size[1]].tolist())
    ]

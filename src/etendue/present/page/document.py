"""The document behind a page: everything that it shows of an archive, as plain JSON with one blob of packed numbers.

In:  an archive opened for display.
Out: a mapping for ``json.dumps``. Any text in it may be untrusted: display it as plain text only.
"""

from __future__ import annotations

import importlib.metadata
import math
import shlex
import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np

from etendue.contract.arrays.variables import variable, without
from etendue.contract.values import quantities
from etendue.contract.values.tables import preset_keys, tables
from etendue.contract.wording import prefixes
from etendue.present.page.brought import wordings
from etendue.present.page.columns import Columns
from etendue.present.page.figures import Coordinate, MetricColumn, figures
from etendue.present.page.looks import pictured
from etendue.present.page.opened import Opened
from etendue.present.page.opening import opening
from etendue.present.page.tables import NUMBERS, WORDS, Ledger, answer, failures, ledger, measured, stage_rows
from etendue.present.plots.summary.cells import omissions
from etendue.types.documents import Document, DocumentView

FORMAT = 1
MOST_ROWS = 400_000  # largest number of cells with their own rows in the page; above it only sums are shown


def document(opened: Opened, about: Mapping[str, Mapping[str, str]], pictures: DocumentView | None = None) -> Document:
    """Return everything that the page shows. ``about``: descriptions of the installed stages, by name; ``pictures``:
    the pictures embedded in the page.
    """
    columns = Columns()
    table = ledger(opened)
    found, omitted = figures(opened)
    record, pipeline = opened.record, _pipeline(opened)
    first = opening(found, opened.axes, start_of(opened), table)
    if first["front"] and first["front"]["usable"] is not None:
        first["front"]["usable"] = columns.put(first["front"]["usable"], "u1")
    start = first["place"]
    return {
        "format": FORMAT,
        "made_by": f"etendue {importlib.metadata.version('etendue')}",
        "archive": opened.folder.resolve().name,
        "name": str(record["pipeline"]),
        "title": str(pipeline.get("about", {}).get("title", "")) if isinstance(pipeline.get("about"), dict) else "",
        "description": str(pipeline.get("description", "")),
        "running": opened.running,
        "ended": opened.ended,
        "progress": opened.progress,
        "axes": [
            {
                "dim": a.dim,
                "key": a.key,
                "label": a.label,
                "units": a.units,
                "text": a.text,
                "factors": list(a.factors) or None,
                "values": list(a.values),
                "prefix": prefixes().get(a.key, ""),
            }
            for a in opened.axes
        ],
        "start": start,
        "opening": first,
        **wordings(opened),
        "sections": [],
        "stages": stage_rows(opened, table, about),
        "shared": _shared(opened),
        "figures": [_figure(one, columns) for one in found],
        "omitted": [vars(one) for one in omitted],
        "pictured": [
            {"stage": stage, "variable": variable, **_said(opened, stage, variable)}
            for stage, variable in pictured(opened)
        ],
        "pictures": dict(pictures or {}),
        "cells": _cells(opened, table, columns),
        "omissions": omissions(table),
        "failures": failures(table),
        "damaged": sorted(opened.damaged),
        "measured": measured(opened),
        "answer": answer(opened),
        "blame": None,
        "losses_command": _losses_command(opened, start),
        "provenance": _provenance(opened),
        "blob": columns.text(),
    }


def plain(value: Any) -> Any:
    """Convert a document to strict JSON: no NaN, no infinity."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None if math.isnan(value) else "inf" if value > 0 else "-inf"
    if isinstance(value, Mapping):
        return {str(key): plain(own) for key, own in value.items()}
    if isinstance(value, list | tuple):
        return [plain(own) for own in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    return value


def start_of(opened: Opened) -> dict[str, int]:
    """Return the position on each axis at which a page and the contact sheet start: the position of the pipeline's own
    value if it is on the axis, else the middle.
    """
    written = _pipeline(opened)
    said = {
        *(name for table in tables() for name in written.get(table, {})),
        *(key.partition(".")[2] for key in opened.record.get("overrides", {})),
    }
    start = {}
    for axis in opened.axes:
        own = opened.record["shared"].get(axis.key) if axis.key in said else None
        given = opened.record["axes"].get(axis.key) or list(axis.values)
        if not isinstance(own, int | float | str) or own not in axis.places:
            own = given[len(given) // 2]
        start[axis.dim] = axis.places.get(own, len(axis.values) // 2)
    return start


def _losses_command(opened: Opened, start: Mapping[str, int]) -> str:
    """Return the command that computes each stage's share of the losses in the cell that the page shows first.

    Return '' if there is no pipeline file, or if stages, presets or rows of a design are swept: a name on such an axis
    stands for several values, which no option can set.
    """
    last = sorted((opened.folder / "runs").glob("*.toml"))
    if not last or any(
        len(axis.values) > 1 and (axis.key in preset_keys() or axis.key.endswith(".use") or axis.factors)
        for axis in opened.axes
    ):
        return ""
    words = ["etendue", "losses", f"{opened.folder.resolve().name}/runs/{last[-1].name}"]
    for axis in opened.axes:
        if len(axis.values) > 1:
            name = axis.key if "." in axis.key else f"{opened.record['table']}.{axis.key}"
            words += ["--set", f"{name}={axis.values[start[axis.dim]]}"]
    return shlex.join(words)


def _pipeline(opened: Opened) -> Document:
    try:
        return tomllib.loads(str(opened.record.get("text", "")))
    except (tomllib.TOMLDecodeError, RecursionError):
        return {}


def _shared(opened: Opened) -> list[Document]:
    """Return the shared quantities, with units, that are not swept and that at least one stage has used."""
    used = {name for node in opened.record["nodes"].values() for name in node.get("shown", {})}
    swept = {axis.key for axis in opened.axes}
    rows = []
    for name, value in opened.record["shared"].items():
        if name in used and name not in swept:
            quantity = quantities.declared(name) if name in quantities.names() else None
            units = quantity.units if quantity else ""
            rows.append(
                {
                    "name": name,
                    "value": value,
                    "units": "" if units == "1" else units,
                    "what": quantity.doc if quantity else "",
                }
            )
    return rows


def _said(opened: Opened, stage: str, variable: str) -> dict[str, str]:
    attrs = next(group.data[variable].attrs for group in opened.groups[stage] if variable in group.variables)
    units = str(attrs.get("units", "1"))
    return {"label": str(attrs.get("long_name", variable)) + without(attrs), "units": "" if units == "1" else units}


def _figure(one: MetricColumn, columns: Columns) -> Document:
    dims = [
        {
            "name": dim,
            "size": size,
            "coordinates": [_coordinate(c, columns) for c in one.coordinates[dim]],
        }
        for dim, size in zip(one.dims, one.values.shape[len(one.axes) :], strict=True)
    ]
    return {
        "stage": one.stage,
        "variable": one.variable,
        "label": one.label,
        "units": one.units,
        "axes": list(one.axes),
        "dims": dims,
        "meanings": list(one.meanings),
        "better": variable(one.variable).better,
        "curve": variable(one.variable).curve,
        "data": columns.put(one.values),
    }


def _coordinate(one: Coordinate, columns: Columns) -> Document:
    said = {"name": one.name, "label": one.label, "units": one.units, "axes": list(one.axes)}
    if one.values.dtype.kind in "fiu":
        return {**said, "data": columns.put(one.values, "f8")}
    return {**said, "labels": [str(v) for v in one.values.ravel().tolist()]}


def _cells(opened: Opened, table: Ledger, columns: Columns) -> Document:
    """Pack the columns of the ledger; for a ledger of more than ``MOST_ROWS`` rows, return only the number of rows."""
    rows = len(table["stage"])
    if rows > MOST_ROWS:
        return {"rows": rows, "columns": {}, "at": {}}
    packed = {name: columns.words(table[name]) for name in WORDS if name != "message"}
    packed |= {name: columns.put(table[name]) for name in NUMBERS}
    at = {}
    for axis in opened.axes:
        if axis.dim in table["at"]:
            places = axis.places
            at[axis.dim] = columns.put([places.get(v, len(axis.values)) for v in table["at"][axis.dim].tolist()], "u4")
    return {"rows": rows, "columns": packed, "at": at}


def _provenance(opened: Opened) -> Document:
    record = opened.record
    last = sorted((opened.folder / "runs").glob("*.toml"))
    return {
        "began": str(record.get("began", "")),
        "runs": len(opened.runs),
        "platform": record.get("platform", {}),
        "libraries": record.get("libraries", {}),
        "options": record.get("options", {}),
        "overrides": record.get("overrides", {}),
        "preset": str(record.get("preset", "")),
        "stated": record.get("stated", {}),
        "text": str(record.get("text", "")),
        "distributions": sorted({d for node in record["nodes"].values() for d in node.get("distributions", [])}),
        "pipeline_file": f"runs/{last[-1].name}" if last else "",
    }

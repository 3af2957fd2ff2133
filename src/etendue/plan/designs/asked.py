"""The design that a pipeline requests: method, points, seed, factors, correlations, rows.

In:  ``[design]`` as written, the pipeline's folder.
Out: ``Asked``, and one fault for each entry that is wrong.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

from etendue.contract.values.bounds import LARGEST_FILE
from etendue.contract.values.units import as_written
from etendue.errors import Fault, nearest
from etendue.pipeline.file import PipelineFile
from etendue.pipeline.overrides import axis_name
from etendue.pipeline.zipped import LONGEST, SAMPLE
from etendue.plan.designs.distributions import KEYS as FORMS
from etendue.plan.designs.points import METHODS, positive, rows_of
from etendue.plan.wiring.parameters import Unfit, resolve_file
from etendue.types.documents import Document, DocumentView

KEYS = ("method", "points", "seed", "factors", "correlation", "file", "rows")


@dataclass(frozen=True)
class Asked:
    """The requested design."""

    method: str
    points: int
    seed: int
    factors: DocumentView = field(default_factory=dict)  # by key, as written; of a list: the values of all rows
    correlated: tuple[tuple[float, ...], ...] = ()
    rows: tuple[int, ...] = ()  # those to compute; all if empty

    @property
    def per_point(self) -> int:
        """The number of rows of one point."""
        return rows_of(self.method, 1, len(self.factors))

    @property
    def drawn(self) -> int:
        """The number of points that are drawn: the requested number, or more if requested rows lie beyond it."""
        fixed = self.method in ("lhs", "list") or not self.rows
        return self.points if fixed else max(self.points, max(self.rows) // self.per_point + 1)

    @property
    def count(self) -> int:
        """The number of rows that are drawn."""
        return self.drawn * self.per_point

    @property
    def chosen(self) -> tuple[int, ...]:
        """The rows to compute."""
        return self.rows or tuple(range(self.points * self.per_point))


def asked_of(pipeline: PipelineFile, faults: list[Fault]) -> Asked | None:
    """Return the design that a pipeline requests; None if it requests none, or if the request has too many faults."""
    design = pipeline.design
    if not design:
        return None
    before = len(faults)
    for key in design:
        if key not in KEYS and not key.startswith("factors."):
            faults.append(Fault(f"design.{key}", f"unknown key{nearest(key, KEYS)}"))
    method = design.get("method", "sobol")
    if method not in METHODS:
        faults.append(Fault("design.method", f"{as_written(method)} is not a method{nearest(str(method), METHODS)}"))
        return None
    factors = factors_of(design, pipeline)
    if method == "list":
        factors = _listed(pipeline, faults)
    elif "file" in design:
        faults.append(Fault("design.file", f"only method 'list' reads a file; this is {method!r}"))
    points = _whole(design, "points", len(next(iter(factors.values()), ())) if method == "list" else 0, 1, faults)
    rows = _rows(design, faults)
    if not factors and len(faults) == before:
        faults.append(Fault("design.factors", "expected at least one factor, such as f = { from = 1, to = 2 }"))
    for key in factors.keys() & pipeline.sweep.keys() - {k for k, one in pipeline.zipped.items() if one.dim == SAMPLE}:
        faults.append(Fault(f"design.factors.{key}", "is also an axis of [sweep]; remove one of them"))
    found = Asked(
        method,
        points,
        _whole(design, "seed", 0, 0, faults),
        factors,
        _correlated(design, method, list(factors), faults),
        rows,
    )
    if len(faults) > before:
        return None
    if text := _too_many(found):
        faults.append(Fault("design.points", f"{text}: expected at most {min(LONGEST, found.count)}"))
        return None
    return found


def _rows(design: DocumentView, faults: list[Fault]) -> tuple[int, ...]:
    """Return the rows to compute, as written in the file; () for all rows."""
    written = design.get("rows", ())
    rows = tuple(written) if isinstance(written, list | tuple) else (-1,)
    if not all(isinstance(row, int) and not isinstance(row, bool) and 0 <= row < LONGEST for row in rows):
        faults.append(Fault("design.rows", f"expected numbers of rows, from 0 to {LONGEST - 1}"))
    elif len(set(rows)) < len(rows):
        faults.append(Fault("design.rows", "expected distinct rows"))
    return rows


def _too_many(asked: Asked) -> str:
    """Return the part of a request that lies beyond the end of a design; '' if there is none."""
    if asked.count > LONGEST:
        return f"{asked.count} rows"
    last = max(asked.rows, default=-1)
    return f"row {last} of {asked.count}" if asked.method in ("lhs", "list") and last >= asked.count else ""


def factors_of(design: DocumentView, pipeline: PipelineFile) -> Document:
    """Return the factors as written in the file, by name."""
    written = design.get("factors", {})
    flat: Document = {key.removeprefix("factors."): value for key, value in design.items() if key[:8] == "factors."}
    for key, value in {**(written if isinstance(written, Mapping) else {}), **flat}.items():
        if (
            isinstance(value, Mapping)
            and not set(value) & set(FORMS)
            and key in {entry.name for entry in pipeline.stages}
        ):
            flat.pop(key, None)
            flat |= {f"{key}.{name}": one for name, one in value.items()}
        else:
            flat[key] = value
    document = {"stages": [{"name": entry.name, "use": entry.use} for entry in pipeline.stages]}
    return {axis_name(key, document): value for key, value in flat.items()}


def _whole(design: DocumentView, key: str, default: int, least: int, faults: list[Fault]) -> int:
    value = design.get(key, default)
    if isinstance(value, int) and not isinstance(value, bool) and least <= value <= 2**63:
        return value
    faults.append(Fault(f"design.{key}", f"expected a whole number of at least {least}, got {as_written(value)}"))
    return least


def _correlated(
    design: DocumentView, method: str, keys: list[str], faults: list[Fault]
) -> tuple[tuple[float, ...], ...]:
    """Return the matrix of correlations of all factors, from ``correlation = [["a", "b", 0.5]]``; () for none."""
    written = design.get("correlation", [])
    if not written:
        return ()
    place = "design.correlation"
    matrix = [[float(i == j) for j in range(len(keys))] for i in range(len(keys))]
    for one in written if isinstance(written, list) else [written]:
        fits = isinstance(one, list) and len(one) == 3 and one[0] in keys and one[1] in keys and one[0] != one[1]
        if not fits or not isinstance(one[2], int | float | Decimal) or not -1 < float(one[2]) < 1:
            text = f'expected [["FACTOR", "FACTOR", -1 to 1], ..], got {as_written(one)}'
            faults.append(Fault(place, f"{text}; the factors are {', '.join(keys)}"))
            return ()
        i, j = keys.index(one[0]), keys.index(one[1])
        matrix[i][j] = matrix[j][i] = float(one[2])
    if method in ("saltelli", "list"):
        why = (
            "Sobol' indices require independent factors"
            if method == "saltelli"
            else "the samples of a list already have correlations"
        )
        faults.append(Fault(place, f"not with method {method!r}: {why}"))
    elif not positive(matrix):
        faults.append(Fault(place, "no factors can have these correlations at once; make some of them smaller"))
    return tuple(map(tuple, matrix))


def _listed(pipeline: PipelineFile, faults: list[Fault]) -> Document:
    """Return the columns of the CSV file of a list design, by factor."""
    place, name = "design.file", pipeline.design.get("file")
    if not isinstance(name, str):
        faults.append(Fault(place, "method 'list' needs the name of a CSV file with a column per factor"))
        return {}
    try:
        path = resolve_file(name, pipeline.folder)
        return _columns(path)
    except Unfit as error:
        faults.append(Fault(place, str(error)))
    return {}


def _columns(path: Path) -> Document:
    if path.stat().st_size > LARGEST_FILE:
        raise Unfit(f"the file is larger than {LARGEST_FILE} bytes")
    try:
        lines = list(csv.reader(path.read_text("utf-8-sig").splitlines()))
    except (csv.Error, UnicodeDecodeError) as error:
        raise Unfit(f"is not a CSV file: {error}") from None
    lines = [[cell.strip() for cell in line] for line in lines if any(cell.strip() for cell in line)]
    if len(lines) < 2:
        raise Unfit("expected a line of names of factors, and a line of values for every sample")
    names = lines[0]
    for number, line in enumerate(lines[1:], 2):
        if len(line) != len(names):
            raise Unfit(f"line {number} has {len(line)} values, but there are {len(names)} factors")
    if len(set(names)) < len(names) or not all(names):
        raise Unfit(f"expected distinct names in its first line, got {', '.join(names)}")
    return {name: [_value(line[at]) for line in lines[1:]] for at, name in enumerate(names)}


def _value(text: str) -> Any:
    if text in ("true", "false"):
        return text == "true"
    try:
        number = Decimal(text)
    except InvalidOperation:
        return text
    return int(number) if text.lstrip("+-").isdigit() else number

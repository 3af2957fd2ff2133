"""A plot: a figure with the numbers in it, saved completely or not at all.

In:  a matplotlib ``Figure`` and rows of numbers.
Out: a PNG, SVG or PDF; the numbers as CSV.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from io import BytesIO, StringIO
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from etendue.errors import RequestError
from etendue.process import SharedChange

SUFFIXES = (".png", ".svg", ".pdf", ".csv")
DPI = 150
STYLE: Any = {"svg.hashsalt": "etendue", "svg.fonttype": "none", "pdf.fonttype": 42, "font.family": "DejaVu Sans"}
UNDATED = {
    "png": {"Software": "etendue"},
    "svg": {"Date": None, "Creator": "etendue"},
    "pdf": {"CreationDate": None, "Creator": "etendue"},
}


# shared because matplotlib has one style for all threads
OUR_STYLE = SharedChange(lambda: resolve_name("matplotlib:rc_context")(STYLE))


@dataclass
class Plot:
    """A plot that notebooks show and ``save`` writes.

    Attributes
    ----------
    figure : matplotlib.figure.Figure
        Made without pyplot, so pyplot keeps no reference to it.
    columns, rows : names and values of what is plotted, a row for each number
    notes : texts that say what was chosen, left out or unknown
    """

    figure: Any
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[object]] = ()
    notes: list[str] = field(default_factory=list)
    dpi: int = DPI

    def save(self, path: str | Path) -> Path:
        """Write the plot; the suffix sets the format: .png, .svg, .pdf, or .csv for the numbers alone.

        Raises
        ------
        RequestError
            Another suffix.
        """
        path = Path(path)
        data = self.data(check_suffix(path))
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
        try:
            partial.write_bytes(data)
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
        return path

    def data(self, kind: str) -> bytes:
        """Return the bytes of a file. Drawing the same plot again gives the same bytes."""
        if kind == "csv":
            text = StringIO()
            writer = csv.writer(text, lineterminator="\n")
            writer.writerow(self.columns)
            writer.writerows(self.rows)
            return text.getvalue().encode()
        found = BytesIO()
        with OUR_STYLE:
            self.figure.savefig(found, format=kind, dpi=self.dpi, metadata=UNDATED[kind])
        return found.getvalue()

    def _repr_png_(self) -> bytes:
        return self.data("png")


def check_suffix(path: Path) -> str:
    """Return ``png`` for ``map.png``.

    Raises
    ------
    RequestError
        The suffix is not supported.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise RequestError(f"{path}: unknown file type; the suffix must be one of {', '.join(SUFFIXES)}")
    return path.suffix.lower()[1:]


def new_figure(width: float, height: float, layout: Any = "constrained") -> Any:
    """Return an empty figure of a size in inches, with its own canvas."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with OUR_STYLE:
        figure = Figure(figsize=(width, height), dpi=DPI, layout=layout, facecolor="white")
    FigureCanvasAgg(figure)
    return figure

"""The section of a page on a design: its samples, and the factors that matter for the usual metrics.

In:  the tree of an archive.
Out: paragraphs, tables and pictures; nothing for a grid.
"""

from __future__ import annotations

from pathlib import Path

import xarray

from etendue.archive.read.studies import stored_studies
from etendue.archive.records.rerun import recorded
from etendue.errors import EtendueError
from etendue.present.plots.asked import PlotRequest
from etendue.present.plots.drawing.samples import parallel, scatter
from etendue.present.plots.kinds import shown_at
from etendue.present.plots.plot import Plot
from etendue.types.documents import Document, DocumentView
from etendue_lab.designs.drawing import bars, converging, yield_curve
from etendue_lab.designs.samples import Samples, samples_of
from etendue_lab.designs.sensitivity import sensitivity
from etendue_lab.designs.stored import STUDY
from etendue_lab.designs.terminal import interval_text

MOST_COLUMNS = 9  # largest number in a scatter matrix that is readable on a page


def section(tree: xarray.DataTree) -> list[Document]:
    """Return the blocks of the section."""
    source = str(tree.encoding.get("source", ""))
    if not source or not recorded(Path(source).parent).pipeline().design:
        return []
    samples = samples_of(Path(source).parent)
    holdings, middle = samples.holdings, shown_at(samples.holdings)
    lines = parallel(holdings, middle=middle)
    names = [str(name) for name in lines.columns if "." in str(name)]
    blocks: list[Document] = [
        {"paragraph": f"{len(samples.numbers)} samples of a design ({samples.method})."},
        _picture(lines, "every sample as a line over factors and metrics"),
    ]
    if len(lines.columns) - 1 <= MOST_COLUMNS:
        blocks.append(_picture(scatter(holdings, names, middle=middle), "factors and metrics against each other"))
    studied = (one.attributes.get("metric") for one in stored_studies(Path(source).parent) if one.command == STUDY)
    for name in dict.fromkeys([*names, *(str(one) for one in studied)]):
        blocks += _of_metric(samples, name, middle)
    return blocks


def _of_metric(samples: Samples, name: str, middle: DocumentView) -> list[Document]:
    found: list[Document] = []
    held = samples.holdings.find(name)
    at = {dim: middle.get(dim, held.values_of(dim)[0]) for dim in held.axes if dim != "sample"}
    asked = PlotRequest((name,), at={dim: str(value) for dim, value in at.items()}, middle=middle)
    try:
        one = sensitivity(samples, [name], asked.at)["metrics"][0]
    except EtendueError as error:
        return [{"paragraph": str(error)}]
    head = ["factor", "first order", "total", "main effect", "regression", "rank correlation"]
    rows = [
        [
            row["factor"],
            interval_text(row["first"]),
            interval_text(row["total"]),
            f"{row['main_effect']:.3f}",
            interval_text(row["regression"]),
            "-" if row["rank"] is None else f"{row['rank']:.2f}",
        ]
        for row in one["factors"]
    ]
    where = f" at {one['said']}" if one["said"] else ""
    said = f"{one['title']}{where}: importance of the factors. {' '.join(f'{note}.' for note in one['notes'])}"
    found += [{"paragraph": said.strip()}, {"table": {"head": head, "rows": rows}}]
    subjects = [
        [own["subject"], ", ".join(own["factors"]), f"{own['sum']:.3f}", interval_text(own["closed"])]
        for own in one["subjects"]
    ]
    if len(subjects) > 1:
        found.append({"table": {"head": ["stage", "factors", "sum alone", "together"], "rows": subjects}})
    found.append(_picture(bars(one, f"what matters, {one['title']}{where}"), f"indices of {name}"))
    for draw, alt in ((converging, f"convergence for {name}"), (yield_curve, f"yield over a limit of {name}")):
        found.append(_picture(draw(samples.holdings, asked), alt))
    return found


def _picture(plot: Plot, alt: str) -> Document:
    return {"picture": plot.data("png"), "alt": alt}

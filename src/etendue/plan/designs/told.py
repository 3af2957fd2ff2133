"""The lines of text about the design of a plan.

In:  the document of ``etendue plan --json``.
Out: lines of text.
"""

from __future__ import annotations

from etendue.types.documents import Document, DocumentView


def design_lines(document: Document) -> list[str]:
    """Return lines with the factors, shared cells and discrepancy of a design; no lines for a plan without design."""
    own = document.get("design")
    if not own:
        return []
    rows = f"{own['rows']} rows" if own["rows"] != own["points"] else f"{own['points']} points"
    texts = [f"design    {own['method']}, {rows}, seed {own['seed']}"]
    texts += [f"factor    {name}: {_said(one)}" for name, one in own["factors"].items()]
    texts += [
        f"set       {key} = {value} in all rows, so that rows differ only by their factors"
        for key, value in own["compared"].items()
    ]
    if own["cells_unshared"] > own["cells"]:
        share = own["cells"] / own["cells_unshared"]
        apart = f"{own['cells_unshared']} if no two rows had a value in common"
        texts.append(f"shared    {own['cells']} cells; {apart} ({share:.0%})")
    if own["discrepancy"] is not None:
        less = own["discrepancy_without_levels"]
        beside = f"; {less:.3g} without levels" if less != own["discrepancy"] else ""
        texts.append(f"spread    discrepancy {own['discrepancy']:.3g}{beside}")
    points = own["points"]
    if own["method"] in ("sobol", "saltelli") and points & (points - 1):
        low = 1 << (points.bit_length() - 1)
        texts.append(f"          {points} points are not a power of two: {low} or {2 * low} fill space more evenly")
    return texts


def _said(one: DocumentView) -> str:
    units = f" {one['units']}" if one["units"] not in (None, "1") else ""
    ends = f", {one['from']:.4g} .. {one['to']:.4g}{units}" if one["from"] is not None else ""
    levels = f", {one['levels']} levels" if one["levels"] else ""
    return f"{one['distribution']}{levels}, {one['distinct']} values{ends}"

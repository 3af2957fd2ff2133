"""The results that the command ``sensitivity`` stores in an archive: a group for every metric, with the keys of the
cells that were used.

In:  the document of a study, the folder of its archive.
Out: groups ``sensitivity/METRIC`` of plain arrays along ``factor``, opened by plain xarray.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from etendue.archive.places import is_url
from etendue.archive.read.studies import CELLS, KEYS, finished_cells
from etendue.archive.write.studies import store_study
from etendue.errors import EtendueError
from etendue.types.documents import Document

STUDY = "sensitivity"
SHARE = "share of the variance"
COLUMNS = {  # array name: its key in the document, and its description
    "first_order": ("first", "first-order index: share of the variance explained by the factor alone"),
    "total": ("total", "total index: share explained by the factor alone and in interaction with others"),
    "main_effect": ("main_effect", "share of the variance explained by the mean over the factor"),
    "regression": ("regression", "standardised regression coefficient"),
    "rank_correlation": ("rank", "rank correlation of Spearman"),
}
SAID = ("metric", "title", "units", "samples", "points", "mean", "deviation", "explained", "said", "notes")


def store(folder: Path, place: Path | str, document: Document) -> Document:
    """Store the indices of every metric; return their path, or the reason why they were not stored."""
    if is_url(place):
        return {"groups": [], "why": "an archive on an object store is only read"}
    groups = {_name(one): _group(folder, document, one) for one in document["metrics"]}
    try:
        store_study(folder, STUDY, groups)
    except (EtendueError, OSError) as error:
        return {"groups": [], "why": str(error).strip().split("\n")[-1]}
    return {"groups": [f"{STUDY}/{name}" for name in groups], "why": ""}


def _name(one: Document) -> str:
    """Return the name of the group that stores a metric: the metric's name and its values on other axes."""
    at = "".join(f",{dim}={value}" for dim, value in one["at"].items() if dim != "stage")
    return re.sub(r"[^\w.,=+-]", "_", f"{one['metric']}{at}")


def _group(folder: Path, document: Document, one: Document) -> Document:
    stage = str(one["metric"]).partition(".")[0]
    rows, cells = one["factors"], finished_cells(folder, stage)
    arrays: dict[str, Any] = {
        "factor": (("factor",), [row["factor"] for row in rows], {"long_name": "factor of the design"}),
        "subject": (
            ("factor",),
            [row["subject"] for row in rows],
            {"long_name": "role of the stage to which the factor belongs"},
        ),
        "end": (("end",), ["low", "high"], {"long_name": "end of the 95 % interval"}),
        CELLS: ((CELLS,), list(cells), {"long_name": "cell from which the indices were computed"}),
        KEYS: ((CELLS,), list(cells.values()), {"long_name": "its key"}),
    }
    for name, (word, about) in COLUMNS.items():
        own = [row[word] for row in rows]
        if all(value is None for value in own):
            continue
        pairs = [value if isinstance(value, dict) else {"value": value} for value in own]
        arrays[name] = (("factor",), _numbers(pairs, "value"), {"long_name": about, "units": "1"})
        if any("low" in pair for pair in pairs):
            ends = np.stack([_numbers(pairs, end) for end in ("low", "high")], axis=-1)
            arrays[f"{name}_interval"] = (("factor", "end"), ends, {"long_name": f"{about}: interval", "units": "1"})
    if one["convergence"]:
        steps = one["convergence"]
        told = np.array([[own["value"] for own in step["factors"]] for step in steps])
        arrays["points"] = (("points",), [step["points"] for step in steps], {"long_name": "points of the design"})
        what = "total index" if one["points"] else "regression coefficient"
        arrays["convergence"] = (("points", "factor"), told, {"long_name": f"{what} of the first points", "units": "1"})
    attrs = {word: value for word in SAID if (value := one[word]) is not None}
    place = {dim: str(value) for dim, value in one["at"].items()}
    return {
        "attrs": {**attrs, "stage": stage, "at": json.dumps(place), "method": document["method"]},
        "arrays": arrays,
    }


def _numbers(pairs: list[Document], word: str) -> Any:
    return np.array([np.nan if pair.get(word) is None else pair[word] for pair in pairs], float)

"""The error of the answer: it is printed after every headline metric, and in one row for every other wanted variable.

In:  the stored errors (``AnswerErrors.document()``).
Out: texts and a table on stdout.
"""

from __future__ import annotations

import math
from collections.abc import Container

from etendue.present.terminal.answer_texts import notes, number, parts_text, says_enough, size, unknown_parts
from etendue.present.terminal.terminal import _out, _table, escape, print_plan
from etendue.types.documents import Document, DocumentView

PLUS_MINUS = "\u00b1"
SHOWN = 8  # rows; smaller errors are summarised in one line


def print_answers(document: DocumentView | None, headlines: Container[str] = ()) -> None:
    """Print the errors of pictures, curves and further metrics, and the errors that could not be measured.

    ``document``: None if no run has measured the errors. ``headlines``: variables that are skipped here, because their
    errors are printed next to their values.
    """
    out = _out()
    if document is None:
        out.print("error of the answer: known after a run")
        return
    known = [(name, one) for name, one in document["errors"].items() if says_enough(one)]
    errors = [(name, one) for name, one in known if size(one) != 0 and one["variable"] not in headlines]
    errors.sort(key=lambda pair: (bool(pair[1]["unit"]), 0.0 if pair[1]["unit"] else -size(pair[1])))
    rows: list[Document] = [
        {**one, "name": name, "mostly": parts_text(one, missing=False)} for name, one in errors[:SHOWN]
    ]
    if rows:
        over = "" if max(number(one["scaled"]) for _, one in errors) == 1 else ", at any point of the sweep"
        out.print(
            _table(
                f"error of the answer: estimated error of each result{over}",
                ("variable", "left", "name"),
                ("error", "right", _error),
                ("largest", "right", _largest),
                ("parts", "left", "mostly"),
                rows=rows,
                wrap=("parts",),
            )
        )
        out.print("pictures and curves: rms and largest error relative to full scale; numbers: the largest error")
    if len(errors) > SHOWN:
        out.print(f"{len(errors) - SHOWN} more variables: --json")
    exact = [name for name, one in known if size(one) == 0]
    if exact:
        out.print(f"no numerical error: {exact[0] if len(exact) == 1 else f'{len(exact)} variables'}")
    for text in notes(document, remedied=bool(headlines)):
        out.print(escape(text))


def _error(row: DocumentView) -> str:
    """Return the error: for pictures and curves the rms relative to full scale, for numbers the largest error in their
    unit.
    """
    value = size(row)
    if math.isnan(value):
        return "unknown"
    unit = row["unit"] if row["unit"] != "1" else ""
    return f"{'at least ' if unknown_parts(row) else ''}{PLUS_MINUS if row['unit'] else ''}{value:.2g} {unit}".rstrip()


def _largest(row: DocumentView) -> str:
    """Return the largest error within a picture or a curve."""
    value = number(row["max"])
    return "" if math.isnan(value) or row["unit"] else f"{value:.2g}"


def print_plan_with_errors(document: Document) -> None:
    """Print a plan, and the errors of its answer if a run has measured them."""
    print_plan(document)
    print_answers(document["answer"])

"""The error of the answer: printed after every headline metric, and in a row for each other wanted variable.

In:  the stored errors (``AnswerErrors.document()``).
Out: texts and a table on stdout.
"""

from __future__ import annotations

import math

from etendue.present.terminal.answer_texts import notes, number, parts_text, says_enough, unknown_parts
from etendue.present.terminal.terminal import _out, _table, escape, print_plan
from etendue.types.documents import Document, DocumentView

PLUS_MINUS = "\u00b1"
SHOWN = 8  # rows; smaller errors are summarised in one line


def print_answers(document: DocumentView | None) -> None:
    """Print the errors of pictures, curves and further metrics, and what could not be measured. None: no run has
    measured them.
    """
    out = _out()
    if document is None:
        out.print("error of the answer: known after a run")
        return
    known = [(name, one) for name, one in document["errors"].items() if says_enough(one)]
    errors = [(name, one) for name, one in known if number(one["rms"]) != 0]  # wanted variables come first
    rows: list[Document] = [
        {**one, "name": name, "mostly": parts_text(one, missing=False)} for name, one in errors[:SHOWN]
    ]
    if rows:
        out.print("")
        out.print(
            "The errors in the first table are of single stages, relative to full scale; those here are of results, "
            "discretisation included."
        )
        out.print(
            _table(
                "error of the answer: its change if what can be refined is refined",
                ("variable", "left", "name"),
                ("error (rms)", "right", _error),
                ("largest", "right", _largest),
                ("parts", "left", "mostly"),
                rows=rows,
                wrap=("parts",),
            )
        )
    if len(errors) > SHOWN:
        out.print(f"{len(errors) - SHOWN} more variables: --json")
    exact = [name for name, one in known if number(one["rms"]) == 0]
    if exact:
        out.print(f"no numerical error: {exact[0] if len(exact) == 1 else f'{len(exact)} variables'}")
    for text in notes(document):
        out.print(escape(text))


def _error(row: DocumentView) -> str:
    """Return the error: of pictures and curves the rms, relative to full scale; of numbers in their unit."""
    value = number(row["rms"])
    if math.isnan(value):
        return "unknown"
    unit = row["unit"] if row["unit"] != "1" else ""
    return f"{'at least ' if unknown_parts(row) else ''}{PLUS_MINUS if row['unit'] else ''}{value:.2g} {unit}".rstrip()


def _largest(row: DocumentView) -> str:
    """Return the largest error within a picture, a curve, or a row of numbers; '' if there is only one."""
    value = number(row["max"])
    return "" if math.isnan(value) or (row["unit"] and value == number(row["rms"])) else f"{value:.2g}"


def print_plan_with_errors(document: Document) -> None:
    """Print a plan, and the errors of its answer if a run has measured them."""
    print_plan(document)
    print_answers(document["answer"])

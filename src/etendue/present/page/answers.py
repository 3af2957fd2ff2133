"""The error of the answer on a page: behind every metric, and for pictures.

In:  an archive opened for display.
Out: texts by stage and variable, for the point that was measured and for the whole sweep; None if nothing was measured.
"""

from __future__ import annotations

from etendue.archive.records.remembered import ANSWER, latest
from etendue.present.page.opened import Opened
from etendue.present.terminal.answer_texts import notes, number, parts_text, plus_minus
from etendue.types.documents import Document, DocumentView

MOST_PICTURES = 3


def answer(opened: Opened) -> Document | None:
    """Return what is known of the errors of an archive's metrics and pictures."""
    stored = latest(opened.folder, ANSWER)
    if stored is None:
        return None
    try:
        return {
            "at": _position(opened, stored["at"]),
            "here": _texts(stored["shown"]),
            "sweep": _texts(stored["errors"]),
            "pictures": _pictures(stored["errors"]),
            "notes": notes(stored),
        }
    except (KeyError, TypeError, ValueError, AttributeError):  # written by another version, or damaged
        return None


def _position(opened: Opened, at: DocumentView) -> dict[str, int]:
    """Return the position on the axes of the archive; -1 for a value that is not there."""
    return {axis.dim: axis.places.get(at.get(axis.dim), -1) for axis in opened.axes}


def _texts(errors: DocumentView) -> Document:
    return {f"{one['stage']}.{one['variable']}": plus_minus(one, one["unit"]) for one in errors.values() if one["unit"]}


def _pictures(errors: DocumentView) -> list[str]:
    """Return sentences about the pictures and curves with the largest errors."""
    own = sorted(
        (one for one in errors.values() if not one["unit"] and one["parts"]), key=lambda one: -number(one["rms"])
    )
    return [
        f"{one['variable']}: {number(one['rms']):.1g} of full scale rms, {number(one['max']):.1g} at most"
        f"{f' ({parts})' if (parts := parts_text(one)) else ''}"
        for one in own[:MOST_PICTURES]
    ]

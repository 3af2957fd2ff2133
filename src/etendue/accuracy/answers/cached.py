"""Errors of answers in the user's cache, by the keys of the wanted cells. This module imports little, because every
plan reads the cache.

In:  a plan.
Out: the stored document (``AnswerErrors.document()``), or None.
"""

from __future__ import annotations

import json

from etendue import cache
from etendue.plan.identity.keys import digest
from etendue.plan.model import Plan
from etendue.plan.shown import answers, shown_place
from etendue.present.terminal.answer_texts import is_sound
from etendue.types.documents import Document

KIND = "answer"
FORM = 7  # version of the stored documents and of how errors are measured: increase it to discard earlier ones


def cached(plan: Plan) -> Document | None:
    """Return the errors that an earlier run of the same cells has measured; None if there are none."""
    try:
        found = json.loads(cache.read(KIND, answer_key(plan)) or b"null")
    except ValueError:
        return None
    return {**found, "remembered": True} if is_sound(found) else None


def answer_key(plan: Plan) -> str:
    """Return the key of the errors of a plan. It depends on the keys of all cells whose values are reported, on the
    point whose results are shown, and on the parameters that the file sets, because these are not refined.
    """
    cells = [[stage, name, [cell.key for cell in plan.of(stage)]] for stage, name in answers(plan)]
    written = [[node.name, *(sorted(one.written) for one in node.alternatives)] for node in plan.nodes]
    place = sorted((dim, str(value)) for dim, value in shown_place(plan).items())
    return digest(json.dumps([KIND, FORM, cells, written, place]).encode())

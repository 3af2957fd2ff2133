"""Errors of answers in the user's cache, by the keys of the wanted cells. Imports little: every plan looks here.

In:  a plan.
Out: the stored document (``AnswerErrors.document()``), or None.
"""

from __future__ import annotations

import json

from etendue import cache
from etendue.plan.identity.keys import digest
from etendue.plan.model import Plan
from etendue.types.documents import Document

KIND = "answer"
FORM = 1  # version of the stored documents and of how errors are measured: increase it to discard earlier ones


def cached(plan: Plan) -> Document | None:
    """Return the errors that a run of the same cells has measured."""
    try:
        found = json.loads(cache.read(KIND, answer_key(plan)) or b"null")
    except ValueError:
        return None
    return {**found, "remembered": True} if isinstance(found, dict) and "errors" in found else None


def answer_key(plan: Plan) -> str:
    """Return the key of the errors of a plan: it depends on the keys of all cells that are wanted."""
    cells = [[stage, name, [cell.key for cell in plan.of(stage)]] for stage, name in plan.wanted]
    return digest(json.dumps([KIND, FORM, cells]).encode())

"""The error of the answer of a run. This error is measured once; later runs of the same cells read it from the archive
or the user's cache.

In:  a run, a budget of seconds, the folder of the archive.
Out: ``AnswerErrors``.
"""

from __future__ import annotations

import json
from pathlib import Path

from etendue import cache
from etendue.accuracy.answers.cached import KIND, answer_key, cached
from etendue.accuracy.answers.comparing import KnownParts
from etendue.accuracy.answers.error import AnswerErrors, answers_of
from etendue.accuracy.answers.evaluations import Shown
from etendue.accuracy.answers.pilots import state_errors
from etendue.accuracy.answers.refinement import NOTHING
from etendue.archive.records.remembered import ANSWER, documents, remember
from etendue.contract.registry import Registry
from etendue.plan.model import Plan
from etendue.present.terminal.answer_texts import is_sound
from etendue.result_files import finite
from etendue.session import Outcome
from etendue.telling import plain, where
from etendue.types.documents import DocumentView

# Budget on the command line: a tenth of the seconds of the stages, with room for evaluations that take longer than
# predicted, but at least a time too short to notice.
SHARE, AT_LEAST = 0.09, 0.2
MORE = 1.5  # if the budget has grown by this factor, evaluations that exceeded it are tried again


def usual_budget(run: Outcome) -> float:
    """Return the share of the CPU seconds of a run's stages, or of the time that passed if this is less."""
    return SHARE * min(run.reports.seconds_of(), run.seconds)


def answer_errors(
    run: Outcome,
    registry: Registry,
    budget: float,
    folder: Path | None = None,
    shown: Shown = None,
    known_parts: KnownParts = NOTHING,
) -> AnswerErrors:
    """Return the errors of a run's wanted variables. Errors that an earlier run has measured for the same cells are
    reused. A finished run never fails because of this measurement: if a stage raises an error, the message is stored as
    the reason why nothing was measured.
    """
    plan = run.plan
    known = recalled(plan, folder)
    if known is not None and (not known.dear or known.budget * MORE > budget):
        found = known
    else:
        try:
            found = state_errors(plan, registry, run, budget, shown, known=known_parts)
        except Exception as error:
            return AnswerErrors({}, {}, {}, why=f"{where(error)}{plain(str(error) or type(error).__name__)}")
        cache.write(KIND, answer_key(plan), json.dumps(finite(found.document())).encode())
    stored = _read(documents(folder).get(answer_key(plan))) if folder is not None else None
    # Nothing new was measured, so nothing is written.
    if folder is not None and (stored is None or stored.dear > found.dear):
        remember(folder, answer_key(plan), finite({**found.document(), "kind": ANSWER}))
    return found


def recalled(plan: Plan, folder: Path | None = None) -> AnswerErrors | None:
    """Return the errors that an earlier run has measured for the same cells; None if there are none."""
    key = answer_key(plan)
    stored = documents(folder).get(key) if folder is not None else None
    known = [found for found in (_read(stored), _read(cached(plan))) if found is not None]
    return min(known, key=lambda found: found.dear, default=None)


def _read(document: DocumentView | None) -> AnswerErrors | None:
    return answers_of(document) if document is not None and is_sound(document) else None

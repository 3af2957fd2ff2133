"""The error of the answer in the attributes of a tree, from which plots and their captions read it.

In:  a tree, the stored errors of a run (``AnswerErrors.document()``).
Out: the same tree; variables that were measured have ``error`` and ``error_parts``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from etendue.present.terminal.answer_texts import is_sound, plus_minus, says_enough
from etendue.types.documents import DocumentView

if TYPE_CHECKING:
    import xarray


def stated(tree: xarray.DataTree, answers: DocumentView | None) -> xarray.DataTree:
    """Write the measured error of each variable into its attributes ``error`` and ``error_parts``."""
    for error in answers["errors"].values() if answers is not None and is_sound(answers) else ():
        for group in (
            tree[error["stage"]].subtree if says_enough(error, True) and error["stage"] in tree.children else ()
        ):
            if error["variable"] in group.data_vars:
                group[error["variable"]].attrs |= {
                    "error": error["rms"],
                    "error_parts": plus_minus(error, error["unit"] or "of full scale"),
                }
    return tree

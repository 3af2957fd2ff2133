"""The laws of state, one test method each.

In:  the bench of a stage.
Out: nothing, or a broken law: state of one picture affects the next, or another thread.
"""

from __future__ import annotations

from etendue.testing.behaviour import remembering
from etendue.testing.bench import Bench


class StateLaws:
    """Mix-in of ``StageConformance``."""

    bench: Bench

    def test_nothing_of_one_picture_reaches_the_next(self) -> None:
        """Computing A, B, A gives the same A twice; B after A equals B computed in a fresh process; returned arrays do
        not change later.
        """
        remembering.one_after_another(self.bench)

    def test_two_threads_do_not_notice_each_other(self) -> None:
        """At every line of the stage's code, another thread computes another picture; both results stay the same."""
        remembering.one_inside_another(self.bench)

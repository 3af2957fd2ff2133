"""The laws of ranges, one test method each.

In:  the bench of a stage.
Out: nothing, or a broken law: a jump inside a range, a step larger than the stated error, an offset of half a code, a
     neutral value that changes the input.
"""

from __future__ import annotations

from etendue.testing.behaviour import neutral, paths, steps
from etendue.testing.bench import Bench


class RangeLaws:
    """Mix-in of ``StageConformance``."""

    bench: Bench

    def test_nothing_jumps_over_thirteen_decades_of_light(self) -> None:
        """A stage that decides or writes whole numbers may jump, but by at most twice the error that it states."""
        paths.continuous_in_light(self.bench)

    def test_nothing_jumps_over_the_range_of_a_parameter(self) -> None:
        """As a numeric parameter varies, a stage that decides or writes whole numbers may jump, by at most twice its
        stated error.
        """
        paths.continuous_in_parameters(self.bench)

    def test_codes_stand_in_the_middle_of_their_steps(self) -> None:
        """Codes have no offset of half a code, and no step is larger than the stated error."""
        steps.codes_in_the_middle(self.bench)

    def test_a_neutral_value_changes_nothing(self) -> None:
        """If a stage with a parameter at 0 or 1 hardly changes its input, the change is within the stated error."""
        neutral.neutral_is_identity(self.bench)

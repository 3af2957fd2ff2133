"""The laws of numerical stability, one test method each: what ``StageConformance`` has beside declarations and claims.

In:  the bench of a stage.
Out: nothing, or a broken law that says what goes wrong: cancellation, overflow, digits lost in float32, a jump, a
     hidden constant.
"""

from __future__ import annotations

from etendue.testing import digits, small_changes
from etendue.testing.bench import Bench
from etendue.testing.laws import declared_laws


class ExtremeLaws:
    """Mixed into ``StageConformance``."""

    bench: Bench

    def test_digits_are_kept_in_every_precision(self) -> None:
        """Single against double against long double, from a millionth of full scale to a thousand times it."""
        digits.digits_kept(self.bench)

    def test_a_small_change_of_what_is_read_changes_little(self) -> None:
        """By one unit in the last place, and by 1e-6."""
        small_changes.input_changes(self.bench)

    def test_a_small_change_of_a_parameter_changes_little(self) -> None:
        """By one unit in the last place, and by 1e-6."""
        small_changes.parameter_changes(self.bench)

    def test_the_unit_of_light_does_not_matter(self) -> None:
        """Light in a unit a million times as large: a hidden constant shows."""
        small_changes.unit_changes(self.bench)

    def test_the_order_that_it_keeps_is_kept(self) -> None:
        """``keeps = ("order",)``: no value falls where what is read rises."""
        declared_laws.order_kept(self.bench)

    def test_the_sum_that_it_keeps_is_kept(self) -> None:
        """``keeps = ("sum",)``: what leaves one place arrives at another."""
        declared_laws.sum_kept(self.bench)

    def test_the_noise_has_the_variance_that_it_says(self) -> None:
        """``Noisy.variance`` against what ``run`` draws."""
        declared_laws.variance_told(self.bench)

    def test_what_it_solves_costs_no_more_digits_than_its_condition(self) -> None:
        """Matrices written, and colours made of colours."""
        declared_laws.matrix_told(self.bench)

"""The laws of numerical stability, one test method each; ``StageConformance`` adds them to the laws on declarations.

In:  the bench of a stage.
Out: nothing, or a broken law that names the fault: cancellation, overflow, digits lost in float32, a jump, a
     hidden constant.
"""

from __future__ import annotations

from etendue.testing import digits, small_changes
from etendue.testing.bench import Bench
from etendue.testing.laws import declared_laws


class ExtremeLaws:
    """Mix-in of ``StageConformance``."""

    bench: Bench

    def test_digits_are_kept_in_every_precision(self) -> None:
        """Results agree in single, double and long double precision, for inputs from 1e-6 to 1000 times full scale."""
        digits.digits_kept(self.bench)

    def test_a_small_change_of_what_is_read_changes_little(self) -> None:
        """A change by one unit in the last place, and by 1e-6."""
        small_changes.input_changes(self.bench)

    def test_a_small_change_of_a_parameter_changes_little(self) -> None:
        """A change by one unit in the last place, and by 1e-6."""
        small_changes.parameter_changes(self.bench)

    def test_the_unit_of_light_does_not_matter(self) -> None:
        """Results do not depend on the unit of light, even if it is a million times as large (no hidden constants)."""
        small_changes.unit_changes(self.bench)

    def test_the_order_that_it_keeps_is_kept(self) -> None:
        """``keeps = ("order",)``: no value falls if the input rises."""
        declared_laws.order_kept(self.bench)

    def test_the_sum_that_it_keeps_is_kept(self) -> None:
        """``keeps = ("sum",)``: the sum over the frame stays the same."""
        declared_laws.sum_kept(self.bench)

    def test_the_noise_has_the_variance_that_it_says(self) -> None:
        """The draws of ``run`` have the variance that ``Noisy.variance`` states."""
        declared_laws.variance_told(self.bench)

    def test_what_it_solves_costs_no_more_digits_than_its_condition(self) -> None:
        """Matrices that the stage writes, and its mapping from colours to colours, lose no more digits than their
        condition numbers imply.
        """
        declared_laws.matrix_told(self.bench)

"""Laws of what kernels ask of their arguments: one sentence that names the argument, what came, what may come."""

import numpy as np
import pytest

from etendue import require


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (
            lambda: require.must(np.array([1, -1]) > 0, "pitch", [1, -1], "above 0 um"),
            "pitch is [1, -1]; it must be above 0 um",
        ),
        (lambda: require.allowed(False, "method", "x", "'a' and 'b'"), "method is 'x'; allowed: 'a' and 'b'"),
        (lambda: require.positive("edge", 0.0, " nm"), "edge is 0.0; it must be above 0 nm"),
        (lambda: require.finite("r0", np.inf), "r0 is inf; it must be above 0 and finite"),
        (
            lambda: require.at_least_zero("dark", [1, -2.5, -1], " electrons"),
            "dark is -2.5 electrons; allowed: numbers at or above 0",
        ),
        (lambda: require.above_zero("time", [0.0, 1.0]), "time is 0.0; allowed: numbers above 0"),
        (lambda: require.amount("ridge", np.inf), "ridge is inf; allowed: finite numbers at or above 0"),
    ],
)
def test_what_is_not_fine_is_named_with_what_came_and_what_may_come(ask, said):
    with pytest.raises(ValueError) as refused:
        ask()
    assert str(refused.value) == said


def test_nan_is_never_fine():
    for ask in (require.positive, require.finite, require.at_least_zero, require.above_zero, require.amount):
        with pytest.raises(ValueError, match="nan"):
            ask("number", np.nan)


def test_what_is_fine_comes_back_in_its_own_precision():
    assert require.at_least_zero("dark", np.zeros(3, np.float32)).dtype == np.float32
    assert require.above_zero("count", [1, 2]).dtype == np.float64
    assert require.amount("ridge", 0) == 0.0

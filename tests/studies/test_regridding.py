"""Light brought from a finer or wider grid to the one it is compared on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from etendue.accuracy.answers.regridding import on_grid
from etendue.contract.arrays.grid import Bands, Grid, Labels, Line


def line(size: int, step: float, cells: bool = False) -> Line:
    return Line(size, -0.5 * (size - 1) * step, step, cells=cells)


def grid(x: Line, bands: int = 2) -> Grid:
    return Grid.of({"wavelength": Bands(tuple(np.linspace(400, 700, bands + 1))), "x": x})


@given(st.integers(4, 40), st.integers(1, 5), st.booleans())
def test_constants_stay_constants(size, bands, cells):
    fine, coarse = grid(line(2 * size, 0.5, cells), 2 * bands), grid(line(size, 1.0, cells), bands)
    assert np.allclose(on_grid(np.full((2 * bands, 2 * size), 3.0), ("wavelength", "x"), fine, coarse), 3.0, rtol=1e-14)


@given(st.integers(4, 40), st.integers(0, 2**32 - 1))
def test_means_over_cells_and_bands_keep_the_sum(size, seed):
    values = np.random.default_rng(seed).random((4, 2 * size))
    found = on_grid(values, ("wavelength", "x"), grid(line(2 * size, 0.5, True), 4), grid(line(size, 1.0, True), 2))
    assert found.sum() * 4 == pytest.approx(values.sum(), rel=1e-12)


def test_samples_of_a_cubic_are_exact_inside():
    """The two values at each end lack a neighbour."""
    fine, coarse = line(40, 0.5), line(20, 1.0)
    cubic = lambda x: 1 + x - 0.2 * x**2 + 0.03 * x**3  # noqa: E731
    found = on_grid(cubic(np.array(fine.values())), ("x",), Grid.of({"x": fine}), Grid.of({"x": coarse}))
    assert np.allclose(found[2:-2], cubic(np.array(coarse.values()))[2:-2], rtol=1e-12)


@given(st.floats(2.0, 3.7), st.floats(1.5, 4.0))
def test_any_offset_and_ratio_is_interpolated(start, ratio):
    """A size that is no multiple of the spacing shifts the samples by a fraction."""
    fine, coarse = Line(60, -15.0, 0.5), Line(8, -15.0 + start, 0.5 * ratio)
    cubic = lambda x: 2 - x + 0.1 * x**3  # noqa: E731
    found = on_grid(cubic(np.array(fine.values())), ("x",), Grid.of({"x": fine}), Grid.of({"x": coarse}))
    assert np.allclose(found, cubic(np.array(coarse.values())), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("sizes", [(7, 13), (8, 16)])
def test_a_margin_is_cut_off(sizes):
    inner, outer = (line(size, 1.0) for size in sizes)
    found = on_grid(np.array(outer.values()), ("x",), Grid.of({"x": outer}), Grid.of({"x": inner}))
    assert np.array_equal(found, inner.values())


@pytest.mark.parametrize(
    ("own", "other"),
    [
        (line(7, 1.0), line(20, 1.0)),  # does not reach so far
        (Labels(("R", "G")), Labels(("R", "B"))),
        (Bands((400, 450)), Bands((400, 650))),  # not covered
        (Line(4, 0, 1, "s"), Line(4, 0, 2, "um")),
    ],
)
def test_what_is_not_defined_is_refused(own, other):
    assert on_grid(np.zeros(own.size), ("x",), Grid.of({"x": own}), Grid.of({"x": other})) is None

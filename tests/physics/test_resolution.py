"""Resolution figures of a response against closed forms: Gaussian, box, circular aperture."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.special import erfc, sici

from etendue_camera.optics import diffraction
from etendue_camera.resolution import contrast

widths = st.floats(0.2, 12.0)


def gaussian(sigma):
    return lambda f: np.exp(-2 * (np.pi * sigma * f) ** 2)


def box(width):
    return lambda f: np.abs(np.sinc(width * f))


def figures(response, nyquist=0.1, highest=4.0, nodes=512, cut_off=1e-3):
    grid = contrast.search_nodes(highest, nodes)
    curve = contrast.ContrastCurve(grid, response(grid))
    mtf50, mtf10, end = curve.crossings(cut_off, response)
    assert_allclose(curve.half(response), mtf50, rtol=1e-9)
    return SimpleNamespace(mtf50=mtf50, mtf10=mtf10, cut_off=end, aliasing=curve.beyond(nyquist))


@given(widths)
def test_a_gaussian_falls_to_its_levels_where_its_logarithm_says(sigma):
    found = figures(gaussian(sigma))
    for value, level in ((found.mtf50, 0.5), (found.mtf10, 0.1), (found.cut_off, 1e-3)):
        exact = math.sqrt(-math.log(level) / 2) / (math.pi * sigma)
        assert_allclose(
            value, exact if exact < 4 else np.nan, rtol=1e-9
        )  # 2e-11 measured; the smallest are steep at the end


@given(widths)
def test_a_box_falls_to_one_half_at_its_constant(width):
    """The root of sinc(x) = 1/2 is 0.603354564...; weights of many bands change nothing where all are the same."""
    found = contrast.mtf50(lambda f: np.tile(np.sinc(width * f), (3, 1)), np.array([1.0, 5.0, 2.0]), 4.0, 512)
    assert_allclose(found, 0.60335456440161455 / width, rtol=1e-11)


def test_contrast_that_comes_back_counts_for_the_cut_off():
    """The first side lobe of a box is 0.217 high: it has 0.2 once more, behind its zero."""
    found = figures(box(2.0), cut_off=0.2)
    assert 1.43 / 2 < found.cut_off < 1.6 / 2
    assert_allclose(box(2.0)(np.array([found.cut_off])), 0.2, rtol=1e-9)
    assert math.isnan(figures(box(1.9), cut_off=1e-2).cut_off)  # at the end of the search a lobe is 0.04 high


@pytest.mark.parametrize("f_number", [1.4, 5.6, 22.0])
def test_the_cut_off_of_a_lens_is_where_its_contrast_is_as_good_as_none(f_number):
    found = figures(lambda f: diffraction.circular_otf(f, 0.55, f_number), cut_off=1e-9)
    assert_allclose(
        found.cut_off, 1 / (0.55 * f_number), rtol=2e-6
    )  # the last billionth is gone 1e-6 in front of the end


@given(st.floats(0.5, 8.0), st.floats(0.3, 3.0))
def test_energy_beyond_nyquist_is_that_of_the_closed_forms(sigma, place):
    """Of a Gaussian erfc, of a box the sine integral, from the Nyquist frequency to the end of the search."""
    nyquist = place * 0.1 / sigma
    assert_allclose(figures(gaussian(sigma), nyquist).aliasing, erfc(2 * math.pi * sigma * nyquist), atol=2e-6)

    def within(f):
        x = math.pi * sigma * f
        return (sici(2 * x)[0] - math.sin(x) ** 2 / x) / (math.pi * sigma)

    share = 1 - within(nyquist) / within(4.0)
    assert_allclose(figures(box(sigma), nyquist).aliasing, share, atol=1e-5)  # 8 um has 32 lobes, each of some nodes


def test_beyond_the_search_nothing_is_known_and_nothing_folds():
    found = figures(gaussian(0.01), nyquist=5.0)
    assert math.isnan(found.mtf50)
    assert math.isnan(found.mtf10)
    assert math.isnan(found.cut_off)
    assert found.aliasing == 0.0


@given(st.integers(16, 300), st.floats(0.4, 5.0))
def test_few_nodes_find_the_same_crossing(nodes, width):
    """The guess between nodes may be bad; the solution is the response's own."""
    assert_allclose(figures(box(width), nodes=nodes, highest=2.0).mtf50, 0.60335456440161455 / width, rtol=1e-7)


def test_a_response_with_a_kink_at_the_level_is_still_solved():
    """|1 - f|, whose levels stand beside its corner, and a step, which no polynomial follows."""
    assert_allclose(figures(lambda f: np.abs(1 - f), cut_off=0.4).mtf10, 0.9, rtol=1e-9)
    step = figures(lambda f: np.where(f < 0.7, 1.0, 0.02), cut_off=0.05)
    assert_allclose([step.mtf50, step.mtf10, step.cut_off], 0.7, rtol=1e-6)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: contrast.search_nodes(0.0, 16), "highest is 0.0"),
        (lambda: contrast.search_nodes(1.0, 1), "nodes 1"),
        (lambda: contrast.search_nodes(math.inf, 16), "highest is inf"),
        (lambda: figures(box(1.0), nyquist=0.0), "nyquist is 0.0"),
        (lambda: figures(box(1.0), cut_off=1.0), "cut_off is 1.0"),
    ],
)
def test_what_makes_no_sense_is_refused(call, text):
    with pytest.raises(ValueError, match=text):
        call()


@given(st.floats(0.5, 6.0), st.floats(0.1, 0.9))
def test_a_spline_of_many_nodes_crosses_where_the_curve_does(sigma, cut_off):
    """Straight lines between 65 places of a step, on a spline of fourth order: 1e-7 at 1024 nodes."""
    grid = contrast.search_nodes(4.0, 1024)
    curve = contrast.ContrastCurve(grid, gaussian(sigma)(grid))
    assert_allclose(curve.crossings(cut_off), curve.crossings(cut_off, gaussian(sigma)), rtol=1e-6)
    assert_allclose(curve.half(), curve.crossings(cut_off)[0], rtol=0)

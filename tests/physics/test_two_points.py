"""Two points through a transfer function: the Airy disc's figures come back, and laws of any spread."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from etendue_camera.optics import diffraction
from etendue_camera.resolution import two_points
from etendue_camera.resolution.two_points import (
    RAYLEIGH_SADDLE,
    separations,
    spread_of,
    two_point_saddle,
)
from tests.physics.reference import cases

SPOT = 0.55 * 2.8  # lambda N, um


def airy(f):
    return diffraction.circular_otf(f, 0.55, 2.8)


def gaussian(sigma):
    return lambda f: np.exp(-2 * (np.pi * f * sigma) ** 2)


def rayleigh_separation(*given, **more):
    return separations(*given, **more)[0]


def sparrow_separation(*given, **more):
    return separations(*given, **more)[1]


def test_the_saddle_of_the_airy_disc_is_that_of_the_high_precision_cases():
    for given_, (ratio, offset), _ in cases("two_point_saddle"):
        separation = given_["sep_in_lambda_over_NA"]
        found, place = two_point_saddle(2 * SPOT * separation, airy, 1 / SPOT)
        assert_allclose(found, ratio, rtol=1e-11)  # 400 nodes leave 2e-13
        # near Sparrow's separation the peaks part as a square root, which magnifies what the nodes leave
        loose = max(1.0, 0.5 * separation / abs(separation - diffraction.SPARROW / 2))
        assert_allclose(place / (2 * SPOT), offset, rtol=1e-10 * loose, atol=1e-12)


@pytest.mark.parametrize(("separation", "saddle"), [(0.4, 1.0), (0.5, 0.98271), (0.6, 0.76112)])
def test_the_papers_three_separations_have_their_saddles(separation, saddle):
    assert_allclose(
        two_point_saddle(separation * 2 * SPOT, airy, 1 / SPOT)[0], saddle, atol=5e-6
    )  # five printed digits


def test_the_airy_disc_has_the_separations_of_sparrow_and_rayleigh(monkeypatch):
    assert_allclose(sparrow_separation(airy, 1 / SPOT) / SPOT, diffraction.SPARROW, rtol=1e-11)
    assert_allclose(rayleigh_separation(airy, 1 / SPOT) / SPOT, diffraction.RAYLEIGH, rtol=1e-11)
    # the rule for spreads without a dark ring agrees where there is one
    monkeypatch.setattr(two_points, "DARK", 0.0)
    assert_allclose(rayleigh_separation(airy, 1 / SPOT) / SPOT, diffraction.RAYLEIGH, rtol=1e-11)
    assert_allclose(RAYLEIGH_SADDLE, diffraction.two_point_saddle(diffraction.RAYLEIGH / 2)[0], rtol=1e-14)


def test_the_spread_of_a_round_lens_is_the_airy_pattern():
    r = np.linspace(0, 4, 9)
    assert_allclose(spread_of(airy, 1 / SPOT).value(r), diffraction.airy_psf_density(r, 0.55, 2.8), atol=1e-11)


@pytest.mark.parametrize("highest", [1.0, 3.0, 20.0])
def test_gaussians_merge_at_two_sigma(highest):
    """Rayleigh's dip solves 2 exp(-d^2/8s^2) = 0.735 (peak)."""
    separation, merging = separations(gaussian(1.3), highest)
    assert_allclose(merging, 2.6, rtol=1e-10)
    x = np.linspace(0.4, 0.6, 200001) * separation
    peak = (np.exp(-((x - separation / 2) ** 2) / 3.38) + np.exp(-((x + separation / 2) ** 2) / 3.38)).max()
    assert_allclose(2 * np.exp(-(separation**2) / 4 / 3.38) / peak, RAYLEIGH_SADDLE, rtol=1e-9)


@settings(max_examples=20, deadline=None)
@given(scale=st.floats(0.01, 100.0), share=st.floats(0.0, 1.0))
def test_separations_scale_with_the_spread(scale, share):
    """A mixture of a lens and a Gaussian, stretched."""

    def mixed(f):
        return share * airy(f) + (1 - share) * gaussian(0.5)(f) * airy(f)

    def stretched(f):
        return mixed(f * scale)

    for rule in (sparrow_separation, rayleigh_separation):
        assert_allclose(rule(stretched, 1 / SPOT / scale), scale * rule(mixed, 1 / SPOT), rtol=1e-9)


def test_blur_parts_points_farther_and_wavelengths_are_weighted():
    def blurred(f):
        return airy(f) * gaussian(0.6)(f)

    assert sparrow_separation(blurred, 1 / SPOT) > sparrow_separation(airy, 1 / SPOT)
    assert rayleigh_separation(blurred, 1 / SPOT) > rayleigh_separation(airy, 1 / SPOT)

    def two(f):
        return np.stack([diffraction.circular_otf(f, 0.45, 2.8), diffraction.circular_otf(f, 0.65, 2.8)])

    highest = 1 / (0.45 * 2.8)
    blue, red = (sparrow_separation(two, highest, [1 - w, w]) for w in (0, 1))
    assert_allclose(
        [blue, red], diffraction.SPARROW * 2.8 * np.array([0.45, 0.65]), rtol=1e-5
    )  # a cut-off inside the range
    assert blue < sparrow_separation(two, highest) < red
    assert_allclose(sparrow_separation(two, highest, [2, 2]), sparrow_separation(two, highest), rtol=1e-14)


@settings(max_examples=20, deadline=None)
@given(share=st.floats(1.02, 1.6))
def test_the_dip_begins_at_sparrows_separation_and_deepens(share):
    start = sparrow_separation(gaussian(0.8), 2.0)
    ratios = two_point_saddle(start * np.array([0.3, 0.99, share, share + 0.1]), gaussian(0.8), 2.0)[0]
    assert ratios[0] == ratios[1] == 1.0
    assert 1 > ratios[2] > ratios[3]


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: two_point_saddle(-1.0, airy, 1.0), "separation is"),
        (lambda: sparrow_separation(airy, 0.0), "highest is"),
        (lambda: sparrow_separation(airy, 1.0, nodes=4), "nodes is"),
        (lambda: sparrow_separation(lambda f: f[:3], 1.0), "otf returns shape"),
        (lambda: sparrow_separation(lambda f: np.stack([f, f]), 1.0, [1.0]), "weights has shape"),
        (lambda: sparrow_separation(lambda f: np.nan * f, 1.0), "not finite"),
    ],
)
def test_nonsense_is_refused_with_its_name_and_what_is_allowed(call, match):
    with pytest.raises(ValueError, match=match):
        call()


@pytest.mark.parametrize("otf", [airy, gaussian(0.8 * SPOT)], ids=["dark ring", "none"])
def test_separations_err_by_what_is_allowed(otf):
    highest = 1 / SPOT
    exact = separations(otf, highest)
    assert_allclose(separations(otf, highest, within=1e-4), exact, rtol=4e-4)  # the ratio of a saddle errs too

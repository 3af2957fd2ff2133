"""Laws of focus: conjugates, defocus without cancellation, and depth of field as the blur it allows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis.strategies import floats
from numpy.testing import assert_allclose

from etendue_camera.optics.focus import (
    blur_diameter,
    defocus_mm,
    depth_of_field,
    effective_magnification,
    focus_distance_of,
    hyperfocal,
    magnification_of,
)

focal_lengths = floats(1.0, 1000.0)
beyond = floats(-2.0, 6.0)  # decades of (s - f)/f
f_numbers = floats(0.5, 64.0)
circles = floats(1e-4, 0.05)
pupils = floats(0.2, 5.0)


def image_distance(f, s):
    return 1.0 / (1.0 / f - 1.0 / s)


def test_an_object_at_two_focal_lengths_is_imaged_in_its_own_size_and_one_at_infinity_in_none():
    assert magnification_of(50.0, 100.0) == -1.0
    assert magnification_of(50.0, np.inf) == 0.0
    assert_allclose(magnification_of(50.0, np.array([100.0, np.inf, 1050.0])), [-1.0, 0.0, -0.05])


@given(f=focal_lengths, decade=beyond)
def test_magnification_is_image_over_object_distance_and_gives_the_distance_back(f, decade):
    s = f * (1 + 10.0**decade)
    m = magnification_of(f, s)
    # the naive image distance loses as many digits as s stands close to f
    assert_allclose(m, -image_distance(f, s) / s, rtol=1e-14 * (1 + f / (s - f)))
    assert_allclose(focus_distance_of(f, m), s, rtol=1e-14)


def test_a_magnification_of_zero_is_a_focus_at_infinity():
    assert focus_distance_of(50.0, 0.0) == np.inf
    assert effective_magnification(0.0, 50.0, np.inf) == 0.0
    assert effective_magnification(-0.3, 50.0, np.inf) == -0.3
    assert effective_magnification(0.0, 50.0, 100.0) == -1.0
    assert effective_magnification(-1.0, 50.0, 100.0) == -1.0


def test_a_magnification_and_a_focus_that_contradict_each_other_are_refused():
    with pytest.raises(ValueError, match=r"gives -1; give only one of them"):
        effective_magnification(-0.5, 50.0, 100.0)


@given(f=focal_lengths, one=beyond, other=beyond)
def test_defocus_is_the_difference_of_the_image_distances(f, one, other):
    s, o = f * (1 + 10.0**one), f * (1 + 10.0**other)
    naive = image_distance(f, o) - image_distance(f, s)
    # the naive form: rounding of 1/f - 1/s and of the difference
    slack = 1e-15 * (image_distance(f, o) ** 2 + image_distance(f, s) ** 2) / f * 4
    assert_allclose(defocus_mm(f, s, o), naive, rtol=1e-14, atol=slack)
    assert_allclose(defocus_mm(f, s, o), -defocus_mm(f, o, s), rtol=1e-15)  # three products in another order


@given(f=focal_lengths, decade=beyond, power=floats(-13.0, -3.0))
def test_objects_a_hair_from_the_focus_keep_their_digits(f, decade, power):
    s = f * (1 + 10.0**decade)
    o = s * (1 + 10.0**power)
    # f^2 (s - o)/((s - f)(o - f)): every difference is of stored numbers, so three roundings
    assert_allclose(defocus_mm(f, s, o), -(f / (s - f)) * (f / (o - f)) * (o - s), rtol=1e-14)


def test_defocus_vanishes_exactly_in_focus_and_has_limits_at_infinity():
    assert defocus_mm(50.0, 1234.5, 1234.5) == 0.0
    assert defocus_mm(50.0, np.inf, np.inf) == 0.0
    assert_allclose(defocus_mm(50.0, np.inf, 1050.0), 50.0 * 50.0 / 1000.0, rtol=1e-15)  # Newton's x x' = f^2
    assert_allclose(defocus_mm(50.0, 1050.0, np.inf), -2.5, rtol=1e-15)
    assert_allclose(defocus_mm(50.0, 1050.0, 1e300), -2.5, rtol=1e-15)  # no overflow on the way
    assert_allclose(defocus_mm(50.0, 1050.0, np.array([np.inf, 1050.0])), [-2.5, 0.0])


@given(f=focal_lengths, decade=beyond, number=f_numbers, circle=circles, pupil=pupils)
def test_the_limits_of_depth_of_field_are_blurred_by_the_circle_of_confusion(f, decade, number, circle, pupil):
    s = f * (1 + 10.0**decade)
    near, far = depth_of_field(f, number, circle, s, pupil)
    assert near <= s * (1 + 1e-15)
    assert far >= s * (1 - 1e-15)
    for limit in (near, far):
        if limit == np.inf or limit <= f * (1 + 1e-12):
            continue
        # blur follows the distance: rounding of the limit shows by s/|limit - s|
        sensitive = limit / max(abs(limit - s), 1e-300) + limit / (limit - f)
        assert_allclose(blur_diameter(f, number, s, limit, pupil), circle, rtol=1e-14 * (1 + sensitive))


@given(f=focal_lengths, number=f_numbers, circle=circles)
def test_from_the_hyperfocal_distance_on_infinity_is_sharp(f, number, circle):
    h = hyperfocal(f, number, circle)
    near, far = depth_of_field(f, number, circle, h)
    assert far == np.inf
    assert_allclose(
        near, h / 2 if circle < f / number else f, rtol=1e-13 * (1 + number * circle / abs(f - number * circle) * 10)
    )
    assert depth_of_field(f, number, circle, f + (h - f) * (1 - 1e-6))[1] < np.inf
    near, far = depth_of_field(f, number, circle)
    assert far == np.inf
    # at infinity the near limit is f^2/(N c), one focal length short of the hyperfocal distance
    if circle < f / number:
        assert_allclose(
            near, h - f, rtol=1e-13 * (1 + f * h / (h - f) ** 2 + number * circle / abs(f - number * circle) * 10)
        )
    assert_allclose(blur_diameter(f, number, h, np.inf), circle, rtol=1e-12 * (1 + f / (h - f)))


def test_the_textbook_case():
    # 50 mm, f/8, 0.03 mm, 3 m: s f^2/(f^2 +- N c (s - f)) by hand
    near, far = depth_of_field(50.0, 8.0, 0.03, 3000.0)
    assert_allclose(near, 3000 * 2500 / (2500 + 0.24 * 2950), rtol=1e-15)
    assert_allclose(far, 3000 * 2500 / (2500 - 0.24 * 2950), rtol=2e-15)


@given(f=focal_lengths, decade=beyond, number=floats(1.0, 30.0), circle=circles)
def test_stopping_down_deepens_the_field(f, decade, number, circle):
    s = f * (1 + 10.0**decade)
    near, far = depth_of_field(f, number, circle, s)
    nearer, farther = depth_of_field(f, number * 1.4, circle, s)
    assert nearer <= near * (1 + 1e-15)
    assert farther >= far * (1 - 1e-15)


def test_what_makes_no_image_is_refused():
    for call in (
        lambda: magnification_of(50.0, 50.0),
        lambda: magnification_of(50.0, 10.0),
        lambda: magnification_of(-50.0, 100.0),
        lambda: magnification_of(50.0, np.nan),
        lambda: defocus_mm(50.0, np.inf, np.array([100.0, 20.0])),
        lambda: focus_distance_of(50.0, 0.5),
        lambda: depth_of_field(50.0, 0.0, 0.03, 3000.0),
        lambda: depth_of_field(50.0, 8.0, -0.03, 3000.0),
        lambda: hyperfocal(50.0, 8.0, np.inf),
        lambda: blur_diameter(50.0, 8.0, np.inf, 1000.0, pupil_magnification=0.0),
    ):
        with pytest.raises(ValueError, match="must be"):
            call()

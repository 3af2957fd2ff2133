"""Lens shading undone by gains, from a model, a table or a flat field. In: fall-offs. Out: even light."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from etendue_camera.mosaic import shading
from etendue_camera.sensor import cfa

PLACES = np.linspace(-4.0, 4.0, 161)  # mm: a window about the axis, which stands on its middle pixel


def falling(focal_length, y=PLACES, x=PLACES):
    """cos4 of the field angle."""
    return (1 + (np.hypot(y[:, None], x[None, :]) / focal_length) ** 2) ** -2.0


@given(relative=st.floats(0.01, 4.0), level=st.floats(1e-6, 1.0))
def test_the_whole_correction_gives_the_light_of_the_axis(relative, level):
    gain = shading.gain_of(np.array(relative), 1.0, 1e4)
    assert relative * level * gain == pytest.approx(level, rel=4e-16)  # three roundings


@given(relative=st.floats(0.01, 1.0), strength=st.floats(0.0, 1.0))
def test_a_part_of_the_correction_lies_between_nothing_and_the_whole(relative, strength):
    none, part, whole = (float(shading.gain_of(np.array(relative), s, 1e4)) for s in (0.0, strength, 1.0))
    assert none == 1.0
    assert 1.0 <= part <= whole * (1 + 2e-16)


def test_black_stays_black_and_the_largest_gain_is_an_end():
    gains = shading.gain_of(np.array([1.0, 0.5, 0.01, 0.0]), 1.0, 8.0)
    assert_array_equal(gains, [1.0, 2.0, 8.0, 8.0])
    assert_array_equal(0.0 * gains, np.zeros(4))
    assert shading.gain_of(np.ones(3, np.float32) / 3, 1.0, 8.0).dtype == np.float32


@pytest.mark.parametrize("pattern", ["RGGB", "X-Trans", "mono"])
def test_a_table_from_a_flat_field_undoes_the_fall_off_that_it_was_made_from(pattern):
    """Each channel falls off by itself, as with an angular response by wavelength."""
    mask = cfa.parse(pattern)
    planes = np.stack([falling(f) for f in (6.9, 8.0, 10.0)][: len(mask.channels)])
    table = shading.calibrated(0.7 * cfa.pick(planes, mask), mask, PLACES, PLACES)
    radius = np.hypot(PLACES[:, None], PLACES[None, :])
    for plane, column in zip(planes, table.gains.T, strict=True):
        flat = plane * np.interp(radius, table.heights_mm, column)
        assert np.abs(flat / flat[80, 80] - 1).max() < 4e-5  # 39 degrees in the corner; straight lines between 129 rows


def test_the_error_of_a_table_falls_with_the_square_of_its_rows():
    mask, flat = cfa.parse("mono"), falling(6.9)
    radius = np.hypot(PLACES[:, None], PLACES[None, :])
    errors = []
    for rows in (9, 17, 33):
        table = shading.calibrated(flat, mask, PLACES, PLACES, rows)
        errors.append(np.abs(flat * np.interp(radius, table.heights_mm, table.gains[:, 0]) - 1)[radius < 4].max())
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.35)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.35)


def test_noise_of_a_flat_field_is_averaged_over_the_pixels_of_a_row():
    flat = falling(6.9)
    noisy = flat + 0.01 * np.random.default_rng(2).standard_normal(flat.shape)
    quiet, found = (shading.calibrated(f, cfa.parse("mono"), PLACES, PLACES, 17) for f in (flat, noisy))
    ratio = (found.gains / quiet.gains)[
        2:15
    ]  # 19 freedoms for 25921 pixels: 0.0003 rms, three times that at its most, more at the ends
    assert np.abs(ratio / ratio.mean() - 1).max() < 0.002


def test_a_table_is_read_as_it_was_written(tmp_path):
    table = shading.calibrated(
        cfa.pick(np.stack([falling(f) for f in (6.9, 8.0, 10.0)]), cfa.parse("RGGB")), cfa.parse("RGGB"), PLACES, PLACES
    )
    shading.write_gains(tmp_path / "gains.csv", table)
    again = shading.read_gains(tmp_path / "gains.csv")
    assert again.columns == ("R", "G", "B")
    assert_array_equal(again.heights_mm, table.heights_mm)
    assert_array_equal(again.gains, table.gains)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "nothing"),
        ("radius,gain\n0,1\n", "radius"),
        ("height_mm\n0\n", "height_mm,gain"),
        ("height_mm,gain\n", "start at 0"),
        ("height_mm,gain\n1,1\n2,1.1\n", "start at 0"),
        ("height_mm,gain\n0,1\n2,1.1\n1,1.2\n", "ascend"),
        ("height_mm,gain\n0,1\n1,x\n", "row 2"),
        ("height_mm,gain\n0,1\n1,1,1\n", "row 2"),
        ("height_mm,gain\n0,1\n1,0\n", "above 0"),
        ("height_mm,gain\n0,1\n1,nan\n", "finite"),
    ],
)
def test_a_broken_table_is_refused_with_its_row(text, says, tmp_path):
    (tmp_path / "gains.csv").write_text(text)
    with pytest.raises(ValueError, match=says):
        shading.read_gains(tmp_path / "gains.csv")


def test_flat_fields_that_say_nothing_are_refused():
    mask, flat = cfa.parse("RGGB"), falling(6.9)
    for call, text in (
        (lambda: shading.calibrated(flat[:, :80], mask, PLACES, PLACES), "as the positions say"),
        (lambda: shading.calibrated(flat, mask, PLACES + 5, PLACES), "axis is outside"),
        (lambda: shading.calibrated(0 * flat, mask, PLACES, PLACES), "require light everywhere"),
        (lambda: shading.calibrated(flat[80:82, 80:82], mask, PLACES[80:82], PLACES[80:82]), "heights"),
        (lambda: shading.calibrated(flat * np.nan, mask, PLACES, PLACES), "finite"),
        (lambda: shading.calibrated(flat, mask, PLACES, PLACES, 1), "rows is 1"),
        (lambda: shading.gain_of(flat, 1.5, 8.0), "strength is 1.5"),
        (lambda: shading.gain_of(flat, 1.0, 0.5), "largest is 0.5"),
        (lambda: shading.gain_of(-flat, 1.0, 8.0), "relative"),
    ):
        with pytest.raises(ValueError, match=text):
            call()

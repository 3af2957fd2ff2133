"""What is measured of a lens, as the tables of the stages: at its knots what was measured, between them what lensfun
interpolates (compared with lensfunpy in ``benchmarks/real_cameras.py``), and the laws that any lens obeys.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from etendue_camera.cameras import lensfun
from etendue_camera.field.lens_calibration import chosen, distorted, interpolated, weighted
from etendue_camera.field.lens_files import LensFile, lens_file
from etendue_camera.field.stages.blur import Distortion
from etendue_camera.field.stages.falloff import Falloff
from tests.cameras import database

OWN = lensfun.parsed(database.text().encode(), "x.xml")
ZOOM = next(one for one in OWN.lenses if "20-40" in one.model)
PRIMES = [one for one in OWN.lenses if "50mm" in one.model]
POLY5 = next(one for one in OWN.lenses if "35mm" in one.model)


@pytest.fixture
def path(tmp_path):
    def written(*entries):
        own = [replace(one, fits=OWN.bodies_of(one.mounts)) for one in entries]
        file = tmp_path / "own.lens"
        file.write_text(LensFile("Acme lens", "a test", "CC0-1.0", tuple(own)).text())
        return str(file)

    return written


@pytest.mark.parametrize("point", ZOOM.distortion)
def test_at_a_knot_the_terms_are_those_of_the_calibration(point):
    assert interpolated(ZOOM.distortion, point.focal, "distortion") == point


@given(focal=st.floats(20, 40))
def test_between_knots_terms_times_focal_length_are_continuous(focal):
    a, b = (interpolated(ZOOM.distortion, f, "distortion") for f in (focal, min(40.0, focal * (1 + 1e-9))))
    assert np.allclose(a.terms, b.terms, atol=1e-8)


@given(r=st.floats(0, 1.8))
def test_half_the_short_side_stays_where_it_is_in_the_models_that_say_so(r):
    for lens in (ZOOM, *PRIMES):  # poly3 and ptlens: r = 1 is fixed
        for point in lens.distortion:
            assert math.isclose(float(distorted(point, np.array(1.0))), 1.0, abs_tol=1e-15)
    poly5 = POLY5.distortion[0]
    assert math.isclose(float(distorted(poly5, np.array(r))), r * (1 + 0.01 * r**2 - 0.002 * r**4), abs_tol=1e-14)


def test_fall_off_at_a_measured_setting_is_the_measured_polynomial_and_none_far_from_all():
    assert weighted(ZOOM.vignetting, ZOOM.focal, 20, 2.8, 1000) == (-1.0, 0.5, -0.2)
    assert weighted(ZOOM.vignetting, ZOOM.focal, 20, 1.0, 1000) is None
    between = weighted(ZOOM.vignetting, ZOOM.focal, 30, 2.8, 1000)
    assert -1.0 < between[0] < -0.4


def test_of_entries_with_one_name_the_one_is_taken_that_lensfun_takes():
    full, cropped = sorted(PRIMES, key=lambda one: one.crop_factor)
    assert chosen(PRIMES, 1.0) is full and chosen(PRIMES, 1.53) is cropped and chosen(PRIMES, 1.6) is cropped
    assert chosen(PRIMES, 1.3) is full and chosen(PRIMES, 0.79) is full and chosen(PRIMES, 0) is full
    assert chosen(PRIMES, 1.5) is cropped  # 2 % larger than the calibrated one


def test_the_stages_apply_what_the_calibration_says(path):
    file = path(ZOOM)
    stage = Distortion(lens_profile=file, focal_length=28.0, crop_factor=1.0)
    height = np.linspace(0, ZOOM.half_diagonal(), 37)
    real = ZOOM.heights(height, 28.0)
    for number, wavelength in enumerate((0.46, 0.54, 0.6)):
        # a cubic spline through 521 heights of a quartic: far below 1e-3 of the field
        assert np.allclose(stage.map().distort(1e3 * height, wavelength), 1e3 * real[:, number], atol=1e-3)
    light = Falloff(lens_profile=file, focal_length=20.0, f_number=2.8, crop_factor=1.0)
    table, square = light.rows(), (height / ZOOM.half_diagonal()) ** 2
    wanted = 1 - square + 0.5 * square**2 - 0.2 * square**3
    assert np.allclose(np.interp(height, table.nodes, table.values[:, 0]), wanted, atol=1e-5)


def test_a_stage_s_own_values_are_before_those_of_the_lens(path):
    file = path(ZOOM)
    assert Distortion(lens_profile=file, focal_length=28.0, k1=0.1).map().table is None
    assert not Falloff(lens_profile=file, focal_length=20.0, f_number=2.8, model="disc").tabled()
    assert not Falloff(lens_profile=path(PRIMES[0]), focal_length=50.0, f_number=2.8).tabled()  # not measured: cos4


def test_a_lens_of_another_mount_is_refused_unless_there_is_an_adapter(path):
    file = path(ZOOM)
    with pytest.raises(ValueError, match="has the mount Alpha, the body Beta.*adapter = true"):
        Distortion(lens_profile=file, mount="Beta")
    Distortion(lens_profile=file, mount="Beta", adapter=True)
    Distortion(lens_profile=path(POLY5), mount="Alpha")  # Alpha takes Screw


def test_a_lens_file_is_read_as_it_was_written_and_a_wrong_one_refused_in_one_line(path, tmp_path):
    own = lens_file(path(ZOOM, *PRIMES))
    assert own.entries[0].distortion == ZOOM.distortion and own.licence == "CC0-1.0"
    text = own.text()
    for number, wrong in enumerate((text[:40], text.replace("ptlens", "acm"), text.replace("0.01", "NaN"), "[" * 9999)):
        other = tmp_path / f"wrong{number}.lens"
        other.write_text(wrong)
        with pytest.raises(ValueError, match=r"^wrong\d\.lens is not a lens file: [^\n]{1,220}$"):
            lens_file(str(other))

"""A window of wavelengths shows its part of the light, and tables end by rule. In: small pipelines. Out: radiance,
photocurrent, notes.
"""

import math
from pathlib import Path

import numpy as np
import pytest
import xarray
from numpy.testing import assert_allclose
from PIL import Image

import etendue
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.plan.planner import make_plan
from etendue.session import from_document
from etendue_camera import spectra
from etendue_camera.constants import LUMINOUS_EFFICACY, PLANCK, SPEED_OF_LIGHT

SMALLEST = Path(__file__).parents[2] / "pipelines" / "smallest.toml"
SENSOR = ("irradiance", "diffraction", "diffusion", "pixel", "mosaic")


def document(low, high, *stages, step=10.0, scene=None, camera=None, **tables):
    start = {"use": "uniform", "name": "scene", "white_luminance": 100.0, "width": 32.0, "height": 32.0, "spacing": 2.0}
    start |= {"wavelength_from": low, "wavelength_to": high, "bin_width": step, **(scene or {})}
    return {
        "name": "window",
        "precision": "float64",
        "camera": {"peak_qe": [0.4, 0.5, 0.3], **(camera or {})},
        "stages": [start, *({"use": use, **tables.get(use, {})} for use in stages)],
    }


def notes(*asked, **tables):
    said = make_plan(from_document(document(*asked, **tables)), installed_stages()).warnings
    return [text for text in said if "not used by any stage" not in text]


def ran(variable, *asked, **tables):
    tree = etendue.simulate({**document(*asked, **tables), "wanted": [variable]}, leave_out=False)
    stage, _, name = variable.partition(".")
    return tree[stage][name]


# ------------------------------------------------------------------------------------------------ windows


@pytest.fixture
def picture(tmp_path):
    path = tmp_path / "picture.png"
    Image.fromarray(np.random.default_rng(3).integers(0, 256, (16, 16, 3), dtype=np.uint8)).save(path)
    return str(path)


SOURCES = {
    "uniform": {},
    "slanted_edge": {"illuminant": "3200 K"},
    "composite": {"illuminant": "FL11"},
    "colorchecker": {"illuminant": "A"},
    "dead_leaves": {"illuminant": "E", "smallest": 4.0, "largest": 10.0},
    "photograph": {},
    "siemens_star": {"illuminant": "ISO 7589 Photoflood"},
}


@pytest.mark.parametrize("use", SOURCES)
def test_two_windows_of_light_add_up_to_the_whole(use, picture):
    """Radiance by bin the same to rounding; the charge, a sum over bands behind one transform for each, to 1e-13 of
    the largest.
    """
    own = dict(SOURCES[use])
    tables = {"scene": {"use": use}, "camera": {"illuminant": own.pop("illuminant", "D65")}}
    tables["scene"] |= own | ({"file": picture} if use == "photograph" else {})
    blue, green, both = (ran("scene.radiance", *w, **tables).values for w in ((400, 500), (500, 600), (400, 600)))
    assert_allclose(np.concatenate([blue, green]), both, rtol=1e-12)
    blue, green, both = (
        ran("mosaic.photocurrent", *w, *SENSOR, **tables).values for w in ((400, 500), (500, 600), (400, 600))
    )
    assert_allclose(blue + green, both, atol=1e-13 * both.max())


def test_a_cube_at_a_stated_level_is_the_same_whichever_bands_it_has(tmp_path):
    def white(low, high):
        edges = np.arange(low, high + 1.0, 10.0)
        bounds = np.stack([edges[:-1], edges[1:]], axis=1)
        data = xarray.Dataset(
            {
                "radiance": (("wavelength", "y", "x"), np.ones((len(bounds), 4, 4))),
                "wavelength_bounds": (("wavelength", "bounds"), bounds),
            },
            {"wavelength": bounds.mean(axis=1), "y": np.arange(4.0), "x": np.arange(4.0)},
        )
        path = tmp_path / f"{low}.zarr"
        data.to_zarr(path, consolidated=False)
        cube = {"use": "radiance_cube", "name": "scene", "file": str(path), "white_luminance": 100.0}
        tree = etendue.simulate(
            {"name": "cube", "camera": {"illuminant": "A"}, "stages": [cube], "wanted": ["scene.white_radiance"]}
        )
        return tree["scene"].white_radiance.values

    assert_allclose(white(450, 500), white(440, 520)[1:6], rtol=1e-12)


def test_two_windows_of_the_smallest_camera_add_up():
    def photocurrent(low, high):
        window = {"scene__wavelength_from": low, "scene__wavelength_to": high}
        tree = etendue.simulate(
            SMALLEST, want=["photocurrent"], f_number=2.8, pixel_pitch=5.4, leave_out=False, **window
        )
        return tree["mosaic"].photocurrent.values

    whole = photocurrent(400, 700)
    # sums of six bands in another order, in float32: 2.7e-6 at most on the processors that were tried
    assert_allclose(photocurrent(400, 500) + photocurrent(500, 700), whole, atol=4e-6 * whole.max())


@pytest.mark.parametrize("name", ["D65", "A", "FL11", "E", "3200 K", "1e5 K"])
def test_the_luminance_of_a_whole_light_is_the_one_asked_for(name):
    """Against sums at 0.1 nm, where products of means err by 1e-7 at the lines of FL11."""
    edges = np.arange(3800, 7801) / 10.0
    light = spectra.light_of_luminance(name, edges, 250.0)
    seen = LUMINOUS_EFFICACY * np.sum(light * spectra.luminous_efficiency(edges) * np.diff(edges))
    assert_allclose(seen, 250.0 * spectra.rendered_share(name, 380.0, 780.0), rtol=1e-6)
    assert 0.997 < spectra.rendered_share(name, 380.0, 780.0) <= 1.0


def test_luminance_is_that_of_exact_sums_over_the_rows():
    """Fractions for tables (S and V linear between rows, S held beyond), 40 digits for Planck: `mpmath.quad` on
    every nm.
    """
    for name, exact in (("D65", 7217323.319291201), ("A", 7369440.724526171), ("FL11", 999739.6632606183)):
        assert_allclose(spectra.luminance_of(name), exact, rtol=1e-15)
    for name, exact in (
        ("1000 K", 17881019.9178710931),
        ("3200 K", 7271073.68401123587),
        ("1e5 K", 7690530.92057867271),
    ):
        assert_allclose(spectra.luminance_of(name), exact, rtol=3e-15)


def test_a_watt_at_the_peak_of_the_eye_is_worth_683_lumens():
    assert_allclose(spectra.luminance_of("555 nm"), 683.002, rtol=1e-15)


def test_a_window_that_holds_a_part_of_the_luminance_is_noted_and_a_line_is_not():
    assert any("400 to 500 nm contains 7.7 % of the luminance of D65" in text for text in notes(400, 500))
    assert not notes(400, 700)
    assert not notes(545, 555, camera={"illuminant": "550 nm"})


def test_a_light_that_no_eye_sees_has_a_radiance_and_no_luminance():
    infrared = {"illuminant": "850 nm", "sensitivity": "flat", "pattern": "mono", "peak_qe": [1.0]}
    with pytest.raises(RequestError, match="'850 nm' is not visible and has no luminance.*radiance"):
        notes(840, 860, camera=infrared)
    level = {"white_luminance": 0.0, "radiance": 0.5}
    rate = ran(
        "mosaic.photocurrent",
        840,
        860,
        "irradiance",
        "pixel",
        "mosaic",
        step=20.0,
        scene=level,
        camera=infrared | {"f_number": 4.0, "pixel_pitch": 5.0, "aperture_fraction": 1.0},
    )
    photons = math.pi * 0.5 / (4 * 4**2) * 25e-12 * 850e-9 / (PLANCK * SPEED_OF_LIGHT)
    assert_allclose(rate.values, photons, rtol=1e-12)
    with pytest.raises(RequestError, match="give one of them for the level"):
        notes(400, 700, scene={"radiance": 1.0})
    with pytest.raises(RequestError, match="give one of them for the level"):
        notes(400, 700, scene={"white_luminance": 0.0})


def test_a_light_whose_luminance_nobody_measured_is_refused_and_a_little_of_it_is_noted():
    with pytest.raises(
        RequestError, match=r"tabulated from 350 to 560 nm. If its end values were extended, 55 % of its luminance"
    ):
        notes(400, 500, camera={"illuminant": "ISO 7589 Sensitometric Printer"})
    said = notes(400, 690, camera={"illuminant": "ISO 7589 Studio Tungsten"})
    assert any("its end values are used, which make up 0.19 % of its luminance" in text for text in said)


# ----------------------------------------------------------------------------------------------- table ends


def table(tmp_path, name, header, rows):
    path = tmp_path / name
    path.write_text("\n".join([header, *(",".join(f"{v:.17g}" for v in row) for row in rows)]) + "\n")
    return str(path)


def test_red_patches_have_the_charge_of_a_sum_by_hand_over_the_rows_of_the_sensitivity(tmp_path):
    """Rows every 10 nm stand for half a step around them: bins to 705 nm are full with a table to 700.

    By hand: everything linear to 1 nm, trapezoids, end values held. Products of means over bins of 10 nm miss that by
    0.3 % in the steepest patch; a lost half bin by 4 to 8 %.
    """
    rows = np.arange(400.0, 701.0, 10.0)
    curves = np.stack(
        [
            0.02 + np.exp(-(((rows - 610) / 50) ** 2)),
            np.exp(-(((rows - 535) / 45) ** 2)),
            np.exp(-(((rows - 460) / 30) ** 2)),
        ]
    )
    curves[0, rows > 620] = np.maximum(curves[0, rows > 620], 0.6)  # no filter cuts the infrared
    path = table(tmp_path, "camera.csv", "wavelength_nm,R,G,B", np.column_stack([rows, curves.T]))
    camera = {
        "sensitivity": path,
        "peak_qe": [1.0, 1.0, 1.0],
        "pixel_pitch": 4.0,
        "aperture_fraction": 1.0,
        "f_number": 4.0,
    }
    chart = {"use": "colorchecker", "width": 240.0, "height": 160.0, "spacing": 2.0, "light": "cells", "softness": 0.0}
    rate = ran("pixel.photon_rate", 395, 705, "irradiance", "pixel", scene=chart, camera=camera).values[0]
    fine = np.arange(395.0, 706.0)
    light = spectra.light_of_luminance("D65", [*(fine - 0.5), 705.5], 100.0)
    reflectance = spectra.colorchecker([*(fine - 0.5), 705.5])[1]
    weight = np.interp(fine, rows, curves[0] / curves[0].max()) * fine * 1e-9 / (PLANCK * SPEED_OF_LIGHT)
    by_hand = np.trapezoid(reflectance * light * weight, fine, axis=1) * math.pi / (4 * 4**2) * 16e-12
    centres = rate[5::10, 5::10].ravel()
    assert centres.shape == (24,)
    assert_allclose(centres, by_hand, rtol=5e-3)


def test_a_sensitivity_that_ends_in_the_light_is_noted_with_what_hangs_on_it(tmp_path):
    rows = np.arange(400.0, 701.0, 10.0)
    path = table(tmp_path, "camera.csv", "wavelength_nm,R,G,B", [(w, 1.0, 1.0, 0.0 if w > 600 else 1.0) for w in rows])
    stages = ("irradiance", "pixel")
    assert not any("rows from" in text for text in notes(395, 705, *stages, camera={"sensitivity": path}))
    said = [text for text in notes(400, 780, *stages, camera={"sensitivity": path}) if "rows from" in text]
    # 75 nm beyond 705 of 380, flat
    assert len(said) == 1 and "rows from 400 to 700 nm" in said[0] and "20 % of the signal of R" in said[0]
    sigma = "Sigma SDMerill (NPL)"
    ended = [(w, *(3 * [1.0 if 450 < w < 650 else 0.0])) for w in rows]
    path = table(tmp_path, "ended.csv", "wavelength_nm,R,G,B", ended)
    assert not any("rows from" in text for text in notes(380, 780, *stages, camera={"sensitivity": path}))
    assert any(
        "'Sigma SDMerill (NPL)' has rows from 400" in text
        for text in notes(380, 780, *stages, camera={"sensitivity": sigma})
    )


def test_a_filter_covers_half_a_step_beyond_its_rows_and_is_noted_farther_out(tmp_path):
    path = table(tmp_path, "glass.csv", "wavelength_nm,transmission", [(w, 0.92) for w in range(400, 701, 10)])
    filtered = {"optical_filter": {"table": path}}
    whole = ran("optical_filter.white_irradiance", 395, 705, "irradiance", "optical_filter", **filtered).values
    bare = ran("irradiance.white_irradiance", 395, 705, "irradiance").values
    assert_allclose(whole, 0.92 * bare, rtol=1e-12)
    assert not notes(395, 705, "irradiance", "optical_filter", **filtered)
    assert any("counts as 0" in text for text in notes(380, 780, "irradiance", "optical_filter", **filtered))


def test_reflectances_hold_their_end_values_and_are_noted(tmp_path):
    rng = np.random.default_rng(1)
    rows = np.arange(420.0, 681.0, 20.0)
    patches = np.column_stack([rows, rng.uniform(0.05, 0.9, (rows.size, 12))])
    header = "wavelength_nm," + ",".join(f"p{i}" for i in range(12))
    short = table(tmp_path, "short.csv", header, patches)
    padded = np.concatenate([[[360.0, *patches[0, 1:]]], patches, [[790.0, *patches[-1, 1:]]]])
    long = table(tmp_path, "long.csv", header, padded)
    matrices = [
        ran("colour_fit.colour_matrix", 380, 780, "irradiance", "colour_fit", colour_fit={"reflectances": path}).values
        for path in (short, long)
    ]
    assert_allclose(*matrices, rtol=1e-12)
    assert any(
        "end values are used" in text
        for text in notes(380, 780, "irradiance", "colour_fit", colour_fit={"reflectances": short})
    )
    assert not notes(380, 780, "irradiance", "colour_fit", colour_fit={"reflectances": long})


def test_a_scale_that_does_not_cover_the_light_is_refused(tmp_path):
    path = table(tmp_path, "quartz.csv", "wavelength_nm,scale", [(w, 1.0) for w in range(450, 651, 10)])
    split = {"separation_x": 2.0, "dispersion": path}
    edge = {"use": "slanted_edge"}
    with pytest.raises(RequestError, match="rows from 450 to 650 nm, but the light extends from 400 to 700 nm"):
        notes(400, 700, "irradiance", "birefringent", birefringent=split, scene=edge)


def test_columns_by_wavelength_that_do_not_cover_the_light_are_noted(tmp_path):
    path = table(tmp_path, "falloff.csv", "height_mm,450,550,650", [(0, 1, 1, 1), (4, 0.5, 0.6, 0.7)])
    stages, falloff = ("irradiance", "falloff"), {"model": "table", "table": path}
    assert any(
        "has 450 to 650 nm; outside this range the nearest column" in text
        for text in notes(400, 780, *stages, falloff=falloff)
    )
    assert not notes(440, 660, *stages, falloff=falloff)


def test_reflectances_of_the_library_are_noted_where_light_is_infrared():
    chart = {"use": "colorchecker"}
    assert not notes(380, 780, scene=chart)
    assert any(
        "ColorChecker has rows from 380 to 730 nm" in text
        for text in notes(380, 1000, scene=chart, camera={"illuminant": "3200 K"})
    )

"""Exposure from a thousandth to a thousand times the right one: pictures brighten and end in white. In: small
cameras.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import etendue
from etendue_camera.electronics import amplifier
from etendue_camera.mosaic import white_balance

FACTORS = np.logspace(-3, 3, 25)  # beside the time at which a diffuse white begins to clip
LIGHT = ("irradiance", "diffraction", "diffusion", {"use": "pixel", "rows": 48, "columns": 48}, "mosaic")
IDEAL, NOISY = ("ideal_mosaic",), ("exposure", "shot_noise", "full_well", "read_noise", "adc", "linearise")
BALANCED = ("white", "balance_mosaic", {"use": "demosaic_bilinear", "name": "demosaic"})
UNBALANCED = ({"use": "demosaic_bilinear", "name": "demosaic"}, "white")
COLOUR = ("colour_fit", "camera_to_xyz", "balance", "display", "encode")
SIDE = {
    "width": "280 um",
    "height": "280 um",
    "spacing": "1 um",
    "bin_width": 60,
    "wavelength_from": 400,
    "wavelength_to": 700,
}
CHARTS = {
    "composite": {"use": "composite", "white_luminance": 250},
    "colours": {"use": "colorchecker", "white_luminance": 250},
    "grey": {"use": "uniform", "white_luminance": 250, "reflectance": 0.18},
    "white": {"use": "uniform", "white_luminance": 250},
}
CAMERA = {"peak_qe": [0.36, 0.44, 0.40], "f_number": 4, "read_noise": 20, "dsnu": 5}
RIGHT = 0.04  # s, about where a diffuse white clips at f/4


def exposed(chart, *stages, wanted, factors=FACTORS, **camera):
    """A camera over exposures; time is the first dim of every variable."""
    entries = [{"use": s} if isinstance(s, str) else s for s in (*LIGHT, *stages)]
    document = {
        "name": "exposed",
        "precision": "float64",
        "camera": {**CAMERA, **camera},
        "stages": [{**CHARTS[chart], **SIDE, "name": "scene"}, *entries],
        "wanted": wanted,
        "sweep": {"integration_time": [RIGHT * f for f in factors]},
    }
    return etendue.simulate(document)


def luma(pictures):
    return np.tensordot([0.2126, 0.7152, 0.0722], np.moveaxis(pictures, 1, 0), axes=1)


@pytest.mark.parametrize("brightness", ["scene", "camera"])
@pytest.mark.parametrize("chart", ["composite", "colours", "grey", "white"])
def test_the_balanced_mosaic_never_falls_when_the_exposure_rises(chart, brightness):
    tree = exposed(chart, *IDEAL, *BALANCED[:2], wanted=["balance_mosaic.mosaic_linear"], brightness=brightness)
    assert np.diff(tree["balance_mosaic"].mosaic_linear.values, axis=0).min() >= 0  # exactly


@pytest.mark.parametrize("way", [BALANCED, UNBALANCED], ids=["balanced mosaic", "own channels"])
@pytest.mark.parametrize("brightness", ["scene", "camera"])
@pytest.mark.parametrize("chart", ["grey", "white"])
def test_an_even_neutral_scene_never_darkens_and_ends_in_white(chart, brightness, way):
    picture = exposed(chart, *IDEAL, *way, *COLOUR, wanted=["rgb_display"], brightness=brightness)[
        "encode"
    ].rgb_display.values
    assert np.diff(picture, axis=0).min() >= -1e-13  # the same value over and over, but for roundings
    assert_allclose(
        picture[-1], 1.0, atol=1e-3
    )  # the white of the balance is a spectrum, that of the display a chromaticity
    grey = picture[0].mean()
    if brightness == "camera":
        assert grey < 0.02  # a thousandth of the light
    else:  # as long as nothing clips the scene's brightness is shown, whatever the time
        assert_allclose(grey, 0.461 if chart == "grey" else 1.0, atol=1e-3)  # 0.18, encoded


@pytest.mark.parametrize("brightness", ["scene", "camera"])
@pytest.mark.parametrize("chart", ["composite", "colours"])
def test_luma_does_not_fall_when_the_exposure_rises(chart, brightness):
    """Noise-free, bilinear, not sharpened: 0.01 at most, where one channel of a colour clips in front of the others."""
    pictures = exposed(chart, *IDEAL, *BALANCED, *COLOUR, wanted=["rgb_display"], brightness=brightness)[
        "encode"
    ].rgb_display.values
    encoded = luma(pictures)
    highest = np.maximum.accumulate(encoded, axis=0)
    assert (highest - encoded).max() <= 0.01


@pytest.mark.parametrize("sensor", [IDEAL, NOISY], ids=["expected values", "noise"])
@pytest.mark.parametrize("brightness", ["scene", "camera"])
@pytest.mark.parametrize("way", [BALANCED, UNBALANCED], ids=["balanced mosaic", "own channels"])
@pytest.mark.parametrize(
    "conversion_gain", [0, 0.05, 2.0], ids=["well at the top code", "well below it", "well above it"]
)
def test_what_is_clipped_all_over_is_white(sensor, brightness, way, conversion_gain):
    tree = exposed(
        "composite",
        *sensor,
        *way,
        *COLOUR,
        wanted=["xyz_scene", "rgb_linear", "white_xyz"],
        brightness=brightness,
        factors=[1e6],
        conversion_gain=conversion_gain,
        illuminant="A",
    )
    white = tree["colour_fit"].white_xyz.values.reshape(-1, 3)[0]
    assert_allclose(
        tree["camera_to_xyz"].xyz_scene.values[0], np.broadcast_to(white[:, None, None], (3, 48, 48)), rtol=1e-6
    )
    assert_allclose(tree["display"].rgb_linear.values[0], 1.0, atol=1e-3)


def test_shading_raises_the_level_of_clipping_by_its_smallest_gain():
    """A window in the corner of a wide field, corrected: no pixel clips at 1 any more, and what does is still white."""
    corner = {"use": "pixel", "rows": 48, "columns": 48}
    stages = ("falloff", *LIGHT[1:3], corner, "mosaic", *IDEAL, "lens_shading", "white", "balance_mosaic")
    entries = [{"use": s} if isinstance(s, str) else s for s in ("irradiance", *stages)]
    scene = {**CHARTS["white"], **SIDE, "name": "scene", "centre_x": "3000 um", "centre_y": "2000 um"}
    document = {
        "name": "corner",
        "precision": "float64",
        "camera": {**CAMERA, "focal_length": "4 mm"},
        "stages": [scene, *entries],
        "sweep": {"integration_time": [0.4 * RIGHT, 1e3 * RIGHT]},
        "wanted": ["lens_shading", "balance_mosaic"],
    }
    tree = etendue.simulate(document)
    level = tree["lens_shading"].clipping_level.values
    bright = tree["lens_shading"].mosaic_linear.values[1]
    assert level[0] == level[1] == bright.min() > 1.5
    balanced = tree["balance_mosaic"]
    assert_array_equal(balanced.mosaic_linear.values[1], level[1])
    assert_array_equal(balanced.white.values[1], np.full(3, level[1]))
    assert balanced.mosaic_linear.values[0].max() < level[0]


@pytest.mark.parametrize(("render_exposure", "time"), [(0.5, 0.3), (0.5, 0.7), (0.5, 3.0), (2.0, 0.3), (2.0, 3.0)])
def test_display_white_is_the_scenes_white_over_its_exposure_or_what_clips(render_exposure, time):
    found = exposed(
        "white",
        *IDEAL,
        *BALANCED,
        *COLOUR,
        wanted=["white", "white.white", "rgb_linear"],
        factors=[time],
        render_exposure=render_exposure,
    )
    diffuse = found["white"].white.values[0] * render_exposure
    shown = min(diffuse.max() / render_exposure, 1.0)
    assert_allclose(found["balance_mosaic"].white.values[0], np.full(3, shown), rtol=1e-15)
    assert_allclose(found["display"].rgb_linear.values[0], min(diffuse.max(), 1.0) / shown, rtol=1e-3)


def test_the_lowest_code_of_a_clipped_pixel_is_that_of_the_converter():
    """Against the converter itself, over wells on both sides of the top code, noise-free and four sigma down."""
    from etendue_camera.electronics import converter

    for well in np.linspace(100, 6000, 401):
        for gain, black, bits in ((1.0, 64, 12), (0.37, 0, 10), (3.3, 16.0, 14)):
            for sigma in (0.0, 3.0):
                lowest = amplifier.lowest_clipped_code(well, gain, black, bits, sigma)
                code = float(converter.digitise(np.array([well - 4 * sigma]), gain, black, bits)[0]) - black
                assert code - 1 <= lowest <= code
                assert (
                    lowest == code
                    or (well - 4 * sigma) * gain + black + 0.5 - np.floor((well - 4 * sigma) * gain + black + 0.5)
                    < 2**-8
                )


@pytest.mark.parametrize(("white", "clipped"), [(0.0, 1.0), (np.nan, 1.0), (1.0, 0.0), (1.0, np.inf), (1.0, np.nan)])
def test_a_level_that_cannot_be_shown_is_refused(white, clipped):
    with pytest.raises(ValueError, match="numbers above 0"):
        white_balance.display_white(white, clipped)


def test_the_charge_of_a_full_well_is_drawn_bright():
    """On the sheet, whose pictures of charge share a scale: what is full is no darker than what was half full."""
    seen = []
    for factor in (0.5, 100.0):
        tree = exposed("composite", *NOISY, wanted=["charge"], factors=[factor])
        preview = tree["frames"].preview
        seen.append(
            [
                float(preview.sel(stage=s).mean())
                for s in preview.stage.values
                if "full_well" in str(s) or "read_noise" in str(s)
            ]
        )
    half, full = np.array(seen)
    assert half.size == 2 and (full > half).all()

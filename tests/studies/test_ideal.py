"""Full planes are what the mosaic would be in every channel, without noise, converter and mosaic."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import etendue
from etendue.contract.registry import installed_stages
from etendue_camera.sensor import cfa, crosstalk
from etendue_camera.sensor.crosstalk_planes import diffuse_planes, plane_kernels

CAMERA = """
name = "ideal"
precision = "float64"
[camera]
peak_qe = [0.36, 0.44, 0.40]
full_well_density = "2000 electron um-2"
dark_current_density = "0 A cm-2"
{camera}
[[stages]]
use = "{scene}"
name = "scene"
white_luminance = "700 cd m-2"
width = "200 um"
height = "200 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "lens_gaussian"
sigma = "2 um"
[[stages]]
use = "pixel"
rows = 26
columns = 31
[[stages]]
use = "mosaic"
{chain}
[[stages]]
use = "demosaic_bilinear"
name = "demosaic"
[[stages]]
use = "no_mask"
[[stages]]
use = "ideal_mosaic"
name = "planes"
clip = false
[[stages]]
use = "no_demosaicing"
name = "ideal"
"""
LINEAR = '[[stages]]\nuse = "ideal_mosaic"\nname = "linear"\n'
METERED = '[[stages]]\nuse = "meter"\n'
CROSSTALK = '[[stages]]\nuse = "crosstalk"\n'


def planes(scene="uniform", chain=LINEAR, camera="", **values):
    text = CAMERA.format(scene=scene, chain=chain, camera=camera)
    tree = etendue.simulate(
        text, want=["ideal.rgb_camera", "demosaic.rgb_camera", "linear.mosaic_linear"], leave_out=False, **values
    )
    found = [
        next(iter(tree[name].children.values()), tree[name])[variable].values
        for name, variable in (
            ("ideal", "rgb_camera"),
            ("demosaic", "rgb_camera"),
            ("linear", "mosaic_linear"),
        )
    ]
    return [f.reshape(f.shape[-3:]) if f.ndim >= 3 else f for f in found]


@pytest.mark.parametrize(
    "camera", ["", 'conversion_gain = "0.7 DN/electron"', "analogue_gain = 4.0", "bits = 10\nblack_level = 100"]
)
def test_of_a_uniform_scene_they_are_the_noise_free_bilinear_one_to_rounding(camera):
    ideal, bilinear, _ = planes(camera=camera, integration_time=1e-3)
    assert 0.02 < ideal.max() < 1  # a picture, and nothing of it clipped
    assert_allclose(ideal, bilinear, rtol=1e-12)  # transforms of the light


@pytest.mark.parametrize("pattern", ["RGGB", "GRBG"])
def test_the_mosaic_picks_from_them(pattern):
    ideal, _, mosaic = planes("composite", integration_time=1e-3, pattern=pattern)
    assert_allclose(cfa.pick(ideal, cfa.parse(pattern)), mosaic, rtol=1e-12)


def test_they_are_not_clipped_where_the_mosaic_is():
    ideal, _, mosaic = planes(integration_time=1.0)
    assert mosaic.max() == 1.0
    assert ideal.max() > 2.0


def test_they_grow_with_the_time_and_with_nothing_else_of_the_exposure():
    once, _, _ = planes("composite", integration_time=1e-3)
    twice, _, _ = planes("composite", integration_time=2e-3, read_noise=50.0, dsnu=9.0, dark_current_density=1e-7)
    assert_allclose(twice, 2 * once, rtol=1e-14)


def test_the_whole_chain_without_noise_is_within_half_a_step_of_them():
    quiet = "".join(
        f'[[stages]]\nuse = "{use}"\n{more}'
        for use, more in (
            ("exposure", "prnu = 0\ndark_nonuniformity = 0\n"),
            ("shot_noise", ""),
            ("full_well", ""),
            ("adc", ""),
        )
    )
    chain = quiet + '[[stages]]\nuse = "linearise"\nname = "linear"\n'
    ideal, _, mosaic = planes(chain=chain, camera="bits = 16\nblack_level = 1000", integration_time=1e-3)
    level = cfa.pick(ideal, cfa.parse("RGGB"))
    electrons = level * 2000 * (5.4 * 0.741) ** 2
    # the mean of 806 pixels, 5 standard errors of their shot noise; rounding errors average out far below it
    assert abs((mosaic / level).mean() - 1) < 5 * np.sqrt((1 / electrons).mean() / level.size)


def test_planes_and_mosaic_use_the_time_that_a_metering_has_found():
    chain = METERED + LINEAR
    ideal, bilinear, mosaic = planes(chain=chain)
    assert_allclose(ideal, bilinear, rtol=1e-12)
    assert abs(mosaic.mean() - 1 / 7.8) < 1e-6  # where the metering brings the mean of what it meters, of saturation
    brighter, _, _ = planes(chain=chain, meter__ev_bias=1.0)
    assert_allclose(brighter, 2 * ideal, rtol=1e-12)


@pytest.mark.parametrize("pitch", [1.1, 2.8])
def test_behind_crosstalk_they_are_what_the_mosaic_becomes(pitch):
    chain = CROSSTALK + '[[stages]]\nuse = "crosstalk_planes"\n' + LINEAR
    camera = f'crosstalk = "through_filter"\npixel_pitch = "{pitch} um"'
    ideal, bilinear, mosaic = planes(chain=chain, camera=camera, integration_time=1e-3)
    assert_allclose(ideal, bilinear, rtol=1e-11)
    plain, _, _ = planes(camera='crosstalk = "per_plane"\n' + f'pixel_pitch = "{pitch} um"', integration_time=1e-3)
    assert np.abs(ideal / plain - 1).max() > 0.02  # colours have mixed
    textured, _, mosaic = planes("composite", chain=chain, camera=camera, integration_time=1e-3)
    picked = cfa.pick(textured, cfa.parse("RGGB"))
    red_and_blue = np.ones(picked.shape, bool)
    red_and_blue[::2, 1::2] = red_and_blue[1::2, ::2] = False
    assert_allclose(picked[red_and_blue], mosaic[red_and_blue], rtol=1e-10)  # their pixels all have the same neighbours


@pytest.mark.parametrize("pattern", ["RGGB", "X-Trans", "RGBW", "mono"])
def test_kernels_between_channels_sum_to_the_mixing_of_uniform_light(pattern):
    mask, rng = cfa.parse(pattern), np.random.default_rng(3)
    kernel = rng.uniform(0, 1, (len(mask.channels), 7, 7))
    kernel /= kernel.sum(axis=(1, 2), keepdims=True)
    assert_allclose(plane_kernels(kernel, mask).sum(axis=(2, 3)), crosstalk.mixing(kernel, mask), atol=1e-15)


def test_charge_that_stays_changes_nothing_and_single_precision_stays_single():
    mask, found = cfa.parse("RGGB"), np.random.default_rng(4).uniform(0, 1, (3, 9, 8))
    stays = np.zeros((3, 3, 3))
    stays[:, 1, 1] = 1.0
    assert_allclose(diffuse_planes(found, stays, mask), found, atol=1e-15)
    single = diffuse_planes(found.astype(np.float32), stays, mask)
    assert single.dtype == np.float32
    assert_allclose(single, found, atol=1e-6)


def test_they_say_so_where_crosstalk_is_left_out_of_them():
    kinds = {name: installed_stages().load(name) for name in ("no_mask", "crosstalk", "crosstalk_planes")}
    wandering, without = kinds["no_mask"](crosstalk="through_filter"), {"behind": kinds["crosstalk"]}
    assert "crosstalk_planes" in wandering.warn_among(without)[0]
    assert wandering.warn_among(kinds) == []
    assert kinds["no_mask"]().warn_among(without) == []

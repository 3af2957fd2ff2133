"""The pixel in the camera: contrast at any sampling, windows off centre, microlenses, densities, crosstalk as a
stage.
"""

import math
import warnings

import numpy as np
import pytest
import xarray as xr

import etendue
from etendue.contract.arrays.facts import Facts
from etendue.contract.arrays.grid import Bands, Grid, Line
from etendue.contract.registry import installed_stages
from etendue.pipeline.file import from_document
from etendue.plan.planner import make_plan
from etendue.transfer import sampling
from etendue_camera.sensor import photodiode, silicon
from etendue_camera.sensor.stages.crosstalk import mixing_of
from etendue_camera.sensor.stages.pixel import Diffusion, Pixel
from etendue_camera.sensor.stages.sensitivity import electrons_per_irradiance
from tests.camera.test_levels import COLOUR, camera

QE = {"peak_qe": (0.4, 0.5, 0.3)}


def contrast(samples_per_pixel, cycles_per_pixel, diffusion, pixels=160, pitch=2.0, phase=0.3):
    """Contrast left of a sine behind the pixel (and diffusion at 0.6 um), fitted to the pixels in the middle."""
    step = pitch / samples_per_pixel
    size = round(pixels * samples_per_pixel)
    x = step * (np.arange(size) - 0.5 * (size - 1))
    f = cycles_per_pixel / pitch
    light = np.broadcast_to(1 + 0.5 * np.cos(2 * np.pi * f * x + phase), (16, size))[None]
    fy, fx = sampling.frequencies(16, step, half=False)[:, None], sampling.frequencies(size, step, half=True)[None, :]
    half = sampling.transform(light)
    if diffusion:
        half = half * Diffusion().transfer(fy, fx, np.array([[[0.6]]]))
    half = half * Pixel(**QE, pixel_pitch=pitch, aperture_fraction=1.0).transfer(fy, fx, None, None)
    count = pixels - 8
    first = (0.5 * (size - 1) * step - 0.5 * (count - 1) * pitch) / step
    seen = sampling.sample(half, 16, size, (8, 1, 1), (first, samples_per_pixel, count))[0, 0]
    centre = pitch * (np.arange(count) - 0.5 * (count - 1))
    middle = np.abs(centre) < 0.25 * pixels * pitch
    waves = np.stack([np.ones(count), np.cos(2 * np.pi * f * centre), np.sin(2 * np.pi * f * centre)], axis=1)[middle]
    mean, even, odd = np.linalg.lstsq(waves, seen[middle], rcond=None)[0]
    return math.hypot(even, odd) / (0.5 * mean)


@pytest.mark.parametrize("diffusion", [False, True])
@pytest.mark.parametrize("samples", [2, 2.3, 3, 3.7, 4, 5, 8])
def test_contrast_behind_the_pixel_is_sinc_times_diffusion_at_every_sampling(samples, diffusion):
    for cycles in (0.1, 0.3, 0.45):
        expected = float(np.sinc(cycles))
        if diffusion:
            expected *= float(photodiode.collection_mtf(cycles / 2.0, float(silicon.absorption(0.6)), 1.8, 10.0, 50.0))
        # what is left is the mirror at the borders, which a sine has not
        assert abs(contrast(samples, cycles, diffusion) - expected) < 2e-4


EDGE = {"width": 60, "height": 20, "spacing": 0.5, "wavelength_from": 540, "wavelength_to": 560, "bin_width": 20}


def rate(fraction=0.5, offset=(0.0, 0.0), chart="points", **more):
    """photon_rate of the green channel of a chart."""
    quantities = {
        "aperture_fraction": fraction,
        "aperture_offset_y": offset[0],
        "aperture_offset_x": offset[1],
        **more.pop("camera", {}),
    }
    document = camera(
        "pixel", chart=chart, scene={**EDGE, **more.pop("scene", {})}, pixel=more.pop("pixel", {}), camera=quantities
    )
    return etendue.simulate(document)["pixel"].photon_rate.values[1]


def test_a_window_off_centre_sees_what_a_centred_one_sees_from_the_next_place():
    """Moving every window by half a pitch is moving the sensor by as much: pixels of half the pitch say the same."""
    scene = {"pitch": 15, "spot_sigma": 1.5}
    moved = rate(0.5, (0.0, 0.25), scene=scene, camera={"pixel_pitch": 4.0}, pixel={"rows": 4, "columns": 12})
    still = rate(0.5, (0.0, -0.25), scene=scene, camera={"pixel_pitch": 4.0}, pixel={"rows": 4, "columns": 12})
    # windows of 2 um at both places are the pixels of a sensor with pitch 2 um, read every second row
    fine = rate(1.0, scene=scene, camera={"pixel_pitch": 2.0}, pixel={"rows": 8, "columns": 24})
    off_row = rate(0.5, (-0.25, 0.25), scene=scene, camera={"pixel_pitch": 4.0}, pixel={"rows": 4, "columns": 12})
    np.testing.assert_allclose(off_row, fine[0::2, 1::2], rtol=1e-11)
    assert np.abs(moved - still).max() > 0.05 * moved.max()


def test_windows_off_centre_leave_a_uniform_scene_alone():
    assert np.allclose(rate(0.5, (0.2, -0.25), "uniform"), rate(0.5, chart="uniform"), rtol=1e-13)


def test_a_microlens_multiplies_the_light_of_pixel_and_white_alike():
    tree = {
        gain: etendue.simulate(
            camera("pixel", *("mosaic", "white"), camera={"aperture_fraction": 0.5, "microlens_gain": gain})
        )
        for gain in (1.0, 3.5)
    }
    for stage, variable in (("pixel", "photon_rate"), ("white", "white")):
        np.testing.assert_allclose(
            tree[3.5][stage][variable].values, 3.5 * tree[1.0][stage][variable].values, rtol=1e-13
        )


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"microlens_gain": 2.0}, r"cannot collect more .* the maximum is 1\.821"),
        ({"aperture_offset_x": 0.2}, r"out of its pixel.*may be at most 0\.1295"),
        ({"aperture_offset_y": -0.1, "aperture_fraction": 1.0}, "may be at most 0 pitches"),
        ({"peak_qe": (0.4, 0.5)}, "2 values, but the pattern 'RGGB' has 3 channels: R, G, B"),
        ({"pattern": "RCCC", "peak_qe": (0.4,)}, "channel C.*CSV table with a column C, or use sensitivity_kind"),
        ({"pattern": "RGBE/", "peak_qe": (0.4,)}, "CSV table with a column E$"),
    ],
)
def test_impossible_pixels_are_refused_with_what_is_possible(values, says):
    with pytest.raises(ValueError, match=says):
        Pixel(**{**QE, **values})


def test_a_pixel_that_loses_charge_to_other_colours_says_so_unless_crosstalk_does_it():
    def said(**quantities):
        document = camera("diffusion", "pixel", "mosaic", "crosstalk", chart="points", scene=EDGE, camera=quantities)
        return [
            text
            for text in make_plan(from_document(document), installed_stages()).warnings
            if "charge diffuses into pixels of other colours" in text
        ]

    assert said(pixel_pitch=1.5)
    assert not said(pixel_pitch=1.5, crosstalk="through_filter")
    assert not said(pixel_pitch=1.5, pattern="mono", sensitivity_kind="filter_transmittance", peak_qe=[0.9])
    assert not said(pixel_pitch=6.0, depletion_depth=30.0)


def test_what_is_said_of_lost_charge_hangs_on_the_contrast_at_half_a_cycle_a_pixel():
    grid = Grid.of({"wavelength": Bands((545.0, 565.0)), "y": Line(40), "x": Line(40)})
    told = []
    for depth in (0.5, 1.0, 1.25, 1.5, 2.0, 4.0):
        diode = {"depletion_depth": depth, "diffusion_depth": 10.0, "diffusion_length": 50.0}
        texts = Pixel(**QE, pixel_pitch=5.0, **diode).warn(Facts(), {"irradiance": grid})
        left = photodiode.collection_mtf(0.5 / 5.0, float(silicon.absorption(0.555)), *diode.values())
        told.append(any("charge diffuses" in text for text in texts))
        assert told[-1] == (left < 0.8)
    assert True in told and False in told


def through_filter(chart="uniform", stages=(), **tables):
    quantities = {"crosstalk": "through_filter", **tables.pop("camera", {})}
    return etendue.simulate(
        camera("diffusion", "pixel", "mosaic", "crosstalk", *stages, chart=chart, camera=quantities, **tables)
    )


def test_uniform_light_has_the_same_total_in_both_models_and_mixes_its_colours_in_one():
    """Red pixels give more than they get: red charge is made deeper and wanders farther."""
    both = {
        name: through_filter(camera={"crosstalk": name, "pixel_pitch": 2.0}, pixel={"rows": 12, "columns": 14})
        for name in ("per_plane", "through_filter")
    }
    before, after = (both[name]["crosstalk"].photocurrent.values for name in ("per_plane", "through_filter"))
    np.testing.assert_array_equal(before, both["per_plane"]["mosaic"].photocurrent.values)
    np.testing.assert_allclose(after.sum(), before.sum(), rtol=1e-12)
    assert np.ptp(after) < 0.9 * np.ptp(before)
    assert after[0, 0] < before[0, 0] and after[1, 1] > before[1, 1]
    cell = after[:2, :2]
    np.testing.assert_allclose(after, np.tile(cell, (6, 7)), rtol=1e-13)


@pytest.mark.parametrize("pattern", ["RGGB", "X-Trans"])
def test_grey_stays_grey_behind_crosstalk(pattern):
    """White, colour fit and picture hold the same mixture: noise-free, a grey surface is neutral to the reach of the
    kernels.

    Green pixels of X-Trans have different neighbours, which one white for all of them cannot know: half a per cent.
    """
    noiseless = {
        "peak_qe": [0.5],
        "pattern": pattern,
        "pixel_pitch": 2.0,
        "illuminant": "A",
        "bits": 16,
        "integration_time": 0.05,
    }
    tree = through_filter(
        scene={"reflectance": 0.5, "white_luminance": 500, "width": 48, "height": 48},
        stages=("charge_fraction", "demosaic_any", "white", "colour_fit", "camera_to_xyz"),
        camera=noiseless,
        charge_fraction={"reference_time": 0.05},
    )
    xyz = tree["camera_to_xyz"].xyz_scene.values
    white = tree["colour_fit"].white_xyz.values
    middle = xyz[:, 8:-8, 8:-8].mean(axis=(1, 2))
    np.testing.assert_allclose(middle / middle[1], white, rtol=1e-7 if pattern == "RGGB" else 5e-3)
    assert tree["colour_fit"].fit_residual.item() < 0.05


def test_what_filters_share_is_undone_at_the_price_of_noise():
    """The mixture is invertible, so colours are as right as before; the matrix amplifies the more, the smaller the
    pixels are.
    """

    def fit(**quantities):
        found = etendue.simulate(camera("colour_fit", camera=quantities))["colour_fit"]
        return np.linalg.norm(found.colour_matrix.values, 2), found.fit_residual.item()

    fits = [fit(), *(fit(crosstalk="through_filter", pixel_pitch=p) for p in (20.0, 4.0, 1.1))]
    assert np.all(np.diff([amplified for amplified, _ in fits]) > 0.02)
    np.testing.assert_allclose([residual for _, residual in fits], fits[0][1], rtol=1e-9)


def test_behind_one_filter_both_models_agree_within_the_blur_of_a_pixel():
    """A monochrome sensor, an edge: the models differ by how charge is spread inside the pixel it was made in, 0.4
    per cent here.
    """
    shared = {
        "pattern": "mono",
        "sensitivity_kind": "filter_transmittance",
        "peak_qe": [1.0],
        "pixel_pitch": 2.0,
        "aperture_fraction": 1.0,
    }
    scene = {**EDGE, "angle": 0, "height": 40, "width": 80}
    planes = [
        through_filter("slanted_edge", scene=scene, camera={**shared, "crosstalk": name})[
            "crosstalk"
        ].photocurrent.values[10, 5:-5]
        for name in ("per_plane", "through_filter")
    ]
    step = planes[0].max() - planes[0].min()
    assert 1e-4 < np.abs(planes[1] - planes[0]).max() / step < 0.006
    np.testing.assert_allclose(planes[1].sum(), planes[0].sum(), rtol=1e-12)  # the edge is odd about the middle


def test_the_mixing_of_the_stage_is_that_of_a_picture():
    edges = tuple(np.arange(400.0, 701.0, 20.0))
    pixel = Pixel(**QE, pixel_pitch=2.0, crosstalk="through_filter")
    photons = electrons_per_irradiance(pixel, edges)
    mixed = mixing_of(pixel, edges, photons)
    counts = np.array([1, 2, 1])
    np.testing.assert_allclose(counts @ mixed, counts, rtol=1e-12)
    assert mixed[0, 0] < mixed[2, 2]  # red charge is made deeper
    np.testing.assert_array_equal(mixing_of(Pixel(**QE), edges, photons), np.eye(3))


def planes_of(tree, variable):
    """The arrays of a variable: one for each shape and position of its pixels."""
    return [node[variable] for node in tree.subtree if variable in node.data_vars]


def swept(pixel, pitches):
    document = camera(
        "diffusion",
        "pixel",
        "mosaic",
        "exposure",
        "pixel_numbers",
        scene={**EDGE, "width": 48, "height": 24},
        chart="points",
        pixel=pixel,
        exposure={"prnu": 0, "dark_nonuniformity": 0},
        wanted=["expected_charge", "photon_rate", "full_well"],
    )
    document["sweep"] = {"pixel_pitch": pitches}
    return document


@pytest.mark.parametrize(
    ("pixel", "shapes"),
    [
        ({"sensor_width": 0.048, "sensor_height": 0.024}, {2.0: (12, 24), 3.0: (8, 16), 4.0: (6, 12)}),
        ({"rows": 4, "columns": 8}, dict.fromkeys((2.0, 3.0, 4.0), (4, 8))),
    ],
)
def test_both_kinds_of_pitch_sweep_open_in_xarray_without_a_warning(tmp_path, pixel, shapes):
    etendue.simulate(swept(pixel, list(shapes)), archive=tmp_path / "sweep")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tree = xr.open_datatree(tmp_path / "sweep" / "data.zarr", engine="zarr")
        tree.load()
        found = {}
        for data in planes_of(tree, "photon_rate"):
            assert list(data.channel.values) == ["R", "G", "B"]
            found |= {
                float(pitch): (data.sizes["y"], data.sizes["x"]) for pitch in np.atleast_1d(data.pixel_pitch.values)
            }
    assert found == shapes


def test_densities_follow_a_swept_pitch():
    """Full well and dark charge grow with the area; so does the light of a uniform scene."""
    document = camera(
        "pixel",
        "mosaic",
        "exposure",
        "pixel_numbers",
        "dynamic_range",
        exposure={"prnu": 0, "dark_nonuniformity": 0},
        pixel={"rows": 2, "columns": 2},
        camera={"dark_current_density": 1e-8},
        wanted=["full_well", "dark_charge", "photon_rate"],
    )
    document["sweep"] = {"pixel_pitch": [2.0, 3.0, 5.0]}
    tree = etendue.simulate(document)
    area = np.array([4.0, 9.0, 25.0])
    for stage, variable in (("pixel_numbers", "full_well"), ("dynamic_range", "dark_charge")):
        value = tree[stage][variable].values
        np.testing.assert_allclose(value / value[0], area / area[0], rtol=1e-12)
    light = np.concatenate([d.values[..., 1, 0, 0].ravel() for d in planes_of(tree, "photon_rate")])
    np.testing.assert_allclose(light / light[0], area / area[0], rtol=1e-12)
    # 1e-8 A cm-2 x area x 10 ms over the elementary charge
    np.testing.assert_allclose(
        tree["dynamic_range"].dark_charge.values, 1e-8 * area * 1e-8 * 0.01 / 1.602176634e-19, rtol=1e-12
    )


def test_the_whole_camera_runs_through_the_filters():
    tree = through_filter(
        "composite",
        stages=("exposure", "shot_noise", "full_well", "read_noise", "adc", "linearise", *COLOUR),
        scene={
            "width": 200,
            "height": 160,
            "bin_width": 40,
            "white_luminance": 500,
            "wavelength_from": 380,
            "wavelength_to": 780,
        },
        camera={"pixel_pitch": 2.0},
    )
    assert np.isfinite(tree["encode"].rgb_display.values).all()
    assert list(tree["demosaic_bilinear"].rgb_camera.channel.values) == ["R", "G", "B"]


def test_a_sensor_that_sees_beyond_the_light_says_so(tmp_path):
    def said(sensitivity, **scene):
        document = camera(
            "pixel",
            chart="points",
            scene={**EDGE, **scene},
            camera={"sensitivity": sensitivity, "peak_qe": [0.5], "illuminant": "E"},
        )
        return [
            text for text in make_plan(from_document(document), installed_stages()).warnings if "is ignored" in text
        ]

    def table(last):
        path = tmp_path / f"until_{last}.csv"
        path.write_text(f"wavelength_nm,R,G,B\n400,1,1,1\n{last},1,1,1\n")
        return str(path)

    visible = {"wavelength_from": 400, "wavelength_to": 700, "bin_width": 20}
    assert said("flat", **visible)
    # 400 to 1000 nm, of which the light has half
    assert said(table(1000), **visible)[0].startswith("pixel: 50 %")
    assert not said(table(1000), **{**visible, "wavelength_to": 1000})
    assert not said(table(700), **visible)
    assert not said("Nikon 5100 (NPL)", **visible)
    assert not said("flat", wavelength_from=540, wavelength_to=560, bin_width=20)  # light of a monochromator

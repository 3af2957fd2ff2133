"""Restoration in the camera: by the pipeline's own transfer function and noise, with what it gains and costs."""

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest
import scipy.fft
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import brentq

import etendue
from etendue.api import Facts, moves_light
from etendue.compute.joined.otf import Otf
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.pipeline.file import from_document
from etendue.plan.planner import make_plan
from etendue.transfer import sampling
from etendue_camera.electronics.stages.known_noise import KnownNoise
from etendue_camera.optics.stages.lens import Diffraction
from etendue_camera.resolution import contrast
from etendue_camera.resolution.edges import slanted_edge
from etendue_camera.restoration import deconvolution
from etendue_camera.restoration.stages.deconvolution import RichardsonLucy, Wiener
from etendue_camera.restoration.stages.figures import System
from etendue_camera.restoration.stages.sharpening import Sharpen, Unsharp
from etendue_camera.sensor.stages.pixel import Diffusion, Pixel

EDGES = tuple(float(e) for e in range(400, 720, 40))
QE = (0.36, 0.44, 0.4)
ASKED = frozenset({"mtf50_gain", "noise_gain"})


def light_of(f_number, pitch, **pixel):
    """What the engine hands on of a lens, a photodiode and a pixel."""
    last = Pixel(pixel_pitch=pitch, peak_qe=QE, **pixel)
    parts = (("lens", Diffraction(f_number=f_number)), ("diffusion", Diffusion()), ("pixel", last))
    return [("lens", Otf(parts[:1], EDGES)), ("diffusion", Otf(parts[:2], EDGES)), ("pixel", Otf(parts, EDGES))]


def picture(rows=40, columns=52, seed=0):
    return np.random.default_rng(seed).normal(0.3, 0.1, (3, rows, columns))


def green(transfers, f, pitch):
    """|Transfer function| of the green channel along x, from the bands themselves."""
    otf = transfers[-1][1]
    weights = otf.weights[1] / otf.weights[1].sum()
    return np.abs(weights @ otf(np.atleast_1d(f) / pitch))


# -- the transfer function


@pytest.mark.parametrize(("f_number", "pitch"), [(1.4, 2.0), (4.0, 4.0), (22.0, 2.0)])
def test_each_channel_is_restored_by_the_photon_weighted_mean_of_its_own_bands(f_number, pitch):
    transfers = light_of(f_number, pitch)
    otf = transfers[-1][1]
    fy, fx = np.array([-0.7, -0.2, 0.0, 0.4]), np.array([0.0, 0.1, 0.5, 0.9])
    bands, weights = otf.plane(fy / pitch, fx / pitch), otf.weights
    direct = np.stack([sum(w * b for w, b in zip(row, bands, strict=True)) / row.sum() for row in weights])
    system = System.of(transfers, 3, pitch)
    assert_allclose(system.plane(fy, fx), direct, rtol=0, atol=1e-15)
    assert_allclose(np.abs(system.along(fx)), green(transfers, fx, pitch), rtol=0, atol=1e-15)


@pytest.mark.parametrize(("f_number", "pitch", "shift"), [(1.4, 2.0, 0.0), (4.0, 5.4, 0.1), (22.0, 2.0, 0.0)])
@pytest.mark.parametrize("kind", [Wiener, RichardsonLucy])
def test_a_table_of_the_transfer_function_errs_less_than_it_says(kind, f_number, pitch, shift):
    transfers = light_of(f_number, pitch, aperture_offset_x=shift)
    for nodes in (32, 128):
        stage = kind(pixel_pitch=pitch, nodes=nodes)
        exact = dataclasses.replace(stage, nodes=0).run(picture(), transfers)["rgb_camera"]
        found = stage.run(picture(), transfers)["rgb_camera"]
        assert (
            np.abs(found - exact).max()
            <= stage.error({"rgb_camera": Facts()}, None, "float64")[0] * np.abs(exact).max()
        )


def test_a_large_frame_is_taken_in_parts_with_the_same_values(monkeypatch):
    transfers = light_of(4.0, 4.0)
    whole = Wiener(pixel_pitch=4.0).run(picture(), transfers)["rgb_camera"]
    monkeypatch.setattr("etendue_camera.restoration.stages.figures.BLOCK", 3000)
    assert_array_equal(Wiener(pixel_pitch=4.0).run(picture(), transfers)["rgb_camera"], whole)


def test_planes_that_are_not_the_pixels_channels_are_refused():
    with pytest.raises(ValueError, match="the pixel stage has 3 channels and rgb_camera 1"):
        Wiener(pixel_pitch=4.0).run(picture()[:1], light_of(4.0, 4.0))


def test_where_nothing_blurs_there_is_nothing_to_undo():
    planes = picture()
    nothing = Wiener(aliasing="ignored", noise_variance=1e-300).run(planes, [])["rgb_camera"]
    assert_allclose(nothing, planes, rtol=0, atol=1e-14)
    lucy = RichardsonLucy(stop=0.0, iterations=3).run(planes, [], ASKED)
    assert_allclose(lucy["rgb_camera"], planes, rtol=0, atol=1e-13)
    assert math.isnan(lucy["mtf50_gain"]) and lucy["noise_gain"] == pytest.approx(1.0, rel=1e-14)


# -- Wiener


def waves(rows, columns, cy, cx):
    """A wave that the padded plane of a frame has exactly, cut to the frame, on an even ground."""
    total = sampling.padded_size(rows), sampling.padded_size(columns)
    y, x = np.mgrid[: total[0], : total[1]]
    return 0.4 + 0.1 * np.cos(2 * np.pi * (cy * y / total[0] + cx * x / total[1])), (cy / total[0], cx / total[1])


@pytest.mark.parametrize("aliasing", ["noise", "ignored"])
def test_a_wave_is_restored_as_the_powers_of_picture_noise_and_folded_light_say(aliasing):
    pitch, transfers = 4.0, light_of(4.0, 4.0)
    stage = Wiener(pixel_pitch=pitch, noise_variance=1e-4, contrast=0.3, exponent=1.5, aliasing=aliasing)
    system = System.of(transfers, 3, pitch)
    for fy, fx in ((0.0, 0.21), (-0.3, 0.17), (0.45, 0.5)):
        found = stage.response(system, np.array([fy]), np.array([fx]))[:, 0, 0]
        power = deconvolution.signal_spectrum(fy, fx, 1.5)
        ratio = 1e-4 / 0.3**2 / power
        if aliasing == "noise":
            for oy, ox in ((fy, fx - 1), (fy - math.copysign(1, fy), fx), (fy - math.copysign(1, fy), fx - 1)):
                folded = np.abs(system.plane(np.array([oy]), np.array([ox]))[:, 0, 0]) ** 2
                ratio = ratio + folded * deconvolution.signal_spectrum(oy, ox, 1.5) / power
        transfer = system.plane(np.array([fy]), np.array([fx]))[:, 0, 0]
        assert_allclose(found, np.conj(transfer) / (np.abs(transfer) ** 2 + ratio), rtol=1e-13)


def test_the_picture_is_multiplied_by_the_response_and_its_mean_is_kept():
    rows, columns, pitch = 40, 52, 4.0
    transfers = light_of(4.0, pitch)
    stage = Wiener(pixel_pitch=pitch)
    gain = stage.response(System.of(transfers, 3, pitch), *deconvolution.frequencies(rows, columns))
    plane, _ = waves(rows, columns, 5, 11)
    given = np.broadcast_to(plane[:rows, :columns], (3, rows, columns))
    direct = [
        scipy.fft.irfft2(scipy.fft.rfft2(sampling.pad(one)) * g, s=plane.shape)[:rows, :columns]
        for one, g in zip(given, gain, strict=True)
    ]
    assert_allclose(stage.run(given, transfers)["rgb_camera"], direct, rtol=0, atol=1e-14)
    assert_allclose(gain[:, 0, 0], 1.0, rtol=1e-15)  # weights that sum to 1
    flat = np.full((3, 9, 9), 0.37)
    assert_allclose(stage.run(flat, transfers)["rgb_camera"], 0.37, rtol=1e-14)


def test_beyond_the_cut_off_of_the_lens_nothing_is_made_up():
    pitch, transfers = 1.1, light_of(22.0, 1.1)  # cut-off at 0.07 to 0.125 cycle/pixel
    for stage in (Wiener(pixel_pitch=pitch, noise_variance=1e-30, largest_gain=1e6), Wiener(pixel_pitch=pitch)):
        fy, fx = deconvolution.frequencies(64, 64)
        gain = stage.response(System.of(transfers, 3, pitch), fy, fx)
        assert np.all(np.isfinite(gain)) and np.abs(gain).max() <= stage.largest_gain * (1 + 1e-15)
        assert np.all(gain[:, np.hypot(fy[:, None], fx) > 0.13] == 0)
    with_pictures = Wiener(pixel_pitch=pitch).run(picture(), transfers, ASKED)
    assert np.all(np.isfinite(with_pictures["rgb_camera"])) and with_pictures["mtf50_gain"] > 1


@pytest.mark.parametrize(("f_number", "pitch"), [(1.4, 5.4), (2.8, 4.0), (8.0, 2.0)])
def test_at_the_nyquist_frequency_half_is_folded_and_at_most_half_comes_back(f_number, pitch):
    transfers = light_of(f_number, pitch)
    system, f = System.of(transfers, 3, pitch), np.array([0.5])
    for noise in (1e-9, 1e-3):
        response = Wiener(pixel_pitch=pitch, noise_variance=noise).response(system, np.zeros(1), f)
        assert np.all(np.abs(response * system.plane(np.zeros(1), f)) <= 0.5)


def test_the_price_in_noise_is_what_white_noise_pays():
    pitch, transfers = 4.0, light_of(2.8, 4.0)
    noise = 0.3 + 1e-3 * np.random.default_rng(1).standard_normal((3, 240, 240))
    for stage in (
        Wiener(pixel_pitch=pitch),
        Sharpen(pixel_pitch=pitch),
        Unsharp(pixel_pitch=pitch),
        RichardsonLucy(pixel_pitch=pitch, stop=0.0, iterations=6),
    ):
        found = stage.run(noise, transfers, ASKED)
        assert found["noise_gain"] > 1.1
        assert_allclose(
            found["rgb_camera"][1].std() / noise[1].std(), found["noise_gain"], rtol=0.02
        )  # 57600 draws: 0.6 %


def test_the_gain_in_mtf50_is_that_of_the_green_curves():
    pitch, transfers = 4.0, light_of(8.0, 4.0)
    before = brentq(lambda f: green(transfers, f, pitch)[0] - 0.5, 0.05, 0.5)
    stage = Wiener(pixel_pitch=pitch, noise_variance=1e-4)
    system = System.of(transfers, 3, pitch)

    def after(f):
        response = stage.response(system, np.zeros(1), np.array([f]))[1, 0, 0]
        return green(transfers, f, pitch)[0] * abs(response) - 0.5

    found = stage.run(picture(), transfers, ASKED)["mtf50_gain"]
    assert_allclose(found, brentq(after, before, 0.5) / before, rtol=1e-6)
    assert found > 1.1
    lucy = RichardsonLucy(pixel_pitch=pitch, stop=0.0, iterations=2)

    def deconvolved(f):
        transfer = green(transfers, f, pitch)[0]
        return 1 - (1 - transfer) * (1 - transfer**2) ** 2 - 0.5

    assert_allclose(
        lucy.run(picture(), transfers, ASKED)["mtf50_gain"], brentq(deconvolved, before, 0.5) / before, rtol=1e-6
    )


def test_less_noise_buys_more_resolution():
    transfers = light_of(8.0, 4.0)
    figures = [
        Wiener(pixel_pitch=4.0, noise_variance=v).run(picture(), transfers, ASKED) for v in (1e-2, 1e-3, 1e-4, 1e-5)
    ]
    assert np.all(np.diff([f["mtf50_gain"] for f in figures]) > 0)
    assert np.all(np.diff([f["noise_gain"] for f in figures]) > 0)


# -- Richardson-Lucy


def test_richardson_lucy_ends_at_the_noise_of_the_camera():
    transfers, planes = light_of(4.0, 4.0), np.clip(picture(60, 60), 0.01, None)
    quiet, loud = (
        RichardsonLucy(pixel_pitch=4.0, iterations=400, read_noise=noise, start="mean").restored(
            planes, System.of(transfers, 3, 4.0)
        )
        for noise in (400.0, 800.0)
    )
    assert np.all(quiet[2] < 400) and np.all(loud[2] < quiet[2])
    one = RichardsonLucy(pixel_pitch=4.0, read_noise=800.0)
    shot, floor = one.noise_model()
    model = deconvolution.apply(loud[0], loud[1])
    residual = (planes - model).std(axis=(1, 2))
    # the end between two iterations is where a straight line reaches it; beyond the frame the estimate is continued
    # otherwise
    assert_allclose(residual, 0.7 * np.sqrt(shot * planes.mean(axis=(1, 2)) + floor), rtol=0.03)
    untouched = RichardsonLucy(pixel_pitch=4.0, read_noise=8000.0).restored(planes, System.of(transfers, 3, 4.0))
    assert_allclose(untouched[0], planes, rtol=0, atol=1e-15)  # a pedestal, put on and taken away
    assert_array_equal(untouched[2], 0)


# -- families


@pytest.mark.parametrize("kind", [Sharpen, Unsharp, Wiener, RichardsonLucy])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_figures_change_no_bit_of_the_picture_and_come_as_asked_for(kind, dtype):
    transfers, planes = light_of(4.0, 5.4), picture().astype(dtype)
    alone = kind().run(planes, transfers, frozenset())
    assert set(alone) == {"rgb_camera"}
    for asked in (ASKED, frozenset({"noise_gain"})):
        found = kind().run(planes, transfers, asked)
        assert_array_equal(found["rgb_camera"], alone["rgb_camera"])
        assert found["rgb_camera"].dtype == dtype
        assert set(found) == {"rgb_camera", *asked}


CAMERA = {
    "name": "restoring",
    "seed": 3,
    "camera": {"peak_qe": list(QE), "pixel_pitch": 4.0, "f_number": 5.6},
    "stages": [
        {
            "use": "slanted_edge",
            "name": "scene",
            "white_luminance": 1000,
            "width": 200,
            "height": 200,
            "wavelength_from": 500,
            "wavelength_to": 620,
            "bin_width": 40,
        },
        {"use": "irradiance"},
        {"use": "diffraction"},
        {"use": "pixel", "rows": 40, "columns": 40},
        {"use": "mosaic"},
        {"use": "exposure"},
        {"use": "shot_noise"},
        {"use": "read_noise"},
        {"use": "adc"},
        {"use": "linearise"},
        {"use": "demosaic_bilinear", "name": "demosaic"},
        {"use": "sharpen"},
    ],
}
WITH_FIGURES = ["sharpen", "unsharp", "wiener", "richardson_lucy"]
PLAIN = [*WITH_FIGURES, "denoise"]
FIGURES = ["restored.rgb_camera", "mtf50_gain", "noise_gain"]


def restored(uses, **sweep):
    document = {**CAMERA, "stages": [*CAMERA["stages"][:-1], {"use": uses[0], "name": "restored"}]}
    return {**document, "sweep": {"restored.use": uses, **sweep}}


def test_restorations_can_be_swapped_in_a_pipeline_and_the_figures_are_those_of_the_cell():
    pictures = etendue.simulate(restored(PLAIN))["restored"].rgb_camera
    assert list(pictures["restored"].values) == PLAIN
    assert len({pictures.sel(restored=use).values.tobytes() for use in PLAIN}) == len(PLAIN)
    found = etendue.simulate(restored(WITH_FIGURES, f_number=[5.6, 11.0]), want=FIGURES)["restored"]
    gain = found.mtf50_gain.sel(restored="sharpen")
    assert gain.dims == ("f_number",) and np.all(gain > 1.05)
    assert np.all(found.noise_gain.sel(f_number=5.6) > 1)
    assert found.noise_gain.sel(restored="sharpen").values == pytest.approx(
        2.2405, abs=1e-4
    )  # of 0.15, whatever the lens


def test_a_figure_that_one_of_the_alternatives_does_not_have_is_not_there():
    with pytest.raises(RequestError, match="mtf50_gain"):
        etendue.simulate(restored(PLAIN), want=["mtf50_gain"])


def test_asked_for_later_figures_are_added_to_an_archive_without_touching_what_is_there(tmp_path):
    """No key, draw or bit of anything else changes: the picture's file is not even written again."""
    folder = tmp_path / "once"
    document = {**CAMERA, "camera": CAMERA["camera"] | {"f_number": 11.0}}
    etendue.simulate(document, archive=folder)
    stages = {entry["use"] for entry in CAMERA["stages"]} | {"scene", "demosaic"}
    own = [
        p
        for stage in stages
        for p in (folder / "data.zarr" / stage).rglob("*")
        if p.is_file() and "/c" in str(p) and "status" not in str(p)
    ]
    before = {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in own}
    plain = make_plan(from_document(document), installed_stages())
    asked = make_plan(from_document({**document, "wanted": ["sharpen.rgb_camera", "mtf50_gain"]}), installed_stages())
    assert {c.ref: (c.key, c.seed) for c in asked.cells.values()} == {
        c.ref: (c.key, c.seed) for c in plain.cells.values()
    }
    etendue.simulate(document, archive=folder, want=["sharpen.rgb_camera", "mtf50_gain"])
    assert float(xr.open_datatree(folder / "data.zarr", engine="zarr")["sharpen"].mtf50_gain) > 1
    after = {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in before}
    assert len(before) > 5
    assert after == before
    etendue.simulate(document, archive=folder)  # asked for no longer: it stays
    assert float(xr.open_datatree(folder / "data.zarr", engine="zarr")["sharpen"].mtf50_gain) > 1


def test_what_is_left_out_has_its_figures_all_the_same():
    document = {**CAMERA, "stages": [*CAMERA["stages"][:-1], {"use": "sharpen", "strength": 0.0}]}
    found = etendue.simulate(document, want=["sharpen.rgb_camera", "noise_gain"])["sharpen"]
    assert int(found.status) == 1
    assert float(found.noise_gain) == 1.0


def place(picture):
    """Where the edge stands in the middle of the green plane, pixels."""
    return slanted_edge.slanted_edge(np.asarray(picture, dtype=float)[1]).place


PLANES = [{"use": "no_mask"}, {"use": "ideal_mosaic", "clip": False}, {"use": "no_demosaicing"}]


@pytest.mark.parametrize("use", ["wiener", "richardson_lucy"])
def test_where_a_pixel_sees_beside_its_middle_the_edge_is_put_back_in_its_place(use):
    """A transfer function with a phase: undone by its conjugate, not doubled."""
    options = {"noise_variance": 1e-5} if "wiener" in use else {"stop": 0.0}
    document = {
        **CAMERA,
        "camera": CAMERA["camera"]
        | {"f_number": 16.0, "aperture_fraction": 0.36, "integration_time": 1e-3},  # nothing folds
        "stages": [*CAMERA["stages"][:4], *PLANES, {"use": use, "name": "restored", **options}],
        "sweep": {"aperture_offset_x": [0.0, 0.2]},
    }
    found = etendue.simulate(document, want=["no_demosaicing.rgb_camera", "restored.rgb_camera"])
    (still, moved), (right, back) = (
        [place(one) for one in found[name].rgb_camera.values] for name in ("no_demosaicing", "restored")
    )
    assert moved == pytest.approx(still - 0.2, abs=1e-3)  # the measure errs by 3e-4
    within = (
        1e-3 if "wiener" in use else 0.03
    )  # at a hard edge Richardson-Lucy is not linear, and ten iterations are not the end
    assert back == pytest.approx(right, abs=within)
    assert right == pytest.approx(still, abs=within)


def behind(use, restoring):
    stages = [dict(s) for s in CAMERA["stages"]]
    stages[2], stages[-1] = {"use": use}, {"use": restoring, "name": "restored"}
    return {**CAMERA, "stages": stages, "camera": CAMERA["camera"] | {"f_number": 11.0}}


@pytest.mark.parametrize("use", WITH_FIGURES)
def test_behind_a_blur_without_a_transfer_function_no_figure_rests_on_the_rest_of_the_camera(use):
    known = etendue.simulate(behind("diffraction", use), want=FIGURES)["restored"]
    unknown = etendue.simulate(behind("aberrations", use), want=FIGURES)["restored"]
    assert known.mtf50_gain > 1 and math.isnan(unknown.mtf50_gain)
    if use in ("sharpen", "unsharp"):  # their filter hangs on no camera
        assert unknown.noise_gain == known.noise_gain
    else:
        assert math.isnan(unknown.noise_gain)
    assert np.all(np.isfinite(unknown.rgb_camera))


@pytest.mark.parametrize("use", ["wiener", "richardson_lucy"])
def test_a_plan_says_that_a_blur_is_unknown_to_the_restoration(use):
    def warnings(lens):
        return [
            text
            for text in make_plan(from_document(behind(lens, use)), installed_stages()).warnings
            if text.startswith("restored: ")
        ]

    (text,) = warnings("aberrations")
    assert "aberrations has no transfer function" in text
    assert "its metrics are NaN" in text
    assert warnings("diffraction") == warnings("wavefront") == []


def test_a_warp_and_a_blur_that_changes_over_the_field_move_light_and_a_transfer_function_does_not():
    kinds = {name: installed_stages().load(name) for name in installed_stages().names()}
    moving = {name for name, kind in kinds.items() if moves_light(kind)}
    assert {"aberrations", "lens_psf_field", "distortion"} <= moving
    assert not {"diffraction", "wavefront", "falloff", "vignetting", "optical_filter", "pixel"} & moving


def test_the_example_of_a_stage_that_looks_at_the_camera_gives_a_transfer_function():
    guide = (Path(__file__).resolve().parents[2] / "docs" / "plugins.md").read_text(encoding="utf-8")
    (block,) = (b for b in re.findall(r"^```python\n(.*?)^```$", guide, re.M | re.S) if '"*.transfer [1]"' in b)
    space = {"np": np}
    exec(block + "    return camera\n", space)
    along = 4.0 * np.arange(8)
    camera = space["run"](None, None, light_of(4.0, 4.0), along, along)
    assert_allclose(camera[:, 0, 0], 1.0, rtol=1e-14)
    assert camera.shape == (3, 8, 5) and np.all(np.abs(camera) <= 1 + 1e-14)


# -- noise


@pytest.mark.parametrize("read_noise", [0.0, 30.0])
def test_the_noise_that_restoration_reckons_with_is_that_of_the_camera(read_noise):
    quantities = {"read_noise": read_noise, "dsnu": 5.0, "pixel_pitch": 4.0, "full_well_density": 500.0, "bits": 10}
    document = {
        "name": "flat",
        "seed": 1,
        "precision": "float64",
        "camera": {
            **quantities,
            "peak_qe": [0.4],
            "pattern": "mono",
            "sensitivity_kind": "filter_transmittance",
            "integration_time": 0.002,
            "dark_current_density": 0.0,
        },
        "stages": [
            {
                "use": "uniform",
                "name": "scene",
                "white_luminance": 1000,
                "width": 600,
                "height": 600,
                "spacing": 4.0,
                "wavelength_from": 500,
                "wavelength_to": 600,
                "bin_width": 50,
            },
            {"use": "irradiance"},
            {"use": "pixel", "rows": 150, "columns": 150},
            {"use": "mosaic"},
            {"use": "exposure", "prnu": 0.0, "dark_nonuniformity": 0.0},
            {"use": "shot_noise"},
            {"use": "full_well"},
            {"use": "read_noise"},
            {"use": "adc"},
            {"use": "linearise"},
        ],
    }
    plane = etendue.simulate(document)["linearise"].mosaic_linear.values
    assert 0.05 < plane.mean() < 0.9
    shot, floor = KnownNoise(**quantities).noise_model()
    assert_allclose(plane.var(), shot * plane.mean() + floor, rtol=0.05)  # 22500 draws: 0.9 %, five sigma


def test_resolution_is_what_the_search_of_the_other_figures_finds():
    """`mtf50_gain` of no restoration is 1 exactly, of the same search on the same curve."""
    transfers = light_of(8.0, 4.0)
    assert Sharpen(pixel_pitch=4.0, strength=0.0).run(picture(), transfers, ASKED)["mtf50_gain"] == 1.0
    assert contrast.mtf50(lambda f: green(transfers, f, 4.0)[None], None, 1.0, 256) < 0.5

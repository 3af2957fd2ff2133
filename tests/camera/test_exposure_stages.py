"""Exposure, noise and read-out as stages of a camera: gain, metering, frames, patterns, defects, figures."""

import copy
import math
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import etendue
from etendue.contract.arrays.facts import Facts
from etendue.contract.arrays.grid import Grid, Line
from etendue.contract.registry import installed_stages
from etendue.contract.values.late_bound import LateValue
from etendue.errors import RequestError
from etendue.plan.planner import make_plan
from etendue.plan.resume import select
from etendue.session import load
from etendue_camera import spectra
from etendue_camera.constants import LUMINOUS_EFFICACY, PLANCK, SPEED_OF_LIGHT
from etendue_camera.electronics import amplifier, converter, emva
from etendue_camera.electronics.stages.exposure import Exposure, FullWell, ShotNoise
from etendue_camera.electronics.stages.read_out import Adc, Linearise
from etendue_camera.sensor.stages.defects import StuckPixels

PIPELINES = Path(__file__).parents[2] / "pipelines"
READ_OUT = ("shot_noise", "full_well", "read_noise", "adc")


def pipeline(*stages, camera=None, scene=None, sweep=None, wanted=None, **tables):
    """A uniform 550 nm scene behind f/4, 20 x 24 pixels of 5.4 um, and the named stages."""
    document = {
        "name": "exposed",
        "precision": "float64",
        "camera": {
            "peak_qe": [0.5, 0.5, 0.5],
            "sensitivity": "flat",
            "illuminant": "550 nm",
            "f_number": 4,
            "dark_current_density": 0,
            "dsnu": 0,
            **(camera or {}),
        },
        "stages": [
            {
                "use": "uniform",
                "name": "scene",
                "white_luminance": 100,
                "width": 140,
                "height": 120,
                "wavelength_from": 545,
                "wavelength_to": 555,
                "bin_width": 10,
                **(scene or {}),
            },
            {"use": "irradiance"},
            {"use": "pixel", "rows": 20, "columns": 24},
            {"use": "mosaic"},
        ],
    }
    document["stages"] += [{"use": name, **tables.get(name, {})} for name in stages]
    return document | ({"sweep": sweep} if sweep else {}) | ({"wanted": wanted} if wanted else {})


def even(**more):
    return {"prnu": 0, "dark_nonuniformity": 0, **more}


def rate_of_white(quantum_efficiency=0.5, pitch=5.4, fraction=0.741, f_number=4.0):
    """Photocurrent of a white diffuser of 100 cd/m2 at 550 nm, electron/s, and its illuminance at the sensor (as of
    a bin), by hand.
    """
    irradiance = math.pi * 100 / spectra.luminance_of("550 nm") / (4 * f_number**2)
    photons = irradiance * (pitch * fraction * 1e-6) ** 2 * 550e-9 / (PLANCK * SPEED_OF_LIGHT)
    return quantum_efficiency * photons, irradiance * LUMINOUS_EFFICACY * spectra.luminous_efficiency((545.0, 555.0))[0]


# -- temperature and gain


def test_dark_charge_follows_the_temperature_and_is_as_given_at_the_reference():
    document = pipeline(
        "exposure",
        "dynamic_range",
        exposure=even(),
        scene={"reflectance": 0},
        wanted=["expected_charge", "dark_charge"],
        camera={"dark_current_density": 1e-9},
        sweep={"temperature": [288.15, 298.15, 318.15]},
    )
    tree = etendue.simulate(document)
    charge = tree["exposure"].expected_charge.values[:, 0, 0]
    at_reference = 1e-9 / 1.602176634e-19 * 5.4e-4**2 * 0.01
    factors = [amplifier.dark_current_factor(t, 298.15) for t in (288.15, 298.15, 318.15)]
    np.testing.assert_allclose(charge, at_reference * np.array(factors), rtol=1e-14)
    np.testing.assert_allclose(tree["dynamic_range"].dark_charge, charge, rtol=1e-14)


def test_codes_above_black_scale_with_the_gain_until_the_converter_ends_before_the_well():
    document = pipeline(
        "exposure",
        *READ_OUT,
        "linearise",
        "white",
        exposure=even(),
        camera={"read_noise": 0, "bits": 16, "black_level": 0},
        sweep={"analogue_gain": [1, 2, 64]},
        wanted=["raw", "charge", "white"],
    )
    tree = etendue.simulate(document)
    raw, charge = tree["adc"].raw.values.astype(float), tree["full_well"].charge.values
    step = 65535 / (1000 * (5.4 * 0.741) ** 2)
    np.testing.assert_allclose(raw[0], np.floor(charge * step + 0.5), rtol=0, atol=0)
    np.testing.assert_allclose(raw[1], np.floor(charge * 2 * step + 0.5), rtol=0, atol=0)
    assert np.all(raw[2] == 65535)
    assert charge.max() < 1000 * (5.4 * 0.741) ** 2  # and the well is not full
    white = tree["white"].white.values
    np.testing.assert_allclose(white, white[0] * np.array([[1], [2], [64]]), rtol=1e-15)
    np.testing.assert_allclose(white[0], rate_of_white()[0] * 0.01 * step / 65535, rtol=1e-12)


def test_read_noise_behind_the_amplifier_shrinks_with_the_gain():
    document = pipeline(
        "exposure",
        "shot_noise",
        "read_noise",
        exposure=even(),
        scene={"reflectance": 0, "width": 800, "height": 800},
        camera={"read_noise": 3, "read_noise_after": 40},
        pixel={"rows": 128},
        sweep={"analogue_gain": [1, 10]},
        wanted=["charge"],
    )
    document["stages"][2] |= {"rows": 128, "columns": 128}
    noise = etendue.simulate(document)["read_noise"].charge.values.std(axis=(1, 2))
    # 5 standard errors of a deviation from 16384 pixels
    np.testing.assert_allclose(noise, [math.hypot(3, 40), 5.0], rtol=5 / math.sqrt(2 * 128 * 128))


@pytest.mark.parametrize("conversion_gain", [0, 0.1])  # the well at the top code, and at 40 per cent of the codes
def test_a_frame_far_beyond_the_well_is_clipped_whatever_its_codes_say(conversion_gain):
    document = pipeline(
        "exposure",
        *READ_OUT,
        "exposure_report",
        exposure=even(),
        camera={"read_noise": 5, "conversion_gain": conversion_gain},
        sweep={"integration_time": [1e-3, 10]},
        wanted=["clipped_fraction", "raw"],
    )
    tree = etendue.simulate(document)
    assert tree["exposure_report"].clipped_fraction.values.tolist() == [0, 1]
    assert np.any(tree["adc"].raw.values[1] < 4095)


def test_more_light_than_the_sensor_holds_is_no_better_picture():
    """A clipped pixel counts as an SNR of 0; the ratio grows with time before and is nowhere above that of a full
    well.
    """
    document = pipeline(
        "exposure",
        *READ_OUT,
        "exposure_report",
        exposure=even(),
        camera={"read_noise": 5},
        sweep={"integration_time": [1e-4, 1e-3, 1e3]},
        wanted=["clipped_fraction", "mean_snr", "expected_charge", "system_gain"],
    )
    document["stages"].append({"use": "dynamic_range"})
    tree = etendue.simulate(document)
    report = tree["exposure_report"]
    assert report.clipped_fraction.values.tolist() == [0, 0, 1]
    dim, bright, over = report.mean_snr.values
    assert 0 < dim < bright and over == 0
    charge = tree["exposure"].expected_charge.values[1].astype(float)
    rounding = 1 / (12 * float(tree["dynamic_range"].system_gain.values.ravel()[0]) ** 2)
    assert bright == pytest.approx((charge / np.sqrt(charge + 25 + rounding)).mean(), rel=1e-5)  # float32


def test_common_noise_that_cannot_be_inverted_is_refused_before_anything_runs():
    document = pipeline("exposure", "shot_noise", camera={"noise": "common"}, shot_noise={"exact_below": "inf"})
    with pytest.raises(RequestError, match="exact_below is inf"):
        etendue.simulate(document)


def test_an_iso_speed_is_a_gain_over_the_speed_at_gain_one():
    by_gain = pipeline("exposure", *READ_OUT, camera={"analogue_gain": 8}, wanted=["adc.raw"])
    by_speed = pipeline("exposure", *READ_OUT, camera={"iso": 800, "base_iso": 100}, wanted=["adc.raw"])
    raw = [etendue.simulate(d)["adc"].raw.values.astype(float).mean() for d in (by_gain, by_speed)]
    # other draws, the same level: shot noise of 480 pixels
    np.testing.assert_allclose(raw[0], raw[1], rtol=0.01)


def test_the_saturation_speed_of_the_camera_is_its_own_base_speed():
    document = pipeline("exposure_numbers", wanted=["saturation_iso"], sweep={"analogue_gain": [1, 4]})
    base, fast = etendue.simulate(document)["exposure_numbers"].saturation_iso.values
    rate, lux = rate_of_white()
    well = 1000 * (5.4 * 0.741) ** 2
    np.testing.assert_allclose(base, 78 * rate / (lux * well), rtol=1e-12)
    np.testing.assert_allclose(fast, 4 * base, rtol=1e-12)
    by_speed = pipeline("exposure_numbers", wanted=["saturation_iso"], camera={"iso": 400, "base_iso": float(base)})
    np.testing.assert_allclose(etendue.simulate(by_speed)["exposure_numbers"].saturation_iso, 400, rtol=1e-12)


@pytest.mark.parametrize(
    ("camera", "words"), [({"iso": 400}, "base_iso"), ({"iso": 400, "base_iso": 100, "analogue_gain": 2}, "both given")]
)
def test_a_speed_that_cannot_be_had_is_refused_before_anything_runs(camera, words):
    with pytest.raises(RequestError, match=words):
        etendue.simulate(pipeline("exposure", *READ_OUT, camera=camera))


def test_dynamic_range_is_that_of_the_gain_and_says_which():
    document = pipeline(
        "dynamic_range", camera={"read_noise": 2, "read_noise_after": 20, "bits": 14}, sweep={"analogue_gain": [1, 16]}
    )
    data = etendue.simulate(document)["dynamic_range"].to_dataset()
    well, step = 1000 * (5.4 * 0.741) ** 2, (2**14 - 1 - 64) / (1000 * (5.4 * 0.741) ** 2)
    np.testing.assert_allclose(data.system_gain, [step, 16 * step], rtol=1e-14)
    expected = [20 * math.log10(well / math.hypot(2, 20)), 20 * math.log10(well / 16 / math.hypot(2, 1.25))]
    np.testing.assert_allclose(data.dr_elgamal, expected, rtol=1e-13)
    np.testing.assert_allclose(data.dr_elgamal_stops, np.array(expected) / (20 * math.log10(2)), rtol=1e-13)
    assert np.all(data.dr_emva < data.dr_elgamal)


def test_a_grey_card_has_the_ratio_of_hand_arithmetic_and_ten_at_the_stated_illuminance():
    camera = {"read_noise": 5, "conversion_gain": 0.5, "integration_time": 0.02}
    numbers = etendue.simulate(pipeline("exposure_numbers", camera=camera))["exposure_numbers"].to_dataset()
    rate, _ = rate_of_white()
    signal, floor = 0.18 * rate * 0.02, 25 + 1 / (12 * 0.25)
    np.testing.assert_allclose(numbers.snr_18, 20 * math.log10(signal / math.sqrt(signal + floor)), rtol=1e-12)
    np.testing.assert_allclose(numbers.exposure_value, math.log2(16 / 0.02), rtol=1e-13)
    # the same card under that light: 10
    in_the_bin = LUMINOUS_EFFICACY * spectra.luminous_efficiency((545.0, 555.0))[0] / spectra.luminance_of("550 nm")
    dimmed = float(numbers.snr10_illuminance) / (math.pi * in_the_bin)
    there = etendue.simulate(pipeline("exposure_numbers", camera=camera, scene={"white_luminance": dimmed}))[
        "exposure_numbers"
    ]
    np.testing.assert_allclose(there.snr_18, 20.0, rtol=1e-12)
    np.testing.assert_allclose(there.snr10_illuminance, numbers.snr10_illuminance, rtol=1e-12)


# -- pedestal


@pytest.mark.parametrize(("black", "warned"), [(8, True), (11, False)])
def test_a_pedestal_under_four_sigma_is_warned_of(black, warned):
    document = pipeline(
        "exposure", *READ_OUT, camera={"black_level": black, "conversion_gain": 0.25, "read_noise": 10.5}
    )
    assert any("4 sigma" in text for text in make_plan(load(document), installed_stages()).warnings) == warned


def test_the_note_on_a_pedestal_says_the_share_of_dark_pixels_that_the_converter_clips():
    """Against the converter, whose codes lie below 0 without the pedestal's help: 1e5 draws are right to 0.005."""
    adc = Adc(black_level=1.0, conversion_gain=0.25, read_noise=10.5, bits=12)
    (text,) = adc.warn(Facts(), {})
    dark = np.random.default_rng(1).normal(0, adc.read_sigma() * adc.dn_per_electron(), 100_000)
    raised = converter.digitise(dark, 1.0, 1.0 + 64, 12) < 64  # lifted by 64 whole codes, nothing is clipped
    assert float(text.split("DN): ")[1].split()[0]) == pytest.approx(raised.mean(), abs=0.01)


# -- what bounds hold


@pytest.mark.parametrize("sigmas", [1.0, 2.0, 3.0, 4.0])
def test_a_full_well_takes_no_more_from_the_mean_than_it_states(sigmas):
    """By hand: a normal charge whose mean lies some of its sigmas below the well."""
    stage = FullWell()
    well = stage.well()
    root = 0.5 * (math.sqrt(sigmas**2 + 4 * well) - sigmas)  # of the mean: mean + sigmas sqrt(mean) = well
    density = math.exp(-0.5 * sigmas**2) / math.sqrt(2 * math.pi)
    lost = root * (density - sigmas * 0.5 * math.erfc(sigmas / math.sqrt(2)))
    bound, _ = stage.negligible(Facts(low=0.0, high=root**2), Grid.of({"y": Line(4), "x": Line(4)}))
    assert lost / well <= bound < 60 * lost / well


def test_what_is_stated_of_a_time_that_a_run_finds_holds_for_every_time_it_may_find():
    values = {"dark_current_density": 1e-8, "dark_pattern": False, "dark_nonuniformity": 0.1, "prnu": 0.01}
    late = Exposure(**values, integration_time=LateValue("integration_time", 1e-3, 0.1))
    light = {"photocurrent": Facts(low=1e3, high=1e5)}
    facts, (most, _) = late.carry(light, {}), late.error({}, {}, "float64")
    for time in (1e-3, 1e-2, 0.1):
        one = Exposure(**values, integration_time=time)
        own = one.carry(light, {})
        assert facts.low <= own.low and own.high <= facts.high
        assert one.error({}, {}, "float64")[0] <= most


def test_only_an_exact_draw_is_proved():
    """How far the expansion is from Poisson was measured."""
    assert ShotNoise(exact_below=math.inf).error({}, {}, "float64") == (0.0, "proved")
    for noise in ("independent", "common"):
        bound, how = ShotNoise(exact_below=100.0, noise=noise).error({}, {}, "float64")
        assert bound > 0 and how == "measured"


def test_offsets_of_pixels_lower_the_level_of_clipping_as_read_noise_does():
    """A full pixel reads lower by either: after the well nothing tells them apart."""
    values = {"conversion_gain": 0.1, "bits": 12, "read_noise_after": 0.0}

    def lowest(**noise):
        return float(Linearise(**values, **noise).run(np.zeros((1, 1), np.uint16))["clipping_level"])

    assert lowest(read_noise=0.0, dsnu=20.0) == lowest(read_noise=20.0, dsnu=0.0) < lowest(read_noise=0.0, dsnu=0.0)


def test_a_camera_without_noise_knows_the_noise_of_rounding():
    """A twelfth of a squared code, whatever the gain."""
    for gain in (0.02, 0.3, 5.0):
        stage = Linearise(conversion_gain=gain, read_noise=0.0, read_noise_after=0.0, dsnu=0.0)
        assert stage.dark_sigma() * stage.white() == pytest.approx(1 / math.sqrt(12), rel=1e-12)


# -- metering: an argument is a variable


def test_a_metered_exposure_reaches_its_target_whatever_the_f_number_and_white_follows():
    document = pipeline(
        "meter",
        "exposure",
        "white",
        meter={"target": 0.4},
        exposure=even(),
        sweep={"f_number": [2.8, 8], "meter.ev_bias": [0, -1]},
        wanted=["expected_charge", "integration_time", "white"],
        camera={"black_level": 0},
    )
    tree = etendue.simulate(document)
    well = 1000 * (5.4 * 0.741) ** 2
    charge = tree["exposure"].expected_charge
    assert charge.dims[:2] == ("f_number", "meter_ev_bias")
    np.testing.assert_allclose(charge.values[..., 0, 0], [[0.4 * well, 0.2 * well]] * 2, rtol=1e-13)
    time = tree["meter"].integration_time.values
    np.testing.assert_allclose(time[1] / time[0], (8 / 2.8) ** 2, rtol=1e-13)
    np.testing.assert_allclose(tree["white"].white.values[..., 1], [[0.4, 0.2]] * 2, rtol=1e-12)


def test_metering_by_exposure_value_keeps_the_exposure_of_a_swept_f_number():
    document = pipeline(
        "meter",
        "exposure",
        meter={"metering": "exposure_value", "exposure_value": 10},
        exposure=even(),
        sweep={"f_number": [2, 4, 16]},
        wanted=["expected_charge", "integration_time"],
    )
    tree = etendue.simulate(document)
    np.testing.assert_allclose(tree["meter"].integration_time, np.array([4, 16, 256]) / 1024, rtol=1e-15)
    charge = tree["exposure"].expected_charge.values[:, 0, 0]
    np.testing.assert_allclose(charge, charge[0], rtol=1e-12)


CAMERA = (
    "exposure",
    *READ_OUT,
    "linearise",
    "white",
    "balance_mosaic",
    "demosaic_bilinear",
    "dynamic_range",
    "exposure_numbers",
)


def arrays_of(tree):
    """Every array by stage and variable, those of the metering itself aside, and what became of cells: what is found is
    not known before, so that less may be left out."""
    found = {}
    for node in tree.subtree:
        if node.path.strip("/").split("/")[0] not in ("", "ledger", "summary", "frames", "meter"):
            found |= {
                f"{node.path}/{name}": array.values
                for name, array in node.to_dataset(inherit=False).data_vars.items()
                if name != "status"
            }
    return found


@pytest.mark.parametrize("noise", ["independent", "common"])
def test_metered_is_fixed_at_the_found_time_bit_for_bit_noise_included(noise):
    wanted = ["expected_charge", "shot_noise.charge", "raw", "rgb_camera", "white", "dr_emva", "snr_18"]
    camera = {"noise": noise, "read_noise": 3}
    metered = etendue.simulate(
        pipeline("meter", *CAMERA, meter={"ev_bias": -0.3}, camera=camera, wanted=[*wanted, "integration_time"])
    )
    time = float(metered["meter"].integration_time)
    assert time != 0.01
    fixed = etendue.simulate(pipeline(*CAMERA, camera=camera | {"integration_time": time}, wanted=wanted))
    found, expected = arrays_of(metered), arrays_of(fixed)
    assert found.keys() == expected.keys()
    for path, array in expected.items():
        assert found[path].tobytes() == array.tobytes(), path


def test_a_given_swept_or_found_time_is_one_word_of_the_random_numbers():
    one = pipeline(*CAMERA[:3], camera={"integration_time": 0.02}, wanted=["charge"])
    swept = pipeline(*CAMERA[:3], sweep={"integration_time": [0.01, 0.02]}, wanted=["charge"])
    alone, among = etendue.simulate(one), etendue.simulate(swept)
    for stage in ("shot_noise", "full_well"):
        if stage in alone:
            assert np.array_equal(alone[stage].charge, among[stage].charge[1])


def test_draws_behind_a_metering_that_is_not_stored_compute_it_again():
    """The charge that it read is stored, the time that is one of its words is not."""
    document = pipeline("meter", *CAMERA[:2], wanted=["charge"]) | {"keep": ["expected_charge"]}
    plan = make_plan(load(document), installed_stages())
    (exposed,), (drawn,), (found,) = (plan.of(name) for name in ("exposure", "shot_noise", "meter"))
    assert found.ref in select(plan, {exposed.ref}, {drawn.ref})


def test_what_nobody_takes_from_the_camera_any_more_is_no_axis():
    with pytest.raises(
        RequestError,
        match="'meter' writes integration_time for every stage that takes it; remove the axis or 'meter'",
    ):
        etendue.simulate(pipeline("meter", "exposure", sweep={"integration_time": [0.01, 0.02]}))
    plan = make_plan(load(pipeline("meter", "exposure", camera={"integration_time": 0.5})), installed_stages())
    assert "camera.integration_time is not used: 'meter' finds it" in plan.warnings


def test_a_stage_in_front_of_the_metering_takes_the_time_of_the_camera():
    document = pipeline(
        "dynamic_range", "meter", "exposure", camera={"integration_time": 5.0, "dark_current_density": 1e-10}
    )
    dark = etendue.simulate(document)["dynamic_range"].dark_charge
    np.testing.assert_allclose(dark, 1e-10 / 1.602176634e-19 * 5.4e-4**2 * 5.0, rtol=1e-12)


def test_a_found_time_beyond_the_range_of_the_quantity_fails_its_cell(monkeypatch):
    document = pipeline("meter", "exposure", meter={"shortest": 1e-29, "longest": 1e-28}, wanted=["expected_charge"])
    with pytest.raises(
        etendue.errors.EtendueError, match="integration_time = 1e-28, found by 'meter', is out of range"
    ):
        etendue.simulate(document)


# -- frames


@pytest.fixture(scope="module")
def series():
    document = pipeline(
        "bracket",
        "exposure",
        *READ_OUT,
        "linearise",
        "exposure_report",
        bracket={"repeats": 2, "brackets": [0, -3]},
        exposure={"prnu": 0.05, "dark_nonuniformity": 0},
        camera={"dsnu": 50, "read_noise": 4, "dark_current_density": 1e-9},
        sweep={"f_number": [4, 8]},
    )
    return document | {
        "wanted": [
            "expected_charge",
            "integration_time",
            "shot_noise.charge",
            "raw",
            "mosaic_linear",
            "clipped_fraction",
        ]
    }


def test_frames_and_brackets_are_a_dimension_of_every_variable_behind_them(series):
    tree = etendue.simulate(series)
    for stage, variable in (
        ("exposure", "expected_charge"),
        ("shot_noise", "charge"),
        ("adc", "raw"),
        ("linearise", "mosaic_linear"),
    ):
        assert tree[stage][variable].dims == ("f_number", "frame", "y", "x")
        assert tree[stage][variable].shape == (2, 4, 20, 24)
    np.testing.assert_allclose(tree["bracket"].integration_time, np.array([1, 1, 1 / 8, 1 / 8]) * 0.01, rtol=1e-15)
    assert tree["exposure_report"].clipped_fraction.dims == ("f_number", "frame")


def test_an_archive_with_frames_is_opened_by_xarray_and_holds_the_same_bits(series, tmp_path):
    tree = etendue.simulate(series)
    etendue.simulate(series, archive=tmp_path / "frames")
    stored = xr.open_datatree(tmp_path / "frames" / "data.zarr", engine="zarr")
    assert stored["adc"].raw.dims == ("f_number", "frame", "y", "x")
    assert np.array_equal(stored["adc"].raw, tree["adc"].raw)
    assert list(stored["adc"].frame.values) == [0, 1, 2, 3]


def test_patterns_are_the_same_in_all_frames_and_shot_noise_is_new_in_each(series):
    tree = etendue.simulate(series)
    expected, charge = tree["exposure"].expected_charge.values, tree["shot_noise"].charge.values
    dark = 1e-9 / 1.602176634e-19 * 5.4e-4**2
    for cell in expected:
        assert np.array_equal(cell[0], cell[1])
        # the bracket at an eighth of the time has an eighth of the charge, pattern included
        np.testing.assert_allclose(cell[2] * 8, cell[0], rtol=1e-14)
    response = [c[0] - dark * 0.01 for c in expected]  # of two cells, f/4 and f/8: one sensor
    np.testing.assert_allclose(response[1] * 4, response[0], rtol=1e-12)
    noise = (charge - expected)[0]
    correlation = np.corrcoef(noise.reshape(4, -1))
    assert np.all(np.abs(correlation[~np.eye(4, dtype=bool)]) < 5 / math.sqrt(noise[0].size))
    offsets = tree["adc"].raw.values[0].astype(float) * (1000 * (5.4 * 0.741) ** 2 / (4095 - 64)) - charge[0]
    # DSNU 50 electron, read noise 4, rounding 1.2: its own pattern correlates by 0.993
    assert np.corrcoef(offsets.reshape(4, -1)).min() > 0.98


def test_the_first_frame_of_a_series_is_no_other_light_than_a_single_exposure():
    one = etendue.simulate(pipeline("exposure", exposure=even(), wanted=["expected_charge"]))[
        "exposure"
    ].expected_charge.values
    many = etendue.simulate(pipeline("bracket", "exposure", exposure=even(), wanted=["expected_charge"]))
    assert np.array_equal(many["exposure"].expected_charge.values, np.stack([one, one]))


def test_an_axis_of_a_time_that_is_spread_over_frames_has_a_name_of_its_own():
    document = pipeline(
        "bracket", "exposure", bracket={"repeats": 1, "brackets": [0, 1]}, sweep={"integration_time": [0.01, 0.02]}
    )
    tree = etendue.simulate(document)
    assert tree["exposure"].expected_charge.dims == ("camera_integration_time", "frame", "y", "x")
    np.testing.assert_array_equal(tree["bracket"].integration_time, [[0.01, 0.02], [0.02, 0.04]])


def test_the_shipped_measurement_returns_the_camera_of_its_file():
    tree = etendue.simulate(PIPELINES / "emva.toml", want=["raw"])
    raw = tree["adc"].raw
    found = emva.measure(raw.camera_integration_time, raw.sel(scene_reflectance=1), raw.sel(scene_reflectance=0))
    well = 1000 * (5.4 * 0.741) ** 2
    dark = 1e-9 / 1.602176634e-19 * 5.4e-4**2
    patterns = math.hypot(3, 0.1 * dark * float(raw.camera_integration_time[found.pattern_level]))
    for estimate, truth in (
        (found.gain, (4095 - 128) / well),
        (found.read_noise, 8),
        (found.dark_current, dark),
        (found.full_well, well),
        (found.prnu, 0.01),
        (found.dsnu, patterns),
    ):
        # 4 standard errors: the coverage itself is measured over 200 sensors in benchmarks/emva.py
        assert abs(estimate.value - truth) < estimate.high - estimate.low, str(estimate)
        assert estimate.high - estimate.low < 0.2 * truth


# -- lines and defects


def test_row_and_column_patterns_stay_and_row_noise_does_not():
    document = pipeline(
        "bracket",
        "exposure",
        "shot_noise",
        "line_pattern",
        scene={"reflectance": 0},
        exposure=even(),
        line_pattern={"row_pattern": 5, "column_pattern": 3, "row_noise": 2},
        wanted=["charge"],
    )
    charge = etendue.simulate(document)["line_pattern"].charge.values  # dark, no shot noise: the pattern itself
    rows, columns = charge.mean(axis=2), charge.mean(axis=1)
    np.testing.assert_allclose(
        charge, rows[:, :, None] + columns[:, None, :] - charge.mean(axis=(1, 2), keepdims=True), atol=1e-12
    )
    moved = rows[1] - rows[0]
    np.testing.assert_allclose(columns[1] - columns[0], moved.mean(), atol=1e-12)  # columns do not move
    assert 0.5 < moved.std() / (2 * math.sqrt(2)) < 1.6  # 20 rows: 3 standard errors
    assert 2 < rows.std() < 9


def test_a_window_of_a_sensor_with_lines_and_defects_equals_the_crop():
    def run(**window):
        document = pipeline(
            "defects",
            "exposure",
            "line_pattern",
            scene={"width": 700, "height": 700, "reflectance": 0.5},
            exposure=even(),
            defects={"hot": 0.05, "dead": 0.05},
            line_pattern={"row_pattern": 5, "column_pattern": 3},
            wanted=["charge", "defect_map"],
        )
        document["stages"][2] |= {"rows": 90, "columns": 100, **window}
        document["stages"][-1:-1] = [{"use": "shot_noise"}]
        document["camera"]["noise"] = "common"
        document["stages"][-1]["row_noise"] = 0
        return etendue.simulate(document | {"wanted": ["defect_map", "expected_charge"]})

    whole, part = run(), run(first_row=30, first_column=50, window_rows=40, window_columns=33)
    kinds = whole["defects"].defect_map.values[30:70, 50:83]
    assert np.array_equal(part["defects"].defect_map, kinds)
    assert {0, 1, 2} == set(np.unique(kinds))
    np.testing.assert_allclose(
        part["exposure"].expected_charge, whole["exposure"].expected_charge[30:70, 50:83], rtol=1e-12
    )


def test_hot_pixels_grow_with_time_and_dead_ones_stay_dark(tmp_path):
    file = tmp_path / "list.csv"
    file.write_text("row,column,kind\n4,5,hot\n7,8,dead\n9,9,stuck\n")
    document = pipeline(
        "defects",
        "exposure",
        *READ_OUT,
        "stuck_pixels",
        exposure=even(),
        sweep={"integration_time": [0.01, 0.04]},
        defects={"hot": 0, "dead": 0, "file": str(file), "hot_rate": 1e5},
        stuck_pixels={"stuck": 0, "level": 0.5, "file": str(file)},
        wanted=["expected_charge", "raw", "defect_map", "stuck_map"],
    )
    tree = etendue.simulate(document)
    charge = tree["exposure"].expected_charge.values
    assert np.all(charge[:, 7, 8] == 0)
    assert np.all(charge[:, 4, 5] > charge[:, 0, 0])
    np.testing.assert_allclose(charge[1], 4 * charge[0], rtol=1e-14)
    assert np.all(tree["stuck_pixels"].raw.values[:, 9, 9] == 2048)
    assert np.count_nonzero(tree["defects"].defect_map) == 2
    assert np.array_equal(np.argwhere(tree["stuck_pixels"].stuck_map.values[1]), [[9, 9]])


def test_the_share_of_defects_is_as_asked_and_belongs_to_the_serial():
    document = pipeline(
        "defects", scene={"width": 1100, "height": 1100}, defects={"hot": 0.04, "dead": 0.02}, wanted=["defect_map"]
    )
    document["stages"][2] |= {"rows": 200, "columns": 200}
    kinds = etendue.simulate(document)["defects"].defect_map.values
    counts = np.bincount(kinds.ravel(), minlength=3)
    # 5 standard errors of a count
    assert abs(counts[1] - 1600) < 5 * 40
    assert abs(counts[2] - 800) < 5 * 28
    other = copy.deepcopy(document)
    other["camera"]["sensor_serial"] = "2"
    moved = etendue.simulate(other)["defects"].defect_map.values
    assert np.count_nonzero((moved > 0) & (kinds > 0)) < 0.1 * counts[1]


def test_what_is_stuck_at_the_top_has_the_top_code_of_any_converter():
    rng = type("Pattern", (), {"uniform": lambda self, name: np.zeros((2, 2))})()
    for bits in (8, 12, 16):
        stage = StuckPixels(bits=bits, stuck=0.5, level=1.0)
        codes = stage.run(np.zeros((2, 2), np.uint16), np.zeros((2, 2), np.uint8), rng)["raw"]
        assert np.array_equal(codes, np.full((2, 2), 2**bits - 1))


def test_the_linear_scale_ends_where_the_well_is_full_when_that_comes_before_the_top_code():
    """12 bits, 0.1 DN an electron: a well of 16011 electrons ends 1601 codes above black, and is 1 on the linear
    scale.
    """
    document = pipeline(
        "exposure",
        "full_well",
        "adc",
        "linearise",
        "white",
        camera={"conversion_gain": 0.1, "integration_time": 100},
        exposure=even(),
        wanted=["mosaic_linear", "white"],
    )
    document["stages"].insert(5, {"use": "shot_noise"})
    tree = etendue.simulate(document)
    well = 1000 * (5.4 * 0.741) ** 2
    # one code is 1 / 1601 of the scale
    np.testing.assert_allclose(tree["linearise"].mosaic_linear.values, 1, atol=0.5 / (0.1 * well))
    rate, _ = rate_of_white()
    np.testing.assert_allclose(tree["white"].white.values, 100 * rate / well, rtol=1e-12)

"""A sensor measured after EMVA 1288 finds what its stages were given: from a pipeline, from an archive, and within
one cell.
"""

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import special

import etendue
from etendue.cli import main
from etendue.compute.random import philox
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.session import load
from etendue_camera.electronics import emva as kernel
from etendue_camera.sensor import cfa
from etendue_lab.emva.report import SHEET, Expected
from etendue_lab.emva.study import of_archive, of_pipeline
from etendue_lab.emva.terminal import print_emva

CAMERA = {
    "pixel_pitch": 5.4,
    "peak_qe": [0.5],
    "sensitivity": "flat",
    "full_well_density": 500,
    "bits": 12,
    "black_level": 128,
    "read_noise": 6,
    "dsnu": 4,
    "dark_current_density": 1e-9,
    "integration_time": 0.05,
    "pattern": "mono",
}
CHAIN = ("mosaic", "exposure", "shot_noise", "full_well", "read_noise", "adc")
SIGMAS = 4.5  # standard errors: of all figures here, one in ten thousand lies beyond


def document(camera=None, exposure=None, scene="slanted_edge", middle=(), chain=CHAIN, **more):
    stages = [
        {
            "use": scene,
            "name": "scene",
            "white_luminance": 100,
            "width": 600,
            "height": 600,
            "wavelength_from": 545,
            "wavelength_to": 555,
            "bin_width": 10,
        },
        {"use": "irradiance"},
        *middle,
        {"use": "pixel"},
        *(
            {"use": use, **(exposure or {})} if use == "exposure" else {"use": use} if isinstance(use, str) else use
            for use in chain
        ),
    ]
    return {"name": "sensor", "seed": 9, "camera": {**CAMERA, **(camera or {})}, "stages": stages, **more}


def measured(pixels=96, **given):
    return of_pipeline(load(document(**given)), installed_stages(), pixels)


def beyond(channel):
    """The figures that lie further from what is expected than so many standard errors, whose interval is 2.0 of them
    (63 groups).
    """
    rows = [row for row in channel.rows() if row["held"] is not None]
    assert {row["figure"] for row in rows} >= {"gain", "full_well", "prnu", "dark_current"}
    far = {}
    for row in rows:
        middle, wide = 0.5 * (row["low"] + row["high"]), 0.25 * (row["high"] - row["low"])
        at_zero = row["low"] == 0 and row["expected"] < row["high"]  # the root of a variance that came out near 0
        if abs(row["expected"] - middle) > SIGMAS * wide and not at_zero:
            far[row["figure"]] = row
    return far


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"camera": {"conversion_gain": 0.25, "analogue_gain": 8, "read_noise_after": 5}},
        {"camera": {"pattern": "RGGB", "peak_qe": [0.3, 0.5, 0.2], "pixel_pitch": 2.0, "full_well_density": 2000}},
        {
            "exposure": {"prnu": 0.03, "dark_nonuniformity": 0.3},
            "camera": {"dark_current_density": 3e-8, "read_noise": 2},
        },
        {
            "camera": {"temperature": 310, "dark_doubling": 8, "bits": 14},
            "middle": ({"use": "falloff"}, {"use": "diffraction"}),
        },
    ],
    ids=["a well", "a converter at gain 8", "a colour sensor", "uneven and leaking", "a warm sensor behind a lens"],
)
def test_a_pipeline_s_sensor_has_the_figures_it_was_given(given):
    report = measured(**given)
    assert len(report.channels) == (3 if "pattern" in given.get("camera", {}) else 1)
    for channel in report.channels:
        assert channel.why == ""
        assert beyond(channel) == {}


@pytest.mark.long
def test_intervals_hold_what_they_should_as_often_as_they_say():
    """Twelve sensors of one kind, 8 figures each: of 96 intervals of 95 % a share of 88 to 100 % (three standard
    deviations).
    """
    held = []
    for seed in range(12):
        report = of_pipeline(
            load({**document(camera={"sensor_serial": str(seed)}), "seed": seed}), installed_stages(), 96
        )
        held += [
            row["held"]
            for row in report.channels[0].rows()
            if row["figure"] in (*SHEET, "dsnu", "absolute_sensitivity")
        ]
    assert len(held) == 96 and None not in held
    assert np.mean(held) > 0.88


def test_what_rounding_hides_in_the_dark_is_not_covered(capsys):
    """8 bits over 8000 electron: a read noise of 6 is 0.2 of a number; with 12 bits it is 3."""
    for bits, hidden in ((8, {"read_noise", "dark_current", "dsnu"}), (12, set())):
        report = measured(camera={"bits": bits, "black_level": 2 ** (bits - 4)})
        assert {row["figure"] for row in report.channels[0].rows() if not row["covered"]} == hidden
        print_emva(report.document())
        said = capsys.readouterr().out
        assert ("channel W: rounding hides the noise of the dark" in said) == bool(hidden)
        assert "simulated sensors" in said


def test_a_sensor_that_its_dark_current_fills_is_measured_at_shorter_times():
    """A million times the usual: 9e6 electron/s into 8000."""
    report = measured(camera={"dark_current_density": 1e-3 / 200})
    assert any("shorter than the camera's 0.05 s" in note for note in report.notes)
    assert beyond(report.channels[0]) == {}


def test_what_is_put_in_follows_from_the_stages():
    """Noises add in squares, of wells the smallest counts; DSNU grows with the time by the spread of the dark
    current.
    """
    (channel,) = measured(
        camera={"bits": 10}, chain=(*CHAIN[:5], {"use": "line_pattern", "row_noise": 3, "column_noise": 4}, "adc")
    ).channels
    assert channel.expected["read_noise"] == pytest.approx(np.sqrt(6**2 + 5**2))
    assert channel.expected["full_well"] <= 500 * 5.4**2 * 0.741
    sheet = {"dsnu": 3.0, "dark_spread": 40.0}
    assert Expected.of(sheet, 0.1)["dsnu"] == pytest.approx(5.0)


def test_a_full_pixel_is_expected_to_have_the_ratio_of_its_own_shot_noise():
    expected = Expected.of({"gain": 0.1, "read_noise": 3.0, "full_well": 1e4}, 0.01)
    capacity = expected["saturation_capacity"]
    assert expected["snr_max"] == pytest.approx(20 * math.log10(capacity / math.sqrt(capacity)))
    assert expected["dynamic_range"] == pytest.approx(20 * math.log10(capacity / expected["absolute_sensitivity"]))


def test_the_frames_of_an_archive_are_measured_camera_by_camera(tmp_path):
    """emva.toml's own sweep, over two read noises; with a cell that is not there its level is left out."""
    asked = document(
        scene="uniform",
        chain=("mosaic", {"use": "bracket", "repeats": 2}, *CHAIN[1:]),
        sweep={
            "scene.reflectance": [0, 1],
            "integration_time": [0.01, 0.02, 0.03, 0.04, 0.06, 0.08, 0.3, 0.4],
            "read_noise": [4, 12],
        },
        keep=["adc"],
    )
    asked["stages"][0]["white_luminance"] = 270
    etendue.simulate(asked, archive=tmp_path / "a")
    report = of_archive(tmp_path / "a", installed_stages())
    assert [channel.at for channel in report.channels] == [{"read_noise": 4.0}, {"read_noise": 12.0}]
    for channel, noise in zip(report.channels, (4, 12), strict=True):
        assert channel.expected["read_noise"] == noise
        assert beyond(channel) == {}
    said = CliRunner().invoke(main, ["emva", str(tmp_path / "a"), "--json"])
    assert said.exit_code == 0, said.output
    found = json.loads(said.stdout)["channels"]
    assert len(found) == 2
    assert len(found[0]["photon_transfer"]["signal"]) == 8
    np.testing.assert_allclose(found[0]["figures"][0]["value"], report.channels[0].measurement.gain.value)


def test_an_archive_without_dark_frames_says_what_to_do(tmp_path):
    asked = document(
        scene="uniform", chain=("mosaic", "bracket", *CHAIN[1:]), sweep={"integration_time": [0.01, 0.02]}, keep=["adc"]
    )
    etendue.simulate(asked, archive=tmp_path / "a")
    with pytest.raises(RequestError, match="in the light and in the dark"):
        of_archive(tmp_path / "a", installed_stages())
    asked["sweep"]["scene.reflectance"] = [0, 1]
    etendue.simulate(asked, archive=tmp_path / "b")
    with pytest.raises(RequestError, match="2 exposure times with light and dark, with at least 2 frames"):
        of_archive(tmp_path / "b", installed_stages())
    etendue.simulate({**asked, "keep": ["exposure"]}, archive=tmp_path / "c")
    with pytest.raises(RequestError, match="holds no raw frames"):
        of_archive(tmp_path / "c", installed_stages())


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"chain": ("mosaic", "exposure", "shot_noise")}, "no stage of the pipeline writes raw"),
        ({"camera": {"peak_qe": [0]}}, "no photoelectrons|peak_qe"),
    ],
)
def test_a_sensor_that_cannot_be_measured_is_refused_with_a_reason(given, word):
    with pytest.raises(RequestError, match=word):
        measured(**given)


def test_too_small_a_window_is_refused():
    with pytest.raises(RequestError, match="--pixels 4"):
        measured(pixels=4)


# -- within one cell ----------------------------------------------------------------------------------------------


def series(stops, camera=None, tail=(), rows=64, **more):
    own = document(
        camera,
        scene="uniform",
        chain=("mosaic", {"use": "bracket", "brackets": list(stops)}, *CHAIN[1:], *tail),
        **more,
    )
    own["stages"][0]["white_luminance"] = 400
    own["stages"][2] |= {"rows": rows, "columns": rows}
    return own


STOPS = (-30, -4, -3, -2, -1.5, -1, -0.7, -0.5, -0.3, 2, 2.5)


def test_a_bracketed_series_has_its_photon_transfer_in_the_archive():
    """The figures of the kernel on the same frames; of one wavelength the fit has the camera's gain as its slope."""
    found = etendue.simulate(series(STOPS, tail=("photon_transfer", "dynamic_range")))
    one, gain = found["photon_transfer"].to_dataset().sel(channel="W"), float(found["dynamic_range"].system_gain[0])
    assert found["photon_transfer"].emva_gain.dims == ("channel", "estimate")
    low, high = one.emva_gain.sel(estimate=["low", "high"]).values
    assert low - 0.5 * (high - low) < gain < high + 0.5 * (high - low)
    raw = found["adc"].raw.values.reshape(len(STOPS), 2, 64, 64)
    own = kernel.measure(one.transfer_time.values[1:], raw[1:], np.broadcast_to(raw[0], raw[1:].shape))
    np.testing.assert_allclose(one.emva_gain.sel(estimate="value"), own.gain.value, rtol=1e-6)
    np.testing.assert_allclose(one.emva_full_well.sel(estimate="value"), own.full_well.value, rtol=1e-6)
    np.testing.assert_allclose(one.transfer_fit, own.gain.value * one.transfer_signal, rtol=1e-5, atol=1e-6)
    assert one.transfer_signal[0] == 0 and float(one.transfer_variance[0]) == 0


@pytest.mark.parametrize(
    ("stops", "given"),
    [((-30, -2, -1), {}), (STOPS[1:], {}), (STOPS, {"rows": 4})],
    ids=["too few levels", "no dark", "too few pixels"],
)
def test_frames_that_are_no_photon_transfer_curve_have_no_figures(stops, given):
    found = etendue.simulate(series(stops, tail=("photon_transfer",), **given))["photon_transfer"]
    assert np.isnan(found.emva_gain).all()
    assert not np.isnan(found.transfer_signal).any()


def test_what_never_saturates_has_a_gain_and_no_full_well():
    found = etendue.simulate(series([s - 4 if s > -30 else s for s in STOPS], tail=("photon_transfer",)))[
        "photon_transfer"
    ]
    assert np.isfinite(found.emva_gain).all()
    assert np.isnan(found.emva_full_well).all()


def test_a_level_of_more_frames_than_there_are_is_refused():
    with pytest.raises(RequestError, match="a level has 40"):
        etendue.simulate(series((-30, 0), tail=({"use": "photon_transfer", "repeats": 40},)))


# -- kernels ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pattern", ["mono", "RGGB", "x-trans"])
def test_every_pixel_of_whole_periods_belongs_to_one_channel(pattern):
    mask = cfa.read(pattern)
    frames = np.arange(2 * 25 * 26, dtype=float).reshape(2, 25, 26)
    index = cfa.channel_index(mask, 25, 26, 3, -1)
    rows, columns = (n // p * p for n, p in zip((25, 26), mask.period, strict=True))
    for number, channel in enumerate(mask.channels):
        own = cfa.frames_of_channel(frames, mask, channel, 3, -1)
        wanted = frames[:, :rows, :columns][:, index[:rows, :columns] == number]
        assert np.array_equal(np.sort(own.reshape(2, -1)), np.sort(wanted))


@pytest.mark.parametrize(("well", "prnu"), [(1000.0, 0.0), (16000.0, 0.03)])
def test_the_peak_of_the_variance_is_where_clipped_counts_have_it(well, prnu):
    """Against 1e5 Poisson counts clipped at the well, a percent apart: the variance there is the largest to within
    three times the noise of such a variance (0.45 %)."""
    rng = philox(b"well")
    factor = 1 + prnu * special.ndtri((np.arange(100) + 0.5) / 100)[:, None]

    def found(light):
        counts = np.minimum(rng.poisson(np.broadcast_to(light * factor, (100, 1000))), well)
        return counts.var(axis=1).mean(), counts.mean()

    peak = kernel.saturation_of_well(well, prnu)
    trials = [found(light) for light in well * np.linspace(0.8, 1.04, 25)]
    variance, charge = np.array(trials).T
    at = np.interp(peak, charge, variance)
    assert at > (1 - 3 * 0.0045) * variance.max()
    assert 0.7 * well < peak < well


def test_the_peak_lies_the_nearer_to_the_well_the_less_the_noise():
    shares = [kernel.saturation_of_well(well) / well for well in (300.0, 3e3, 3e4, 3e5)]
    assert np.all(np.diff(shares) > 0) and shares[-1] > 0.99
    with pytest.raises(ValueError, match="full_well"):
        kernel.saturation_of_well(0.0)

"""Sensors that are no textbook's: what calibrate makes of hidden noise, odd lamps, shifted codes and growing darks."""

import numpy as np
import pytest

from etendue.errors import RequestError
from etendue_lab.calibrate import checking, pattern_fit
from etendue_lab.calibrate.calibration import calibrate
from etendue_lab.frames.patterns import Pattern, dark_patterns
from etendue_lab.frames.reading import open_frames
from tests.studies.desk import SIGMAS, TOP, TRUE, beyond, measurement, sensor


def opened(folder, arrays):
    np.savez(folder / "frames.npz", **arrays)
    return open_frames(folder / "frames.npz")


@pytest.mark.parametrize("seed", range(3))
def test_the_spread_of_the_dark_current_is_told_from_dsnu(tmp_path, seed):
    true = {"dark_nonuniformity": 0.2, "dsnu": 3.0, "dark_current": 4000.0, "read_noise": TRUE["read_noise"]}
    own = {"dark_nonuniformity": 0.2, "dark_current": 4000.0}
    model = calibrate(opened(tmp_path, measurement(seed=seed, size=96, stack=16, **own)))
    assert beyond(model, true) == {}


def test_no_spread_of_the_dark_current_is_found_where_there_is_none(tmp_path):
    assert "dark_nonuniformity" not in calibrate(opened(tmp_path, measurement(seed=3, size=96))).values


def test_a_dark_pattern_at_a_time_comes_from_frames_at_all_times(tmp_path):
    frames = opened(tmp_path, measurement(seed=3, size=96, stack=16, dark_nonuniformity=0.2, dark_current=5000.0))
    found = dark_patterns(frames, [one for one in frames.levels() if one.dark])
    assert found.grows
    for time in (0.001, 0.02):
        one = found.at(time).variance()
        true = TRUE["gain"] ** 2 * (TRUE["dsnu"] ** 2 + (0.2 * 5000 * time) ** 2)
        assert abs(one.value - true) < SIGMAS * (one.high - one.value)


def test_dark_current_comes_from_light_levels_where_the_dark_has_one_time(tmp_path):
    rng = np.random.default_rng(4)
    take = sensor(4, size=96)
    times, photons = rng.choice([0.002, 0.005, 0.01, 0.02], 24), rng.uniform(500, 28000, 24)
    arrays = {
        "light": np.stack([take(t, p) for t, p in zip(times, photons, strict=True)]),
        "light_time_s": times, "light_photons_per_pixel": photons,
        "dark": take(0.01, 0, 16)[None], "dark_time_s": [0.01],
    }  # fmt: skip
    model = calibrate(opened(tmp_path, arrays))
    names = ("gain", "dark_current", "black_level", "read_noise", "quantum_efficiency")
    assert beyond(model, {name: TRUE[name] for name in names}) == {}


def test_a_lamp_that_is_not_proportional_is_no_bend(tmp_path):
    arrays = measurement(seed=6, size=128, levels=24)
    for name in ("light", "light_stack"):  # labels that are too low, by 6 % of the brightest
        label = arrays[f"{name}_photons_per_pixel"]
        arrays[f"{name}_photons_per_pixel"] = label * (1 - 0.06 * label / arrays["light_photons_per_pixel"].max())
    model = calibrate(opened(tmp_path, arrays))
    assert "bend" not in model.values
    assert model.values["light_excess"].low > 0
    assert beyond(model, {"gain": TRUE["gain"]}) == {}


def test_codes_in_the_upper_bits_are_those_of_the_converter(tmp_path):
    arrays = measurement(seed=1, size=64)
    shifted = {name: value * 16 if value.dtype == np.uint16 else value for name, value in arrays.items()}
    frames = opened(tmp_path, shifted)
    assert frames.step == 16
    assert "multiples of 16" in frames.notes[0]
    (tmp_path / "plain").mkdir()
    one, other = calibrate(frames), calibrate(opened(tmp_path / "plain", arrays))
    assert one.values == other.values
    assert one.bits == other.bits == 12


def eight_bits(seed, black):
    """A sensor of 8 bits whose noise in the dark is an eighth of a step."""
    rng = np.random.default_rng(seed)
    response = 1 + 0.01 * rng.standard_normal((128, 128))

    def take(charge, count):
        signal = rng.poisson(charge * response, (count, 128, 128)) + 8 * rng.standard_normal((count, 128, 128))
        return np.clip(np.rint(signal * 0.015 + black), 0, 255).astype(np.uint16)

    charges = np.linspace(0, 20000, 31)[1:]
    return {
        "light": np.stack([take(one, 2) for one in charges]),
        "light_time_s": charges * 1e-6, "light_photons_per_pixel": charges / 0.5,
        "dark": np.stack([take(0, 2) for _ in charges]), "dark_time_s": charges * 1e-6,
    }  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
def test_a_dark_that_rounding_hides_does_not_shift_the_gain(tmp_path, seed):
    frames = opened(tmp_path, eight_bits(seed, 2.0))
    model = calibrate(frames)
    assert beyond(model, {"gain": 0.015, "quantum_efficiency": 0.5, "prnu": 0.01, "black_level": 2.0}) == {}
    assert "rounding" in model.needs["dsnu"]
    assert "rounding" in model.needs["dark_current"]
    assert checking.check(frames, model)["within"] == {"variance_rms": True, "variance_worst": True, "mean_worst": True}


def test_a_dark_cut_off_at_zero_does_not_shift_the_gain(tmp_path):
    arrays = measurement(seed=2, size=96)
    cut = {
        name: np.maximum(value.astype(int) - 100, 0).astype(np.uint16) if value.dtype == np.uint16 else value
        for name, value in arrays.items()
    }
    model = calibrate(opened(tmp_path, cut))
    assert beyond(model, {"gain": TRUE["gain"], "quantum_efficiency": 0.5, "black_level": 0.0}) == {}
    assert "cut off" in model.needs["dsnu"]


def test_a_model_that_does_not_hold_has_wide_intervals(tmp_path):
    arrays = measurement(seed=5, size=96, levels=24)
    # a second read-out above half of full scale, with a noise of 60 electrons of its own
    rng = np.random.default_rng(0)
    for name in ("light", "light_stack"):
        codes = arrays[name].astype(float)
        noisy = np.rint(codes + 15 * rng.standard_normal(codes.shape) * (codes > 2000))
        arrays[name] = np.clip(noisy, 0, TOP).astype(np.uint16)
    usual = calibrate(opened(tmp_path, measurement(seed=5, size=96, levels=24)))
    model = calibrate(opened(tmp_path, arrays))
    assert any("does not fit" in one for one in model.tests)
    wide, narrow = (one.values["gain"].high - one.values["gain"].value for one in (model, usual))
    assert wide > 3 * narrow


def test_bright_pixels_are_no_pattern_of_rows():
    rng = np.random.default_rng(1)
    groups = rng.standard_normal((128, 128)) + 0.3 * rng.standard_normal((8, 128, 128))
    hot = rng.integers(0, 128 * 128, 60)
    groups.reshape(8, -1)[:, hot] += rng.exponential(100.0, 60)
    found = pattern_fit.fit(Pattern(groups - groups.mean(axis=(1, 2), keepdims=True), 8), shaded=False)
    assert found.outliers > 40
    assert found.rows is None
    assert found.white.low < 1.0 < found.white.high


def test_too_few_levels_above_hidden_noise_are_told(tmp_path):
    arrays = eight_bits(0, 2.0)
    few = {name: value[:3] if name.startswith("light") else value for name, value in arrays.items()}
    with pytest.raises(RequestError, match="rounding hides|more noise than the dark"):
        calibrate(opened(tmp_path, few))

"""What the line of microphones must give: closed forms of beams, phasors and noise."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from etendue_array import kernels
from etendue_array.beam import DelayAndSum
from etendue_array.hearing import Phasors
from etendue_array.sound import PlaneWave
from numpy.testing import assert_allclose, assert_array_equal

import etendue
from etendue import stages as s
from etendue.api import RequestError

SPEED = 343.0
PIPELINES = Path(__file__).parents[1] / "pipelines"


def heard(figures=True, **values):
    """The chain without noise, unless it is told of some."""
    noise = s.microphone_noise(name="noise", noise_rms=values.pop("noise_rms", 0.0))
    sound = s.plane_wave(name="sound", samples=512, sampling_rate="16 kHz", rms=values.pop("rms", 1.0))
    beam = s.delay_and_sum(name="beam", directions=721, taper=values.pop("taper", "uniform"))
    chain = etendue.Pipeline(
        sound, noise, s.phasors(), beam, s.beam_figures(name="figures"), name="heard", seed=values.pop("seed", 1)
    )
    return etendue.simulate(chain, scheduler="serial", precision="float64", **values)


@pytest.mark.parametrize(
    ("count", "tone", "bearing"), [(4, 1000.0, 0.0), (8, 2000.0, 20.0), (16, 3000.0, -50.0), (1, 2000.0, 10.0)]
)
def test_the_beam_of_one_wave_is_the_array_factor(count, tone, bearing):
    """A tone in the middle of a bin: every direction, to rounding."""
    tree = heard(microphones=count, tone=tone, bearing=bearing, spacing=0.05)
    beam = tree["beam"].beam.sel(frequency=tone)
    wanted = kernels.array_factor(count, 0.05, tone, SPEED, beam.direction.to_numpy(), bearing)
    assert_allclose(beam.to_numpy(), wanted, atol=1e-12)


@pytest.mark.parametrize("rms", [0.02, 1.0, 40.0])
def test_the_level_is_that_of_the_sound(rms):
    tree = heard(rms=rms)
    assert float(tree["figures"].sound_level) == pytest.approx(20 * math.log10(rms / 20e-6), abs=1e-6)


def test_noise_that_is_independent_is_lowered_by_the_number_of_microphones():
    """Without sound worth the name: mean power of the beam = noise of a bin over N, 2 s^2 / samples / N; 113 x 721
    values, of which some 700 are independent, so that the mean lies within 15 %."""
    tree = heard(rms=1e-9, noise_rms=1.0, microphones=8, spacing=0.17)
    found = float(tree["beam"].beam.mean())
    assert found == pytest.approx(2 / 512 / 8, rel=0.15)


@pytest.mark.parametrize("count", [1, 2, 8, 100])
def test_white_noise_gain_is_the_number_of_microphones_where_all_count_alike(count):
    assert kernels.white_noise_gain(kernels.taper("uniform", count)) == pytest.approx(count, rel=1e-12)


@pytest.mark.parametrize("count", [3, 8, 100])
def test_a_taper_costs_gain_and_lowers_side_lobes(count):
    """Hann: 2/3 (N + 1) microphones' worth, exactly: the sums of sin^2 and sin^4 are (N + 1) / 2 and 3 (N + 1) / 8."""
    assert kernels.white_noise_gain(kernels.taper("hann", count)) == pytest.approx(2 / 3 * (count + 1), rel=1e-12)


def test_a_tapered_beam_is_wider_and_has_lower_side_lobes():
    plain, tapered = (heard(microphones=16, taper=taper)["figures"] for taper in kernels.TAPERS)
    assert float(tapered.beam_width) > 1.4 * float(plain.beam_width)
    assert float(tapered.side_lobe) < -30 < float(plain.side_lobe) < -13


def test_a_long_line_has_the_width_and_the_side_lobe_of_a_slit():
    """Broadside: 0.8859 wavelengths over the length, rad; highest side lobe -13.26 dB. N = 100 of a slit is within a
    thousandth.
    """
    count, spacing, tone = 100, 0.05, 2000.0
    figures = heard(microphones=count, spacing=spacing, tone=tone, bearing=0.0)["figures"]
    width = math.degrees(0.8859 * SPEED / tone / (count * spacing))
    assert float(figures.beam_width) == pytest.approx(
        width, rel=0.02
    )  # linear between directions a quarter degree apart
    directions = np.linspace(-20, 20, 40001)
    power = kernels.array_factor(count, spacing, tone, SPEED, directions, 0.0)
    assert kernels.half_power_width(directions, power) == pytest.approx(width, rel=1e-3)
    assert kernels.side_lobe(power) == pytest.approx(-13.26, abs=0.02)


def test_microphones_too_far_apart_hear_a_second_direction():
    """A grating lobe at sin t = sin t0 - c / (f d), as strong as the first."""
    tree = heard(microphones=8, spacing=0.2, tone=2000.0, bearing=20.0)
    beam = tree["beam"].beam.sel(frequency=2000.0)
    other = math.degrees(math.asin(math.sin(math.radians(20.0)) - SPEED / (2000.0 * 0.2)))
    assert float(beam.interp(direction=other)) == pytest.approx(1.0, abs=1e-3)
    assert float(tree["figures"].side_lobe) == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("bearing", [-60.0, 0.0, 33.3])
def test_the_direction_is_found(bearing):
    """Within a fiftieth of a degree: a parabola through three samples, a quarter degree apart."""
    assert float(heard(bearing=bearing, microphones=16)["figures"].bearing_error) == pytest.approx(0.0, abs=0.02)


def test_power_in_time_is_power_in_frequency():
    """Parseval: over all bins but the first and the last."""
    signals = np.random.default_rng(1).standard_normal((3, 64))
    signals -= signals.mean(axis=1, keepdims=True)
    signals -= (-1.0) ** np.arange(64) * (signals * (-1.0) ** np.arange(64)).mean(axis=1, keepdims=True)
    found = Phasors(lowest=1.0, highest=8000.0).run(signals, np.arange(64) / 16000)["phasor"]
    assert_allclose((found**2).sum(axis=(0, 1)), (signals**2).mean(axis=1), rtol=1e-12)


def test_turning_the_line_around_mirrors_the_beam():
    one, other = (heard(bearing=bearing)["beam"].beam.to_numpy() for bearing in (25.0, -25.0))
    assert_allclose(one, other[:, ::-1], atol=1e-9)


def test_what_cannot_be_is_refused():
    with pytest.raises(ValueError, match="needs more than 20000 samples per second"):
        PlaneWave(tone=10000.0)
    with pytest.raises(RequestError, match="no frequency bin from 501 to 502 Hz"):
        etendue.simulate(PIPELINES / "beam.toml", phasors__lowest=501.0, phasors__highest=502.0)


def test_a_stage_on_labels_may_be_called_with_arrays():
    """By place or by name, in the order of what it reads, as a stage that is written on arrays may be."""
    phasor, directions = np.random.default_rng(1).standard_normal((2, 1, 4)), np.linspace(-90, 90, 361)
    where = np.array(["real", "imaginary"]), np.array([1000.0]), 0.1 * np.arange(4), directions
    names = ("phasor", *list(DelayAndSum.run.__signature__.parameters)[2:])
    stage = DelayAndSum()
    by_place, by_name = stage.run(phasor, *where), stage.run(**dict(zip(names, (phasor, *where), strict=True)))
    assert_array_equal(by_place["beam"], by_name["beam"])


def test_a_quantity_is_shown_under_the_table_of_its_own_distribution():
    command = [sys.executable, "-m", "etendue", "stages", "delay_and_sum"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "(under [array]; " in said

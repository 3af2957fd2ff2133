"""Bounds hold for sparse light too: behind blurs, between samples, and where a later stage lets an error grow."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from etendue.contract.arrays.facts import Content, Facts
from etendue.contract.arrays.grid import Bands, Grid, Line
from etendue.plan.expansion.growth import factors_of
from etendue.transfer import effects, peaks, sampling
from etendue.transfer import rings as scene_rings
from etendue_camera.electronics.stages.exposure import FullWell
from etendue_camera.electronics.stages.metering import Meter
from etendue_camera.field import warp
from etendue_camera.optics.stages.glare import Glare
from etendue_camera.optics.stages.lens import Diffraction, LensGaussian
from tests.plan.given import CAMERA, SCENE, SENSOR, plan_of

SIZE, STEP = (64, 72), 0.5
EDGES = (500.0, 600.0)
GRID = Grid.of({"wavelength": Bands(EDGES), "y": Line(SIZE[0], 0.0, STEP), "x": Line(SIZE[1], 0.0, STEP)})
BLURS = (LensGaussian(sigma=0.4), LensGaussian(sigma=2.0), Diffraction(f_number=8.0), Glare(fraction=0.02, veil=0.01))
AFTER = (LensGaussian(sigma=0.0), LensGaussian(sigma=1.0), LensGaussian(sigma=4.0))


def sparse(seed, spots, width, background):
    """Spots of some decades of brightness on a background; of no width: single samples."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    plane = np.full(SIZE, background)
    for _ in range(spots):
        cy, cx, level = rng.uniform(8, SIZE[0] - 9), rng.uniform(8, SIZE[1] - 9), 10 ** -rng.uniform(0, 2)
        away = (y - cy) ** 2 + (x - cx) ** 2
        plane += level * (np.exp(-0.5 * away / width**2) if width else away == away.min())
    return plane


def content_of(plane, norm="rms"):
    """The content of one band."""
    edges = scene_rings.ring_edges(*SIZE, STEP, STEP)
    full = float(plane.max())
    power, amplitude = scene_rings.ring_sums(plane / full, STEP, STEP, edges)
    ends = ((float(plane.min()) / full,), (float(plane.mean()) / full,), (1.0,))
    widths = scene_rings.blur_widths(*SIZE, STEP, STEP)
    largest = scene_rings.largest_behind(plane / full, STEP, STEP, widths)
    known = {"widths": tuple(map(float, widths)), "peaks": (tuple(map(float, largest)),)}
    return Content(full, tuple(map(float, edges)), (tuple(power),), (tuple(amplitude),), *ends, norm=norm, **known)


def blurred(plane, *stages):
    """The plane behind transfer functions, on the domain of a segment."""
    half = sampling.transform(plane)
    fy, fx = sampling.frequencies(SIZE[0], STEP, False)[:, None], sampling.frequencies(SIZE[1], STEP, True)[None, :]
    for stage in stages:
        half = half * stage.transfer(fy, fx, np.array([0.55])[:, None, None]).reshape(half.shape)
    return sampling.planes_of(half, *SIZE)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    spots=st.integers(1, 12),
    width=st.sampled_from([0.0, 0.7, 1.5]),
    background=st.floats(1e-6, 0.3),
    blur=st.sampled_from(BLURS),
    norm=st.sampled_from(["rms", "max"]),
)
def test_leaving_a_blur_out_of_sparse_light_changes_it_by_no_more_than_is_stated(
    seed, spots, width, background, blur, norm
):
    """Relative to the largest value of the light as it should be, at the blur itself and behind any later one."""
    plane = sparse(seed, spots, width, background)
    stated = effects.change(blur, content_of(plane, norm), GRID).whole
    for later in AFTER:
        exact, without = blurred(plane, blur, later), blurred(plane, later)
        apart = np.abs(without - exact)
        true = apart.max() if norm == "max" else math.sqrt((apart**2).mean())
        assert true <= stated * exact.max() + 1e-12


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), spots=st.integers(1, 12), background=st.floats(1e-6, 0.3), sigma=st.floats(0.3, 6))
def test_the_largest_value_behind_a_blur_is_no_smaller_than_is_assumed(seed, spots, background, sigma):
    plane = sparse(seed, spots, 0.7, background)
    content, blur = content_of(plane), LensGaussian(sigma=sigma)
    frequency = np.array(content.edges[1:])  # where a falling transfer function leaves the least of a ring
    left = np.abs(effects.in_directions((blur,), EDGES, frequency))[0]
    least = peaks.largest_at_least(content, left, peaks.padding(GRID))[0]
    assert least * content.full <= blurred(plane, blur).max() * (1 + 1e-9)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    spots=st.integers(1, 12),
    width=st.sampled_from([0.0, 0.7, 5.0]),
    background=st.floats(1e-6, 0.3),
    blurs=st.lists(st.sampled_from(BLURS), max_size=3),
)
def test_the_largest_value_behind_blurs_and_a_later_one_is_no_smaller_than_is_known(
    seed, spots, width, background, blurs
):
    """Known from the scene's own largest values behind wider blurs; stage after stage, as a plan passes it on. They may
    lie half a sample from the next one along both axes, where a Gaussian has fallen by (step / 2 sigma)^2.
    """
    plane = sparse(seed, spots, width, background)
    content = content_of(plane)
    for blur in blurs:
        content = effects.behind(blur, EDGES, content)
    for sigma, least in zip(content.widths, content.peaks[0], strict=True):
        between = 1e-9 + (0.5 * STEP / sigma) ** 2 if sigma else 1e-9
        assert least * content.full <= blurred(plane, *blurs, LensGaussian(sigma=sigma)).max() * (1 + between) + 1e-12


def test_the_largest_values_of_a_large_bright_area_are_known_behind_blurs_far_narrower_than_it():
    """A quarter of the frame, 36 samples wide: its middle is as bright behind a blur, which mean and variance
    alone would not tell."""
    plane = np.full(SIZE, 0.01)
    plane[20:50, 20:56] = 1.0
    content = content_of(plane)
    later = np.array([0.0, 1.0, 2.0])
    frequency = scene_rings.frequencies_in(np.array(content.edges))
    factors = effects.in_directions((LensGaussian(sigma=0.4),), EDGES, frequency)[:, 0]
    changed = scene_rings.largest_in_rings(np.abs(1 - factors))
    known = peaks.largest_behind(content, changed, np.zeros_like(changed), later, peaks.padding(GRID))[:, 0]
    assert (known[:2] > 0.9).all()
    assert known[2] > 0.8
    unknown = replace(content, widths=(), peaks=())
    assert peaks.largest_behind(unknown, changed, np.zeros_like(changed), later, peaks.padding(GRID)).max() < 0.3
    factor = content.scaled(0.5, 1.0)
    assert factor.full * factor.peaks[0][1] <= 0.5 * content.full * content.peaks[0][1]


def test_a_band_of_its_own_counts_for_what_is_wanted_and_the_whole_light_at_the_stage():
    """A dim band that is blurred more than a bright one: its share of the light is small, but a sensor may see it
    alone."""
    plane = sparse(3, 6, 1.0, 0.2)
    one = content_of(plane)
    two = replace(
        one,
        **{
            name: (getattr(one, name)[0], tuple(0.01 * v for v in getattr(one, name)[0]))
            for name in ("amplitude", "peaks")
        },
        power=(one.power[0], tuple(1e-4 * v for v in one.power[0])),
        **{name: (getattr(one, name)[0], 0.01 * getattr(one, name)[0]) for name in ("low", "mean", "high")},
    )
    rings = len(one.edges) - 1
    factors = np.stack([np.zeros(rings), np.linspace(0, 0.5, rings)])
    found = peaks.relative(factors, 1 - factors, two, GRID)
    alone = peaks.relative(factors[1:], 1 - factors[1:], one, GRID)
    assert found.apart == pytest.approx(alone.apart)
    assert found.whole <= 0.0101 * alone.apart


@pytest.mark.parametrize("order", [1, 2, 3, 5])
@pytest.mark.parametrize("oversampling", [1, 2, 4])
def test_a_spline_misses_a_wave_by_what_is_stated_and_not_by_much_less(order, oversampling):
    """A wave of the cosine transform, moved by all fractions of a sample; away from the border."""
    count = 400
    x = np.arange(count)
    line, scale = x - 0.5 * (count - 1), 1.002
    source = line * scale + 0.5 * (count - 1)
    inner = (source > 20) & (source < count - 21)
    for wave in (40, 80, 160, 240, 320):
        plane = np.tile(np.cos(np.pi * wave * (x + 0.5) / count), (9, 1))
        found = warp.radial(plane, np.arange(9) - 4.0, line, lambda s: np.full(s.shape, scale), order, oversampling)
        apart = np.abs(found[4] - np.cos(np.pi * wave * (source + 0.5) / count))[inner].max()
        stated = float(warp.wave_error(order, np.array([wave / (2 * count)]), oversampling)[0])
        assert apart <= stated * (1 + 1e-9) + 1e-12
        assert stated <= 2.1 * apart + 1e-12


def test_an_error_grows_where_light_is_clipped_by_the_light_over_the_well():
    text = (
        CAMERA
        + SCENE.format(scene="slanted_edge")
        + SENSOR.replace('[[stages]]\nuse = "adc"', '[[stages]]\nuse = "full_well"\n[[stages]]\nuse = "adc"')
    )
    found = []
    for exposure in ("1 ms", "1 s", "10 s"):
        plan = plan_of(text, {"camera.integration_time": exposure, "tolerance": 1e-3})
        (well,) = [cell for cell in plan.cells.values() if isinstance(cell.stage, FullWell)]
        high = plan.of("shot_noise")[0].facts.high
        factors = dict(factors_of(dict(plan.cells), False))
        assert factors["shot_noise", ()] == pytest.approx(max(1.0, high / well.stage.well()), rel=0.05)
        found.append(factors["pixel", ()])
    assert found[0] == 1.0
    assert found[2] > 5 * found[1] > 5


@pytest.mark.parametrize("times", [["1 ms"], ["1 ms", "10 s"]])
def test_what_is_decided_does_not_depend_on_the_exposure_but_what_is_stated_does(times):
    """An edited exposure computes no light again; of a sweep the exposure that lets errors grow most is stated."""
    sweep = f"\n[sweep]\nintegration_time = {times}\n".replace("'", '"')
    text = CAMERA + SCENE.format(scene="slanted_edge") + SENSOR
    alone = plan_of(text, {"camera.integration_time": "10 s", "tolerance": 1e-2}).of("pixel")[0]
    swept = plan_of(text + sweep, {"tolerance": 1e-2}).of("pixel")[0]
    assert (alone.key, alone.left_out, alone.approximated) == (swept.key, swept.left_out, swept.approximated)
    assert (swept.growth == alone.growth) == (len(times) > 1)


@pytest.mark.parametrize("metering", ["mean", "centre", "highlight"])
def test_a_metered_time_lies_within_what_is_known_of_it(metering):
    rng = np.random.default_rng(1)
    meter = Meter(metering=metering, longest=1e9, shortest=1e-12)
    for power in (0.5, 2, 8):
        light = 10 + 1e4 * rng.random((40, 50)) ** power
        known = Facts(low=float(light.min()), high=float(light.max()), mean=float(light.mean()))
        facts = meter.carry({"photocurrent": known}, {})
        assert facts.low <= meter.run(light)["integration_time"] <= facts.high
        assert meter.growth({"photocurrent": known}) >= 1

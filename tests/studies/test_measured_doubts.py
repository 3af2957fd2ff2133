"""``etendue measure``: what intervals hold in a JPEG, what is doubted, what rounding hides, and the picture of it."""

import math

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from PIL import Image
from scipy.special import ndtr

from etendue.cli import main
from etendue.errors import RequestError
from etendue_camera.colour.encoding import srgb_encode
from etendue_camera.electronics.rounding import both, in_front
from etendue_camera.quality.block_coding import coded
from etendue_lab.measure.study import MeasurementRequest, measure

FIFTY, SIDE = math.sqrt(math.log(2) / 2) / math.pi, 80  # MTF50 of a Gaussian of 1 pixel rms
WHOLE = f"0,0,{SIDE},{SIDE}"


def across(degrees=5.0, shift=(0.0, 0.0)):
    y, x = (np.arange(SIDE) - 0.5 * SIDE - part for part in shift)
    return x * math.cos(math.radians(degrees)) - y[:, None] * math.sin(math.radians(degrees))


def saved(path, linear, **how):
    Image.fromarray(np.rint(255 * srgb_encode(np.clip(linear, 0, 1))).astype(np.uint8)).save(path, **how)
    return path


def seen(path, linear, **how):
    return measure(saved(path, linear, **how), MeasurementRequest(edges=(WHOLE,)))["edges"][0]


@pytest.mark.parametrize(("quality", "sigma"), [(75, 0.5), (95, 0.7)])
def test_intervals_of_a_jpeg_hold_what_its_coding_moves(tmp_path, quality, sigma):
    """Eight edges at other places of the blocks: of 95 % intervals six or more hold it, in all but 1 of 170 such
    draws.
    """
    held = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        picture = rng.uniform(0.9, 1.1) * (0.1 + 0.5 * ndtr(across(rng.uniform(3, 12), rng.uniform(-4, 4, 2)) / sigma))
        one = seen(tmp_path / "a.jpg", picture, quality=quality)
        held += one["mtf50_low"] <= FIFTY / sigma <= one["mtf50_high"]
        assert one["doubts"] == [] and one["compression"]["spread"] > 0
    assert held >= 6


@pytest.mark.parametrize(("quality", "sigma", "noise"), [(100, 1.0, 0.0), (95, 0.7, 0.005)])
def test_intervals_of_a_jpeg_are_no_wider_than_its_errors_ask(tmp_path, quality, sigma, noise):
    """The median error of an interval of 95 % is 0.34 of its half width where it is normal, 0.31 where it is rounding
    alone.

    Of 12 edges a median scatters by a third of itself; intervals that were twice too wide, or too narrow, are seen.
    """
    far = []
    for seed in range(12):
        rng = np.random.default_rng([seed, quality])
        picture = rng.uniform(0.05, 0.15) + rng.uniform(0.5, 0.7) * ndtr(
            across(rng.uniform(3, 15), rng.uniform(-4, 4, 2)) / sigma
        )
        one = seen(tmp_path / "a.jpg", picture + rng.normal(0, noise, picture.shape), quality=quality)
        truth = FIFTY / sigma
        far.append(
            abs(one["mtf50"] - truth)
            / (one["mtf50_high"] - one["mtf50"] if truth > one["mtf50"] else one["mtf50"] - one["mtf50_low"])
        )
    assert 0.17 < np.median(far) < 0.65


def test_rounding_is_counted_once(tmp_path):
    """A JPEG whose table has steps of 1 rounds levels as a PNG does: the interval is hardly wider, and not that of
    both.
    """
    picture = 0.1 + 0.5 * ndtr(across() / 1.0)
    png, jpg = seen(tmp_path / "a.png", picture), seen(tmp_path / "a.jpg", picture, quality=100)
    widths = [one["mtf50_high"] - one["mtf50_low"] for one in (png, jpg)]
    assert widths[0] < widths[1] < 1.4 * widths[0]


def test_what_no_noise_moves_is_said_to_be_conservative(tmp_path):
    """16 bits without noise: the interval holds the method's own error, and says that it is no interval of chance."""
    for sigma in (0.4, 1.5):
        for noise in (0.0, 0.01):
            linear = 0.1 + 0.5 * ndtr(across() / sigma) + np.random.default_rng(3).normal(0, noise, (SIDE, SIDE))
            tifffile.imwrite(tmp_path / "a.tif", np.rint(65535 * srgb_encode(np.clip(linear, 0, 1))).astype(np.uint16))
            one = measure(tmp_path / "a.tif", MeasurementRequest(edges=(WHOLE,)))["edges"][0]
            assert one["conservative"] == (noise == 0)
            if noise == 0:
                assert one["mtf50_low"] <= FIFTY / sigma <= one["mtf50_high"]
                assert one["mtf50_high"] - one["mtf50_low"] == pytest.approx(1e-3 * one["mtf50"], rel=0.3)
                told = CliRunner().invoke(main, ["measure", str(tmp_path / "a.tif"), "--edge", WHOLE])
                assert "conservative" in told.output and "upper bound" in told.output


def test_two_errors_of_rounding_together_stay_below_what_is_said():
    """Drawn: 200,000 sums, of which a share scatters by 5e-4."""
    rng = np.random.default_rng(0)
    for first, second in ((1.0, 1.0), (1.0, 0.3), (0.2, 1.0), (1.0, 0.0)):
        sums = np.abs(first * rng.uniform(-1, 1, 200_000) + second * rng.uniform(-1, 1, 200_000))
        for confidence in (0.5, 0.95):
            assert np.mean(sums < both(first, second, confidence)) == pytest.approx(confidence, abs=5e-3)


def test_a_coarser_table_widens_the_interval_and_is_said(tmp_path):
    picture = 0.1 + 0.5 * ndtr(across() / 0.6)
    fine, coarse, coarsest = (seen(tmp_path / "a.jpg", picture, quality=quality) for quality in (98, 80, 40))
    widths = [one["mtf50_high"] - one["mtf50_low"] for one in (fine, coarse)]
    assert widths[1] > 2 * widths[0]
    assert fine["not_covered"] == [] and "coarse" in coarsest["not_covered"]
    assert seen(tmp_path / "a.png", picture)["compression"] is None


@pytest.mark.parametrize("quality", [60, 90])
def test_blocks_are_coded_as_in_a_file(tmp_path, quality):
    """Libraries round their transforms to whole numbers, so that now and then a coefficient falls to its neighbour."""
    plane = np.rint(np.random.default_rng(0).normal(128, 30, (48, 40)).clip(0, 255))
    Image.fromarray(plane.astype(np.uint8)).save(tmp_path / "a.jpg", quality=quality)
    with Image.open(tmp_path / "a.jpg") as file:
        table, decoded = np.reshape(file.quantization[0], (8, 8)), np.asarray(file, float)
    away = np.abs(coded(plane, table) - decoded)
    assert away.mean() < 0.1 * np.std(
        plane - decoded
    )  # of what coding changes; with the table on its side it is half or more
    shifted = coded(np.pad(plane, ((3, 0), (5, 0)), mode="edge")[3:, 5:], table, (3, 5))
    assert shifted.shape == plane.shape and not np.array_equal(shifted, coded(plane, table))


def others():
    y, x = np.mgrid[:SIDE, :SIDE] - 40.0
    line, slope = across(7), np.clip(across(6) / 70 + 0.5, 0, 1)
    return {
        "stroke": 0.8 - 0.7 * (ndtr(line + 2.5) - ndtr(line - 2.5)),
        "two steps": 0.2 + 0.35 * (ndtr(line / 0.8) + 0.6 * ndtr((line - 6) / 0.8)),
        "up and down": 0.2 + 0.35 * (ndtr(line) - 0.6 * ndtr(line - 14)),
        "ramp": 0.2 + 0.5 * slope,
        "disc": 0.2 + 0.5 * ndtr(100 - np.hypot(x + 100, y + 10)),
        "corner": 0.2 + 0.5 * ndtr(across(8)) * ndtr(across(98)),
    }


@pytest.mark.parametrize("name", list(others()))
def test_what_is_no_single_edge_is_refused_or_doubted(tmp_path, name):
    picture = others()[name] + np.random.default_rng(1).normal(0, 0.004, (SIDE, SIDE))
    try:
        doubts = seen(tmp_path / "a.png", picture)["doubts"]
    except RequestError as error:
        doubts = [str(error)]
    assert doubts


@pytest.mark.parametrize("sigma", [0.5, 2.5])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_an_edge_is_not_doubted(tmp_path, sigma, noise):
    """Also where it is sharpened, and where light falls off along it."""
    rng, line = np.random.default_rng(2), across(9)
    shape = ndtr(line / sigma) + 0.15 * (ndtr(line / sigma) - ndtr(line / (2 * sigma)))
    picture = (0.15 + 0.5 * shape) * np.linspace(0.93, 1.07, SIDE)[:, None] + rng.normal(0, noise, (SIDE, SIDE))
    assert seen(tmp_path / "a.png", picture)["doubts"] == []


# ------------------------------------------------------------------------------------------------------------ noise


@pytest.mark.parametrize("sigma", [0.0005, 0.0015, 0.003, 0.006])
def test_noise_below_a_number_of_the_file_is_held(tmp_path, sigma):
    """Of twelve patches of any level nine at least; below a third of a number the interval says so and begins at 0."""
    held = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        path = saved(tmp_path / "a.png", rng.uniform(0.2, 0.6) + rng.normal(0, sigma, (64, 64)))
        patch = measure(path, MeasurementRequest(noise=("0,0,64,64",)))["noise"][0]
        own = patch["channels"][0]["linear"]["sigma"]
        held += own["low"] <= sigma <= own["high"]
        assert bool(patch["hidden"]) or sigma > 0.001
    assert held >= 9


def test_a_variance_behind_rounding_has_noise_in_front():
    """Drawn, at any place between two numbers; Sheppard's above half a step."""
    rng = np.random.default_rng(0)
    for sigma in (0.05, 0.2, 0.4, 0.8, 2.0):
        for place in (0.0, 0.3, 0.5):
            seen = np.rint(place + rng.normal(0, sigma, 200_000)).var()
            low, high = in_front(0.98 * seen, 1.02 * seen + 1e-4)
            assert low <= sigma <= high
    assert in_front(1.0, 1.0)[0] == pytest.approx(math.sqrt(1 - 1 / 12), rel=1e-3)


def test_noise_that_a_jpeg_took_off_is_not_covered(tmp_path):
    path = saved(tmp_path / "a.jpg", 0.4 + np.random.default_rng(0).normal(0, 0.003, (64, 64)), quality=80)
    assert measure(path, MeasurementRequest(noise=("0,0,64,64",)))["noise"][0]["not_covered"]


# ------------------------------------------------------------------------------------------------------------ what is
# said and drawn


def test_the_picture_shows_region_and_line_where_they_stand(tmp_path):
    """The line that is drawn runs through half level: the picture is even there on either side."""
    path = saved(tmp_path / "a.png", 0.1 + 0.5 * ndtr(across(12, (0.0, 6.0))))
    one = measure(path, MeasurementRequest(edges=(WHOLE,)))["edges"][0]
    for x, y in one["line"]:
        assert abs((x - 46) * math.cos(math.radians(12)) - (y - 40) * math.sin(math.radians(12))) < 0.1
    found = CliRunner().invoke(
        main, ["measure", str(path), "--noise", "2,2,20,20", "--edge", WHOLE, "--picture", str(tmp_path / "b.png")]
    )
    assert found.exit_code == 0, found.output
    with Image.open(tmp_path / "b.png") as drawn:
        drawn.load()
        assert drawn.width == drawn.height > 300
    wrong = CliRunner().invoke(main, ["measure", str(path), "--picture", str(tmp_path / "b.gif")])
    assert wrong.exit_code == 2


def test_doubts_are_printed_and_stand_in_json(tmp_path):
    path = saved(tmp_path / "a.png", others()["two steps"])
    found = CliRunner().invoke(main, ["measure", str(path), "--edge", WHOLE])
    assert found.exit_code == 0 and "may not be one straight edge" in found.output and "it rises twice" in found.output
    assert '"double"' in CliRunner().invoke(main, ["measure", str(path), "--edge", WHOLE, "--json"]).output

"""The lens from an edge photograph: a known blur comes back within its interval, the pixel divided out."""

import json
import math
import tomllib

import numpy as np
import pytest
import scipy
from click.testing import CliRunner

from etendue.cli import main
from etendue.errors import RequestError
from etendue_lab.calibrate.calibration import calibrate
from etendue_lab.calibrate.edge_blur import EdgePhotograph, edge_blur, pixel_otf, width_of
from etendue_lab.frames.moments import MONO
from etendue_lab.frames.reading import open_frames
from tests.studies.desk import TOP, TRUE, measurement


def step(shape, angle, sigma, aperture):
    """An edge behind a Gaussian and a square pixel, 0 to 1, in closed form: the normal distribution integrated twice,
    at the four corners of the pixel along the edge's normal.
    """
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    across, along = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    d = (x - shape[1] / 2 - 0.3) * across + (y - shape[0] / 2) * along
    a, b = aperture * across / 2, aperture * along / 2

    def twice(t):
        normal = np.exp(-0.5 * (t / sigma) ** 2) / math.sqrt(2 * math.pi)
        return ((t * t + sigma**2) * scipy.special.ndtr(t / sigma) + t * sigma * normal) / 2

    return (twice(d + a + b) - twice(d + a - b) - twice(d - a + b) + twice(d - a - b)) / (4 * a * b)


def photograph(path, rng, angle, sigma, aperture, bend=0.0, bright=12000.0):
    """A raw frame of an edge by the sensor of `tests.studies.desk`."""
    share = 0.1 + 0.8 * step((120, 160), angle, sigma, aperture)
    charge = rng.poisson(bright * share * (1 + TRUE["prnu"] * rng.standard_normal(share.shape)))
    charge = charge + math.hypot(TRUE["read_noise"], TRUE["dsnu"]) * rng.standard_normal(share.shape)
    charge = charge * (1 - bend * np.maximum(charge, 0) / (TOP / TRUE["gain"]))
    codes = np.clip(np.rint(charge * TRUE["gain"] + TRUE["black_level"]), 0, TOP)
    np.save(path, codes.astype(np.uint16)[None])
    return path


@pytest.fixture(scope="module")
def sensors(tmp_path_factory):
    """A linear sensor and one that bends, calibrated."""
    found = []
    for number, bend in enumerate((0.0, 0.04)):
        path = tmp_path_factory.mktemp("frames") / f"{number}.npz"
        np.savez(path, **measurement(seed=1, size=96, bend=bend, order=1, levels=20))
        frames = open_frames(path)
        found.append((bend, frames, calibrate(frames)))
    return found


def test_widths_of_twenty_four_cameras_come_back(sensors, tmp_path):
    held = []
    for number in range(24):
        rng = np.random.default_rng((11, number))
        bend, frames, model = sensors[number % 2]
        sigma, aperture, angle, pitch = rng.uniform((0.2, 0.5, 3, 1.5), (1.5, 1.0, 20, 8))
        path = photograph(tmp_path / "edge.npy", rng, angle, sigma, aperture, bend, rng.uniform(3000, 12000))
        found = edge_blur(EdgePhotograph(path, pitch, aperture), frames, [model], {"W": MONO}).sigma
        held.append(found.low <= sigma * pitch <= found.high)
        # 4.3 standard errors
        assert abs(found.value - sigma * pitch) < 2.2 * max(found.high - found.value, found.value - found.low)
    assert sum(held) >= 20  # of intervals of 95 %; fewer come once in 170 times


def test_the_width_is_solved_for_exactly():
    for sigma, aperture, angle in ((0.3, 1.0, 5.0), (1.2, 0.6, 12.0)):
        half = scipy.optimize.brentq(
            lambda f, s=sigma, a=aperture, t=angle: (
                math.exp(-2 * (math.pi * s * f) ** 2) * float(pixel_otf(f, t, a)) - 0.5
            ),
            1e-3, 0.99,
        )  # fmt: skip
        assert width_of(half, angle, aperture) == pytest.approx(sigma, rel=1e-9)
    assert width_of(0.9, 5.0, 1.0) == 0.0  # the pixel alone is below a half


def test_what_is_no_edge_of_this_pixel_is_told(sensors, tmp_path):
    _, frames, model = sensors[0]
    places, rng = {"W": MONO}, np.random.default_rng(0)
    sharp = photograph(tmp_path / "sharp.npy", rng, 6.0, 0.05, 0.4)
    with pytest.raises(RequestError, match="above the MTF50 of a pixel"):
        edge_blur(EdgePhotograph(sharp, 4.0, 1.0), frames, [model], places)
    bright = photograph(tmp_path / "bright.npy", rng, 6.0, 0.5, 1.0, bright=30000.0)
    with pytest.raises(RequestError, match="top code"):
        edge_blur(EdgePhotograph(bright, 4.0, 1.0), frames, [model], places)
    np.save(tmp_path / "flat.npy", np.full((1, 64, 64), 500, np.uint16))
    with pytest.raises(RequestError, match=r"flat\.npy"):
        edge_blur(EdgePhotograph(tmp_path / "flat.npy", 4.0, 1.0), frames, [model], places)


def test_the_file_states_the_lens_and_its_pixel(tmp_path):
    np.savez(tmp_path / "frames.npz", **measurement(seed=1, size=64))
    edge = photograph(tmp_path / "edge.npy", np.random.default_rng(2), 6.0, 0.7, 0.8)
    asked = ["calibrate", str(tmp_path / "frames.npz"), "-o", str(tmp_path / "mine.toml"), "--edge", str(edge)]
    refused = CliRunner().invoke(main, [*asked, "--pitch", "4"])
    assert refused.exit_code == 2
    assert "--aperture" in refused.output
    assert not (tmp_path / "mine.toml").exists()
    done = CliRunner().invoke(main, [*asked, "--pitch", "4", "--aperture", "0.8", "--json"])
    assert done.exit_code == 0, done.output
    found, written = json.loads(done.output)["edge"], tomllib.loads((tmp_path / "mine.toml").read_text())
    assert found["sigma_low"] < 2.8 < found["sigma_high"]
    assert written["facts"]["lens"]["value"] == f"sigma = {found['sigma']:.5g} um"
    camera = {name: one["value"] for name, one in written["camera"].items()}
    assert camera["microlens_gain"] * camera["aperture_fraction"] ** 2 == pytest.approx(1, rel=1e-8)

"""Information and losses along a camera: laws of the chain, and what is found beside what is predicted."""

import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from etendue.builder.simulating import simulate
from etendue.cli import main
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.session import load
from etendue_camera.resolution import noise_power
from etendue_lab.information.fine_detail import fine_detail, frames
from etendue_lab.information.study import information
from etendue_lab.losses.study import losses
from tests.studies.test_noise import CAMERA

BLURRED = CAMERA.replace(
    'use = "pixel"\nsampling = "paper"', 'use = "lens_gaussian"\nsigma = "2 um"\n[[stages]]\nuse = "pixel"'
)


def camera(text=CAMERA, camera="", side=480, demosaic="demosaic_bilinear"):
    return load(text.format(demosaic=demosaic, camera=camera, side=side))


@pytest.fixture(scope="module")
def report():
    return information(camera(BLURRED, side=320), installed_stages(), count=0)


def test_nothing_behind_the_light_adds_information(report):
    bits = [row.bits for row in report.rows]
    assert all(after <= before + 1e-3 for before, after in itertools.pairwise(bits))
    assert report.rows[0].bits == pytest.approx(0.5 * math.log2(1 + 0.12 * report.rows[0].quanta[0]))
    for row in report.rows:
        assert max(row.channels.values(), default=0.0) <= row.bits + 1e-3


def test_a_filter_of_each_channel_loses_nothing(report):
    """Sharpening and a colour matrix can be undone, so that all channels together tell as much."""
    by_stage = {row.stage: row.bits for row in report.rows}
    assert by_stage["sharpen"] == pytest.approx(by_stage["demosaic"], abs=1e-6)
    assert by_stage["display"] == pytest.approx(by_stage["demosaic"], rel=1e-3)


def test_noise_power_is_found_as_predicted():
    """Behind demosaicer and sharpening: 15 x 64 periodograms of 8 pixels, three rows of them, five standard errors."""
    detail = fine_detail(camera(side=384), installed_stages(), 0.18)
    places = [place for place in detail.answers if place[1] == "rgb_camera"]
    stacks = frames(detail, installed_stages(), 16)
    for place in places:
        found, count = noise_power.periodograms(np.stack([frame[place] for frame in stacks]), 8)
        expected = sum(w * noise_power.expected_periodogram(h, v, 8) for h, v, w in detail.answers[place])
        for i in range(3):
            ratio = (found[i, i].real[[0, 1, -1]].mean(0) / expected[i, i].real[[0, 1, -1]].mean(0))[1:5]
            assert np.all(np.abs(ratio - 1) < 5 / math.sqrt(2 * count))  # at fx = 4/8 the rows 1 and -1 are one
    with_expected = frames(detail, installed_stages(), 2, expected=["shot_noise", "read_noise", "exposure"])
    assert all(np.std(frame[places[0]] - with_expected[0][places[0]]) < 1e-3 for frame in with_expected)


@pytest.mark.long
def test_quanta_are_found_as_predicted():
    """Five standard errors of the noise, and 3 % for the contrast of an edge 92 rows long, squared."""
    report = information(camera(BLURRED, side=480, demosaic="demosaic_colour_difference"), installed_stages(), count=16)
    assert {(c.stage, c.channel) for c in report.curves} >= {
        ("linearise", "R"),
        ("demosaic", "G"),
        ("sharpen", "B"),
        ("display", "R"),
    }
    for curve in report.curves:
        assert curve.apart < 5 * curve.standard_error + 0.03
        assert curve.bits_found == pytest.approx(curve.bits_predicted, rel=0.03)


def test_the_stage_says_the_same_of_a_grey_card():
    """Dark charge counts as light there: a thousandth here."""
    text = (
        BLURRED.replace('use = "slanted_edge"', 'use = "uniform"\nreflectance = 0.18')
        + '[[stages]]\nuse = "detail_information"\n'
    )
    tree = simulate(
        text.format(demosaic="demosaic_bilinear", camera="", side=256), want=["information_capacity", "neq"]
    )
    found = tree["detail_information"]
    row = next(r for r in information(camera(BLURRED, side=256), installed_stages(), count=0).rows if r.stage == "adc")
    assert float(found.information_capacity[-1]) == pytest.approx(row.bits, rel=5e-3)
    np.testing.assert_allclose(found.neq.values[[0, 16]], row.quanta[:2], rtol=0.02)


@pytest.fixture(scope="module")
def shared():
    return losses(camera(BLURRED, side=256), installed_stages(), runs=0)


def test_shares_sum_to_the_loss_and_predict_pairs(shared):
    for game in shared.games:
        assert game.shares.values.sum() == pytest.approx(game.shares.total)
        for predicted, found in game.pairs.values():
            assert predicted == pytest.approx(found, abs=0.05 * game.shares.gross)


def test_losses_are_those_of_the_camera_itself(shared):
    contrast, snr = shared.games
    f = 0.25 * (1 + np.polynomial.legendre.leggauss(64)[0])
    weight = 0.5 * np.polynomial.legendre.leggauss(64)[1]
    lens = np.exp(-2 * (math.pi * 2 / 4 * f) ** 2)  # sigma 2 um, pixels of 4 um: with all else ideal
    with_all = dict(zip(contrast.shares.players, contrast.shares.values, strict=True))
    assert with_all["lens_gaussian"] == pytest.approx(-20 * math.log10(weight @ lens), rel=0.15)
    assert contrast.ideal == pytest.approx(1)
    assert snr.ideal > snr.camera
    assert with_all["sharpen"] < 0  # it wins contrast back, and costs SNR
    assert dict(zip(snr.shares.players, snr.shares.values, strict=True))["sharpen"] > 0


def test_noise_that_is_found_agrees_with_the_camera_of_the_shares(shared):
    report = information(camera(BLURRED, side=256), installed_stages(), count=0)
    last = next(row for row in report.rows if row.stage == "adc")
    assert last.quanta[0] < sum(report.electrons.values())
    assert shared.games[1].ideal == pytest.approx(math.sqrt(report.electrons["G"]))


@pytest.mark.long
def test_colour_is_shared_out_among_lens_mosaic_and_sharpening():
    report = losses(camera(BLURRED, side=256), installed_stages(), runs=16)
    game = report.games[-1]
    assert (game.name, game.ideal) == ("colour", 0)
    assert set(game.shares.players) == {"lens_gaussian", "sharpen", "mosaic to demosaic"}
    assert game.shares.values.sum() == pytest.approx(game.camera**2)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"reflectance": 0.0}, "--reflectance 0"),
        ({"ratio": 1.0}, "--contrast-ratio 1"),
        ({"size": 100.0}, "--object 100"),
        ({"count": 1}, "--frames 1"),
    ],
)
def test_requests_without_meaning_are_refused(settings, message):
    with pytest.raises(RequestError, match=message):
        information(camera(), installed_stages(), **settings)


def test_in_the_dark_there_is_no_information():
    report = information(camera(CAMERA.replace("10 ms", "1e-9 s"), side=272), installed_stages(), count=0)
    assert all(0 <= row.bits < 1e-4 for row in report.rows)


def test_a_camera_without_a_mosaic_is_refused():
    pipeline = camera()
    with pytest.raises(RequestError, match="mosaic_linear"):
        information(replace(pipeline, stages=pipeline.stages[:6]), installed_stages(), count=0)


def test_both_commands_print_and_give_json(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(CAMERA.format(demosaic="demosaic_bilinear", camera="", side=272))
    for words in (["information", str(path), "--frames", "0"], ["losses", str(path), "--runs", "0"]):
        shown = CliRunner().invoke(main, words)
        assert shown.exit_code == 0, shown.output
        assert "demosaic" in shown.output
        given = CliRunner().invoke(main, [*words, "--json"])
        document = json.loads(given.stdout)
        assert document["pipeline"] == "small"
    assert CliRunner().invoke(main, ["losses", str(path), "--reflectance", "2"]).exit_code == 2

"""A pair follows from the seed and its number alone, and is what a run of its settings gives."""

from __future__ import annotations

import json
import pickle
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest
from PIL import Image

from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.evaluation.asking import overrides_of
from etendue.pipeline.file import overridden
from etendue.plan.planner import make_plan
from etendue.session import load
from etendue_lab.pairs.blocks import names_of, write_blocks
from etendue_lab.pairs.drawing import pairs_of, photographs_of
from tests.run.small import BARE, assert_same_bits, command, run

OVER = (
    "f_number=1.8:8",
    "integration_time=1 ms:10 ms:log",
    "bits=8:14",
    "demosaic.use=demosaic_bilinear,demosaic_nearest",
)
EXAMPLE = "package:etendue_camera/data/examples/picture.png"
TEXT = BARE.replace('use = "composite"', f'use = "photograph"\nfile = "{EXAMPLE}"')


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Three pictures in two folders, and a file that is none."""
    place = tmp_path_factory.mktemp("photographs")
    draw = np.random.default_rng(5)
    (place / "more").mkdir()
    for name in ("b.png", "a.JPG", "more/c.tif"):
        Image.fromarray(draw.integers(0, 255, (40, 60, 3), dtype=np.uint8)).save(place / name)
    (place / "notes.txt").write_text("no picture")
    return place


def small(photographs, **how):
    return pairs_of(load(TEXT), photographs, **{"over": OVER, "seed": 7, "count": 12, **how})


def digest_of(pairs, number):
    return pairs[number].digest()


def test_a_pair_is_the_same_in_any_order_on_any_worker(photographs):
    pairs = small(photographs)
    first = [pair.digest() for pair in pairs]
    assert len(set(first)) == 12
    assert [small(photographs)[n].digest() for n in (11, 3)] == [first[11], first[3]]
    assert small(photographs, count=5000)[3].digest() == first[3]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(lambda n: digest_of(pairs, n), range(12))) == first
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        found = pool.map(pairs.__getitem__, (0, 5, 10))
        assert [pair.digest() for pair in found] == [first[n] for n in (0, 5, 10)]
    assert pickle.loads(pickle.dumps(pairs))[5].digest() == first[5]


def test_a_pair_is_what_a_run_gives(photographs):
    pairs = small(photographs, variables=("raw", "expected_charge", "rgb_camera"))
    for number in (0, 4):
        pair = pairs[number]
        pipeline = overridden(load(TEXT), overrides_of(pair.settings))
        tree = run(make_plan(pipeline, installed_stages()), pictures=False).tree
        for name, stage in (("raw", "adc"), ("expected_charge", "exposure"), ("rgb_camera", "sharpen")):
            whole = tree[stage][name].values.astype(np.float32)
            assert_same_bits(pair.arrays[name], whole if whole.ndim == 3 else whole[np.newaxis], name)
            assert pair.arrays[name].dtype == np.float32
        assert pair.arrays["raw"].shape == (1, 32, 32)
        assert pair.arrays["rgb_camera"].shape == (3, 32, 32)


def test_the_truth_is_the_mean_of_the_raw_frame(photographs):
    """In electrons the raw frame differs from the truth by noise, of which most is that of photons: its variance is the
    mean charge, if nothing is read noise. Of 1024 pixels a variance has a standard error of 4.4 %; five of these, and
    5 % for rounding.
    """
    quiet = TEXT.replace('"2.6 um"', '"2.6 um"\nread_noise = 0\nbits = 14')
    for pair in pairs_of(load(quiet), photographs, over=["integration_time=1 ms:2 ms"], seed=7)[:4]:
        raw, mean = (pair.arrays[name].ravel().astype(float) for name in ("raw", "expected_charge"))
        slope, offset = np.polyfit(mean, raw, 1, w=1 / np.sqrt(mean))
        share = (((raw - offset) / slope - mean) ** 2 / mean).mean()
        assert 1 - 0.22 < share < 1 + 0.27


def test_settings_are_drawn_from_their_ranges_and_from_all_photographs(photographs):
    pairs = small(photographs, count=3000)
    every = [pairs.settings(n) for n in range(3000)]
    assert {one["scene.file"] for one in every} == set(pairs.photographs)
    assert len(pairs.photographs) == 3
    assert {one["bits"] for one in every} == set(range(8, 15))
    assert {one["demosaic.use"] for one in every} == {"demosaic_bilinear", "demosaic_nearest"}
    assert len({one["seed"] for one in every}) == 3000
    stops = np.array([one["f_number"] for one in every])
    times = np.log([one["integration_time"] for one in every])
    assert 1.8 <= stops.min() < 1.85 < 7.95 < stops.max() <= 8
    # The mean of a uniform draw, within five standard errors.
    for values, low, high in ((stops, 1.8, 8), (times, np.log(1e-3), np.log(1e-2))):
        assert abs(values.mean() - (low + high) / 2) < 5 * (high - low) / np.sqrt(12 * 3000)


def test_memory_stays_within_its_bound(photographs):
    pairs = small(photographs, count=30)
    pairs.session.clear()
    pairs.session.results.clear(600_000)
    digests = [pair.digest() for pair in pairs]
    assert pairs.session.bytes <= 600_000
    assert digests == [pair.digest() for pair in small(photographs, count=30)]


def test_blocks_hold_the_pairs_and_stay(photographs, tmp_path):
    pairs = small(photographs, count=10)
    assert write_blocks(pairs, tmp_path, size=4) == 10
    numbers = []
    for block in range(3):
        arrays, settings = names_of(block)
        found, beside = np.load(tmp_path / arrays), json.loads((tmp_path / settings).read_text())
        assert found["raw"].dtype == np.float32
        for at, number in enumerate(found["number"]):
            pair = pairs[int(number)]
            assert_same_bits(found["raw"][at], pair.arrays["raw"])
            assert_same_bits(found["expected_charge"][at], pair.arrays["expected_charge"])
            assert beside["settings"][at] == json.loads(json.dumps(pair.settings))
        numbers += found["number"].tolist()
    assert numbers == list(range(10))
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert write_blocks(pairs, tmp_path, size=4) == 0
    (tmp_path / names_of(1)[1]).unlink()  # as if it had been stopped before the block was whole
    assert write_blocks(pairs, tmp_path, size=4, workers=1) == 4
    assert before == {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert write_blocks(replace(pairs, total=14), tmp_path, size=4) == 6  # the last block was not full
    for other in (replace(pairs, seed=8), replace(pairs, variables=("raw",))):
        with pytest.raises(RequestError, match="holds other pairs"):
            write_blocks(other, tmp_path, size=4)


@pytest.mark.parametrize(
    ("text", "how", "says"),
    [
        (BARE, {}, 'no stage reads a picture; give the scene use = "photograph"'),
        (TEXT, {"over": ["f_numbr=1:2"]}, "did you mean 'f_number'"),
        (TEXT, {"variables": ["raww"]}, "'raw'"),
        (TEXT, {"variables": ["irradiance"]}, "has the dims wavelength y x; expected y x, or channel y x"),
        (TEXT, {"variables": ["clipped_fraction"]}, "expected y x"),
        (TEXT + "\n[sweep]\nf_number = [2, 4]\n", {"over": []}, "the pipeline sweeps f_number, but every pair"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_computed(photographs, text, how, says):
    with pytest.raises(RequestError, match="(?s).*") as refused:
        pairs_of(load(text), photographs, **{"over": OVER, **how})
    assert says in str(refused.value)


def test_photographs_that_are_not_there_are_told(tmp_path):
    for place, says in (
        (tmp_path, "no pictures"),
        (tmp_path / "x.png", "no such file"),
        ([tmp_path / "y.png"], "y.png"),
    ):
        with pytest.raises(RequestError, match=says):
            photographs_of(place)


def test_the_command_writes_blocks(photographs, tmp_path):
    (tmp_path / "small.toml").write_text(TEXT)
    words = ["pairs", tmp_path / "small.toml", "--photographs", photographs, "--over", OVER[0], "--count", "5"]
    words += ["--block", "3", "-o", tmp_path / "out"]
    done = command(*words, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["shapes"] == {"raw": [1, 32, 32], "expected_charge": [1, 32, 32]}
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(
        [*names_of(0), *names_of(1), "pairs.json"]
    )
    again = command(*words)
    assert "5 pairs, 0 of them made now" in again.stdout

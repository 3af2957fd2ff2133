"""The probe of whole cameras: a few of them hold here, 200 in ``benchmarks/random_cameras.py``; and each of its laws
can be broken.
"""

import copy
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from etendue_lab.stability import camera_laws

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))
import drawn_cameras  # noqa: E402
import random_cameras  # noqa: E402

sys.path.remove(str(BENCHMARKS))

SEEDS = (2, 4, 7, 13, 16, 22, 24, 26, 29, 32, 38, 41)
TIMES = len(camera_laws.TIMES)


@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
def test_a_camera_obeys_the_laws_or_is_refused_with_a_reason(seed, tmp_path):
    verdict = random_cameras.judge(seed, tmp_path, small=True)
    assert not verdict.broken, random_cameras.table([verdict])


def test_a_seed_is_a_camera_and_its_file_says_the_same(tmp_path):
    for seed in range(60):
        document = drawn_cameras.draw(seed, tmp_path)
        assert drawn_cameras.draw(seed, tmp_path) == document
        assert tomllib.loads(random_cameras.toml_of(document)) == document


def test_the_ranges_that_are_drawn_from_are_those_declared():
    from etendue.contract.values import quantities as camera

    drawn = [drawn_cameras.Drawn(seed, Path()) for seed in range(300)]
    for one in drawn:
        one.quantities()
    for name in camera.names():
        parameter = camera.declared(name)
        found = [one.camera[name] for one in drawn if name in one.camera]
        numbers = [
            v
            for values in found
            for v in (values if isinstance(values, list) else [values])
            if isinstance(v, int | float)
        ]
        assert all(parameter.allows(v) for v in numbers)
        if name in ("pixel_pitch", "f_number", "integration_time"):
            low, high = drawn_cameras.SPANS[name]
            assert min(numbers) < low * (high / low) ** 0.1 and max(numbers) > low * (high / low) ** 0.9


# -- a law that cannot be broken says nothing ----------------------------------------------------------------------


class Tree(dict):
    """What a law looks at, without a run."""

    def __init__(self, **arrays):
        super().__init__()
        for place, values in arrays.items():
            stage, _, variable = place.partition("__")
            self.setdefault(stage, {})[variable] = type("Values", (), {"values": np.asarray(values)})()


def card(display, mosaic):
    """A grey card of 2 x 2 pixels at seven times: (time, channel) on the display, (time,) in the mosaic."""
    return Tree(
        ideal__mosaic_linear=np.broadcast_to(np.asarray(mosaic)[:, None, None], (TIMES, 2, 2)),
        encode__rgb_display=np.broadcast_to(np.asarray(display)[:, :, None, None], (TIMES, 3, 2, 2)),
        adapt__cones_floored=np.zeros(TIMES),
        fit__colour_matrix=np.eye(3),
    )


RISING = np.linspace(0.1, 1.0, TIMES)
MADE = {"sweep": {"integration_time": []}, "camera": {}}


def broken(display, mosaic=RISING * 0.9):
    return {one.law for one in camera_laws.grey_card(MADE, card(display, mosaic))}


def test_a_card_that_darkens_or_turns_coloured_or_clips_to_grey_is_found():
    grey = np.repeat(RISING[:, None], 3, axis=1)
    assert broken(grey) == set()
    falling = grey.copy()
    falling[3] = 0.1
    assert broken(falling) == {"monotone"}
    coloured = grey.copy()
    coloured[2:, 0] += 0.0021
    assert broken(coloured) == {"neutral"}
    clipped = np.where(np.arange(TIMES) >= 5, 1.0, 0.5)
    assert broken(np.minimum(grey, 0.9), clipped) == {"white"}
    assert broken(np.where(clipped[:, None] == 1, 1.0, grey * 0.5), clipped) == set()


def test_a_pixel_is_white_only_where_all_of_its_support_is_clipped(tmp_path):
    mosaic = np.ones((TIMES, 40, 40))
    mosaic[:, 0, 0] = 0.5
    display = np.ones((TIMES, 3, 40, 40))
    display[:, :, 4, 4] = 0.7  # within reach of the pixel that is not clipped
    made = camera_laws.over_time(drawn_cameras.draw(2, tmp_path, small=True))
    made["wanted"] = ["ideal.mosaic_linear"]
    for slot in ("adapt", "display"):
        camera_laws.of(made, slot)[{"adapt": "target", "display": "display"}[slot]] = "sRGB"
    lifted, matrix = np.zeros(TIMES), np.eye(3)
    tree = Tree(
        ideal__mosaic_linear=mosaic, encode__rgb_display=display, adapt__cones_floored=lifted, fit__colour_matrix=matrix
    )
    assert not list(camera_laws.any_scene(made, tree))
    display[:, :, 30, 30] = 1 - 1e-5
    assert {one.law for one in camera_laws.any_scene(made, tree)} == {"white"}


def test_light_that_is_lost_or_bent_or_out_of_bounds_is_found():
    wanted = {"wanted": ["irradiance.irradiance", "lens.irradiance"]}
    plane = np.ones((3, 4, 4))
    assert not list(camera_laws.flux(wanted, Tree(irradiance__irradiance=plane, lens__irradiance=plane)))
    assert list(camera_laws.flux(wanted, Tree(irradiance__irradiance=plane, lens__irradiance=plane * (1 - 1e-5))))
    assert not list(camera_laws.linear({}, Tree(cfa__photocurrent=[plane, 10 * plane])))
    assert list(camera_laws.linear({}, Tree(cfa__photocurrent=[plane, 10.001 * plane])))
    document = {
        "camera": {"bits": 8},
        "stages": [{"use": "encode", "name": "encode"}, {"use": "adc", "name": "convert"}],
    }
    fine = {"encode__rgb_display": np.ones((3, 2, 2)), "convert__raw": np.full((2, 2), 255, np.uint16)}
    assert not list(camera_laws.bounded(document, Tree(**fine)))
    for place, value in (("encode__rgb_display", 1.001), ("encode__rgb_display", np.nan), ("convert__raw", 256)):
        wrong = copy.deepcopy(fine)
        wrong[place] = np.full(wrong[place].shape, value)
        assert list(camera_laws.bounded(document, Tree(**wrong)))


def test_a_warning_a_failed_cell_and_a_refusal_are_told_apart(tmp_path, monkeypatch):
    document = drawn_cameras.draw(2, tmp_path, small=True)
    refused = {**document, "camera": {**document["camera"], "f_number": -1.0}}
    with pytest.raises(camera_laws.Refused, match="f_number"):
        random_cameras.run(refused, tmp_path)
    import warnings

    monkeypatch.setattr("etendue.simulate", lambda *_, **__: warnings.warn("careless", RuntimeWarning, stacklevel=1))
    with pytest.raises(camera_laws.Failure, match="careless") as found:
        random_cameras.run(document, tmp_path)
    assert found.value.kind == "leaked warning"

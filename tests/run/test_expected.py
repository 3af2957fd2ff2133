"""Runs of expected values: samplers give their mean, nothing is rounded."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from etendue.compute import random
from etendue.compute.tables import PatternRandom
from etendue.contract.arrays.grid import Grid, Line
from etendue.contract.capabilities import Sampled, has_no_mean, is_random, mean_arguments_of, rounds
from etendue.contract.registry import installed_stages
from etendue.contract.stage import arguments_of
from etendue.pipeline.file import read_pipeline
from etendue.plan.planner import make_plan
from etendue.session import Options, collect, load
from etendue_camera.electronics import converter, noise
from tests.run.small import BARE, assert_same_bits

FLAT = BARE.replace('use = "composite"', 'use = "uniform"')
SIDE = 200
GRID = Grid.of({"y": Line(SIDE, 0.0, 1.0), "x": Line(SIDE, 0.0, 1.0)})
TRIED = {  # what each sampler and rounding is tried on: parameters, what it reads
    "exposure": ({"prnu": 0.05, "dark_current_density": 1e-8, "integration_time": 0.1}, {"photocurrent": 3e4}),
    "shot_noise": ({}, {"expected_charge": 7.3}),
    "read_noise": ({"read_noise": 5.0, "dsnu": 3.0}, {"charge": 120.3}),
    "line_pattern": (
        {"row_pattern": 1.0, "column_pattern": 2.0, "row_noise": 1.0, "column_noise": 0.5},
        {"charge": 120.3},
    ),
    "adc": ({"bits": 10}, {"charge": 523.4}),
    "defects": ({"hot": 0.02, "dead": 0.05}, {"photocurrent": 3e4}),
    "stuck_pixels": ({"stuck": 0.05, "bits": 10}, {"raw": 431}),
}


def expected_plan(text=BARE, expected=True, **overrides):
    return make_plan(load(text, overrides), installed_stages(), expected=expected)


def collected(plan, *names, **how):
    """The named variables of a plan without a sweep."""
    last = {v: node.name for node in plan.nodes for v in node.writes}
    wanted = {}
    for name in names:
        wanted.setdefault((last[name], (0,) * len(plan.node(last[name]).axes)), set()).add(name)
    found = collect(plan, wanted, Options(**{"scheduler": "serial", **how}))
    return {name: array for arrays in found.arrays.values() for name, array in arrays.items()}


def test_every_built_in_stage_that_draws_or_rounds_knows_its_mean():
    kinds = {name: installed_stages().load(name) for name in installed_stages().names()}
    ours = {name: kind for name, kind in kinds.items() if kind.__module__.startswith("etendue_camera.")}
    assert [name for name, kind in ours.items() if has_no_mean(kind)] == []
    drawing = {name for name, kind in ours.items() if is_random(kind) or rounds(kind)}
    assert drawing == set(TRIED)  # each of them is held to its mean below
    for name in drawing:
        assert set(mean_arguments_of(ours[name])) <= set(arguments_of(ours[name])) - {"rng", "rng_sensor"}


@pytest.mark.parametrize("name", TRIED)
def test_the_mean_of_many_draws_is_what_the_stage_says(name):
    """Within 4.5 standard errors over 30 draws of 40 000 pixels; rows and columns of a pattern are fewer, and so is
    their share.
    """
    values, inputs = TRIED[name]
    stage = installed_stages().load(name)(**values)
    reads = {
        port: np.full((SIDE, SIDE), value, dtype=np.uint16 if port == "raw" else np.float64)
        for port, value in inputs.items()
    }
    beside = {"prepared": np.zeros((SIDE, SIDE), np.uint8)}
    means, found = [], None
    for seed in range(30):
        given_too = beside | {
            "rng": random.philox(f"{name} {seed}".encode()),
            "rng_sensor": PatternRandom(f"{name} {seed}".encode(), GRID, "float64"),
        }
        found = stage.run(**{k: v for k, v in {**reads, **given_too}.items() if k in arguments_of(type(stage))})
        means.append({k: v.astype(float).mean() for k, v in found.items() if not k.endswith("_map")})
    floats = {port: array.astype(np.float64) for port, array in reads.items()}
    mean = stage.mean(**{k: v for k, v in {**floats, **beside}.items() if k in mean_arguments_of(type(stage))})
    assert mean.keys() == found.keys()
    for variable in means[0]:
        drawn = np.array([one[variable] for one in means])
        error = drawn.std(ddof=1) / np.sqrt(len(drawn))
        rounded = 0.5 if rounds(type(stage)) else 0.0  # codes of one charge may all lie on one side
        assert abs(drawn.mean() - mean[variable].mean()) <= 4.5 * error + rounded + 1e-9 * abs(drawn.mean())


@given(st.floats(-1e3, 1e5), st.floats(1e-3, 10), st.integers(2, 16), st.floats(0, 2.9))
def test_rounding_moves_a_code_by_half_a_step_at_most(charge, gain, bits, black):
    code = converter.digitise(np.array([charge]), gain, black, bits)[0]
    exact = converter.unrounded(np.array([charge]), gain, black, bits)[0]
    assert abs(float(code) - exact) <= 0.5 + 1e-9 * abs(charge * gain)


def test_factors_that_are_cut_off_at_nothing_have_the_mean_that_is_said():
    """Against 2 million normals: standard error below 7e-4."""
    z = np.random.default_rng(3).standard_normal(2_000_000)
    for spread in (0.0, 0.1, 0.5, 1.0):
        assert np.maximum(1 + spread * z, 0).mean() == pytest.approx(
            noise.mean_factor(spread), abs=4 * spread / np.sqrt(z.size) + 1e-15
        )


def test_without_samplers_in_front_the_expected_run_is_the_run():
    """What stands before the first draw has the bits of an ordinary run, and its key."""
    plain, means = expected_plan(expected=False), expected_plan()
    for name in ("photon_rate", "photocurrent"):
        assert_same_bits(collected(plain, name)[name], collected(means, name)[name])
    behind = {"exposure", "shot_noise", "read_noise", "adc", "linearise", "demosaic", "sharpen", "exposure_report"}
    changed = {cell.node for cell in means.cells.values() if cell.key != plain.cells[cell.ref].key}
    assert changed == behind


def test_a_camera_without_noise_differs_from_its_mean_by_rounding_alone():
    quiet = {
        "camera.read_noise": 0,
        "camera.dsnu": 0,
        "exposure.prnu": 0,
        "exposure.dark_nonuniformity": 0,
        "camera.black_level": 64,
    }
    means = collected(expected_plan(**quiet), "expected_charge", "raw", "mosaic_linear")
    runs = collected(expected_plan(expected=False, **quiet), "expected_charge")
    assert_same_bits(means["expected_charge"], runs["expected_charge"])
    adc = expected_plan(**quiet).of("adc")[0].stage
    codes = adc.run(means["expected_charge"])["raw"]
    assert means["raw"].dtype.kind == "f"
    assert np.abs(codes - means["raw"]).max() <= 0.5 + 1e-3


def test_a_flat_scene_is_on_average_what_the_expected_run_gives():
    """12 seeds and sensors of 1024 pixels, far from clipping: the mean code of a colour within 4.5 standard errors, and
    0.02 DN of rounding, which noise of several DN spreads evenly."""
    bright = {"camera.integration_time": "2 ms", "camera.black_level": 64, "camera.read_noise": 10}
    mean = collected(expected_plan(FLAT, **bright), "raw")["raw"]
    drawn = []
    for seed in range(12):
        plan = expected_plan(FLAT, expected=False, seed=seed, **bright, **{"camera.sensor_serial": f"number {seed}"})
        drawn.append(collected(plan, "raw")["raw"].astype(float))
    assert mean.max() < 0.9 * np.iinfo(np.uint16).max
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        frames = np.array([one[row::2, column::2].mean() for one in drawn])
        error = frames.std(ddof=1) / np.sqrt(len(frames))
        assert abs(frames.mean() - mean[row::2, column::2].mean()) <= 4.5 * error + 0.02


def test_expected_values_are_the_same_for_every_scheduler_and_seed():
    serial = collected(expected_plan(), "raw", "rgb_camera")
    threads = collected(expected_plan(seed=99), "raw", "rgb_camera", scheduler="threads", workers=2, batch_seconds=0.0)
    processes = collected(expected_plan(), "raw", "rgb_camera", scheduler="processes", workers=2)
    for name, array in serial.items():
        assert_same_bits(array, threads[name])
        assert_same_bits(array, processes[name])


def test_slices_that_the_engine_maps_are_expected_values_too():
    """Frames of a bracket: each has the expected charge of its own time, whatever the seed."""
    pipeline = replace(
        read_pipeline(Path(__file__).parents[2] / "pipelines" / "burst.toml"), wanted=("read_noise.charge",)
    )
    runs = []
    for seed in (1, 2):
        plan = make_plan(replace(pipeline, seed=seed), installed_stages(), expected=True)
        ref = next(cell.ref for cell in plan.cells.values() if cell.node == "read_noise")
        runs.append(collect(plan, {ref: ["charge"]}, Options(scheduler="serial")).arrays[ref]["charge"])
    assert runs[0].ndim == 3
    assert_same_bits(*runs)


def test_a_mean_that_asks_for_random_numbers_is_refused():
    class Drawing(Sampled):
        writes = {"charge": "y x [electron]"}

        def run(self, rng):
            return {}

        def mean(self, rng):
            return {}

    with pytest.raises(TypeError, match="draws no random numbers"):
        mean_arguments_of(Drawing)

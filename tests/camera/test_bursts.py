"""Bursts and brackets: a stage is run frame by frame, whoever wrote it, and what frames know together is merged."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import etendue
from etendue.compute.random import philox
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.plan.planner import make_plan
from etendue.session import load
from etendue_camera.restoration import merging

pytestmark = pytest.mark.long

DEMOSAICERS = [
    "demosaic_bilinear",
    "demosaic_colour_difference",
    "demosaic_directional",
    "demosaic_residual",
    "demosaic_malvar",
]
NOISE = ("shot_noise", "full_well", "read_noise", "adc", "linearise")
PICTURE = (
    "white",
    "balance_mosaic",
    "demosaic_bilinear",
    "merge_frames",
    "colour_fit",
    "camera_to_xyz",
    "balance",
    "display",
    "encode",
)


def burst(*stages, brackets=(-2, 0, 2), repeats=1, side=64, scene=None, camera=None, meter=None, **more):
    """A metered bracket of a chart."""
    width = side * 4.0 + 20
    first = {
        "use": "composite",
        "name": "scene",
        "white_luminance": 800,
        "width": width,
        "height": width,
        "spacing": 1.0,
        "wavelength_from": 400,
        "wavelength_to": 700,
        "bin_width": 50,
    } | (scene or {})
    front = [first, {"use": "irradiance"}, {"use": "pixel", "rows": side, "columns": side}, {"use": "mosaic"}]
    time = [{"use": "meter"} | (meter or {}), {"use": "bracket", "repeats": repeats, "brackets": list(brackets)}]
    rest = [stage if isinstance(stage, dict) else {"use": stage} for stage in stages]
    return {
        "name": "burst",
        "seed": 5,
        "stages": [*front, *time, *rest],
        "camera": {"peak_qe": [0.4, 0.5, 0.45], "pixel_pitch": 4.0, "f_number": 4.0} | (camera or {}),
        **more,
    }


CHAIN = ("exposure", *NOISE, *PICTURE)


def test_a_metered_bracket_goes_through_each_of_five_demosaicers_to_the_display():
    chain = [{"use": "demosaic_bilinear", "name": "demosaic"} if use == "demosaic_bilinear" else use for use in CHAIN]
    tree = etendue.simulate(burst(*chain, sweep={"demosaic.use": DEMOSAICERS}))
    assert tree["demosaic"].rgb_camera.dims == ("demosaic", "frame", "channel", "y", "x")
    shown = tree["encode"].rgb_display
    assert shown.dims == ("demosaic", "channel", "y", "x")
    assert len({picture.values.tobytes() for picture in shown}) == len(DEMOSAICERS)
    assert np.isfinite(shown).all()
    # a bracket sees two stops further up than its metered exposure alone, and shows the same scene
    alone = etendue.simulate(burst(*(s for s in chain if s != "merge_frames"), brackets=[0]))[
        "encode"
    ].rgb_display.values[0]
    assert np.median(np.abs(shown.values[0] - alone)) < 0.02


def test_a_frame_equals_the_stage_alone_on_that_frame_bit_for_bit():
    """Noise too: its words are those of the cell, with the frame's label behind them."""
    document = burst(*CHAIN[: CHAIN.index("merge_frames")], repeats=2, brackets=[0, -1], camera={"noise": "common"})
    tree = etendue.simulate(document)
    plan = make_plan(load(document), installed_stages())
    for name, port, variable in (
        ("shot_noise", "expected_charge", "charge"),
        ("full_well", "charge", "charge"),
        ("demosaic_bilinear", "mosaic_linear", "rgb_camera"),
    ):
        node = plan.node(name)
        (cell,) = plan.of(name)
        source = next(s for p, s, _ in node.inputs[0] if p == port)
        given = tree[source][port].values
        assert given.shape[0] == 4
        for frame in range(4):
            arguments = {port: given[frame]}
            if name == "shot_noise":
                arguments["rng"] = philox(cell.seed + f"|frame={frame}".encode())
            if name == "demosaic_bilinear":
                arguments |= {"y": np.arange(64.0), "x": np.arange(64.0)}
            assert_array_equal(tree[name][variable].values[frame], cell.stage.run(**arguments)[variable])
    frames = tree["shot_noise"].charge.values
    assert not np.array_equal(frames[0], frames[1])  # new noise in every frame


def test_expected_charge_of_a_frame_is_that_of_a_single_exposure_of_its_time():
    many = etendue.simulate(burst("exposure", brackets=[0, -3, 1]))
    for frame, time in enumerate(many["bracket"].integration_time.values):
        document = burst("exposure", camera={"integration_time": float(time)})
        document["stages"] = [s for s in document["stages"] if s["use"] not in ("meter", "bracket")]
        one = etendue.simulate(document)["exposure"].expected_charge.values
        assert_array_equal(many["exposure"].expected_charge.values[frame], one)


def flat(level, **more):
    """A flat grey card, seen without anything that makes pixels unequal but noise."""
    return burst(
        {"use": "exposure", "prnu": 0, "dark_nonuniformity": 0},
        *NOISE,
        "white",
        "balance_mosaic",
        {"use": "demosaic_nearest", "name": "demosaic"},
        "merge_frames",
        side=400,
        scene={"use": "uniform", "reflectance": level, "spacing": 40.0, "bin_width": 300},
        precision="float64",
        camera={"peak_qe": [0.4, 0.5, 0.45], "dsnu": 0, "read_noise": 12, "dark_current_density": 0, "bits": 14},
        **more,
    )


@pytest.mark.parametrize("ev_bias", [-4.0, -1.0, 1.5], ids=["dark", "middle", "longest is cut off"])
def test_an_hdr_merge_leaves_the_noise_that_theory_allows(ev_bias):
    """1 / sum(1 / v) over the frames that are not cut off, v from shot noise, read noise and rounding at the true
    signal.

    80,000 green sites: the deviation is known to 0.25 %.
    """
    document = flat(
        0.5, wanted=["merge_frames.rgb_camera", "merged_variance", "expected_charge", "bracket.integration_time"]
    )
    document["stages"][4] |= {"ev_bias": ev_bias}
    tree = etendue.simulate(document)
    well = 1000 * (4.0 * 0.741) ** 2
    charge = tree["exposure"].expected_charge.values[:, 0, 1]  # of green
    times = tree["bracket"].integration_time.values
    gain = (2**14 - 1 - 64) / well
    assert (charge.max() > 0.97 * well) == (ev_bias > 0)
    used = charge < 0.95 * well
    scale = times.min() / times[used] / well
    theory = 1 / np.sum(1 / (scale**2 * (charge[used] + 12**2 + 1 / (12 * gain**2))))
    green = tree["merge_frames"].rgb_camera.values[1]
    sites = np.concatenate([green[0::2, 1::2].ravel(), green[1::2, 0::2].ravel()])
    white_gain = float(np.mean(sites)) * well / (charge.min())  # of the white balance
    assert sites.std() == pytest.approx(white_gain * math.sqrt(theory), rel=0.01)
    assert math.sqrt(tree["merge_frames"].merged_variance.values[1].mean()) == pytest.approx(
        white_gain * math.sqrt(theory), rel=0.01
    )


def test_a_mean_of_equal_frames_has_one_over_root_n_of_the_noise():
    document = flat(0.5, repeats=8, brackets=[0], wanted=["merge_frames.rgb_camera", "demosaic.rgb_camera"])
    document["stages"][-1] |= {"method": "mean"}
    tree = etendue.simulate(document)
    one, eight = (tree[s].rgb_camera.values[..., 1, 0::2, 1::2].std() for s in ("demosaic", "merge_frames"))
    assert eight == pytest.approx(one / math.sqrt(8), rel=0.015)  # 40,000 sites: 0.35 % each


def test_a_clipped_mean_leaves_out_what_only_one_frame_saw():
    frames = np.full((9, 1, 16, 16), 0.4) + 1e-3 * np.random.default_rng(2).standard_normal((9, 1, 16, 16))
    frames[3, 0, 5, 5] = 0.9  # a cosmic ray
    given = (np.ones(9), np.ones(9), ([0.0], [1e-6]))
    plain, clipped = (merging.merged(frames, *given, method, 4.0, 0)[0] for method in ("mean", "sigma_clipped"))
    assert plain[0, 5, 5] > 0.45
    assert clipped[0, 5, 5] == pytest.approx(0.4, abs=2e-3)
    rest = np.ones((16, 16), bool)
    rest[5, 5] = False
    assert_allclose(clipped[0][rest], plain[0][rest], atol=1e-3)


def test_where_all_frames_are_cut_off_the_shortest_is_shown():
    frames = np.full((2, 3, 8, 8), 1.0)
    rate, variance = merging.merged(frames, np.array([1.0, 4.0]), np.ones(2), (np.ones(3), np.ones(3)), "hdr", 3.0, 2)
    assert_array_equal(rate, 1.0)
    assert np.isfinite(variance).all()


def test_a_demosaicer_of_planes_is_refused_by_name():
    document = burst("exposure", *NOISE, "demosaic_bilinear", {"use": "demosaic_nearest", "name": "again"})
    document["stages"][-1]["from"] = {"mosaic_linear": "demosaic_bilinear"}
    with pytest.raises(RequestError, match="mosaic_linear"):
        etendue.simulate(document)


def test_figures_behind_a_bracket_are_those_of_each_frame():
    tree = etendue.simulate(burst("exposure", *NOISE, "exposure_report", "dynamic_range", brackets=[0, 3]))
    assert tree["exposure_report"].clipped_fraction.dims == ("frame",)
    assert tree["exposure_report"].clipped_fraction.values[1] > tree["exposure_report"].clipped_fraction.values[0]
    assert_allclose(
        tree["dynamic_range"].dark_charge.values[1], 8 * tree["dynamic_range"].dark_charge.values[0], rtol=1e-6
    )


def test_schedulers_resuming_and_sweeping_change_no_bit_of_a_metered_bracket(tmp_path):
    document = burst(*CHAIN, sweep={"meter.ev_bias": [0, 1]}, side=32)
    serial = every_array(etendue.simulate(document, scheduler="serial"))
    for scheduler in ("threads", "processes"):
        assert every_array(etendue.simulate(document, scheduler=scheduler, workers=2)) == serial
    folder = tmp_path / "archive"
    etendue.simulate({**document, "keep": ["adc.raw", "meter.integration_time"]}, archive=folder)
    resumed = every_array(etendue.simulate(document, archive=folder))
    assert {path: resumed[path] for path in serial} == serial
    alone = etendue.simulate({**document, "sweep": {"meter.ev_bias": [1]}})
    whole = etendue.simulate(document)
    for stage, variable in (("adc", "raw"), ("encode", "rgb_display")):
        assert_array_equal(alone[stage][variable].values[0], whole[stage][variable].values[1])


def every_array(tree):
    """The bytes of every variable of every stage."""
    found = {}
    for node in tree.subtree:
        if node.path.strip("/").split("/")[0] not in ("", "ledger", "summary", "frames"):
            found |= {
                f"{node.path}/{name}": array.values.tobytes()
                for name, array in node.to_dataset(inherit=False).data_vars.items()
            }
    return found

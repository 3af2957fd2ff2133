"""What a scene does not need is left out, exactly or within the tolerance; what may be coarser is coarser."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import etendue
from etendue.contract.arrays.facts import Content, Facts
from etendue.contract.arrays.grid import Bands, Grid, Line
from etendue.contract.stage import parameters_of
from etendue.plan.expansion.leave_out import LeaveOutRule, decide
from etendue.plan.planner import summary
from etendue.session import Options, collect
from etendue_camera.electronics.stages.exposure import ShotNoise
from etendue_camera.electronics.stages.read_out import ReadNoise
from etendue_camera.optics.stages.gathering import OpticalFilter
from tests.plan.given import CAMERA, SCENE, SENSOR, chain, keys_of, plan_of

NO_FALLOFF = SENSOR.replace('[[stages]]\nuse = "falloff"\n', "")
BLURS = ("diffraction", "lens_gaussian", "diffusion")
FLOAT32 = 2e-6  # what the pixel stage declares of its float32 transform, the largest of those compared here


def optics(scene="slanted_edge", stages=SENSOR, tail=""):
    """Scene, lens and sensor."""
    return CAMERA + SCENE.format(scene=scene) + stages + tail


def left_out(plan):
    """Bound of every cell that is left out, by stage."""
    bounds = {node.name: [cell.left_out.bound for cell in plan.of(node.name) if cell.left_out] for node in plan.nodes}
    return {name: found for name, found in bounds.items() if found}


def values(tree, stage, variable):
    """One variable of a stage, wherever its shape group is."""
    (found,) = [node[variable].values for node in tree[stage].subtree if variable in node.data_vars]
    return found


# -- exactly ----------------------------------------------------------------------------------------------


def test_a_uniform_scene_needs_no_blur():
    assert left_out(plan_of(optics("uniform", NO_FALLOFF), {"tolerance": 0})) == {name: [0.0] for name in BLURS}


def test_light_that_falls_off_is_no_longer_uniform():
    """With tolerance 0 the fall-off must be computed, and then the blurs act on what it makes."""
    assert left_out(plan_of(optics("uniform"), {"tolerance": 0})) == {}


def test_a_scene_with_an_edge_needs_every_blur_but_one_of_no_width():
    assert left_out(plan_of(optics(), {"tolerance": 0})) == {}
    assert left_out(plan_of(optics(), {"tolerance": 0, "lens_gaussian.sigma": 0})) == {"lens_gaussian": [0.0]}


def test_a_stage_that_does_nothing_with_its_parameters_is_left_out():
    assert left_out(plan_of(chain(), {"tolerance": 0, "sharpen.strength": 0})) == {"sharpen": [0.0]}
    assert left_out(plan_of(chain(), {"tolerance": 0, "sharpen.strength": 1e-9})) == {}


def test_leaving_out_a_blur_of_a_uniform_scene_changes_nothing_but_rounding():
    text = optics("uniform", NO_FALLOFF)
    trees = [
        etendue.simulate(text, scheduler="serial", want=["photon_rate"], leave_out=allowed) for allowed in (True, False)
    ]
    one, other = (values(tree, "pixel", "photon_rate") for tree in trees)
    assert np.abs(one - other).max() <= FLOAT32 * np.abs(other).max()


def test_nothing_is_left_out_where_that_is_asked_for():
    for text in (optics("uniform", NO_FALLOFF), chain(sweep='"sharpen.strength" = [0, 0.1]')):
        assert left_out(plan_of(text, {"tolerance": 0.5})) != {}
        assert left_out(plan_of(text, {"tolerance": 0.5}, leave_out=False)) == {}


# -- within the tolerance ---------------------------------------------------------------------------------


def corner_loss(width_um, focal_mm):
    """1 - cos^4 at the corner of a square frame whose outermost samples lie half a sample inside it."""
    corner = math.hypot(1, 1) * 0.5 * (width_um - 1)
    return 1 - math.cos(math.atan(corner / (1e3 * focal_mm))) ** 4


@settings(max_examples=30, deadline=None)
@given(exponent=st.floats(-7, -0.5), width=st.sampled_from([48, 64, 120, 200]), focal=st.floats(2, 50))
def test_a_small_field_needs_no_fall_off_where_the_light_it_takes_is_within_the_tolerance(exponent, width, focal):
    """It is a share of every value, the same in both norms: of the value with it, as that is the reference."""
    tolerance = 10**exponent
    setting = {"scene.width": width, "scene.height": width, "camera.focal_length": focal, "tolerance": tolerance}
    loss = corner_loss(width, focal)
    bound = loss / (1 - loss)
    for norm in ("max", "rms"):
        if math.isclose(bound, tolerance, rel_tol=1e-9):
            continue
        plan = plan_of(optics(), {**setting, "norm": norm})
        assert left_out(plan).get("falloff", []) == ([pytest.approx(bound, rel=1e-9)] if bound < tolerance else [])


@settings(max_examples=30, deadline=None)
@given(
    exponent=st.floats(-6, -0.01),
    scene=st.sampled_from(["uniform", "slanted_edge", "composite"]),
    norm=st.sampled_from(["rms", "max"]),
)
def test_no_omission_and_no_coarser_setting_adds_more_than_the_tolerance(exponent, scene, norm):
    tolerance = 10**exponent
    plan = plan_of(optics(scene), {"tolerance": tolerance, "norm": norm})
    for cell in plan.cells.values():
        assert cell.left_out is None or cell.left_out.bound <= tolerance
        assert all(one.bound <= tolerance for one in cell.approximated)


def test_a_wider_tolerance_leaves_out_no_less():
    found = [set(left_out(plan_of(optics(), {"tolerance": t}))) for t in (0, 1e-6, 1e-4, 1e-2, 0.5)]
    assert all(a <= b for a, b in pairwise(found))
    assert found[0] != found[-1]


def test_a_wider_tolerance_takes_no_finer_setting():
    """Of every knob, its place on the ladder from the cheapest setting to the reference."""
    places = []
    for tolerance in (1e-6, 1e-4, 1e-3, 1e-2, 0.1):
        plan = plan_of(optics("composite"), {"tolerance": tolerance})
        found = {}
        for cell in (cell for cell in plan.cells.values() if not cell.left_out):
            for name, (parameter, _, _) in parameters_of(type(cell.stage)).items():
                if parameter.settings and getattr(cell.stage, name) in parameter.settings:
                    found[cell.node, name] = parameter.settings.index(getattr(cell.stage, name))
        places.append(found)
    for strict, loose in pairwise(places):
        finer = {
            knob: (strict[knob], loose[knob]) for knob in loose.keys() & strict.keys() if loose[knob] > strict[knob]
        }
        assert not finer
    assert places[0] != places[-1]


def test_what_the_file_writes_is_no_plans_to_choose():
    plan = plan_of(optics(), {"tolerance": 0.1, "pixel.kept_frequencies": 1, "diffusion.nodes": 777})
    assert plan.of("pixel")[0].stage.kept_frequencies == 1
    assert "kept_frequencies" not in {one.knob for one in plan.of("pixel")[0].approximated}
    swept = plan_of(chain(sweep='"pixel.kept_frequencies" = [0.5, 1]'), {"tolerance": 0.1})
    assert [cell.stage.kept_frequencies for cell in swept.of("pixel")] == [0.5, 1]


@pytest.mark.parametrize(
    "setting", [{}, {"scene.use": "composite"}, {"camera.f_number": 16}, {"lens_gaussian.sigma": 5}]
)
@pytest.mark.parametrize("tolerance", [0.3, 0.03, 3e-3])
def test_light_and_pixels_differ_by_no_more_than_the_stated_bounds(setting, tolerance):
    """Behind every stage rms of full scale, by its own bound and those in front of it; a blur lets no error grow."""
    text = optics()
    exact = plan_of(text, {**setting, "precision": "float64"}, leave_out=False)
    plan = plan_of(text, {**setting, "precision": "float64", "tolerance": tolerance, "camera.focal_length": "2 mm"})
    exact = plan_of(text, {**setting, "precision": "float64", "camera.focal_length": "2 mm"}, leave_out=False)
    names = [
        ("falloff", "irradiance"),
        ("diffraction", "irradiance"),
        ("lens_gaussian", "irradiance"),
        ("diffusion", "irradiance"),
        ("pixel", "photon_rate"),
    ]
    one, other = (collect(p, {(name, ()): [v] for name, v in names}, Options("serial")).arrays for p in (plan, exact))
    bound = 0.0
    for name, variable in names:
        bound += plan.of(name)[0].bound
        with_it, without = other[name, ()][variable], one[name, ()][variable]
        axes = (1, 2) if variable == "photon_rate" else None
        rms = np.sqrt(((with_it - without) ** 2).mean(axis=axes)) / with_it.max(axis=axes)
        assert (
            np.max(rms) <= 1.2 * bound + 1e-14
        )  # the brightest light behind a blur is a little less bright than in front of it


# -- cell by cell -----------------------------------------------------------------------------------------


def test_the_decision_for_a_cell_does_not_depend_on_what_else_is_swept():
    sweep = (
        'focal_length = [1, 5, 50]\n"lens_gaussian.sigma" = [0, 1]\n"sharpen.strength" = [0, '
        "0.2]\nintegration_time = [0.1, 0.2]"
    )
    swept = plan_of(chain(sweep=sweep), {"tolerance": 5e-4})
    assert any(c.left_out for c in swept.of("falloff"))
    assert not all(c.left_out for c in swept.of("falloff"))
    keys = {axis.dim: axis.key if "." in axis.key else f"camera.{axis.key}" for axis in swept.axes}
    for cell in swept.cells.values():
        setting = {keys[dim]: value for dim, value in swept.labels(cell.ref).items()}
        alone = plan_of(chain(), {"tolerance": 5e-4} | setting).of(cell.node)[0]
        assert (alone.left_out, alone.approximated, alone.key) == (cell.left_out, cell.approximated, cell.key)


def test_only_the_cells_that_do_not_need_a_stage_go_without_it():
    plan = plan_of(chain(sweep='"sharpen.strength" = [0, 0.1, 0.2]'))
    assert [bool(cell.left_out) for cell in plan.of("sharpen")] == [True, False, False]
    stage = next(s for s in summary(plan)["stages"] if s["name"] == "sharpen")
    assert stage["left_out"]["cells"] == 1
    assert stage["left_out"]["of"] == 3
    assert stage["left_out"]["bound"] == 0
    assert "strength is 0" in stage["left_out"]["why"]


def test_what_is_left_out_is_the_same_light_under_another_name():
    plan = plan_of(optics("uniform", NO_FALLOFF), {"tolerance": 0})
    keys = keys_of(plan)
    assert keys["diffraction"] == keys["lens_gaussian"] == keys["diffusion"] == keys["irradiance"]


def test_a_stage_that_changes_the_grid_is_never_left_out():
    """Reads and writes must be the same variable on the same grid; a pixel that sees uniform light still is a pixel."""
    plan = plan_of(optics("uniform", NO_FALLOFF), {"tolerance": 0.9})
    assert not {"pixel", "mosaic", "exposure", "adc", "linearise"} & set(left_out(plan))


# -- what bounds hold ---------------------------------------------------------------------------------------


@settings(max_examples=30)
@given(low=st.floats(0, 1), high=st.floats(0.01, 4), smooth=st.booleans())
def test_a_factor_puts_no_more_detail_into_even_light_than_is_stated(low, high, smooth):
    """Most detail has the factor that is its lowest value in one half of the frame and its highest in the other."""
    low *= high
    none = ((0.0, 0.0, 0.0),)
    even = Content(2.0, (0.0, 0.1, 0.2, 0.5), none, none, (1.0,), (1.0,), (1.0,))
    light = Facts(uniform=True, low=2.0, high=2.0, contrast=1.0, content=even).scaled(low, high, smooth)
    assert light.content.full * light.content.detail >= 2.0 * 0.5 * (high - low) * (1 - 1e-12)
    assert (light.low, light.high) == (2 * low, 2 * high)
    assert low == 0 or light.contrast >= light.high / light.low * (1 - 1e-12)


@pytest.mark.parametrize("most", [200.0, 1e4])
def test_the_share_of_a_noise_is_that_of_the_pixel_in_which_it_is_largest(most):
    """Read noise counts most in the darkest pixel, however bright the others are."""
    read, shot = ReadNoise(read_noise=1.0, read_noise_after=0.0, dsnu=0.0), ShotNoise()
    facts, grids = {"charge": Facts(low=100.0, high=most)}, {"charge": Grid.of({"y": Line(8), "x": Line(8)})}
    found = decide(LeaveOutRule(0.05), read, facts, grids, grids, lambda: [shot, read])
    assert found.bound == pytest.approx(1 / 101, rel=1e-12)
    assert decide(LeaveOutRule(0.009), read, facts, grids, grids, lambda: [shot, read]) is None


def test_a_blur_that_is_left_out_is_no_part_of_the_error_of_the_light_behind_it():
    """What its contrast would spare the sum over wavelengths is not spared."""
    setting = {"tolerance": 3e-2, "precision": "float64", "lens_gaussian.sigma": "0.1 um"}
    without = optics("composite", SENSOR.replace('[[stages]]\nuse = "lens_gaussian"\n', ""))
    plan = plan_of(optics("composite"), setting)
    assert "lens_gaussian" in left_out(plan)
    del setting["lens_gaussian.sigma"]
    assert plan.of("pixel")[0].error == plan_of(without, setting).of("pixel")[0].error


def test_a_filter_states_what_it_takes_from_any_band_whatever_light_the_scene_has():
    """A red point on black loses all its light, and white does beside a scene without red."""
    none, edges = ((0.0, 0.0),) * 2, (0.0, 0.1, 0.5)
    point = Content(1.0, edges, none, none, (0.0, 0.0), (0.5, 0.001), (1.0, 1.0))
    grid = Grid.of({"wavelength": Bands((500.0, 600.0, 800.0)), "y": Line(8), "x": Line(8)})
    short_pass = OpticalFilter(cut_off=650.0)
    for own in (point, Content(1.0, edges, none, none, (0.0, 0.0), (0.5, 0.0), (1.0, 0.0))):
        assert short_pass.negligible(Facts(content=own), grid)[0] == 1 - short_pass.transmission(grid)[1] > 0.9


@pytest.mark.parametrize(("low", "high"), [(0.12345, 0.98765), (0.0777, 0.5001)])
def test_no_sample_of_a_scene_lies_beyond_what_is_stated_of_its_light_relative_to_the_largest(low, high):
    text = optics()
    content = plan_of(text, {"scene.low": low, "scene.high": high}).of("scene")[0].facts.content
    drawn = {"scene__low": low, "scene__high": high, "precision": "float64"}
    light = values(etendue.simulate(text, want=["radiance"], scheduler="serial", **drawn), "scene", "radiance")
    for band, plane in enumerate(light / light.max()):
        assert content.low[band] <= plane.min() and plane.max() <= content.high[band] * (1 + 1e-12)

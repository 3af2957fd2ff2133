"""What a scene does not need is left out: exactly, or within bounds that add up to the tolerance."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import etendue
from etendue.plan import leave_out
from etendue.plan.planner import summary
from tests.plan.given import CAMERA, SCENE, SENSOR, chain, keys_of, plan_of

NO_FALLOFF = SENSOR.replace('[[stages]]\nuse = "falloff"\n', "")
BLURS = ("diffraction", "lens_gaussian", "diffusion")
FLOAT32 = 2e-6  # what the pixel stage declares of its float32 transform, the largest of those compared here


def optics(scene="slanted_edge", stages=SENSOR, tail=""):
    """Scene, lens and sensor, without the reconstruction whose gain leaves no room for approximation."""
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
    trees = [etendue.simulate(text, scheduler="serial", want=["photon_rate"], leave_out=allowed) for allowed in (True, False)]
    one, other = (values(tree, "pixel", "photon_rate") for tree in trees)
    assert np.abs(one - other).max() <= FLOAT32 * np.abs(other).max()


def test_nothing_is_left_out_where_that_is_asked_for():
    for text in (optics("uniform", NO_FALLOFF), chain(sweep='"sharpen.strength" = [0, 0.1]')):
        assert left_out(plan_of(text, {"tolerance": 0.5})) != {}
        assert left_out(plan_of(text, {"tolerance": 0.5}, leave_out=False)) == {}


# -- within the tolerance ---------------------------------------------------------------------------------


def falloff_bound(width_um, focal_mm):
    """1 - cos^4 at the corner of a square frame whose outermost samples lie half a sample inside it."""
    corner = math.hypot(1, 1) * 0.5 * (width_um - 1)
    return 1 - math.cos(math.atan(corner / (1e3 * focal_mm))) ** 4


@settings(max_examples=40, deadline=None)
@given(exponent=st.floats(-7, -0.5), width=st.integers(45, 200), focal=st.floats(2, 50))
def test_a_small_field_needs_no_fall_off_only_where_the_tolerance_allows(exponent, width, focal):
    tolerance = 10**exponent
    setting = {"scene.width": width, "scene.height": width, "camera.focal_length": focal, "tolerance": tolerance}
    plan = plan_of(optics(), setting)
    bound, share = falloff_bound(width, focal), leave_out.shares(plan.nodes, tolerance)["falloff"]
    if math.isclose(bound, share, rel_tol=1e-9):
        return
    expected = {"falloff": [pytest.approx(bound, rel=1e-9)]} if bound < share else {}
    assert {name: bounds for name, bounds in left_out(plan).items() if name == "falloff"} == expected


@settings(max_examples=40, deadline=None)
@given(
    exponent=st.floats(-6, -0.01), scene=st.sampled_from(["uniform", "slanted_edge", "composite"]), copies=st.integers(0, 4),
    whole=st.booleans(),
)  # fmt: skip
def test_bounds_never_add_up_to_more_than_the_tolerance(exponent, scene, copies, whole):
    """However many stages compete for it, and whatever gains stand between them and the end of the claim."""
    tolerance = 10**exponent
    more = "".join(f'[[stages]]\nuse = "falloff"\nname = "falloff_{i}"\n' for i in range(copies))
    text = (chain(scene) if whole else optics(scene)).replace('[[stages]]\nuse = "diffraction"', more + '[[stages]]\nuse = "diffraction"')
    plan = plan_of(text, {"tolerance": tolerance})
    for cell in plan.cells.values():
        assert cell.bound is None or cell.bound <= tolerance * (1 + 1e-12)
    gains = leave_out.downstream_gain(plan.nodes)
    assert sum(c.left_out.bound * gains[c.node] for c in plan.cells.values() if c.left_out) <= tolerance * (1 + 1e-12)


def test_a_wider_tolerance_leaves_out_no_less():
    found = [set(left_out(plan_of(optics(), {"tolerance": t}))) for t in (0, 1e-6, 1e-4, 1e-2, 0.5)]
    assert all(a <= b for a, b in pairwise(found))
    assert found[0] != found[-1]


@pytest.mark.parametrize("focal", [2.0, 10.0, 30.0])
def test_results_differ_by_no_more_than_the_stated_bound(focal):
    """Of full scale: where the fall-off is left out, and behind the pixel, to which the declared gains carry it."""
    setting = f'precision = "float64"\ntolerance = 0.9\nwanted = ["photon_rate"]\n[camera]\nfocal_length = {focal}\n'
    text = setting + optics().replace("[camera]\n", "")
    plan = plan_of(text)
    assert list(left_out(plan)) == ["falloff"]
    one, other = (etendue.simulate(text, scheduler="serial", leave_out=allowed) for allowed in (True, False))
    for name, variable in (("falloff", "irradiance"), ("pixel", "photon_rate")):
        bound = plan.of(name)[0].bound
        with_it, without = values(other, name, variable), values(one, name, variable)
        assert 0 < np.abs(with_it - without).max() <= (bound + 1e-15) * np.abs(without).max()  # and the rounding of float64
    # the bound is that of the corner and relative to the light there, so it is nearly reached where it is stated
    at_falloff = np.abs(values(one, "falloff", "irradiance") / values(other, "falloff", "irradiance") - 1).max()
    assert at_falloff == pytest.approx(left_out(plan)["falloff"][0], rel=0.05)


# -- cell by cell -----------------------------------------------------------------------------------------


def test_the_decision_for_a_cell_does_not_depend_on_what_else_is_swept():
    sweep = 'focal_length = [1, 5, 50]\n"lens_gaussian.sigma" = [0, 1]\n"sharpen.strength" = [0, 0.2]\nintegration_time = [0.1, 0.2]'
    swept = plan_of(chain(sweep=sweep), {"tolerance": 0.05})
    assert any(c.left_out for c in swept.of("falloff"))
    assert not all(c.left_out for c in swept.of("falloff"))
    keys = {axis.dim: axis.key if "." in axis.key else f"camera.{axis.key}" for axis in swept.axes}
    for cell in swept.cells.values():
        setting = {keys[dim]: value for dim, value in swept.labels(cell.ref).items()}
        alone = plan_of(chain(), {"tolerance": 0.05} | setting).of(cell.node)[0]
        assert (alone.left_out, alone.key, alone.bound) == (cell.left_out, cell.key, cell.bound)


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


def test_the_claim_ends_where_a_gain_is_not_known_and_the_plan_says_where():
    plan = plan_of(optics(), {"tolerance": 0.5})
    stage = next(s for s in summary(plan)["stages"] if s["name"] == "falloff")
    names = [node.name for node in plan.nodes]
    end = names.index(stage["left_out"]["claim_ends_at"])
    assert plan.nodes[end].kind.gain is None
    behind = names[names.index("falloff") :]
    assert [plan.of(name)[0].bound is None for name in behind] == [names.index(name) >= end for name in behind]


def test_a_stage_that_changes_the_grid_is_never_left_out():
    """Reads and writes must be the same variable on the same grid; a pixel that sees uniform light still is a pixel."""
    plan = plan_of(optics("uniform", NO_FALLOFF), {"tolerance": 0.9})
    assert not {"pixel", "mosaic", "exposure", "adc", "linearise"} & set(left_out(plan))

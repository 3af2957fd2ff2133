"""Of every knob that is open the cheapest setting within the tolerance, and the best there is where none is."""

from hypothesis import given
from hypothesis import strategies as st

from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of
from etendue.plan.cost import knobs_cost
from etendue.plan.expansion.approximate import choose
from etendue.plan.planner import summary
from tests.plan.given import CAMERA, SCENE, SENSOR, plan_of

RESOLUTION = installed_stages().load("resolution")
KNOBS = ("solved", "point_nodes", "nodes")
FINEST = RESOLUTION(solved=True, point_nodes=320, nodes=4096)


def stated(stage):
    return stage.error(None, None, "float64")


@given(exponent=st.floats(-9, 0), open_knobs=st.sets(st.sampled_from(KNOBS)))
def test_a_stage_stays_within_the_tolerance_or_as_near_to_its_best_as_a_tenth_of_it(exponent, open_knobs):
    """With 4e-6 as the least that can be stated: below that the settings are the finest, as far as they are open."""
    tolerance, knobs = 10**exponent, tuple(knob for knob in KNOBS if knob in open_knobs)
    chosen, told = choose(RESOLUTION(), knobs, tolerance, stated)
    best = RESOLUTION(**{knob: getattr(FINEST, knob) for knob in knobs})
    assert not knobs or stated(chosen)[0] <= max(tolerance, stated(best)[0] + 0.1 * tolerance)
    assert all(one.bound > 0 for one in told)
    assert all(getattr(chosen, knob) == getattr(RESOLUTION(), knob) for knob in KNOBS if knob not in knobs)


def test_a_stage_of_which_nothing_finer_is_to_be_had_is_not_made_dearer_in_vain():
    lens = installed_stages().load("aberrations")()
    assert (
        choose(
            lens, ("heights", "bands", "pupil_samples", "accuracy"), 1e-6, lambda stage: (stage.accuracy, "measured")
        )[0]
        == lens
    )


def test_a_setting_that_changes_nothing_is_not_told_as_coarser():
    plan = plan_of(CAMERA + SCENE.format(scene="composite") + SENSOR, {"tolerance": 1e-2, "scene.bin_width": "300 nm"})
    (pixel,) = plan.of("pixel")
    assert "wavelength_terms" not in {one.knob for one in pixel.approximated}


def test_what_a_coarser_setting_saves_is_told_where_its_knob_says_what_it_costs():
    text = CAMERA + SCENE.format(scene="composite") + SENSOR
    by_knob = {
        a["knob"]: a for s in summary(plan_of(text, {"tolerance": 1e-2}))["stages"] for a in s["approximated"] or []
    }
    assert by_knob["kept_frequencies"]["seconds_saved"] > 0
    for stage in summary(plan_of(text, {"tolerance": 1e-2}))["stages"]:
        for one in stage["approximated"] or []:
            assert one["seconds_saved"] is None or one["seconds_saved"] >= 0


def test_no_knob_says_that_a_coarser_setting_costs_more():
    registry = installed_stages()
    for name in registry.names():
        for parameter, _, _ in parameters_of(registry.load(name)).values():
            assert list(parameter.costs) == sorted(parameter.costs), name


def test_a_cost_lies_between_settings_as_the_next_finer_one_has_it():
    default = knobs_cost(RESOLUTION())
    assert default == 1
    assert knobs_cost(RESOLUTION(nodes=700)) == knobs_cost(RESOLUTION(nodes=1024)) > default
    assert knobs_cost(RESOLUTION(nodes=10_000)) == knobs_cost(RESOLUTION(nodes=4096))
    diffusion = installed_stages().load("diffusion")
    assert knobs_cost(diffusion(nodes=9999)) == knobs_cost(diffusion(nodes=0)) > knobs_cost(diffusion(nodes=2000)) == 1

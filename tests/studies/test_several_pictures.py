"""Studies of one picture name the stage that makes several of them, whatever they are of."""

import pytest

from etendue.errors import RequestError
from etendue.pipeline.file import parse_pipeline
from etendue.plan.planner import make_plan
from etendue_lab.emva import levels as emva_levels
from etendue_lab.noise.flat_field import MOSAIC, FlatField, several
from tests.studies import alternatives
from tests.studies.test_compare import written

MADE = [("polariser", "", 4, "angle"), ("bracket", "repeats = 1\nbrackets = [-1, 0, 1]", 3, "frame")]


def plan_of(use, more):
    return make_plan(parse_pipeline(written(wandering=f'[[stages]]\nuse = "{use}"\n{more}')), alternatives.registry())


@pytest.mark.parametrize(("use", "more", "many", "dim"), MADE)
def test_who_makes_several_pictures_is_named_with_their_number_and_dim(use, more, many, dim):
    plan = plan_of(use, more)
    node = plan.node("linearise")
    assert several(plan, node, MOSAIC).startswith(f"{use} makes {many} of linearise.mosaic_linear, along '{dim}'")
    assert several(plan, node, MOSAIC, {dim}) == ""
    with pytest.raises(RequestError, match=f"a single picture only: {use} makes {many}"):
        FlatField(plan, node, [], [])


def test_frames_behind_a_polariser_are_no_repeats_of_an_exposure():
    """They were stacked as such, and broke off where a series of exposures stood beside them."""
    with pytest.raises(RequestError, match="may differ only in exposure: polariser makes 4 of adc.raw"):
        emva_levels.of_plan(plan_of("polariser", ""), lambda ref: pytest.fail("read"))

"""A pipeline made of a pipeline: what is changed is changed, and nothing else; the one that is given stays."""

import pytest

from etendue.pipeline.derived import (
    at_value,
    each,
    free_name,
    given,
    stage_in_front,
    wanting,
    with_values,
    without_stages,
)
from etendue.pipeline.file import StageEntry, parse_pipeline

TEXT = """
name = "chain"
wanted = ["c.x"]
[shared]
gain = 2
[[stages]]
use = "source"
name = "a"
level = 1
[[stages]]
use = "filter"
name = "b"
from = { x = "a" }
[[stages]]
use = "filter"
name = "c"
from = { x = "b", y = "a" }
strength = 0.5
width = 3
"""


@pytest.fixture
def chain():
    return parse_pipeline(TEXT)


def stages(pipeline):
    return {one.name: (one.use, dict(one.values), dict(one.origin)) for one in pipeline.stages}


def test_values_stand_beside_those_that_stay(chain):
    made = with_values(chain, "c", {"width": 4, "height": 1}, but={"strength"})
    assert stages(made) == {**stages(chain), "c": ("filter", {"width": 4, "height": 1}, {"x": "b", "y": "a"})}
    assert stages(chain) == stages(parse_pipeline(TEXT))


def test_who_reads_what_is_gone_reads_what_that_read(chain):
    assert stages(without_stages(chain, {"b"}))["c"][2] == {"x": "a", "y": "a"}
    assert stages(without_stages(chain, {"a", "b"})) == {"c": ("filter", {"strength": 0.5, "width": 3}, {})}
    assert without_stages(chain, set()) == chain


def test_a_stage_more_stands_in_front_of_one(chain):
    more = StageEntry(free_name("b", [one.name for one in chain.stages]), "filter", {}, {}, "")
    assert [one.name for one in stage_in_front(chain, "b", more).stages] == ["a", "b_", "b", "c"]


def test_what_is_wanted_is_stored_where_it_is_asked_for(chain):
    places = [("a", "x"), ("c", "y")]
    for kept, exact in ((False, False), (True, False), (False, True)):
        made = wanting(chain, places, kept, exact)
        assert made.wanted == ("a.x", "c.y")
        assert made.keep == (made.wanted if kept else None)
        assert made.precision == ("float64" if exact else chain.precision)
    assert (wanting(chain).wanted, wanting(chain).keep) == (None, None)


def test_a_value_of_an_axis_stands_where_a_file_says_it(chain):
    assert at_value(chain, "gain", 4).shared == {"gain": 4}
    assert stages(at_value(chain, "c.width", 9))["c"][1] == {"strength": 0.5, "width": 9}
    # a stage's own table goes with its own implementation, and not with others
    swapped = {"use": "other", "depth": 1, "label": "deep"}
    assert stages(at_value(chain, "c.use", swapped))["c"] == ("other", {"depth": 1}, {"x": "b", "y": "a"})
    same = at_value(chain, "c.use", {"use": "filter", "width": 1})
    assert stages(same)["c"][:2] == ("filter", {"strength": 0.5, "width": 1})
    assert at_value(chain, "nowhere.width", 9) == chain


def test_a_change_of_every_stage_keeps_their_order(chain):
    made = each(chain, lambda entry: given(entry, {"level": 0}))
    assert [one.values["level"] for one in made.stages] == [0, 0, 0]
    assert [one.name for one in made.stages] == ["a", "b", "c"]

"""Every knob says from which setting to which it goes, and what says so is refused where it contradicts itself."""

import math

import pytest

from etendue.api import param
from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of

REGISTRY = installed_stages()
WITHOUT_ORDER = {
    "method",
    "heights of real_lens",
}  # of choices that keep one tolerance, and of one that is another lens


def knobs():
    for name in REGISTRY.names():
        for parameter, (declared, _, default) in parameters_of(REGISTRY.load(name)).items():
            if declared.fidelity:
                yield name, parameter, declared, default


def test_every_knob_has_settings_unless_they_have_no_order():
    for stage, name, declared, _ in knobs():
        assert declared.settings or name in WITHOUT_ORDER or f"{name} of {stage}" in WITHOUT_ORDER, (stage, name)


def test_what_changes_a_grid_what_a_scene_shows_or_an_interval_is_left_to_studies():
    studied = {name for _, name, declared, _ in knobs() if declared.studied}
    assert studied == {"spacing", "bin_width", "softness", "draws"}


@pytest.mark.parametrize(
    ("default", "words"),
    [
        (2, {"settings": (1, 2)}),  # of no knob
        (2, {"studied": True}),
        (3, {"fidelity": True, "reference": "2", "settings": (1, 2)}),
        (0, {"fidelity": True, "reference": "2", "settings": (1, 2)}),
        ("c", {"fidelity": True, "reference": "b", "settings": ("a", "b")}),
        (2, {"fidelity": True, "reference": "2", "settings": (2,)}),
        (2, {"fidelity": True, "reference": "2", "settings": (1, 2, 1)}),
    ],
)
def test_settings_that_contradict_themselves_are_refused(default, words):
    with pytest.raises(TypeError, match=r"settings|studied"):
        param(default, **words)


@pytest.mark.parametrize(
    ("default", "settings"), [(2, (1, 2)), (1.5, (1, 2)), (30.0, (30.0, math.inf)), (0, (16, 64, 0)), ("a", ("b", "a"))]
)
def test_a_default_may_lie_anywhere_between_the_ends(default, settings):
    declared = param(default, fidelity=True, reference="the last", settings=settings).metadata["parameter"]
    assert declared.settings == settings

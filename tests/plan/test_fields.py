"""A sensor that sees less than half of a scene's area is told before a run; a scene without detail loses nothing."""

import math
import re

import pytest

from tests.plan.given import chain, plan_of

SIDE = 48.0  # um, of the shared scene; the sensor has 8 x 8 pixels


def notes(scene="composite", sweep="", **overrides):
    plan = plan_of(
        chain(scene=scene, sweep=sweep), overrides={f"camera.{name}": value for name, value in overrides.items()}
    )
    return [text for text in plan.warnings if "crops" in text]


@pytest.mark.parametrize("pitch", [6.0, 4.3, 4.2, 1.0])
def test_it_is_told_below_half_of_the_area(pitch):
    assert bool(notes(pixel_pitch=pitch)) == ((8 * pitch) ** 2 < 0.5 * SIDE**2)


def test_one_note_names_the_smallest_field_and_only_the_axes_that_change_it():
    (note,) = notes(sweep='f_number = [2, 4]\npixel_pitch = ["6 um", "2 um", "4 um"]')
    assert re.findall(r"([\d.]+) um x ([\d.]+) um", note) == [("16", "16"), ("48", "48")]
    assert "at pixel_pitch = 2 um (to less than half of its area in 4 of 6 cells)" in note
    assert "f_number" not in note


def test_of_light_that_is_the_same_everywhere_nothing_is_lost():
    assert not notes(scene="uniform", pixel_pitch=1.0)


def soft(**overrides):
    plan = plan_of(chain(scene="composite"), overrides={f"camera.{name}": value for name, value in overrides.items()})
    return [text for text in plan.warnings if "its rendering leaves" in text]


@pytest.mark.parametrize("pitch", [6.0, 2.0, 1.8, 1.0])
def test_a_chart_softer_than_the_pixels_is_told(pitch):
    """The chart is drawn with a Gaussian of 1 um rms: exp(-2 pi^2 s^2 f^2) at half a cycle a pixel."""
    left = math.exp(-2 * (math.pi * 0.5 / pitch) ** 2)
    found = soft(pixel_pitch=pitch)
    assert bool(found) == (left < 0.25)
    assert all(f"leaves {100 * left:.2g} %" in text for text in found)

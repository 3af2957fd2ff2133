"""What the plan says about pipelines whose stages stand in each other's way. In: small pipelines. Out: notes and
faults.
"""

import math

import pytest

import etendue
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.plan.planner import make_plan
from etendue.session import from_document


def document(*stages, **camera):
    return {
        "name": "notes",
        "camera": {"peak_qe": [0.4, 0.5, 0.3], **camera},
        "stages": [
            {
                "use": "slanted_edge",
                "name": "scene",
                "white_luminance": 100,
                "width": 60,
                "height": 40,
                "bin_width": 40,
                "spacing": 0.5,
            },
            {"use": "irradiance"},
            *({"use": s} if isinstance(s, str) else s for s in stages),
        ],
    }


def notes(*stages, **camera):
    return make_plan(from_document(document(*stages, **camera)), installed_stages()).warnings


def test_charge_that_was_to_diffuse_behind_the_filters_and_does_not_is_noted():
    lacking = notes("diffraction", "diffusion", "pixel", "mosaic", crosstalk="through_filter")
    assert any("there is no stage crosstalk after the mosaic" in text for text in lacking)
    assert not any(
        "no stage crosstalk" in text
        for text in notes("diffraction", "pixel", "mosaic", "crosstalk", crosstalk="through_filter")
    )


def test_a_stage_that_changes_what_was_read_before_it_is_told_to_move_up():
    late = notes("diffraction", "pixel", "mosaic", "exposure", "crosstalk", crosstalk="through_filter")
    told = (
        "crosstalk: nothing reads its photocurrent; exposure comes earlier and reads the photocurrent of mosaic; "
        "move crosstalk up"
    )
    assert told in late
    assert not any(
        "move" in text
        for text in notes("diffraction", "pixel", "mosaic", "crosstalk", "exposure", crosstalk="through_filter")
    )


def test_frames_that_end_in_one_picture_are_in_their_place():
    """The time of the merged picture is another quantity than that of each frame, which was read before."""
    bursts = "bracket exposure shot_noise adc linearise white demosaic_bilinear merge_frames".split()
    bursts += ["colour_fit", "camera_to_xyz"]
    assert not any("move" in text for text in notes("diffraction", "pixel", "mosaic", *bursts))


def test_diffraction_that_counts_twice_and_coma_on_the_axis_are_noted():
    twice = notes("diffraction", {"use": "wavefront", "coma": 0.2}, "pixel")
    assert any("counts twice" in text for text in twice)
    assert any("coma are zero on axis" in text for text in twice)
    assert not any("zero on axis" in text for text in notes({"use": "wavefront", "coma": 0.2, "field_y": 2.0}, "pixel"))


def test_a_wavefront_too_steep_to_be_sampled_is_a_fault_of_the_file():
    with pytest.raises(RequestError, match="slope of the wavefront"):
        notes({"use": "wavefront", "defocus": 2.0}, "pixel", f_number=2)


def test_a_grey_card_beyond_saturation_has_no_ratio():
    figures = etendue.simulate(
        {**document("exposure_numbers", integration_time=1e3), "wanted": ["snr_18", "snr10_illuminance"]}
    )
    numbers = figures["exposure_numbers"]
    assert math.isnan(numbers.snr_18)
    assert numbers.snr10_illuminance > 0  # less light, and the ratio is 10
    coarse = etendue.simulate(
        {**document("exposure_numbers", analogue_gain=4096), "wanted": ["snr_18", "snr10_illuminance"]}
    )
    assert math.isnan(coarse["exposure_numbers"].snr10_illuminance)  # four electrons reach the top code

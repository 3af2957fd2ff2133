"""A stage put in the place of another by an override: what both take is kept, the rest is left out with a note."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from etendue.cli import main
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.pipeline.file import parse_pipeline
from etendue.plan.planner import make_plan
from etendue.plan.resume import with_stored_values
from tests.plan.given import chain, plan_of

PIPELINE = Path(__file__).parents[2] / "pipelines" / "smallest.toml"


def planned(**overrides):
    return make_plan(
        parse_pipeline(PIPELINE.read_text(), folder=PIPELINE.parent, overrides=overrides), installed_stages()
    )


def test_a_stage_in_the_place_of_another_keeps_what_both_take_and_says_what_it_leaves_out():
    plan = planned(
        **{
            "scene.use": "photograph",
            "scene.file": "package:etendue_camera/data/examples/picture.png",
            "demosaic.use": "demosaic_bilinear",
        }
    )
    (scene,) = plan.of("scene")
    assert (scene.use, scene.stage.white_luminance, scene.stage.width) == ("photograph", 360, 700)
    cube = planned(
        **{
            "scene.use": "radiance_cube",
            "scene.file": "package:etendue_camera/data/examples/cube.zarr",
            "scene.spacing": "60 um",
        }
    )
    (note,) = (one for one in cube.warnings if "the stage it replaces" in one)
    assert (
        "radiance_cube has no width, height, cycles, highest_frequency, wavelength_from, wavelength_to, bin_width"
        in note
    )
    assert "have them: white_luminance" in note


def test_what_is_set_on_the_command_line_is_never_left_out_silently():
    with pytest.raises(RequestError, match="radiance_cube has no parameter 'width'"):
        planned(
            **{
                "scene.use": "radiance_cube",
                "scene.file": "package:etendue_camera/data/examples/cube.zarr",
                "scene.width": "3 um",
            }
        )


@pytest.mark.parametrize("use", ["sharpen", "denoise"])
def test_a_word_that_no_stage_ever_took_is_refused_whatever_is_swapped(use):
    text = PIPELINE.read_text().replace('use = "sharpen"', 'use = "sharpen"\nstrenght = 0.7')
    for overrides in ({}, {"sharpen.use": use}):
        with pytest.raises(RequestError, match="has no parameter 'strenght'"):
            make_plan(parse_pipeline(text, folder=PIPELINE.parent, overrides=overrides), installed_stages())


def test_what_is_lacking_is_told_with_the_words_of_the_command_line():
    with pytest.raises(RequestError, match=r"needs 'file': .*; --set scene.file=\.\.\."):
        planned(**{"scene.use": "radiance_cube"})
    (use,) = (one.use for one in planned().pipeline.stages if one.name == "demosaic")
    with pytest.raises(RequestError, match=f"the stage {use} is named 'demosaic': demosaic.use"):
        planned(**{f"{use}.use": "demosaic_bilinear"})


def test_a_swapped_stage_without_a_name_keeps_the_one_that_it_had():
    assert "sharpen" in {node.name for node in planned(**{"sharpen.use": "denoise"}).nodes}


def test_an_archive_of_a_swapped_stage_can_be_computed_again(tmp_path):
    words = ["scene.use=uniform", "pixel.rows=8", "pixel.columns=8", 'wanted=["irradiance"]']
    asked = [
        "run",
        str(PIPELINE),
        "--archive",
        str(tmp_path / "a"),
        "--json",
        *(part for one in words for part in ("--set", one)),
    ]
    done = CliRunner().invoke(main, [*asked, "--sweep", "f_number=4", "--sweep", "pixel_pitch=5"])
    assert done.exit_code == 0, done.output
    again = CliRunner().invoke(main, ["reproduce", str(tmp_path / "a"), "--json"])
    assert again.exit_code == 0 and json.loads(again.stdout), again.output


def test_a_label_means_what_the_newest_sweep_that_has_it_says():
    plan = plan_of(chain(sweep='"sharpen.use" = ["sharpen"]'))
    (axis,) = plan.axes
    sweeps = [{"sharpen.use": [{"use": "sharpen", "label": "more", "strength": one}]} for one in (0.5, 0.9)]
    whole = with_stored_values(plan, {"sharpen": {axis.dim: ["sharpen", "more"]}}, [{}, *sweeps])
    own = plan.of("sharpen")[0].stage.strength
    assert [cell.stage.strength for cell in whole.of("sharpen")] == [own, 0.5]

"""Sensors by name: every value has a source, fits its quantity, and yields to what a pipeline says itself."""

import json
import re
from pathlib import Path

import pytest

from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of
from etendue.contract.values import quantities as camera
from etendue.contract.values.units import to_unit
from etendue.errors import RequestError
from etendue.pipeline.file import parse_pipeline, read_pipeline
from etendue.pipeline.presets import SPOKEN, preset, preset_names
from etendue.plan.planner import make_plan
from etendue.plan.wiring.parameters import resolve
from etendue_camera import spectra
from tests.fresh import process

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "pipelines" / "sensors.toml").read_text()
DECLARED = {
    name: (parameter, kind)
    for stage in installed_stages().names()
    for name, (parameter, kind, _) in parameters_of(installed_stages().load(stage)).items()
    if parameter.shared
}


def value_of(sensor, name):
    return resolve(preset(sensor).shared[name].value, *DECLARED[name], Path("."))


def plan_of(text=TEXT, **overrides):
    return make_plan(
        parse_pipeline(text, overrides={f"camera.{k}": v for k, v in overrides.items()}), installed_stages()
    )


@pytest.mark.parametrize("sensor", preset_names())
def test_every_value_is_one_of_its_quantity_and_says_where_it_is_from(sensor):
    found = preset(sensor)
    assert found.title and found.kind and found.description
    for name in found.shared:
        assert name in camera.names(), name
        value_of(sensor, name)  # in range and of the right unit
    for name, sourced in {**found.shared, **found.facts}.items():
        assert re.match(r"https?://\S+$", sourced.source) or sourced.source.startswith(SPOKEN), (
            f"{name}: {sourced.source}"
        )


@pytest.mark.parametrize("sensor", preset_names())
def test_the_full_well_that_is_published_is_the_one_that_comes_out(sensor):
    found = preset(sensor)
    if "full_well" not in found.facts:
        assert found.kind == "paper"
        return
    area = (value_of(sensor, "pixel_pitch") * value_of(sensor, "aperture_fraction")) ** 2
    published = float(to_unit(found.facts["full_well"].value, "electron"))
    assert value_of(sensor, "full_well_density") * area == pytest.approx(
        published, rel=1e-3
    )  # as many digits as the file has


@pytest.mark.parametrize("sensor", preset_names())
def test_a_published_gain_brings_the_published_full_well_near_the_top_code(sensor):
    if "conversion_gain" in preset(sensor).shared:
        area = (value_of(sensor, "pixel_pitch") * value_of(sensor, "aperture_fraction")) ** 2
        codes = value_of(sensor, "full_well_density") * area * value_of(sensor, "conversion_gain")
        top = 2 ** value_of(sensor, "bits") - 1 - value_of(sensor, "black_level")
        assert codes == pytest.approx(top, rel=0.06)  # two sources disagree by 5 % on the IMX250


@pytest.mark.parametrize("sensor", ["sony-imx174", "sony-imx250"])
def test_the_published_dynamic_range_is_that_of_the_published_well_and_noise(sensor):
    from math import log10

    found = preset(sensor)
    well = float(to_unit(found.facts["full_well"].value, "electron"))
    published = float(found.facts["dynamic_range"].value.removesuffix(" dB"))
    assert 20 * log10(well / value_of(sensor, "read_noise")) == pytest.approx(published, abs=2)  # cameras of two makers


@pytest.mark.parametrize("sensor", preset_names())
def test_a_range_that_is_not_that_of_the_values_and_a_guess_that_lowers_it_say_by_how_much(sensor):
    """By more than 1 dB. Dark charge aside; the guess is a fixed pattern, which counts as noise in ``dr_elgamal``."""
    from math import hypot, log10

    found, noise, dsnu = preset(sensor), value_of(sensor, "read_noise"), value_of(sensor, "dsnu")
    well = (
        value_of(sensor, "full_well_density")
        * (value_of(sensor, "pixel_pitch") * value_of(sensor, "aperture_fraction")) ** 2
    )
    own, lowered = (20 * log10(well / floor) for floor in (noise, hypot(noise, dsnu)))
    published = found.facts.get("dynamic_range")
    if published is not None and abs(float(published.value.removesuffix(" dB")) - own) > 1:
        assert f"{own:.1f} dB" in published.note
    if found.shared["dsnu"].source == "typical" and own - lowered > 1:
        assert f"{lowered:.1f} dB" in found.shared["dsnu"].note and f"{own:.1f}" in found.shared["dsnu"].note


@pytest.mark.parametrize("sensor", preset_names())
def test_sensitivity_curves_are_there_and_said_to_be_this_or_another_cameras(sensor):
    sourced = preset(sensor).shared["sensitivity"]
    spectra.check_camera(sourced.value)
    measured = sourced.value != "Nikon 5100 (NPL)"
    assert ("this camera" if measured else "another camera") in sourced.note and bool(sourced.licence) == measured


def test_there_are_the_paper_and_three_classes():
    kinds = {preset(name).kind for name in preset_names()}
    assert {"paper", "phone", "full frame", "machine vision"} <= kinds
    for kind in ("phone", "full frame", "machine vision"):
        sensor = next(preset(name) for name in preset_names() if preset(name).kind == kind)
        published = [name for name, s in sensor.shared.items() if s.source.startswith("http") and name != "sensitivity"]
        assert {"pixel_pitch", "full_well_density", "read_noise", "bits"} <= set(published), kind


def test_what_the_paper_does_not_print_is_marked():
    paper = preset("paper-ccd").shared
    printed = {name for name, s in paper.items() if s.source.startswith("the paper")}
    assert printed == {"pixel_pitch", "aperture_fraction", "depletion_depth", "diffusion_depth"}
    for name in (
        "full_well_density",
        "dark_current_density",
        "read_noise",
        "dsnu",
        "bits",
        "peak_qe",
        "diffusion_length",
    ):
        assert paper[name].source == "typical" and "not in the paper" in paper[name].note


@pytest.mark.parametrize("sensor", preset_names())
def test_a_pipeline_that_names_a_sensor_has_its_values(sensor):
    plan = plan_of(sensor=sensor)
    for name in preset(sensor).shared:
        if name in plan.shared:
            assert plan.shared[name] == value_of(sensor, name), name
    assert plan.pipeline.preset_name == sensor


def test_what_the_pipeline_says_goes_before_what_the_sensor_says():
    assert plan_of(read_noise=1.5).shared["read_noise"] == 1.5
    assert plan_of(read_noise=1.5).shared["pixel_pitch"] == 5.86


def test_a_key_is_made_of_values_not_of_the_sensors_name():
    named = plan_of(sensor="sony-imx174")
    written = {name: value for name, value in preset("sony-imx174").values().items()}
    spelled = plan_of(sensor="", **written)
    assert {ref: cell.key for ref, cell in named.cells.items()} == {
        ref: cell.key for ref, cell in spelled.cells.items()
    }
    other = plan_of(sensor="sony-imx250")
    assert named.cells["read_noise", ()].key != other.cells["read_noise", ()].key
    assert named.cells["scene", ()].key == other.cells["scene", ()].key


def test_a_quantity_of_a_sensor_may_be_swept():
    plan = make_plan(parse_pipeline(TEXT, overrides={"sweep.read_noise": [1, 2]}), installed_stages())
    assert [axis.values for axis in plan.axes] == [(1.0, 2.0)]


def test_a_sensor_has_more_sides_than_a_pipeline_asks_for_and_that_is_no_warning():
    text = TEXT[: TEXT.index('[[stages]]\nuse = "irradiance"')]
    plan = make_plan(parse_pipeline(text.replace("keep = [", "#")), installed_stages())
    assert not [w for w in plan.warnings if "read_noise" in w]


@pytest.mark.parametrize(
    ("overrides", "place", "says"),
    [
        ({"camera.sensor": "sony-imx17"}, "camera.sensor", "did you mean 'sony-imx174'"),
        ({"camera.sensor": "film"}, "camera.sensor", "unknown sensor 'film'"),
        ({"camera.sensor": 5}, "camera.sensor", "expected the name of a sensor"),
    ],
)
def test_a_sensor_that_is_none_is_a_fault_with_a_way_out(overrides, place, says):
    with pytest.raises(RequestError) as error:
        make_plan(parse_pipeline(TEXT, overrides=overrides), installed_stages())
    assert any(fault.place == place and says in fault.message for fault in error.value.faults), str(error.value)


def test_the_pipeline_in_the_repository_runs_as_it_stands():
    plan = make_plan(read_pipeline(ROOT / "pipelines" / "sensors.toml"), installed_stages())
    assert plan.shared["pixel_pitch"] == 5.86


def command(*words):
    return process("sensors", *words)


def test_the_command_lists_sensors_and_gives_sources():
    listed = json.loads(command("--json").stdout)
    assert [one["name"] for one in listed] == list(preset_names())
    (one,) = json.loads(command("sony-imx363", "--json").stdout)
    assert one["camera"]["read_noise"] == {
        "value": 5,
        "source": preset("sony-imx363").shared["read_noise"].source,
        "note": "",
    }
    shown = command("sony-a7r2").stdout
    assert preset("sony-a7r2").shared["read_noise"].source in shown  # whole, to be copied
    assert "typical" in shown
    wrong = command("sony-a7r")
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert "did you mean 'sony-a7r2'" in wrong.stderr

"""A sensor as an axis: its cells are those of the sensor alone, and what sensors say is kept with a run."""

from dataclasses import replace
from pathlib import Path

import pytest
import xarray

from etendue.archive.records.inputs import resolve_pipeline
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.pipeline.file import parse_pipeline
from etendue.pipeline.presets import preset
from etendue.plan.planner import make_plan
from etendue_lab.compare.axis import without_sweep
from etendue_lab.compare.edge import pitches_of
from tests.run.small import run

TEXT = (Path(__file__).parents[2] / "pipelines" / "sensors.toml").read_text()
SENSORS = ("sony-imx174", "sony-imx363", "paper-ccd")
SMALL = {
    "scene.width": "80 um",
    "scene.height": "60 um",
    "pixel.sensor_width": "60 um",
    "pixel.sensor_height": "40 um",
    "wanted": ["raw"],
}


NAMELESS = TEXT.replace('sensor = "sony-imx174"\n', "")


def plan_of(text=TEXT, **overrides):
    return make_plan(parse_pipeline(text, overrides={**SMALL, **overrides}), installed_stages())


def keys(plan, **at):
    """By stage: the keys of the cells at some values of axes."""
    return {
        (cell.node, cell.key)
        for ref, cell in plan.cells.items()
        if all(plan.labels(ref).get(dim, value) == value for dim, value in at.items())
    }


@pytest.mark.parametrize("sensor", SENSORS)
def test_a_cell_along_the_axis_is_the_cell_of_that_sensor_alone(sensor):
    swept, alone = plan_of(**{"sweep.sensor": list(SENSORS)}), plan_of(**{"camera.sensor": sensor})
    assert keys(swept, sensor=sensor) == keys(alone)
    assert [axis.values for axis in swept.axes] == [SENSORS]


def test_what_is_in_front_of_the_sensor_is_computed_once():
    plan = plan_of(**{"sweep.sensor": list(SENSORS)})
    assert len(plan.of("lens")) == 1 and len(plan.of("pixel")) == len(SENSORS)


def test_a_table_goes_before_the_camera_and_the_camera_before_the_name():
    mine = {"sensor": "sony-imx174", "label": "mine", "read_noise": 40, "pixel_pitch": "4 um"}
    plan = plan_of(**{"sweep.sensor": ["sony-imx363", mine], "camera.read_noise": 7})
    found = {plan.labels(cell.ref)["sensor"]: vars(cell.stage) for cell in plan.of("read_noise")}
    assert {name: values["read_noise"] for name, values in found.items()} == {"sony-imx363": 7, "mine": 40}
    pitches = {plan.labels(cell.ref)["sensor"]: vars(cell.stage)["pixel_pitch"] for cell in plan.of("pixel")}
    assert pitches == {"sony-imx363": 1.4, "mine": 4}


def test_a_quantity_of_the_camera_holds_for_all_and_is_said():
    plan = plan_of(**{"sweep.sensor": list(SENSORS), "camera.pixel_pitch": 4})
    assert {vars(cell.stage)["pixel_pitch"] for cell in plan.of("pixel")} == {4}
    assert any("camera.pixel_pitch overrides every sensor" in text for text in plan.warnings)


def test_a_quantity_with_an_axis_of_its_own_is_left_to_it():
    plan = plan_of(**{"sweep.sensor": list(SENSORS), "sweep.pixel_pitch": [3, 4]})
    assert len(plan.of("pixel")) == 6
    for pitch in (3, 4):
        alone = plan_of(**{"camera.sensor": SENSORS[1], "camera.pixel_pitch": pitch})
        assert keys(plan, sensor=SENSORS[1], pixel_pitch=pitch) == keys(alone)


def test_a_sensor_that_is_in_no_file_is_a_table_with_a_label():
    mine = {"label": "mine", **preset("sony-imx250").values()}
    assert keys(plan_of(**{"sweep.sensor": [mine]}), sensor="mine") == keys(plan_of(**{"camera.sensor": "sony-imx250"}))


@pytest.mark.parametrize(
    ("written", "says"),
    [
        (["sony-imx17"], "did you mean 'sony-imx174'"),
        ("sony-imx174", "expected a list of sensors"),
        ([], "expected a list of sensors"),
        ([5], "expected a sensor name"),
        (["sony-imx174", "sony-imx174"], "appears twice"),
        ([{"sensor": "sony-imx174", "pixel_pich": 4}], "did you mean 'pixel_pitch'"),
        ([{"sensor": "sony-imx174", "pixel_pitch": "4 s"}], "pixel_pitch: expected a number in um"),
        ([{"label": "bare"}], "bare gives no"),
    ],
)
def test_what_is_wrong_is_said_at_the_axis(written, says):
    with pytest.raises(RequestError) as error:
        plan_of(NAMELESS, **{"sweep.sensor": written})
    assert all(fault.place == "sweep.sensor" for fault in error.value.faults), str(error.value)
    assert any(says in fault.message for fault in error.value.faults), str(error.value)


def test_the_record_of_a_run_holds_what_its_sensors_said():
    plan = plan_of(**{"sweep.sensor": ["sony-imx174", {"sensor": "sony-imx363", "label": "cold", "read_noise": 1}]})
    text = resolve_pipeline(plan).text
    again = parse_pipeline(text)
    assert again.sweep["sensor"][0]["pixel_pitch"] == preset("sony-imx174").values()["pixel_pitch"]
    assert keys(make_plan(again, installed_stages())) == keys(plan)


def test_an_archive_grows_by_sensors(tmp_path):
    one, other = (plan_of(**{"sweep.sensor": [name]}) for name in SENSORS[:2])
    run(one, tmp_path / "grown")
    assert run(other, tmp_path / "grown").reused  # what is in front of the sensor
    run(plan_of(**{"sweep.sensor": list(SENSORS[:2])}), tmp_path / "whole")
    grown, whole = (raw_of(tmp_path / name) for name in ("grown", "whole"))
    assert set(grown) == set(whole) == set(SENSORS[:2])
    for name in whole:
        xarray.testing.assert_equal(grown[name], whole[name])


def raw_of(folder):
    """By sensor: the raw frame, wherever its shape puts it."""
    tree = xarray.open_datatree(folder / "data.zarr", engine="zarr")
    return {
        str(name): one.drop_vars("sensor")
        for group in tree["adc"].subtree
        for name, one in (group.ds.raw.groupby("sensor", squeeze=False) if "raw" in group else ())
        if group.ds.status.sel(sensor=name) == 0
    }


def test_studies_of_one_camera_take_the_sensor_that_is_named_or_the_first():
    pipeline = parse_pipeline(TEXT, overrides={**SMALL, "sweep.sensor": list(SENSORS[1:])})
    alone, at = without_sweep(pipeline)
    assert at == {"sensor": "sony-imx174"} and keys(
        make_plan(replace(alone, wanted=("raw",)), installed_stages())
    ) == keys(plan_of())
    alone, at = without_sweep(parse_pipeline(NAMELESS, overrides={**SMALL, "sweep.sensor": list(SENSORS[1:])}))
    assert at == {"sensor": "sony-imx363"}
    assert keys(make_plan(replace(alone, wanted=("raw",)), installed_stages())) == keys(
        plan_of(**{"camera.sensor": "sony-imx363"})
    )


def test_an_edge_is_as_soft_as_the_pitch_of_each_sensor_asks():
    assert pitches_of(plan_of(**{"sweep.sensor": list(SENSORS)})) == [5.86, 1.4, 5.4]
    assert pitches_of(plan_of(**{"sweep.pixel_pitch": [3, 4]})) == [3, 4]
    assert pitches_of(plan_of()) == [5.86]

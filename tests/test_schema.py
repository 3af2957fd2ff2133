"""The schema of pipeline files takes what the reader takes, and refuses what a schema can know to be wrong."""

import tomllib
from pathlib import Path

import pytest

from etendue.contract.registry import installed_stages
from etendue.pipeline.schema import schema

jsonschema = pytest.importorskip("jsonschema")
HERE = Path(__file__).parent
PIPELINES = sorted((HERE.parent / "pipelines").glob("**/*.toml"))
KNOWABLE = """
    axis_is_a_number axis_value_out_of_range bool_for_a_number camera_is_a_list camera_quantity_in_a_stage
    camera_quantity_on_top date_for_a_number description_is_a_number empty_axis fraction_for_a_whole_number
    from_an_unknown_port from_is_no_table keep_is_a_table list_for_a_number misspelt_camera_key misspelt_parameter
    more_bits_than_the_converter_has most_cells_is_text name_is_a_path name_too_long name_with_a_backslash
    name_with_newline negative_f_number negative_noise negative_seed no_cells_at_most no_stages number_for_a_choice
    requires_is_a_number seed_is_a_fraction stage_name_with_a_slash stage_without_use stages_are_texts
    stages_is_a_table sweep_is_a_number sweep_of_no_steps sweep_table_misspelt text_for_a_number tolerance_above_one
    tolerance_is_a_list unknown_precision unknown_stage unknown_top_level_key
""".split()


@pytest.fixture(scope="module")
def validator():
    made = schema(installed_stages())
    jsonschema.Draft7Validator.check_schema(made)
    return jsonschema.Draft7Validator(made)


@pytest.mark.parametrize("file", PIPELINES, ids=lambda file: file.stem)
def test_every_shipped_pipeline_is_of_the_form(validator, file):
    document = tomllib.loads(file.read_text())
    known = {installed_stages().installed(name).distribution for name in installed_stages().names()}
    if not set(document.get("requires", ())) <= known:
        pytest.skip(f"needs {document['requires']}")
    assert not [error.message for error in validator.iter_errors(document)]


@pytest.mark.parametrize("name", KNOWABLE)
def test_what_a_schema_can_know_it_refuses(validator, name):
    assert list(validator.iter_errors(tomllib.loads((HERE / "wrong" / f"{name}.toml").read_text())))


def test_every_parameter_of_every_stage_is_in_it(validator):
    by_use = {
        rule["if"]["properties"]["use"]["const"]: rule["then"]
        for rule in validator.schema["properties"]["stages"]["items"]["allOf"]
    }
    assert set(by_use) == set(installed_stages().names())


@pytest.mark.parametrize(
    ("written", "right"),
    [
        (["sony-imx174", {"sensor": "sony-imx363", "label": "quiet", "read_noise": 1}], True),
        ([{"label": "mine", "pixel_pitch": "3 um"}], True),
        (["sony-imx17"], False),
        ([{"sensor": "sony-imx363", "read_nois": 1}], False),
        ([{"pixel_pitch": "3 um"}], False),
        ([], False),
    ],
)
def test_an_axis_of_sensors_is_names_or_tables_of_camera_quantities(validator, written, right):
    document = {"sweep": {"sensor": written}, "stages": [{"use": "irradiance"}]}
    assert (not list(validator.iter_errors(document))) == right

"""`keep = "looks"`: what people look at is stored, the bands of light are not, and the plan says what each choice
takes.
"""

from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from etendue.cli import main
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.pipeline.file import parse_pipeline, read_pipeline
from etendue.plan.planner import make_plan, summary

PIPELINE = Path(__file__).parents[2] / "pipelines" / "smallest.toml"


def planned(keep):
    return make_plan(replace(read_pipeline(PIPELINE), keep=keep), installed_stages())


def test_looks_are_all_but_the_bands_of_light():
    plan = planned(("looks",))
    light = {
        (n.name, v)
        for n in plan.nodes
        for v, written in n.writes.items()
        if {"wavelength", "y", "x"} <= {*written.dims}
    }
    assert light and plan.kept == planned(None).kept - light
    assert ("encode", "rgb_display") in plan.kept and ("scene", "white_radiance") in plan.kept


def test_looks_may_stand_beside_other_names():
    assert planned(("looks", "irradiance")).kept == planned(("looks",)).kept | planned(("irradiance",)).kept


def test_every_way_of_writing_it_means_the_same():
    text = PIPELINE.read_text()
    ways = [parse_pipeline(f"keep = {word}\n{text}") for word in ('"looks"', '["looks"]')]
    assert [one.keep for one in ways] == [("looks",)] * 2
    assert read_pipeline(PIPELINE, {"keep": "looks"}).keep == ("looks",)


def test_the_plan_tells_the_bytes_of_every_variable_and_of_every_choice():
    document, looks = (summary(planned(keep)) for keep in (None, ("looks",)))
    assert document["keep"] == looks["keep"] == {"all": document["bytes"], "looks": looks["bytes"]}
    for one in (document, looks):
        assert one["bytes"] == sum(
            v["bytes"] for stage in one["stages"] for v in stage["variables"].values() if v["kept"]
        )
    assert looks["bytes"] < 0.2 * document["bytes"]


def test_no_stage_may_take_the_word():
    with pytest.raises(RequestError, match="means pictures and metrics of all stages"):
        make_plan(
            parse_pipeline(PIPELINE.read_text().replace('name = "demosaic"', 'name = "looks"')), installed_stages()
        )


def test_what_one_begins_with_says_what_each_choice_takes(tmp_path):
    asked = CliRunner().invoke(main, ["new", "first", "-o", str(tmp_path)])
    assert asked.exit_code == 0, asked.output
    text = (tmp_path / "first.toml").read_text()
    lines = [line for line in text.splitlines() if line.startswith(("#   ", "keep"))]
    assert lines[-1] == 'keep = ["looks"]' and len(lines) == 4 and all("B" in line.split()[-1] for line in lines[:-1])
    keeps = summary(make_plan(parse_pipeline(text), installed_stages()))["keep"]
    sizes = [float(line.split()[-2]) for line in lines[:2]]
    assert sizes == pytest.approx([keeps["all"] / 1e6, keeps["looks"] / 1e6], rel=0.02)

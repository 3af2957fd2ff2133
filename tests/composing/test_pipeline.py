"""A pipeline written in Python is the pipeline of a file: the same document, the same plan, the same bits."""

import inspect
from pathlib import Path

import numpy as np
import pytest

import etendue
from etendue import stages as s
from etendue.builder.stages import maker
from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of
from etendue.contract.values.parameter import MISSING
from etendue.errors import RequestError
from etendue.pipeline.file import read_pipeline
from etendue.plan.planner import make_plan

PIPELINES = sorted((Path(__file__).parents[2] / "pipelines").glob("*.toml"))


def grey():
    scene = s.uniform(white_luminance="100 cd m-2", width="20 um", height="20 um", bin_width="100 nm")
    return etendue.Pipeline(scene, s.irradiance(), s.falloff(), name="grey").camera(f_number=4)


def keys(plan):
    return {ref: cell.key for ref, cell in plan.cells.items()}


@pytest.mark.parametrize("file", PIPELINES, ids=lambda file: file.stem)
def test_what_is_read_from_a_file_plans_the_same_cells(file):
    written = read_pipeline(file)
    if any(
        name not in {"", *(d.distribution for d in map(installed_stages().installed, installed_stages().names()))}
        for name in written.requires
    ):
        pytest.skip(f"{file.stem} needs {', '.join(written.requires)}")
    again = etendue.Pipeline.read(file)
    wanted = make_plan(written, installed_stages())
    assert keys(again.plan().plan) == keys(wanted)


def test_a_file_that_it_writes_reads_as_the_same_pipeline(tmp_path):
    made = grey().sweep(f_number=etendue.span(2, 8, 3, "log"))
    made.to_toml(tmp_path / "grey.toml")
    assert etendue.Pipeline.read(tmp_path / "grey.toml").document() == made.document()
    assert keys(make_plan(read_pipeline(tmp_path / "grey.toml"), installed_stages())) == keys(made.plan().plan)


def test_it_gives_the_bits_that_simulate_gives(tmp_path):
    made = grey().sweep(f_number=[2, 4])
    made.to_toml(tmp_path / "grey.toml")
    own, others = made.run(progress=False).tree, etendue.simulate(tmp_path / "grey.toml")
    kept = made.run(tmp_path / "archive", progress=False).tree
    for tree in (others, kept):
        np.testing.assert_array_equal(own["falloff/irradiance"].values, tree["falloff/irradiance"].values)


def test_no_call_changes_what_it_is_called_on():
    made = grey()
    before = made.document()
    more = (
        made.camera(f_number=2)
        .sweep(f_number=[2, 4])
        .add(s.diffraction())
        .stage("uniform", width="40 um")
        .want("irradiance")
        .set(seed=3)
    )
    assert made.document() == before != more.document()
    assert more.remove("diffraction").insert("falloff", s.diffraction()).swap("falloff", s.diffraction()).document()[
        "stages"
    ][3] == {
        "use": "diffraction",
        "name": "falloff",
    }


def test_every_installed_stage_has_its_own_signature_and_help():
    for name in dir(s):
        own = inspect.signature(getattr(s, name)).parameters
        declared = {
            n: found for n, found in parameters_of(installed_stages().load(name)).items() if not found[0].shared
        }
        assert set(own) == {*declared, "name", "reads_from"}
        assert {n for n, p in own.items() if p.default is inspect.Parameter.empty} == {
            n for n, (_, _, d) in declared.items() if d is MISSING
        }
        assert all(f"\n{n} : " in getattr(s, name).__doc__ for n in declared)


def test_a_wing_of_the_same_name_as_a_stage_stays_a_module():
    import etendue_camera.mosaic.stages.white as module

    assert module.__name__ == "etendue_camera.mosaic.stages.white"
    assert s.mosaic().use == "mosaic"


def test_a_stage_as_value_of_an_axis_is_what_a_file_says():
    swept = grey().sweep(falloff__use=["falloff", s.glare(fraction=0.01), s.irradiance, s.irradiance()])
    assert swept.axes == {"falloff.use": ["falloff", {"use": "glare", "fraction": 0.01}, "irradiance", "irradiance"]}


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda: s.difraction, "unknown stage 'difraction'; did you mean 'diffraction'?"),
        (lambda: s.uniform(widht=2), "uniform.widht: unknown parameter; did you mean 'width'?"),
        (lambda: s.diffraction(f_number=2), "shared by stages; set it with Pipeline.camera(f_number=...)"),
        (lambda: etendue.Pipeline(s.irradiance), "stage 1: expected a placed stage, got the function"),
        (lambda: grey().add("sharpen"), "expected a placed stage such as etendue.stages.NAME(), got 'sharpen'"),
        (lambda: etendue.Pipeline(f_number=2), "f_number: is a camera quantity; use Pipeline.camera(f_number=...)"),
        (lambda: grey().stage("scene", width=2), "the pipeline has no stage 'scene'"),
        (lambda: grey().sweep(f_number="2, 4"), "sweep.f_number: expected a list of values or span(...)"),
        (lambda: grey().camera(f_numer=2).plan(), "f_numer"),
        (lambda: maker("x"), "unknown stage 'x'"),
    ],
)
def test_what_is_wrong_is_said_at_once(wrong, said):
    with pytest.raises((RequestError, AttributeError)) as caught:
        wrong()
    assert said in str(caught.value)


def test_what_notebooks_show_escapes_what_was_given():
    made = grey().stage("uniform", width="<script>").set(description="x")
    assert "<script>" not in made._repr_html_() and "&lt;script&gt;" in made._repr_html_()
    page = grey().plan()._repr_html_()
    assert "<td" in page and "falloff" in page and "3 cells" in page

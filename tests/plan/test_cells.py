"""Each thing once: stages at the product of the axes that reach them, and only the stages a wanted variable needs."""

import math
import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.plan.planner import summary
from tests.fresh import process
from tests.plan.given import CAMERA, SCENE, SENSOR, chain, keys_of, plan_of

TENS = """
f_number = { from = 1.4, to = 16, steps = 10, spacing = "log" }
pixel_pitch = { from = "2 um", to = "5 um", steps = 10 }
integration_time = { from = "1 ms", to = "100 ms", steps = 10, spacing = "log" }
"""

# A short camera: 14 stages at 1000 points would only be slower to plan, not another law.
SHORT = (
    CAMERA
    + SCENE.format(scene="slanted_edge")
    + "\n".join(
        f'[[stages]]\nuse = "{use}"'
        for use in ("irradiance", "diffraction", "pixel", "mosaic", "exposure", "lens_numbers", "pixel_numbers")
    )
)


def counts(plan):
    return {node.name: len(plan.of(node.name)) for node in plan.nodes}


def axes(plan):
    return {node.name: node.axes for node in plan.nodes}


def test_a_sweep_of_ten_by_ten_by_ten_shares_the_scene_the_lens_and_the_pixels():
    plan = plan_of(SHORT.replace('use = "pixel"\n', 'use = "pixel"\nrows = 8\ncolumns = 8\n') + f"\n[sweep]{TENS}")
    assert counts(plan) == {
        "scene": 1,
        "irradiance": 10,
        "diffraction": 10,
        "pixel": 100,
        "mosaic": 100,
        "exposure": 1000,
        "lens_numbers": 10,
        "pixel_numbers": 10,
    }
    document = summary(plan)
    assert document["cells"] == len(plan.cells) == 1241
    assert document["naive_cells"] == 8000


def test_every_cell_stands_behind_what_it_reads_and_shares_its_axes():
    plan = plan_of(chain(sweep='f_number = [2, 4]\n"sharpen.strength" = [0, 0.5]\npixel_pitch = ["4 um", "5 um"]'))
    seen = set()
    for ref, cell in plan.cells.items():
        for _, source, _ in cell.inputs:
            assert source in seen
            labels = plan.labels(ref)
            assert all(labels[dim] == value for dim, value in plan.labels(source).items())
        seen.add(ref)


@settings(max_examples=20, deadline=None)
@given(
    order=st.permutations(["f_number", "pixel_pitch", "integration_time"]), sizes=st.tuples(*[st.integers(1, 3)] * 3)
)
def test_axes_keep_the_order_of_the_file_and_cells_are_their_product(order, sizes):
    values = {"f_number": [2, 3, 4], "pixel_pitch": [3, 4, 5], "integration_time": [0.1, 0.2, 0.3]}
    sweep = "\n".join(f"{name} = {values[name][:size]}" for name, size in zip(order, sizes, strict=True))
    plan = plan_of(chain(sweep=sweep))
    size = dict(zip(order, sizes, strict=True))
    reached = {
        "scene": set(),
        "irradiance": {"f_number"},
        "diffusion": {"f_number"},
        "pixel": {"f_number", "pixel_pitch"},
        "sharpen": set(order),
    }
    for name, dims in reached.items():
        assert axes(plan)[name] == tuple(dim for dim in order if dim in dims)
        assert counts(plan)[name] == math.prod(size[dim] for dim in dims)


def test_an_axis_of_one_value_is_an_axis_with_the_keys_of_the_scalar():
    swept, alone = plan_of(chain(sweep="f_number = [4]")), plan_of(chain(), {"camera.f_number": 4})
    assert axes(swept)["pixel"] == ("f_number",)
    assert keys_of(swept) == keys_of(alone)


# -- what is wanted ---------------------------------------------------------------------------------------


def test_only_what_a_wanted_variable_needs_is_planned():
    everything = [node.name for node in plan_of(chain(tail='[[stages]]\nuse = "lens_numbers"\n')).nodes]
    assert everything[-2:] == ["sharpen", "lens_numbers"]
    raw = plan_of(chain(), {"wanted": ["raw"]})
    assert [node.name for node in raw.nodes] == everything[: everything.index("adc") + 1]
    assert raw.wanted == (("adc", "raw"),)


def test_a_variable_is_its_last_writers_and_a_stage_can_be_named():
    assert plan_of(chain(), {"wanted": ["irradiance"]}).wanted == (("diffusion", "irradiance"),)
    assert plan_of(chain(), {"wanted": ["falloff.irradiance"]}).wanted == (("falloff", "irradiance"),)
    assert plan_of(chain(), {"wanted": ["scene"]}).wanted == (("scene", "radiance"), ("scene", "white_radiance"))
    assert [node.name for node in plan_of(chain(), {"wanted": ["falloff.irradiance"]}).nodes] == [
        "scene",
        "irradiance",
        "falloff",
    ]


def test_what_is_kept_causes_no_computing_and_is_looked_up_by_variable_stage_or_both():
    kept = plan_of(chain(), {"wanted": ["raw"], "keep": ["irradiance", "mosaic", "exposure.expected_charge"]}).kept
    assert kept == {
        *((name, "irradiance") for name in ("irradiance", "falloff", "diffraction", "lens_gaussian", "diffusion")),
        ("irradiance", "white_irradiance"),
        ("mosaic", "photocurrent"),
        ("exposure", "expected_charge"),
    }
    assert not plan_of(chain(), {"wanted": ["raw"], "keep": ["rgb_camera"]}).kept


def test_only_the_plugins_of_the_stages_in_the_file_are_imported(tmp_path):
    """Wanting raw needs neither the module of the colour stages, which are not in the file, nor colour-science where
    the scene is known.
    """
    (tmp_path / "file.toml").write_text(CAMERA + SCENE.format(scene="uniform") + SENSOR)
    script = (
        "import sys; from pathlib import Path; from etendue.plan.planner import make_plan;"
        "from etendue.contract.registry import installed_stages;"
        "from etendue.pipeline.file import read_pipeline; make_plan(read_pipeline(Path('file.toml')), "
        "installed_stages());"
        "print(*sorted(m for m in sys.modules if 'stages' in m), 'colour' in sys.modules)"
    )
    cache = os.environ | {"ETENDUE_CACHE": str(tmp_path / "cache")}
    for _ in range(2):
        done = process(code=script, cwd=tmp_path, env=cache)
    loaded = {name.removeprefix("etendue_camera.").replace(".stages", "") for name in done.stdout.split()}
    assert {"electronics.exposure", "optics.gathering", "scene.charts", "sensor.pixel", "False"} <= loaded
    assert not {name.split(".")[0] for name in loaded} & {"colour", "restoration", "resolution", "quality"}
    assert not loaded & {
        "electronics.paper_order",
        "electronics.numbers",
        "optics.glare",
        "optics.filters",
        "optics.numbers",
        "mosaic.demosaic",
    }


# -- branches ---------------------------------------------------------------------------------------------

BRANCHES = chain(
    tail="""
[[stages]]
use = "demosaic_nearest"
name = "other"
[[stages]]
use = "sharpen"
name = "other_sharpen"
strength = 0.4
[[stages]]
use = "sharpen"
name = "back"
from = { rgb_camera = "demosaic" }
"""
)


def test_a_stage_reads_the_nearest_earlier_writer_unless_from_says_otherwise():
    plan = plan_of(BRANCHES, {"wanted": ["sharpen", "other_sharpen", "back"]})
    reads = {node.name: [source for _, source, _ in node.inputs[0]] for node in plan.nodes}
    assert reads["sharpen"] == ["demosaic"]
    assert reads["other"] == ["linearise"]
    assert reads["other_sharpen"] == ["other"]
    assert reads["back"] == ["demosaic"]
    assert keys_of(plan)["back"] == keys_of(plan)["sharpen"]  # same recipe, whatever the name


def test_an_axis_of_one_branch_does_not_reach_the_other():
    plan = plan_of(
        BRANCHES + '\n[sweep]\n"other_sharpen.strength" = [0.1, 0.2, 0.3]\n', {"wanted": ["sharpen", "other_sharpen"]}
    )
    assert counts(plan)["other_sharpen"] == 3
    assert counts(plan)["sharpen"] == counts(plan)["other"] == 1
    assert plan.node("other_sharpen").axes == ("other_sharpen_strength",)


# -- a stage as an axis -----------------------------------------------------------------------------------


def test_a_swapped_stage_is_an_axis_named_after_the_stage():
    plan = plan_of(
        chain(sweep='"demosaic.use" = ["demosaic_bilinear", "demosaic_nearest"]\nintegration_time = [0.1, 0.2]')
    )
    assert [axis.key for axis in plan.axes] == ["demosaic.use", "integration_time"]
    assert plan.node("demosaic").axes == plan.node("sharpen").axes == ("demosaic", "integration_time")
    assert plan.node("linearise").axes == ("integration_time",)
    assert [cell.use for cell in plan.of("demosaic")] == ["demosaic_bilinear"] * 2 + ["demosaic_nearest"] * 2
    assert plan.axis("demosaic").values == ("demosaic_bilinear", "demosaic_nearest")
    # one of the alternatives alone has the same key
    alone = plan_of(chain(), {"demosaic.use": "demosaic_nearest", "camera.integration_time": "0.2"})
    assert alone.of("demosaic")[0].key == plan.of("demosaic")[3].key


def test_the_key_with_and_without_quotes_means_the_same():
    quoted = plan_of(chain(sweep='"demosaic.use" = ["demosaic_bilinear", "demosaic_nearest"]'))
    bare = plan_of(chain(sweep='demosaic.use = ["demosaic_bilinear", "demosaic_nearest"]'))
    assert [a.key for a in quoted.axes] == [a.key for a in bare.axes]
    assert keys_of(quoted) == keys_of(bare)


def test_alternatives_may_be_tables_with_a_label_and_parameters_of_their_own():
    text = (
        CAMERA
        + SCENE.format(scene="slanted_edge")
        + SENSOR.replace('use = "lens_gaussian"\n', 'use = "lens_gaussian"\nname = "blur"\nsigma = "1 um"\n')
        + """
[sweep]
"blur.use" = [
    "lens_gaussian",
    { use = "lens_gaussian", sigma = "500 nm", label = "sharp" },
    { use = "diffraction", label = "perfect" },
]
"""
    )
    plan = plan_of(text, {"wanted": ["blur.irradiance"]})
    assert plan.axis("blur").values == ("lens_gaussian", "sharp", "perfect")
    stages = [cell.stage for cell in plan.of("blur")]
    assert [getattr(stage, "sigma", None) for stage in stages] == [1.0, 0.5, None]
    assert [cell.use for cell in plan.of("blur")] == ["lens_gaussian", "lens_gaussian", "diffraction"]


def test_axes_of_a_swapped_stage_are_the_union_of_those_of_its_alternatives():
    """demosaic stages read the pattern, whose axis starts at the mosaic; reading differs, writing does not."""
    plan = plan_of(
        chain(sweep='pattern = ["RGGB", "BGGR"]\n"demosaic.use" = ["demosaic_bilinear", "demosaic_colour_difference"]')
    )
    assert plan.node("mosaic").axes == ("pattern",)
    assert plan.node("demosaic").axes == ("pattern", "demosaic")
    assert [cell.stage.pattern for cell in plan.of("demosaic")] == ["RGGB", "RGGB", "BGGR", "BGGR"]


def test_an_alternative_with_a_wrong_parameter_is_a_fault_of_the_axis():
    with pytest.raises(RequestError) as caught:
        plan_of(chain(sweep='"sharpen.use" = [{ use = "sharpen", strength = 9 }, "sharpen"]'))
    assert [fault.place for fault in caught.value.faults] == ["sweep.sharpen.use.strength", "sweep.sharpen.use"]
    assert caught.value.faults[0].line == caught.value.faults[1].line is not None


# -- segments ---------------------------------------------------------------------------------------------


def test_transfer_functions_in_a_row_are_one_segment_that_ends_with_the_sum_over_wavelength():
    plan = plan_of(chain())
    segments = {node.name: node.segment for node in plan.nodes if node.segment}
    whole = ("diffraction", "lens_gaussian", "diffusion", "pixel")
    assert segments == {name: whole[: i + 1] for i, name in enumerate(whole)}
    assert {cell.segment_input for cell in plan.cells.values() if cell.segment_input} == {
        (("falloff", ()), "irradiance")
    }


@pytest.mark.parametrize("setting", [{"wanted": ["raw"]}, {"keep": ["pixel"]}, {"lens_gaussian.sigma": 0}], ids=str)
def test_a_segment_is_fixed_by_the_pipeline_not_by_what_is_wanted_kept_or_left_out(setting):
    before, after = plan_of(chain()), plan_of(chain(), setting)
    for node in after.nodes:
        assert node.segment == before.node(node.name).segment


def test_a_stage_between_two_blurs_splits_the_segment():
    text = chain().replace(
        '[[stages]]\nuse = "diffusion"', '[[stages]]\nuse = "optical_filter"\n[[stages]]\nuse = "diffusion"'
    )
    plan = plan_of(text)
    assert plan.node("lens_gaussian").segment == ("diffraction", "lens_gaussian")
    assert plan.node("pixel").segment == ("diffusion", "pixel")


# -- precision --------------------------------------------------------------------------------------------


def edge(low, high=0.9, **setting):
    return plan_of(chain(), {"scene.low": low, "scene.high": high, **setting}).precision


def test_the_range_of_the_scene_decides_the_precision():
    """A float32 transform errs by 2e-7 of full scale: too much for what is darker than that over the tolerance."""
    assert edge(0.1) == "float32"
    assert edge(0.0) == "float64"  # exact black: no range holds it
    assert edge(9e-6) == "float64"  # the paper's 100000:1
    assert edge(0.1, tolerance=1e-7) == "float64"
    assert edge(9e-6, tolerance=0.1) == "float32"


def test_a_precision_that_is_named_is_taken():
    assert edge(0.0, precision="float32") == "float32"
    assert edge(0.1, precision="float64") == "float64"


def test_the_darkest_of_swept_scenes_decides_for_all():
    """One precision for a plan: a sweep is compared cell by cell."""
    assert plan_of(chain(sweep='"scene.low" = [0.1, 0.2]')).precision == "float32"
    assert plan_of(chain(sweep='"scene.low" = [0.1, 1e-6]')).precision == "float64"


def test_the_plan_of_the_shipped_pipelines_is_complete():
    """Every file in pipelines/ whose stages are installed can be planned."""
    for path in sorted((Path(__file__).parents[2] / "pipelines").glob("*.toml")):
        if "real_lens" in path.read_text() and "real_lens" not in installed_stages():
            continue  # a plugin's pipeline
        plan = plan_of(path.read_text(), folder=path.parent)
        assert summary(plan)["cells"] == len(plan.cells) > 0


def test_an_axis_that_reaches_nothing_wanted_is_left_out_with_a_note():
    """A file with a sweep can be asked for one of its variables; an axis that no stage knows stays a fault."""
    sweep = "f_number = [2, 4]\nintegration_time = [0.1, 0.2]"
    plan = plan_of(chain(sweep=sweep), {"wanted": ["irradiance"]})
    assert [axis.dim for axis in plan.axes] == ["f_number"]
    assert [text for text in plan.warnings if "integration_time" in text] == [
        "sweep.integration_time is not swept: no wanted variable depends on it"
    ]
    assert keys_of(plan)["diffusion"] == keys_of(plan_of(chain(sweep=sweep)))["diffusion"]

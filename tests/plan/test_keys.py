"""Equal recipe, equal key; whatever can change a result changes the key, and nothing else does."""

import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import etendue
from etendue.contract.arrays.grid import Grid, Labels, Line
from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of, quantities_of
from etendue.contract.values.parameter import MISSING
from etendue.plan import cost
from etendue.plan.expansion import cells, forms, recipes
from etendue.plan.identity import keys
from etendue.plan.wiring import binding
from tests.plan.given import CAMERA, SCENE, chain, changed, keys_of, plan_of

BEHIND_PIXEL = {"pixel", "mosaic", "exposure", "shot_noise", "adc", "linearise", "demosaic", "sharpen"}
BEHIND_LENS = {"irradiance", "falloff", "diffraction", "lens_gaussian", "diffusion"} | BEHIND_PIXEL


def test_the_same_recipe_written_differently_has_the_same_keys():
    """Order of keys, units, comments, names of parameters left at their default: none of it is part of the recipe."""
    other = chain().replace('"1000 cd m-2"', '"0.1 cd cm-2"').replace('"1 um"', '"1000 nm"   # a comment')
    other = other.replace('use = "pixel"', 'use = "pixel"\nsampling = "physical"')
    other = other.replace("[camera]", '[camera]\nf_number = 2.8\nfocal_length = "0.00693 m"')
    assert keys_of(plan_of(chain())) == keys_of(plan_of(other))


@pytest.mark.parametrize(
    ("setting", "reached"),
    [
        ({"camera.f_number": 4}, BEHIND_LENS),
        ({"camera.diffusion_length": 20}, {"diffusion"} | BEHIND_PIXEL),
        ({"camera.pixel_pitch": "5 um"}, BEHIND_PIXEL),
        ({"camera.integration_time": "20 ms"}, {"exposure", "shot_noise", "adc", "linearise", "demosaic", "sharpen"}),
        ({"camera.bits": 10}, {"adc", "linearise", "demosaic", "sharpen"}),
        ({"sharpen.strength": 0.3}, {"sharpen"}),
        ({"scene.angle": 4}, {"scene"} | BEHIND_LENS),
        ({"seed": 5}, {"shot_noise", "adc", "linearise", "demosaic", "sharpen"}),
        ({"camera.sensor_serial": "2"}, {"exposure", "shot_noise", "adc", "linearise", "demosaic", "sharpen"}),
        ({"precision": "float64"}, {"scene"} | BEHIND_LENS),
    ],
    ids=lambda value: " ".join(sorted(value)) if isinstance(value, set) else str(value),  # the same in every process
)
def test_a_change_reaches_the_stages_behind_it_and_no_other(setting, reached):
    assert changed(plan_of(chain()), plan_of(chain(), setting)) == reached


@pytest.mark.parametrize(
    "setting",
    [
        {"keep": ["raw"]},
        {"keep": []},
        {"wanted": ["raw"]},
        {"wanted": ["sharpen"]},
        {"name": "other"},
        {"description": "x"},
    ],
    ids=str,
)
def test_what_is_kept_wanted_or_called_changes_no_key(setting):
    before = keys_of(plan_of(chain()))
    for name, found in keys_of(plan_of(chain(), setting)).items():
        assert found == before[name]


def test_the_tolerance_is_not_part_of_a_key():
    """It decides what is left out and which knobs are set; what is computed either way has the same key."""
    text = chain("composite")
    one, other = (plan_of(text, {"tolerance": t, "precision": "float64"}) for t in (1e-3, 1.1e-3))
    same = [
        ref
        for ref, cell in one.cells.items()
        if (cell.stage, cell.left_out is None) == (other.cells[ref].stage, other.cells[ref].left_out is None)
    ]
    assert len(same) == len(one.cells)
    assert keys_of(one) == keys_of(other)
    assert keys_of(plan_of(text, {"tolerance": 0}, leave_out=False)) == keys_of(
        plan_of(text, {"tolerance": 1e-9}, leave_out=False)
    )


def test_a_cell_that_is_left_out_has_the_key_of_what_it_reads():
    plan = plan_of(chain(), {"sharpen.strength": 0})
    assert plan.of("sharpen")[0].left_out
    assert keys_of(plan)["sharpen"] == keys_of(plan)["demosaic"]
    computed = plan_of(chain(), {"sharpen.strength": 0}, leave_out=False)
    assert keys_of(computed)["sharpen"] != keys_of(computed)["demosaic"]


def test_the_cells_of_a_sweep_have_the_keys_they_have_alone():
    swept = plan_of(chain(sweep="f_number = [2, 4]\nintegration_time = [0.001, 0.01, 0.1]"))
    for cell in swept.cells.values():
        labels = swept.labels(cell.ref)
        alone = plan_of(chain(), {f"camera.{axis}": value for axis, value in labels.items()})
        assert cell.key == alone.of(cell.node)[0].key


def test_a_stage_is_known_by_what_it_does_not_by_its_name_unless_it_draws_noise():
    renamed = plan_of(chain().replace('name = "demosaic"', 'name = "debayer"'))
    assert [c.key for c in renamed.of("debayer")] == keys_of(plan_of(chain()))["demosaic"]
    patterned = plan_of(chain().replace('use = "exposure"', 'use = "exposure"\nname = "integrated"'))
    assert [c.key for c in patterned.of("integrated")] == keys_of(plan_of(chain()))["exposure"]
    other_noise = plan_of(chain().replace('use = "shot_noise"', 'use = "shot_noise"\nname = "photons"'))
    assert [c.key for c in other_noise.of("photons")] != keys_of(plan_of(chain()))["shot_noise"]


BUILT_IN = sorted(
    name for name in installed_stages().names() if installed_stages().installed(name).distribution == "etendue"
)


def unchecked(kind, values):
    """A stage with these values, whatever it would say of them: a key is made of every value alike."""
    stage = object.__new__(kind)
    for name, value in values.items():
        object.__setattr__(stage, name, value)
    return stage


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_parameter_of_every_built_in_stage_is_part_of_its_key(name):
    kind = installed_stages().load(name)
    declared = parameters_of(kind)
    given_values = {
        n: d if d is not MISSING else (0.1, 0.2, 0.3) if n == "peak_qe" else 1.0 for n, (p, _, d) in declared.items()
    }
    file = next((n for n, (p, _, d) in declared.items() if p.file), None)
    if file:
        given_values[file] = __file__
    base = keys.key_of(keys.parameters_for_key(unchecked(kind, given_values)))
    for parameter in declared:
        old = given_values[parameter]
        if isinstance(old, str):
            new = keys.__file__ if parameter == file else old + "?"
        else:
            new = (*old, 1.0) if isinstance(old, tuple) else 1.0 if old in (math.inf, -math.inf) else old + 1
        assert keys.key_of(keys.parameters_for_key(unchecked(kind, {**given_values, parameter: new}))) != base, (
            parameter
        )


# -- what a plan decides ----------------------------------------------------------------------------------


def test_grids_stand_in_keys_as_they_are(monkeypatch):
    """Whatever of the planner makes them: its code is in no key."""
    before, made = plan_of(chain()), forms.output_grid
    mosaic = before.of("mosaic")[0].stage

    def moved(stage, declaration, *given):
        grid = made(stage, declaration, *given)
        return grid.replace(x=replace(grid.line("x"), start=grid.line("x").start + 1e-12)) if stage == mosaic else grid

    monkeypatch.setattr(cells, "output_grid", moved)
    assert changed(before, plan_of(chain())) == BEHIND_PIXEL - {"pixel"}


def test_where_a_segment_begins_stands_in_keys(monkeypatch):
    before = plan_of(chain())
    monkeypatch.setattr(
        binding, "_segment", lambda node, earlier: (node.name,) if node.is_transfer else ()
    )  # each transformed alone
    assert changed(before, plan_of(chain())) == {"lens_gaussian", "diffusion"} | BEHIND_PIXEL


def test_whether_light_is_streamed_stands_in_keys(monkeypatch):
    """Streamed or whole, transfer functions give other last bits; what makes light gives the same."""
    before = plan_of(chain())
    assert all(cell.key for cell in before.cells.values())  # found when they are asked for
    monkeypatch.setattr(cost, "LARGEST_WHOLE", 1000)
    assert changed(before, plan_of(chain())) == {"diffraction", "lens_gaussian", "diffusion"} | BEHIND_PIXEL


def test_the_dim_along_which_a_quantity_has_the_label_of_its_slice_stands_in_keys(monkeypatch):
    """Planes that are not mosaicked know their filter by it."""
    before = plan_of(chain())
    kind = type(before.of("linearise")[0].stage)
    told = {name: replace(one, along="frame") for name, one in quantities_of(kind).items()}
    monkeypatch.setattr(recipes, "quantities_of", lambda asked: told if asked is kind else quantities_of(asked))
    assert changed(before, plan_of(chain())) == {"linearise", "demosaic", "sharpen"}


def test_how_a_scene_was_drawn_stands_in_the_keys_of_those_who_look_at_transfer_functions(monkeypatch):
    """They divide by the contrast that the drawing took, so the same light drawn otherwise gives other figures."""
    text = chain() + '[[stages]]\nuse = "resolution"\n'
    before = plan_of(text)
    monkeypatch.setattr(type(before.of("scene")[0].stage), "rendered", lambda scene: (7.0, 0.0))
    assert changed(before, plan_of(text)) == {"resolution", "sharpen"}


def test_equal_grids_are_one_text_whatever_their_numbers_came_as():
    one, other = (
        Grid.of({"x": Line(4, 1, 2.0), "c": Labels((1, "R"))}),
        Grid.of({"x": Line(np.int64(4), 1.0, 2), "c": Labels((1.0, "R"))}),
    )
    assert one == other and keys.plain_text(one) == keys.plain_text(other)
    assert keys.plain_text(one) != keys.plain_text(one.replace(x=Line(4, 1, 2.0, cells=True)))
    assert keys.plain_text(Labels(("a b",))) != keys.plain_text(Labels(("a", "b")))


finite = st.one_of(st.floats(allow_nan=False), st.integers(-(2**60), 2**60), st.text(max_size=5), st.booleans())


@given(
    one=st.dictionaries(st.text(max_size=3), finite, max_size=4),
    other=st.dictionaries(st.text(max_size=3), finite, max_size=4),
)
def test_different_parameters_have_different_keys_and_their_order_does_not_matter(one, other):
    assert keys.key_of(one) == keys.key_of(dict(reversed(one.items())))
    same = one.keys() == other.keys() and all(repr(one[k]) == repr(other[k]) for k in one)
    assert (keys.key_of(one) == keys.key_of(other)) == same


# -- files ------------------------------------------------------------------------------------------------


def pictured(folder, name):
    scene = SCENE.format(scene="photograph") + f'file = "{name}"\n'
    return plan_of(CAMERA + scene, folder=folder)


def picture(path, shade):
    from PIL import Image

    Image.new("RGB", (8, 8), (shade, shade, shade)).save(path)


def test_files_count_by_content_and_not_by_path(tmp_path):
    picture(tmp_path / "a.png", 100)
    shutil.copy(tmp_path / "a.png", tmp_path / "b.png")
    picture(tmp_path / "c.png", 101)
    one, copied, other = (pictured(tmp_path, name) for name in ("a.png", "b.png", "c.png"))
    assert keys_of(one) == keys_of(copied)
    assert changed(one, other) == {"scene"}


def test_a_folder_counts_by_the_names_and_contents_of_its_files(tmp_path):
    """A reader that takes the planes of a cube by name reads another cube after a file was renamed."""

    def folder(name, **files):
        (tmp_path / name).mkdir()
        for file, text in files.items():
            (tmp_path / name / file).write_text(text)
        return keys.file_digest(str(tmp_path / name))

    one = folder("one", a="red", b="blue")
    assert folder("copied", b="blue", a="red") == one
    assert one not in (folder("renamed", a="red", c="blue"), folder("swapped", a="blue", b="red"))


def test_a_file_that_is_overwritten_between_two_plans_of_one_process_has_another_key(tmp_path):
    """A notebook that simulates, edits a table and simulates again must not be given the old result."""
    picture(tmp_path / "a.png", 100)
    before = pictured(tmp_path, "a.png")
    picture(tmp_path / "a.png", 200)
    assert changed(before, pictured(tmp_path, "a.png")) == {"scene"}


def test_a_file_that_is_overwritten_between_two_runs_of_one_process_is_read_again(tmp_path):
    text = CAMERA + SCENE.format(scene="photograph") + f"file = '{tmp_path / 'a.png'}'\n"
    levels = []
    for shade in (100, 200):
        picture(tmp_path / "a.png", shade)
        levels.append(float(etendue.simulate(text, scheduler="serial")["scene"]["radiance"].mean()))
    linear = [((shade / 255 + 0.055) / 1.055) ** 2.4 for shade in (100, 200)]  # sRGB, above its linear part
    assert levels[1] / levels[0] == pytest.approx(linear[1] / linear[0], rel=1e-5)  # float32

"""Stages that look at transfer functions: what they are given, which axes reach them, and when they are computed
again.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint

import numpy as np
import pytest
from numpy.testing import assert_allclose

from etendue.compute.joined.otf import Otf
from etendue.contract.registry import Registry
from etendue.errors import RequestError
from etendue.plan.expansion.recipes import Recipes
from etendue.plan.planner import make_plan
from etendue.plugins.discovery import Discovery, installed
from etendue.plugins.hookspecs import GROUP
from etendue.session import load
from etendue_camera.optics.stages.lens import LensGaussian
from etendue_camera.optics.stages.wavefront import Wavefront
from etendue_camera.sensor.stages.pixel import Diffusion, Pixel
from tests.run.small import BARE, assert_same_arrays, by_labels, run

EDGES = (400.0, 500.0, 600.0, 700.0)
WIDE = np.linspace(0.0, 0.3, 80)


def registry():
    """What is installed, and the stages beside this file."""
    return Registry(Discovery([*installed().points, EntryPoint("own", "tests.run.looking", GROUP)]))


def plan_of(overrides=None, tail="restore", text=BARE):
    whole = text + "".join(f'[[stages]]\nuse = "{use}"\n' for use in tail.split())
    probes = [use for use in tail.split() if use in ("sizes", "parts")]
    return make_plan(load(whole, {"wanted": ["rgb_camera", *probes], **(overrides or {})}), registry())


def arrays_of(plan, **options):
    return by_labels(plan, run(plan, **options).arrays)


def of(plan, arrays, stage, variable):
    """The arrays of one variable of a stage, in the order of its cells."""
    return [array for (labels, name), array in arrays.items() if labels[0] == stage and name == variable]


def test_a_stage_gets_the_transfer_functions_in_front_of_it():
    """Its own use of them is the product of the stages' own, weighted by photons."""
    plan = plan_of({"keep": ["sharpen.rgb_camera", "restore.rgb_camera"]})
    arrays = run(plan, **{}).arrays
    before, after = arrays[("sharpen", ())]["rgb_camera"], arrays[("restore", ())]["rgb_camera"]
    stages = [plan.of(name)[0].stage for name in ("diffraction", "diffusion", "pixel")]
    pixel = stages[-1]
    wavelength = np.array([0.45, 0.55, 0.65])[:, None, None]
    edges = plan.of("pixel")[0].input_grids["irradiance"].bands().edges
    weights = pixel.prepare({"wavelength_edges": np.array(edges), "wavelength": wavelength.ravel() * 1e3})[0]
    otf = np.ones((3, 1, 1))
    for stage in stages:
        otf = otf * stage.transfer(
            np.zeros((1, 1)), np.full((1, 1), 0.05), wavelength, *([weights] if stage is pixel else [])
        )
    factor = weights @ otf[:, 0, 0] / weights.sum(axis=1)
    assert 0.3 < factor.min() < factor.max() < 0.99
    assert_allclose(after, before * factor[:, None, None], rtol=3e-7)  # single precision


def test_axes_reach_what_looks_at_their_stages_and_no_others_do():
    """The probe reads no picture: the integration time changes nothing for it."""
    sweep = {
        "sweep.diffusion_length": ["5 um", "50 um"],
        "sweep.f_number": [2.8, 8],
        "sweep.integration_time": ["2 ms", "4 ms"],
    }
    plan = plan_of(sweep, tail="restore parts")
    assert plan.node("parts").axes == ("diffusion_length", "f_number")
    assert set(plan.node("restore").axes) == {"diffusion_length", "f_number", "integration_time"}
    assert len({cell.key for cell in plan.of("parts")}) == 4
    assert len({cell.key for cell in plan.of("restore")}) == 8


@pytest.mark.parametrize(
    ("overrides", "again"),
    [
        ({"camera.depletion_depth": "2.5 um"}, True),
        ({"scene.softness": 2.0}, True),
        ({"scene.white_luminance": "900 cd m-2"}, False),
        ({"camera.integration_time": "3 ms"}, False),
    ],
)
def test_a_probe_is_computed_again_where_what_it_looks_at_changes(overrides, again):
    """And only there: neither light nor time change a transfer function."""
    first, second = plan_of(tail="parts"), plan_of(overrides, tail="parts")
    assert (first.of("parts")[0].key != second.of("parts")[0].key) == again


@pytest.mark.parametrize(
    "overrides", [{"scene.wavelength_to": "600 nm"}, {"scene.spacing": "0.75 um"}, {"falloff.use": "distortion"}]
)
def test_a_transfer_function_is_keyed_by_the_light_it_is_made_for(overrides):
    """By the wavelengths, by the grid, and by whether something in front moves light that is in no product."""
    first, second = plan_of(tail="parts"), plan_of(overrides, tail="parts")
    assert first.of("parts")[0].key != second.of("parts")[0].key


def test_wavelengths_that_are_swept_reach_a_probe():
    """The scene stands far in front of the stages that are looked at."""
    assert plan_of({"sweep.scene.wavelength_to": ["600 nm", "700 nm"]}, tail="parts").node("parts").axes == (
        "scene_wavelength_to",
    )


def test_an_alternative_that_moves_light_reaches_what_looks_at_transfer_functions():
    """Behind a distortion no product is the camera: the cell in the sweep is the cell alone, in either order of the
    values.
    """
    for uses in (["falloff", "distortion"], ["distortion", "falloff"]):
        plan = plan_of({"sweep.falloff.use": uses, "wanted": ["resolution.mtf50"]}, tail="")
        assert plan.node("resolution").axes == ("falloff",)
        found = of(plan, arrays_of(plan), "resolution", "mtf50")
        assert [bool(np.isnan(one).all()) for one in found] == [use == "distortion" for use in uses]
    both = plan_of({"sweep.falloff.use": ["falloff", "vignetting"]}, tail="parts")
    assert both.node("parts").axes == ()  # neither moves light


def test_a_library_behind_a_looked_at_stage_is_part_of_the_key(monkeypatch):
    """The weights of the channels come from colour-science, though the probe itself asks it nothing."""
    before = plan_of(tail="parts").of("parts")[0].key
    for library in ("colour-science", "numpy", "scipy"):
        with monkeypatch.context() as patched:
            patched.setattr(
                "etendue.plan.expansion.recipes.version_of",
                lambda name, library=library: "another" if name == library else "this",
            )
            assert plan_of(tail="parts").of("parts")[0].key != before
            one = plan_of(tail="parts").of("parts")[0].key
            patched.setattr("etendue.plan.expansion.recipes.version_of", lambda name: "this")
            assert plan_of(tail="parts").of("parts")[0].key != one


def test_a_stage_whose_effect_is_left_out_is_still_looked_at():
    """Diffusion changes nothing in an even picture, and is part of the camera all the same."""
    plan = plan_of({"scene.use": "uniform", "camera.focal_length": "1 m"}, tail="parts")
    assert plan.of("diffusion")[0].left_out
    kept = arrays_of(plan)
    assert [row[0] for row in of(plan, kept, "parts", "parts")[0]] == [1, 2, 3]


def test_serial_and_parallel_give_the_same_bits():
    sweep = {"sweep.f_number": [2, 5.6], "sweep.pixel_pitch": ["2.0 um", "2.6 um"]}
    plan = plan_of(sweep, tail="restore parts sizes")
    first = arrays_of(plan)
    assert_same_arrays(first, arrays_of(plan, scheduler="threads", workers=3))


def test_only_a_probe_may_look_at_a_variable():
    with pytest.raises(RequestError, match="only a Probe may look at the variables"):
        plan_of(tail="nosy")


def test_a_probe_of_two_variables_has_all_their_stages_in_order_and_their_grids():
    plan = plan_of(tail="sizes")
    rows, step = (of(plan, arrays_of(plan), "sizes", v)[0] for v in ("rows", "step"))
    assert plan.of("sizes")[0].grids["rows"]["stage"].entries == ("pixel", "demosaic", "sharpen")
    assert rows.tolist() == [32, 32, 32]
    assert_allclose(step, 2.6, rtol=1e-6)


def seen_by(plan, alternative, cell):
    """What stands in the key of a cell of the transfer functions that it looks at, stage by stage."""
    recipes = Recipes(plan.cells, {node.name: node for node in plan.nodes}, 0, False, {})
    return recipes.looked_at(alternative, "transfers", [plan.cells[ref] for ref in dict(cell.looks_at)["transfers"]])[0]


def test_alternatives_may_differ_in_what_they_look_at():
    """`denoise` reads the picture alone, `restore` the transfer functions too; each is keyed by what it reads."""
    sweep = {"sweep.sharpen.use": ["denoise", "restore"]}
    plan, other = plan_of(sweep, tail=""), plan_of({**sweep, "diffusion.nodes": 2048}, tail="")
    looked = [dict(cell.looks_at) for cell in plan.of("sharpen")]
    assert looked[0] == {}
    assert [ref[0] for ref in looked[1]["transfers"]] == ["diffraction", "diffusion", "pixel"]
    mine, its = (seen_by(p, p.node("sharpen").alternatives[1], p.of("sharpen")[1]) for p in (plan, other))
    assert [a == b for a, b in zip(mine, its, strict=True)] == [True, False, True]
    assert len(of(plan, arrays_of(plan), "sharpen", "rgb_camera")) == 2


BRANCH = BARE.replace(
    'use = "mosaic"',
    """use = "pixel"
name = "ideal"
rows = 32
columns = 32
from = { irradiance = "falloff" }
[[stages]]
use = "mosaic"
from = { photon_rate = "pixel" }""",
)


def test_a_branch_is_the_product_of_its_own_stages():
    """The pixel that stands beside has no lens in front of it, and the picture behind the other has no such pixel."""
    plan = plan_of(tail="restore parts", text=BRANCH)
    arrays = arrays_of(plan)
    assert of(plan, arrays, "parts", "parts")[0][:, 0].tolist() == [1, 2, 3, 1]
    assert [ref[0] for ref in dict(plan.of("restore")[0].looks_at)["transfers"]] == [
        "diffraction",
        "diffusion",
        "pixel",
    ]


# -- what they are given ------------------------------------------------------------------------------------------

PIXEL = Pixel(pixel_pitch=3.0, aperture_offset_x=0.1, peak_qe=(0.36, 0.44, 0.40))
COMA = Wavefront(f_number=4.0, coma=0.4, field_x=2.0, field_y=1.0)


def otf_of(*stages, rendered=None):
    return Otf(tuple((str(i), stage) for i, stage in enumerate(stages)), EDGES, rendered)


@pytest.mark.parametrize("stages", [(PIXEL,), (COMA,), (Diffusion(),), (COMA, Diffusion(), PIXEL)])
def test_a_line_is_the_diagonal_of_a_plane(stages):
    """Radial stages are evaluated at the radius: 1e-9 of the cubic table of diffusion, on other nodes."""
    otf = otf_of(*stages)
    fy, fx = 0.3 * WIDE, 0.954 * WIDE
    assert_allclose(otf.along(fy, fx), np.diagonal(otf.plane(fy, fx), axis1=1, axis2=2), atol=1e-9)
    assert_allclose(otf.along(fy, 0 * fx), otf.plane(fy, np.zeros(1))[:, :, 0], atol=1e-9)
    assert_allclose(otf(fx), otf.plane(np.zeros(1), fx)[:, 0], atol=1e-9)


def test_a_product_is_that_of_its_parts_and_leaving_one_out_divides_it():
    whole = otf_of(COMA, Diffusion(), PIXEL)
    fy, fx = 0.5 * WIDE, 0.5 * WIDE
    assert_allclose(
        whole.without(["1"]).along(fy, fx) * otf_of(Diffusion()).along(fy, fx), whole.along(fy, fx), atol=1e-12
    )
    assert whole.without("1").parts == (whole.parts[0], whole.parts[2])
    assert whole.without([name for name, _ in whole.parts]).along(fy, fx).tolist() == np.ones((3, 80)).tolist()


def test_weights_are_known_from_the_pixel_on():
    assert otf_of(COMA).weights is None
    assert otf_of(COMA, PIXEL).weights.shape == (3, 3)


def test_the_rendering_of_a_scene_is_a_gaussian_and_a_box():
    """exp(-2 (pi s f)^2) and the mean over a cell; a scene that says nothing leaves everything."""
    both = otf_of(LensGaussian(sigma=1.0), rendered=(1.5, 0.0))
    assert_allclose(both.scene_along(np.zeros(3), WIDE[:3]), np.exp(-2 * (np.pi * 1.5 * WIDE[:3]) ** 2), rtol=1e-14)
    assert_allclose(
        otf_of(PIXEL, rendered=(0.0, 2.0)).scene_along(np.array([0.1]), np.array([0.2])),
        np.sinc(0.2) * np.sinc(0.4),
        rtol=1e-14,
    )
    assert otf_of(PIXEL).scene_along(WIDE, WIDE).tolist() == [1.0] * 80


def test_points_of_different_number_are_refused():
    with pytest.raises(ValueError):
        otf_of(PIXEL).along(np.zeros(3), np.zeros(4))
    with pytest.raises(ValueError, match="two lists"):
        otf_of(PIXEL).along(np.zeros((3, 1)), np.zeros((1, 3)))

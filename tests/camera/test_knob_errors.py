"""What a setting of a knob adds to its stage's output, rms over the picture, is no more than the stage states.

Against the reference setting, over scenes (noise, black and white patches, an edge, each as soft as chance has it),
grids and parameters drawn at random.
"""

import dataclasses
import inspect
import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from etendue.compute.tables import coordinates_of
from etendue.contract.arrays.facts import Facts
from etendue.contract.arrays.grid import Bands, Grid, Line
from etendue.contract.registry import installed_stages
from etendue.transfer import expansion, sampling
from etendue.transfer.products import Product
from etendue_camera.electronics.distributions import poisson_total_variation
from etendue_camera.optics import lens
from etendue_camera.scene import dead_leaves
from etendue_camera.sensor import crosstalk
from etendue_camera.sensor.stages.crosstalk import channel_kernels, tables_of
from etendue_camera.sensor.stages.masks import mask_of
from etendue_camera.sensor.stages.sensitivity import electrons_per_irradiance

LOAD = installed_stages().load
UNKNOWN = {"irradiance": Facts()}
QE = (0.36, 0.44, 0.40)


def light_on(random, bands=3, size=None):
    size, step = size or int(random.integers(24, 56)), float(10 ** random.uniform(-0.6, 0.6))
    edges = tuple(float(edge) for edge in np.linspace(400, 700, bands + 1))
    lines = [Line(n, -0.5 * (n - 1) * step, step) for n in (size, size + 5)]
    return Grid.of({"wavelength": Bands(edges), "y": lines[0], "x": lines[1]})


def scene(random, grid, softness=None):
    shape = grid.shape(("wavelength", "y", "x"))
    light, kind = random.uniform(size=shape), random.integers(3)
    if kind == 1:
        light = np.round(light)
    if kind == 2:
        y, x = np.mgrid[: shape[1], : shape[2]]
        turn = random.uniform(-0.4, 0.4)
        light = np.broadcast_to(
            np.cos(turn) * x + np.sin(turn) * y > random.uniform(0.3, 0.7) * shape[2], shape
        ).astype(float)
    width = random.uniform(0, 3) if softness is None else softness
    soft = gaussian_filter(light, (0, width, width), mode="mirror")
    return soft / soft.max()


def frequencies(grid):
    y, x = grid.line("y"), grid.line("x")
    return sampling.frequencies(y.size, y.step, half=False)[:, None], sampling.frequencies(x.size, x.step, half=True)[
        None
    ]


def filtered(light, transfer, grid):
    return sampling.planes_of(sampling.transform(light) * transfer, grid.line("y").size, grid.line("x").size)


def blurred(stage, light, grid):
    made = stage.prepare(coordinates_of({"light": grid}))
    return filtered(light, Product((stage,), grid.bands().edges, lambda *_: made).at(*frequencies(grid)), grid)


def done(stage, light, grid):
    known = coordinates_of({"light": grid})
    given = {"irradiance": light, "prepared": stage.prepare(known), **known}
    return stage.run(**{name: given[name] for name in inspect.signature(type(stage).run).parameters if name != "self"})[
        "irradiance"
    ]


def stated(stage, facts, grids):
    return stage.error(facts, grids, "float64")[0]


def share(found, reference, bound):
    """Of the bound that the true error takes."""
    return float(np.sqrt(np.mean((found - reference) ** 2)) / np.abs(reference).max() / bound)


def diffusion_nodes(random):
    grid, nodes = light_on(random, size=70), int(random.choice([64, 128, 256, 512]))
    stage = LOAD("diffusion")(
        depletion_depth=float(10 ** random.uniform(-1.5, 1)),
        diffusion_depth=float(10 ** random.uniform(-0.5, 2)),
        diffusion_length=float(10 ** random.uniform(0, 3)),
        back=str(random.choice(["absorbing", "reflecting"])),
        nodes=nodes,
    )
    light = scene(random, grid)
    exact = blurred(dataclasses.replace(stage, nodes=0), light, grid)
    return share(blurred(stage, light, grid), exact, stated(stage, UNKNOWN, {"irradiance": grid}))


def lens_psf_nodes(random, folder):
    grid, radius = light_on(random), np.linspace(0, 10 ** random.uniform(0.3, 2.2), 40)
    psf = np.exp(-radius / 10 ** random.uniform(0, 1.5)) + 10 ** random.uniform(-4, -1)
    path = folder / f"{random.integers(1 << 40)}.csv"
    path.write_text("radius_um,psf\n" + "\n".join(f"{r},{p}" for r, p in zip(radius, psf, strict=True)))
    stage, light = LOAD("lens_psf")(file=str(path), nodes=int(random.choice([256, 1024, 4096]))), scene(random, grid)
    distinct, where = np.unique(np.hypot(*frequencies(grid)), return_inverse=True)
    exact = lens.radial_psf_otf(distinct, radius, psf)[where].reshape(np.hypot(*frequencies(grid)).shape)
    return share(
        blurred(stage, light, grid), filtered(light, exact, grid), stated(stage, UNKNOWN, {"irradiance": grid})
    )


def distortion_spline(random):
    grid, softness = light_on(random, size=48), float(random.uniform(0.7, 4))
    step, order, oversampling = grid.line("x").step, int(random.choice([1, 2, 3, 5])), int(random.choice([1, 2, 4]))
    strength = float(random.uniform(-0.05, 0.05))
    stage = LOAD("distortion")(k1=strength, reference_radius=0.034 * step, order=order, oversampling=oversampling)
    light = scene(random, grid, softness)
    exact = done(dataclasses.replace(stage, order=5, oversampling=8), light, grid)
    facts = {"irradiance": Facts(band_limit=math.sqrt(0.5 * math.log(100)) / (math.pi * softness * step))}
    return share(done(stage, light, grid), exact, stated(stage, facts, {"irradiance": grid}))


def wavefront_samples(random):
    grid, kind = light_on(random, bands=2, size=32), random.integers(3)
    odd = (
        {"zernike": tuple(float(v) for v in random.normal(size=8) * 0.05)},
        {"coma": float(random.uniform(0, 0.4)), "field_x": 2.0},
        {"aperture": "polygonal", "spherical": float(random.uniform(0, 0.5))},
    )[kind]
    stage = LOAD("wavefront")(
        f_number=float(10 ** random.uniform(0.1, 1.2)), pupil_samples=int(random.choice([32, 64])), **odd
    )
    light = scene(random, grid)
    exact = blurred(dataclasses.replace(stage, pupil_samples=256), light, grid)
    return share(blurred(stage, light, grid), exact, stated(stage, UNKNOWN, {"irradiance": grid}))


def leaves_oversampling(random):
    spacing = float(10 ** random.uniform(-0.3, 0.5))
    stage = LOAD("dead_leaves")(
        white_luminance=1000.0,
        width=32 * spacing,
        height=28 * spacing,
        spacing=spacing,
        smallest=float(spacing * random.uniform(1, 6)),
        largest=20 * spacing,
        softness=float(random.choice([0.5, 1, 2])),
        seed=int(random.integers(100)),
        oversampling=int(random.choice([1, 2, 4])),
    )
    known = coordinates_of({"light": stage.describe()[1]["radiance"]})

    def painted(cells):
        y, x = stage.centred(known["y"], known["x"])
        return dead_leaves.dead_leaves(y, x, stage.chart(), stage.softness_um(stage.softness), stage.cell, cells)

    tables = LOAD("uniform")(white_luminance=1000.0).error(None, None, "float64")[0]
    return share(painted(stage.oversampling), painted(32), stated(stage, None, None) - tables)


def crosstalk_kernels(random):
    edges, light = tuple(np.linspace(400.0, 700.0, 7)), scene(random, light_on(random, bands=1))[0]
    stage = LOAD("crosstalk")(
        crosstalk="through_filter",
        peak_qe=QE,
        pixel_pitch=float(10 ** random.uniform(0, 1.4)),
        beyond=float(random.choice([0.1, 0.03, 1e-2, 1e-3, 1e-5])),
        depletion_depth=float(10 ** random.uniform(-0.5, 0.5)),
        diffusion_depth=float(10 ** random.uniform(0, 2)),
        diffusion_length=float(10 ** random.uniform(0.5, 3)),
    )
    photons, tables = electrons_per_irradiance(stage, edges), tables_of(stage, edges)
    found, exact = (
        crosstalk.diffuse(light, channel_kernels(photons, tables, beyond), mask_of(stage.pattern), 0, 0)
        for beyond in (stage.beyond, 1e-14)
    )
    return share(found, exact, stated(stage, {}, {"white_irradiance": Grid.of({"wavelength": Bands(edges)})}))


def wavelength_terms(random):
    grid = light_on(random, bands=int(random.integers(8, 24)), size=32)
    edges, (fy, fx) = grid.bands().edges, frequencies(grid)
    before = (
        LOAD("diffraction")(f_number=float(10 ** random.uniform(0.1, 1.4))),
        LOAD("diffusion")(depletion_depth=1.0, diffusion_depth=float(10 ** random.uniform(0, 1.5))),
    )
    pitch, terms = grid.line("x").step * float(random.uniform(1, 5)), int(random.choice([3, 4, 5, 6]))
    stage = LOAD("pixel")(pixel_pitch=pitch, peak_qe=QE, wavelength_terms=terms)
    weights, product = electrons_per_irradiance(stage, edges), Product(before, edges)
    planes, place = scene(random, grid), np.linspace(0, 1, len(edges) - 1)
    if random.integers(2):  # two colours, narrow or wide, in place of noise over wavelength
        width = random.uniform(0.05, 0.5)
        planes = sum(
            planes[i : i + 1] * np.exp(-(((place - random.uniform()) / width) ** 2))[:, None, None] for i in range(2)
        )
    aperture, transfer = stage.transfer(fy, fx, None, None), product.at(fy, fx)
    exact = np.einsum("cl,lyx->cyx", weights, filtered(planes, transfer * aperture, grid))
    frequency = np.linspace(0, 0.5 * math.hypot(1 / grid.line("y").step, 1 / grid.line("x").step), expansion.FITTED)
    basis = expansion.band_basis(weights, terms, product.along(frequency), expansion.importance(frequency))
    own = expansion.coefficients(weights, basis, transfer.reshape(len(transfer), -1)).reshape(
        len(weights), terms, *transfer.shape[1:]
    )
    gathered = sampling.transform(np.einsum("kl,lyx->kyx", basis, planes))
    found = sampling.planes_of((own * gathered * aperture).sum(axis=1), grid.line("y").size, grid.line("x").size)
    return share(found, exact, stage.segment_error(before, UNKNOWN, {"irradiance": grid}, "float64")[0])


KNOBS = {
    "diffusion.nodes": (diffusion_nodes, 4, 100),
    "lens_psf.nodes": (lens_psf_nodes, 6, 100),
    "distortion": (distortion_spline, 8, 200),
    "wavefront.pupil_samples": (wavefront_samples, 3, 60),
    "dead_leaves.oversampling": (leaves_oversampling, 3, 60),
    "crosstalk.beyond": (crosstalk_kernels, 8, 100),
    "pixel.wavelength_terms": (wavelength_terms, 8, 200),
}


def shares(name, seed, count, folder):
    draw, random = KNOBS[name][0], np.random.default_rng(seed)
    given = (folder,) if "folder" in inspect.signature(draw).parameters else ()
    return np.array([draw(random, *given) for _ in range(count)])


@pytest.mark.parametrize("name", KNOBS)
def test_no_setting_adds_more_than_its_stage_states(name, tmp_path):
    assert shares(name, 1, KNOBS[name][1], tmp_path).max() <= 1


@pytest.mark.long
@pytest.mark.parametrize("name", KNOBS)
def test_one_scene_in_a_hundred_may_add_more(name, tmp_path):
    """Bounds that are fitted hold for all but a hundredth of scenes and parameters."""
    assert np.mean(shares(name, 2, KNOBS[name][2], tmp_path) > 1) <= 0.01


@pytest.mark.parametrize("exact_below", [10.0, 30.0, 100.0, 300.0])
def test_the_form_of_the_draw_is_as_near_to_poisson_as_it_states(exact_below):
    stage = LOAD("shot_noise")(exact_below=exact_below)
    means = exact_below * np.array([1.0, 1.1, 1.5, 3.0])
    assert max(poisson_total_variation(float(mean), exact_below) for mean in means) <= stated(stage, {}, {})

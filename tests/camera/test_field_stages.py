"""Field-dependent stages inside a pipeline: blur from a file, distortion, lateral colour. In: small pipelines."""

import math

import numpy as np
import pytest

import etendue
from etendue.api import Bands, Facts, Grid, Line
from etendue_camera.field.psf_bank import PsfBank
from etendue_camera.field.stages.blur import Distortion, LensPsfField


def pipeline(*stages, chart="points", scene=None, **more):
    light = {
        "white_luminance": 100,
        "width": 120,
        "height": 90,
        "spacing": 1.0,
        "bin_width": 100,
        "wavelength_from": 450,
        "wavelength_to": 650,
    }
    return {
        "name": "field",
        "precision": "float64",
        "camera": {},
        "stages": [{"use": chart, "name": "scene", **light, **(scene or {})}, {"use": "irradiance"}, *stages],
        **more,
    }


def light_of(document):
    tree = etendue.simulate(document)
    return tree[document["stages"][-1]["use"]].irradiance


@pytest.fixture(scope="module")
def bank_file(tmp_path_factory):
    """Spots whose width and tail grow with height and wavelength."""
    step = np.arange(-9, 10) * 1.0
    y, x = step[:, None], step[None, :]
    heights, wavelengths = np.array([0.0, 60.0, 120.0]), np.array([0.45, 0.65])

    def spot(h, w):
        h = h / 120
        return np.exp(-0.5 * (((y - 0.5 * h) / (1 + w + 0.5 * h**2)) ** 2 + (x / (1 + w)) ** 2)) * (1 + 0.05 * h * y)

    path = tmp_path_factory.mktemp("bank") / "bank.npz"
    PsfBank(heights, wavelengths, [[spot(h, w) for w in wavelengths] for h in heights], 1.0, "made for a test").save(
        path
    )
    return str(path)


def test_every_point_of_a_scene_keeps_its_flux_behind_the_lens(bank_file):
    points = {"pitch": 40.0, "spot_sigma": 1.5, "background": 0.0}
    sharp = light_of(pipeline(scene=points))
    blurred = light_of(pipeline({"use": "lens_psf_field", "file": bank_file}, scene=points))
    y, x = (sharp[dim].values for dim in ("y", "x"))
    near = sharp.values.max(axis=0) > 0.9 * sharp.values.max()
    checked = 0
    for row, column in np.argwhere(near):
        box = (slice(None), slice(row - 17, row + 18), slice(column - 17, column + 18))
        if row < 17 or column < 17 or row + 18 > y.size or column + 18 > x.size:
            continue
        # what neighbouring points, 40 samples away, send into the box and this one out of it
        np.testing.assert_allclose(blurred.values[box].sum(axis=(1, 2)), sharp.values[box].sum(axis=(1, 2)), rtol=1e-4)
        checked += 1
    assert checked >= 2


def test_a_uniform_scene_behind_image_weights_and_distortion_is_left_as_it_is(bank_file):
    document = pipeline(
        {"use": "distortion", "k1": -0.05, "reference_radius": 0.1},
        {"use": "lens_psf_field", "file": bank_file, "weights": "image"},
        chart="uniform",
    )
    tree = etendue.simulate(document)
    np.testing.assert_array_equal(tree["lens_psf_field"].irradiance.values, tree["irradiance"].irradiance.values)


def test_lateral_colour_moves_red_and_blue_apart_by_what_it_says():
    colour = 0.04  # for 100 nm: the two bands stand 50 nm to either side of the reference
    scene = {"pitch": 45.0, "spot_sigma": 2.0, "background": 0.0}
    document = pipeline({"use": "distortion", "lateral_colour": colour}, scene={**scene, "width": 240, "height": 180})
    plain = light_of(pipeline(scene={**scene, "width": 240, "height": 180}))
    moved = light_of(document)
    y, x = (plain[dim].values for dim in ("y", "x"))
    yy, xx = np.meshgrid(y, x, indexing="ij")

    def place(plane, near):
        weight = plane * (np.hypot(yy - near[0], xx - near[1]) < 12)
        return np.array([(weight * yy).sum(), (weight * xx).sum()]) / weight.sum()

    rows, columns = np.nonzero(plain.values[0] > 0.95 * plain.values[0].max())
    for row, column in list(zip(rows, columns, strict=True)):
        here = np.array([y[row], x[column]])
        if np.abs(here / [90 - 20, 120 - 20]).max() > 1:
            continue
        true = place(plain.values[0], here)
        for plane, scale in zip(moved.values, (1 - 0.5 * colour, 1 + 0.5 * colour), strict=True):
            # centroids inside a window that cuts 1e-6 of a Gaussian
            np.testing.assert_allclose(place(plane, true * scale), true * scale, atol=0.02)


def test_a_table_and_its_coefficients_give_the_same_picture(tmp_path):
    ideal = np.linspace(0, 110, 45)
    path = tmp_path / "table.csv"
    real = ideal * (1 - 0.04 * (ideal / 100) ** 2)
    path.write_text(
        "ideal_um,550\n" + "\n".join(f"{a!r},{b!r}" for a, b in zip(ideal.tolist(), real.tolist(), strict=True))
    )
    chart = {"chart": "slanted_edge"}
    by_table = light_of(pipeline({"use": "distortion", "table": str(path)}, **chart))
    by_terms = light_of(pipeline({"use": "distortion", "k1": -0.04, "reference_radius": 0.1}, **chart))
    # the spline through 45 heights of a cubic is the cubic but for its end conditions
    np.testing.assert_allclose(by_table, by_terms, rtol=1e-6)
    with pytest.raises(ValueError, match="give only one of them"):
        Distortion(table=str(path), k1=0.1)


def test_what_changes_nothing_is_left_out():
    facts, grid = (
        Facts(uniform=False),
        Grid.of({"wavelength": Bands((500.0, 600.0)), "y": Line(9, -4.0, 1.0), "x": Line(9, -4.0, 1.0)}),
    )
    assert Distortion().negligible(facts, grid) == (0.0, "nothing is displaced")
    assert Distortion(k1=0.1).negligible(facts, grid) is None
    assert Distortion(k1=0.1).negligible(Facts(uniform=True), grid)[0] == 0
    assert Distortion().error({"irradiance": facts}, {"irradiance": grid}, "float32")[0] == 0


def grids(half=60.0, edges=(450.0, 550.0, 650.0), cells=False):
    n = int(2 * half) + 1
    return {
        "irradiance": Grid.of(
            {"wavelength": Bands(edges), "y": Line(n, -half, 1.0, cells=cells), "x": Line(n, -half, 1.0, cells=cells)}
        )
    }


def test_the_plan_says_where_light_tables_and_pictures_end(bank_file, tmp_path):
    scene = Facts(uniform=False)
    assert LensPsfField(file=bank_file, weights="image").warn(scene, grids()) == []
    far = LensPsfField(file=bank_file, weights="image").warn(scene, grids(200.0, (350.0, 450.0)))
    assert any("ends 120 um from the axis, but the light extends to 282.8" in note for note in far)
    assert any("450 to 650 nm" in note for note in far)
    assert any("weights = 'image'" in note for note in LensPsfField(file=bank_file).warn(scene, grids()))
    assert Distortion(k1=0.02, reference_radius=0.1).warn(scene, grids()) == []  # pincushion looks inwards
    (note,) = Distortion(k1=-0.02, reference_radius=0.1).warn(scene, grids())
    assert "beyond the rendered light" in note
    ideal = float(Distortion(k1=-0.02, reference_radius=0.1).map().undistort(math.hypot(60, 60), 0.5)) / math.sqrt(2)
    assert f"extends {ideal - 60:.3g} um" in note
    assert any("order = 1" in n for n in Distortion(k1=0.02, reference_radius=0.1).warn(scene, grids(cells=True)))
    path = tmp_path / "short.csv"
    path.write_text("ideal_um,500,520\n10,10.1,10.1\n20,20.4,20.4\n")
    notes = Distortion(table=str(path)).warn(scene, grids())
    assert any("ends 20 um" in n for n in notes)
    assert any("500 to 520 nm" in n for n in notes)


def test_light_in_cells_and_samples_are_not_mixed_up(bank_file):
    with pytest.raises(ValueError, match="set light = 'cells'"):
        LensPsfField(file=bank_file).grid(grids(cells=True))
    with pytest.raises(ValueError, match="set light = 'bandlimited'"):
        LensPsfField(file=bank_file, light="cells").grid(grids())
    assert LensPsfField(file=bank_file).grid(grids()) == {}


def test_a_bank_that_changed_on_disk_is_read_again(bank_file, tmp_path):
    path = tmp_path / "bank.csv"
    PsfBank([0.0], [0.5], np.ones((1, 1, 5, 5)), 1.0).save(path)
    stage = LensPsfField(file=str(path))
    assert stage.bank().psf.shape == (1, 1, 5, 5)
    PsfBank([0.0], [0.5], np.ones((1, 1, 7, 7)), 1.0).save(path)
    assert stage.bank().psf.shape == (1, 1, 7, 7)


def test_bands_taken_one_by_one_are_those_of_the_whole(bank_file):
    stage = LensPsfField(file=bank_file, tolerance=0.02)
    line = np.arange(40) * 2.0
    known = {"y_um": line, "x_um": line - 30, "wavelength": np.array([480.0, 520.0, 600.0])}
    light = np.random.default_rng(0).random((3, 40, 40))
    for one in (stage, Distortion(k1=0.05, reference_radius=0.1, lateral_colour=0.01)):
        prepared = one.prepare(known)
        places = (known["y_um"], known["x_um"]) if isinstance(one, Distortion) else ()
        whole = one.run(light, *places, prepared)["irradiance"]
        for band in range(3):
            some = slice(band, band + 1)
            part = one.run(light[some], *places, one.by_band(prepared, some))["irradiance"]
            np.testing.assert_array_equal(part, whole[some])

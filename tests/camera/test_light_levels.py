"""How much light arrives, where: T-numbers, focus, tables, rims, glare, split light. In: small pipelines. Out:
ratios, lux.
"""

import math

import numpy as np
import pytest

import etendue
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.pipeline.file import from_document
from etendue.plan.planner import make_plan
from etendue_camera import spectra
from etendue_camera.field import illumination
from etendue_camera.light import radiometry
from etendue_camera.optics import focus


def document(*stages, scene=None, chart="uniform", wanted=None, precision="float64", **camera):
    """A scene, its irradiance, and stages given by name or as tables."""
    made = {
        "name": "light",
        "precision": precision,
        "camera": camera,
        "stages": [
            {
                "use": chart,
                "name": "scene",
                "white_luminance": 100,
                "width": 64,
                "height": 48,
                "bin_width": 100,
                "wavelength_from": 400,
                "wavelength_to": 700,
                **(scene or {}),
            },
            {"use": "irradiance"},
            *({"use": s} if isinstance(s, str) else s for s in stages),
        ],
    }
    return made | ({"wanted": wanted} if wanted else {})


def light(*stages, **how):
    """Irradiance behind the last stage, and the data set it stands in."""
    tree = etendue.simulate(document(*stages, **how))
    last = stages[-1] if stages else "irradiance"
    data = tree[last if isinstance(last, str) else last.get("name", last["use"])].to_dataset()
    return data.irradiance.values, data


def plan_of(made):
    return make_plan(from_document(made), installed_stages())


def radius(data):
    return np.hypot(data.y.values[:, None], data.x.values[None, :])


def test_a_white_surface_of_100_cd_per_m2_at_f4_is_measured_in_lux():
    for model, lux in (("aplanatic", math.pi * 100 / 64), ("flat_disc", math.pi * 100 / 65)):
        tree = etendue.simulate(
            document(
                "illuminance",
                scene={"wavelength_from": 380, "wavelength_to": 780, "bin_width": 10},
                f_number=4,
                aperture_model=model,
                illuminant="D65",
            )
        )
        # of the rendered wavelengths; products of means over bins of 10 nm: 8.2e-5 measured
        rendered = spectra.rendered_share("D65", 380, 780)
        np.testing.assert_allclose(tree["illuminance"].illuminance.values, lux * rendered, rtol=1e-4)
        np.testing.assert_allclose(
            tree["illuminance"].illuminance_grey.values, 0.18 * tree["illuminance"].illuminance.values, rtol=1e-13
        )


def test_a_t_number_replaces_f_number_and_transmittance():
    t_number = 2.8 / math.sqrt(0.64)
    by_loss, _ = light(f_number=2.8, transmittance=0.64)
    for model in ("aplanatic", "flat_disc"):  # the aperture's model is not asked
        by_number, _ = light(f_number=2.8, t_number=t_number, aperture_model=model)
        np.testing.assert_allclose(by_number, by_loss, rtol=1e-14)


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        ({"t_number": 4, "transmittance": 0.9}, "includes the lens losses already"),
        ({"t_number": 2, "f_number": 2.8}, "more light than it receives"),
        ({"magnification": -0.5, "focus_distance": 500}, "give only one of them"),
        ({"focus_distance": 5, "focal_length": 6.93}, "closer there is no real image"),
        (
            {
                "f_number": 0.5,
                "magnification": -0.1,
                "pupil_magnification": 1e-3,
                "t_number": 0,
                "aperture_model": "aplanatic",
            },
            None,
        ),
    ],
)
def test_a_camera_that_contradicts_itself_is_refused_before_anything_runs(camera, message):
    made = document(**camera)
    if message is None:
        plan_of(made)
        return
    with pytest.raises(RequestError, match=message):
        plan_of(made)


def test_every_stage_sees_the_magnification_of_the_focus():
    f, s = 25.0, 75.0
    m = float(focus.magnification_of(f, s))
    stages = (
        {"use": "falloff", "model": "disc"},
        {"use": "vignetting", "rim_radius": 8, "rim_distance": 9},
        "diffraction",
    )
    scene = {"width": 3000, "height": 2000, "spacing": 20}
    wanted = ["irradiance", "lens_numbers", "etendue"]
    by_focus = etendue.simulate(
        document(
            *stages,
            "lens_numbers",
            "pixel_etendue",
            scene=scene,
            wanted=wanted,
            focal_length=f,
            f_number=2,
            focus_distance=s,
        )
    )
    by_number = etendue.simulate(
        document(
            *stages,
            "lens_numbers",
            "pixel_etendue",
            scene=scene,
            wanted=wanted,
            focal_length=f,
            f_number=2,
            magnification=m,
        )
    )
    for stage in ("irradiance", "falloff", "vignetting", "diffraction"):
        np.testing.assert_allclose(by_focus[stage].irradiance.values, by_number[stage].irradiance.values, rtol=1e-14)
    one, other = by_focus["lens_numbers"], by_number["lens_numbers"]
    for name in ("working_f_number", "airy_diameter", "near_limit", "far_limit"):
        np.testing.assert_allclose(one[name].values, other[name].values, rtol=1e-13)
    assert one.working_f_number == pytest.approx(2 * (1 - m), rel=1e-14)


def test_a_focus_at_unit_magnification_gives_a_quarter_of_the_light():
    far, _ = light(f_number=4, focal_length=50)
    near, _ = light(f_number=4, focal_length=50, focus_distance=100)
    np.testing.assert_allclose(near / far, 0.25, rtol=1e-14)


def test_etendue_times_radiance_is_the_power_on_the_pixel():
    pixel = {"pixel_pitch": 3.0, "aperture_fraction": 0.5}
    for camera in ({"f_number": 1.4}, {"f_number": 8, "magnification": -0.7, "aperture_model": "flat_disc"}):
        tree = etendue.simulate(
            document("pixel_etendue", wanted=["irradiance", "etendue", "radiance"], **camera, **pixel)
        )
        power = tree["irradiance"].irradiance.values * 1.5**2  # um2
        by_etendue = tree["scene"].radiance.values * tree["pixel_etendue"]["etendue"].values
        np.testing.assert_allclose(by_etendue, power, rtol=1e-14)
    tree = etendue.simulate(document("pixel_etendue", f_number=0.5, **pixel))
    np.testing.assert_allclose(
        tree["pixel_etendue"].cone_half_angle.values, 90.0, rtol=1e-7
    )  # a half space; sin is flat there
    np.testing.assert_allclose(tree["pixel_etendue"]["etendue"].values, math.pi * 1.5**2, rtol=1e-14)


def test_fall_off_follows_the_exit_pupil():
    scene = {"width": 9000, "height": 6000, "spacing": 500}
    even, _ = light(scene=scene, f_number=2.0)
    for model, law in (
        ("cos4", lambda t: radiometry.cos4(t)),
        ("disc", lambda t: radiometry.disc_falloff(2.0, t, -0.2, 1.6)),
    ):
        stage = {"use": "falloff", "model": model}
        found, data = light(
            stage, scene=scene, f_number=2.0, focal_length=5, magnification=-0.2, pupil_magnification=1.6
        )
        even, _ = light(scene=scene, f_number=2.0, focal_length=5, magnification=-0.2, pupil_magnification=1.6)
        tangent = radius(data) / 1e3 / (5 * 1.8)
        np.testing.assert_allclose(found / even, np.broadcast_to(law(tangent), found.shape), rtol=1e-13)


def written(path, text):
    path.write_text(text)
    return str(path)


def test_a_table_of_relative_illumination_is_met_at_its_rows_and_divided_by_its_centre(tmp_path):
    table = written(tmp_path / "ri.csv", "height_mm,ratio  # measured\n0,0.98\n1.5,0.49\n2,0.294\n4,0.2\n")
    stage = {"use": "falloff", "model": "table", "table": table}
    scene = {"width": 4100, "height": 100, "spacing": 100}
    found, data = light(stage, scene=scene)
    even, _ = light(scene=scene)
    ratio = (found / even)[0]
    np.testing.assert_allclose(
        ratio, np.broadcast_to(np.interp(radius(data) / 1e3, [0, 1.5, 2, 4], [1, 0.5, 0.3, 0.2 / 0.98]), ratio.shape)
    )
    x = data.x.values
    np.testing.assert_allclose(ratio[0, np.isclose(x, 1500)], 0.5, rtol=1e-13)
    plan = plan_of(document(stage, scene=scene))
    assert any("0.98 on axis, not 1" in text for text in plan.warnings)
    beyond = plan_of(document(stage, scene={**scene, "width": 12000}))
    assert any("ends at 4, but the frame corner is at" in text for text in beyond.warnings)


def test_a_table_by_angle_and_wavelength_is_straight_between_its_columns(tmp_path):
    table = written(tmp_path / "ri.csv", "angle_deg,450,650\n0,1,1\n45,0.4,0.8\n60,0.2,0.4\n")
    stage = {"use": "falloff", "model": "table", "table": table}
    scene = {"width": 4100, "height": 100, "spacing": 100}
    found, data = light(stage, scene=scene, focal_length=1.5)
    even, _ = light(scene=scene)
    edge = np.isclose(data.x.values, 1500)  # tan = 1
    middle = (found / even)[:, 0, edge][:, 0]
    assert data.wavelength.values.tolist() == [450, 550, 650]
    np.testing.assert_allclose(middle, [0.4, 0.6, 0.8], rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("radius,ratio\n0,1\n1,1\n", "expected a header 'height_mm,ratio'"),
        ("height_mm,ratio\n0,1\n0,0.5\n", "line 3: height_mm 0 must be greater than 0"),
        ("height_mm,ratio\n0,1\n1,x\n", "line 3: expected 2 finite numbers"),
        ("height_mm,ratio\n0,1\n1,-0.1\n", "ratios must not be negative"),
        ("height_mm,ratio\n1,1\n2,0.5\n", "a row at height_mm 0 .* is required"),
        ("height_mm,650,450\n0,1,1\n2,0.5,0.5\n", "must be named by ascending wavelengths in nm"),
        ("height_mm,ratio\n0,1\n", "at least two are required"),
    ],
)
def test_a_broken_table_is_named_with_its_line(tmp_path, text, message):
    stage = {"use": "falloff", "model": "table", "table": written(tmp_path / "ri.csv", text)}
    with pytest.raises(RequestError, match=message):
        plan_of(document(stage))


def test_a_table_without_its_model_and_a_model_without_its_table_are_refused(tmp_path):
    table = written(tmp_path / "ri.csv", "height_mm,ratio\n0,1\n1,0.5\n")
    for stage in ({"use": "falloff", "table": table}, {"use": "falloff", "model": "table"}):
        with pytest.raises(RequestError, match="with model = 'table'"):
            plan_of(document(stage))


def test_stopping_down_opens_a_vignetted_corner():
    scene = {"width": 4000, "height": 3000, "spacing": 250}
    stage = {"use": "vignetting", "rim_radius": 3.5, "rim_distance": 6.0}
    even, _ = light(scene=scene, focal_length=5)
    wide, data = light(stage, scene=scene, focal_length=5, f_number=1)
    closed, _ = light(stage, scene=scene, focal_length=5, f_number=8)
    assert (closed / even * (4 * 8**2) / (4 * 2.8**2)).min() == pytest.approx(1.0, rel=1e-13)
    expected = illumination.vignetting(radius(data) / 5e3, 2.5, 3.5, 6.0)
    np.testing.assert_allclose(wide / even / 2.8**2, np.broadcast_to(expected, wide.shape), rtol=1e-12)
    assert expected.min() < 0.8
    with pytest.raises(RequestError, match="aperture stop"):
        plan_of(document(stage, focal_length=5, f_number=0.7))


def test_a_sensor_made_for_the_lens_sees_it_everywhere_as_on_the_axis():
    scene = {"width": 4000, "height": 3000, "spacing": 250}
    even, data = light(scene=scene)
    off, _ = light({"use": "angular_response", "power": 2, "exit_pupil_distance": 4}, scene=scene)
    height = radius(data) / 1e3
    np.testing.assert_allclose(off / even, np.broadcast_to(np.cos(np.arctan(height / 4)) ** 2, off.shape), rtol=1e-13)
    # a linear profile that meets the lens at one of the samples
    place = np.isclose(height, height[6, 3])
    slope = math.degrees(math.atan(height[6, 3] / 4)) / height[6, 3]
    matched, _ = light(
        {"use": "angular_response", "power": 2, "exit_pupil_distance": 4, "microlens_shift": slope}, scene=scene
    )
    assert (matched / even).min() > 0.99 > 0.8 > (off / even).min()
    np.testing.assert_allclose((matched / even)[:, place], 1.0, rtol=1e-13)
    telecentric, _ = light({"use": "angular_response", "power": 2, "exit_pupil_distance": "inf"}, scene=scene)
    np.testing.assert_allclose(telecentric, even, rtol=1e-15)


def test_a_response_measured_on_one_side_serves_both_and_one_on_both_sides_each(tmp_path):
    scene = {"width": 4000, "height": 100, "spacing": 250}
    even, data = light(scene=scene)
    # height at which the lens's angle is 3 degrees more than the sensor's: found from the profile itself
    profile = {"exit_pupil_distance": 4, "microlens_shift": 20.0}
    angle = np.degrees(np.arctan(radius(data) / 4e3)) - 20.0 * radius(data) / 1e3
    assert angle.min() < -5
    for name, text, where in (
        ("one", "angle_deg,ratio\n0,1\n30,0.7\n", np.abs(angle)),
        ("both", "angle_deg,ratio\n-30,0.4\n0,1\n30,0.7\n", angle),
    ):
        table = written(tmp_path / f"{name}.csv", text)
        found, _ = light({"use": "angular_response", "table": table, **profile}, scene=scene)
        rows = np.loadtxt(table, delimiter=",", skiprows=1).T
        np.testing.assert_allclose(found / even, np.broadcast_to(np.interp(where, *rows), found.shape), rtol=1e-13)


POINTS = {
    "chart": "points",
    "scene": {"pitch": 30, "spot_sigma": 2, "spacing": 1, "background": 0.0, "width": 96, "height": 64},
}


def test_glare_lifts_black_and_leaves_a_uniform_scene_alone():
    clean, _ = light(**POINTS)
    veiled, _ = light({"use": "glare", "veil": 0.04}, **POINTS)
    dark = clean < 1e-9 * clean.max()
    level = veiled[:, dark[0]].mean(axis=1)
    # the veil is the mean of the padded frame, whose mirrored surroundings hold as much light as the frame to some per
    # cent
    np.testing.assert_allclose(level, 0.04 * clean.mean(axis=(1, 2)), rtol=0.2)
    # the points are Gaussian: what lies below 1e-9 of the peak is not yet 0
    np.testing.assert_allclose(veiled - 0.96 * clean, np.broadcast_to(level[:, None, None], clean.shape), rtol=1e-6)
    uniform, _ = light({"use": "glare", "veil": 0.04, "fraction": 0.1})
    np.testing.assert_array_equal(uniform, light()[0])


def test_a_tail_reaches_the_black_beside_a_bright_half():
    edge = {
        "chart": "slanted_edge",
        "scene": {"low": 0.0, "high": 1.0, "angle": 0, "width": 400, "height": 60, "spacing": 1, "softness": 0},
    }
    clean, data = light(**edge)
    assert clean.min() == 0
    found, _ = light({"use": "glare", "fraction": 0.1, "radius": 5}, **edge)
    row = found[1, 30] / clean[1].max()
    bright = clean[1, 30] > 0.5 * clean[1].max()
    # beyond an edge a cubic tail leaves 1/2 - atan(d/r0)/pi of itself: the line spread r0/(pi (r0^2 + x^2)), integrated
    x = data.x.values
    far = np.abs(x[~bright])
    chosen = (far > 3) & (far < 40)
    expected = 0.1 * (0.5 - np.arctan(far[chosen] / 5) / math.pi)
    # 400 um of edge and its mirror images: the tail that comes back from the far side is 0.1 x 5/(pi 200)
    np.testing.assert_allclose(row[~bright][chosen], expected, atol=0.1 * 5 / (math.pi * 150))
    assert chosen.sum() > 30


def test_split_light_is_the_mean_of_its_copies():
    clean, _ = light(**POINTS)
    split, _ = light({"use": "birefringent", "separation_y": "2 um", "separation_x": "4 um"}, **POINTS)
    copies = [np.roll(clean, (dy, dx), (1, 2)) for dy in (-1, 1) for dx in (-2, 2)]
    inside = np.s_[:, 4:-4, 4:-4]  # what a roll brings around the border is not what the scene continues with
    np.testing.assert_allclose(split[inside], np.mean(copies, axis=0)[inside], atol=1e-14 * clean.max())


def test_split_light_with_dispersion_splits_each_band_by_its_own_distance(tmp_path):
    table = written(
        tmp_path / "scale.csv", "wavelength_nm,scale\n400,0.5\n500,0.5\n500.001,1\n600,1\n600.001,1.5\n700,1.5\n"
    )
    split, _ = light({"use": "birefringent", "separation_x": "4 um", "dispersion": table}, **POINTS)
    clean, _ = light(**POINTS)
    inside = np.s_[4:-4, 6:-6]
    for band, shift in enumerate((1, 2, 3)):
        expected = 0.5 * (np.roll(clean[band], -shift, 1) + np.roll(clean[band], shift, 1))
        # the table steps within 0.001 nm of a bin of 100 nm
        np.testing.assert_allclose(split[band][inside], expected[inside], atol=2e-5 * clean.max())


def test_what_does_nothing_is_left_out():
    stages = ("vignetting", "angular_response", "glare", "birefringent")
    plan = plan_of(document(*stages, **POINTS))
    assert all(cell.left_out is not None and cell.left_out.bound == 0 for name in stages for cell in plan.of(name))
    # the camera's own pupils: nothing is assumed of the sensor
    numbers = etendue.simulate(document("lens_numbers", focal_length=50, f_number=8, focus_distance=3000))[
        "lens_numbers"
    ]
    near, far = focus.depth_of_field(50.0, 8.0, 0.005, 3000.0)
    np.testing.assert_allclose([numbers.near_limit, numbers.far_limit], [near, far], rtol=1e-14)
    endless = etendue.simulate(document("lens_numbers", focal_length=5, f_number=8, focus_distance=3000))[
        "lens_numbers"
    ]
    assert math.isinf(float(endless.far_limit))
    assert float(endless.hyperfocal_distance) < 3000


def test_filters_follow_one_another_and_a_table_in_per_cent_is_refused(tmp_path):
    table = written(tmp_path / "t.csv", "wavelength_nm,transmission\n390,0.5\n710,0.5\n")
    one, _ = light({"use": "optical_filter", "table": table})
    both, data = light(
        {"use": "optical_filter", "name": "first", "table": table},
        {"use": "optical_filter", "name": "second", "cut_off": 550, "edge": 20},
    )
    np.testing.assert_allclose((both / one)[:, 0, 0], 1 / (1 + np.exp((data.wavelength.values - 550) / 10)), rtol=1e-13)
    wrong = written(tmp_path / "percent.csv", "wavelength_nm,transmission\n390,50\n710,50\n")
    with pytest.raises(etendue.errors.EtendueError, match="is it in per cent"):
        light({"use": "optical_filter", "table": wrong})

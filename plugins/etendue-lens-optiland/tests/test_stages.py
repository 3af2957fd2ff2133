"""The stages in a pipeline: what they do to light, and that they agree with each other."""

import numpy as np
import pytest

pytest.importorskip("optiland")

from etendue_lens_optiland.stages import Blur, Distortion, Illumination, Numbers
from numpy.testing import assert_allclose

from etendue.api import Bands, Facts, Grid, Line

CAMERA = {"f_number": 8.0}
EDGES = (440.0, 520.0, 600.0, 680.0)


def coordinates(size=61, step=2.0, centre_y=0.0):
    line = step * (np.arange(size) - size // 2)
    return {
        "y_um": line + centre_y,
        "x_um": line,
        "wavelength": np.array([480.0, 560.0, 640.0]),
        "wavelength_edges": np.array(EDGES),
    }


def test_a_point_keeps_its_flux_and_spreads_along_its_own_field():
    stage = Blur(**CAMERA, heights=3, pupil_samples=32, lost=0.1, focus="best")
    where = coordinates(size=101, step=1.0, centre_y=2800.0)
    light = np.zeros((3, 101, 101))
    light[:, 50, 50] = 1.0
    out = stage.run(light, stage.prepare(where))["irradiance"]
    # kernels have a sum of 1, and the frame holds them
    assert_allclose(out.sum(axis=(1, 2)), 1.0, rtol=1e-9)
    assert_allclose(
        out, out[:, :, ::-1], rtol=0, atol=1e-9 + 2e-3 * out.max()
    )  # across the meridian; tables are splines
    assert np.abs(out - out[:, ::-1]).max() > 0.01 * out.max()


def test_distortion_moves_a_spot_to_its_chief_ray_at_every_wavelength():
    stage = Distortion(**CAMERA)
    where, lens = coordinates(size=401, step=1.0, centre_y=2700.0), Distortion(**CAMERA).opened()
    tangent = 2690.0 / lens.image_distance_um
    y, x = where["y_um"], where["x_um"]
    spot = np.exp(-((y[:, None] - 2690.0) ** 2 + x[None, :] ** 2) / (2 * 6.0**2))
    out = stage.run(np.stack([spot] * 3), y, x, stage.prepare(where))["irradiance"]
    found = (out.sum(axis=2) @ y) / out.sum(axis=(1, 2))
    landed = [lens.chief(tangent, w * 1e-3)[1][0] for w in where["wavelength"]]
    # a spot of 6 um is drawn out a little by the slope of the distortion
    assert_allclose(found, landed, rtol=0, atol=0.02)
    assert found[2] - found[0] > 1.0  # lateral colour, um


def test_illumination_is_that_of_the_figures():
    fields = (0.0, 15.0, 22.0)
    figures = Numbers(**CAMERA, fields=fields, wavelengths=(480.0, 560.0, 640.0), pupil_samples=64).run()
    stage = Illumination(**CAMERA, wavelengths=(480.0, 560.0, 640.0))
    y = np.append(0.0, figures["image_height"][1:] * 1e3)
    where = coordinates() | {"y_um": y, "x_um": np.zeros(1)}
    out = stage.run(np.ones((3, 3, 1)), y, np.zeros(1), stage.prepare(where))["irradiance"]
    # a spline through 9 fields over heights at their own wavelengths
    assert_allclose(out[:, :, 0], figures["real_illumination"].T, rtol=1e-3)
    assert out[1, 2, 0] < 0.9


def test_figures_are_those_of_the_lens_in_its_own_units():
    found = Numbers(f_number=4.0, pupil_samples=64).run()
    assert_allclose(found["real_focal_length"], 6.93, rtol=1e-12)
    assert_allclose(found["back_focal_distance"] / 6.93, 1.18, atol=0.01)
    assert found["distortion"][0] == 0.0
    assert -2.0 < found["distortion"][2] < found["distortion"][1] < 0.0  # barrel
    assert_allclose(found["lateral_colour"][:, 1], 0.0, atol=1e-9)  # 550 nm is the reference
    assert_allclose(found["axial_f_number"], 4.0, rtol=0.02)
    assert ((found["strehl_ratio"] > 0) & (found["strehl_ratio"] <= 1)).all()


def test_light_of_another_kind_is_refused_before_anything_runs():
    lines = {dim: Line(9, -8.0, 2.0, cells=True) for dim in ("y", "x")}
    grid = {"irradiance": Grid.of({"wavelength": Bands(EDGES), **lines})}
    with pytest.raises(ValueError, match="set light = 'cells'"):
        Blur().grid(grid)
    assert Blur(light="cells").grid(grid) == {}


def test_a_frame_beyond_the_traced_fields_is_noted():
    lines = {"y": Line(9, 3000.0, 2.0), "x": Line(9, -8.0, 2.0)}
    grid = {"irradiance": Grid.of({"wavelength": Bands(EDGES), **lines})}
    facts = Facts(uniform=False)
    assert any("the last PSF is used" in note for note in Blur(f_number=8.0, fields=(0.0, 10.0)).warn(facts, grid))
    assert not Blur(f_number=8.0).warn(facts, grid)


def test_a_band_by_itself_is_what_it_is_among_others():
    where = coordinates(size=21)
    light = np.random.default_rng(1).uniform(0.1, 1.0, (3, 21, 21))
    y, x = where["y_um"], where["x_um"]
    for stage, more in (
        (Blur(**CAMERA, fields=(0.0, 22.0), pupil_samples=32, lost=0.2), ()),
        (Distortion(**CAMERA, nodes=6), (y, x)),
        (Illumination(**CAMERA, nodes=4, pupil_samples=32), (y, x)),
    ):
        prepared = stage.prepare(where)
        whole = stage.run(light, *more, prepared)["irradiance"]
        alone = stage.run(light[1:2], *more, stage.by_band(prepared, slice(1, 2)))["irradiance"]
        assert np.array_equal(alone, whole[1:2])

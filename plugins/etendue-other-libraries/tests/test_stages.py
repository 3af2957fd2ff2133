"""Codes are wrong by what is stated; the stages are ranked beside etendue's own in one command."""

import json
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.mosaic import bilinear
from etendue_camera.sensor import cfa

WHY = "is not installed: pip install plugins/etendue-other-libraries"
cv2 = pytest.importorskip("cv2", reason=f"OpenCV {WHY}")
pytest.importorskip("skimage", reason=f"scikit-image {WHY}")
pytest.importorskip("etendue_other_libraries", reason=f"the plugin {WHY}")

from etendue_other_libraries.codes import Codes  # noqa: E402
from etendue_other_libraries.from_opencv import Bilinear, EdgeAware, GradientNumber  # noqa: E402


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("largest", [1.0, 2.0, 30.0])
def test_codes_are_wrong_by_half_a_step_at_most_and_by_its_share_of_the_root_of_12_in_the_mean(bits, largest):
    codes = Codes(largest, bits)
    values = np.random.default_rng(1).uniform(-largest / 16, largest, 100_000)
    apart = codes.back(codes.of(values), float) - values
    assert np.abs(apart).max() <= 0.5 * codes.step * (1 + 1e-9)
    assert_allclose(apart.std(), codes.step / np.sqrt(12), rtol=0.01)  # 100,000 draws: 0.2 %
    assert_array_equal(codes.back(codes.of(np.array([-largest, 2 * largest])), float), [-largest / 16, largest])


@pytest.mark.parametrize("order", cfa.BAYER)
def test_opencv_s_bilinear_is_the_bilinear_one_within_its_stated_error(order):
    plane = np.random.default_rng(2).uniform(-0.05, 1.9, (33, 40))
    stage = Bilinear(pattern=order)
    found = stage.run(plane, np.arange(33.0), np.arange(40.0))["rgb_camera"]
    stated, _ = stage.error(None, None, "float64")
    apart = found - bilinear.bilinear(plane, order)
    assert np.sqrt((apart**2).mean()) < stated and np.abs(apart).max() < 2 * stated


@pytest.mark.parametrize("kind", [Bilinear, EdgeAware, GradientNumber])
def test_a_window_is_seen_through_the_mask_of_its_own_pixels(kind):
    colours = np.broadcast_to(np.array([0.9, 0.5, 0.2])[:, None, None], (3, 24, 24))
    stage = kind(pattern="RGGB")
    for row, column in ((0, 0), (1, 0), (5, 2), (3, 3)):
        plane = cfa.pick(colours, cfa.parse("RGGB"), row, column)
        found = stage.run(plane, row + np.arange(24.0), column + np.arange(24.0))["rgb_camera"]
        assert_allclose(found, colours, atol=Codes(stage.largest, stage.bits).step)


def test_what_cannot_be_demosaiced_is_refused_in_words():
    with pytest.raises(ValueError, match="X-Trans"):
        Bilinear(pattern="X-Trans")
    with pytest.raises(ValueError, match="not have two colours"):
        Bilinear(pattern="RGGB").run(np.zeros((1, 9)), np.zeros(1), np.arange(9.0))


AXES = {
    "demosaic.use=demosaic_bilinear,demosaic_directional,opencv_bilinear,opencv_edge_aware,opencv_vng": 5,
    'sharpen.use=sharpen,denoise,scipy_wiener,skimage_nl_means,{ use = "skimage_nl_means", sigma = 0.01, label = '
    '"sigma 1 %" }': 5,
    "sharpen.use=sharpen,richardson_lucy,skimage_richardson_lucy": 3,
}


@pytest.mark.parametrize("axis", AXES)
def test_they_are_ranked_beside_others_in_one_command(axis, tmp_path):
    """Also where the stage in their place writes optional figures that they have not."""
    (tmp_path / "small.toml").write_text(CAMERA)
    command = [
        sys.executable,
        "-m",
        "etendue",
        "compare",
        "small.toml",
        "--axis",
        axis,
        "--no-mtf50",
        "--repeat",
        "1",
        "--json",
        "-o",
        "o",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)["rows"]
    assert len(rows) == AXES[axis] and all(row["status"] == "done" and row["psnr"] > 15 for row in rows)


CAMERA = """
name = "small"
seed = 1
[camera]
peak_qe = [0.36, 0.44, 0.40]
f_number = 4
pixel_pitch = "4 um"
integration_time = "4 ms"
full_well_density = "2000 electron um-2"
[[stages]]
use = "composite"
name = "scene"
white_luminance = "1000 cd m-2"
width = "300 um"
height = "240 um"
spacing = "1 um"
wavelength_from = "400 nm"
wavelength_to = "700 nm"
bin_width = "100 nm"
""" + "".join(
    f'[[stages]]\nuse = "{use}"\n{more}'
    for use, more in (
        ("irradiance", ""),
        ("lens_gaussian", 'name = "lens"\nsigma = "1.5 um"\n'),
        ("pixel", "rows = 56\ncolumns = 70\n"),
        ("mosaic", ""),
        ("exposure", ""),
        ("shot_noise", ""),
        ("full_well", ""),
        ("read_noise", ""),
        ("adc", ""),
        ("linearise", ""),
        ("white", ""),
        ("balance_mosaic", ""),
        ("demosaic_bilinear", 'name = "demosaic"\n'),
        ("sharpen", ""),
        ("colour_fit", ""),
        ("camera_to_xyz", ""),
        ("balance", ""),
        ("display", ""),
        ("encode", ""),
    )
)

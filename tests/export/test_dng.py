"""A DNG is the frame to others: LibRaw reads the same digital numbers, mask, levels and white."""

from dataclasses import replace

import numpy as np
import pytest
import tifffile
from numpy.testing import assert_allclose

from etendue_camera.colour import matrices
from etendue_camera.export import dng
from etendue_camera.sensor import cfa

MATRIX = np.array([[0.62, 0.28, 0.05], [0.26, 0.79, -0.05], [0.01, -0.09, 1.17]])
WHITE = np.array([0.41, 0.70, 0.52])


def frame(mask="RGGB", shape=(64, 96), **changes):
    """A grey field, as bright as the sensor's own white makes it, with a little noise."""
    rng = np.random.default_rng(5)
    parsed = None if mask is None else cfa.parse(mask)
    level = 0.5 if parsed is None else 0.5 * WHITE[cfa.channel_index(parsed, *shape)]
    raw = np.rint(64 + level * (4095 - 64) + rng.normal(0, 3, shape)).astype(np.uint16)
    known = {"camera_white": WHITE, "balanced_to_xyz": MATRIX} if mask else {}
    made = dng.RawFrame(
        raw=raw, mask=parsed and parsed.rows, black=64, white_level=4095, illuminant="D65", model="test", **known
    )
    return replace(made, **changes)


@pytest.fixture
def rawpy():
    return pytest.importorskip("rawpy")


@pytest.mark.parametrize("mask", ["RGGB", "BGGR", "GRBG", "GBRG", "X-Trans"])
def test_libraw_reads_what_was_written(mask, tmp_path, rawpy):
    written = frame(mask, exposure=1 / 250, f_number=2.8, focal_length=6.93, iso=400)
    dng.write(tmp_path / "a.dng", written)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image, written.raw)
        np.testing.assert_array_equal(raw.raw_image_visible, written.raw)
        assert raw.black_level_per_channel == [64] * 4
        assert raw.white_level == 4095
        letters = np.array(list(raw.color_desc.decode()))[raw.raw_colors]
        parsed = cfa.parse(mask)
        np.testing.assert_array_equal(letters, np.array(parsed.channels)[cfa.channel_index(parsed, 64, 96)])
        assert_allclose(raw.camera_whitebalance[:3], WHITE.max() / WHITE, rtol=1e-6)  # float32, ratios of 32 bits
        assert raw.other.shutter_speed == pytest.approx(1 / 250)
        assert raw.other.aperture == pytest.approx(2.8)
        assert raw.other.focal_length == pytest.approx(6.93)
        assert raw.other.iso_speed == 400


@pytest.mark.parametrize("mask", ["RGGB", "X-Trans"])
def test_a_grey_field_comes_out_grey(mask, tmp_path, rawpy):
    dng.write(tmp_path / "a.dng", frame(mask, (528, 540)))  # LibRaw develops no X-Trans frame below 512 pixels
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        rgb = raw.postprocess(use_camera_wb=True, no_auto_bright=True, output_bps=16, gamma=(1, 1))
    mean = rgb[20:-20, 20:-20].mean(axis=(0, 1))
    assert_allclose(mean / mean[1], 1, atol=2e-3)  # 3 DN of noise over 300 pixels a side
    assert_allclose(mean[1] / 65535, 0.5 * WHITE.max(), rtol=5e-3)


def test_without_filters_it_is_a_monochrome_picture(tmp_path, rawpy):
    written = frame(None)
    dng.write(tmp_path / "a.dng", written)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        assert raw.num_colors == 1
        np.testing.assert_array_equal(raw.raw_image, written.raw)
        assert (raw.black_level_per_channel[0], raw.white_level) == (64, 4095)


def test_a_mask_libraw_does_not_understand_still_gives_the_numbers(tmp_path, rawpy):
    written = frame("quad-RGGB")
    dng.write(tmp_path / "a.dng", written)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image, written.raw)
    with tifffile.TiffFile(tmp_path / "a.dng") as file:
        tags = {tag.code: tag.value for tag in file.pages[0].tags}
    assert tags[33421] == (4, 4)
    assert list(tags[33422]) == [0, 0, 1, 1, 0, 0, 1, 1, 1, 1, 2, 2, 1, 1, 2, 2]


def test_the_colour_matrix_and_the_neutral_say_the_same_white():
    """A reader may take the white from AsShotNeutral, or from ColorMatrix1 and the white's chromaticity."""
    to_camera, forward = dng.colour_matrices(WHITE, MATRIX)
    white_xyz = MATRIX.sum(axis=1)
    assert_allclose(to_camera @ white_xyz, WHITE / WHITE.max(), rtol=1e-13)
    assert_allclose(
        forward.sum(axis=1), dng.D50_XYZ, rtol=1e-13
    )  # "a vector of ones to D50", as the specification asks
    assert_allclose(np.linalg.inv(to_camera) @ np.diag(WHITE / WHITE.max()), MATRIX, atol=1e-14)


def test_the_matrix_takes_any_camera_signal_to_its_xyz():
    """What a reader computes from the file is what the pipeline computed: camera over white, times the fitted
    matrix.
    """
    to_camera, _ = dng.colour_matrices(WHITE, MATRIX)
    camera = np.random.default_rng(2).uniform(0, 1, (20, 3))
    assert_allclose(np.linalg.solve(to_camera, (camera / WHITE.max()).T).T, (camera / WHITE) @ MATRIX.T, rtol=1e-12)


def test_ratios_hold_their_numbers():
    values = np.random.default_rng(3).uniform(-20, 20, 500)
    pairs = np.array(dng._ratios(values)).reshape(-1, 2)
    assert_allclose(pairs[:, 0] / pairs[:, 1], values, atol=1e-8)
    assert np.abs(pairs).max() < 2**31
    assert dng._ratios(64) == (64, 1)
    assert dng._ratios(0.008, dng.TOP) == (1, 125)


def test_forward_matrix_of_a_d50_scene_needs_no_adaptation():
    d50 = matrices.von_kries_matrix(MATRIX.sum(axis=1), dng.D50_XYZ, matrices.TRANSFORMS["bradford"]) @ MATRIX
    assert_allclose(dng.colour_matrices(WHITE, d50)[1], d50, atol=1e-14)


def test_two_writings_are_the_same_file(tmp_path):
    for name in ("a.dng", "b.dng"):
        dng.write(tmp_path / name, frame())
    assert (tmp_path / "a.dng").read_bytes() == (tmp_path / "b.dng").read_bytes()


@pytest.mark.parametrize(("light", "code"), [("D65", 21), ("D50", 23), ("A", 17), ("FL2", 255), ("3200 K", 255)])
def test_the_light_is_named_where_exif_has_a_name(light, code, tmp_path):
    dng.write(tmp_path / "a.dng", frame(illuminant=light))
    with tifffile.TiffFile(tmp_path / "a.dng") as file:
        assert file.pages[0].tags[50778].value == code


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"mask": ("RW", "GB")}, "filters W"),
        ({"mask": ("RG", "GR")}, "lacks one of R, G, B"),
        ({"mask": ("RGGGGGGGB",)}, "maximum is"),
        ({"camera_white": None}, "require a white"),
        ({"camera_white": np.array([0.4, 0.0, 0.5])}, "camera_white"),
        ({"balanced_to_xyz": np.ones((3, 3))}, "balanced_to_xyz"),
        ({"raw": np.zeros((4, 4))}, "raw is float64"),
        ({"black": 5000}, "black is 5000"),
    ],
)
def test_what_a_dng_cannot_say_is_refused(changes, match, tmp_path):
    with pytest.raises(ValueError, match=match):
        dng.write(tmp_path / "a.dng", replace(frame(), **changes))

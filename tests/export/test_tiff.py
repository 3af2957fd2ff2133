"""16-bit TIFF: digital numbers as they are, pictures of 0 to 1 to the nearest code."""

import numpy as np
import pytest
import tifffile

from etendue_camera.export import tiff


def test_digital_numbers_stay_what_they_are(tmp_path):
    raw = np.random.default_rng(1).integers(0, 65536, (31, 17)).astype(np.uint16)
    tiff.write(tmp_path / "a.tif", raw, "what it is")
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        np.testing.assert_array_equal(file.pages[0].asarray(), raw)
        assert file.pages[0].description == "what it is"
        assert file.pages[0].photometric == tifffile.PHOTOMETRIC.MINISBLACK


def test_a_picture_is_off_by_half_a_code_at_most(tmp_path):
    rgb = np.random.default_rng(2).uniform(0, 1, (3, 20, 30))
    tiff.write(tmp_path / "a.tif", rgb, srgb=True)
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        read = file.pages[0].asarray()
        assert file.pages[0].photometric == tifffile.PHOTOMETRIC.RGB
        assert 34675 in file.pages[0].tags  # the profile
    assert read.shape == (20, 30, 3)
    assert np.abs(np.moveaxis(read, -1, 0) / 65535 - rgb).max() <= 0.5 / 65535 * (1 + 1e-12)


def test_what_lies_outside_ends_at_the_ends():
    np.testing.assert_array_equal(tiff.codes(np.array([[-0.5, 0.0], [1.0, 7.0]])), [[0, 0], [65535, 65535]])


def test_the_profile_is_the_same_every_time_and_is_read():
    import io

    from PIL import ImageCms

    assert tiff.srgb_profile() == tiff.srgb_profile()
    assert "sRGB" in ImageCms.getProfileName(ImageCms.ImageCmsProfile(io.BytesIO(tiff.srgb_profile())))


@pytest.mark.parametrize(
    "picture", [np.zeros((2, 4, 4)), np.zeros(4), np.full((4, 4), np.nan), np.zeros((4, 4), np.uint32)]
)
def test_what_is_no_picture_is_refused(picture):
    with pytest.raises(ValueError, match="picture"):
        tiff.codes(picture)

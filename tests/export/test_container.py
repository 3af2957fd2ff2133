"""A TIFF file of our own making is one to others."""

import io

import numpy as np
import pytest
import tifffile

from etendue_camera.export import container

PLAIN = [(256, 4, 6), (257, 4, 4), (258, 3, 16), (259, 3, 1), (262, 3, 1), (277, 3, 1), (278, 4, 4)]


def test_samples_and_tags_of_every_type_are_read_back_by_tifffile():
    samples = np.arange(24, dtype=np.uint16).reshape(4, 6) * 2731
    tags = [
        *PLAIN,
        (271, container.ASCII, "maker"),
        (33421, container.SHORT, (2, 2)),
        (50706, container.BYTE, (1, 4, 0, 0)),
        (50714, container.RATIONAL, (513, 2)),
        (50721, container.SRATIONAL, (-1, 3, 5, 7, 9, 11)),
        (50829, container.LONG, (0, 0, 4, 6)),
    ]
    file = io.BytesIO()
    container.write_picture(
        file, samples.tobytes(), tags, [(34855, container.SHORT, 400), (33434, container.RATIONAL, (1, 250))]
    )
    file.seek(0)
    with tifffile.TiffFile(file) as tiff:
        page = tiff.pages[0]
        np.testing.assert_array_equal(page.asarray(), samples)
        found = {tag.code: tag.value for tag in page.tags}
    assert found[271] == "maker"
    assert found[33421] == (2, 2)
    assert bytes(found[50706]) == bytes((1, 4, 0, 0))
    assert found[50714] == (513, 2)
    assert found[50721] == (-1, 3, 5, 7, 9, 11)
    assert found[50829] == (0, 0, 4, 6)
    assert found[34665] == {"ISOSpeedRatings": 400, "ExposureTime": (1, 250)}
    assert list(found) == sorted(found)  # TIFF wants its tags in order


def test_a_tag_given_twice_is_refused():
    with pytest.raises(ValueError, match="271"):
        container.write_picture(io.BytesIO(), b"", [*PLAIN, (271, 2, "a"), (271, 2, "b")])

"""Zipper edges and false colour, on L*a*b*."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from etendue_camera.quality import artefacts


def _lab(seed, shape=(9, 11)):
    return np.random.default_rng(seed).uniform(0, 100, (3, *shape))


@given(seed=st.integers(0, 2**32 - 1))
def test_a_picture_has_no_artefacts_against_itself(seed):
    picture = _lab(seed)
    assert artefacts.zipper(picture, picture) == 0
    assert artefacts.false_colour(picture, picture) == 0


@given(seed=st.integers(0, 2**32 - 1), shift=st.floats(-20, 20))
def test_a_cast_over_the_whole_picture_is_no_zipper_but_its_size_in_false_colour(seed, shift):
    reference = _lab(seed)
    cast = reference + np.array([0, shift, 0.5 * shift])[:, None, None]
    assert artefacts.zipper(cast, reference) == 0
    assert_allclose(
        artefacts.false_colour(cast, reference), abs(shift) * np.sqrt(1.25), atol=1e-11
    )  # a weighted mean of one value


@given(seed=st.integers(0, 2**32 - 1))
def test_artefacts_turn_and_mirror_with_the_pictures(seed):
    picture, reference = _lab(seed), _lab(seed + 1)
    for turn in (lambda p: np.rot90(p, axes=(1, 2)), lambda p: p[:, ::-1], lambda p: p[:, :, ::-1]):
        assert artefacts.zipper(turn(picture), turn(reference)) == artefacts.zipper(picture, reference)
        # the order of the sums changes
        assert_allclose(
            artefacts.false_colour(turn(picture), turn(reference)),
            artefacts.false_colour(picture, reference),
            rtol=1e-12,
        )


def test_a_saw_tooth_along_an_edge_counts_its_pixels():
    # vertical edge between columns 5 and 6; every second pixel of column 6 is 10 darker: its most similar neighbour
    # (the reference is constant there) has no zipper, so the change of smallest size decides: for the odd pixels all
    # neighbours in the light half but two columns on are unchanged
    reference = np.zeros((3, 8, 12))
    reference[0, :, 6:] = 80
    picture = reference.copy()
    picture[0, ::2, 6] -= 10
    # a changed pixel differs by 10 from its unchanged neighbours; its like neighbours are two rows away, no neighbours
    # at all
    assert artefacts.zipper(picture, reference) == 4 / (8 * 12)
    assert artefacts.zipper(picture, reference, threshold=10) == 0


def test_only_the_most_similar_neighbour_is_looked_at():
    reference = np.zeros((1, 3, 3))
    reference[0] = [[0, 50, 90], [20, 21, 60], [70, 95, 40]]  # that of the middle pixel (21) is its left one (20)
    picture = reference.copy()
    picture[0, 0, 1] = 22  # now nearer still, and beside the point
    far = artefacts.zipper(picture[0], reference[0])
    picture[0, 1, 0] = 10
    assert artefacts.zipper(picture[0], reference[0]) > far


def test_blur_counts_only_where_falls_count():
    reference = np.zeros((1, 6, 6))
    reference[0] = 100 * (np.add.outer(np.arange(6), np.arange(6)) % 2) + 7 * np.arange(36).reshape(6, 6) % 11
    flat = np.full_like(reference, 50)
    assert artefacts.zipper(flat[0], reference[0]) > 0
    assert artefacts.zipper(flat[0], reference[0], falls=False) == 0


def test_false_colour_is_looked_for_where_there_is_detail():
    reference = np.zeros((3, 20, 20))
    reference[0, :, 10:] = 60
    at_edge, elsewhere = reference.copy(), reference.copy()
    at_edge[1, :, 9:11] = 12
    elsewhere[1, :, 2:4] = 12
    assert artefacts.false_colour(at_edge, reference) == 12
    assert artefacts.false_colour(elsewhere, reference) == 0


def test_the_finest_lines_are_detail():
    reference = np.zeros((3, 6, 6))
    reference[0, :, ::2] = 60  # a central difference sees nothing here
    picture = reference.copy()
    picture[2] = 5
    assert artefacts.false_colour(picture, reference) == 5


def test_a_flat_reference_gives_the_plain_mean_and_a_grey_one_no_colour():
    reference = np.full((3, 4, 4), 30.0)
    picture = reference.copy()
    picture[1, 0, 0] += 16
    assert artefacts.false_colour(picture, reference) == 1
    assert artefacts.false_colour(picture[0], reference[0]) == 0


def test_a_single_pixel_has_no_neighbour():
    assert artefacts.zipper(np.zeros((3, 1, 1)), np.ones((3, 1, 1))) == 0


def test_nonsense_is_refused():
    a = np.zeros((3, 4, 4))
    with pytest.raises(ValueError, match="picture has shape"):
        artefacts.zipper(a, a[:, :3])
    with pytest.raises(ValueError, match=r"picture has shape \(2, 4, 4\)"):
        artefacts.false_colour(np.zeros((2, 4, 4)), np.zeros((2, 4, 4)))
    with pytest.raises(ValueError, match="threshold is -1"):
        artefacts.zipper(a, a, threshold=-1)

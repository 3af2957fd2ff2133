"""A variable that is shown as a map: numbers over y and x as grey, by what its distribution says of it."""

import numpy as np
import pytest

from etendue.contract.arrays.drawn import Drawn
from etendue.contract.arrays.variables import Variable
from etendue.present.pictures.appearance import appearance

PLANE = np.array([[1.0, 10.0, 100.0], [np.nan, np.inf, 0.0]])


def mapped(plane, known):
    return appearance(Drawn.of(known), ("y", "x")).small(plane)


@pytest.mark.parametrize(
    ("words", "grey"),
    [
        ({"range": (0, 200)}, [[0.005, 0.05, 0.5], [np.nan, 1, 0]]),
        ({"range": (0, 10)}, [[0.1, 1, 1], [np.nan, 1, 0]]),
        ({}, [[0.01, 0.1, 1], [np.nan, 1, 0]]),
        ({"log": True}, [[0, 0.5, 1], [np.nan, 1, 0]]),
        ({"log": True, "range": (0.1, 1000)}, [[0.25, 0.5, 0.75], [np.nan, 1, 0]]),
    ],
)
def test_grey_goes_from_one_end_to_the_other_and_what_is_undefined_stays_so(words, grey):
    found = mapped(PLANE, Variable(shown="map", **words))
    np.testing.assert_allclose(found, [grey] * 3, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("plane", [np.full((2, 3), 7.0), np.full((2, 3), np.nan)])
def test_a_map_without_ends_is_of_one_grey(plane):
    assert len(np.unique(mapped(plane, Variable(shown="map")))) == 1

"""Transforms of stacks of planes: each plane as if it were alone, in little memory."""

import tracemalloc

import numpy as np
import pytest

from etendue.transfer import sampling


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("shape", [(1, 33, 48), (5, 1, 1), (40, 30, 47), (3, 400, 401)])
def test_a_stack_of_planes_is_transformed_as_each_plane_alone(shape, precision):
    planes = np.random.default_rng(3).random(shape).astype(precision)
    half = sampling.transform(planes)
    assert half.dtype == np.result_type(precision, np.complex64)
    assert np.array_equal(half, np.stack([sampling.transform(plane) for plane in planes]))
    back = sampling.planes_of(half, *shape[1:])
    assert back.dtype == planes.dtype and back.flags.c_contiguous
    assert np.array_equal(back, np.stack([sampling.planes_of(one, *shape[1:]) for one in half]))


def test_a_stack_of_planes_takes_little_memory_beside_its_result():
    planes = np.ones((32, 300, 300))
    for made in (sampling.transform, lambda stack: sampling.planes_of(stack, 300, 300)):
        tracemalloc.start()
        found = made(planes)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        # A plane is padded, transformed and copied: at most four of its transforms.
        assert found.nbytes <= peak < found.nbytes + 4 * found.nbytes / len(planes) + 2**20
        planes = found

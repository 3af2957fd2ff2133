"""Matrices against 60-digit arithmetic; whites that stay white; fits that find what is there."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.colour import matrices
from tests.physics.reference import extra

NAMES = {"Bradford": "bradford", "CAT02": "cat02", "VonKries_HPE_D65": "von_kries_hpe_d65"}
seeds = st.integers(0, 2**32 - 1)
whites = st.tuples(st.floats(0.2, 0.5), st.floats(0.25, 0.45)).map(matrices.xyz_from_xy)
transforms = st.sampled_from(sorted(matrices.TRANSFORMS))


def floats(rows):
    return np.array(rows, dtype=float)


@pytest.mark.parametrize(
    ("matrix", "name", "inverse"),
    [
        (matrices.RGB_TO_XYZ_PAL, "ebu_pal_bt470_625_RGB_to_XYZ", "its_inverse"),
        (matrices.RGB_TO_XYZ_SRGB, "bt709_RGB_to_XYZ", "bt709_inverse"),
        (matrices.EQ16_AS_PRINTED, None, "eq16_as_printed_inverse"),
        (matrices.EQ16_CORRECTED, None, "eq16_corrected(0.020)_inverse"),
    ],
)
def test_display_matrices_and_their_inverses_are_held(matrix, name, inverse):
    if name:
        assert_allclose(matrix, floats(extra("matrices")[name]), rtol=1e-14)
    assert_allclose(np.linalg.inv(matrix), floats(extra("matrices")[inverse]), rtol=1e-14 * 5)  # condition 4-5


def test_conditions_and_whites_of_the_display_matrices_are_held():
    reference = extra("matrices")
    conditions = {
        "ebu": matrices.RGB_TO_XYZ_PAL,
        "bt709": matrices.RGB_TO_XYZ_SRGB,
        "as_printed": matrices.EQ16_AS_PRINTED,
        "corrected": matrices.EQ16_CORRECTED,
    }
    for name, matrix in conditions.items():
        assert_allclose(np.linalg.cond(matrix), float(reference["cond2"][name]), rtol=1e-14)
    assert_allclose(matrices.EQ16_AS_PRINTED.sum(axis=1), floats(reference["white_XYZ_as_printed"]), rtol=1e-15)
    assert_allclose(matrices.EQ16_CORRECTED.sum(axis=1), floats(reference["white_XYZ_corrected"]), rtol=1e-15)


def test_the_corrected_equation_16_is_the_pal_matrix_to_three_digits():
    assert_array_equal(np.round(matrices.RGB_TO_XYZ_PAL, 3), matrices.EQ16_CORRECTED)
    assert_array_equal(np.argwhere(matrices.EQ16_AS_PRINTED != matrices.EQ16_CORRECTED), [[2, 0]])


@given(white=st.tuples(st.floats(0.25, 0.4), st.floats(0.25, 0.4)))
def test_equal_red_green_and_blue_are_the_white_of_the_display(white):
    matrix = matrices.rgb_to_xyz_matrix(matrices.SRGB_PRIMARIES_XY, white)
    assert_allclose(matrix @ np.ones(3), matrices.xyz_from_xy(white), rtol=0, atol=1e-14)


@pytest.mark.parametrize("case", extra("cat"), ids=lambda c: f"{c['method']} from {c['from_xy'][0]}")
def test_adaptation_matrices_are_held(case):
    source, target = (matrices.xyz_from_xy(tuple(map(float, case[k]))) for k in ("from_xy", "to_xy"))
    matrix = matrices.von_kries_matrix(source, target, matrices.TRANSFORMS[NAMES[case["method"]]])
    assert_allclose(matrix, floats(case["matrix"]), rtol=1e-14, atol=1e-300)


def test_the_cone_matrices_are_the_published_ones():
    for name, rows in extra("cat_raw_matrices").items():
        assert_array_equal(matrices.TRANSFORMS[NAMES[name]], floats(rows))
    # CAM16's rows are normalised so that the equal-energy white excites all cones alike
    assert_allclose(matrices.TRANSFORMS["cat16"].sum(axis=1), 1.0, atol=1e-6)


@given(source=whites, target=whites, name=transforms)
def test_adaptation_takes_one_white_to_the_other_and_back(source, target, name):
    cones = matrices.TRANSFORMS[name]
    assume(min((cones @ source).min(), (cones @ target).min()) > 0.05)
    matrix = matrices.von_kries_matrix(source, target, cones)
    back = matrices.von_kries_matrix(target, source, cones)
    # gains up to 1/0.05, condition of the cone matrices up to 4.5
    assert_allclose(matrix @ source, target, rtol=0, atol=1e-13)
    assert_allclose(back @ matrix, np.eye(3), rtol=0, atol=1e-12)
    assert_allclose(matrices.von_kries_matrix(source, source, cones), np.eye(3), rtol=0, atol=2e-15)


@pytest.mark.parametrize("white", [(0.95, 1.0, 0.0), (0.0, 0.0, 0.0), (0.1, 0.1, -1.0), (np.nan, 1.0, 1.0)])
def test_whites_that_leave_a_cone_dark_are_refused(white):
    cones, daylight = matrices.TRANSFORMS["von_kries_hpe_d65"], (0.95, 1.0, 1.09)
    with pytest.raises(ValueError, match=r"source_white_xyz .* all three cones"):
        matrices.von_kries_matrix(white, daylight, cones)
    with pytest.raises(ValueError, match=r"target_white_xyz .* all three cones"):
        matrices.von_kries_matrix(daylight, white, cones)


def test_singular_transforms_and_primaries_on_a_line_are_refused():
    with pytest.raises(ValueError, match="transform"):
        matrices.von_kries_matrix((1, 1, 1), (1, 1, 1), np.ones((3, 3)))
    with pytest.raises(ValueError, match="primaries_xy"):
        matrices.rgb_to_xyz_matrix([(0.6, 0.3), (0.4, 0.3), (0.2, 0.3)], matrices.D65_XY)
    with pytest.raises(ValueError, match="chromaticity"):
        matrices.rgb_to_xyz_matrix([(0.6, 0.3), (0.4, 0.0), (0.2, 0.1)], matrices.D65_XY)


@given(seed=seeds, rows=st.integers(1, 40), columns=st.integers(1, 40), dtype=st.sampled_from(["f4", "f8"]))
def test_a_matrix_acts_on_each_pixel_alone(seed, rows, columns, dtype):
    rng = np.random.default_rng(seed)
    matrix, planes = rng.normal(size=(3, 3)), rng.normal(size=(3, rows, columns)).astype(dtype)
    result = matrices.apply_matrix(matrix, planes)
    assert result.dtype == planes.dtype
    # three products of up to 10 or so, each rounded
    expected = np.tensordot(matrix, planes.astype(float), 1)
    assert_allclose(result, expected, rtol=0, atol=60 * np.finfo(dtype).eps)
    # bit for bit however the picture is cut
    cut = [matrices.apply_matrix(matrix, part) for part in np.array_split(planes, 3, axis=2)]
    assert_array_equal(np.concatenate(cut, axis=2), result)
    assert_array_equal(matrices.apply_matrix(matrix, planes[:, 0, 0]), result[:, 0, 0])


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="matrix has shape"):
        matrices.apply_matrix(np.eye(3), np.zeros((4, 2, 2)))
    with pytest.raises(ValueError, match="samples has shape"):
        matrices.fit_matrix(np.zeros((4, 3)), np.zeros((5, 3)))
    with pytest.raises(ValueError, match="both or neither"):
        matrices.fit_matrix(np.eye(3), np.eye(3), white_sample=(1, 1, 1))
    with pytest.raises(ValueError, match="span 2 of 3"):
        matrices.fit_matrix(np.eye(3)[[0, 1, 1]], np.eye(3))
    with pytest.raises(ValueError, match="NaN"):
        matrices.fit_matrix(np.eye(3) * np.nan, np.eye(3))
    with pytest.raises(ValueError, match="white_sample"):
        matrices.fit_matrix(np.eye(3), np.eye(3), (0, 0, 0), (1, 1, 1))


@given(seed=seeds, keep_white=st.booleans())
def test_a_fit_finds_the_matrix_that_made_the_targets(seed, keep_white):
    rng = np.random.default_rng(seed)
    matrix, samples, white = rng.normal(size=(3, 3)), rng.uniform(size=(24, 3)), np.array([0.6, 1.0, 0.8])
    pair = (white, matrix @ white) if keep_white else ()
    fit = matrices.fit_matrix(samples, samples @ matrix.T, *pair)
    assert_allclose(fit.matrix, matrix, rtol=0, atol=1e-13)  # condition of 24 random triples: below 20
    assert fit.residual < 1e-14
    condition = np.linalg.cond(fit.matrix)
    assert_allclose(fit.condition, condition, rtol=1e-14 * condition)  # two ways to round


@given(seed=seeds)
def test_a_kept_white_is_exact_and_costs_residual(seed):
    rng = np.random.default_rng(seed)
    samples, targets = rng.uniform(size=(24, 3)), rng.uniform(size=(24, 3))
    white, wanted = np.array([0.6, 1.0, 0.8]), np.array([0.95, 1.0, 1.09])
    free, held = matrices.fit_matrix(samples, targets), matrices.fit_matrix(samples, targets, white, wanted)
    assert_allclose(held.matrix @ white, wanted, rtol=0, atol=5e-15)
    assert held.residual >= free.residual
    # at the minimum the error is orthogonal to every change that is allowed
    error = samples @ free.matrix.T - targets
    assert_allclose(samples.T @ error, 0, atol=1e-12)
    plane = np.eye(3) - np.outer(white, white) / (white @ white)
    assert_allclose(plane @ samples.T @ (samples @ held.matrix.T - targets), 0, atol=1e-12)
    assert_allclose(free.residual, np.sqrt(np.mean(error**2)), rtol=1e-13)


@pytest.mark.parametrize("apart", [0.0, 1e-15, 1e-12, 1e-9])
def test_channels_that_are_alike_to_rounding_make_no_matrix_of_it(apart):
    """Three filters that see the same: what distinguishes them is rounding, and a matrix of 1/rounding would draw it
    in colours.
    """
    rng = np.random.default_rng(5)
    samples = rng.uniform(0.1, 1, (24, 1)) * np.ones(3) + apart * rng.normal(size=(24, 3))
    targets = samples @ rng.normal(size=(3, 3))
    for white in ((), (np.ones(3), np.ones(3))):
        with pytest.raises(ValueError, match="span"):
            matrices.fit_matrix(samples, targets, *white)


@pytest.mark.parametrize("apart", [1e-5, 1e-2])
def test_channels_that_differ_by_more_than_rounding_make_one_no_larger_than_they_need(apart):
    rng = np.random.default_rng(6)
    samples = rng.uniform(0.1, 1, (24, 1)) * np.ones(3) + apart * rng.normal(size=(24, 3))
    matrix = rng.normal(size=(3, 3))
    fit = matrices.fit_matrix(samples, samples @ matrix.T, np.ones(3), matrix @ np.ones(3))
    assert_allclose(fit.matrix, matrix, rtol=0, atol=1e-14 / apart)  # rounding over what tells the channels apart


def test_constants_cannot_be_written():
    for matrix in (matrices.RGB_TO_XYZ_PAL, matrices.EQ16_AS_PRINTED, *matrices.TRANSFORMS.values()):
        with pytest.raises(ValueError, match="read-only"):
            matrix[0, 0] = 0


def test_a_ridge_trades_residual_for_a_smaller_matrix_and_keeps_the_white():
    """Nearly equal channels: the free elements shrink steadily, the error grows steadily, white stays exact to
    rounding.
    """
    rng = np.random.default_rng(4)
    base = rng.uniform(0.1, 1, (24, 1))
    samples = base + 0.02 * rng.normal(size=(24, 3))
    targets = samples @ rng.normal(size=(3, 3)) + 0.01 * rng.normal(size=(24, 3))
    white, target = np.ones(3), np.array([0.95, 1.0, 1.09])
    fits = [matrices.fit_matrix(samples, targets, white, target, ridge=r) for r in (0, 1e-4, 1e-2, 1)]
    sizes, residuals = [np.linalg.norm(f.matrix) for f in fits], [f.residual for f in fits]
    assert all(a > b for a, b in itertools.pairwise(sizes))
    assert all(a < b for a, b in itertools.pairwise(residuals))
    for fit in fits:
        assert_allclose(fit.matrix @ white, target, rtol=1e-12)
    with pytest.raises(ValueError, match="ridge is -1"):
        matrices.fit_matrix(samples, targets, ridge=-1)


def test_channels_that_are_alike_share_what_one_channel_would_have():
    """The smallest matrix: equal columns for equal channels, grey exact, pictures those of the channels' mean."""
    rng = np.random.default_rng(3)
    grey, blue = rng.uniform(0.05, 1, (2, 24, 1))
    samples, targets = np.hstack([grey, grey, blue]), rng.uniform(0, 1, (24, 3))
    white = np.array([0.95, 1.0, 1.09])
    both = matrices.fit_matrix(samples, targets, np.ones(3), white, least=True)
    one = matrices.fit_matrix(samples[:, 1:], targets, np.ones(2), white)
    assert (both.undetermined, one.undetermined) == (1, 0)
    assert_allclose(both.matrix.sum(axis=1), white, rtol=1e-14)
    assert_allclose(both.matrix[:, 0], both.matrix[:, 1], atol=1e-13)
    assert_allclose(samples @ both.matrix.T, samples[:, 1:] @ one.matrix.T, atol=1e-12)

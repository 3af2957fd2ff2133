"""Linear colour: matrices between spaces, adaptation to a white, and fitted camera matrices.

In:  chromaticities, white points (XYZ), planes (3, y, x) of linear values, sample and target triples.
Out: 3 x 3 matrices and planes in the other space.
Sources: SMPTE RP 177 (matrix from primaries); von Kries with the cone matrices listed at `TRANSFORMS`; seed
paper eqs. 14 and 16. Everything here is for linear values; encodings are in `encoding.py`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue import require

Matrix = NDArray[np.float64]

D65_XY = (0.3127, 0.3290)
PAL_PRIMARIES_XY = ((0.64, 0.33), (0.29, 0.60), (0.15, 0.06))  # ITU-R BT.470-6 system B, G (625 lines), EBU
SRGB_PRIMARIES_XY = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))  # IEC 61966-2-1 and ITU-R BT.709
BLOCK = 1 << 14  # pixels whose temporaries stay in the cache
LEAST_SPAN = 1e-7  # of the samples' size: channels that differ by less count as equal


class MatrixFit(NamedTuple):
    """A fitted matrix, its rms error in the unit of the targets, its condition number, and the number of undetermined
    directions.
    """

    matrix: Matrix
    residual: float
    condition: float
    undetermined: int = 0


def rgb_to_xyz_matrix(primaries_xy: Sequence[tuple[float, float]], white_xy: tuple[float, float]) -> Matrix:
    """Return the matrix from linear display RGB to XYZ, with Y = 1 for white.

    Parameters
    ----------
    primaries_xy : three (x, y)
        Chromaticities of red, green, blue, not on one line; each y not 0.
    white_xy : (x, y)
        Chromaticity of R = G = B = 1; y not 0.

    Returns
    -------
    (3, 3) array

    Raises
    ------
    ValueError
        If a y is 0 or the three primaries are collinear.

    Notes
    -----
    Source: SMPTE RP 177. Error: below 2e-15 relative per element (BT.470 and BT.709 against 60-digit
    arithmetic).
    """
    primaries = np.stack([xyz_from_xy(xy) for xy in primaries_xy], axis=1)
    require.allowed(
        primaries.shape == (3, 3) and not np.linalg.cond(primaries) > 1e12,
        "primaries_xy",
        primaries_xy,
        "three chromaticities not on one line",
    )
    return primaries * np.linalg.solve(primaries, xyz_from_xy(white_xy))


def xyz_from_xy(xy: tuple[float, float]) -> NDArray:
    """Return XYZ of a chromaticity at Y = 1, shape (3,); raise ValueError if y is 0."""
    x, y = xy
    require.only(abs(y) > 0, "chromaticity", repr(xy), "y other than 0")
    return np.array([x / y, 1.0, (1 - x - y) / y])


def von_kries_matrix(source_white_xyz: ArrayLike, target_white_xyz: ArrayLike, transform: ArrayLike) -> Matrix:
    """Return the matrix on XYZ that maps one white to another by three gains on cone responses.

    Parameters
    ----------
    source_white_xyz, target_white_xyz : (3,) array
        XYZ of the scene white and of the display white, same scale.
    transform : (3, 3) array
        XYZ to cone responses; see `TRANSFORMS`.

    Returns
    -------
    (3, 3) array
        M^-1 diag(target / source) M; the identity if the whites are equal.

    Raises
    ------
    ValueError
        If a cone response of a white is below 1e-9 of the largest, or the transform is singular: a gain would be
        infinite, negative or 0, and the picture would be infinite or lose one of its three dimensions.

    Notes
    -----
    Source: von Kries; the paper, section 3.1, with gains between M and M^-1 rather than on RGB. Error: below 4e-16
    of the largest element and 6e-15 of each element (Bradford, CAT02, von Kries; D65 to D50, A to D65).

    Examples
    --------
    >>> from etendue_camera.colour.matrices import TRANSFORMS, von_kries_matrix
    >>> matrix = von_kries_matrix([1.0985, 1.0, 0.3558], [0.9505, 1.0, 1.089], TRANSFORMS["bradford"])  # A to D65
    >>> (matrix @ [1.0985, 1.0, 0.3558]).round(4).tolist()
    [0.9505, 1.0, 1.089]
    """
    cones = np.asarray(transform, np.float64)
    require.only(
        cones.shape == (3, 3) and np.linalg.cond(cones) < 1e12,
        "transform",
        repr(cones.tolist()),
        "an invertible 3 x 3 matrix, XYZ to cones",
    )
    source = _cone_responses("source_white_xyz", source_white_xyz, cones)
    target = _cone_responses("target_white_xyz", target_white_xyz, cones)
    return np.linalg.solve(cones, (target / source)[:, None] * cones)


def apply_matrix(matrix: ArrayLike, planes: NDArray) -> NDArray:
    """Multiply every pixel's triple by a matrix.

    Parameters
    ----------
    matrix : (n, k) array
    planes : (k, ...) array, any unit
        Usually (3, y, x).

    Returns
    -------
    (n, ...) array, dtype of planes (integers become float64)

    Raises
    ------
    ValueError
        If the shapes do not fit.

    Notes
    -----
    Sums run over k in order, pixel by pixel. Unlike with a BLAS product, the bits of a pixel do not depend on its
    neighbours or on how the picture is split. Error: k roundings of the largest term.
    """
    planes = np.asarray(planes)
    if not np.issubdtype(planes.dtype, np.floating):
        planes = planes.astype(np.float64)
    weights = np.asarray(matrix).astype(planes.dtype)
    require.that(
        weights.ndim == 2 and planes.ndim >= 1 and planes.shape[0] == weights.shape[1],
        f"matrix has shape {weights.shape} and planes {planes.shape}; allowed: (n, k) and (k, ...)",
    )
    flat = planes.reshape(len(planes), -1)
    result = np.empty((len(weights), flat.shape[1]), planes.dtype)
    product = np.empty(min(BLOCK, flat.shape[1]), planes.dtype)
    for start in range(0, flat.shape[1], BLOCK):
        part = flat[:, start : start + BLOCK]
        term = product[: part.shape[1]]
        for row, total in zip(weights, result[:, start : start + BLOCK], strict=True):
            np.multiply(part[0], row[0], out=total)
            for weight, plane in zip(row[1:], part[1:], strict=True):
                np.multiply(plane, weight, out=term)
                total += term
    return result.reshape(len(weights), *planes.shape[1:])


def fit_matrix(
    samples: ArrayLike,
    targets: ArrayLike,
    white_sample: ArrayLike | None = None,
    white_target: ArrayLike | None = None,
    ridge: float = 0.0,
    least: bool = False,
) -> MatrixFit:
    """Return the least-squares matrix from camera triples to target values.

    Parameters
    ----------
    samples : (n, k) array
        Camera values of n patches in k channels, usually three. At least k patches must be linearly independent (k - 1
        if a white is given).
    targets : (n, 3) array
        Desired values, for example XYZ.
    white_sample : (k,) array
    white_target : (3,) array
        Both or neither. If given, the matrix maps the white sample exactly to the white target, and the fit uses the
        remaining degrees of freedom.
    ridge : float, samples squared
        At or above 0: weight of the squared free elements relative to the mean squared error. Overlapping filters lead
        to large elements of both signs, which separate colours well but amplify noise; a ridge makes them smaller.
    least : bool
        Whether directions that the samples leave undetermined are set to zero (the smallest matrix that fits) instead
        of raising an error.

    Returns
    -------
    matrix : (3, k) array
        target = matrix @ sample.
    residual : float, unit of targets
        Rms error over n patches and three components.
    condition : float
        Condition number of the matrix (2-norm): how much it can amplify relative noise. Overlapping filters make it
        large.
    undetermined : int
        Number of channel directions that the samples do not determine; 0 unless ``least``.

    Raises
    ------
    ValueError
        If shapes do not fit, values are not finite, or a white is missing or black. Unless ``least``, also if the
        samples leave the matrix undetermined: their spread along some direction that the white leaves free is below
        1e-7 of their size. Matrix elements would reach 1e7, and single precision, which rounds to 6e-8, would turn
        rounding errors into colour.

    Notes
    -----
    The white is mapped exactly, to rounding, by solving in the space orthogonal to it (null-space method); a large
    weight for the white would cost half the digits.
    """
    samples, targets = np.asarray(samples, np.float64), np.asarray(targets, np.float64)
    require.that(
        samples.ndim == 2
        and targets.ndim == 2
        and len(samples) == len(targets)
        and samples.shape[1] >= 1
        and targets.shape[1] == 3,
        f"samples has shape {samples.shape} and targets {targets.shape}; allowed: (n, k) and (n, 3)",
    )
    if (white_sample is None) != (white_target is None):
        raise ValueError("white_sample and white_target: one is missing; allowed: both or neither")
    require.that(
        np.isfinite(samples).all() and np.isfinite(targets).all(),
        "samples or targets hold NaN or infinity; allowed: finite numbers",
    )
    channels = samples.shape[1]
    fixed, free = np.zeros((channels, 3)), np.eye(channels)
    if white_sample is not None:
        white, wanted = np.asarray(white_sample, np.float64), np.asarray(white_target, np.float64)
        fit_in = (
            white.shape == (channels,)
            and wanted.shape == (3,)
            and np.isfinite(white).all()
            and np.isfinite(wanted).all()
        )
        require.that(
            fit_in and white.any(),
            f"white_sample is {white}, white_target {wanted}; allowed: finite triples, not black",
        )
        fixed = np.outer(white, wanted) / (white @ white)
        free = np.linalg.svd(white[None, :])[2][1:].T
    freedoms = free.shape[1]
    require.amount("ridge", ridge)
    design, wanted_rest = samples @ free, targets - samples @ fixed
    if ridge > 0:
        design = np.concatenate([design, np.sqrt(ridge * len(samples)) * np.eye(freedoms)])
        wanted_rest = np.concatenate([wanted_rest, np.zeros((freedoms, 3))])
    # Equal channels differ by rounding errors only, and these have full rank. The rank is therefore judged relative to
    # the size of the samples.
    left, sizes, right = np.linalg.svd(design, full_matrices=False)
    known = sizes > LEAST_SPAN * np.linalg.norm(samples, 2)
    rank = int(np.count_nonzero(known))
    if rank == freedoms:
        steps = np.linalg.lstsq(design, wanted_rest, rcond=1e-12)[0]
    elif least:
        steps = right[known].T @ ((left[:, known].T @ wanted_rest) / sizes[known, None])
    else:
        raise ValueError(f"samples span {rank} of {freedoms} free dimensions; allowed: patches that span them all")
    transposed = fixed + free @ steps
    residual = np.sqrt(np.mean((samples @ transposed - targets) ** 2))
    return MatrixFit(transposed.T.copy(), float(residual), float(np.linalg.cond(transposed)), freedoms - rank)


def _cone_responses(name: str, white: ArrayLike, cones: Matrix) -> NDArray:
    white = np.asarray(white, np.float64)
    require.shape(white.shape == (3,), name, white, "(3,), XYZ")
    responses = cones @ white
    if not (np.isfinite(responses).all() and responses.min() > 1e-9 * responses.max()):
        raise ValueError(
            f"{name} is {white.tolist()}, with cone responses {responses.tolist()}; allowed: whites that "
            "excite all three cones, each at least 1e-9 of the largest"
        )
    return responses


def _constant(rows: ArrayLike) -> Matrix:
    matrix = np.array(rows, np.float64)
    matrix.setflags(write=False)
    return matrix


TRANSFORMS = {
    "bradford": _constant([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]),
    "cat02": _constant([[0.7328, 0.4296, -0.1624], [-0.7036, 1.6975, 0.0061], [0.0030, 0.0136, 0.9834]]),
    "cat16": _constant(
        [[0.401288, 0.650173, -0.051461], [-0.250268, 1.204414, 0.045854], [-0.002079, 0.048952, 0.953127]]
    ),
    "von_kries_hpe_d65": _constant([[0.40024, 0.70760, -0.08081], [-0.22630, 1.16532, 0.04570], [0.0, 0.0, 0.91822]]),
}
"""XYZ to cone responses: Lam 1985 (ICC), CIECAM02, CAM16, and Hunt-Pointer-Estevez normalised to D65."""

RGB_TO_XYZ_PAL = _constant(rgb_to_xyz_matrix(PAL_PRIMARIES_XY, D65_XY))
RGB_TO_XYZ_SRGB = _constant(rgb_to_xyz_matrix(SRGB_PRIMARIES_XY, D65_XY))
EQ16_AS_PRINTED = _constant([[0.431, 0.342, 0.178], [0.222, 0.707, 0.071], [0.229, 0.130, 0.939]])
"""Seed paper eq. 16. Its 0.229 is a misprint: it turns white into a strong blue (Z is 1.298 instead of 1.089)."""
EQ16_CORRECTED = _constant([[0.431, 0.342, 0.178], [0.222, 0.707, 0.071], [0.020, 0.130, 0.939]])

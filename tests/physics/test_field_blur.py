"""Field-dependent blur: conservation, symmetry, two methods and the direct sum, and the decision between them."""

import numpy as np
import pytest

from etendue_camera.field import blur, node_grids
from etendue_camera.field.convolve import hats_of
from etendue_camera.field.expansion import expansion
from etendue_camera.field.psf_bank import PsfBank
from etendue_camera.field.psf_kernels import Sampler

pytestmark = pytest.mark.long

SPACING = 1.0


def bank(strength=1.0, reach=40.0, wavelengths=(0.45, 0.65)):
    """Gaussian spots of a few samples with a tail outwards, over heights of a small window (um)."""
    step = np.arange(-7, 8) * SPACING
    y, x = step[:, None], step[None, :]
    heights = np.linspace(0, reach, 5)

    def spot(h, w):
        h = strength * h / reach
        return np.exp(-0.5 * (((y - 0.5 * h) / (1 + w + 0.4 * h**2)) ** 2 + (x / (1 + w)) ** 2)) * (1 + 0.06 * h * y)

    return PsfBank(heights, wavelengths, [[spot(h, w) for w in wavelengths] for h in heights], SPACING)


def line(n, centre=0.0):
    return centre + (np.arange(n) - 0.5 * (n - 1)) * SPACING


def direct(plane, y, x, pictures, wavelength, size):
    """Every sample of the mirrored plane spread by the kernel of its own place."""
    sampler = Sampler(pictures, SPACING, size, error=1e-6)
    reach = size // 2
    mirror_y, mirror_x = (np.pad(np.arange(n), reach, mode="symmetric") for n in plane.shape)
    out = np.zeros((plane.shape[0] + 4 * reach, plane.shape[1] + 4 * reach))
    yy, xx = np.meshgrid(y, x, indexing="ij")
    kernels = np.tensordot(sampler.kernels(yy.ravel(), xx.ravel()), pictures.mix([wavelength])[0], axes=(1, 0)).reshape(
        *plane.shape, size, size
    )
    for i, source_y in enumerate(mirror_y):
        for j, source_x in enumerate(mirror_x):
            out[i : i + size, j : j + size] += plane[source_y, source_x] * kernels[source_y, source_x]
    return out[2 * reach : 2 * reach + plane.shape[0], 2 * reach : 2 * reach + plane.shape[1]]


@pytest.fixture(scope="module")
def small():
    plane = np.random.default_rng(3).random((18, 24))
    y, x = line(18, 6.0), line(24, -5.0)
    pictures = bank()
    return plane, y, x, pictures, direct(plane, y, x, pictures, 0.5, pictures.size(SPACING, 1e-7))


@pytest.mark.parametrize("method", ["tiles", "eigen"])
def test_either_method_is_the_direct_sum_when_every_sample_is_a_node(small, method):
    plane, y, x, pictures, exact = small
    found = blur.blur(plane[None], y, x, [0.5], pictures, method, 1e-6)
    # heights are mixed linearly to a tenth of the tolerance, the Gram matrix knows directions to 1e-8
    np.testing.assert_allclose(found[0], exact, atol=1e-6)


def test_full_rank_and_tiles_on_the_same_grid_are_the_same():
    pictures, y, x = bank(), line(30, 10.0), line(40)
    planes = np.random.default_rng(0).random((2, 30, 40))
    for weights in ("source", "image"):
        tiles = blur.prepare(pictures, y, x, [0.5, 0.6], "tiles", 1e-2, count=5, weights=weights)
        terms = [expansion(np.tensordot(tiles.kernels, row, axes=(2, 0)), 0.0, 10**6) for row in tiles.mix]
        eigen = blur.Prepared(
            blur.replace(tiles.choice, method="eigen"),
            tiles.shape,
            weights,
            tiles.mix,
            tiles.kernels[:0],
            tuple(b for b, _, _ in terms),
            tuple(c for _, c, _ in terms),
        )
        # a Gram matrix in double precision knows directions down to 1e-8 of the largest
        np.testing.assert_allclose(blur.apply(planes, eigen), blur.apply(planes, tiles), atol=1e-7)


@pytest.mark.long
@pytest.mark.parametrize("kind", [np.float64, np.float32])
@pytest.mark.parametrize("method", ["tiles", "eigen"])
@pytest.mark.parametrize("light", ["bandlimited", "cells"])
def test_the_flux_of_a_point_is_kept_at_any_place_and_azimuth(kind, method, light):
    pictures, y, x = bank(), line(64), line(80)
    prepared = blur.prepare(pictures, y, x, [0.45, 0.5, 0.65], method, 1e-2, light=light)
    reach = prepared.choice.size // 2 + 1
    for row, column in np.random.default_rng(5).integers((reach, reach), (64 - reach, 80 - reach), (12, 2)):
        planes = np.zeros((3, 64, 80), dtype=kind)
        planes[:, row, column] = [1.0, 3.0, 1e4]
        flux = blur.apply(planes, prepared).sum(axis=(1, 2), dtype=float)
        np.testing.assert_allclose(flux, [1.0, 3.0, 1e4], rtol=1e-13 if kind == np.float64 else 1e-6)


@pytest.mark.parametrize("method", ["tiles", "eigen"])
def test_a_uniform_plane_stays_uniform_exactly_or_by_the_divergence_of_the_displacement(method):
    pictures, y, x = bank(), line(40), line(56)
    ones = np.ones((1, 40, 56))
    image = blur.blur(ones, y, x, [0.5], pictures, method, 1e-2, weights="image")
    np.testing.assert_allclose(image, 1.0, atol=1e-12)
    source = blur.blur(ones, y, x, [0.5], pictures, method, 1e-2)
    inside = np.abs(source - 1)[0, 10:-10, 10:-10].max()
    # on top of the divergence: second derivatives of the second moments, of the size of the displacement's here
    assert 1e-3 < inside < 2 * blur.unevenness(pictures)
    centred = blur.blur(ones, y, x, [0.5], pictures, method, 1e-2, centre="centroid")
    assert np.abs(centred - 1)[0, 10:-10, 10:-10].max() < 0.5 * inside


def test_a_bank_that_is_the_same_everywhere_is_a_plain_convolution():
    step = np.arange(-12, 13) * SPACING
    spot = np.exp(-0.5 * (step[:, None] ** 2 + step**2) / 1.8**2)
    pictures = PsfBank([0.0, 50.0], [0.55], [[spot], [spot]], SPACING)
    plane = np.random.default_rng(2).random((1, 50, 60))
    prepared = blur.prepare(pictures, line(50), line(60), [0.55], "auto", 1e-4)
    assert (prepared.choice.method, prepared.choice.count) == ("eigen", 0)
    from scipy.ndimage import convolve1d

    profile = np.exp(-0.5 * (np.arange(-12, 13) / 1.8) ** 2)
    profile /= profile.sum()
    exact = convolve1d(convolve1d(plane[0], profile, axis=0, mode="reflect"), profile, axis=1, mode="reflect")
    # a tenth of the tolerance of flux lies in the tails that are cut off
    np.testing.assert_allclose(blur.apply(plane, prepared)[0], exact, atol=2e-5)


@pytest.mark.parametrize("method", ["tiles", "eigen"])
def test_blur_is_linear(method):
    rng = np.random.default_rng(1)
    one, other = rng.random((2, 1, 33, 47))
    prepared = blur.prepare(bank(), line(33), line(47), [0.6], method, 1e-2)
    together = blur.apply(2 * one - 3 * other, prepared)
    np.testing.assert_allclose(together, 2 * blur.apply(one, prepared) - 3 * blur.apply(other, prepared), atol=1e-12)


@pytest.mark.parametrize("method", ["tiles", "eigen"])
@pytest.mark.parametrize("weights", ["source", "image"])
def test_a_turned_or_mirrored_scene_gives_the_turned_or_mirrored_image(method, weights):
    plane = np.random.default_rng(4).random((41, 41))
    y, x = line(41, 0.0), line(41, 0.0)
    prepared = blur.prepare(bank(), y, x, [0.5], method, 3e-3, weights=weights)
    image = blur.apply(plane[None], prepared)[0]
    for change in (np.rot90, np.transpose, lambda a: a[::-1], lambda a: a[:, ::-1]):
        # directions of equal singular value are cut between, where eigen-PSFs end: within the tolerance
        atol = 1e-12 if method == "tiles" else 3e-3
        np.testing.assert_allclose(blur.apply(change(plane)[None], prepared)[0], change(image), atol=atol)


def kernels_of(prepared):
    """The kernel of every sample, as the prepared method mixes it: (Y, X, size, size)."""
    hats = [hats_of(n, g) for n, g in zip(prepared.shape, prepared.choice.grid, strict=True)]
    if prepared.choice.method == "tiles":
        return np.einsum(
            "yi,xj,ijab->yxab", *hats, np.tensordot(prepared.kernels, prepared.mix[0], axes=(2, 0)), optimize=True
        )
    shares = np.einsum("yi,xj,kij->yxk", *hats, prepared.coefficients[0], optimize=True)
    return prepared.bases[0][0] + np.tensordot(shares, prepared.bases[0][1:], axes=1)


@pytest.mark.parametrize("method", ["tiles", "eigen"])
@pytest.mark.parametrize("tolerance", [3e-2, 3e-3])
@pytest.mark.parametrize("strength", [0.3, 1.0])
def test_the_error_stays_within_the_tolerance_for_the_scene_that_hurts_most(strength, method, tolerance):
    pictures, y, x = bank(strength), line(60, 8.0), line(50)
    found = blur.prepare(pictures, y, x, [0.55], method, tolerance)
    assert found.choice.error <= tolerance * (1 + 1e-9)
    size = pictures.size(SPACING)
    yy, xx = np.meshgrid(y, x, indexing="ij")
    sampler = Sampler(pictures, SPACING, size, error=1e-5)
    exact = np.tensordot(sampler.kernels(yy.ravel(), xx.ravel()), [0.5, 0.5], axes=(1, 0)).reshape(60, 50, size, size)
    room = (size - found.choice.size) // 2
    apart = exact - np.pad(kernels_of(found), ((0, 0), (0, 0), (room, room), (room, room)))
    # for one sample of the result the worst scene is bright where the difference of the kernels that reach it is
    # positive
    worst = np.zeros((2, 60 + size, 50 + size))
    for i in range(size):
        for j in range(size):
            worst[0, i : i + 60, j : j + 50] += np.maximum(apart[..., i, j], 0)
            worst[1, i : i + 60, j : j + 50] += np.maximum(-apart[..., i, j], 0)
    # the bound holds for kernels that change little over their own width; here they are a quarter of the frame
    assert worst.max() <= 1.1 * tolerance


def test_the_cheaper_method_is_chosen_and_the_other_one_told():
    y, x = line(100), line(120)
    for strength in (0.1, 1.5):
        choice = blur.choose(bank(strength, 90.0), y, x, [0.55], "auto", 5e-3)
        ((other, _, _, cost),) = choice.others
        assert {choice.method, other} == {"eigen", "tiles"}
        assert choice.cost <= cost
        alone = blur.choose(bank(strength, 90.0), y, x, [0.55], choice.method, 5e-3)
        assert (alone.count, alone.grid) == (choice.count, choice.grid)
    # fast decay of the singular values: a few eigen-PSFs
    weak = blur.choose(bank(0.1, 90.0), y, x, [0.55], "auto", 5e-3)
    assert weak.method == "eigen"
    assert weak.count <= 6


@pytest.mark.long
def test_more_terms_and_more_tiles_are_never_worse_and_tiles_converge_with_the_square():
    y, x = line(100, 70.0), line(100, 60.0)  # off the axis, between heights of the bank
    pictures = bank(1.0, 200.0)
    errors = [blur.choose(pictures, y, x, [0.55], "tiles", 1e-4, count=n).error for n in (3, 5, 9)]
    extra = 1e-4 * 0.2  # tails and heights, whatever the grid
    assert errors[1] - extra < (errors[0] - extra) / 3
    assert errors[2] - extra < (errors[1] - extra) / 3
    terms = [blur.choose(pictures, y, x, [0.55], "eigen", 1e-4, count=n).error for n in (1, 2, 4, 8)]
    assert terms == sorted(terms, reverse=True)


def test_planes_between_the_wavelengths_of_the_bank_are_mixed():
    y, x = line(30), line(30)
    pictures = bank()
    plane = np.random.default_rng(9).random((30, 30))
    ends = blur.blur(np.stack([plane, plane]), y, x, [0.45, 0.65], pictures, "tiles", 1e-3)
    middle = blur.blur(plane[None], y, x, [0.5], pictures, "tiles", 1e-3)
    np.testing.assert_allclose(middle[0], 0.75 * ends[0] + 0.25 * ends[1], atol=1e-12)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 1), (2, 2), (3, 50)])
def test_odd_frames_are_blurred_too(shape):
    planes = np.random.default_rng(0).random((1, *shape)).astype(np.float32)
    found = blur.blur(planes, line(shape[0]), line(shape[1]), [0.55], bank(), "auto", 1e-2, weights="image")
    assert found.shape == planes.shape
    assert found.dtype == np.float32
    assert planes.min() - 1e-3 <= found.min() <= found.max() <= planes.max() + 1e-3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tolerance": 0.0}, "tolerance"),
        ({"method": "fast"}, "method"),
        ({"weights": "both"}, "weights"),
        ({"light": "rays"}, "light"),
        ({"centre": "peak"}, "centre"),
        ({"count": 3}, "count"),
        ({"y": np.array([0.0, 1.0, 3.0])}, "even steps"),
        ({"y": np.arange(4) * 2.0}, "same spacing"),
    ],
)
def test_nonsense_is_refused(change, message):
    given = {"y": line(4), "method": "auto", "tolerance": 0.1, **change}
    y, method, tolerance = given.pop("y"), given.pop("method"), given.pop("tolerance")
    with pytest.raises(ValueError, match=message):
        blur.prepare(bank(), y, line(5), [0.5], method, tolerance, **given)


def test_planes_of_another_shape_are_refused():
    prepared = blur.prepare(bank(), line(4), line(5), [0.5])
    with pytest.raises(ValueError, match="shape"):
        blur.apply(np.zeros((2, 4, 5)), prepared)


@pytest.mark.parametrize("size", [9, 301, 945, 947, 3203])
def test_kernels_that_are_too_large_are_known_before_one_is_made(size):
    """The first finer grid of a frame of 40 x 60 has 3 x 5 nodes; small frames have a kernel for every sample, and
    nothing between them.
    """
    assert node_grids.kernels_fit(size, 5, 40, 60) == (3 * 5 * 5 * 8 * size**2 <= 512 << 20)
    assert node_grids.kernels_fit(size, 5, 1, 1) and node_grids.kernels_fit(size, 5, 2, 3)

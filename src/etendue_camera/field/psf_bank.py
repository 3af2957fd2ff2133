"""Point spread functions by image height and wavelength: stored, interpolated, rotated and resampled to an image grid.

In:  images of a point (PSFs) at several heights and wavelengths, from a design program, a wavefront or a measurement.
Out: kernels on the image grid for any image point, each with a sum of exactly 1; files.
Sources: rotational symmetry of a centred lens; the sampling theorem; spline interpolation (Unser, IEEE Signal
Processing Magazine 16(6), 22, 1999).

A bank holds the PSF of an image point at ``(y, x) = (height, 0)``, whose radial direction is +y. For other image points
the PSF is rotated about the axis of the lens.

See `psf_files` for the file formats.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue import require
from etendue_camera.arrays import FloatArray
from etendue_camera.field import psf_files
from etendue_camera.field.psf_kernels import Centre, Light, Sampler, between, rounded

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

_NEGATIVE_SHARE = 1e-2  # of the flux; more is not measurement noise


@dataclass(frozen=True, eq=False)
class PsfBank:
    """Point spread functions (PSFs) by image height and wavelength.

    Attributes
    ----------
    heights_um : (K,) array, um
        Distances of the image points from the axis, ascending; the first may be 0.
    wavelengths_um : (L,) array, um
        Ascending.
    psf : (K, L, n, n) array, 1
        Axes height, wavelength, y, x, for an image point on the +y axis. The reference point (the ideal or chief-ray
        image point) is sample (n // 2, n // 2). Each PSF is divided by its sum.
    spacing_um : float or (L,) array, um
        Spacing of the samples of a PSF; stored as (L,).
    source : str
        Description of the origin of the data.
    clipped : float, 1
        Largest fraction of negative values (measurement noise) that was set to zero in a PSF.

    Raises
    ------
    ValueError
        For shapes that do not match, heights or wavelengths that do not ascend, values that are not finite, a PSF
        without light, or negative values of more than a hundredth of the flux of a PSF.

    Notes
    -----
    Interpolation between heights obeys rotational symmetry: the part of a PSF that is even under a half turn is a
    function of h^2, and the odd part is h times such a function. Both are interpolated by cubics in h^2 with slopes
    from the neighbours; negative values are then set to zero and the sum to 1. Between wavelengths interpolation is
    linear. Beyond the first and last entries the nearest entry applies: a bank that does not start at height 0 uses its
    first PSF on the axis.
    """

    heights_um: FloatArray
    wavelengths_um: FloatArray
    psf: FloatArray
    spacing_um: Any
    source: str = ""
    clipped: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        heights = _axis("heights_um", self.heights_um, lowest=0.0)
        wavelengths = _axis("wavelengths_um", self.wavelengths_um, lowest=1e-12)
        psf = np.array(self.psf, dtype=float)
        require.that(
            psf.ndim == 4
            and psf.shape[:2] == (heights.size, wavelengths.size)
            and psf.shape[2] == psf.shape[3]
            and psf.shape[3] >= 3,
            f"psf has shape {psf.shape}; it must be (heights, wavelengths, n, n) = ({heights.size}, "
            f"{wavelengths.size}, n, n), n >= 3",
        )
        spacing = np.asarray(self.spacing_um, dtype=float)
        require.must(
            spacing.shape in ((), (1,), (wavelengths.size,)) and np.all((spacing > 0) & np.isfinite(spacing)),
            "spacing_um",
            self.spacing_um,
            "one length above 0 um, or one for each of the wavelengths",
        )
        require.that(np.isfinite(psf).all(), "psf contains values that are not finite")
        below = -np.minimum(psf, 0.0).sum(axis=(2, 3))
        psf = np.maximum(psf, 0.0)
        total = psf.sum(axis=(2, 3))
        if not np.all(total > 0):
            raise ValueError(
                f"psf has no light at (height, wavelength) number {tuple(int(i) for i in np.argwhere(~(total > 0))[0])}"
            )
        share = float((below / total).max())
        require.that(
            not share > _NEGATIVE_SHARE,
            f"psf has negative values of {share:.2g} of its flux; at most {_NEGATIVE_SHARE:g} is accepted as noise: "
            f"remove the background",
        )
        psf /= total[:, :, None, None]
        for name, array in (
            ("heights_um", heights),
            ("wavelengths_um", wavelengths),
            ("psf", psf),
            ("spacing_um", np.broadcast_to(spacing, wavelengths.shape).copy()),
        ):
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        object.__setattr__(self, "clipped", share)

    @property
    def nbytes(self) -> int:
        return int(self.psf.nbytes)

    def with_height(self, height_um: float) -> FloatArray:
        """Return the PSFs at one height, (L, n, n), for an image point on the +y axis and with the sampling of the
        bank.
        """
        return self._at(np.array([float(height_um)]))[0]

    def _at(self, heights: FloatArray) -> FloatArray:
        """Return the PSFs at any heights, (H, L, n, n)."""
        own, psf = self.heights_um, self.psf
        if own.size == 1:
            return np.repeat(psf, heights.size, axis=0)
        heights = np.clip(heights, own[0], own[-1])
        turned = psf[:, :, ::-1, ::-1]
        if psf.shape[-1] % 2 == 0:  # sample 0 has no mirror image
            turned = np.roll(turned, 1, axis=(2, 3))
        even, odd = 0.5 * (psf + turned), 0.5 * (psf - turned)
        first = int(own[0] == 0)
        odd[first:] /= own[first:, None, None, None]
        if first:
            odd[0] = odd[1]
        weights = _cubic(own**2, heights**2)
        found = np.tensordot(weights, even, axes=1) + heights[:, None, None, None] * np.tensordot(weights, odd, axes=1)
        for k, height in enumerate(own):  # given PSFs are returned exactly
            found[heights == height] = psf[k]
        np.maximum(found, 0.0, out=found)
        return found / found.sum(axis=(2, 3), keepdims=True)

    def roundness(self) -> float:
        """Return half the sum of absolute differences between the PSF on the axis and its mean over directions; 0 if
        the bank has no PSF on the axis.

        On the axis of a rotationally symmetric lens all directions are equal: a PSF that is not round there indicates
        noise or a decentred lens, which a bank cannot describe.
        """
        return (
            0.0
            if self.heights_um[0] > 0
            else max(0.5 * float(np.abs(picture - rounded(picture)).sum()) for picture in self.psf[0])
        )

    def rounded(self) -> PsfBank:
        """Return a bank with a round PSF on the axis: PSFs that change under a quarter turn are averaged over
        directions.
        """
        turned = np.rot90(self.psf[0], axes=(1, 2))
        if turned.shape[1] % 2 == 0:  # rotate about sample n // 2
            turned = np.roll(turned, 1, axis=1)
        apart = 0.5 * float(np.abs(self.psf[0] - turned).sum(axis=(1, 2)).max())
        if self.heights_um[0] > 0 or apart <= 1e-9:
            return self
        psf = self.psf.copy()
        psf[0] = [rounded(picture) for picture in psf[0]]
        return PsfBank(self.heights_um, self.wavelengths_um, psf, self.spacing_um, self.source)

    def refined(self, error: float) -> PsfBank:
        """Return a bank with enough heights that linear interpolation between them has an error of at most ``error``.

        The error is half the sum of absolute differences, measured midway between two heights and doubled because the
        curvature may be larger elsewhere. At most 16 steps are made between two heights.
        """
        own = self.heights_um
        if own.size == 1:
            return self
        middle = self._at(0.5 * (own[:-1] + own[1:]))
        apart = 0.5 * np.abs(middle - 0.5 * (self.psf[:-1] + self.psf[1:])).sum(axis=(2, 3)).max(axis=1)
        steps = np.clip(np.ceil(np.sqrt(2 * apart / error)), 1, 16).astype(int)
        heights = np.concatenate(
            [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(own[:-1], own[1:], steps, strict=True)]
            + [own[-1:]]
        )
        return (
            self
            if heights.size == own.size
            else PsfBank(heights, self.wavelengths_um, self._at(heights), self.spacing_um, self.source)
        )

    def centroids(self) -> FloatArray:
        """Return the mean position of each PSF relative to its reference point, (K, L, 2) along y and x, um."""
        step = np.arange(self.psf.shape[-1]) - self.psf.shape[-1] // 2
        mean = np.stack([self.psf.sum(axis=3) @ step, self.psf.sum(axis=2) @ step], axis=-1)
        return mean * self.spacing_um[:, None]

    def radius(self, lost: float = 0.0) -> float:
        """Return the radius (um) around the reference point outside which no PSF has more than ``lost`` of its flux.

        The radius is at most that of the circle inscribed in the PSF arrays, whose corners are not used.
        """
        n = self.psf.shape[-1]
        step = np.arange(n) - n // 2
        distance = np.hypot(step[:, None], step[None, :]).ravel()
        order = np.argsort(distance, kind="stable")
        inside = np.cumsum(self.psf.reshape(*self.psf.shape[:2], -1)[..., order], axis=-1)
        needed = np.array(
            [
                distance[order][np.minimum((one <= 1 - lost - 1e-15).sum(axis=-1), n * n - 1)].max()
                for one in inside.swapaxes(0, 1)
            ]
        )
        return float((np.minimum(needed, (n - 1) // 2) * self.spacing_um).max())

    def size(self, spacing: float, lost: float = 0.0, light: Light = "bandlimited") -> int:
        """Return the number of samples, always odd, along each side of a kernel on a grid of this spacing (um)."""
        half = int(np.ceil(self.radius(lost) / spacing)) + 1
        return 2 * (max(half, 5) if light == "bandlimited" else half) + 1

    def kernel_at(
        self,
        y_um: float,
        x_um: float,
        spacing: float,
        size: int | None = None,
        light: Light = "bandlimited",
        centre: Centre = "reference",
    ) -> FloatArray:
        """Return the kernels of one image point on the image grid, (L, size, size), at the wavelengths of the bank.

        Parameters
        ----------
        y_um, x_um : float, um
            Image point relative to the axis of the lens.
        spacing : float, um
            Spacing of the image grid.
        size : int, optional
            Odd number of samples; the image point is sample (size // 2, size // 2). Default: large enough for the
            circle inscribed in the bank's PSFs.
        light, centre
            As for ``Sampler``.
        """
        sampler = Sampler(self, spacing, size, light, centre)
        return sampler.kernels(np.array([float(y_um)]), np.array([float(x_um)]))[0]

    def mix(self, wavelengths_um: FloatArray) -> FloatArray:
        """Return the weights (wavelengths, L) that interpolate PSFs at other wavelengths; rows sum to 1."""
        wanted = np.atleast_1d(np.asarray(wavelengths_um, dtype=float))
        low, share = between(self.wavelengths_um, wanted)
        weights = np.zeros((wanted.size, self.wavelengths_um.size))
        rows = np.arange(wanted.size)
        weights[rows, low] += 1 - share
        weights[rows, np.minimum(low + 1, self.wavelengths_um.size - 1)] += share
        return weights

    def save(self, path: str | Path) -> None:
        """Write a ``.npz`` or ``.csv`` file; see `psf_files`."""
        psf_files.write(
            Path(path), self.heights_um, self.wavelengths_um, self.psf, np.asarray(self.spacing_um), self.source
        )

    @classmethod
    def load(cls, path: str | Path) -> PsfBank:
        """Read a ``.npz`` or ``.csv`` file; see `psf_files`."""
        return cls(*psf_files.read(Path(path)))


def _axis(name: str, values: ArrayLike, lowest: float) -> FloatArray:
    axis = np.array(values, dtype=float)
    require.must(
        axis.ndim == 1
        and axis.size >= 1
        and np.isfinite(axis).all()
        and np.all(np.diff(axis) > 0)
        and (axis[0] >= lowest),
        name,
        values,
        f"one-dimensional, finite, ascending and not below {lowest:g} um",
    )
    return axis


def _cubic(nodes: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the weights (wanted, nodes) of piecewise cubics; the slope at a node is that of the parabola through the
    node and its two neighbours.
    """
    count, steps = nodes.size, np.diff(nodes)
    each = np.zeros((count - 1, count))  # slopes of the chords
    rows = np.arange(count - 1)
    each[rows, rows], each[rows, rows + 1] = -1 / steps, 1 / steps
    slopes = np.empty((count, count))
    if count == 2:
        slopes[:] = each[0]
    else:
        share = (steps[:-1] / (steps[:-1] + steps[1:]))[:, None]
        slopes[1:-1] = (1 - share) * each[:-1] + share * each[1:]
        slopes[0], slopes[-1] = 2 * each[0] - slopes[1], 2 * each[-1] - slopes[-2]
    low, t = between(nodes, wanted)
    t, step = t[:, None], steps[low][:, None]
    unit = np.eye(count)
    return (
        (1 + 2 * t) * (1 - t) ** 2 * unit[low]
        + t * (1 - t) ** 2 * step * slopes[low]
        + t**2 * (3 - 2 * t) * unit[low + 1]
        + t**2 * (t - 1) * step * slopes[low + 1]
    )

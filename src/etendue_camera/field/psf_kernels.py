"""Point spread functions on an image grid: resampled once, rotated for each image point, with sum and mean preserved.

In:  a bank of point spread functions (``PsfBank``), the spacing of an image grid (um), image points (um).
Out: kernels with a sum of exactly 1.
Sources: the sampling theorem; spline interpolation (Unser, IEEE Signal Processing Magazine 16(6), 22, 1999).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from etendue import require
from etendue_camera.arrays import FloatArray

if TYPE_CHECKING:
    from etendue_camera.field.psf_bank import PsfBank

Light = Literal["bandlimited", "cells"]
Centre = Literal["reference", "centroid"]

_ORDER = 5  # of the spline
_OVERSAMPLING = 3  # of the table that the spline interpolates
_TOGETHER = 1 << 14  # samples that are interpolated in one call: few enough for the cache
_POINTS = 64  # image points evaluated at a time, to bound memory


@dataclass(eq=False)
class Sampler:
    """Kernels of a bank on one image grid.

    Parameters
    ----------
    bank : PsfBank
    spacing : float, um
        Spacing of the image grid.
    size : int, optional
        Samples along each side of a kernel, odd; default ``bank.size(spacing)``.
    light : {"bandlimited", "cells"}
        Meaning of a value on the grid. ``bandlimited``: a sample. Frequencies of the PSF beyond a circle at the Nyquist
        frequency of the grid are removed, as for a transfer function, which may leave small negative values. ``cells``:
        the mean over a grid cell. A kernel is the light that falls into each cell, and never negative.
    centre : {"reference", "centroid"}
        The point of the PSF that is placed on the image point. ``reference``: its reference sample, so that the mean
        displacement of the PSF moves the image. ``centroid``: its centroid, for use where distortion already includes
        this displacement.
    used : indices, optional
        Wavelengths of the bank to use; default all.
    error : float
        Allowed error of linear interpolation between the heights of the refined bank.

    Notes
    -----
    ``bandlimited`` resamples each PSF once by its Fourier transform to three samples per spacing of the coarser grid
    (PSF or image), then rotates it with a quintic spline. The error of a kernel is below 5e-6 of its flux where the PSF
    is band-limited and dark at its border. ``cells`` averages at least two linear interpolations per PSF sample along
    each axis. Both then divide the kernel by its sum, and multiply it by a linear function of position that restores
    the mean position of the PSF.
    """

    bank: PsfBank
    spacing: float
    size: Any = None
    light: Light = "bandlimited"
    centre: Centre = "reference"
    used: tuple[int, ...] | None = None
    error: float = 1e-4

    def __post_init__(self) -> None:
        self.bank = bank = self.bank.rounded().refined(self.error)
        light, centre = self.light, self.centre
        require.must(0.0 < self.spacing < np.inf, "spacing", self.spacing, "finite and above 0 um")
        require.must(light in ("bandlimited", "cells"), "light", repr(light), "'bandlimited' or 'cells'")
        require.must(centre in ("reference", "centroid"), "centre", repr(centre), "'reference' or 'centroid'")
        self.spacing = float(self.spacing)
        self.size = bank.size(self.spacing, light=light) if self.size is None else int(self.size)
        require.must(self.size >= 3 and self.size % 2 != 0, "size", self.size, "odd and at least 3")
        n = bank.psf.shape[-1]
        step = np.arange(n) - n // 2
        circle = np.hypot(step[:, None], step[None, :]) <= (n - 1) // 2
        chosen = tuple(range(bank.wavelengths_um.size)) if self.used is None else self.used
        self.wavelengths = len(chosen)
        self.means = np.zeros((bank.heights_um.size, len(chosen), 2))
        self.tables: list[list[FloatArray]] = []  # by wavelength, then height
        self.steps = np.zeros(len(chosen))
        room = 2 + (
            int(np.ceil((np.abs(bank.centroids()).max(axis=(0, 2)) / bank.spacing_um).max()))
            if centre == "centroid"
            else 0
        )
        for number, which in enumerate(chosen):
            own, column = float(bank.spacing_um[which]), []
            for k in range(bank.heights_um.size):
                picture = bank.psf[k, which] * circle
                picture = picture / picture.sum()
                mean = np.array([picture.sum(axis=1) @ step, picture.sum(axis=0) @ step]) * own
                move = -mean if centre == "centroid" else np.zeros(2)
                self.means[k, number] = mean + move
                if light == "bandlimited":
                    table, self.steps[number] = _band_limited(picture, own, self.spacing, move, room)
                    column.append(scipy.ndimage.spline_filter(table, order=_ORDER))
                else:
                    self.steps[number] = own
                    column.append(
                        scipy.ndimage.shift(
                            np.pad(picture, room), move / own, order=1, mode="constant", prefilter=False
                        )
                    )
            self.tables.append(column)
        half = self.size // 2
        grid = np.arange(-half, half + 1)
        self.inside = np.hypot(grid[:, None], grid[None, :]) <= half + 0.5
        self.dy, self.dx = (a[self.inside] * self.spacing for a in np.meshgrid(grid, grid, indexing="ij"))

    def kernels(self, y_um: FloatArray, x_um: FloatArray) -> FloatArray:
        """Return kernels (P, L, size, size), each with a sum of 1, of the image points at ``y_um`` and ``x_um``, both
        (P,), at the L wavelengths of the tables.
        """
        y_um, x_um = np.asarray(y_um, dtype=float), np.asarray(x_um, dtype=float)
        out = np.zeros((y_um.size, len(self.tables), self.size, self.size))
        for first in range(0, y_um.size, _POINTS):
            points = slice(first, first + _POINTS)
            out[points][..., self.inside] = self._values(y_um[points], x_um[points])
        return out

    def _values(self, y_um: FloatArray, x_um: FloatArray) -> FloatArray:
        radius = np.hypot(y_um, x_um)
        safe = np.where(radius > 0, radius, 1.0)
        cosine, sine = np.where(radius > 0, y_um / safe, 1.0), x_um / safe
        low, share = between(self.bank.heights_um, radius)
        values = np.empty((radius.size, len(self.tables), self.dy.size))
        means = np.empty((radius.size, len(self.tables), 2))
        for point in range(radius.size):
            k, a, c, s = int(low[point]), float(share[point]), float(cosine[point]), float(sine[point])
            for number, column in enumerate(self.tables):
                table = column[k] if a == 0 else (1 - a) * column[k] + a * column[k + 1]
                values[point, number] = self._turned(table, self.steps[number], c, s)
            mean = self.means[k] if a == 0 else (1 - a) * self.means[k] + a * self.means[k + 1]
            means[point] = mean @ np.array([[c, s], [-s, c]])
        return self._levelled(values, means)

    def _turned(self, table: FloatArray, step: float, c: float, s: float) -> FloatArray:
        """Return the values of a table at the samples of a kernel, for an image point in the direction (c, s)."""
        middle = table.shape[0] // 2
        order = _ORDER if self.light == "bandlimited" else 1
        parts = 1 if self.light == "bandlimited" else max(1, int(np.ceil(2 * self.spacing / step)))
        total = np.zeros(self.dy.shape)
        offsets = ((np.arange(parts) + 0.5) / parts - 0.5) * self.spacing
        oy, ox = (a.reshape(-1, 1) for a in np.meshgrid(offsets, offsets, indexing="ij"))
        together = max(1, _TOGETHER // max(self.dy.size, 1))
        for first in range(0, oy.size, together):
            dy, dx = self.dy + oy[first : first + together], self.dx + ox[first : first + together]
            where = np.stack([c * dy + s * dx, c * dx - s * dy])
            where /= step
            where += middle
            for values in scipy.ndimage.map_coordinates(table, where, order=order, mode="constant", prefilter=False):
                total += values
        return total

    def _levelled(self, values: FloatArray, wanted: FloatArray) -> FloatArray:
        """Normalise kernels to a sum of 1 and the ``wanted`` mean positions (..., 2), by a factor linear in
        position.
        """
        dy, dx = self.dy, self.dx
        sums = values @ np.stack([np.ones_like(dy), dy, dx, dy * dy, dy * dx, dx * dx], axis=-1)
        total, now = sums[..., :1], sums[..., 1:3] / sums[..., :1]
        yy, yx, xx = (
            sums[..., 3 + i] / total[..., 0] - now[..., a] * now[..., b]
            for i, (a, b) in enumerate(((0, 0), (0, 1), (1, 1)))
        )
        off_y, off_x = (wanted[..., i] - now[..., i] for i in (0, 1))
        determinant = yy * xx - yx * yx
        solvable = (determinant > 1e-12 * self.spacing**4) & (yy > 0)
        safe = np.where(solvable, determinant, 1.0)
        slope_y, slope_x = (xx * off_y - yx * off_x) / safe, (yy * off_x - yx * off_y) / safe
        # a kernel too small to reach the mean position of its PSFs is left unchanged
        reach = np.abs(slope_y) + np.abs(slope_x)
        held = (solvable & (reach * self.spacing * self.size < 1.0))[..., None]
        factor = 1.0 + slope_y[..., None] * (dy - now[..., :1]) + slope_x[..., None] * (dx - now[..., 1:])
        values = values * np.where(held, factor, 1.0)
        return values / values.sum(axis=-1, keepdims=True)


def rounded(picture: FloatArray) -> FloatArray:
    """Return the mean of a PSF over all directions about its sample n // 2, normalised to a sum of 1.

    Notes
    -----
    The PSF is resampled and rotated like kernels: a round, band-limited PSF changes by less than 1e-5 of its flux.
    """
    n = picture.shape[0]
    room = (n - 1) // 2
    table, step = _band_limited(picture, 1.0, 1.0, np.zeros(2), 2)
    radius = np.arange(0.0, room + 1.0, 1 / _OVERSAMPLING)
    angle = np.arange(8 * max(room, 8)) * (2 * np.pi / (8 * max(room, 8)))
    where = np.stack([radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)]) / step + table.shape[0] // 2
    profile = scipy.ndimage.map_coordinates(
        scipy.ndimage.spline_filter(table, order=_ORDER), where, order=_ORDER, prefilter=False
    ).mean(axis=1)
    curve = scipy.interpolate.make_interp_spline(
        np.r_[-radius[:0:-1], radius], np.r_[profile[:0:-1], profile], k=_ORDER
    )
    offset = np.arange(n) - n // 2
    distance = np.hypot(offset[:, None], offset[None, :])
    values = np.where(distance <= room, np.maximum(curve(np.minimum(distance, room)), 0.0), 0.0)
    return values / values.sum()


def _band_limited(
    picture: FloatArray, own: float, spacing: float, move: FloatArray, room: int
) -> tuple[FloatArray, float]:
    """Resample a PSF by its Fourier transform, low-pass it in a circle at the Nyquist frequency of the grid, and move
    it (um).

    Returns the table, with its centre at n // 2, and its spacing.
    """
    n = picture.shape[0]
    total = scipy.fft.next_fast_len(n + 2 * max(n // 4, 8, room))
    wide = np.zeros((total, total))
    start = total // 2 - n // 2
    wide[start : start + n, start : start + n] = picture
    frequency = scipy.fft.fftfreq(total, own)
    fy, fx = frequency[:, None], frequency[None, :]
    transform = scipy.fft.fft2(scipy.fft.ifftshift(wide)) * np.exp(-2j * np.pi * (fy * move[0] + fx * move[1]))
    transform[np.hypot(fy, fx) > 0.5 / spacing] = 0.0
    if total % 2 == 0:  # the Nyquist frequency has no counterpart of the opposite sign
        transform[total // 2] = 0.0
        transform[:, total // 2] = 0.0
    size = int(np.ceil(total * own * _OVERSAMPLING / max(own, spacing)))
    out = np.zeros((size, size), dtype=complex)
    half = (min(size, total) - 1) // 2
    keep = np.r_[0 : half + 1, -half:0] if half else np.array([0])
    out[np.ix_(keep, keep)] = transform[np.ix_(keep, keep)]
    return scipy.fft.fftshift(scipy.fft.ifft2(out).real), total * own / size


def between(nodes: FloatArray, wanted: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the index of the node below and the weight of the node above; beyond the ends, the end nodes apply."""
    if nodes.size == 1:
        return np.zeros(wanted.shape, dtype=np.intp), np.zeros(wanted.shape)
    low = np.clip(np.searchsorted(nodes, wanted, side="right") - 1, 0, nodes.size - 2)
    return low, np.clip((wanted - nodes[low]) / (nodes[low + 1] - nodes[low]), 0.0, 1.0)

"""Differences between a camera's picture and the ideal camera's picture: every metric of one cell.

In:  two ``Shot``: the pictures of one scene by a camera and by its ideal.
Out: metrics by name, NaN where there is nothing to measure; the map of colour differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy

from etendue.types.arrays import Array
from etendue_camera.colour import difference
from etendue_camera.colour.matrices import apply_matrix
from etendue_camera.quality import artefacts, fidelity, scielab
from etendue_camera.quality.visible_noise import visible_noise

UNITS = {
    "psnr_linear": "dB",
    "psnr_encoded": "dB",
    "ssim": "1",
    "de_mean": "1",
    "de_median": "1",
    "de_p95": "1",
    "scielab_mean": "1",
    "scielab_p95": "1",
    "false_colour": "1",
    "snr_flat": "1",
    "visible_noise": "1",
}
FLAT_SIZES = (64, 48, 32, 24, 16, 10)  # side of a flat region, pixels; the largest available is used
# Width of the surroundings that must be flat too, pixels, so that blur does not spread other content into the region.
MARGIN = 3
FLATNESS = 2e-3  # standard deviation over mean up to which a region counts as flat
DARKEST, BRIGHTEST, GREY = 0.02, 0.95, 0.18  # luminance over white: range of a region, and preferred value


@dataclass(frozen=True)
class Shot:
    """One picture of a camera: the compared variables, None for a variable that no stage of the pipeline writes."""

    rgb_camera: Any
    gains: Any = None  # (channel,), applied to ``rgb_camera`` by a balance of the mosaic
    time: float | None = None  # integration time, s, if a stage meters it
    rgb_linear: Any = None
    rgb_display: Any = None
    to_xyz: Any = None  # (3, 3), of the display: linear RGB to XYZ, Y = 1 for its white

    def xyz(self) -> Array:
        """Return the light of the display, within its range."""
        return apply_matrix(self.to_xyz, np.clip(self.rgb_linear, 0, 1))


class Flat(NamedTuple):
    """A uniform square of the scene: position and size, pixels."""

    row: int
    column: int
    size: int


def figures(shot: Shot, ideal: Shot, samples_per_degree: float) -> tuple[dict[str, float], Any, Flat | None]:
    """Return every metric of ``UNITS``, the map of CIEDE2000 (None without a display), and the uniform region used.

    Raises
    ------
    ValueError
        The pictures have different sizes.
    """
    if shot.rgb_camera.shape != ideal.rgb_camera.shape:
        raise ValueError(
            f"the picture has shape {shot.rgb_camera.shape}, but the picture of the ideal camera has shape "
            f"{ideal.rgb_camera.shape}"
        )
    found = dict.fromkeys(UNITS, float("nan"))
    brightest = float(np.max(ideal.rgb_camera))
    found["psnr_linear"] = fidelity.psnr(
        _as_exposed(shot, ideal), ideal.rgb_camera, brightest if brightest > 0 else 1.0
    )
    if shot.rgb_display is not None and ideal.rgb_display is not None:
        found["psnr_encoded"] = fidelity.psnr(shot.rgb_display, ideal.rgb_display)
    if shot.rgb_linear is None or ideal.rgb_linear is None:
        return found, None, None
    matrix = np.asarray(shot.to_xyz)
    white = matrix.sum(axis=1)
    if (
        shot.rgb_display is not None
        and ideal.rgb_display is not None
        and min(shot.rgb_display.shape[-2:]) >= fidelity.WINDOW
    ):
        luma = matrix[1:2] / matrix[1].sum()
        found["ssim"] = fidelity.ssim(apply_matrix(luma, shot.rgb_display), apply_matrix(luma, ideal.rgb_display))
    picture, reference = shot.xyz(), ideal.xyz()
    lab, lab_reference = difference.lab(picture, white), difference.lab(reference, white)
    shown = difference.delta_e_2000(lab, lab_reference)
    found["de_mean"], found["de_median"], found["de_p95"] = fidelity.spread(shown)
    seen = fidelity.spread(scielab.scielab(picture, reference, white, samples_per_degree))
    found["scielab_mean"], found["scielab_p95"] = seen.mean, seen.p95
    found["false_colour"] = artefacts.false_colour(lab, lab_reference)
    flat = flat_region(reference)
    if flat is not None:
        patch = picture[:, flat.row : flat.row + flat.size, flat.column : flat.column + flat.size]
        patch = without_slope(patch)
        spread, mean = float(patch[1].std()), float(patch[1].mean())
        found["snr_flat"] = mean / spread if spread > 0 else float("inf")
        if mean > 0:
            found["visible_noise"] = visible_noise(patch, white, samples_per_degree).value
    return found, shown, flat


def flat_region(xyz: Array) -> Flat | None:
    """Return the largest uniform square of a noise-free picture; if there are several, the square closest to a grey
    card.

    Uniform means that in the square and 3 pixels around it no plane's standard deviation exceeds 0.2 % of its mean, and
    luminance is between 0.02 and 0.95 of white.
    """
    planes = np.asarray(xyz, np.float64)
    rows, columns = planes.shape[1:]
    for size in FLAT_SIZES:
        wide = size + 2 * MARGIN
        if wide > min(rows, columns):
            continue
        mean, square = _box_means(planes, wide), _box_means(planes**2, wide)
        variance = np.maximum(square - mean**2, 0)
        level = mean[1]
        flat = np.all(variance <= (FLATNESS * mean) ** 2, axis=0) & (level >= DARKEST) & (level <= BRIGHTEST)
        if flat.any():
            distance = np.where(flat, np.abs(np.log(np.where(flat, level, 1) / GREY)), np.inf)
            row, column = np.unravel_index(np.argmin(distance), distance.shape)
            return Flat(int(row) + MARGIN, int(column) + MARGIN, size)
    return None


def without_slope(patch: Array) -> Any:
    """Return a patch (channel, y, x) from which the best-fitting plane was subtracted: shading is removed, the mean
    stays.
    """
    patch = np.asarray(patch, np.float64)
    y, x = (np.arange(n) - (n - 1) / 2 for n in patch.shape[1:])
    down = (patch.mean(axis=2) @ y) / (y @ y)
    across = (patch.mean(axis=1) @ x) / (x @ x)
    return patch - down[:, None, None] * y[:, None] - across[:, None, None] * x


def _as_exposed(shot: Shot, ideal: Shot) -> Any:
    """Return the camera primaries scaled to the exposure time and white-balance gains of the ideal camera. Differences
    in metering and white balance then do not count as errors.
    """
    scale = np.ones(len(shot.rgb_camera))
    for gains, sign in ((shot.gains, -1), (ideal.gains, 1)):
        scale *= 1.0 if gains is None else np.asarray(gains, np.float64) ** sign
    if shot.time and ideal.time:
        scale *= ideal.time / shot.time
    if np.all(scale == 1):
        return shot.rgb_camera
    return shot.rgb_camera * scale.astype(shot.rgb_camera.dtype)[:, None, None]


def _box_means(planes: Array, size: int) -> Any:
    """Return the mean of every ``size`` x ``size`` square inside the picture, indexed by the upper left corner of the
    square.
    """
    means = scipy.ndimage.uniform_filter(planes, (0, size, size), mode="nearest")
    before = size // 2
    rows, columns = (n - size + 1 for n in planes.shape[1:])
    return means[:, before : before + rows, before : before + columns]

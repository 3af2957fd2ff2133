"""Metrics of a picture against its reference.

In:  pairs of arrays (channel, y, x): the result of the alternatives, encoded, tristimulus.
Out: PSNR, RMSE, SSIM, CIEDE2000, zipper, false colour; None where there is nothing to measure.
"""

from __future__ import annotations

import numpy as np

from etendue.types.arrays import Array
from etendue_camera.colour import difference
from etendue_camera.quality import artefacts, fidelity

BORDER = 10  # pixels ignored at each side, because values beyond the border are unknown


def inside(picture: Array, border: int = BORDER) -> Array:
    """Return a picture without its border; unchanged if nothing would be left."""
    rows, columns = picture.shape[-2:]
    if min(rows, columns) <= 4 * border:
        return picture
    return picture[..., border : rows - border, border : columns - border]


def linear_figures(picture: Array, reference: Array, own_white: bool) -> dict[str, float | None]:
    """Return PSNR (dB) and RMSE for full scale 1. With ``own_white``, also return PSNR relative to the brightest value
    of the reference; pictures of different exposure can be ranked by this value.
    """
    ours, theirs = inside(picture), inside(reference)
    found = fidelity.psnr(ours, theirs)
    figures: dict[str, float | None] = {"psnr": found, "rmse": float(10 ** (-found / 20))}
    if own_white:
        peak = float(theirs.max())
        figures["psnr_white"] = fidelity.psnr(ours, theirs, peak) if peak > 0 else None
    return figures


def display_figures(picture: Array, reference: Array) -> dict[str, float | None]:
    """Return PSNR and structural similarity of encoded values."""
    ours, theirs = inside(picture), inside(reference)
    large = min(ours.shape[-2:]) >= fidelity.WINDOW
    return {"psnr_encoded": fidelity.psnr(ours, theirs), "ssim": fidelity.ssim(ours, theirs) if large else None}


def colour_figures(picture: Array, reference: Array, white: Array) -> dict[str, float | None]:
    """Return mean CIEDE2000, zipper and false colour of tristimulus values, for an eye adapted to a white."""
    ours, theirs = (difference.lab(np.asarray(inside(p), np.float64), white) for p in (picture, reference))
    return {
        "delta_e": float(difference.delta_e_2000(ours, theirs).mean()),
        "zipper": artefacts.zipper(ours, theirs),
        "false_colour": artefacts.false_colour(ours, theirs),
    }

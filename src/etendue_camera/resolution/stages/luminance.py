"""The luminance of every picture of a run: the weights that combine bands, channels and display values to a plane.

In:  transfer functions, matrices and white of all stages, pictures.
Out: planes (y, x), linear in light.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from etendue.api import Grid, Probe, quantity
from etendue_camera.arrays import FloatArray
from etendue_camera.colour import encoding as transfer
from etendue_camera.resolution.stages.analytic import one_channel

if TYPE_CHECKING:
    from etendue.compute.joined.otf import Otf

NOISE_FREE = ("irradiance", "photon_rate")
SATURATED = 1e-3  # fraction of clipped pixels above which a mosaic gives no valid edge
Seen = Sequence[tuple[str, FloatArray, Grid]]  # the arrays of a variable, by the stage that wrote it
LUMINANCE = (0.2126390058715104, 0.7151686787677559, 0.0721923153607337)  # of sRGB primaries


@dataclass(frozen=True, kw_only=True)
class PictureProbe(Probe):
    """A probe of the pictures of all stages, with the camera's transfer functions, matrices and white."""

    role: ClassVar = "resolution"
    with_grids: ClassVar = True
    reads: ClassVar = {
        "transfers": "*.transfer [1]",
        "lights": "*.white_irradiance wavelength [W m-2 nm-1]",
        "matrices": "*.colour_matrix component channel [1]",
        "whites": "*.white channel [1]",
        "irradiance": "*.irradiance wavelength y x [W m-2 nm-1]",
        "photon_rate": "*.photon_rate channel y x [electron/s]",
        "mosaic_linear": "*.mosaic_linear y x [1]",
        "rgb_camera": "*.rgb_camera channel y x [1]",
        "xyz_scene": "*.xyz_scene channel y x [1]",
        "rgb_linear": "*.rgb_linear channel y x [1]",
        "rgb_display": "*.rgb_display channel y x [1]",
    }
    beside: ClassVar = ("transfers", "lights", "matrices", "whites")

    pixel_pitch: float = quantity("pixel_pitch")
    pattern: str = quantity("pattern")


def weighed(
    transfers: Sequence[tuple[str, Otf]], matrices: Seen, whites: Seen, decode: Callable[[FloatArray], FloatArray]
) -> dict[str, Callable[[FloatArray], FloatArray]]:
    """Return the function that computes the luminance of each variable; ``decode`` is for encoded display values."""
    green = second_of(transfers)
    y_row, display = _luminance(matrices, whites), np.array(LUMINANCE)
    return {
        "irradiance": lambda a: np.tensordot(np.ones(len(a)) if green is None else green, a, 1),
        "photon_rate": lambda a: a[min(1, len(a) - 1)],
        "mosaic_linear": lambda a: a,
        "rgb_camera": lambda a: _mixed(y_row, a),
        "xyz_scene": lambda a: a[1],
        "rgb_linear": lambda a: _mixed(display, a),
        "rgb_display": lambda a: _mixed(display, decode(a)),
    }


def decoded(picture: FloatArray, encoding: str, exponent: float) -> FloatArray:
    """Return linear values from display values."""
    if encoding == "power":
        return transfer.gamma_signed(picture, 1 / exponent)
    return (transfer.srgb_decode if encoding == "sRGB" else transfer.bt709_decode)(picture)


def check_encoding(linear: Seen, encoded: Seen, encoding: str, exponent: float) -> None:
    """Raise ValueError unless the last encoded picture, decoded, equals the last linear picture within 0.01."""
    if not linear or not encoded:
        return
    apart = float(np.abs(np.clip(linear[-1][1], 0, 1) - decoded(encoded[-1][1], encoding, exponent)).max(initial=0.0))
    if apart > 0.01:
        raise ValueError(
            f"rgb_display decoded as {encoding} differs from rgb_linear by {apart:.2g}: give this stage the encoding "
            f"and the exponent of "
            "the stage encode"
        )


def channels_of(transfers: Sequence[tuple[str, Otf]]) -> FloatArray | None:
    """Return the photon weights of the pixel stage, (channel, wavelength); None without a pixel stage."""
    return next((otf.weights for _, otf in transfers if otf.weights is not None), None)


def second_of(transfers: Sequence[tuple[str, Otf]]) -> FloatArray | None:
    """Return the weights of the second channel, or of the only channel, (wavelength,); None without a pixel stage."""
    weights = channels_of(transfers)
    return None if weights is None else np.asarray(one_channel(weights), dtype=float)


def first_exposure(array: FloatArray, variable: str) -> FloatArray:
    """Return the picture of the first exposure, without the axis of the frames."""
    dims = 2 if variable == "mosaic_linear" else 3
    array = np.asarray(array)
    return array.reshape(-1, *array.shape[-dims:])[0]


def _mixed(weights: FloatArray | None, planes: FloatArray) -> FloatArray:
    own = (
        weights if weights is not None and len(weights) == len(planes) else np.eye(len(planes))[min(1, len(planes) - 1)]
    )
    return np.tensordot(own.astype(planes.dtype), planes, 1)


def _luminance(matrices: Seen, whites: Seen) -> FloatArray | None:
    """Return the weights that give Y from camera RGB by the fitted matrix, (channel,); None without a matrix."""
    if not matrices or not whites or len(whites[-1][1]) != matrices[-1][1].shape[1] or not np.all(whites[-1][1] > 0):
        return None
    return np.asarray(matrices[-1][1], dtype=float)[1] / np.asarray(whites[-1][1], dtype=float)

"""Rendering of camera arrays for viewing: light as the CIE 1931 observer sees it, channels by name, a mosaic in the
colours of its filters.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from etendue.contract.arrays.drawn import Drawn
from etendue_camera import spectra
from etendue_camera.arrays import FloatArray
from etendue_camera.colour import matrices
from etendue_camera.sensor import cfa

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from etendue.types.arrays import Array

TO_RGB = np.linalg.inv(matrices.RGB_TO_XYZ_SRGB)


def of_wavelength(drawn: Drawn, edges: NDArray[np.float64], names: Sequence[str]) -> FloatArray:
    """Return weights (3, wavelength) that show wavelength bands as an eye sees them; ``edges`` in nm. For a variable
    that is not light, the weights give the mean over the bands.
    """
    return (
        TO_RGB @ (spectra.colour_matching(edges) * np.diff(edges)[:, None]).T if drawn.linear else _mean(len(edges) - 1)
    )


def of_channel(drawn: Drawn, edges: Array | None, names: Sequence[str]) -> FloatArray | None:
    """Return weights (3, channel) that show channels as linear RGB. XYZ is shown as a viewer adapted to its white sees
    it. Other channels are averaged; None if the channels are R, G, B.
    """
    names = list(names)
    if names[:3] == ["R", "G", "B"]:
        return None
    if names != ["X", "Y", "Z"] or not drawn.linear:
        return _mean(len(names))
    if not drawn.viewer:
        return TO_RGB
    white = np.asarray(drawn.viewer, float)  # the viewer's white, not the white of the display
    return TO_RGB @ matrices.von_kries_matrix(
        white, matrices.xyz_from_xy(matrices.D65_XY), matrices.TRANSFORMS["bradford"]
    )


def of_pattern(text: str) -> tuple[tuple[str, ...], dict[str, tuple[float, float, float]]]:
    """Return the rows of letters of a colour filter array, and the colour of each letter."""
    mask = cfa.read(text)
    return mask.rows, {channel: cfa.tint(channel) for channel in mask.channels}


def _mean(planes: int) -> FloatArray:
    return np.full((3, planes), 1 / planes)

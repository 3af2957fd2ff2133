"""Whites: what a display shows with all its primaries on, what an illuminant makes of white paper.

In:  the name of an illuminant, of a measured display, or of an RGB space.
Out: XYZ with Y = 1.
"""

from __future__ import annotations

from typing import Any

from etendue import spectra
from etendue.physics import colour

TABLE_EDGES = tuple(float(w) for w in range(380, 785, 5))
MEASURED = ("Apple Studio Display", "Typical CRT Brainard 1997")  # displays whose primaries are spectra


def white_of(name: str) -> Any:
    """XYZ (Y = 1) of an illuminant, of a measured display with all primaries on, or of the white of an RGB space."""
    if name == "sRGB":
        return colour.xyz_from_xy(colour.D65_XY)
    if name in spectra.rgb_space_names():
        return colour.xyz_from_xy(spectra.rgb_space_primaries(name)[1])
    spd = spectra.display_primaries(name, TABLE_EDGES).sum(axis=1) if name in MEASURED else spectra.illuminant(name, TABLE_EDGES)
    xyz = spectra.colour_matching(TABLE_EDGES).T @ spd
    return xyz / xyz[1]

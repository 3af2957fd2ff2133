"""Whites: of a display with all primaries on, and of an illuminant on white paper.

In:  the name of an illuminant, of a measured display, or of an RGB space.
Out: XYZ with Y = 1.
"""

from __future__ import annotations

from etendue_camera import spectra
from etendue_camera.arrays import FloatArray
from etendue_camera.colour import matrices

TABLE_EDGES = tuple(float(w) for w in range(380, 785, 5))
D65_DISPLAYS = ("D65", "sRGB", "ebu")  # available without colour-science
MEASURED = ("Apple Studio Display", "Typical CRT Brainard 1997")  # displays whose primaries are spectra


def white_name(name: str) -> str:
    """Return the name of the illuminant that is the white of an RGB space; return the name of an illuminant or measured
    display unchanged.
    """
    if name in D65_DISPLAYS:
        return "D65"
    return spectra.rgb_space_white(name) if name in spectra.rgb_space_names() else name


def white_of(name: str) -> FloatArray:
    """Return XYZ (Y = 1) of an illuminant, of a measured display with all primaries on, or of an RGB space's white.

    Display standards give their white as the published chromaticity of an illuminant. The same chromaticity is used for
    the illuminant itself, so that "D65" equals the white of sRGB to the last bit; a sum over the spectrum of D65
    differs by 2e-4 in Z.
    """
    if name in D65_DISPLAYS:
        return matrices.xyz_from_xy(matrices.D65_XY)
    published = None if name in MEASURED else spectra.white_chromaticity(name)
    if published is not None:
        return matrices.xyz_from_xy(published)
    spd = (
        spectra.display_primaries(name, TABLE_EDGES).sum(axis=1)
        if name in MEASURED
        else spectra.illuminant(name, TABLE_EDGES)
    )
    xyz = spectra.colour_matching(TABLE_EDGES).T @ spd
    return xyz / xyz[1]

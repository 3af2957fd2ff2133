"""Whites: what a display shows with all its primaries on, what an illuminant makes of white paper.

In:  the name of an illuminant, of a measured display, or of an RGB space.
Out: XYZ with Y = 1.
"""

from __future__ import annotations

from etendue_camera import spectra
from etendue_camera.arrays import FloatArray
from etendue_camera.colour import matrices

TABLE_EDGES = tuple(float(w) for w in range(380, 785, 5))
D65_DISPLAYS = ("D65", "sRGB", "ebu")  # known without colour-science
MEASURED = ("Apple Studio Display", "Typical CRT Brainard 1997")  # displays whose primaries are spectra


def white_name(name: str) -> str:
    """The illuminant that is the white of an RGB space; the name itself of an illuminant or a measured display."""
    if name in D65_DISPLAYS:
        return "D65"
    return spectra.rgb_space_white(name) if name in spectra.rgb_space_names() else name


def white_of(name: str) -> FloatArray:
    """XYZ (Y = 1) of an illuminant, of a measured display with all primaries on, or of the white of an RGB space.

    Standards of displays give their white as the published chromaticity of an illuminant. An illuminant has it here
    too, so that "D65" is the white of sRGB to the last bit; a sum over its spectrum is off by 2e-4 in Z.
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

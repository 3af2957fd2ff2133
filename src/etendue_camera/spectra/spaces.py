"""RGB spaces, whites and adaptation transforms of colour-science.

In:  a name.
Out: matrices and chromaticities, read-only float64; ValueError for an unknown name.
"""

from etendue_camera.spectra import shipped
from etendue_camera.spectra.bins import FloatArray, frozen


def rgb_space_matrix(name: str) -> tuple[FloatArray, FloatArray]:
    """Return the RGB to XYZ matrix (3, 3) and white point xy (2,) of a space in ``colour.RGB_COLOURSPACES``.

    The matrix is taken from the standard as printed, so for "sRGB" it has four digits. Unknown names raise ValueError.
    """
    space = shipped.space(name)
    return frozen(space["matrix"]), frozen(space["white"])


def rgb_space_primaries(name: str) -> tuple[tuple[tuple[float, float], ...], tuple[float, float]]:
    """Return chromaticities xy of red, green, blue, and of the white, of a space in ``colour.RGB_COLOURSPACES``.

    Unknown names raise ValueError.
    """
    space = shipped.space(name)
    primaries = tuple((float(x), float(y)) for x, y in space["primaries"])
    return primaries, (float(space["white"][0]), float(space["white"][1]))


def rgb_space_white(name: str) -> str:
    """Return the name of the illuminant that is the white of a space in ``colour.RGB_COLOURSPACES``; if its white is no
    illuminant, return ``name``.

    A white counts as an illuminant if its chromaticity is the illuminant's published one.
    """
    space = shipped.space(name)
    published = white_chromaticity(str(space["white_name"]))
    own = (float(space["white"][0]), float(space["white"][1]))
    return str(space["white_name"]) if published == own else name


def white_chromaticity(name: str) -> tuple[float, float] | None:
    """Return xy of the white of an RGB space, or of an illuminant as published (CIE 15, 1931 observer); None for a
    light without such a chromaticity.
    """
    if name in list(shipped.names("space")):
        return rgb_space_primaries(name)[1]
    found = shipped.white(name)
    return None if found is None else (float(found[0]), float(found[1]))


def adaptation_matrix(name: str) -> FloatArray:
    """Return the matrix from XYZ to sharpened cone responses, (3, 3), by name: "Von Kries", "Bradford", "CAT02", ...

    ``name`` is one of ``colour.adaptation.CHROMATIC_ADAPTATION_TRANSFORMS``; other names raise ValueError.
    """
    return frozen(shipped.adaptation(name))

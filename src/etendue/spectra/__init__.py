"""Spectral tables as bin means: lights, eyes, cameras, displays, test charts. colour-science is imported late, here only."""

from etendue.spectra.bins import Edges, FloatArray, table_from_csv
from etendue.spectra.library import (
    absolute_scale,
    adaptation_matrix,
    camera_sensitivity,
    colorchecker,
    colour_matching,
    colour_version,
    cone_fundamentals,
    display_primaries,
    illuminant,
    load_library,
    luminous_efficiency,
    rgb_space_matrix,
    rgb_space_primaries,
    xyz_to_lms_matrix,
)
from etendue.spectra.names import check_camera, check_illuminant, check_rgb_space, rgb_space_names
from etendue.spectra.upsampling import srgb_to_xyz, upsampling_basis

__all__ = [
    "Edges", "FloatArray", "absolute_scale", "adaptation_matrix", "camera_sensitivity", "check_camera", "check_illuminant",
    "check_rgb_space", "colorchecker", "colour_matching", "colour_version", "cone_fundamentals", "display_primaries", "illuminant",
    "load_library", "luminous_efficiency", "rgb_space_matrix", "rgb_space_names", "rgb_space_primaries", "srgb_to_xyz",
    "table_from_csv", "upsampling_basis", "xyz_to_lms_matrix",
]  # fmt: skip

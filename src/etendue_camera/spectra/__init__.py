"""Spectral tables as bin means: lights, observers, cameras, displays, charts. The colour-science tables are shipped."""

from etendue_camera.spectra.authority import colour_version
from etendue_camera.spectra.bins import Edges, FloatArray, csv_rows, require_rows, table_from_csv
from etendue_camera.spectra.ends import cut_off_note, held_in_the_infrared, held_note
from etendue_camera.spectra.library import (
    camera_rows,
    camera_sensitivity,
    colorchecker,
    colour_matching,
    cone_fundamentals,
    display_primaries,
    illuminant,
    luminous_efficiency,
    xyz_to_lms_matrix,
)
from etendue_camera.spectra.luminance import (
    check_luminance,
    light_of_luminance,
    light_of_radiance,
    luminance_notes,
    luminance_of,
    rendered_share,
)
from etendue_camera.spectra.named import ENDINGS, spectrum
from etendue_camera.spectra.names import check_camera, check_illuminant, check_rgb_space, range_of, rgb_space_names
from etendue_camera.spectra.reflectances import require_shares
from etendue_camera.spectra.spaces import (
    adaptation_matrix,
    rgb_space_matrix,
    rgb_space_primaries,
    rgb_space_white,
    white_chromaticity,
)
from etendue_camera.spectra.upsampling import srgb_to_xyz, upsampling_basis

__all__ = [
    "ENDINGS",
    "Edges",
    "FloatArray",
    "adaptation_matrix",
    "camera_rows",
    "camera_sensitivity",
    "check_camera",
    "check_illuminant",
    "check_luminance",
    "check_rgb_space",
    "colorchecker",
    "colour_matching",
    "colour_version",
    "cone_fundamentals",
    "csv_rows",
    "cut_off_note",
    "display_primaries",
    "held_in_the_infrared",
    "held_note",
    "illuminant",
    "light_of_luminance",
    "light_of_radiance",
    "luminance_notes",
    "luminance_of",
    "luminous_efficiency",
    "range_of",
    "rendered_share",
    "require_rows",
    "require_shares",
    "rgb_space_matrix",
    "rgb_space_names",
    "rgb_space_primaries",
    "rgb_space_white",
    "spectrum",
    "srgb_to_xyz",
    "table_from_csv",
    "upsampling_basis",
    "white_chromaticity",
    "xyz_to_lms_matrix",
]

"""What this distribution provides: a ray-traced lens, in four stages."""

from __future__ import annotations

from etendue.api import hookimpl


@hookimpl
def etendue_stages() -> dict[str, str]:
    return {
        "real_lens": "etendue_lens_optiland.stages:Blur",
        "real_lens_distortion": "etendue_lens_optiland.stages:Distortion",
        "real_lens_illumination": "etendue_lens_optiland.stages:Illumination",
        "real_lens_numbers": "etendue_lens_optiland.stages:Numbers",
    }


@hookimpl
def etendue_variables() -> dict[str, dict[str, str]]:
    return {
        "real_focal_length": {"long_name": "effective focal length of the traced lens", "units": "mm"},
        "back_focal_distance": {"long_name": "back focal distance, from the last surface to the focus", "units": "mm"},
        "image_scale": {"long_name": "image height per tangent of the field angle, on axis", "units": "mm"},
        "axial_f_number": {"long_name": "working f-number, on axis"},
        "image_height": {"long_name": "image height of the chief ray", "units": "mm"},
        "strehl_ratio": {"long_name": "Strehl ratio"},
        "wavefront_rms": {"long_name": "rms wavefront error, in waves"},
        "distortion": {"long_name": "distortion, image height over the ideal minus one", "units": "percent"},
        "lateral_colour": {
            "long_name": "lateral colour, image height relative to that of the reference wavelength",
            "units": "um",
        },
        "real_illumination": {"long_name": "relative illumination of the traced cone"},
    }

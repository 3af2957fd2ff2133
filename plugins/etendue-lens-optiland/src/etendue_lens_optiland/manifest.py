"""What this distribution brings to etendue: a lens that is traced, in four stages."""

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
        "back_focal_distance": {"long_name": "distance from the last surface to the focus", "units": "mm"},
        "image_scale": {"long_name": "image height by tangent of the field angle, on the axis", "units": "mm"},
        "axial_f_number": {"long_name": "f-number of the cone on the axis"},
        "image_height": {"long_name": "image height of the chief ray", "units": "mm"},
        "strehl_ratio": {"long_name": "highest point of a point's picture over that without aberrations"},
        "wavefront_rms": {"long_name": "rms of the wavefront in wavelengths"},
        "distortion": {"long_name": "image height over that of the ideal lens, less one", "units": "percent"},
        "lateral_colour": {"long_name": "image height against that of the reference wavelength", "units": "um"},
        "real_illumination": {"long_name": "light of the traced cone relative to the axis"},
    }

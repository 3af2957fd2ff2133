"""The camera: quantities that several stages share, declared once.

``quantity("f_number")`` is the field of a stage that uses it. In a pipeline file they stand under ``[camera]``:
one value, however many stages use it.
"""

from __future__ import annotations

import math
from typing import Any

from etendue.spec.stage import MISSING, param

_Q: dict[str, tuple[Any, dict[str, Any]]] = {
    "f_number": (2.8, dict(at_least=0.5, at_most=1e6, doc="geometric f-number, focal length over entrance pupil")),
    "focal_length": (6.93, dict(units="mm", above=0, doc="effective focal length")),
    "magnification": (0.0, dict(at_most=0, doc="image over object size, signed: 0 at infinity, negative for a real image")),
    "pupil_magnification": (1.0, dict(above=0, doc="diameter of the exit pupil over that of the entrance pupil")),
    "focus_distance": (
        math.inf,
        dict(units="mm", above=0, infinite=True, doc="object-side distance from the front principal plane at which the lens is in focus"),
    ),
    "object_distance": (
        math.inf,
        dict(units="mm", above=0, infinite=True, doc="distance of the object from the front principal plane; inf: that of the focus"),
    ),
    "t_number": (0.0, dict(at_least=0, doc="photometric f-number; 0: f-number and transmittance hold")),
    "transmittance": (1.0, dict(above=0, at_most=1, doc="transmittance of the lens")),
    "aperture_model": ("aplanatic", dict(choices=("aplanatic", "flat_disc"), doc="E = pi L T/4N^2, or eq. 5")),
    "pixel_pitch": (5.4, dict(units="um", above=0, doc="distance between pixel centres")),
    "aperture_fraction": (0.741, dict(above=0, at_most=1, doc="side of the light-sensitive square over the pitch")),
    "integration_time": (0.01, dict(units="s", above=0, doc="exposure time")),
    "illuminant": ("D65", dict(doc="light on the scene: a CIE name, '<T> K', 'E' or '<w> nm'")),
    "sensitivity": ("Nikon 5100 (NPL)", dict(table=True, doc="a camera of colour-science, or the path of a CSV table")),
    "sensitivity_kind": ("system_qe", dict(choices=("system_qe", "filter_transmittance"), doc="what the table holds")),
    "sensitivity_per": ("photon", dict(choices=("photon", "energy"), doc="the table is per photon or per energy")),
    "peak_qe": (
        MISSING,
        dict(
            at_least=0,
            at_most=1,
            length=3,
            doc="peak quantum efficiency of each channel, such as [0.36, 0.44, 0.40]: name its source, or call it typical",
        ),
    ),
    "depletion_depth": (1.8, dict(units="um", above=0, doc="depletion depth L_d of the photodiode")),
    "diffusion_depth": (10.0, dict(units="um", above=0, infinite=True, doc="depth L of the quasi-neutral region")),
    "diffusion_length": (50.0, dict(units="um", above=0, infinite=True, doc="electron diffusion length L_n")),
    "surface_transmission": (1.0, dict(above=0, at_most=1, doc="light that enters the silicon")),
    "pattern": ("RGGB", dict(choices=("RGGB", "BGGR", "GRBG", "GBRG"), doc="colour filter array, first row first")),
    "full_well_density": (1000.0, dict(units="electron um-2", above=0, doc="charge capacity by light-sensitive area")),
    "dark_current_density": (1e-10, dict(units="A cm-2", at_least=0, doc="dark current by pixel area")),
    "read_noise": (10.0, dict(units="electron", at_least=0, doc="rms read noise of a pixel")),
    "dsnu": (2.0, dict(units="electron", at_least=0, doc="rms offset from pixel to pixel, fixed per sensor")),
    "bits": (12, dict(at_least=1, at_most=16, doc="bits of the converter")),
    "black_level": (64, dict(units="DN", at_least=0, doc="pedestal of the converter")),
    "conversion_gain": (0.0, dict(units="DN/electron", at_least=0, doc="of the converter; 0: full well at the top code")),
    "sensor_serial": ("1", dict(doc="which sensor: fixed patterns are its own")),
    "noise": ("independent", dict(choices=("independent", "common"), doc="draws between cells of a sweep")),
    "render_exposure": (1.0, dict(above=0, doc="display value of a diffuse white")),
}


def quantity(name: str) -> Any:
    """The dataclass field of a shared camera quantity."""
    default, allowed = _Q[name]
    return param(default, camera=True, **allowed)


def names() -> tuple[str, ...]:
    return tuple(_Q)


def default(name: str) -> Any:
    return _Q[name][0]

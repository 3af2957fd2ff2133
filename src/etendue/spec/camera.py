"""The camera: quantities that several stages share, declared once.

``quantity("f_number")`` is the field of a stage that uses it. In a pipeline file they stand under ``[camera]``:
one value, however many stages use it. Ranges reach beyond every camera by orders of magnitude, and end before a number of
32 bits does: what is within them plans and runs.
"""

from __future__ import annotations

import math
from typing import Any

from etendue.spec.stage import MISSING, Parameter, param

_Q: dict[str, tuple[Any, dict[str, Any]]] = {
    "f_number": (2.8, dict(at_least=0.5, at_most=1e6, doc="geometric f-number, focal length over entrance pupil")),
    "focal_length": (6.93, dict(units="mm", above=0, held=(1e-3, 1e6), doc="effective focal length")),
    "magnification": (0.0, dict(at_most=0, held=(-1e4, 0), doc="image over object size, signed: 0 at infinity, negative for a real image")),
    "pupil_magnification": (1.0, dict(above=0, held=(1e-3, 1e3), doc="diameter of the exit pupil over that of the entrance pupil")),
    "focus_distance": (
        math.inf,
        dict(units="mm", above=0, infinite=True, doc="object-side distance from the front principal plane at which the lens is in focus"),
    ),
    "object_distance": (
        math.inf,
        dict(units="mm", above=0, infinite=True, doc="distance of the object from the front principal plane; inf: that of the focus"),
    ),
    "t_number": (0.0, dict(at_least=0, held=(0, 1e6), doc="photometric f-number; 0: f-number and transmittance hold")),
    "transmittance": (1.0, dict(above=0, at_most=1, held=(1e-12, 1), doc="transmittance of the lens")),
    "aperture_model": ("aplanatic", dict(choices=("aplanatic", "flat_disc"), doc="E = pi L T/4N^2, or eq. 5")),
    "pixel_pitch": (5.4, dict(units="um", above=0, held=(1e-2, 1e4), doc="distance between pixel centres")),
    "aperture_fraction": (0.741, dict(above=0, at_most=1, held=(1e-3, 1), doc="side of the light-sensitive square over the pitch")),
    "aperture_offset_y": (
        0.0,
        dict(at_least=-0.5, at_most=0.5, doc="centre of the light-sensitive square from that of the pixel, in pitches"),
    ),
    "aperture_offset_x": (0.0, dict(at_least=-0.5, at_most=0.5, doc="the same along x")),
    "microlens_gain": (1.0, dict(at_least=1, doc="light that a microlens collects over that which falls on the light-sensitive square")),
    "integration_time": (0.01, dict(units="s", above=0, held=(1e-12, 1e9), doc="exposure time")),
    "illuminant": ("D65", dict(doc="light on the scene: a CIE name, '<T> K', 'E' or '<w> nm'")),
    "sensitivity": ("Nikon 5100 (NPL)", dict(table=True, doc="a camera of colour-science, the path of a CSV table, or flat")),
    "sensitivity_kind": ("system_qe", dict(choices=("system_qe", "filter_transmittance"), doc="what the table holds")),
    "sensitivity_per": ("photon", dict(choices=("photon", "energy"), doc="the table is per photon or per energy")),
    "peak_qe": (
        MISSING,
        dict(
            at_least=0,
            at_most=1,
            one_for_all=True,
            doc="peak quantum efficiency by channel, such as [0.36, 0.44, 0.40], or one for all: name its source, or call it typical",
        ),
    ),
    "depletion_depth": (1.8, dict(units="um", above=0, doc="depletion depth L_d of the photodiode")),
    "diffusion_depth": (10.0, dict(units="um", above=0, infinite=True, doc="depth L of the quasi-neutral region")),
    "diffusion_length": (50.0, dict(units="um", above=0, infinite=True, doc="electron diffusion length L_n")),
    "back": ("absorbing", dict(choices=("absorbing", "reflecting"), doc="what happens to electrons at the back of the diffusion depth")),
    "surface_transmission": (1.0, dict(above=0, at_most=1, held=(1e-12, 1), doc="light that enters the silicon")),
    "pattern": (
        "RGGB",
        dict(
            table=True,
            along="channel",
            doc="colour filter array, first row first: RGGB, BGGR, GRBG, GBRG, quad-RGGB and its orders, RGBW, X-Trans, RCCC, mono, "
            "rows of letters such as 'RG/GB', or the path of a .csv file with such rows",
        ),
    ),
    "crosstalk": (
        "per_plane",
        dict(
            choices=("per_plane", "through_filter"),
            doc="charge diffuses in front of the colour filters (stage diffusion), or behind them (stage crosstalk, after the mosaic)",
        ),
    ),
    "full_well_density": (1000.0, dict(units="electron um-2", above=0, held=(1e-3, 1e9), doc="charge capacity by light-sensitive area")),
    "dark_current_density": (1e-10, dict(units="A cm-2", at_least=0, held=(0, 1), doc="dark current by pixel area")),
    "temperature": (298.15, dict(units="K", at_least=150, at_most=450, doc="of the silicon, for its dark current")),
    "dark_reference_temperature": (298.15, dict(units="K", at_least=150, at_most=450, doc="at which dark_current_density holds")),
    "dark_doubling": (
        0.0,
        dict(units="K", at_least=0, doc="warming by which dark current doubles; 0: generation in the depletion region, 8.5 K at 298 K"),
    ),
    "analogue_gain": (1.0, dict(above=0, at_most=1e4, held=(1e-4, 1e4), doc="of the amplifier in front of the converter; 1: base")),
    "iso": (0.0, dict(at_least=0, doc="speed that sets the analogue gain, iso / base_iso; 0: analogue_gain holds")),
    "base_iso": (0.0, dict(at_least=0, doc="speed at analogue gain 1: saturation_iso of exposure_numbers there, or of a data sheet")),
    "read_noise_after": (
        0.0,
        dict(units="electron", at_least=0, held=(0, 1e6), doc="rms noise behind the amplifier, as electrons at gain 1; a gain divides it"),
    ),
    "read_noise": (10.0, dict(units="electron", at_least=0, held=(0, 1e6), doc="rms read noise of a pixel")),
    "dsnu": (2.0, dict(units="electron", at_least=0, held=(0, 1e6), doc="rms offset from pixel to pixel, fixed per sensor")),
    "bits": (12, dict(at_least=1, at_most=16, doc="bits of the converter")),
    "black_level": (64, dict(units="DN", at_least=0, doc="pedestal of the converter")),
    "conversion_gain": (0.0, dict(units="DN/electron", at_least=0, held=(0, 1e6), doc="of the converter; 0: full well at the top code")),
    "sensor_serial": ("1", dict(doc="which sensor: fixed patterns are its own")),
    "noise": ("independent", dict(choices=("independent", "common"), doc="draws between cells of a sweep")),
    "render_exposure": (1.0, dict(above=0, held=(1e-6, 1e6), doc="linear display value of a diffuse white that does not saturate")),
    "brightness": (
        "scene",
        dict(
            choices=("scene", "camera"),
            doc="what is shown as display white: the scene's white over render_exposure, at most what saturates; or what saturates, "
            "as on a camera set to manual, where a shorter exposure is darker",
        ),
    ),
}


def quantity(name: str) -> Any:
    """The dataclass field of a shared camera quantity."""
    default, allowed = _Q[name]
    return param(default, camera=True, **allowed)


def names() -> tuple[str, ...]:
    return tuple(_Q)


def default(name: str) -> Any:
    return _Q[name][0]


def declared(name: str) -> tuple[Parameter, Any]:
    """What is allowed for a quantity, and its default (``MISSING`` where it must be given)."""
    default_value, allowed = _Q[name]
    return Parameter(camera=True, **allowed), default_value

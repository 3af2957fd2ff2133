"""Colour: camera primaries to tristimulus values, white balance, display primaries, encoding.

In:  ``rgb_camera`` and what is known of the light (``white_radiance``, ``white_irradiance``).
Out: ``xyz_scene``, ``rgb_linear``, ``xyz_display``, ``rgb_display``; a variable's name says its colour state.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue import spectra
from etendue.api import RGB, XYZ, Grid, Labels, Stage, hookimpl, param, quantity
from etendue.physics import colour, transfer
from etendue.stages.crosstalk import mixing_of
from etendue.stages.gain_chain import GainChain
from etendue.stages.sensitivity import Collecting, electrons_per_irradiance, quantum_efficiency

TABLE_EDGES = tuple(float(w) for w in range(380, 785, 5))
SPACES = {"Von Kries": "von_kries_hpe_d65", "Bradford": "bradford", "CAT02": "cat02", "CAT16": "cat16"}
PRINTED_GAINS = (0.5844, 0.5753, 0.514)
DISPLAYS = ("Apple Studio Display", "Typical CRT Brainard 1997")


def white_of(name: str) -> Any:
    """XYZ (Y = 1) of an illuminant, or of a display with all primaries on."""
    cmf = spectra.colour_matching(TABLE_EDGES)
    spd = spectra.display_primaries(name, TABLE_EDGES).sum(axis=1) if name in DISPLAYS else None
    if spd is None:
        if name == "sRGB":
            return colour.xyz_from_xy(colour.D65_XY)
        spd = spectra.illuminant(name, TABLE_EDGES)
    xyz = cmf.T @ spd
    return xyz / xyz[1]


@dataclass(frozen=True, kw_only=True)
class WhiteSignal(GainChain, Collecting):
    """What a camera makes of a perfect white diffuser after a time."""

    def grid(self, inputs: Any) -> dict[str, Grid]:
        return {"white": Grid.of({"channel": Labels(self.channels)})}

    def prepare(self, coordinates: Any) -> Any:
        edges = tuple(coordinates["wavelength_edges"])
        return electrons_per_irradiance(self, edges), edges

    def after(self, time: float, white_irradiance: Any, prepared: Any) -> dict[str, Any]:
        rates = prepared[0] * white_irradiance
        electrons = mixing_of(self, prepared[1], rates) @ rates.sum(axis=1) * time
        return {"white": electrons * (self.dn_per_electron() / self.white())}

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (2e-7 if precision == "float32" else 1e-15), "proved"


@dataclass(frozen=True, kw_only=True)
class White(WhiteSignal):
    """The camera's linear signal of a perfect white diffuser on the axis: from the illuminant, noise-free."""

    reads: ClassVar = {"white_irradiance": "wavelength [W m-2 nm-1]"}
    writes: ClassVar = {"white": "channel [1]"}
    nanoseconds: ClassVar = 100.0
    libraries: ClassVar = ("colour-science",)

    integration_time: float = quantity("integration_time")

    def run(self, white_irradiance: Any, prepared: Any) -> dict[str, Any]:
        return self.after(self.integration_time, white_irradiance, prepared)


@dataclass(frozen=True, kw_only=True)
class WhiteMetered(WhiteSignal):
    """``white`` after the time that the metering has found."""

    reads: ClassVar = {"white_irradiance": "wavelength [W m-2 nm-1]", "exposure_time": "[s]"}
    writes: ClassVar = {"white": "channel [1]"}
    nanoseconds: ClassVar = 100.0
    libraries: ClassVar = ("colour-science",)

    def run(self, white_irradiance: Any, exposure_time: Any, prepared: Any) -> dict[str, Any]:
        return self.after(float(exposure_time), white_irradiance, prepared)


@dataclass(frozen=True, kw_only=True)
class ColourFit(Collecting):
    """Least squares from white-balanced camera primaries to XYZ, over the ColorChecker under the scene's light.

    White is kept exactly. ``fit_residual`` is the rms error in XYZ (white Y = 1), ``fit_condition`` the condition number.
    For any number of channels: one gives luminance in the colour of the white, two a plane of colours, and the residual
    says how far that is from the truth. Crosstalk behind the filters is in the camera's primaries, as it is in a picture.
    """

    reads: ClassVar = {"white_radiance": "wavelength [W m-2 sr-1 nm-1]", "white_irradiance": "wavelength [W m-2 nm-1]"}
    writes: ClassVar = {
        "colour_matrix": "component channel [1]",
        "white_xyz": "component [1]",
        "fit_residual": "[1]",
        "fit_condition": "[1] nan",  # no number where the white is a single colour
    }
    creates: ClassVar = {"component": XYZ}
    nanoseconds: ClassVar = 1000.0
    libraries: ClassVar = ("colour-science",)

    def grid(self, inputs: Any) -> dict[str, Grid]:
        return {"colour_matrix": Grid.of({"component": XYZ, "channel": Labels(self.channels)})}

    def prepare(self, coordinates: Any) -> Any:
        edges = tuple(coordinates["wavelength_edges"])
        centres = coordinates["wavelength"] * np.diff(coordinates["wavelength_edges"])
        response = quantum_efficiency(self, edges) * centres
        return response, spectra.colour_matching(edges), spectra.colorchecker(edges)[1], edges

    def run(self, white_radiance: Any, white_irradiance: Any, prepared: Any) -> dict[str, Any]:
        response, cmf, reflectance, edges = prepared
        light = np.asarray(white_irradiance, dtype=float)
        response = mixing_of(self, edges, response * light) @ response
        camera_white = response @ light
        if not np.all(camera_white > 0):
            names = ", ".join(self.channels)
            raise ValueError(f"the white has a dead channel ({names} = {camera_white}): look at the filter, the illuminant, peak_qe")
        samples = (reflectance * light) @ response.T / camera_white
        scene = np.asarray(white_radiance, dtype=float) * np.diff(edges)
        white = cmf.T @ scene
        if not white[1] > 0:
            raise ValueError(f"the scene's white has no luminance (X, Y, Z = {white}): look at the illuminant and the wavelengths")
        targets = (reflectance * scene) @ cmf / white[1]
        fit = colour.fit_matrix(samples, targets, white_sample=np.ones(len(response)), white_target=white / white[1])
        return {
            "colour_matrix": fit.matrix, "white_xyz": white / white[1],
            "fit_residual": np.array(fit.residual), "fit_condition": np.array(fit.condition),
        }  # fmt: skip

    def warn(self, facts: Any, grids: Any) -> list[str]:
        few = {1: "pictures are luminance in the colour of the white", 2: "colours between its two are guessed"}
        count = len(self.channels)
        if count > 2:
            return []
        return [f"the pattern {self.pattern!r} has {count} channel{'s' * (count > 1)}, too few for colour: {few[count]}; see fit_residual"]

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-6 if precision == "float32" else 1e-12), "fitted"


@dataclass(frozen=True, kw_only=True)
class CameraToXyz(Stage):
    """Camera primaries over the white, times the fitted matrix: a white diffuser has Y = 1.

    Where a channel is clipped its true value is unknown. ``highlights = "neutral"`` ends all balanced channels at the
    level at which the first of them clips, so that what is too bright turns white and not magenta.
    """

    reads: ClassVar = {"rgb_camera": "channel y x [1]", "white": "channel [1]", "colour_matrix": "component channel [1]"}
    writes: ClassVar = {"xyz_scene": "channel y x [1]"}
    creates: ClassVar = {"channel": XYZ}
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 5.0

    highlights: str = param("neutral", choices=("neutral", "keep"), doc="what becomes of clipped channels")

    def grid(self, inputs: Any) -> dict[str, Grid]:
        found = {port: tuple(inputs[port]["channel"].values()) for port in ("rgb_camera", "white", "colour_matrix")}
        if len(set(found.values())) > 1:
            text = ", ".join(f"{port} {' '.join(map(str, names))}" for port, names in found.items())
            raise ValueError(f"channels differ: {text}; the demosaicer, white and colour_fit work on the same pattern")
        return {"xyz_scene": inputs["rgb_camera"].replace(channel=XYZ)}

    def run(self, rgb_camera: Any, white: Any, colour_matrix: Any) -> dict[str, Any]:
        if not np.all(white > 0):
            raise ValueError(f"the white has a dead channel: {white}; look at the filter, the illuminant and peak_qe")
        balance = 1.0 / np.asarray(white, dtype=float)
        matrix = np.asarray(colour_matrix, dtype=float) * balance
        if self.highlights == "neutral":
            first_to_clip = balance.min()
            rgb_camera = np.minimum(rgb_camera, (first_to_clip / balance).astype(rgb_camera.dtype)[:, None, None])
        return {"xyz_scene": colour.apply_matrix(matrix, rgb_camera)}

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-6 if precision == "float32" else 2e-15), "measured"


@dataclass(frozen=True, kw_only=True)
class Balance(Stage):
    """Von Kries in a named cone space: scene white to the target's white, or the paper's printed diagonal (eq. 14)."""

    reads: ClassVar = {"xyz_scene": "channel y x [1]", "white_xyz": "component [1]"}
    writes: ClassVar = {"xyz_scene": "channel y x [1]"}
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 5.0
    libraries: ClassVar = ("colour-science",)

    space: str = param("Von Kries", choices=tuple(SPACES), doc="cone space of the gains")
    target: str = param("D65", doc="white of the display: an illuminant or a display")
    gains: str = param("white", choices=("white", "as_printed"), doc="from the scene's white, or the paper's diagonal with its scale")

    def __post_init__(self) -> None:
        if self.target not in ("sRGB", *DISPLAYS):
            spectra.check_illuminant(self.target, TABLE_EDGES[0], TABLE_EDGES[-1])

    def prepare(self, coordinates: Any) -> Any:
        return white_of(self.target)

    def viewing_white(self) -> Any:
        """XYZ of the white to which a viewer of the result is adapted, for pictures of it; None: that of the picture."""
        return white_of(self.target) if self.gains == "white" else None

    def run(self, xyz_scene: Any, white_xyz: Any, prepared: Any) -> dict[str, Any]:
        cones = colour.TRANSFORMS[SPACES[self.space]]
        if self.gains == "as_printed":
            matrix = np.linalg.solve(cones, np.diag(PRINTED_GAINS) @ cones)
        else:
            matrix = colour.von_kries_matrix(np.asarray(white_xyz, dtype=float), prepared, cones)
        return {"xyz_scene": colour.apply_matrix(matrix, xyz_scene)}

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-6 if precision == "float32" else 3e-15), "measured"


@dataclass(frozen=True, kw_only=True)
class Display(Stage):
    """Tristimulus values to linear display primaries: the inverse of primaries x cones (section 3.2 of the paper)."""

    reads: ClassVar = {"xyz_scene": "channel y x [1]"}
    writes: ClassVar = {"rgb_linear": "channel y x [1]"}
    creates: ClassVar = {"channel": RGB}
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 5.0
    libraries: ClassVar = ("colour-science",)

    display: str = param("sRGB", choices=("sRGB", *DISPLAYS), doc="whose primaries; not sRGB: measured spectra and cone fundamentals")
    render_exposure: float = quantity("render_exposure")

    def grid(self, inputs: Any) -> dict[str, Grid]:
        return {"rgb_linear": inputs["xyz_scene"].replace(channel=RGB)}

    def prepare(self, coordinates: Any) -> Any:
        if self.display == "sRGB":
            return np.linalg.inv(colour.RGB_TO_XYZ_SRGB)
        primaries = spectra.display_primaries(self.display, TABLE_EDGES)
        to_lms = spectra.cone_fundamentals(TABLE_EDGES).T @ primaries
        fitted = spectra.xyz_to_lms_matrix(TABLE_EDGES)
        white = white_of(self.display)
        # The cones are no exact mixture of the colour-matching functions: rows are scaled so that white stays white.
        lms_white = to_lms.sum(axis=1)
        fitted = fitted * (lms_white / (fitted @ white))[:, None]
        return np.linalg.solve(to_lms, fitted)

    def run(self, xyz_scene: Any, prepared: Any) -> dict[str, Any]:
        return {"rgb_linear": colour.apply_matrix(prepared * self.render_exposure, xyz_scene)}

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (2e-6 if precision == "float32" else 5e-15), "measured"


@dataclass(frozen=True, kw_only=True)
class ToXyz(Stage):
    """Linear RGB to XYZ by eq. 16: full precision by default, printed forms by name."""

    reads: ClassVar = {"rgb_linear": "channel y x [1]"}
    writes: ClassVar = {"xyz_display": "channel y x [1]"}
    creates: ClassVar = {"channel": XYZ}
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 5.0

    matrix: str = param("ebu", choices=("ebu", "sRGB", "eq16_corrected_3digit", "eq16_as_printed"))

    def grid(self, inputs: Any) -> dict[str, Grid]:
        return {"xyz_display": inputs["rgb_linear"].replace(channel=XYZ)}

    def run(self, rgb_linear: Any) -> dict[str, Any]:
        matrices = {
            "ebu": colour.RGB_TO_XYZ_PAL, "sRGB": colour.RGB_TO_XYZ_SRGB,
            "eq16_corrected_3digit": colour.EQ16_CORRECTED, "eq16_as_printed": colour.EQ16_AS_PRINTED,
        }  # fmt: skip
        return {"xyz_display": colour.apply_matrix(matrices[self.matrix], rgb_linear)}

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-6 if precision == "float32" else 1e-15), "measured"


@dataclass(frozen=True, kw_only=True)
class Encode(Stage):
    """Gamma: linear display values to encoded ones, clipped to the display's range; what was clipped is counted."""

    reads: ClassVar = {"rgb_linear": "channel y x [1]"}
    writes: ClassVar = {"rgb_display": "channel y x [1]", "gamut_clipped": "[1]"}
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 15.0

    encoding: str = param("sRGB", choices=("sRGB", "BT.709", "power"))
    exponent: float = param(0.45, above=0, at_most=5, doc="of encoding 'power' (eq. 15)")

    def run(self, rgb_linear: Any) -> dict[str, Any]:
        kind = rgb_linear.dtype.type
        inside = np.clip(rgb_linear, kind(0), kind(1))
        outside = np.count_nonzero(inside != rgb_linear) / max(rgb_linear.size, 1)
        if self.encoding == "power":
            encoded = transfer.gamma_signed(inside, self.exponent)
        else:
            encoded = (transfer.srgb_encode if self.encoding == "sRGB" else transfer.bt709_encode)(inside)
        return {"rgb_display": encoded, "gamut_clipped": np.array(outside)}

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-6 if precision == "float32" else 1e-15), "measured"


@hookimpl
def etendue_stages() -> dict[str, type]:
    return {
        "white": White, "white_metered": WhiteMetered, "colour_fit": ColourFit, "camera_to_xyz": CameraToXyz, "balance": Balance,
        "display": Display, "to_xyz": ToXyz, "encode": Encode,
    }  # fmt: skip

"""Declarations of variables: ``"wavelength y x [W m-2 nm-1]"``, read and printed.

In:  the text beside a port in a stage's ``reads`` or ``writes``.
Out: name, dims, unit, dtype and whether undefined values are allowed.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

_FORM = re.compile(r"^\s*(?:(?P<name>[\w.*]+)\s*:)?\s*(?P<dims>[^\[\]]*?)\s*\[(?P<unit>[^\]]*)\]\s*(?P<flags>.*?)\s*$")
DTYPES = ("float", "uint8", "uint16", "uint32")

LONG_NAMES = {
    "radiance": "spectral radiance of the scene on the image-plane grid",
    "white_radiance": "spectral radiance of a perfect white diffuser in the scene",
    "irradiance": "spectral irradiance in front of the sensor",
    "white_irradiance": "spectral irradiance of a perfect white diffuser on the axis",
    "photon_rate": "photoelectrons per second at the pixel centres, behind each filter",
    "photocurrent": "photoelectrons per second behind the colour filter array",
    "expected_charge": "expected charge at the end of the exposure",
    "charge": "charge in the pixel",
    "raw": "raw digital number",
    "mosaic_linear": "linearised mosaic, 1 at clipping",
    "rgb_camera": "linear camera primaries",
    "white": "linear camera signal that is shown as display white",
    "white_saturated": "channels in which a white diffuser lies above saturation",
    "clipping_level": "level of the mosaic from which pixels are clipped",
    "white_error": "angle between the camera's white and that of the illuminant",
    "white_used": "share of the picture in which the white was looked for",
    "channels_floored": "channels of the white which were lifted to the floor",
    "cones_floored": "cone responses of the scene's white which were lifted to the floor",
    "directions_floored": "directions of colour of which the channels say nothing, given none",
    "balance_gains": "gains that make the channels of a white diffuser equal",
    "defects_corrected": "pixels replaced",
    "defects_left": "pixels found defective without sound neighbours to replace them",
    "defects_missed": "defective pixels that were not found",
    "false_alarms": "sound pixels replaced",
    "xyz_scene": "scene tristimulus values, white diffuser Y = 1",
    "white_xyz": "tristimulus values of the scene white, Y = 1",
    "colour_matrix": "white-balanced camera primaries to tristimulus values",
    "rgb_linear": "linear display primaries",
    "lms": "cone responses to the displayed light, its white 1",
    "xyz_display": "tristimulus values of the displayed light",
    "rgb_display": "encoded display values",
    "mtf50": "frequency of half contrast",
    "mtf50_lp_mm": "frequency of half contrast, line pairs per mm",
    "mtf10": "frequency at which contrast has fallen to a tenth",
    "cut_off": "highest frequency with any contrast to speak of",
    "nyquist": "Nyquist frequency of the pixels",
    "mtf_nyquist": "contrast at the Nyquist frequency",
    "aliasing": "share of the energy of a line's picture beyond the Nyquist frequency",
    "rayleigh": "separation of two points with the dip of Rayleigh's criterion",
    "sparrow": "largest separation of two points without a dip",
    "effective_lp_mm": "MTF50, at most the Nyquist frequency, line pairs per mm",
    "effective_cycles": "MTF50, at most the Nyquist frequency",
    "effective_line_widths": "MTF50, at most the Nyquist frequency, line widths per picture height",
    "resolution_gain": "MTF50 without a factor over MTF50 with it",
    "limiting_factor": "index of the factor that limits resolution",
    "edge_mtf50": "frequency of half contrast of a measured edge",
    "edge_mtf50_low": "lower end of its 95 % interval",
    "edge_mtf50_high": "upper end of its 95 % interval",
    "edge_mtf50_cycles": "frequency of half contrast of a measured edge",
    "edge_effective_lp_mm": "MTF50 of a measured edge, at most the Nyquist frequency, line pairs per mm",
    "edge_effective_cycles": "MTF50 of a measured edge, at most the Nyquist frequency",
    "edge_effective_line_widths": "MTF50 of a measured edge, at most the Nyquist frequency, line widths per picture height",
    "edge_mtf10": "frequency at which contrast of a measured edge has fallen to a tenth",
    "edge_aliasing": "share of the energy of a measured line spread above 0.5 cycles/pixel",
    "edge_angle": "angle between a measured edge and the nearer axis of the raster",
    "edge_analytic": "frequency of half contrast of the transfer functions along the edge's normal",
    "edge_difference": "measured minus analytic frequency of half contrast",
    "star_mtf50": "frequency of half contrast of a measured Siemens star",
    "star_mtf50_cycles": "frequency of half contrast of a measured Siemens star",
    "star_mtf10": "frequency at which contrast of a measured Siemens star has fallen to a tenth",
    "leaves_mtf50": "frequency of half contrast of a measured texture",
    "leaves_mtf50_cycles": "frequency of half contrast of a measured texture",
    "edge_flags": "1 above Nyquist, 2 not reached, 4 clipped, 8 noisy, 16 no edge",
    "mtf50_gain": "frequency of half contrast behind a restoration over that in front of it",
    "noise_gain": "standard deviation of white noise behind a restoration over that in front of it",
    "mean_snr": "mean signal-to-noise ratio",
    "clipped_fraction": "share of clipped pixels",
    "black_fraction": "share of black pixels",
    "working_f_number": "f-number of the cone at the image",
    "equivalent_t_number": "photometric f-number at infinity",
    "exit_pupil_distance": "distance from the exit pupil to the sensor",
    "near_limit": "nearest distance within the depth of field, from the front principal plane",
    "far_limit": "farthest distance within the depth of field, from the front principal plane",
    "hyperfocal_distance": "nearest focus whose depth of field reaches infinity",
    "etendue": "etendue of a pixel on the axis",
    "cone_half_angle": "half angle of the cone of light at the image, on the axis",
    "illuminance": "illuminance of a white diffuser's image on the axis",
    "illuminance_grey": "illuminance of a grey diffuser's image on the axis",
    "dr_elgamal": "dynamic range, dark noise as smallest signal",
    "dr_emva": "dynamic range, SNR = 1 as smallest signal",
    "dr_elgamal_stops": "dynamic range, dark noise as smallest signal",
    "dr_emva_stops": "dynamic range, SNR = 1 as smallest signal",
    "system_gain": "digital numbers per electron",
    "integration_time": "time of exposure",
    "merged_variance": "variance of the merged value, as of a mosaic",
    "exposure_value": "log2 of squared f-number over time",
    "saturation_iso": "saturation-based ISO speed",
    "snr_18": "temporal signal-to-noise ratio of an 18 % grey card",
    "snr10_illuminance": "illuminance of the scene at which an 18 % grey card has a signal-to-noise ratio of 10",
    "defect_map": "0 good, 1 hot, 2 dead, 3 stuck",
    "stuck_map": "0 good, 3 stuck",
}


@dataclass(frozen=True)
class Declaration:
    """What a port carries.

    ``dims`` are those a stage works on; over any others that lead what it is given, the engine maps it. ``dtype`` is ``float`` (the
    plan's precision) or an unsigned integer type. ``nan`` allows undefined values. What is ``optional`` is computed where
    it is asked for.
    """

    variable: str
    dims: tuple[str, ...]
    unit: str
    dtype: str = "float"
    nan: bool = False
    optional: bool = False

    def __str__(self) -> str:
        flags = "".join(
            f" {flag}"
            for flag in (self.dtype if self.dtype != "float" else "", "nan" if self.nan else "", "optional" if self.optional else "")
            if flag
        )
        return f"{self.variable}: {' '.join(self.dims)} [{self.unit}]{flags}".replace("  ", " ")

    def mapped(self, dims: tuple[str, ...]) -> tuple[str, ...] | None:
        """The dims over which a stage is mapped that is given an array with these dims; None where it cannot take it."""
        extra = dims[: len(dims) - len(self.dims)]
        return extra if dims == (*extra, *self.dims) and not set(extra) & set(self.dims) else None

    def led_by(self, mapped: tuple[str, ...]) -> Declaration:
        """The same with the dims in front over which a stage is mapped, as far as it has none of them itself."""
        return replace(self, dims=(*mapped, *self.dims)) if mapped and not set(mapped) & set(self.dims) else self


def parse_declaration(port: str, text: str) -> Declaration:
    """Read one declaration; the variable is the port unless the text names one."""
    if text.startswith("*."):  # what a probe looks at, in every stage
        variable, _, rest = text.partition(" ")
        text = f"{variable}: {rest or '[1]'}"
    match = _FORM.match(text)
    if not match:
        raise ValueError(f"cannot read the declaration {port!r}: {text!r}; expected 'dims [unit]'")
    dtype, nan, optional = "float", False, False
    for flag in match["flags"].split():
        if flag == "nan":
            nan = True
        elif flag == "optional":
            optional = True
        elif flag in DTYPES:
            dtype = flag
        else:
            raise ValueError(f"unknown word {flag!r} in the declaration of {port!r}; valid: nan, optional, {', '.join(DTYPES)}")
    return Declaration(match["name"] or port, tuple(match["dims"].split()), match["unit"].strip(), dtype, nan, optional)

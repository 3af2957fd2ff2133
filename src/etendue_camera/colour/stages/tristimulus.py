"""Colour: camera RGB to tristimulus values, and chromatic adaptation to another viewing white.

In:  ``rgb_camera`` and the white of the light (``white_radiance``, ``white_irradiance``).
Out: ``xyz_scene``; for its rendering on a display see ``display.py``.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import ClassVar

import numpy as np

from etendue import require
from etendue.api import XYZ, Facts, Grid, Haloed, Labels, Viewed, fitted, measured, param, quantity
from etendue_camera import spectra
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.colour import matrices
from etendue_camera.colour.stages.display_white import MEASURED, TABLE_EDGES, white_name, white_of
from etendue_camera.mosaic import white_balance
from etendue_camera.sensor.stages.crosstalk import mixing_of
from etendue_camera.sensor.stages.sensitivity import Collecting, quantum_efficiency

SPACES = {"Von Kries": "von_kries_hpe_d65", "Bradford": "bradford", "CAT02": "cat02", "CAT16": "cat16"}
VISIBLE = (380.0, 780.0)  # nm
PRINTED_GAINS = (0.5844, 0.5753, 0.514)


@dataclass(frozen=True, kw_only=True)
class ColourFit(Collecting):
    """Fit a matrix from white-balanced camera RGB to XYZ by least squares, over reflectances under the scene's light.

    White is exact by default. ``fit_residual`` is the rms error in XYZ (white Y = 1), ``fit_condition`` the condition
    number.

    Channels with equal responses do not distinguish some colours: such directions are set to zero and counted in
    ``directions_floored``. Any number of channels is allowed: one channel gives luminance in the colour of the white,
    two give a plane of colours; the residual states the error. Crosstalk below the filters is included in the camera
    RGB, as in a picture.
    """

    role: ClassVar = "colour matrix"
    reads: ClassVar = {"white_radiance": "wavelength [W m-2 sr-1 nm-1]", "white_irradiance": "wavelength [W m-2 nm-1]"}
    writes: ClassVar = {
        "colour_matrix": "component channel [1]",
        "white_xyz": "component [1]",
        "fit_residual": "[1]",
        "fit_condition": "[1] nan",  # undefined where the white is a single colour
        "directions_floored": "[1]",
    }
    creates: ClassVar = {"component": XYZ}
    nanoseconds: ClassVar = 1000.0
    libraries: ClassVar = ("colour-science",)
    error: ClassVar = fitted(1e-6, 1e-12)

    reflectances: str = param(
        "ColorChecker",
        table=True,
        doc="ColorChecker, or a CSV file: wavelength_nm, then one column per patch; end values are extended",
    )
    white: str = param(
        "kept",
        choices=("kept", "fitted"),
        doc="whether the matrix maps the white of the light exactly, or fits it like any patch",
    )
    ridge: float = param(
        0.0,
        at_least=0,
        doc="regularisation: weight of the matrix norm relative to the error; a larger weight gives less noise "
        "and more colour error",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        require.that(
            self.reflectances == "ColorChecker" or self.reflectances.endswith(spectra.ENDINGS),
            f"reflectances is {self.reflectances!r}; it must be ColorChecker or the path of a .csv or .spdx table",
        )
        if not min(self.peak_qe) > 0:
            raise ValueError(
                f"peak_qe is {list(self.peak_qe)}: no matrix can use a channel without response; give "
                f"every channel a "
                "peak above 0, or remove the stage colour_fit"
            )

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        if self.reflectances != "ColorChecker":
            spectra.require_shares("reflectances", self.reflectances)
        edges, channels = inputs["white_radiance"].bands().edges, len(self.channels)
        seen = sum(below < VISIBLE[1] and above > VISIBLE[0] for below, above in pairwise(edges))
        if seen < channels and self.ridge == 0:
            raise ValueError(
                f"{seen} of {len(edges) - 1} bands from {edges[0]:g} to {edges[-1]:g} nm are visible, and "
                f"{seen} cannot separate "
                f"{channels} channels: use a narrower bin_width, or wavelengths from {VISIBLE[0]:g} to "
                f"{VISIBLE[1]:g} nm"
            )
        return {"colour_matrix": Grid.of({"component": XYZ, "channel": Labels(self.channels)})}

    def prepare(self, coordinates: Mapping[str, Array]) -> tuple[FloatArray, FloatArray, FloatArray, tuple[float, ...]]:
        edges = tuple(coordinates["wavelength_edges"])
        centres = coordinates["wavelength"] * np.diff(coordinates["wavelength_edges"])
        response = quantum_efficiency(self, edges) * centres
        return response, spectra.colour_matching(edges), self.patches(edges), edges

    def patches(self, edges: tuple[float, ...]) -> FloatArray:
        """Return the reflectance of each patch, (patch, wavelength)."""
        if self.reflectances == "ColorChecker":
            return spectra.colorchecker(edges)[1]
        return spectra.table_from_csv(self.reflectances, edges, outside="hold")[1].T

    def run(
        self,
        white_radiance: FloatArray,
        white_irradiance: FloatArray,
        prepared: tuple[FloatArray, FloatArray, FloatArray, tuple[float, ...]],
    ) -> dict[str, Array]:
        response, cmf, reflectance, edges = prepared
        light = np.asarray(white_irradiance, dtype=float)
        response = mixing_of(self, edges, response * light) @ response
        camera_white = response @ light
        if not np.all(camera_white > 0):
            names = ", ".join(self.channels)
            raise ValueError(
                f"the white has a dead channel ({names} = {camera_white}): check the filter, the illuminant and peak_qe"
            )
        samples = (reflectance * light) @ response.T / camera_white
        scene = np.asarray(white_radiance, dtype=float) * np.diff(edges)
        white = cmf.T @ scene
        require.that(
            white[1] > 0,
            f"the scene's white has no luminance (X, Y, Z = {white}): check the illuminant and the wavelengths",
        )
        targets = (reflectance * scene) @ cmf / white[1]
        kept = self.white == "kept"
        fit = matrices.fit_matrix(
            samples,
            targets,
            np.ones(len(response)) if kept else None,
            white / white[1] if kept else None,
            ridge=self.ridge,
            least=True,
        )
        return {
            "colour_matrix": fit.matrix,
            "white_xyz": white / white[1],
            "fit_residual": np.array(fit.residual),
            "fit_condition": np.array(fit.condition if fit.condition < 1e15 else np.nan),
            "directions_floored": np.array(float(fit.undetermined)),
        }

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        few = {
            1: "pictures are luminance in the colour of the white",
            2: "colours outside one plane cannot be determined",
        }
        count, edges = len(self.channels), grids["white_radiance"].bands().edges
        said: list[str] = []
        if self.reflectances != "ColorChecker":
            said += spectra.held_note(self.reflectances, spectra.csv_rows(self.reflectances)[1], edges[0], edges[-1])
        if count > 2:
            return said
        channels = f"{count} channel{'s' * (count > 1)}"
        said.append(f"the pattern {self.pattern!r} has {channels}, too few for colour: {few[count]}; see fit_residual")
        return said


@dataclass(frozen=True, kw_only=True)
class CameraToXyz(Haloed):
    """Apply the fitted matrix to camera RGB divided by the white; the level rendered as display white gets Y = 1.

    The level of display white is the scene white or the level at which the first balanced channel clips, whichever is
    lower; with ``brightness = "camera"`` it is always the clipping level. ``balance_mosaic`` uses the same level, so
    the result does not depend on whether it was applied. The true value of a clipped channel is unknown: ``highlights =
    "neutral"`` clips all balanced channels at that level, so overexposed areas are white and not magenta.
    """

    role: ClassVar = "camera colour"
    reads: ClassVar = {
        "rgb_camera": "channel y x [1]",
        "white": "channel [1]",
        "clipping_level": "[1]",
        "colour_matrix": "component channel [1]",
    }
    writes: ClassVar = {"xyz_scene": "channel y x [1]"}
    creates: ClassVar = {"channel": XYZ}
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 5.0
    working: ClassVar = 1.7
    error: ClassVar = measured(1e-6, 2e-15)

    brightness: str = quantity("brightness")
    highlights: str = param(
        "neutral", choices=("neutral", "keep"), doc="treatment of clipped channels: clip all to neutral, or keep"
    )

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        found = {port: tuple(inputs[port]["channel"].values()) for port in ("rgb_camera", "white", "colour_matrix")}
        if len(set(found.values())) > 1:
            text = ", ".join(f"{port} {' '.join(map(str, names))}" for port, names in found.items())
            raise ValueError(f"channels differ: {text}; the demosaicer, white and colour_fit must use the same pattern")
        return {"xyz_scene": inputs["rgb_camera"].replace(channel=XYZ)}

    def run(
        self, rgb_camera: FloatArray, white: FloatArray, clipping_level: FloatArray, colour_matrix: FloatArray
    ) -> dict[str, Array]:
        if not np.all(white > 0):  # writing an array takes longer than multiplying a small frame
            raise ValueError(f"the white has a dead channel: {white}; check the filter, the illuminant and peak_qe")
        level, clipped = np.asarray(white, dtype=float), float(clipping_level)
        shown = level * (white_balance.display_white(level.max(), clipped, self.brightness == "camera") / level.max())
        matrix = np.asarray(colour_matrix, dtype=float) / shown
        if self.highlights == "neutral":
            ends = (level * (clipped / level.max())).astype(rgb_camera.dtype)
            ended = np.empty_like(rgb_camera)
            for plane, end, out in zip(rgb_camera, ends, ended, strict=True):
                plane.clip(max=end, out=out)
            rgb_camera = ended
        return {"xyz_scene": matrices.apply_matrix(matrix, rgb_camera)}


@dataclass(frozen=True, kw_only=True)
class Balance(Viewed, Haloed):
    """Adapt the scene white to the target white by von Kries scaling in a named cone space, or by the paper's printed
    diagonal (eq. 14).

    A cone that the scene white does not excite, as under narrow-band light, would have an infinite gain. Its response
    is lifted to ``floor`` and counted in ``cones_floored``, or an error is raised.
    """

    role: ClassVar = "chromatic adaptation"
    reads: ClassVar = {"xyz_scene": "channel y x [1]", "white_xyz": "component [1]"}
    writes: ClassVar = {"xyz_scene": "channel y x [1]", "cones_floored": "[1]"}
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 5.0
    working: ClassVar = 0.7
    libraries: ClassVar = ("colour-science",)

    once: ClassVar = ("adaptation to the white of the display",)
    error: ClassVar = measured(1e-6, 3e-15)

    space: str = param("Von Kries", choices=tuple(SPACES), doc="cone space of the gains")
    target: str = param("D65", table=True, doc="target white: an illuminant, a display or an RGB space")
    gains: str = param(
        "white",
        choices=("white", "as_printed"),
        doc="gains from the scene white, or the paper's diagonal with its scale",
    )
    floor: float = param(
        1e-4,
        at_least=0,
        below=1,
        doc="floor for cone responses of the scene white, as a fraction of the largest; 0: no floor, an error is "
        "raised",
    )

    def __post_init__(self) -> None:
        if self.target not in MEASURED and self.target not in spectra.rgb_space_names():
            spectra.check_illuminant(self.target, TABLE_EDGES[0], TABLE_EDGES[-1])

    def prepare(self, coordinates: Mapping[str, Array]) -> FloatArray:
        return white_of(self.target)

    def assumes(self) -> dict[str, Hashable]:
        """Return the target white that the gains assume; the paper's printed diagonal assumes its own target white."""
        return {"the white of the display": white_name(self.target)} if self.gains == "white" else {}

    def viewing_white(self) -> FloatArray | None:
        """Return XYZ of the white to which a viewer of the result is adapted, for rendering pictures; None: the white
        of the picture itself.
        """
        return white_of(self.target) if self.gains == "white" else None

    def run(self, xyz_scene: FloatArray, white_xyz: FloatArray, prepared: FloatArray) -> dict[str, Array]:
        if self.gains == "as_printed":
            cones = matrices.TRANSFORMS[SPACES[self.space]]
            matrix, floored = np.linalg.solve(cones, np.diag(PRINTED_GAINS) @ cones), 0
        else:
            source, target = (tuple(map(float, white)) for white in (white_xyz, prepared))
            matrix, floored = _adaptation(source, target, self.space, self.floor)
        return {"xyz_scene": matrices.apply_matrix(matrix, xyz_scene), "cones_floored": np.array(float(floored))}


@lru_cache(64)  # takes longer than the multiplication of a small picture
def _adaptation(
    source: tuple[float, ...], target: tuple[float, ...], space: str, floor: float
) -> tuple[FloatArray, int]:
    """Return the matrix from a source white to a target white, and the number of cones lifted to the floor."""
    cones, white, floored = matrices.TRANSFORMS[SPACES[space]], np.array(source), 0
    if floor > 0:
        responses, floored = white_balance.lifted(cones @ white, floor)
        white = np.linalg.solve(cones, responses) if floored else white
    return matrices.von_kries_matrix(white, target, cones), floored

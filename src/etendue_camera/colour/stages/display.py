"""The display: tristimulus values to display RGB, cone responses and back, encoding and decoding.

In:  ``xyz_scene``.
Out: ``rgb_linear``, ``lms``, ``xyz_display``, ``rgb_display``; the name of a variable gives its colour state.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import RGB, XYZ, Facts, Grid, Haloed, Labels, measured, param
from etendue_camera import spectra
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.colour import encoding as transfer
from etendue_camera.colour import matrices
from etendue_camera.colour.stages.display_white import MEASURED, TABLE_EDGES, white_name, white_of
from etendue_camera.roles import Displaying

LMS = Labels(("L", "M", "S"))
BLOCK = 1 << 15  # values whose temporaries stay in the cache
BEYOND = 1e-5  # of full scale: 32-bit rounding of a value at the end of the range
PRINTED = {"eq16_corrected_3digit": matrices.EQ16_CORRECTED, "eq16_as_printed": matrices.EQ16_AS_PRINTED}
OWN = {"ebu": matrices.RGB_TO_XYZ_PAL, "sRGB": matrices.RGB_TO_XYZ_SRGB}


def space_to_xyz(name: str) -> FloatArray:
    """Return the matrix from linear RGB of a named space to XYZ, in full precision, from its primaries and white."""
    if name in OWN:
        return OWN[name]
    primaries, white = spectra.rgb_space_primaries(name)
    if all(y for _, y in primaries):
        return matrices.rgb_to_xyz_matrix(primaries, white)
    return spectra.rgb_space_matrix(name)[0]  # XYZ itself as a space: its primaries have no luminance


def primaries_to_xyz(display: str) -> FloatArray:
    """Return the matrix from linear display RGB to XYZ, with Y = 1 for white, from measured spectra or else from the
    primaries of its space.
    """
    if display not in MEASURED:
        return space_to_xyz(display)
    found = spectra.colour_matching(TABLE_EDGES).T @ spectra.display_primaries(display, TABLE_EDGES)
    return found / found[1].sum()


def primaries_to_cones(display: str) -> FloatArray:
    """Return the matrix from linear RGB to cone responses, which maps white (1, 1, 1) to (1, 1, 1): primaries x cone
    fundamentals (section 3.2 of the paper).

    For an RGB space, which has no spectra, its XYZ is multiplied by a matrix fitted from colour-matching functions to
    cones.
    """
    if display in MEASURED:
        found = spectra.cone_fundamentals(TABLE_EDGES).T @ spectra.display_primaries(display, TABLE_EDGES)
    else:
        found = spectra.xyz_to_lms_matrix(TABLE_EDGES) @ space_to_xyz(display)
    return found / found.sum(axis=1)[:, None]


def check_display(name: str) -> None:
    """Raise ValueError unless the name is a measured display or an RGB space."""
    spectra.check_rgb_space(name, MEASURED)


@dataclass(frozen=True, kw_only=True)
class Display(Displaying, Haloed):
    """Convert tristimulus values to linear display RGB, with the inverse of primaries x cones (paper, section 3.2).

    An RGB space has no spectra: its matrix is the inverse of the matrix that its primaries and white define.
    """

    role: ClassVar = "display primaries"
    reads: ClassVar = {"xyz_scene": "channel y x [1]"}
    writes: ClassVar = {"rgb_linear": "channel y x [1]"}
    creates: ClassVar = {"channel": RGB}
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 5.0
    working: ClassVar = 0.7
    libraries: ClassVar = ("colour-science",)
    error: ClassVar = measured(2e-6, 5e-15)

    display: str = param(
        "sRGB",
        doc="display: Apple Studio Display, Typical CRT Brainard 1997 (measured spectra), or an RGB space of "
        "colour-science",
    )

    def __post_init__(self) -> None:
        check_display(self.display)

    def assumes(self) -> dict[str, Hashable]:
        return {"the display": self.display, "the white of the display": white_name(self.display)}

    def to_xyz(self) -> FloatArray:
        return primaries_to_xyz(self.display)

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        return {"rgb_linear": inputs["xyz_scene"].replace(channel=RGB)}

    def prepare(self, coordinates: Mapping[str, Array]) -> FloatArray:
        if self.display not in MEASURED:
            return np.linalg.inv(space_to_xyz(self.display))
        # Cones are not an exact combination of colour-matching functions: rows are scaled so that white stays white.
        fitted = spectra.xyz_to_lms_matrix(TABLE_EDGES)
        fitted = fitted / (fitted @ white_of(self.display))[:, None]
        return np.linalg.solve(primaries_to_cones(self.display), fitted)

    def run(self, xyz_scene: FloatArray, prepared: FloatArray) -> dict[str, Array]:
        return {"rgb_linear": matrices.apply_matrix(prepared, xyz_scene)}


@dataclass(frozen=True, kw_only=True)
class _Cones(Haloed):
    """Conversion between display RGB and the viewer's cone responses; the display's white gives 1 for all three."""

    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 5.0
    libraries: ClassVar = ("colour-science",)
    error: ClassVar = measured(2e-6, 5e-15)

    display: str = param(
        "sRGB",
        doc="display, as in the stage display: measured spectra x cone fundamentals; for an RGB space, cones fitted "
        "to XYZ",
    )

    def __post_init__(self) -> None:
        check_display(self.display)

    def assumes(self) -> dict[str, Hashable]:
        return {"the display": self.display}

    def prepare(self, coordinates: Mapping[str, Array]) -> FloatArray:
        return primaries_to_cones(self.display)


@dataclass(frozen=True, kw_only=True)
class ToCones(_Cones):
    """Convert linear display RGB to cone responses: primaries x cone fundamentals (section 3.2 of the paper)."""

    role: ClassVar = "cones"
    reads: ClassVar = {"rgb_linear": "channel y x [1]"}
    writes: ClassVar = {"lms": "channel y x [1]"}
    creates: ClassVar = {"channel": LMS}

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        return {"lms": inputs["rgb_linear"].replace(channel=LMS)}

    def run(self, rgb_linear: FloatArray, prepared: FloatArray) -> dict[str, Array]:
        return {"lms": matrices.apply_matrix(prepared, rgb_linear)}


@dataclass(frozen=True, kw_only=True)
class FromCones(_Cones, Displaying):
    """Convert cone responses to linear display RGB: the inverse of ``to_cones``."""

    role: ClassVar = "cones"
    reads: ClassVar = {"lms": "channel y x [1]"}
    writes: ClassVar = {"rgb_linear": "channel y x [1]"}
    creates: ClassVar = {"channel": RGB}

    def to_xyz(self) -> FloatArray:
        return primaries_to_xyz(self.display)

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        return {"rgb_linear": inputs["lms"].replace(channel=RGB)}

    def run(self, lms: FloatArray, prepared: FloatArray) -> dict[str, Array]:
        return {"rgb_linear": matrices.apply_matrix(np.linalg.inv(prepared), lms)}


@dataclass(frozen=True, kw_only=True)
class ToXyz(Haloed):
    """Convert linear display RGB to XYZ, for an RGB space or by eq. 16 (EBU primaries), in full precision or as
    printed.
    """

    role: ClassVar = "tristimulus"
    reads: ClassVar = {"rgb_linear": "channel y x [1]"}
    writes: ClassVar = {"xyz_display": "channel y x [1]"}
    creates: ClassVar = {"channel": XYZ}
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 5.0
    working: ClassVar = 0.7

    libraries: ClassVar = ("colour-science",)
    error: ClassVar = measured(1e-6, 1e-15)

    matrix: str = param(
        "sRGB",
        doc="matrix of a display, as in the stage display, or ebu (eq. 16), eq16_corrected_3digit, eq16_as_printed",
    )

    def __post_init__(self) -> None:
        spectra.check_rgb_space(self.matrix, (*PRINTED, "ebu", *MEASURED))

    def assumes(self) -> dict[str, Hashable]:
        return {"the display": "ebu" if self.matrix in PRINTED else self.matrix}

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        return {"xyz_display": inputs["rgb_linear"].replace(channel=XYZ)}

    def prepare(self, coordinates: Mapping[str, Array]) -> FloatArray:
        return PRINTED[self.matrix] if self.matrix in PRINTED else primaries_to_xyz(self.matrix)

    def run(self, rgb_linear: FloatArray, prepared: FloatArray) -> dict[str, Array]:
        return {"xyz_display": matrices.apply_matrix(prepared, rgb_linear)}


@dataclass(frozen=True, kw_only=True)
class _Encoding(Haloed):
    """One of the display encodings."""

    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 15.0
    error: ClassVar[Any] = measured(1e-6, 1e-15)
    decides: ClassVar = {"encoding": ("BT.709",)}  # its printed constants leave a step of 2.5e-4 between the two parts

    encoding: str = param("sRGB", choices=("sRGB", "BT.709", "power"))
    exponent: float = param(0.45, above=0, at_most=5, doc="exponent of encoding 'power' (eq. 15)")

    def assumes(self) -> dict[str, Hashable]:
        return {"the encoding": ("power", self.exponent) if self.encoding == "power" else self.encoding}


@dataclass(frozen=True, kw_only=True)
class Encode(_Encoding):
    """Encode linear display values (gamma), clipped to the display's range. Clipped values are counted if they exceed
    the range by more than rounding: white that is clipped in the camera can differ from 1 in its last bits.
    """

    role: ClassVar = "display encoding"
    working: ClassVar = 1.5
    reads: ClassVar = {"rgb_linear": "channel y x [1]"}
    writes: ClassVar = {"rgb_display": "channel y x [1]", "gamut_clipped": "[1]"}
    keeps: ClassVar = ("order",)

    def run(self, rgb_linear: FloatArray) -> dict[str, Array]:
        kind, flat = rgb_linear.dtype.type, rgb_linear.reshape(-1)
        encoded, clipped = np.empty_like(flat), 0
        for start in range(0, flat.size, BLOCK):
            part = flat[start : start + BLOCK]
            inside = np.clip(part, kind(0), kind(1))
            if (part != inside).any():
                clipped += int(np.count_nonzero(np.abs(part - inside) > BEYOND))
            if self.encoding == "power":
                curve = transfer.gamma_signed(inside, self.exponent)
            else:
                curve = (transfer.srgb_encode if self.encoding == "sRGB" else transfer.bt709_encode)(inside)
            encoded[start : start + BLOCK] = curve
        outside = clipped / max(flat.size, 1)
        return {"rgb_display": encoded.reshape(rgb_linear.shape), "gamut_clipped": np.array(outside)}

    def joined(self, parts: Mapping[str, Sequence[Array]], sizes: Sequence[int]) -> dict[str, Array]:
        """Return the clipped fraction of all values, from the counts of the parts."""
        clipped = sum(round(float(share) * size) for share, size in zip(parts["gamut_clipped"], sizes, strict=True))
        return {"gamut_clipped": np.array(clipped / max(sum(sizes), 1))}


@dataclass(frozen=True, kw_only=True)
class Decode(_Encoding):
    """Decode encoded display values to linear ones; values that ``encode`` clipped stay clipped."""

    role: ClassVar = "display decoding"
    reads: ClassVar = {"rgb_display": "channel y x [1]"}
    writes: ClassVar = {"rgb_linear": "channel y x [1]"}
    keeps: ClassVar = ("order",)

    def run(self, rgb_display: FloatArray) -> dict[str, Array]:
        if self.encoding == "power":
            return {"rgb_linear": transfer.gamma_signed(rgb_display, 1 / self.exponent)}
        return {"rgb_linear": (transfer.srgb_decode if self.encoding == "sRGB" else transfer.bt709_decode)(rgb_display)}

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        steep = max(1.0, 1 / self.exponent) if self.encoding == "power" else 2.4
        return steep * (1e-6 if precision == "float32" else 2e-15), "measured"

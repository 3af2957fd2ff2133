"""Roles by which studies find stages, and base classes for further properties that a stage can declare.

In:  stage classes of this package and of plugins.
Out: base classes for stages; names of roles. Studies check the class or role of a stage, never its name.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

from etendue.contract.stage import Stage
from etendue_camera.arrays import FloatArray

LENS = ("lens", "distortion", "glare", "low-pass filter")  # roles that spread or move light before the sensor
DISTORTION = "distortion"
RESTORING = ("", "sharpening", "denoising", "defect correction")  # roles that improve a picture; "": no role
SHADING = "shading correction"
BALANCE = "white balance"  # after this stage, white is equal in all channels
CROSSTALK = "crosstalk"
READ_NOISE = "read noise"
PROCESSING = ("demosaicing", "denoising", "sharpening")  # roles that change detail and noise after the read-out
DEFECTIVE = ("sensor defects", "stuck pixels")
FULL_WELL = "full well"
REFERENCE = "reference"  # stages that only studies insert: never an alternative to others


class Scaled(Stage):
    """A stage that writes the linear mosaic and declares its scale."""

    @abstractmethod
    def electrons(self) -> float:
        """Return the charge (electron) of a pixel whose linear mosaic value is 1."""


# Datasheet entries by name, with units. Noises and patterns of several stages add in squares, dark currents add, gains
# multiply, and the smallest full well applies.
FIGURES: Mapping[str, str] = {
    "gain": "DN/electron",
    "read_noise": "electron",
    "dsnu": "electron",
    "full_well": "electron",
    "prnu": "1",
    "dark_current": "electron/s",
    "dark_spread": "electron/s",
}  # dark current: mean over pixels; dark spread: rms difference between pixels


class InSilicon(Stage):
    """A stage that changes the light but belongs to the sensor, not to the lens. Studies keep it when they replace the
    lens by an ideal lens.
    """


class FlatScene(Stage):
    """A uniform scene. Studies set its ``reflectance`` and, if it has them, its parameters of size and light."""


class EdgeScene(Stage):
    """A scene of one slanted edge. Studies set its parameters ``angle``, ``low``, ``high`` and ``softness`` and, if it
    has them, the parameters of size and light.
    """


class Displaying(Stage):
    """A stage that writes linear display values and declares the display primaries."""

    @abstractmethod
    def to_xyz(self) -> FloatArray:
        """Return the matrix (3, 3) from linear RGB to XYZ, with Y = 1 for the white of the display."""

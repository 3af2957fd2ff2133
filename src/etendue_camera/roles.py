"""What studies ask of stages: the roles that they look for, and typed bases for what a stage can say of itself.

In:  stage classes, those of plugins like those of this package.
Out: bases to derive a stage from; names of roles. Whether a stage is one of them is asked of its class or role, never
     of its name.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

from etendue.contract.stage import Stage
from etendue_camera.arrays import FloatArray

LENS = ("lens", "distortion", "glare", "low-pass filter")  # what spreads or moves light in front of the sensor
DISTORTION = "distortion"
RESTORING = ("", "sharpening", "denoising", "defect correction")  # what betters a picture; "" says nothing
SHADING = "shading correction"
BALANCE = "white balance"  # behind it white is equal in all channels
CROSSTALK = "crosstalk"
READ_NOISE = "read noise"
PROCESSING = ("demosaicing", "denoising", "sharpening")  # what changes detail and noise behind the read-out
DEFECTIVE = ("sensor defects", "stuck pixels")
FULL_WELL = "full well"
REFERENCE = "reference"  # stages that only stand where a study puts them: never an alternative to others


class Scaled(Stage):
    """A stage that makes the linear mosaic, and knows its scale."""

    @abstractmethod
    def electrons(self) -> float:
        """Charge of a pixel that reads 1."""


# What a datasheet says, by name: units, and of several stages noises and patterns add in squares, of wells the smallest
# counts.
FIGURES: Mapping[str, str] = {
    "gain": "DN/electron",
    "read_noise": "electron",
    "dsnu": "electron",
    "full_well": "electron",
    "prnu": "1",
    "dark_current": "electron/s",
    "dark_spread": "electron/s",
}  # the last two: mean over pixels, and rms between them


class InSilicon(Stage):
    """A stage on the light that belongs to the sensor, not to the lens: an ideal lens leaves it as it is."""


class FlatScene(Stage):
    """A scene that is the same everywhere. Studies give it ``reflectance``, and of size and light the parameters
    that it has.
    """


class EdgeScene(Stage):
    """A scene of one slanted edge. Studies give it ``angle``, ``low``, ``high``, ``softness``, and of size and light
    what it has.
    """


class Displaying(Stage):
    """A stage that writes linear values for a display, and knows its primaries."""

    @abstractmethod
    def to_xyz(self) -> FloatArray:
        """(3, 3): linear RGB to XYZ, Y = 1 for the display's white."""

"""What studies ask of stages: the roles that they look for, and typed bases for what a stage can say of itself.

In:  stage classes, those of plugins like those of the package.
Out: bases to derive a stage from; names of roles. Whether a stage is one of them is asked of its class or role, never of its name.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from etendue.contract.stage import Stage

LENS = ("lens", "distortion", "glare", "low-pass filter")  # what spreads or moves light in front of the sensor
DISTORTION = "distortion"
RESTORING = ("", "sharpening", "denoising", "defect correction")  # what betters a picture; "" says nothing
SHADING = "shading correction"
BALANCE = "white balance"  # behind it white is equal in all channels
CROSSTALK = "crosstalk"
SHOT_NOISE = "shot noise"
READ_NOISE = "read noise"
PROCESSING = ("demosaicing", "denoising", "sharpening")  # what changes detail and noise behind the read-out
DEFECTIVE = ("sensor defects", "stuck pixels")
FULL_WELL = "full well"
REFERENCE = "reference"  # stages that only stand where a study puts them: never an alternative to others


class Noisy(Stage):
    """A stage that adds noise to what a pixel holds, and knows how much.

    ``by_line``: whole rows or columns share the noise. A converter's rounding is noise too: a twelfth of the square of its step.
    """

    by_line: ClassVar[bool] = False

    @abstractmethod
    def variance(self, charge: float) -> float:
        """What is added to the variance of a pixel with a mean charge (electron), referred to the pixel: electron^2."""


class Scaled(Stage):
    """A stage that makes the linear mosaic, and knows its scale."""

    @abstractmethod
    def electrons(self) -> float:
        """Charge of a pixel that reads 1."""


class Datasheet(Stage):
    """A stage that knows figures of its sensor which a measurement finds again."""

    @abstractmethod
    def datasheet(self) -> Mapping[str, float]:
        """Some of ``gain`` (DN/electron), ``read_noise``, ``dsnu``, ``full_well`` (electron), ``prnu`` (1), ``dark_current`` and
        ``dark_spread`` (mean over pixels and rms between them, electron/s). Noises and patterns of several stages add in squares, of
        wells the smallest counts."""


@dataclass(frozen=True)
class Sheet:
    """What a port that looks at ``"*.datasheet"`` is given of a stage: its role and its figures; none of one that has no datasheet."""

    role: str
    figures: Mapping[str, float]

    @classmethod
    def of(cls, stage: Stage) -> Sheet:
        return cls(stage.role, dict(stage.datasheet()) if isinstance(stage, Datasheet) else {})


class InSilicon(Stage):
    """A stage on the light that belongs to the sensor, not to the lens: an ideal lens leaves it as it is."""


class FlatScene(Stage):
    """A scene that is the same everywhere. Studies give it ``reflectance``, and of size and light the parameters that it has."""


class EdgeScene(Stage):
    """A scene of one slanted edge. Studies give it ``angle``, ``low``, ``high``, ``softness``, and of size and light what it has."""


class Displaying(Stage):
    """A stage that writes linear values for a display, and knows its primaries."""

    @abstractmethod
    def to_xyz(self) -> Any:
        """(3, 3): linear RGB to XYZ, Y = 1 for the display's white."""

"""Stages that break their own declaration, each in one way. In a module of their own, so that they can be pickled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import (
    RGB,
    Banded,
    Bands,
    Bounded,
    Facts,
    Grid,
    Haloed,
    Line,
    Noisy,
    Sampled,
    Source,
    Stage,
    Transfer,
    param,
    quantity,
)
from etendue_camera.mosaic.bilinear import bilinear
from etendue_camera.sensor.cfa import shifted_bayer


@dataclass(frozen=True, kw_only=True)
class Sound(Stage):
    """The stage that the others are spoilt copies of."""

    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]"}
    gain: ClassVar = 1.0
    strength: float = param(1.1, above=0, at_most=10, doc="factor on everything")

    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge * charge.dtype.type(self.strength)}

    def carry(self, facts: Any, grid: Any) -> Facts:
        return facts["charge"].scaled(self.strength)

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (2e-7 if precision == "float32" else 1e-15), "proved"


@dataclass(frozen=True, kw_only=True)
class Transposed(Sound):
    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge.T}


@dataclass(frozen=True, kw_only=True)
class Undeclared(Sound):
    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge, "by_the_way": charge}


@dataclass(frozen=True, kw_only=True)
class Mutating(Sound):
    def run(self, charge: Any) -> dict[str, Any]:
        charge *= 2
        return {"charge": charge}


@dataclass(frozen=True, kw_only=True)
class ForcedMutating(Sound):
    def run(self, charge: Any) -> dict[str, Any]:
        charge.flags.writeable = True
        charge += 1
        return {"charge": charge.copy()}


@dataclass(frozen=True, kw_only=True)
class UndefinedInTheDark(Sound):
    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge / charge.max()}


@dataclass(frozen=True, kw_only=True)
class CrashingOnOnePixel(Sound):
    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge + charge[1, 1]}


@dataclass(frozen=True, kw_only=True)
class FalseError(Sound):
    def run(self, charge: Any) -> dict[str, Any]:
        far = charge.dtype.type(1e8)
        return {"charge": (charge + far) - far}


@dataclass(frozen=True, kw_only=True)
class NonsenseError(Sound):
    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return 1e-6, "guessed"


@dataclass(frozen=True, kw_only=True)
class FalseGain(Sound):
    gain: ClassVar = 1.0

    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge * 3 - charge.mean() * 2}

    def carry(self, facts: Any, grid: Any) -> Facts:
        return Facts()


@dataclass(frozen=True, kw_only=True)
class FalseGainByPattern(Sound):
    """Random errors average out; errors that alternate add up."""

    gain: ClassVar = 1.0

    def run(self, charge: Any) -> dict[str, Any]:
        padded = np.pad(charge, 1, mode="edge")
        around = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
        return {"charge": charge * 1.2 - around * 0.05}

    def carry(self, facts: Any, grid: Any) -> Facts:
        return Facts()


@dataclass(frozen=True, kw_only=True)
class FalseRange(Sound):
    def carry(self, facts: Any, grid: Any) -> Facts:
        return facts["charge"]


@dataclass(frozen=True, kw_only=True)
class FalselyUniform(Sound):
    def carry(self, facts: Any, grid: Any) -> Facts:
        return Facts(uniform=True)


@dataclass(frozen=True, kw_only=True)
class NotNegligible(Sound, Bounded):
    def negligible(self, facts: Any, grid: Any) -> tuple[float, str]:
        return 1e-3, "it is said to do little"


@dataclass(frozen=True, kw_only=True)
class Greedy(Sound):
    def run(self, *arrays: Any) -> dict[str, Any]:
        return {"charge": arrays[0]}


@dataclass(frozen=True, kw_only=True)
class Curious(Sound):
    def run(self, charge: Any, weather: Any) -> dict[str, Any]:
        return {"charge": charge * weather}


@dataclass(frozen=True, kw_only=True)
class BlindToItsWindow(Stage):
    """A demosaicer that takes the first pixel it is given for that of the sensor."""

    role: ClassVar = "demosaicing"
    reads: ClassVar = {"mosaic_linear": "y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    creates: ClassVar = {"channel": RGB}
    negative: ClassVar = "keep"
    pattern: str = quantity("pattern")

    def run(self, mosaic_linear: Any) -> dict[str, Any]:
        return {"rgb_camera": bilinear(mosaic_linear, self.pattern)}


@dataclass(frozen=True, kw_only=True)
class BlindInPart(BlindToItsWindow):
    """Sees its rows, and no columns."""

    def run(self, mosaic_linear: Any, y: Any) -> dict[str, Any]:  # type: ignore[override]
        return {"rgb_camera": bilinear(mosaic_linear, shifted_bayer(self.pattern, round(float(y[0])), 0))}


@dataclass(frozen=True, kw_only=True)
class BandedFromItsWindow(Haloed):
    """Darker columns that follow the window over the sensor."""

    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]"}
    gain: ClassVar = 1.0

    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge * (1 - 1e-3 * (np.arange(charge.shape[1]) % 7 == 0)).astype(charge.dtype)}


@dataclass(frozen=True, kw_only=True)
class NoValue(Sound):
    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True, kw_only=True)
class BareParameter(Sound):
    size: float = 1.0


@dataclass(frozen=True, kw_only=True)
class DefaultOutOfRange(Sound):
    size: float = param(-1.0, units="um", above=0)


@dataclass(frozen=True, kw_only=True)
class OtherUnit(Sound):
    pixel_pitch: float = param(5.4e-3, units="mm", above=0, shared=True)


@dataclass(frozen=True, kw_only=True)
class OtherUnitOfAVariable(Sound):
    writes: ClassVar = {"charge": "y x [DN]"}


@dataclass(frozen=True, kw_only=True)
class Remembering(Sound):
    seen: ClassVar[list[float]] = []

    def run(self, charge: Any) -> dict[str, Any]:
        self.seen.append(float(charge.max()))
        return {"charge": charge + len(self.seen)}


@dataclass(frozen=True, kw_only=True)
class Unseeded(Sound):
    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge + np.random.default_rng().uniform(size=charge.shape)}


@dataclass(frozen=True, kw_only=True)
class LetsUndefinedPass(Sound):
    nan: ClassVar = "keep"


@dataclass(frozen=True, kw_only=True)
class ClipsNothing(Sound):
    negative: ClassVar = "shrug"


@dataclass(frozen=True, kw_only=True)
class MovingGrid(Sound):
    counter: ClassVar[list[int]] = []

    def grid(self, inputs: Any) -> dict[str, Grid]:
        self.counter.append(1)
        return {"charge": inputs["charge"].replace(y=Line(9, float(len(self.counter))))}


@dataclass(frozen=True, kw_only=True)
class LosingLight(Transfer):
    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    negative: ClassVar = "keep"

    def transfer(self, fy: Any, fx: Any, wavelength: Any) -> Any:
        return 0.9 * np.exp(-(fy**2 + fx**2)) * np.ones_like(wavelength)


@dataclass(frozen=True, kw_only=True)
class Amplifying(LosingLight):
    def transfer(self, fy: Any, fx: Any, wavelength: Any) -> Any:
        return 1 + fy**2 + fx**2 + 0 * wavelength


@dataclass(frozen=True, kw_only=True)
class Lopsided(LosingLight):
    def transfer(self, fy: Any, fx: Any, wavelength: Any) -> Any:
        return np.exp(-np.abs(fx) * (1.5 + np.sign(fx)) - fy**2) + 0 * wavelength


@dataclass(frozen=True, kw_only=True)
class SilentlyNegative(LosingLight):
    negative: ClassVar = "error"

    def transfer(self, fy: Any, fx: Any, wavelength: Any) -> Any:
        return np.exp(-(fy**2 + fx**2)) * np.ones_like(wavelength)


@dataclass(frozen=True, kw_only=True)
class FalseSource(Source):
    """Says that it is uniform with a contrast of 1, and draws a ramp."""

    writes: ClassVar = {"radiance": "wavelength y x [W m-2 sr-1 nm-1]"}

    def describe(self) -> tuple[Facts, dict[str, Grid]]:
        grid = Grid.of({"wavelength": Bands((500.0, 600.0)), "y": Line(3), "x": Line(4)})
        return Facts(uniform=self.claim(), contrast=2.0), {"radiance": grid}

    def claim(self) -> bool | None:
        return True

    def run(self, out_x: Any) -> dict[str, Any]:
        return {"radiance": np.broadcast_to(1.0 + out_x, (1, 3, 4))}


@dataclass(frozen=True, kw_only=True)
class FalseContrast(FalseSource):
    def claim(self) -> bool | None:
        return None


@dataclass(frozen=True, kw_only=True)
class OtherShape(FalseContrast):
    def run(self, out_x: Any) -> dict[str, Any]:
        return {"radiance": np.ones((1, 4, 3))}


@dataclass(frozen=True, kw_only=True)
class WholeOnly(Banded):
    """Says that it can work band by band, and divides by the brightest band it sees."""

    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}

    def by_band(self, prepared: Any, bands: slice) -> Any:
        return prepared

    def run(self, irradiance: Any) -> dict[str, Any]:
        return {"irradiance": irradiance / irradiance.max()}


@dataclass(frozen=True, kw_only=True)
class SeesItsRows(WholeOnly):
    """Says that it can work on some rows, and divides by their middle."""

    def in_rows(self) -> bool:
        return True

    def run(self, irradiance: Any) -> dict[str, Any]:
        return {"irradiance": irradiance / (1 + np.arange(irradiance.shape[1])[:, None])}


@dataclass(frozen=True, kw_only=True)
class WithoutCreates(Sound):
    """Writes a dim which nothing it reads has, and does not say what it is."""

    writes: ClassVar = {"parts": "channel y x [electron]"}


@dataclass(frozen=True, kw_only=True)
class MadeOfThree(Sound):
    """Sound, with a dim that the kit gives three labels of its own."""

    reads: ClassVar = {"stack": "frame y x [electron]"}
    writes: ClassVar = {"mean_charge": "y x [electron]", "colour": "channel [1]"}
    creates: ClassVar = {"channel": RGB}
    gain: ClassVar = 1.0

    def run(self, stack: Any) -> dict[str, Any]:
        return {"mean_charge": stack.mean(axis=0), "colour": np.ones(3)}

    def carry(self, facts: Any, grid: Any) -> Facts:
        return Facts(low=facts["stack"].low, high=facts["stack"].high)


@dataclass(frozen=True, kw_only=True)
class BackwardLadder(Sound):
    """Its settings go from the reference to the cheapest."""

    terms: int = param(4, at_least=1, fidelity=True, reference="1", settings=(8, 4, 1))

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return 10.0**-self.terms, "fitted"


@dataclass(frozen=True, kw_only=True)
class SettingOutOfRange(Sound):
    terms: int = param(4, at_least=2, fidelity=True, reference="8", settings=(1, 4, 8))


@dataclass(frozen=True, kw_only=True)
class FalseMean(Sound, Sampled):
    """Its noise has an offset that its mean does not know."""

    def run(self, charge, rng):
        return {"charge": charge + 5.0 + rng.standard_normal(charge.shape)}

    def mean(self, charge):
        return {"charge": charge}


@dataclass(frozen=True, kw_only=True)
class DrawingMean(Sound, Sampled):
    """Its mean draws."""

    def run(self, charge, rng):
        return {"charge": charge + rng.standard_normal(charge.shape)}

    def mean(self, charge, rng):
        return {"charge": charge}


@dataclass(frozen=True, kw_only=True)
class ShortHalo(Sound, Haloed):
    """Reaches two rows far and speaks of one."""

    gain: ClassVar = None

    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge + np.roll(charge, 2, axis=0)}

    def carry(self, facts: Any, grid: Any) -> Facts:
        return Facts()

    def halo(self) -> int:
        return 1


@dataclass(frozen=True, kw_only=True)
class Restless(Sound):
    """Depends on digits that no measurement has."""

    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge * (1 + 0.5 * ((charge * 1e9) % 1))}


@dataclass(frozen=True, kw_only=True)
class RestlessParameter(Sound):
    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge * charge.dtype.type(1 + 0.5 * ((self.strength * 1e9) % 1))}


@dataclass(frozen=True, kw_only=True)
class HiddenConstant(Stage):
    """A millionth of a unit that nobody has named."""

    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}

    def run(self, irradiance: Any) -> dict[str, Any]:
        return {"irradiance": irradiance + irradiance.dtype.type(1e-6)}


@dataclass(frozen=True, kw_only=True)
class Upturned(Sound):
    keeps: ClassVar = ("order",)

    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge.max() - charge}


@dataclass(frozen=True, kw_only=True)
class Leaking(Sound):
    keeps: ClassVar = ("sum",)

    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge * charge.dtype.type(0.9)}


@dataclass(frozen=True, kw_only=True)
class LouderThanSaid(Noisy):
    """Says a deviation where a variance is asked for."""

    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]"}

    def variance(self, charge: float) -> float:
        return 3.0

    def run(self, charge: Any, rng: Any) -> dict[str, Any]:
        return {"charge": charge + 3 * rng.standard_normal(charge.shape).astype(charge.dtype)}


@dataclass(frozen=True, kw_only=True)
class NearlyLinear(Stage):
    """A matrix, and a ripple too small to be seen in it."""

    reads: ClassVar = {"rgb_camera": "channel y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}

    def run(self, rgb_camera: Any) -> dict[str, Any]:
        return {"rgb_camera": rgb_camera + rgb_camera.dtype.type(4e-10) * np.sin(1e3 * rgb_camera)}


@dataclass(frozen=True, kw_only=True)
class NumbersForLabels(Stage):
    """Four frames behind a polariser, at angles that are no coordinate."""

    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"charge": "polariser y x [electron]"}
    creates: ClassVar = {"polariser": (0.0, 45.0, 90.0, 135.0)}

    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": np.stack([charge] * 4)}


@dataclass(frozen=True, kw_only=True)
class ReadsFour(Stage):
    """Knows four frames and no other number of them."""

    reads: ClassVar = {"charge": "polariser y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]"}

    def run(self, charge: Any) -> dict[str, Any]:
        first, second, third, fourth = charge
        return {"charge": ((first + third) + (second + fourth)) / 4}


@dataclass(frozen=True, kw_only=True)
class SilentAboutBlack(Stage):
    """Reads what every camera with noise makes negative, and says nothing of it."""

    reads: ClassVar = {"rgb_camera": "channel y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}

    def run(self, rgb_camera: Any) -> dict[str, Any]:
        return {"rgb_camera": rgb_camera * rgb_camera.dtype.type(0.5)}


@dataclass(frozen=True, kw_only=True)
class WarnsOfPorts(Sound):
    """Takes what is known of its own values for a mapping by port."""

    def warn(self, facts: Any, grids: Any) -> list[str]:
        return ["bright"] if facts["charge"].high else []


@dataclass(frozen=True, kw_only=True)
class CountsInFewDigits(Sound):
    """Every other row is darker, by a count that has eleven bits."""

    def run(self, charge: Any, y: Any) -> dict[str, Any]:  # type: ignore[override]
        odd = y.astype(np.float16) % 2
        return {"charge": charge * (1.1 - 0.1 * odd[:, None]).astype(charge.dtype)}

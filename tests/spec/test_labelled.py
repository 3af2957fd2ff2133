"""A stage written on labels is a stage like any other: same bits, same laws, and errors that speak of labels."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_array_equal

from etendue.api import Stage, labelled, measured, param
from etendue.contract.stage import arguments_of
from etendue.errors import PluginError
from etendue.testing import StageConformance

PLANES = "channel y x [1]"


@dataclass(frozen=True, kw_only=True)
class Warm(Stage):
    """Red is lifted."""

    role: ClassVar = "grading"
    reads: ClassVar = {"rgb_camera": PLANES}
    writes: ClassVar = {"rgb_camera": PLANES}
    gain: ClassVar = 4.0
    negative: ClassVar = "keep"
    error: ClassVar = measured(1e-6, 1e-14)

    red: float = param(1.5, above=0, at_most=4)

    def run(self, rgb_camera):
        lifted = rgb_camera.copy()
        lifted[0] *= lifted.dtype.type(self.red)
        return {"rgb_camera": lifted}


@labelled
@dataclass(frozen=True, kw_only=True)
class WarmByLabel(Warm):
    """The same on labels."""

    def run(self, data):
        rgb = data["rgb_camera"]
        return data.assign(rgb_camera=rgb * xr.where(rgb.channel == "R", self.red, 1.0).astype(rgb.dtype))


@labelled
@dataclass(frozen=True, kw_only=True)
class Tilted(Stage):
    """Light that falls off along y, by the place on the image plane and the wavelength."""

    role: ClassVar = "grading"
    handed: ClassVar = True  # it falls off towards larger y only
    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    error: ClassVar = measured(1e-6, 1e-14)

    def run(self, data):
        light = data["irradiance"]
        factor = np.exp(-1e-4 * (light.y_um - light.y_um.min()) * (550.0 / light.wavelength))
        return {"irradiance": (light * factor).astype(light.dtype).transpose("y", "wavelength", "x")}


class TestArrays(StageConformance):
    stage = Warm()


class TestLabels(StageConformance):
    stage = WarmByLabel()


class TestTilted(StageConformance):
    stage = Tilted()


def test_labels_and_arrays_give_the_same_bits():
    planes = np.random.default_rng(1).random((3, 8, 9))
    where = {
        "y": np.arange(8.0),
        "x": np.arange(9.0),
        "y_um": np.arange(8.0),
        "x_um": np.arange(9.0),
        "channel": np.array(["R", "G", "B"]),
    }
    asked = {name: where[name] for name in arguments_of(WarmByLabel) if name in where}
    assert_array_equal(WarmByLabel().run(rgb_camera=planes, **asked)["rgb_camera"], Warm().run(planes)["rgb_camera"])


def faulty(body):
    kind = dataclass(frozen=True, kw_only=True)(type("Faulty", (Warm,), {"run": body, "__annotations__": {}}))
    planes = np.ones((3, 2, 2))
    where = {
        "y": np.arange(2.0),
        "x": np.arange(2.0),
        "y_um": np.arange(2.0),
        "x_um": np.arange(2.0),
        "channel": np.array(["R", "G", "B"]),
    }
    made = labelled(kind)
    return made().run(rgb_camera=planes, **{name: where[name] for name in arguments_of(made) if name in where})


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (lambda self, data: data["rgb_camera"].to_numpy(), "returned ndarray, not a Dataset"),
        (lambda self, data: data.drop_vars("rgb_camera"), "declares rgb_camera"),
        (
            lambda self, data: data.assign(rgb_camera=data.rgb_camera.mean("channel")),
            "with the dims 'y x', but declares 'channel y x'",
        ),
        (lambda self, data: data.assign(rgb_camera=data.rgb_camera.assign_attrs(units="lx")), "in lx, but declares 1"),
        (
            lambda self, data: {"rgb_camera": data.rgb_camera.assign_coords(y=data.y + 1)},
            "with other values of y than in its input",
        ),
        (lambda self, data: data.assign(other=data.rgb_camera), "returned other, which it does not write"),
    ],
    ids=["no labels", "nothing", "dims", "unit", "coordinate", "more"],
)
def test_what_does_not_fit_its_declaration_is_told_in_labels(body, words):
    with pytest.raises(PluginError, match=words):
        faulty(body)


def test_a_run_that_asks_for_arrays_beside_data_is_no_labelled_stage():
    with pytest.raises(TypeError, match="asks for wavelength besides data"):
        labelled(type("Odd", (Warm,), {"run": lambda self, data, wavelength: data}))

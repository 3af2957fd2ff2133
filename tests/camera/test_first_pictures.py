"""The first pictures that a user sees are true: grey patches come out of the shipped cameras within CIEDE2000 3 of
what they are.
"""

from pathlib import Path

import numpy as np
import pytest

import etendue
from etendue_camera import spectra
from etendue_camera.colour import matrices
from etendue_camera.colour.difference import delta_e_2000, lab
from etendue_camera.colour.encoding import srgb_decode
from etendue_camera.scene.composite import PATCH_COLUMNS, PATCH_ROWS, composite_regions

PIPELINES = Path(__file__).parents[2] / "pipelines"
SEEN = 3.0  # a difference that an eye sees side by side, and forgives apart
STEPS = 8


def grey_patches(width, height):
    """(y, x, half height, half width) of the middles of the checker's grey patches and the wedge's steps, um from
    the centre.
    """
    regions = composite_regions(width, height)
    checker, wedge = regions["patches"], regions["wedge"]
    high, wide = (checker.bottom - checker.top) / PATCH_ROWS, (checker.right - checker.left) / PATCH_COLUMNS
    step = (wedge.right - wedge.left) / STEPS
    patches = [
        (checker.bottom - high / 2, checker.left + (i + 0.5) * wide, high / 4, wide / 4) for i in range(PATCH_COLUMNS)
    ]
    middle, reach = (wedge.top + wedge.bottom) / 2, (wedge.bottom - wedge.top) / 4
    return patches + [(middle, wedge.left + (i + 0.5) * step, reach, step / 4) for i in range(STEPS)]


def mean_within(picture, y, x, place):
    own = picture[:, np.abs(y - place[0]) <= place[2]][:, :, np.abs(x - place[1]) <= place[3]]
    return own.mean(axis=(1, 2)) if own.size else None


def differences(name, **camera):
    """CIEDE2000 of each grey patch that the frame holds: the picture beside the light of the scene under its own
    white.
    """
    pipeline = etendue.Pipeline.read(PIPELINES / f"{name}.toml").sweep(
        **{axis: [value] for axis, value in camera.items()}
    )
    tree = pipeline.run(want=["scene", "encode", "pixel.photon_rate"], progress=False).tree
    scene = tree["scene"].dataset
    bounds = scene["wavelength_bounds"].values
    matching = spectra.colour_matching(np.append(bounds[:, 0], bounds[-1, 1])) * np.diff(bounds)
    white = scene["white_radiance"].values @ matching
    shown = tree["encode"].dataset["rgb_display"].squeeze(drop=True)
    linear = srgb_decode(np.clip(shown.transpose("channel", "y", "x").values.astype(float), 0, 1))
    y, x = (own - own.mean() for own in (shown[f"{dim}_um"].values.ravel() for dim in ("y", "x")))
    width, height = (
        abs(float(scene[dim][-1] - scene[dim][0])) * scene.sizes[dim] / (scene.sizes[dim] - 1) for dim in ("x", "y")
    )
    to_xyz = matrices.RGB_TO_XYZ_SRGB
    found = []
    for place in grey_patches(width, height):
        true = mean_within(scene["radiance"].values, scene["y"].values, scene["x"].values, place)
        seen = mean_within(linear, y, x, place)
        if seen is not None:
            found.append(
                float(
                    delta_e_2000(
                        lab(true @ matching / white[1], white / white[1]), lab(to_xyz @ seen, to_xyz @ np.ones(3))
                    )
                )
            )
    return found


SMALLEST = {"f_number": 2.8, "pixel_pitch": 5.4, "integration_time": 0.008}


def test_grey_is_grey_in_the_first_picture():
    found = differences("smallest", **SMALLEST)
    assert len(found) == 14 and max(found) < SEEN


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "camera"),
    [
        ("smallest", {**SMALLEST, "f_number": 2.0}),
        ("raw_corrections", {}),
        ("burst", {"meter.ev_bias": 0.0}),
        ("burst", {"meter.ev_bias": -1.0}),
        ("burst", {"meter.ev_bias": 1.0}),
    ],
)
def test_grey_is_grey_in_shipped_pictures(name, camera):
    found = differences(name, **camera)
    assert len(found) >= 13 and max(found) < SEEN

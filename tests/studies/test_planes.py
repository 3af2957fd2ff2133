"""Full planes are a mosaic run plane by plane: a correction does to a plane what it does to the mosaic at that
plane's sites.
"""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import etendue
from etendue.contract.registry import installed_stages
from etendue_camera.sensor import cfa

CAMERA = """
name = "planes"
[camera]
peak_qe = [0.36, 0.44, 0.40]
pixel_pitch = "4 um"
integration_time = "4 ms"
pattern = "{pattern}"
[[stages]]
use = "composite"
white_luminance = "1000 cd m-2"
width = "160 um"
height = "160 um"
spacing = "2 um"
bin_width = "60 nm"
wavelength_from = "400 nm"
wavelength_to = "700 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "lens_gaussian"
sigma = "2 um"
[[stages]]
use = "pixel"
rows = 25
columns = 28
[[stages]]
use = "white"
{mosaic}
[[stages]]
use = "ideal_mosaic"
clip = false
{corrections}
"""
TABLE = "height_mm,R,G,B,W\n0,1,1.01,1.02,1.03\n0.1,1.5,1.6,1.7,1.8\n"


def corrected(pattern, mosaic, corrections, variable="mosaic_linear"):
    written = "".join(f'[[stages]]\nuse = "{use}"\n{values}\n' for use, values in corrections)
    text = CAMERA.format(pattern=pattern, mosaic=f'[[stages]]\nuse = "{mosaic}"', corrections=written)
    last = corrections[-1][0]
    found = etendue.simulate(text, want=[f"{last}.{variable}"])[last]
    return next(iter(found.children.values()), found)[variable].values


@pytest.mark.parametrize("pattern", ["RGGB", "GBRG", "X-Trans"])
@pytest.mark.parametrize("highlights", ["neutral", "keep"])
def test_what_works_pixel_by_pixel_gives_the_same_bits_of_planes_and_of_the_mosaic(pattern, highlights, tmp_path):
    (tmp_path / "gains.csv").write_text(TABLE.replace(",W", "").replace(",1.03", "").replace(",1.8", ""))
    steps = [
        ("lens_shading", f'map = "table"\ntable = "{tmp_path / "gains.csv"}"'),
        ("balance_mosaic", f'highlights = "{highlights}"'),
        ("sharpen_mosaic", "strength = 0.0"),
    ]
    planes, mosaic = (corrected(pattern, use, steps) for use in ("no_mask", "mosaic"))
    assert planes.shape == (3, 25, 28)
    assert np.ptp(mosaic) > 0.1
    assert_array_equal(cfa.pick(planes, pattern), mosaic)


def test_each_plane_has_its_own_white_and_level_and_the_white_of_all_is_whole():
    white = corrected("RGGB", "no_mask", [("balance_mosaic", "")], "white")
    assert white.shape == (3,) and np.ptp(white) == 0
    level = corrected("RGGB", "no_mask", [("lens_shading", "")], "clipping_level")
    assert level.shape == (3,)


def stage(name, **values):
    return installed_stages().load(name)(**values)


SITES = {"R": (0, 0), "B": (1, 1)}  # of RGGB: where every pixel has the neighbours of its colour around it, two apart


@pytest.mark.parametrize("letter", SITES)
def test_planes_cut_out_of_a_mosaic_are_sharpened_and_searched_as_the_mosaic_is_at_those_sites(letter):
    rng, (row, column) = np.random.default_rng(3), SITES[letter]
    mosaic = rng.uniform(0.2, 0.8, (24, 20))
    mosaic[8:10, 6:8] = 0.99  # stands out in every colour
    cut = np.s_[row::2, column::2]
    whole, alone = (stage("sharpen_mosaic", strength=0.4, pattern=pattern) for pattern in ("RGGB", letter))
    assert_array_equal(alone.run(mosaic[cut])["mosaic_linear"], whole.run(mosaic)["mosaic_linear"][cut])
    y, x = np.arange(24.0), np.arange(20.0)
    whole, alone = (stage("correct_found_defects", contrast=0.0, pattern=pattern) for pattern in ("RGGB", letter))
    found = whole.run(mosaic, y, x)["mosaic_linear"]
    plane = alone.run(np.ascontiguousarray(mosaic[cut]), np.arange(12.0), np.arange(10.0))["mosaic_linear"]
    assert_array_equal(
        plane != mosaic[cut], found[cut] != mosaic[cut]
    )  # what takes their place looks at the other colours too
    assert 0 < np.count_nonzero(plane != mosaic[cut]) < plane.size // 4


def test_one_letter_is_a_mask_of_one_filter():
    assert cfa.parse("g").channels == ("G",) and cfa.parse("g").period == (1, 1)
    with pytest.raises(ValueError, match="pattern is '7'"):
        cfa.parse("7")

"""Prescriptions from names, tables and Zemax files."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("optiland")

from etendue_lens_optiland.lens import open_lens
from etendue_lens_optiland.prescription import load, sample_names
from numpy.testing import assert_allclose

WIDE = str(Path(__file__).parent / "data" / "wide_56deg.csv")
ZEMAX = """VERS 190513 0 123 L123
MODE SEQ
NAME a lens of one glass
UNIT MM X W X CM MR CPMM
ENPD 2.5
FTYP 0 0 1 1 0 0 0 0
XFLN 0.0
YFLN 0.0
WAVM 1 0.55 1.0
PWAV 1
GCAT SCHOTT
SURF 0
  TYPE STANDARD
  CURV 0.0 0 0 0 0 ""
  DISZ INFINITY
SURF 1
  STOP
  TYPE STANDARD
  CURV 0.05 0 0 0 0 ""
  DISZ 2.0
  GLAS N-BK7 0 0 1.5168 64.17 0 0 0 0 0 0
  DIAM 4.0 1 0 0 1 ""
SURF 2
  TYPE STANDARD
  CURV -0.05 0 0 0 0 ""
  DISZ 18.6
  DIAM 4.0 1 0 0 1 ""
SURF 3
  TYPE STANDARD
  CURV 0.0 0 0 0 0 ""
  DISZ 0.0
"""


def tangent(degrees):
    return float(np.tan(np.radians(degrees)))


def test_a_zemax_file_is_read_with_its_glass_and_its_image(tmp_path):
    path = tmp_path / "one.zmx"
    path.write_text(ZEMAX)
    found = {w: open_lens(file=str(path), f_number=8.0, reference_um=w) for w in (0.45, 0.55, 0.65)}
    for wavelength, lens in found.items():
        index = float(np.ravel(lens.prescription.surfaces[0].material_post.n(wavelength))[0])
        power = (index - 1) * (0.05 + 0.05 - (index - 1) * 2.0 * 0.05 * 0.05 / index)
        # the lensmaker's equation with its thickness
        assert_allclose(lens.focal_length, 1 / power, rtol=1e-9)
        assert_allclose(lens.back_focus, (1 / power) * (1 - (index - 1) * 2.0 * 0.05 / index), rtol=1e-8)
    assert found[0.45].focal_length < found[0.55].focal_length < found[0.65].focal_length
    assert found[0.55].prescription.image_given
    assert found[0.55].prescription.stop == 0


def test_a_table_of_surfaces_is_the_lens_it_says():
    lens = open_lens(file=WIDE, focal_length_mm=6.93, f_number=11.0)
    assert_allclose(lens.focal_length, 12.5, rtol=0.01)  # nominal
    assert lens.prescription.stop_radius == 0.90625
    assert not lens.prescription.image_given
    assert_allclose(lens.shift, lens.back_focus, rtol=1e-9)  # then it stands at the paraxial image
    assert lens.bundle(0.0, 0.55, 64).wavefront_rms() < 0.05


def test_rims_cut_the_corner_and_only_there(tmp_path):
    narrow = tmp_path / "narrow.csv"
    narrow.write_text(Path(WIDE).read_text().replace("6.365,1.0,4.025", "6.365,1.0,2.4"))
    free = tmp_path / "free.csv"
    lines = Path(WIDE).read_text().splitlines()
    free.write_text(
        "\n".join(line if not line[:1].isdigit() else ",".join([*line.split(",")[:4], "0", line[-1]]) for line in lines)
    )
    areas = {}
    for name, path in (("as is", WIDE), ("narrow", narrow), ("free", free)):
        lens = open_lens(file=str(path), f_number=11.0)
        areas[name] = lens.illumination(np.array([0.0, tangent(15.0), tangent(26.0)]), (0.55,), 64)[0]
    assert_allclose(areas["narrow"][0], areas["free"][0], rtol=1e-12)
    assert areas["narrow"][2] < 0.9 * areas["free"][2]
    assert areas["as is"][2] <= areas["free"][2] * (1 + 1e-3)  # boxes around the pupil differ


def test_an_f_number_beyond_the_stop_is_refused_with_the_widest():
    with pytest.raises(ValueError, match=r"about f/8\.\d"):
        open_lens(file=WIDE, f_number=4.0)


def test_a_table_with_abbe_numbers_disperses(tmp_path):
    path = tmp_path / "crown.csv"
    path.write_text("radius_mm,thickness_mm,index_after,abbe,is_stop\n20,2,1.5168,64.17,1\n-20,18.6,1.0,,0\n")
    blue, red = (open_lens(file=str(path), f_number=8.0, reference_um=w).focal_length for w in (0.4861, 0.6563))
    # 1/V between the lines F and C that define it
    assert_allclose((red - blue) / red, 1 / 64.17, rtol=0.03)
    named = tmp_path / "named.csv"
    named.write_text("radius_mm,thickness_mm,glass,is_stop\n20,2,N-BK7,1\n-20,18.6,,0\n")
    assert_allclose(open_lens(file=str(named), f_number=8.0, reference_um=0.4861).focal_length, blue, rtol=1e-3)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("a,b\n1,2\n", "expected a header"),
        ("radius_mm,thickness_mm,index_after,is_stop\n20,2,1.5,0\n-20,18,1,0\n", "exactly one"),
        ("radius_mm,thickness_mm,index_after,is_stop\n20,2,0.5,1\n-20,18,1,0\n", "at least 1"),
        ("radius_mm,thickness_mm,index_after,is_stop\n20,2,x,1\n-20,18,1,0\n", "not a number"),
        ("radius_mm,thickness_mm,index_after,is_stop\n20,2,1.5,1\n-20,18,1.5,0\n", "lenses in air"),
        ("radius_mm,thickness_mm,index_after,is_stop\n-20,2,1.5,1\n20,18,1,0\n", "no real image"),
    ],
)
def test_broken_tables_are_refused(tmp_path, text, what):
    path = tmp_path / "broken.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=what):
        open_lens(file=str(path), f_number=8.0)


def test_unknown_lenses_and_files_are_refused_with_what_there_is(tmp_path):
    with pytest.raises(ValueError, match="did you mean ReverseTelephoto"):
        load("ReversedTelephoto")
    with pytest.raises(ValueError, match="must be a Zemax file"):
        load("", str(tmp_path / "lens.seq"))
    broken = tmp_path / "broken.zmx"
    broken.write_text("SURF 0\n")
    with pytest.raises(ValueError, match="could not read it as a Zemax file"):
        load("", str(broken))
    with pytest.raises(ValueError, match="mirror"):
        load("HubbleTelescope")
    assert "ReverseTelephoto" in sample_names()

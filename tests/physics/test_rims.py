"""Kernels at the rim of what floats can say, against high precision. In: extreme arguments. Out: relative errors.

The literals are of 20 digits: `mpmath` with 400 digits for D(f)/D(0) (the closed integrals of the diffusion equation),
60 for CIEDE2000 (Sharma, Wu, Dalal 2005, eqs. 2-22, for inputs as exact binary64), 25 for a pixel's share of an Airy
spot (Gauss's rule over its area).
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from etendue_camera.colour.difference import delta_e_2000
from etendue_camera.optics.diffraction import pixel_airy
from etendue_camera.sensor.photodiode import collection, collection_mtf, collection_per_absorption

WEAK = [  # absorption 1/um, f cycles/um, depletion, depth, diffusion length um, back, D(f)/D(0)
    (
        5e-324,
        0.0015143994690342889,
        0.0032796701805010535,
        0.9556331642016497,
        0.8508120356077739,
        "absorbing",
        0.9999940494330202181,
    ),
    (
        5e-324,
        0.00012562783700073202,
        0.5584820825790895,
        0.2798200008793732,
        87126.23636898598,
        "absorbing",
        0.9999999991855635337,
    ),
    (
        2e-323,
        0.0017242931416062857,
        0.02511816891150463,
        528.3101463842479,
        8077.878601839352,
        "reflecting",
        0.17498409267364568308,
    ),
    (
        2e-323,
        0.00010865674018854746,
        0.028820953643352434,
        33.46067501603986,
        7.422891992212103,
        "absorbing",
        0.999988481434668006,
    ),
    (
        1.5e-322,
        0.006013866360651174,
        5.428919537076621,
        0.4011848425307971,
        224.4780605634067,
        "reflecting",
        0.99999472937339806731,
    ),
    (
        1.5e-322,
        0.00031981379552341316,
        0.0020325966721604707,
        0.1394271021818944,
        3899.1814700076,
        "absorbing",
        0.9999999936439706399,
    ),
    (
        3e-320,
        2.9540536120754957,
        0.02883876534665873,
        0.17792495644007328,
        391.6138112408781,
        "absorbing",
        0.66970135703062739323,
    ),
    (
        3e-320,
        0.004534570370891574,
        0.0011142492019265012,
        0.016748887466359948,
        1.0408838324962513,
        "reflecting",
        0.99999992883669720737,
    ),
    (
        1e-315,
        0.02447990990505033,
        0.016192385363634508,
        1.1300884681389778,
        0.16642367535787347,
        "reflecting",
        0.99970158037411395131,
    ),
    (
        1e-315,
        0.016501010404124175,
        1.726546519284873,
        1.377795160355409,
        1.969330778386369,
        "absorbing",
        0.99955510685027437586,
    ),
]

# two colours L*, a*, b*, beside one another: across 0 degrees, anywhere, on the axis, along a radius; their difference
NEAR = [
    (
        (18.576425653205174, 53.82008547798903, 2.6431182412519865e-10),
        (18.576425653205174, 53.82008549208229, -1.3343575318148282e-09),
        4.1919129607319463726e-9,
    ),
    (
        (50.66921598704782, -74.00069464928242, -10.616690614018268),
        (50.66921598704408, -74.00069464928598, -10.616690614018923),
        3.8231276670900002998e-12,
    ),
    (
        (16.142176503468104, 21.74292234552609, 0.0),
        (16.142176503468104, 21.74292234552609, -0.0012455850051826779),
        0.00081235637780601791451,
    ),
    (
        (90.29380482113051, 12.33647177879979, -16.531124055875175),
        (90.29380482113051, 12.336570170035742, -16.53125590214019),
        0.0000897542095333913331,
    ),
    (
        (9.192441255598066, 69.38513442865096, 0.015871524540128808),
        (9.192441255598066, 66.67967332639022, -0.006455395201507513),
        0.66623469881178855451,
    ),
    (
        (78.45137232080283, -51.08377921217, 13.056026185994597),
        (78.45137232149001, -51.08377921280123, 13.056026186230783),
        5.2399130740692621592e-10,
    ),
    (
        (10.36410529696094, 20.44690346144949, 0.0),
        (10.36410529696094, 20.44690346144949, -4.9054485461670965e-12),
        3.2323862264942073518e-12,
    ),
    (
        (43.483307510246256, -29.736452739713357, 13.689898161222203),
        (43.483307510246256, -29.737359910101006, 13.690315799140569),
        0.00040833502328705847603,
    ),
    (
        (31.97902971773141, 64.57846111418684, 6.753079422235649e-08),
        (31.97902971773141, 64.57845792101688, -5.549584875368051e-08),
        8.1934532248453189293e-7,
    ),
    (
        (83.7623746016086, 36.71124631027482, -33.92995761757015),
        (83.7623751765068, 36.711245852997024, -33.929957715599116),
        4.5004367777780055177e-7,
    ),
    (
        (18.67860811944543, 41.67223253568542, 0.0),
        (18.67860811944543, 41.67223253568542, -0.00021308369799830746),
        0.00011638170158576075396,
    ),
    (
        (65.13942708809557, 42.331338594050095, 11.68415044438143),
        (65.13942708809557, 42.331338594164365, 11.684150444412971),
        3.9890195691283946529e-11,
    ),
    (
        (33.237276156328704, 57.147152470524446, 0.0025369547510121645),
        (33.237276156328704, 57.186128826452496, -0.001947225670855631),
        0.011113118211384337298,
    ),
    (
        (90.02129855971437, -4.144266012856889, 26.264352875947907),
        (90.01977286722759, -4.143566278118722, 26.264863820102587),
        0.0011750749573416495057,
    ),
    (
        (78.97323079487434, 26.34466490706119, 0.0),
        (78.97323079487434, 26.34466490706119, -0.08395669502312703),
        0.053048030950280851739,
    ),
    (
        (65.17874442957694, -76.38993151110583, -6.128754192037462),
        (65.17874442957694, -76.38993284998685, -6.128754299455712),
        3.0194103270057809742e-7,
    ),
]

FAR = [  # pitch over lambda N, row, column, share of the spot
    (5.4 / 0.55, 39, 0, 5.4868887787219368482e-8),
    (5.4 / 0.55, 300, 0, 1.2226203700083963893e-10),
    (5.4 / 0.55, 1000, 0, 3.3372586533641676504e-12),
    (5.4 / 0.55, 1000, 707, 1.7884838139789367743e-12),
    (1.0, 100, 37, 2.7555208020854029753e-8),
    (1.0, 3000, 3000, 4.6420731167993110107e-13),
    (2.75, 1000, 500, 8.2891474057574364362e-12),
    (9.818181818181818, 100000, 50000, 2.3483387558712154366e-18),
    (40.0, 2000, 1, 1.0078541822506175649e-13),
]


@pytest.mark.parametrize(("absorption", "f", "depletion", "depth", "length", "back", "expected"), WEAK)
def test_diffusion_of_hardly_any_absorption_keeps_its_digits(absorption, f, depletion, depth, length, back, expected):
    assert_allclose(collection_mtf(f, absorption, depletion, depth, length, back), expected, rtol=1e-15)


def test_the_limit_of_no_absorption_is_reached_without_a_jump():
    """D/alpha differs from its limit by alpha times a length: by nothing for the smallest numbers."""
    for depletion in (0.0, 1.8, np.inf):
        at_zero = collection_per_absorption(0.1, 0.0, depletion, 10.0, 50.0)
        for absorption in (5e-324, 1e-310, 1e-300):
            with np.errstate(over="raise", divide="raise", invalid="raise"):
                found = collection_per_absorption(0.1, absorption, depletion, 10.0, 50.0)
                share = collection(0.1, absorption, depletion, 10.0, 50.0)
            assert found == pytest.approx(at_zero, rel=1e-15) or depletion == np.inf
            assert 0 <= share <= 1


@pytest.mark.parametrize(("first", "second", "expected"), NEAR)
def test_colours_beside_one_another_differ_with_all_digits(first, second, expected):
    """Also where their hues stand on either side of 0 degrees."""
    assert_allclose(delta_e_2000(np.array(first), np.array(second)), expected, rtol=2e-15)


def test_a_difference_across_zero_degrees_is_that_of_the_mirrored_pair():
    """Mirrored about the a* axis, the two halves of a hue difference are equal; weights change in proportion to the
    hue.
    """
    for step in (1e-3, 1e-6, 1e-9):
        across = delta_e_2000(np.array([50.0, 40.0, step]), np.array([50.0, 40.0, -step]))
        beside = 2 * delta_e_2000(np.array([50.0, 40.0, step]), np.array([50.0, 40.0, 0.0]))
        assert_allclose(across, beside, rtol=1e-2 * step + 1e-14)


@pytest.mark.parametrize(("pitch", "row", "column", "expected"), FAR)
def test_far_pixels_keep_their_digits(pitch, row, column, expected):
    """Four edges of the order of the share times the distance: a rounding for each pixel of it."""
    assert_allclose(pixel_airy(row, column, pitch, 1.0, 1.0), expected, rtol=2e-15 * np.hypot(row, column) + 1e-14)

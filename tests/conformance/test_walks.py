"""Jumps are found along a path; bends, roots and steep curves are none."""

import numpy as np
import pytest

from etendue.contract.capabilities import decides
from etendue.contract.registry import installed_stages
from etendue.testing.behaviour.paths import FINE, LIGHT, treats_places_alone
from etendue.testing.behaviour.walking import jumps_along
from etendue.testing.bench import Bench
from etendue.testing.cases import ordinary

ALLOWED = 1e-6


def largest(curve, places=LIGHT):
    (found,) = jumps_along(lambda ts: [{"it": np.array([curve(t)])} for t in ts], places, ["it"], ALLOWED, 4).values()
    return found


@pytest.mark.parametrize("power", [0.01, 0.1, 0.45, 0.5, 1.0, 2.2])
def test_a_power_is_no_jump_at_0_however_steep(power):
    assert largest(lambda t: t**power)[0] <= ALLOWED


@pytest.mark.parametrize("curve", [lambda t: min(t, 1.0), lambda t: t / (1 + t), np.log1p, lambda t: abs(t - 0.3)])
def test_bends_and_curves_are_no_jumps(curve):
    assert largest(curve)[0] <= ALLOWED


@pytest.mark.parametrize(
    ("curve", "places", "size", "where"),
    [
        (lambda t: t * (1 + 1e-5 * (t > 2.3)), LIGHT, 1e-5, 2.3),
        (lambda t: 0.98 if t > 1 else t, LIGHT, 0.02, 1.0),
        (lambda t: t + (t > 0) * 1e-3, LIGHT, 1.0, 0.0),
        (lambda t: t / (1 + t) * (1 + 1e-5 * (t > 2.3)), FINE, 1e-5, 2.3),
    ],
)
def test_a_jump_is_found_with_its_size_and_place(curve, places, size, where):
    off, low, high = largest(curve, places)
    assert off == pytest.approx(size, rel=0.03)
    assert low <= where <= high


def test_an_encoding_decides_only_where_its_standard_has_a_step():
    kind = installed_stages().load("encode")
    assert [decides(kind(encoding=word)) for word in ("sRGB", "power", "BT.709")] == [False, False, True]


def test_places_are_by_themselves_in_a_curve_and_not_in_a_blur():
    alone = {}
    for name in ("encode", "denoise", "falloff"):
        kind = installed_stages().load(name)
        alone[name] = treats_places_alone(Bench(kind(**ordinary(kind))))
    assert alone == {"encode": True, "denoise": False, "falloff": False}

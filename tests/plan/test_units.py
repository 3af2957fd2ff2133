"""Numbers in a pipeline file are exact: one decimal value, one float, whatever unit it was written in."""

import re
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from etendue.contract.values.parameter import Parameter
from etendue.contract.values.units import UnitError, parse_unit, same_unit, to_unit
from etendue.plan.wiring.parameters import Unfit, axis_values, resolve

HERE = Path()
ANY = Parameter()
LENGTH = Parameter(units="um")

decimals = st.decimals(
    min_value=Decimal("1e-9"), max_value=Decimal("1e9"), allow_nan=False, allow_infinity=False, places=9
).filter(bool)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("5400 nm", "um", 5.4),
        ("5.4um", "um", 5.4),
        ("5.4 µm", "um", 5.4),
        ("5.4 μm", "um", 5.4),
        ("0.54e-2 mm", "um", 5.4),
        ("1e3 cd/m2", "cd m-2", 1000.0),
        ("0.1 cd cm-2", "cd m-2", 1000.0),
        ("1 electron/um2", "electron um-2", 1.0),
        ("1e8 electron cm-2", "electron um-2", 1.0),
        ("0.1 nA cm-2", "A cm-2", 1e-10),
        ("90 arcmin", "deg", 1.5),
        ("2 min", "s", 120.0),
        ("5 %", "1", 0.05),
        ("3", "mm", 3.0),
        ("100 lp/mm", "cycles/um", 0.1),
        ("0.1 cycles/um", "cycles/mm", 100.0),
        ("0.25 um-1", "cycles/um", 0.25),
        ("1 cycle/mm", "mm-1", 1.0),
        ("0.5 cycles/pixel", "cycles/pixel", 0.5),
    ],
)
def test_text_with_a_unit_is_the_nearest_float_of_its_decimal_value(text, unit, value):
    assert to_unit(text, unit) == value


def test_units_that_say_the_same_are_the_same_however_they_are_written():
    """Of what is not in the table the text decides."""
    assert same_unit("um-1", "cycles/um")
    assert same_unit("lp/mm", "mm-1")
    assert same_unit("W m-2 nm-1", "W/m2/nm")
    assert same_unit("arcsec", "arcsec")
    assert not same_unit("cycles/um", "cycles/mm")
    assert not same_unit("cycles/pixel", "cycles/um")
    assert not same_unit("arcsec", "arcsecond")


@given(number=decimals)
def test_the_same_length_in_three_units_is_the_same_float(number):
    """Bit for bit: a sweep written in nm meets the cells of one written in um."""
    assert to_unit(f"{number} um", "um") == float(number)
    assert to_unit(f"{number * 1000} nm", "um") == float(number)
    assert to_unit(f"{number / 1000} mm", "um") == float(number)


@given(number=decimals, unit=st.sampled_from(["mm", "nm", "cm", "m", "km", "in"]))
def test_a_conversion_is_correctly_rounded(number, unit):
    """The float nearest to the exact rational value: two roundings would miss it about once in two thousand."""
    metres = {
        "mm": Fraction(1, 1000),
        "nm": Fraction(1, 10**9),
        "cm": Fraction(1, 100),
        "m": 1,
        "km": 1000,
        "in": Fraction(254, 10000),
    }
    assert to_unit(f"{number} {unit}", "um") == float(Fraction(number) * metres[unit] * 10**6)


@given(
    powers=st.lists(
        st.tuples(st.sampled_from(["m", "um", "s", "sr", "W"]), st.integers(-3, 3).filter(bool)), min_size=1, max_size=4
    )
)
def test_a_unit_means_the_same_in_any_order_and_with_a_slash(powers):
    text = " ".join(f"{symbol}{power}" for symbol, power in powers)
    slashed = "1" + "".join(f" {symbol}{power}" if power > 0 else f"/{symbol}{-power}" for symbol, power in powers)
    backwards = " ".join(f"{symbol}{power}" for symbol, power in reversed(powers))
    assert parse_unit(text) == parse_unit(backwards) == parse_unit(slashed)


@pytest.mark.parametrize("text", ["-0", "-0.0", "-0 nm", "-0e5 mm"])
def test_minus_zero_is_zero(text):
    """Else two files that mean the same would have two keys."""
    assert str(to_unit(text, "um")) == "0.0"
    assert str(resolve(Decimal("-0.0"), LENGTH, float, HERE)) == "0.0"
    assert str(resolve(-0.0, LENGTH, float, HERE)) == "0.0"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "um",
        "3 parsec",
        "3 um um",
        "1/3",
        "1_000",
        "0x10",
        "nan",
        "inf um",
        "1e999999999 km",
        "3 nm-999999999",
        "3 ms",
    ],
)
def test_anything_else_is_refused_and_the_message_quotes_it(text):
    with pytest.raises(UnitError) as caught:
        to_unit(text, "um")
    quoted = re.search("'(.*?)'", str(caught.value))
    assert quoted is not None
    assert quoted[1] in text


def test_neither_a_list_nor_a_truth_value_is_a_number():
    for value in ([1], [0, [2], 0], True, None, {}):
        with pytest.raises(Unfit):
            resolve(value, ANY, float, HERE)


def test_infinity_is_a_value_only_where_it_is_allowed():
    endless = Parameter(units="um", above=0, infinite=True)
    assert resolve("inf", endless, float, HERE) == float("inf")
    assert resolve(Decimal("inf"), endless, float, HERE) == float("inf")
    for parameter, value in (
        (LENGTH, "inf"),
        (LENGTH, Decimal("inf")),
        (endless, Decimal("-inf")),
        (endless, Decimal("nan")),
    ):
        with pytest.raises(Unfit):
            resolve(value, parameter, float, HERE)


@given(
    first=st.floats(1e-6, 1e6),
    ratio=st.floats(1.01, 1e3),
    steps=st.integers(2, 40),
    spacing=st.sampled_from(["linear", "log"]),
)
def test_generated_axes_have_twelve_digits_and_hold_both_ends(first, ratio, steps, spacing):
    """Rounded, so that an axis written on another machine, or backwards, is the same axis."""
    low, high = Decimal(f"{first:.6g}"), Decimal(f"{first * ratio:.6g}")
    if low == high:
        return
    forwards = axis_values({"from": low, "to": high, "steps": steps, "spacing": spacing}, ANY, float, HERE)
    backwards = axis_values({"from": high, "to": low, "steps": steps, "spacing": spacing}, ANY, float, HERE)
    assert forwards[0] == float(low)
    assert forwards[-1] == float(high)
    assert list(forwards) == sorted(forwards)
    assert all(value == float(f"{value:.12g}") for value in forwards)
    # two ways to one value differ by rounding alone, 1e-16 times a few, far below half of the twelfth digit unless on
    # its edge
    assert all(abs(a - b) <= 1.01e-11 * abs(a) for a, b in zip(forwards, reversed(backwards), strict=True))


def test_a_generated_axis_is_the_list_it_stands_for():
    spaced = axis_values({"from": "1 um", "to": "6 um", "steps": 6}, LENGTH, float, HERE)
    assert spaced == axis_values(["1 um", 2, Decimal("3"), "4000 nm", 5.0, "0.006 mm"], LENGTH, float, HERE)
    assert axis_values({"from": 1, "to": 1000, "steps": 4, "spacing": "log"}, ANY, float, HERE) == (
        1.0,
        10.0,
        100.0,
        1000.0,
    )
    assert axis_values({"from": 3, "to": 9, "steps": 1}, ANY, float, HERE) == (3.0,)


def test_an_axis_of_whole_numbers_refuses_steps_between_them():
    assert axis_values({"from": 8, "to": 12, "steps": 3}, ANY, int, HERE) == (8, 10, 12)
    with pytest.raises(Unfit, match="whole number"):
        axis_values({"from": 8, "to": 11, "steps": 3}, ANY, int, HERE)

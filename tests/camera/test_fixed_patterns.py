"""Fixed patterns are the sensor's: its serial, the pattern's own name and the absolute pixel say what they are, and
nothing else.
"""

import itertools
import math

import numpy as np
import pytest

import etendue
from etendue.compute.random import tiled_normal
from etendue.compute.tables import PatternRandom
from etendue.contract.arrays.grid import Grid, Line

SIDE = 384  # pixels: half of them, the hot ones, scatter a correlation by 0.0037, a fifth of what is allowed
APART = 0.02
# of a pattern's rms: single precision holds a charge of 8000 electrons to 5e-4, of which 6 are the rms of a pattern
ROUNDING = 1e-4
MAPS = ("hot or dead", "stuck", "stuck level")
STAGES = ("defects", "leaking", "exposure", "shot_noise", "read_noise", "line_pattern", "adc", "stuck_pixels")
SHOWN = {
    "mosaic": "photocurrent",
    "defects": "photocurrent defect_map",
    "leaking": "expected_charge",
    "exposure": "expected_charge",
    "shot_noise": "charge",
    "read_noise": "charge",
    "line_pattern": "charge",
    "stuck_pixels": "raw stuck_map",
}


def document(side=SIDE, suffix="", window=None, front=(), **tables):
    """A grey card on a sensor with every pattern: the stages that have one stand beside each other, under their
    names and a suffix.
    """
    named = {use: use + suffix for use in STAGES}
    scene = {
        "width": side * 6,
        "height": side * 6,
        "spacing": 6,
        "wavelength_from": 545,
        "wavelength_to": 555,
        "bin_width": 10,
    }
    camera = {
        "peak_qe": [0.5],
        "sensitivity": "flat",
        "pattern": "mono",
        "pixel_pitch": 6,
        "read_noise": 0,
        "dsnu": 8,
        "dark_current_density": 3e-8,
        "integration_time": 0.05,
        **tables.pop("camera", {}),
    }
    own = {
        "defects": {"hot": 0.5, "dead": 0.2},
        "leaking": {"use": "exposure", "prnu": 0, "dark_nonuniformity": 0.1},
        "exposure": {"prnu": 0.05, "dark_nonuniformity": 0},
        "line_pattern": {"row_pattern": 6, "column_pattern": 6},
        "stuck_pixels": {"stuck": 0.5},
    }
    beside = {use: {"from": {"photocurrent": "mosaic"}} for use in ("leaking", "exposure")}
    return {
        "name": "patterns",
        "precision": "float64",
        "camera": camera,
        "stages": [
            {"use": "uniform", "name": "scene", "white_luminance": 100, **scene},
            {"use": "irradiance"},
            {"use": "pixel", "rows": side, "columns": side, **(window or {})},
            {"use": "mosaic"},
            *front,
            *({"use": use, **own.get(use, {}), **beside.get(use, {}), "name": name} for use, name in named.items()),
        ],
        "wanted": [
            f"{named.get(use, use)}.{variable}" for use, variables in SHOWN.items() for variable in variables.split()
        ],
        **tables,
    }


def patterns_of(suffix="", **how):
    """Every pattern as its stage shows it, in units of what it adds; what has no value at a pixel is 0 there."""
    tree = etendue.simulate(document(suffix=suffix, **how))

    def found(stage, variable):
        return tree[stage + suffix][variable].values.astype(float)

    hot, stuck = found("defects", "defect_map") == 1, found("stuck_pixels", "stuck_map")
    lines = found("line_pattern", "charge") - found("read_noise", "charge")
    return {
        "prnu": found("exposure", "expected_charge"),
        "dark current": found("leaking", "expected_charge"),
        "dsnu": found("read_noise", "charge") - found("shot_noise", "charge"),
        "row": lines - lines.mean(axis=-2, keepdims=True),
        "column": lines - lines.mean(axis=-1, keepdims=True),
        "hot or dead": found("defects", "defect_map"),
        "hot rate": np.where(hot, found("defects", "photocurrent") - tree["mosaic"].photocurrent.values, 0),
        "stuck": stuck,
        "stuck level": np.where(stuck > 0, found("stuck_pixels", "raw"), 0),
    }


def same(one, other):
    for name, pattern in one.items():
        if name in MAPS:
            np.testing.assert_array_equal(other[name], pattern, err_msg=name)
        else:
            apart = np.abs((other[name] - other[name].mean()) - (pattern - pattern.mean()))
            assert apart.max() < ROUNDING * pattern.std(), name
        assert np.corrcoef(pattern.ravel(), other[name].ravel())[0, 1] > 1 - 1e-8, name


def correlation(one, other, where=None):
    where = np.ones(one.shape, bool) if where is None else where
    return abs(np.corrcoef(one[where], other[where])[0, 1])


@pytest.fixture(scope="module")
def sensor():
    return patterns_of()


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 2},
        {"precision": "float32"},
        {"suffix": "_by_another_name"},
        {"camera": {"noise": "common", "bits": 12}},
    ],
    ids=str,
)
def test_a_sensor_has_one_pattern_whatever_is_drawn_asked_or_called(sensor, change):
    same(sensor, patterns_of(**change))


def test_a_window_of_a_sensor_has_the_patterns_of_its_pixels(sensor):
    """From pixel 50, 70 on: its tiles are cut."""
    rows, columns = slice(50, 330), slice(70, 380)
    found = patterns_of(window={"first_row": 50, "first_column": 70, "window_rows": 280, "window_columns": 310})
    crop = {name: pattern[rows, columns] for name, pattern in sensor.items()}
    for name in ("row", "column"):  # whose mean over the window was taken off
        crop[name] = crop[name] - crop[name].mean()
    same(crop, found)


def test_a_sensor_keeps_its_patterns_from_frame_to_frame():
    frames = patterns_of(side=64, front=({"use": "bracket", "repeats": 3, "brackets": [0]},))
    for name in ("prnu", "dark current", "dsnu", "row", "column", "stuck", "stuck level"):
        assert frames[name].shape == (3, 64, 64)
        same({name: frames[name][0]}, {name: frames[name][1]})
        same({name: frames[name][0]}, {name: frames[name][2]})


def test_stages_that_ask_for_one_pattern_are_given_one():
    """Two exposures of one sensor: the pattern is the sensor's, and no stage's."""
    twin = {
        "use": "exposure",
        "name": "twin",
        "prnu": 0.05,
        "dark_nonuniformity": 0,
        "from": {"photocurrent": "mosaic"},
    }
    asked = document(side=64, front=(twin,))
    asked["wanted"] += ["twin.expected_charge"]
    tree = etendue.simulate(asked)
    np.testing.assert_array_equal(tree["twin"].expected_charge, tree["exposure"].expected_charge)
    assert tree["twin"].expected_charge.std() > 0.01 * tree["twin"].expected_charge.mean()


def test_another_sensor_has_other_patterns(sensor):
    other = patterns_of(camera={"sensor_serial": "2"})
    hot = (sensor["hot or dead"] == 1) & (other["hot or dead"] == 1)
    stuck = (sensor["stuck"] > 0) & (other["stuck"] > 0)
    for name in ("prnu", "dark current", "dsnu", "hot or dead", "stuck"):
        assert correlation(sensor[name], other[name]) < APART, name
    for name, where in (("hot rate", hot), ("stuck level", stuck)):
        assert correlation(sensor[name], other[name], where) < 5 / math.sqrt(where.sum()), name
    for name in ("row", "column"):
        assert correlation(sensor[name], other[name]) < 5 / math.sqrt(SIDE), name


def test_patterns_of_one_sensor_know_nothing_of_each_other(sensor):
    """Where both have a value; the levels of stuck pixels are no tiles of the rates of hot ones."""
    where = {"hot rate": sensor["hot or dead"] == 1, "stuck level": sensor["stuck"] > 0}
    pixels = [name for name in sensor if name not in ("row", "column")]
    for one, other in itertools.combinations(pixels, 2):
        both = np.logical_and(where.get(one, True), where.get(other, True)) & np.ones((SIDE, SIDE), bool)
        if sensor[one][both].std() and sensor[other][both].std():
            assert correlation(sensor[one], sensor[other], both) < max(APART, 5 / math.sqrt(both.sum())), (one, other)


@pytest.mark.parametrize("serials", [("1", "1"), ("1", "2"), ("", "1")], ids=str)
def test_names_kinds_and_serials_part_patterns_and_nothing_else_does(serials):
    """50 000 rows or columns, 65 000 pixels: a scatter of 0.0045."""
    pixels, rows, columns = (Grid.of({"y": Line(n), "x": Line(m)}) for n, m in ((256, 256), (50_000, 1), (1, 50_000)))

    def drawn(serial, name):
        one, down, along = (PatternRandom(serial.encode(), grid, "float64") for grid in (pixels, rows, columns))
        return {
            "normal": one.normal(name),
            "uniform": one.uniform(name),
            "row": down.row_normal(name),
            "column": along.column_normal(name),
        }

    first, second = (
        drawn(serial, name)
        for serial, name in zip(serials, ("a", "a" if serials[0] != serials[1] else "b"), strict=True)
    )
    for how in first:
        assert correlation(first[how].ravel(), second[how].ravel()) < APART
        np.testing.assert_array_equal(first[how], drawn(serials[0], "a")[how])
    for one, other in itertools.combinations(first, 2):
        size = min(first[one].size, first[other].size)
        assert correlation(first[one].ravel()[:size], first[other].ravel()[:size]) < APART
    assert correlation(first["normal"][:, 0], first["row"].ravel()[:256]) < 5 / 16  # of 256 rows


def test_what_joins_a_serial_and_a_name_is_in_neither():
    grid = Grid.of({"y": Line(256), "x": Line(256)})
    assert (
        correlation(
            PatternRandom(b"1|a", grid, "float32").normal("b"), PatternRandom(b"1", grid, "float32").normal("a|b")
        )
        < APART
    )
    assert (
        correlation(PatternRandom(b"1", grid, "float32").normal("b"), PatternRandom(b"", grid, "float32").normal("1b"))
        < APART
    )


def test_a_pattern_of_larger_pixels_is_cut_like_any_other():
    """Rows of two by two pixels, as a stage that joins them writes: the window is the crop."""
    whole = Grid.of({"y": Line(60, 0.5, 2.0), "x": Line(50, 0.5, 2.0)})
    part = Grid.of({"y": Line(20, 20.5, 2.0), "x": Line(10, 10.5, 2.0)})
    for how in ("normal", "uniform"):
        one, other = (getattr(PatternRandom(b"1", grid, "float32"), how)("a") for grid in (whole, part))
        np.testing.assert_array_equal(one[10:30, 5:15], other)


@pytest.mark.long
def test_patterns_are_normal_far_out_and_know_nothing_of_their_tiles():
    """16.8 million values, from -2048 on: moments and tails within 5 standard errors, at tiles' borders as inside."""
    pattern = tiled_normal(b"1\nnormal\nprnu", -2048, -2048, 4096, 4096)
    n, values = pattern.size, pattern.astype(np.float64)
    for power, expected, spread in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
        assert abs((values**power).mean() - expected) < 5 * math.sqrt(spread / n)
    for sigmas in (1, 2, 3, 4, 5):
        share = math.erfc(sigmas / math.sqrt(2))
        assert abs(np.count_nonzero(np.abs(pattern) > sigmas) - share * n) < 5 * math.sqrt(share * n) + 1
    for axis in (0, 1):
        product = (np.take(values, range(1, 4096), axis) * np.take(values, range(4095), axis)).mean(axis=1 - axis)
        across = product[63::64]  # from the last pixel of a tile to the first of the next
        assert abs(across.mean()) < 5 / math.sqrt(across.size * 4096)
        assert abs(np.delete(product, np.s_[63::64]).mean()) < 5 / math.sqrt((product.size - across.size) * 4096)
    tiles = values.reshape(64, 64, 64, 64).mean(axis=(1, 3))
    assert abs(tiles.var() * 4096 - 1) < 5 * math.sqrt(2 / 4096)
    place = values.reshape(64, 64, 64, 64).mean(axis=(0, 2))
    assert abs(place.var() * 4096 - 1) < 5 * math.sqrt(2 / 4096)

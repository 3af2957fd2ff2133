"""Maps: every cell drawn in its place, what is unknown left empty, what does not fit refused."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from etendue.report.maps import FACTOR_COLOURS, Axes, map_of_names, map_of_numbers

SIDES = Axes(x=[1.4, 2.8, 5.6], y=[1.0, 2.0], panels=["lens", "pixel"], x_name="f-number", y_name="pitch")


def colours_in(path):
    with Image.open(path) as picture:
        return {tuple(colour) for _, colour in picture.convert("RGB").getcolors(1 << 24)}


def byte(name):
    return tuple(round(255 * part) for part in to_rgb(FACTOR_COLOURS[name]))


def area(path, name):
    with Image.open(path) as picture:
        return int((np.asarray(picture.convert("RGB")) == byte(name)).all(axis=-1).sum())


def test_names_have_their_colours_and_areas(tmp_path):
    """Three of twelve cells against two: areas of the panels are in that proportion, the legend's patches besides."""
    indices = np.full((2, 2, 3), np.nan)
    indices[0, 0] = 0
    map_of_names(indices, ["lens", "noise"], SIDES, tmp_path / "one.png", "one")
    indices[1] = 1
    map_of_names(indices, ["lens", "noise"], SIDES, tmp_path / "two.png", "two")
    assert byte("noise") in colours_in(tmp_path / "one.png")  # in the legend
    drawn = area(tmp_path / "two.png", "noise") - area(tmp_path / "one.png", "noise")
    legend = area(tmp_path / "one.png", "noise")
    assert 1.9 < drawn / (area(tmp_path / "two.png", "lens") - legend) < 2.1
    assert not (tmp_path / "two.png.partial").exists()


def test_numbers_are_drawn_where_they_are_known(tmp_path):
    values = np.linspace(1, 300, 12).reshape(2, 2, 3)
    map_of_numbers(values, SIDES, tmp_path / "all.png", "all", "lp/mm")
    map_of_numbers(np.full((2, 2, 3), np.nan), SIDES, tmp_path / "none.png", "none", "lp/mm")
    map_of_numbers(np.full((2, 2, 3), 5.0), SIDES, tmp_path / "same.png", "same", "lp/mm")

    def coloured(name):
        return sum(max(c) - min(c) > 40 for c in colours_in(tmp_path / name))

    assert coloured("all.png") > coloured("none.png")
    assert (tmp_path / "same.png").exists()


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda path: map_of_numbers(np.zeros((2, 3, 2)), SIDES, path, ""), "shape"),
        (lambda path: map_of_names(np.full((2, 2, 3), 2.0), ["lens", "noise"], SIDES, path, ""), "allowed is 0 to 1"),
    ],
)
def test_what_does_not_fit_is_refused(call, text, tmp_path):
    with pytest.raises(ValueError, match=text):
        call(tmp_path / "map.png")
    assert not list(tmp_path.iterdir())

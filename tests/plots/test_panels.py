"""Maps: every cell drawn in its place, what is unknown left empty, what does not fit refused."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from etendue.contract.arrays.variables import variable
from etendue.present.plots.drawing.panels import Sides, map_of_figures, map_of_names
from etendue.present.plots.plot import Plot

TINTS = variable("limiting_factor").tints
SIDES = Sides(x=[1.4, 2.8, 5.6], y=[1.0, 2.0], panels=["lens", "pixel"], x_name="f-number", y_name="pitch")


def colours_in(path):
    with Image.open(path) as picture:
        return {tuple(colour) for _, colour in picture.convert("RGB").getcolors(1 << 24)}


def byte(name):
    return tuple(round(255 * part) for part in to_rgb(TINTS[name]))


def area(path, name):
    with Image.open(path) as picture:
        return int((np.asarray(picture.convert("RGB")) == byte(name)).all(axis=-1).sum())


def test_names_have_their_colours_and_areas(tmp_path):
    """Three of twelve cells against two: areas of the panels are in that proportion, the legend's patches besides."""
    indices = np.full((2, 2, 3), np.nan)
    indices[0, 0] = 0
    Plot(map_of_names(indices, ["lens", "noise"], SIDES, "one", tints=TINTS)).save(tmp_path / "one.png")
    indices[1] = 1
    Plot(map_of_names(indices, ["lens", "noise"], SIDES, "two", tints=TINTS)).save(tmp_path / "two.png")
    assert byte("noise") in colours_in(tmp_path / "one.png")  # in the legend
    drawn = area(tmp_path / "two.png", "noise") - area(tmp_path / "one.png", "noise")
    legend = area(tmp_path / "one.png", "noise")
    assert 1.9 < drawn / (area(tmp_path / "two.png", "lens") - legend) < 2.1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.png", "two.png"]


def test_numbers_are_drawn_where_they_are_known(tmp_path):
    values = np.linspace(1, 300, 12).reshape(2, 2, 3)
    Plot(map_of_figures(values, SIDES, "all", "lp/mm")).save(tmp_path / "all.png")
    Plot(map_of_figures(np.full((2, 2, 3), np.nan), SIDES, "none", "lp/mm")).save(tmp_path / "none.png")
    assert map_of_figures(np.full((2, 2, 3), 5.0), SIDES, "same", "lp/mm").axes

    def coloured(name):
        return sum(max(c) - min(c) > 40 for c in colours_in(tmp_path / name))

    assert coloured("all.png") > coloured("none.png")


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: map_of_figures(np.zeros((2, 3, 2)), SIDES, ""), "shape"),
        (lambda: map_of_names(np.full((2, 2, 3), 2.0), ["lens", "noise"], SIDES, ""), "must be from 0 to 1"),
    ],
)
def test_what_does_not_fit_is_refused(call, text):
    with pytest.raises(ValueError, match=text):
        call()


def test_one_number_alone_is_read_on_its_colour():
    figure = map_of_figures([[[21.0]]], Sides(x=[""], y=[""], panels=[""]), "one")
    (panel,) = figure.axes
    (number,) = panel.texts
    (picture,) = panel.images
    behind = picture.to_rgba(np.array([[21.0]]))[0, 0, :3]
    assert number.get_text() == "21" and abs(np.mean(to_rgb(number.get_color())) - behind.mean()) > 0.5

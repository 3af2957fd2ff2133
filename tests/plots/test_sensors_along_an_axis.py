"""Names along an axis stand everywhere as they were swept, and what a refusal suggests works."""

import re
import shlex

import pytest

import etendue
from etendue.errors import RequestError
from etendue.present.page.opened import Opened
from etendue.present.plots.holdings import Holdings
from etendue.present.plots.kinds import PlotRequest, draw, listed
from etendue.present.plots.opening import opened
from etendue.present.plots.places import read_at

SENSORS = [
    "sony-imx363",
    "sony-imx174",
    "paper-ccd",
]  # neither the order of their names nor that of the sizes of their pictures
PIPELINE = """
name = "several"
seed = 1
[camera]
focal_length = "6 mm"
integration_time = "4 ms"
[[stages]]
use = "uniform"
name = "scene"
white_luminance = "500 cd m-2"
width = "70 um"
height = "70 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "pixel"
[[stages]]
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "adc"
[[stages]]
use = "exposure_report"
[sweep]
sensor = ["sony-imx363", "sony-imx174", "paper-ccd"]
f_number = [2, 4]
"""


@pytest.fixture(scope="module")
def several(tmp_path_factory):
    folder = tmp_path_factory.mktemp("several") / "several"
    etendue.simulate(PIPELINE, archive=folder)
    return folder


@pytest.fixture(scope="module")
def drawable(several):
    return Holdings(opened(several))


def test_sensors_stand_in_one_order_the_axis_own(drawable, several):
    raw = drawable.find("raw")
    assert (
        len(raw.groups) == 3 and [str(group["sensor"].values[0]) for group in raw.groups] != SENSORS
    )  # by the names of their shapes
    assert listed(drawable)["axes"]["sensor"] == SENSORS == raw.values_of("sensor")
    assert [row[0] for row in draw(drawable, "strip", PlotRequest(("raw",), at={"f_number": 2})).rows] == SENSORS
    mapped = draw(drawable, "map", PlotRequest(("mean_snr",)))
    column = mapped.columns.index("sensor")
    assert list(dict.fromkeys(row[column] for row in mapped.rows)) == SENSORS
    assert list(Opened(several).axis("sensor").values) == SENSORS


def test_without_a_ledger_the_order_is_that_of_a_group_that_has_them_all(several):
    tree = opened(several).drop_nodes("ledger")
    assert Holdings(tree).axes["sensor"] == SENSORS == Holdings(tree).find("raw").values_of("sensor")


def test_what_a_refusal_of_pictures_of_several_sizes_suggests_is_drawn(drawable):
    with pytest.raises(RequestError, match="several sizes") as refused:
        draw(drawable, "show", PlotRequest(("raw",)))
    words = shlex.split(re.search(r"with ((?:--at \S+ ?)+)", str(refused.value)).group(1))
    at = read_at(words[1::2])
    assert set(at) == {"sensor", "f_number"}
    (size,) = draw(drawable, "show", PlotRequest(("raw",), at=at)).rows
    variable, *others = shlex.split(re.search(r"strip (.*)$", str(refused.value)).group(1))
    rows = draw(drawable, "strip", PlotRequest((variable,), at=read_at(others[1::2]))).rows
    assert [row[0] for row in rows] == SENSORS and rows[0][2:] == size


def test_a_unit_stands_once_and_numbers_clear_of_the_frame(tree):
    figure = tree.etendue.plot.pareto("effective_lp_mm", "mean_snr").figure
    (axes,) = [one for one in figure.axes if one.get_xlabel()]
    assert axes.get_xlabel().count("cycles/mm") == 1 and "per mm" not in axes.get_xlabel()
    figure.canvas.draw()
    frame = axes.get_window_extent()
    boxes = [text.get_window_extent() for text in axes.texts]
    assert boxes and all(b.x0 > frame.x0 and b.x1 < frame.x1 and b.y0 > frame.y0 and b.y1 < frame.y1 for b in boxes)

"""One variable of one cell is one picture, to the last bit: on the contact sheet, in a plot, in the report, in the
viewer and in a notebook.

Every kind of ``shown``: light, planes of a camera and of tristimulus values, mosaics, one plane, encoded values, a map
whose distribution is not installed where it is drawn, and what nobody says anything of. Under A and D65, swept and not.
"""

import base64
import io
import json
import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import xarray
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from etendue.present.page.live import Live
from etendue.present.page.looks import Picture, picture, pictured
from etendue.present.page.opened import Opened
from etendue.present.page.shots import shots
from etendue.present.plots import pictures
from etendue.present.plots.drawing.strip import picture_of, show, white_of
from etendue.present.plots.holdings import Holdings
from etendue.present.plots.opening import opened as tree_of
from etendue.present.plots.summary.contents import _pictures as small_pictures
from tests.fresh import process

SITE = Path(__file__).parents[1] / "plugins" / "halation"  # brings `halo`, a map from 0 to 20 percent
STAGES = """irradiance halation pixel mosaic defects exposure shot_noise adc linearise white balance_mosaic
demosaic_bilinear colour_fit camera_to_xyz balance display encode"""


def pipeline(camera, sweep="", target="D65", size=(12, 18), chart="colorchecker", window="", frames=""):
    words = {
        "pixel": f"rows = {size[0]}\ncolumns = {size[1]}\n{window}",
        "defects": "hot = 0.02\n",
        "balance": f'target = "{target}"\n',
    }
    scene = (
        f'use = "{chart}"\nname = "scene"\nwidth = "{size[1] * 6 + 24} um"\nheight = "{size[0] * 6 + 24} '
        f'um"\nspacing = "2 um"\n'
    )
    scene += (
        'white_luminance = "1000 cd m-2"\nwavelength_from = "400 nm"\nwavelength_to = "700 nm"\nbin_width = "50 nm"\n'
    )
    uses = (
        STAGES.replace("exposure", "bracket exposure").replace("colour_fit", "merge_frames colour_fit")
        if frames
        else STAGES
    )
    words["bracket"] = frames
    stages = "".join(f'[[stages]]\nuse = "{use}"\n{words.get(use, "")}' for use in uses.split())
    own = (
        'focal_length = "6.93 mm"\npixel_pitch = "6 um"\npeak_qe = [0.36, 0.44, 0.40]\nintegration_time = "20 '
        'ms"\nf_number = 2.8\n'
    )
    return f'name = "agrees"\nseed = 1\n[camera]\n{own}{camera}\n[[stages]]\n{scene}{stages}\n[sweep]\n{sweep}\n'


SENSORS = (
    'sensor = [{label = "a", pattern = "GBRG", black_level = 0}, {label = "b", pattern = "RGGB", black_level = 200}]'
)
PIPELINES = {
    "A": pipeline('illuminant = "A"', target="A", frames="brackets = [-3, 0, 3]\n"),
    "D65 and A": pipeline("", sweep='illuminant = ["A", "D65"]\n"balance.target" = ["A", "D65"]'),
    "sensors": pipeline('illuminant = "A"', sweep=f'{SENSORS}\n"pixel.first_row" = [2, 3]', window="window_rows = 9\n"),
    "large": pipeline('illuminant = "A"', target="A", size=(258, 20), chart="slanted_edge"),
}
RUN = """
import sys, etendue
for name in sys.argv[1:]:
    etendue.simulate(f"{name}.toml", archive=name)
"""


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    """Made where the map's distribution is installed, and drawn where it is not."""
    folder = tmp_path_factory.mktemp("agrees")
    for name, text in PIPELINES.items():
        (folder / f"{name}.toml").write_text(text)
    done = process(*PIPELINES, code=RUN, cwd=folder, env={**os.environ, "PYTHONPATH": str(SITE)})
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module", params=PIPELINES)
def archive(request, archives):
    return archives / request.param


@cache
def loaded(archive):
    return tree_of(archive).load()


@cache
def served(archive):
    return Live(archive)


def of_sheet(archive, at):
    """(stage, variable): pixels, as a run has left them."""
    frames = xarray.open_dataset(archive / "data.zarr", engine="zarr", group="frames")
    columns = [frames[name].values for name in ("stage", "variable", "preview", "height", "width")]
    for stage, variable, preview, high, wide in zip(*columns, strict=True):
        yield (stage.removesuffix(f".{variable}"), variable), np.moveaxis(preview[:, :high, :wide], 0, -1)


def of_report(archive, at):
    opened = served(archive).opened
    for one in shots(opened, {axis.dim: axis.places[at[axis.dim]] for axis in opened.axes}, 10**9)["strip"]:
        assert one["how"] == "lossless"
        with Image.open(io.BytesIO(base64.b64decode(one["data"]))) as picture:
            yield (one["stage"], one["variable"]), np.asarray(picture.convert("RGB"))


def of_notebook(archive, at):
    """As a tree without the pictures of its run shows itself."""
    for one in small_pictures(Holdings(loaded(archive).drop_nodes("frames")), at):
        yield (one.stage, one.variable), one.picture


def of_viewer(archive, at):
    live = served(archive)
    where = ",".join(f"{axis.dim}:{axis.places[at[axis.dim]]}" for axis in live.opened.axes)
    for stage, variable in pictured(live.opened):
        _, data, said = live.answers["picture"]({"stage": stage, "variable": variable, "at": where})
        size = json.loads(said["X-Picture"])
        pixels = np.frombuffer(data, np.uint8).reshape(size["height"], size["width"], 4)
        yield (stage, variable), pixels[..., :3]


def of_plot(archive, at):
    holdings = Holdings(loaded(archive))
    for one in holdings.of_kind("picture"):
        plot = show(holdings, one.variable, one.stage, {dim: at[dim] for dim in one.axes})
        yield (one.stage, one.variable), np.asarray(plot.figure.axes[-1].images[0].get_array())


def made_small(archive, at):
    """What plots and viewer show at full size."""
    holdings = Holdings(loaded(archive))
    for one in holdings.of_kind("picture"):
        place = {dim: at[dim] for dim in one.axes}
        white = white_of(holdings, one, place)
        yield (one.stage, one.variable), pictures.drawn(picture_of(one, place)[0], white, small=True)


def cells(archive):
    """Places on the axes: the one that is on the sheet, the first and the last."""
    axes = served(archive).opened.axes
    frames = xarray.open_dataset(archive / "data.zarr", engine="zarr", group="frames")
    on_sheet = {str(dim): value for dim, value in frames.attrs["cell"].items()}
    ends = ({axis.dim: axis.values[i] for axis in axes} for i in (0, -1))
    return [on_sheet, *(at for at in ends if at != on_sheet)]


def test_everybody_draws_the_same(archive):
    for number, at in enumerate(cells(archive)):
        full, small = dict(of_plot(archive, at)), dict(made_small(archive, at))
        assert {stage for stage, _ in full} >= {"scene", "halation", "pixel", "defects", "adc", "balance", "encode"}
        places = {of_viewer: full, of_report: small, of_notebook: small} | ({} if number else {of_sheet: small})
        for place, expected in places.items():
            found = dict(place(archive, at))
            assert len(found) >= 15 and found.keys() <= full.keys(), place.__name__
            wrong = [which for which, pixels in found.items() if not np.array_equal(pixels, expected[which])]
            assert not wrong, (place.__name__, at, wrong)
        for which, pixels in full.items():
            assert max(pixels.shape) > 256 or np.array_equal(pixels, small[which]), which


def test_a_grey_edge_under_a_is_seen_as_its_viewer_sees_it(archives):
    """Adapted to A it is grey; beside the white of a display it is orange."""
    mean = picture(Opened(archives / "large"), "balance", "xyz_scene", {}).eight_bit().reshape(-1, 3).mean(axis=0)
    assert mean.max() / mean.min() < 1.05


def test_a_swept_sensor_is_seen_through_its_own_filters_from_the_first_row_that_is_read(archives):
    opened = Opened(archives / "sensors")
    corners = [
        "".join(picture(opened, "adc", "raw", {"sensor": sensor, "pixel_first_row": row}).filter_letters()[0, :2])
        for sensor in (0, 1)
        for row in (0, 1)
    ]
    assert corners == ["GB", "RG", "RG", "GB"]  # of GBRG from rows 2 and 3, of RGGB
    frames = xarray.open_dataset(archives / "sensors" / "data.zarr", engine="zarr", group="frames")
    assert np.ptp(frames.preview.sel(stage="adc").values.astype(int), axis=0).max() > 100


def test_a_merger_of_frames_is_as_bright_as_one_of_them(archives):
    """Its values are of the longest exposure: drawn at the brightness of the frame in the middle it is three stops
    dark.
    """
    opened = Opened(archives / "A")
    middle, merged = (
        picture(opened, stage, "rgb_camera", {}).eight_bit().mean() for stage in ("demosaic_bilinear", "merge_frames")
    )
    assert (
        merged / middle > 0.6
    )  # a share of 1/8 in light is 0.39 in bytes; the frame is overexposed where its merger is not


@given(st.integers(0, 3), st.integers(0, 4), st.floats(-0.499, 0.499), st.floats(-0.499, 0.499))
def test_a_place_belongs_to_the_sample_whose_middle_is_nearest(row, column, down, right):
    """Samples reach half a step to either side of where their coordinates stand; beyond the outermost there is none."""
    origin, step = (-4.0, 20.0), (2.0, 3.0)
    shown = Picture(None, None, "light", {}, np.zeros((3, 4, 5)), origin, step, True)
    place = [at + one * (n + off) for at, one, n, off in zip(origin, step, (row, column), (down, right), strict=True)]
    assert shown.sample(*place) == (row, column)
    assert shown.sample(place[0], 20.0 - 0.501 * 3.0) is None and shown.sample(place[0], 20.0 + 4.501 * 3.0) is None

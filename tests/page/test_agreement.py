"""One variable of one cell is one picture: on the contact sheet, in a plot, in the report and in the viewer.

Every kind of ``shown``: light, planes of a camera and of tristimulus values, mosaics, one plane, encoded values, a map
whose distribution is not installed where it is drawn, and what nobody says anything of. Under A and D65, swept and not.
"""

import base64
import io
import json
import os
from pathlib import Path

import numpy as np
import pytest
import xarray
from PIL import Image

from etendue.present.page.live import Live
from etendue.present.page.looks import picture, pictured
from etendue.present.page.opened import Opened
from etendue.present.page.shots import shots
from etendue.present.plots.drawing.strip import show
from etendue.present.plots.holdings import Holdings
from etendue.present.plots.opening import opened as tree_of
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


@pytest.fixture(
    scope="module", params=[pytest.param(one, marks=[] if one == "A" else [pytest.mark.long]) for one in PIPELINES]
)
def archive(request, archives):
    return archives / request.param


@pytest.fixture(scope="module")
def drawn(archive):
    """Bytes by who draws them, stage, variable and place: {("plot", "encode", "rgb_display", (("f_number", 2.8),)):
    (y, x, 3)}.
    """
    found = {}
    opened, live, holdings = Opened(archive), Live(archive), Holdings(tree_of(archive).load())
    frames = xarray.open_dataset(archive / "data.zarr", engine="zarr", group="frames")
    at = {str(dim): value for dim, value in frames.attrs["cell"].items()}
    start = {axis.dim: axis.places[at[axis.dim]] for axis in opened.axes}
    stages = [str(name) for name in frames.stage.values]
    for name, variable, preview, high, wide in zip(
        stages,
        frames.variable.values.tolist(),
        frames.preview.values,
        frames.height.values,
        frames.width.values,
        strict=True,
    ):
        own = opened.reaching(stage := name.removesuffix(f".{variable}"))
        place = tuple((dim, at[dim]) for dim in own)
        found["sheet", stage, variable, place] = np.moveaxis(preview[:, :high, :wide], 0, -1)
    for one in shots(opened, start)["strip"]:
        place = tuple((dim, at[dim]) for dim in opened.reaching(one["stage"]))
        with Image.open(io.BytesIO(base64.b64decode(one["data"]))) as picture:
            found["report", one["stage"], one["variable"], place] = np.asarray(picture.convert("RGB"))
    for stage, variable in pictured(opened):
        axes = [opened.axis(dim) for dim in opened.reaching(stage)]
        last = tuple(len(axis.values) - 1 for axis in axes)
        for index in {tuple(start[axis.dim] for axis in axes), tuple(0 for _ in last), last}:
            place = tuple((axis.dim, axis.values[i]) for axis, i in zip(axes, index, strict=True))
            where = ",".join(f"{axis.dim}:{i}" for axis, i in zip(axes, index, strict=True))
            _, data, said = live.answers["picture"]({"stage": stage, "variable": variable, "at": where})
            size = json.loads(said["X-Picture"])
            found["viewer", stage, variable, place] = np.frombuffer(data, np.uint8).reshape(
                size["height"], size["width"], 4
            )[..., :3]
            plot = show(holdings, variable, stage, dict(place))
            found["plot", stage, variable, place] = np.asarray(plot.figure.axes[-1].images[0].get_array())
    return found


def test_everybody_draws_the_same(drawn, archive):
    """To 1 of 255: sums of float32 in another order may fall on the other side of a half."""
    by_picture = {}
    for (who, *which), pixels in drawn.items():
        by_picture.setdefault(tuple(which), {})[who] = pixels.astype(int)
    far = {}
    for which, own in by_picture.items():
        assert {"plot", "viewer"} <= own.keys()
        for who, pixels in own.items():  # of a large array the sheet and the report show areas, the others samples
            other = own["plot"] if pixels.shape == own["plot"].shape else own["sheet"]
            far[(*which, who)] = int(np.abs(pixels - other).max())
    wrong = {which: one for which, one in far.items() if one > 1}
    assert not wrong, "\n".join(f"{one:4d} {which}" for which, one in wrong.items())
    assert {which[0] for which in by_picture} >= {"scene", "halation", "pixel", "defects", "adc", "balance", "encode"}
    assert sum(who == "sheet" for *_, who in far) == sum(who == "report" for *_, who in far) >= 15


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

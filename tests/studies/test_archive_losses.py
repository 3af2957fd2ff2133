"""The camera of an archive at one place of its sweep is the one whose cell stands there, whatever is swept."""

import json
import shlex

import pytest
import xarray
from click.testing import CliRunner

from etendue.cli.program import main
from etendue.contract.registry import installed_stages
from etendue.pipeline.file import parse_pipeline
from etendue.plan.planner import make_plan
from etendue.present.page.document import document
from etendue.present.page.opened import Opened
from etendue.present.page.report import report
from etendue.present.plots import kinds
from etendue.present.plots.holdings import Holdings
from etendue.present.plots.kinds import PlotRequest, draw
from etendue.present.plots.opening import opened
from etendue.session import Options, execute
from etendue_lab.losses import archived as archive_losses
from etendue_lab.losses.archived import camera_at, losses_at
from etendue_lab.losses.study import losses
from tests.page.conftest import embedded_document

PIPELINE = """
name = "blamed"
seed = 1
[camera]
focal_length = "6.93 mm"
peak_qe = [0.36, 0.44, 0.40]
pixel_pitch = "3 um"
[[stages]]
use = "colorchecker"
name = "scene"
white_luminance = "1000 cd m-2"
width = "192 um"
height = "192 um"
spacing = "1.5 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "diffraction"
[[stages]]
use = "pixel"
rows = 64
columns = 64
[[stages]]
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "adc"
[[stages]]
use = "linearise"
[[stages]]
use = "white"
[[stages]]
use = "demosaic_bilinear"
name = "demosaic"
[[stages]]
use = "sharpen"
[sweep]
f_number = [2, 8]
sharpen.strength = [0, 0.3]
demosaic.use = ["demosaic_bilinear", { use = "demosaic_colour_difference", label = "difference" }]
"""


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("blamed") / "blamed"
    execute(make_plan(parse_pipeline(PIPELINE), installed_stages()), folder, Options("serial"))
    return folder


def test_its_cells_have_the_keys_of_the_cells_that_stand_there(archive):
    ledger = xarray.open_dataset(archive / "data.zarr", engine="zarr", group="ledger").load()
    own = ledger.isel(cell=ledger.stage.values.astype(object) == "sharpen")
    assert own.sizes["cell"] == 8
    for row in range(8):
        one = own.isel(cell=row)
        at = {
            "f_number": float(one.at_f_number),
            "sharpen_strength": float(one.at_sharpen_strength),
            "demosaic": str(one.at_demosaic.values),
        }
        plan = make_plan(camera_at(archive, at), installed_stages())
        (cell,) = plan.of("sharpen")
        assert plan.cells[cell.ref].key == str(one.key.values)


@pytest.fixture(scope="module")
def swapped(tmp_path_factory):
    """A parameter that stands before the axis that chooses its stage, and which one of the two stages lacks."""
    text = PIPELINE.split("f_number = [2")[0]
    text += """
diffraction.obstruction = [0.1, 0.6]
diffraction.use = [
    "diffraction",
    { use = "wavefront", aperture = "annular", label = "annular" },
    { use = "wavefront", aperture = "annular", defocus = 0.1, label = "out of focus" },
]
"""
    folder = tmp_path_factory.mktemp("swapped") / "swapped"
    execute(
        make_plan(parse_pipeline(text.replace("[camera]", "[camera]\nf_number = 4")), installed_stages()),
        folder,
        Options("serial"),
    )
    return folder


@pytest.mark.long
def test_a_swept_parameter_before_the_axis_that_chooses_its_stage_stays(swapped):
    ledger = xarray.open_dataset(swapped / "data.zarr", engine="zarr", group="ledger").load()
    own = ledger.isel(cell=ledger.stage.values.astype(object) == "diffraction")
    assert len(set(own.key.values.tolist())) >= 5
    for row in range(own.sizes["cell"]):
        one = own.isel(cell=row)
        plan = make_plan(
            camera_at(
                swapped,
                {
                    "diffraction_obstruction": float(one.at_diffraction_obstruction),
                    "diffraction": str(one.at_diffraction.values),
                },
            ),
            installed_stages(),
        )
        (cell,) = plan.of("diffraction")
        assert plan.cells[cell.ref].key == str(one.key.values)


def test_losses_are_those_of_that_camera(archive):
    at = {"f_number": 8.0, "sharpen_strength": 0.3, "demosaic": "difference"}
    found = losses_at(archive, at, runs=0)
    alone = losses(camera_at(archive, at), installed_stages(), runs=0).document()
    assert [one["what"] for one in found["losses"]] == ["contrast", "SNR"] and found["why"] == ""
    assert [one["loss"] for one in found["losses"]] == [one["loss"] for one in alone["losses"]]
    other = losses_at(archive, {**at, "f_number": 2.0}, runs=0)
    assert other["losses"][0]["loss"] < found["losses"][0]["loss"]  # a wider aperture blurs less


def test_what_cannot_be_shared_out_says_why(tmp_path, archive):
    (tmp_path / "empty/data.zarr").mkdir(parents=True)
    assert "no record" in losses_at(tmp_path / "empty", {})["why"]


def test_a_report_and_a_budget_hold_what_was_shared_out_and_else_the_command(archive, tmp_path):
    asked = []

    def shares(folder, at):
        asked.append(at)
        return losses_at(folder, at, runs=0)

    report(archive, tmp_path / "with.html", shares)
    report(archive, tmp_path / "without.html")
    with_, without = (embedded_document((tmp_path / name).read_text()) for name in ("with.html", "without.html"))
    start = {axis.dim: axis.values[with_["start"][axis.dim]] for axis in Opened(archive).axes}
    assert asked == [start] and with_["blame"]["at"] == with_["start"]
    assert [one["what"] for one in with_["blame"]["losses"]] == ["contrast", "SNR"]
    assert without["blame"] is None and without["losses_command"] == ""  # a stage's label means nothing to --set
    plot = draw(Holdings(opened(archive)), "budget", PlotRequest(blame=losses_at(archive, start, runs=0)))
    owed = {row[0]: row[-2] for row in plot.rows if row[-2] is not None}
    assert owed == {one["stage"]: one["share"] for one in with_["blame"]["losses"][0]["stages"]}
    assert plot.columns[-2:] == ("contrast_share", "snr_share") and plot.data("svg").count(b"below 0") >= 1


def test_a_command_for_the_losses_is_offered_where_it_means_the_same_camera(archive):
    opened = Opened(archive)
    opened.axes = tuple(axis for axis in opened.axes if axis.dim != "demosaic")
    words = shlex.split(document(opened, {})["losses_command"])
    assert words[:3] == ["etendue", "losses", "blamed/runs/0001.toml"]
    assert [word.partition("=")[0] for word in words[4::2]] == ["camera.f_number", "sharpen.strength"]


def test_a_budget_is_blamed_where_the_report_begins_and_says_where(archive, tmp_path, monkeypatch):
    asked = []

    def shares(folder, at, told):
        asked.append(at)
        return {"losses": [], "notes": [], "why": "not asked for here"}

    monkeypatch.setattr(archive_losses, "losses_at", shares)
    monkeypatch.setattr(kinds, "shown_at", lambda holdings: {})  # of an archive without pictures
    done = CliRunner().invoke(
        main, ["plot", str(archive), "budget", "--blame", "-o", str(tmp_path / "budget.csv"), "--json"]
    )
    opened = Opened(archive)
    start = document(opened, {})["start"]
    assert asked == [{axis.dim: axis.values[start[axis.dim]] for axis in opened.axes}] and len(asked[0]) == 3
    assert json.loads(done.stdout)["notes"] == [
        "no losses at f/8, difference, sharpen strength 0.3: not asked for here"
    ]

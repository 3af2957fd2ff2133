"""Figures of a camera and the stages that change what they are about: each is in them, or is named beside them."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose

import etendue
from etendue.cli import main
from etendue.contract.registry import installed_stages
from etendue.present.page.document import document as page_of
from etendue.present.page.opened import Opened
from etendue.present.plots.holdings import Holdings
from etendue.session import load
from etendue_lab.compare.edge import ANGLE
from etendue_lab.information.edge_contrast import edge_contrast
from etendue_lab.information.fine_detail import fine_detail
from etendue_lab.losses.games import Contrast
from tests.run.small import assert_same_bits

CAMERA = {
    "f_number": 4.0,
    "focal_length": "8 mm",
    "integration_time": "6 ms",
    "illuminant": "D65",
    "pixel_pitch": 2.8,
    "peak_qe": [0.36, 0.44, 0.4],
    "full_well_density": "2000 electron um-2",
    "read_noise": 5.0,
    "dsnu": 1.0,
    "black_level": 64,
}
EDGE = {
    "use": "slanted_edge",
    "name": "scene",
    "white_luminance": 4000.0,
    "width": 320.0,
    "height": 320.0,
    "spacing": 0.5,
    "wavelength_from": 400.0,
    "wavelength_to": 700.0,
    "bin_width": 50.0,
}
FLAT = {
    "use": "uniform",
    "name": "scene",
    **{key: EDGE[key] for key in ("white_luminance", "wavelength_from", "wavelength_to", "bin_width")},
}
MODELS = ("per_plane", "through_filter")


def used(*names, **changed):
    return [{"use": name, **changed.get(name, {})} for name in names]


def pipeline(stages, **camera):
    return {"name": "seen", "seed": 1, "tolerance": 0, "camera": {**CAMERA, **camera}, "stages": stages}


# -- resolution: the charge that wanders, and the light -----------------------------------------------------------


def planes(scene=EDGE, before=(), rows=110, **camera):
    """The headline and the edge of full planes, in front of the mosaic, cycles/um."""
    stages = [
        scene,
        *used("irradiance"),
        *before,
        *used(
            "diffraction", "diffusion", "pixel", "crosstalk_planes", "no_mask", pixel={"rows": rows, "columns": rows}
        ),
        {"use": "resolution", "rendering": True, "angle": -5.0},
        {"use": "edge_resolution"},
    ]
    tree = etendue.simulate(pipeline(stages, **camera), leave_out=False)
    edge = tree["edge_resolution"].edge_mtf50.sel(stage="crosstalk_planes")
    return float(tree["resolution"].mtf50.sel(stage="pixel")), float(edge), tree


@pytest.mark.parametrize("pitch", [1.1, 2.8, 5.4])
@pytest.mark.parametrize("crosstalk", MODELS)
def test_mtf50_is_that_of_a_grey_edge_in_full_planes(crosstalk, pitch):
    """Behind the filters or in front of them. What is left is the chart's mirror image beyond a narrow frame: 0.4 %."""
    rows = min(110, int(300 / pitch))
    said, measured, tree = planes(rows=rows, crosstalk=crosstalk, pixel_pitch=pitch)
    assert_allclose(said, measured, rtol=0.01)
    if crosstalk == "through_filter":
        rendered = tree["edge_resolution"].edge_analytic
        assert_allclose(rendered.sel(stage="crosstalk_planes"), measured, rtol=0.01)
        assert rendered.sel(stage="pixel") > 1.05 * rendered.sel(
            stage="crosstalk_planes"
        )  # that picture is in front of it
        assert tree["resolution"].resolution_gain.sel(factor="diffusion") > 1.05


@pytest.mark.parametrize(
    "before", [(), ({"use": "optical_filter", "cut_off": 560.0},)], ids=["lamp", "lamp and filter"]
)
def test_mtf50_is_under_the_light_of_the_scene_behind_its_filters(before):
    """Under light that is equally strong in all bands it is 6.6 % off in the light of a lamp, and 7 % behind a
    short-pass.
    """
    said, measured, _ = planes(before=before, illuminant="A", crosstalk="through_filter")
    assert_allclose(said, measured, rtol=0.01)


def test_where_charge_stays_in_its_plane_a_stage_of_crosstalk_changes_no_bit():
    stages = [
        EDGE,
        *used(
            "irradiance",
            "diffraction",
            "diffusion",
            "pixel",
            "mosaic",
            "crosstalk",
            "resolution",
            pixel={"rows": 32, "columns": 32},
        ),
    ]
    with_it, without = (
        etendue.simulate(
            pipeline([s for s in stages if s["use"] != left_out], crosstalk="per_plane"), want=["resolution.mtf"]
        )
        for left_out in ("", "crosstalk")
    )
    assert list(with_it["resolution"].stage.values) == ["diffraction", "diffusion", "pixel"]
    assert_same_bits(with_it["resolution"].mtf.values, without["resolution"].mtf.values)


# -- information ------------------------------------------------------------------------------------------------


def read_out(*more, scene=EDGE, size=64, **camera):
    stages = [
        scene,
        *used(
            "irradiance",
            "diffraction",
            "diffusion",
            "pixel",
            "mosaic",
            "crosstalk",
            "exposure",
            "shot_noise",
            "full_well",
            "read_noise",
            "line_pattern",
            "adc",
            "linearise",
            "demosaic_bilinear",
            pixel={"rows": size, "columns": size},
        ),
        *more,
    ]
    return pipeline(stages, **camera)


@pytest.fixture(scope="module")
def card():
    grey = FLAT | {"width": 520.0, "height": 520.0, "spacing": 1.0}
    return fine_detail(
        load(read_out(scene=grey, size=160, crosstalk="through_filter", full_well_density="2e4 electron um-2")),
        installed_stages(),
        0.18,
    )


def test_contrast_of_the_study_is_that_of_an_edge_on_the_mosaic(card):
    """Every channel's pixels, charge that wandered and all; of no crosstalk it would be 6 to 20 % more."""
    frequency, place = np.array([0.1, 0.2, 0.3]), (card.first.name, "mosaic_linear")
    white = float(np.max(list(card.signal().values()))) / card.full / 0.18
    found = edge_contrast(card, [place], white, frequency, installed_stages(), None)[place]
    turn = math.radians(ANGLE)
    fy, fx = math.sin(turn) * frequency, math.cos(turn) * frequency
    for channel in card.channels:
        said, without = (np.abs(np.diagonal(card.contrast(channel, fy, fx, names))) for names in ((), ("crosstalk",)))
        assert_allclose(found[channel], said, atol=0.01)
        assert np.all(without - said > 0.02)


def test_the_loss_of_contrast_is_shared_with_crosstalk(card):
    game = Contrast(card)
    assert {"diffusion", "pixel", "crosstalk"} <= set(game.players)
    everything = frozenset(game.players)
    assert game.loss(everything) > game.loss(everything - {"crosstalk"}) + 0.2  # dB
    assert game.loss(everything - {"diffusion"}) == game.loss(everything)  # charge wanders behind the filters


def test_information_counts_what_wanders_and_not_what_is_dark():
    """Less with crosstalk than without; a dark current adds noise and no signal, however strong it is."""
    found = {}
    for name, camera in (
        ("kept", {"crosstalk": "per_plane", "diffusion_depth": 1e-3}),
        ("moved", {"crosstalk": "through_filter"}),
        ("dark", {"crosstalk": "through_filter", "dark_current_density": 1e-6}),
    ):
        tree = etendue.simulate(
            read_out({"use": "detail_information"}, **camera), want=["information_capacity", "information_of_light"]
        )
        found[name] = tree["detail_information"]
    bits = {name: float(own.information_capacity[-1]) for name, own in found.items()}
    assert bits["dark"] < 0.95 * bits["moved"] < 0.95 * 0.98 * bits["kept"]
    assert_allclose(
        found["dark"].information_of_light, found["moved"].information_of_light, rtol=2e-3
    )  # PRNU and its spread


# -- noise --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "noise", [{"row_noise": 40.0}, {"row_pattern": 40.0}, {}], ids=["new rows", "fixed rows", "coarse codes"]
)
def test_mean_snr_is_that_of_an_even_field(noise):
    """Rows: the spread of 1500 is known to 2 %. Codes: of 31 electrons, under twice the noise; that of 18000 pixels
    is known to 0.5 %.
    """
    even = FLAT | {"width": 40.0, "height": 4300.0, "spacing": 4.0, "reflectance": 0.1, "white_luminance": 400.0}
    names = (
        "pixel",
        "mosaic",
        "exposure",
        "shot_noise",
        "full_well",
        "read_noise",
        "line_pattern",
        "adc",
        "exposure_report",
    )
    given = {
        "pixel": {"rows": 1500, "columns": 12},
        "exposure": {"prnu": 0.0, "dark_nonuniformity": 0.0},
        "line_pattern": noise,
    }
    black = 64 if noise else 2
    camera = {"pattern": "mono", "peak_qe": [0.4], "sensitivity": "flat", "black_level": black} | (
        {} if noise else {"bits": 9}
    )
    tree = etendue.simulate(pipeline([even, *used("irradiance", *names, **given)], **camera))
    raw = tree["adc"].raw.values.astype(float) - black
    assert_allclose(float(tree["exposure_report"].mean_snr), raw.mean() / raw.std(), rtol=0.06 if noise else 0.015)


def test_dynamic_range_and_snr_have_the_noise_of_rows():
    """sqrt(5^2 + 12^2) = 13: new rows count as read noise of 13 electrons, fixed ones as a DSNU."""
    figures = used("dynamic_range", "exposure_numbers")
    stages = [
        FLAT | {"width": 40.0, "height": 40.0},
        *used("irradiance", "pixel", "mosaic", "exposure", "shot_noise", "read_noise", "line_pattern", "adc"),
    ]

    def found(rows, **camera):
        lines = [s | rows if s["use"] == "line_pattern" else s for s in stages]
        tree = etendue.simulate(
            pipeline([*lines, *figures], **camera), want=["dr_elgamal", "dr_emva", "snr_18", "snr10_illuminance"]
        )
        return [
            float(tree[stage][name])
            for stage, name in (
                ("dynamic_range", "dr_elgamal"),
                ("dynamic_range", "dr_emva"),
                ("exposure_numbers", "snr_18"),
                ("exposure_numbers", "snr10_illuminance"),
            )
        ]

    assert_allclose(found({"row_noise": 12.0}), found({}, read_noise=13.0), rtol=1e-9)
    assert_allclose(found({"column_pattern": 12.0}), found({}, dsnu=math.hypot(1.0, 12.0)), rtol=1e-9)
    assert found({}) == found({"row_noise": 0.0})


# -- what cannot enter is named -----------------------------------------------------------------------------------

BEHIND = used("sharpen", "resolution", "dynamic_range", "exposure_report", "pixel_numbers")


@pytest.fixture(scope="module")
def marked(tmp_path_factory):
    folder = tmp_path_factory.mktemp("marked")
    etendue.simulate(read_out(*BEHIND, size=24), archive=folder / "kept")
    return folder / "kept"


def test_stages_behind_a_figure_are_named_in_archive_plot_and_report(marked):
    tree = etendue.open_archive(marked)
    held = Holdings(tree).held
    said = {f"{f['stage']}.{f['variable']}": f["label"] for f in page_of(Opened(marked), {})["figures"]}
    for stage, name in (
        ("resolution", "mtf50_lp_mm"),
        ("dynamic_range", "dr_elgamal"),
        ("exposure_report", "mean_snr"),
    ):
        assert tree[stage][name].attrs["not_in_it"] == "demosaic_bilinear, sharpen"
        assert held[stage, name].title.endswith(", without demosaic_bilinear, sharpen")
        assert said[f"{stage}.{name}"].endswith(", without demosaic_bilinear, sharpen")
    for stage, name in (
        ("resolution", "nyquist"),
        ("exposure_report", "clipped_fraction"),
        ("pixel_numbers", "full_well"),
    ):
        assert "not_in_it" not in tree[stage][name].attrs


def test_the_end_table_names_them_too(tmp_path):
    path, document = tmp_path / "seen.toml", read_out(*BEHIND, size=24)
    tables = [
        ("", {k: v for k, v in document.items() if not isinstance(v, dict | list)}),
        ("[camera]", document["camera"]),
    ]
    tables += [("[[stages]]", stage) for stage in document["stages"]]
    path.write_text(
        "\n".join(f"{head}\n" + "\n".join(f"{k} = {json.dumps(v)}" for k, v in table.items()) for head, table in tables)
    )
    words = ["run", str(path), "--archive", str(tmp_path / "kept"), "--quiet", "--no-errors"]
    said = " ".join(CliRunner().invoke(main, words).output.split())  # whatever the width of the terminal
    assert re.search(r"without the effect of demosaic_bilinear, sharpen: mtf50_lp_mm at pixel", said)

"""Studies ask stages what they are and say, not what they are called: other names change nothing, and third parties
are treated as ours.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from etendue.contract.registry import installed_stages
from etendue.pipeline.file import StageEntry, parse_pipeline
from etendue.plan.planner import make_plan
from etendue.session import Options, execute
from etendue_lab.compare.axis import AxisRequest
from etendue_lab.compare.compared import FIGURES
from etendue_lab.compare.study import compare
from etendue_lab.noise.study import noise
from etendue_lab.quality.study import quality
from tests.studies import strangers

CAMERA = """
name = "small"
seed = 3
precision = "float64"
[camera]
pixel_pitch = "4 um"
integration_time = "6 ms"
peak_qe = [0.36, 0.44, 0.40]
full_well_density = "2000 electron um-2"
crosstalk = "{crosstalk}"
[[stages]]
use = "{scene}"
name = "scene"
white_luminance = "800 cd m-2"
width = "400 um"
height = "400 um"
spacing = "2 um"
wavelength_from = "400 nm"
wavelength_to = "700 nm"
bin_width = "100 nm"
"""
SIZES = {"pixel": {"rows": 84, "columns": 80}, "lens_gaussian": {"sigma": "1.5 um"}, "lens_shading": {"strength": 0.5}}
LIGHT = ("irradiance", "falloff", "vignetting", "distortion", "lens_gaussian", "diffusion", "pixel", "mosaic")
READ_OUT = ("exposure", "shot_noise", "full_well", "read_noise", "line_pattern", "adc", "linearise")
COLOUR = ("colour_fit", "camera_to_xyz", "balance", "display", "encode")
MOSAIC = ("lens_shading", "white", "white_estimate", "balance_mosaic")
WHOLE = (*LIGHT, "crosstalk", "meter", *READ_OUT, *MOSAIC, "demosaic_bilinear", "sharpen", *COLOUR)
SERIAL = Options("serial")


def camera(stages=WHOLE, scene="slanted_edge", crosstalk="per_plane", **values):
    base = parse_pipeline(CAMERA.format(scene=scene, crosstalk=crosstalk))
    given = {**SIZES, **values}
    return replace(base, stages=(*base.stages, *(StageEntry(use, use, given.get(use, {}), {}, use) for use in stages)))


def rows(registry, pipeline, key, values, monkeypatch, expected=False, edges=False):
    monkeypatch.setattr("etendue_lab.compare.study.installed_stages", lambda: registry)
    found = compare(pipeline, AxisRequest(key, values), 1, expected, SERIAL, edges=edges)
    return {row.label.removeprefix(strangers.PREFIX): row for row in found.rows}, found


# -- other names --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("key", "values"), [("demosaic_bilinear.use", None), ("lens_shading.strength", (0.0, 0.5))])
def test_compare_finds_the_same_under_other_names(key, values, monkeypatch):
    pipeline = camera(crosstalk="through_filter")
    ours, one = rows(installed_stages(), pipeline, key, values, monkeypatch, edges=True)
    theirs, other = rows(strangers.Renamed(), strangers.renamed(pipeline), key, values, monkeypatch, edges=True)
    assert set(ours) == set(theirs)
    for label, row in ours.items():
        known = [name for name in FIGURES if "second" not in name]
        assert [getattr(row, name) for name in known] == [getattr(theirs[label], name) for name in known], label
    assert any(row.mtf50 for row in ours.values())
    assert (one.variable, one.reference, one.without) == (other.variable, other.reference, other.without)
    assert one.notes == [note.replace(strangers.PREFIX, "") for note in other.notes]


@pytest.mark.parametrize("crosstalk", ["per_plane", "through_filter"])
def test_quality_finds_the_same_under_other_names(crosstalk):
    pipeline = camera(crosstalk=crosstalk)
    ours, theirs = quality(pipeline, installed_stages()), quality(strangers.renamed(pipeline), strangers.Renamed())
    assert repr(ours.rows) == repr(theirs.rows)
    assert ours.ideal.left_out == theirs.ideal.left_out
    assert ours.notes == [note.replace(strangers.PREFIX, "") for note in theirs.notes]
    assert ours.rows[0]["status"] == "done"


def test_noise_finds_the_same_under_other_names():
    pipeline = camera()
    ours = noise(pipeline, installed_stages(), frames=1).document()
    theirs = noise(strangers.renamed(pipeline), strangers.Renamed(), frames=1).document()
    assert repr(ours) == repr(theirs).replace(strangers.PREFIX, "")
    assert ours["mosaic"][0]["predicted"]


def test_what_is_resolved_is_the_same_under_other_names():
    pipeline = camera(
        (*LIGHT[:3], *LIGHT[4:], *READ_OUT, "demosaic_bilinear", "white", *COLOUR, "resolution", "edge_resolution")
    )
    arrays = []
    for one, registry in ((pipeline, installed_stages()), (strangers.renamed(pipeline), strangers.Renamed())):
        outcome = execute(make_plan(replace(one, wanted=("resolution", "edge_resolution")), registry), None, SERIAL)
        arrays.append(
            {(ref, v): a for ref, found in outcome.arrays.items() if "resolution" in ref[0] for v, a in found.items()}
        )
    assert arrays[0].keys() == arrays[1].keys()
    for where, array in arrays[0].items():
        assert_array_equal(array, arrays[1][where])
    assert np.isfinite(arrays[0][("resolution", ()), "mtf50"]).all()


# -- third parties ------------------------------------------------------------------------------------------------


PLAIN = (
    "irradiance",
    "soft_lens",
    "window",
    "pixel",
    "mosaic",
    "exposure",
    "shot_noise",
    "reset",
    "adc",
    "linearise",
    "flatten",
    "quads",
    "white",
    *COLOUR,
)


def test_their_correction_is_made_to_the_reference_too(monkeypatch):
    found, result = rows(
        strangers.registry(),
        camera(PLAIN, "uniform"),
        "quads.use",
        ("quads", "demosaic_bilinear"),
        monkeypatch,
        expected=True,
    )
    assert (
        min(row.psnr for row in found.values()) > 200
    )  # of even light every interpolation is right, where both are flattened
    assert not any("omits" in note for note in result.notes)
    only = tuple("bayer_only" if use == "flatten" else use for use in PLAIN)
    found, result = rows(
        strangers.registry(), camera(only, "uniform"), "quads.use", ("quads",), monkeypatch, expected=True
    )
    assert found["quads"].psnr < 60
    assert any("omits bayer_only, which cannot be run plane by plane: knows RGGB only" in note for note in result.notes)


def test_their_demosaicer_is_offered_beside_ours(monkeypatch):
    found, _ = rows(strangers.registry(), camera(PLAIN), "quads.use", None, monkeypatch)
    assert {"quads", "demosaic_bilinear"} <= set(found) and "no_demosaicing" not in found
    assert found["demosaic_bilinear"].psnr > found["quads"].psnr


def test_their_noise_is_predicted_from_what_it_says():
    report = noise(camera(PLAIN), strangers.registry(), frames=2)
    for channel, (predicted, found, error) in report.mosaic.items():
        assert abs(found - predicted) < 4 * error + 0.003 * predicted, channel
    for row in report.rows:
        assert np.all(
            np.abs(np.subtract(row.found, row.predicted))
            < 4 * np.array(row.found_error) + 0.01 * np.array(row.predicted)
        )
    secretive = tuple("secretive" if use == "reset" else use for use in PLAIN)
    report = noise(camera(secretive), strangers.registry(), frames=1)
    assert all(predicted is None for predicted, _, _ in report.mosaic.values())
    assert any("secretive draws random numbers but does not declare its noise" in note for note in report.notes)


def test_their_lens_is_none_of_the_ideal_camera_and_their_window_is():
    found = quality(camera(PLAIN), strangers.registry())
    assert found.ideal.left_out == ("soft_lens",)
    assert not any("treated as part of the lens" in note for note in found.notes)
    plain = {"flatten": {"gain_of_green": 1.0}, "reset": {"sigma": 1.0}}
    soft, sharp = (
        quality(camera(PLAIN, soft_lens={"reach": reach}, **plain), strangers.registry()).rows[0] for reach in (6, 0)
    )
    assert sharp["psnr_linear"] > soft["psnr_linear"] + 1


def test_the_ideal_camera_is_corrected_as_theirs_is():
    flat, coloured = (
        quality(camera(PLAIN, flatten={"gain_of_green": gain}), strangers.registry()).rows[0] for gain in (1.0, 1.25)
    )
    assert abs(flat["psnr_linear"] - coloured["psnr_linear"]) < 1
    assert flat["psnr_linear"] > 20


def test_frames_of_a_bracket_have_planes_of_their_own(monkeypatch):
    """The reference's ideal exposure has a value for each frame and each channel: they are merged as the camera's
    are.
    """
    both = ("demosaic_bilinear", "demosaic_nearest")
    read_out = ("bracket", "exposure", "shot_noise", "full_well", "adc", "linearise")
    stages = ("irradiance", "lens_gaussian", "pixel", "mosaic", *read_out, "white", both[0], "merge_frames", *COLOUR)
    found, _ = rows(installed_stages(), camera(stages), f"{both[0]}.use", both, monkeypatch)
    assert found["demosaic_bilinear"].psnr > found["demosaic_nearest"].psnr > 15
    assert quality(camera(stages), installed_stages()).rows[0]["psnr_linear"] > 15

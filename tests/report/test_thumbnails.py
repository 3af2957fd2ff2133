"""Pictures are exact area averages, reduced where they are made, and the same wherever that is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from etendue.contract.registry import installed_stages
from etendue.plan.planner import make_plan
from etendue.present.pictures import details, pictures, thumbnails
from etendue.present.pictures.fitting import as_float, fitted, tinted
from etendue.present.pictures.thumbnails import Thumbnail
from etendue.session import Options, execute, from_document
from etendue.transfer.resampling import area_weights
from etendue_camera.sensor import cfa

# float32 sums of a few hundred values in [0, 1], in another order
ROUNDING = 2e-6


def averaged(picture):
    """By the matrices of area weights themselves, in float64."""
    y, x = picture.shape[-2:]
    scale = min(1.0, 256 / max(y, x))
    return area_weights(y, max(1, round(y * scale))) @ picture @ area_weights(x, max(1, round(x * scale))).T


@given(y=st.integers(1, 700), x=st.integers(1, 700), planes=st.sampled_from([(), (3,)]), seed=st.integers(0, 9))
@settings(max_examples=25, deadline=None)
def test_a_picture_is_fitted_by_exact_area_averages(y, x, planes, seed):
    picture = np.random.default_rng(seed).random((*planes, y, x))
    found = fitted(picture)
    assert max(found.shape[-2:]) <= 256 or max(y, x) <= 256
    np.testing.assert_allclose(found, averaged(picture), atol=ROUNDING)


@given(y=st.integers(1, 600), x=st.integers(1, 600), period=st.sampled_from([(1, 1), (2, 2), (4, 2), (6, 6)]))
@settings(max_examples=25, deadline=None)
def test_a_mosaic_is_fitted_as_its_three_colours_are(y, x, period):
    rng = np.random.default_rng(y + x)
    plane, tints = rng.random((y, x)), rng.random((*period, 3)).astype(np.float32)
    colours = np.moveaxis(tints[np.arange(y) % period[0]][:, np.arange(x) % period[1]], -1, 0)
    np.testing.assert_allclose(tinted(plane, tints, as_float), averaged(colours * plane), atol=ROUNDING)


@pytest.mark.parametrize("pattern", ["RGGB", "X-Trans"])
def test_the_colours_of_a_window_of_a_mosaic_are_those_of_its_pixels(pattern):
    mask = cfa.read(pattern)
    tints = np.array([cfa.tint(channel) for channel in mask.channels])
    period = tints[cfa.channel_index(mask, *mask.period, 3, 1)]
    whole = np.moveaxis(tints[cfa.channel_index(mask, 9, 13, 3, 1)], -1, 0)
    np.testing.assert_allclose(tinted(np.ones((9, 13)), period, as_float), whole)


PIPELINE = {
    "name": "shown",
    "camera": {
        "f_number": 4,
        "pixel_pitch": 3,
        "peak_qe": [0.5, 0.5, 0.5],
        "pattern": "RGGB",
        "integration_time": 0.01,
    },
    "keep": ["mosaic", "shot_noise"],
    "stages": [
        {
            "use": "slanted_edge",
            "name": "scene",
            "width": 900,
            "height": 840,
            "spacing": 3,
            "white_luminance": 100,
            "bin_width": 100,
        },
        {"use": "irradiance"},
        {"use": "pixel"},
        {"use": "mosaic"},
        {"use": "exposure"},
        {"use": "shot_noise"},
    ],
}


def plan_of(**words):
    return make_plan(from_document({**PIPELINE, **words}), installed_stages())


@pytest.mark.parametrize("scheduler", ["serial", "processes"])
def test_what_a_run_hands_on_of_the_shown_cells_is_small_and_the_pictures_are_those_of_a_run_in_memory(
    tmp_path, scheduler
):
    import xarray

    outcome = execute(plan_of(), tmp_path / "kept", Options(scheduler, 1))
    assert not outcome.failed
    assert not any(
        isinstance(a, Thumbnail) or np.size(a) > 16 for found in outcome.arrays.values() for a in found.values()
    )
    stored = xarray.open_datatree(tmp_path / "kept" / "data.zarr", engine="zarr")["frames"].preview
    in_memory = execute(plan_of(), None, Options("serial")).tree["frames"].preview
    assert stored.sizes["stage"] > 4
    assert np.array_equal(stored.values, in_memory.values)


def test_pictures_of_stored_cells_are_those_of_fresh_ones(tmp_path):
    import xarray

    execute(plan_of(keep=None), tmp_path / "a", Options("serial"))
    first = xarray.open_datatree(tmp_path / "a" / "data.zarr", engine="zarr")["frames"].preview.values
    (tmp_path / "a" / "contact_sheet.png").unlink()
    for part in (tmp_path / "a" / "data.zarr" / "frames").rglob("zarr.json"):
        part.unlink()
    outcome = execute(plan_of(keep=None), tmp_path / "a", Options("serial"))
    assert outcome.computed == 0 and (tmp_path / "a" / "contact_sheet.png").is_file()
    again = xarray.open_datatree(tmp_path / "a" / "data.zarr", engine="zarr")["frames"].preview.values
    assert np.array_equal(first, again)


@pytest.mark.parametrize("rows", [24, 280])
def test_every_picture_has_its_part_whichever_others_are_missing(rows, monkeypatch):
    """Cells fail, or were computed by a run before: rows that are kept of a picture do not depend on it."""
    monkeypatch.setattr(details, "BAND", 1)  # of a large one few
    document = {
        "name": "partly",
        "camera": {"pixel_pitch": 3, "f_number": 4, "peak_qe": [0.5, 0.5, 0.5]},
        "stages": [
            {
                "use": "slanted_edge",
                "name": "scene",
                "width": 3 * rows,
                "height": 3 * rows + 600,
                "spacing": 2,
                "white_luminance": 100,
                "bin_width": 200,
            },
            {"use": "irradiance"},
            {"use": "pixel", "rows": rows - 4, "columns": rows - 4},
        ],
        "keep": ["radiance", "irradiance", "photon_rate"],
    }
    plan = make_plan(from_document(document), installed_stages())
    shown = {cell.node: cell.ref for cell in plan.cells.values()}
    random, small = np.random.default_rng(3), {}
    for ref, look in thumbnails.looks(plan, shown.values()).items():
        grids = {v: plan.cells[ref].grids[v].shape(declared.dims) for v, declared in plan.node(ref[0]).writes.items()}
        small[ref] = thumbnails.only(
            {v: view.of(random.random(grids[v], np.float32)) for v, view in look.views.items()}
        )
    for missing in ((), *((ref,) for ref in small)):
        frames = pictures.render(plan, shown, {ref: own for ref, own in small.items() if ref not in missing})
        assert len(frames) == 3 - len(missing) and all(frame.part is not None and frame.part.size for frame in frames)

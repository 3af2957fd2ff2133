"""Bands without any light are not computed: they are zero, and everything else is as if they had been."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from etendue.compute import bands
from etendue.compute.joined import segment_bands, segments
from etendue.contract.registry import installed_stages
from etendue.plan.planner import make_plan
from etendue.session import Options, collect, load
from tests.plan.given import CAMERA, SCENE, SENSOR

NARROW = SCENE.replace('"100 nm"', '"20 nm"')
TEXT = CAMERA + NARROW.format(scene="siemens_star") + SENSOR


def arrays_of(text, light, **given):
    settings = {"camera.illuminant": light, "precision": "float64", **given}
    plan = make_plan(load(text, settings), installed_stages(), leave_out_allowed=False)
    wanted = {cell.ref: set(cell.grids) for cell in plan.cells.values() if cell.grids}
    found = collect(plan, wanted, Options("serial", pictures=False))
    assert not any(report.status == "failed" for report in found.reports.values())
    return {(ref[0], name): np.asarray(array) for ref, own in found.arrays.items() for name, array in own.items()}


@pytest.mark.parametrize("light", ["550 nm", "D65"])
@pytest.mark.parametrize("terms", [0, 4])
def test_dark_bands_left_out_change_nothing_but_rounding(monkeypatch, light, terms):
    own = arrays_of(TEXT, light, **{"pixel.wavelength_terms": terms})
    for place in (bands, segment_bands):
        monkeypatch.setattr(place, "is_dark", lambda plane: False)
    whole = arrays_of(TEXT, light, **{"pixel.wavelength_terms": terms})
    assert own.keys() == whole.keys()
    for name, array in own.items():
        assert array.shape == whole[name].shape, name
        if light == "D65":
            np.testing.assert_array_equal(array, whole[name])
        elif np.issubdtype(array.dtype, np.floating):
            assert_allclose(array, whole[name], rtol=0, atol=1e-12 * np.abs(whole[name]).max())


def test_under_a_line_every_band_is_stored_and_one_has_light():
    found = arrays_of(TEXT, "550 nm")
    for stage in ("scene", "irradiance", "falloff", "diffraction", "lens_gaussian", "diffusion"):
        light = found[stage, "radiance" if stage == "scene" else "irradiance"]
        assert light.shape[0] == 15
        assert [band for band in range(15) if light[band].any()] == [7]  # 540 to 560 nm


def test_a_line_transforms_one_band(monkeypatch):
    """What the lens transforms is the light itself, not fifteen bands of which fourteen are zero."""
    seen, transform = [], segments.sampling.transform
    monkeypatch.setattr(segments.sampling, "transform", lambda planes: seen.append(len(planes)) or transform(planes))
    arrays_of(TEXT, "550 nm")
    assert seen
    assert set(seen) == {1}


def test_lit_bands_reach_from_the_first_to_the_last_with_light():
    light = np.zeros((6, 3, 4))
    assert bands.lit_bands(light) == slice(0, 1)
    light[2, 0, 0] = 1.0
    assert bands.lit_bands(light) == slice(2, 3)
    light[4, 2, 3] = -1e-300
    assert bands.lit_bands(light) == slice(2, 5)
    assert bands.among_all(light[2:5], slice(2, 5), 6).tolist() == light.tolist()

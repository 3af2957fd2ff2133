"""Whole curves of resolution: closed forms, products, the figures that are read from them, and where they stand in a
sweep.
"""

import math

import numpy as np
import pytest
import xarray
from numpy.testing import assert_allclose
from scipy import special
from xarray.testing import assert_identical

import etendue
from etendue_camera.optics.stages.lens import Diffraction
from etendue_camera.resolution.edges.slanted_edge import slanted_edge
from etendue_camera.resolution.stages import curves
from etendue_camera.resolution.stages.analytic import FACTORS
from etendue_camera.resolution.stages.edge import EVERY_FACTOR
from etendue_camera.resolution.stages.edge_figures import FLAGS
from etendue_camera.sensor.stages.pixel import Diffusion
from tests.camera.test_resolution import WHITE, document, figures, pixel

NYQUIST = 32  # place of half a cycle a pixel among the frequencies


def test_a_lens_and_a_pixel_have_their_closed_forms():
    """2/pi (acos v - v sqrt(1 - v^2)) and |sinc|; where both stand the curve is their product."""
    pitch, unit = 4.0, 0.55 * 4.0
    found = figures(Diffraction(f_number=4.0), pixel(pitch, aperture_fraction=1.0), pixel_pitch=pitch)
    f = curves.PER_PIXEL / pitch
    v = np.minimum(f * unit, 1.0)
    lens, box = 2 / math.pi * (np.arccos(v) - v * np.sqrt(1 - v**2)), np.abs(np.sinc(curves.PER_PIXEL))
    assert_allclose(found["mtf"], [lens, lens * box], atol=1e-12)
    assert_allclose(found["factor_mtf"][[0, 2]], [lens, box], atol=1e-12)
    assert_allclose(found["factor_mtf"][1], 1.0, atol=1e-15)  # no stage of diffusion
    assert np.isnan(found["factor_mtf"][FACTORS.index("sampling")]).all()


@pytest.mark.parametrize("angle", [0.0, 17.0])
def test_of_one_wavelength_the_camera_is_the_product_of_its_factors(angle):
    found = figures(Diffraction(f_number=8.0), Diffusion(), pixel(3.0), pixel_pitch=3.0, angle=angle)
    assert_allclose(found["mtf"][-1], np.prod(found["factor_mtf"][:3], axis=0), atol=1e-12)


def test_the_figures_stand_on_the_curves():
    """At the Nyquist frequency they are equal; half contrast lies where a spline through the samples says, to its
    own error.
    """
    found = figures(Diffraction(f_number=5.6), Diffusion(), pixel(5.4), edges=WHITE, pixel_pitch=5.4)
    assert_allclose(found["mtf"][:, NYQUIST], found["mtf_nyquist"], rtol=1e-12)
    assert_allclose(found["frequency_lp_mm"][NYQUIST], found["nyquist_lp_mm"], rtol=1e-15)
    assert_allclose(found["nyquist_lp_mm"], 1e3 * found["nyquist"], rtol=1e-15)
    for mtf50, curve in zip(found["mtf50"] * 5.4, found["mtf"], strict=True):
        assert_allclose(np.interp(mtf50, curves.PER_PIXEL, curve), 0.5, atol=1e-3)


@pytest.mark.parametrize(("f_number", "bound"), [(1.4, 1e-3), (5.6, 1e-3), (32.0, 3.2e-2)])
def test_a_straight_line_between_samples_errs_by_what_is_stated(f_number, bound):
    """Pixels of 1.5 um: the cut-off of f/5.6 lies at 0.49 cycles/pixel; of f/32 all contrast is in the first six
    samples.
    """
    own = figures(Diffraction(f_number=f_number), pixel(1.5), pixel_pitch=1.5)["mtf"][-1]
    middle = figures(Diffraction(f_number=f_number), pixel(1.5), pixel_pitch=3.0)["mtf"][-1]  # at half the frequencies
    assert abs(middle[1::2] - 0.5 * (own[: NYQUIST + 1][:-1] + own[1 : NYQUIST + 1])).max() < bound


def test_a_camera_whose_contrast_ends_early_has_noughts_behind_it():
    """f/32 on pixels of 1 um: the cut-off is at 0.057 cycles/pixel."""
    found = figures(Diffraction(f_number=32.0), pixel(1.0), pixel_pitch=1.0)
    assert found["mtf"].min() >= 0
    assert (found["mtf"][:, 4:] < 1e-15).all()


@pytest.mark.parametrize(
    ("sigma", "tail", "finer", "bound"), [(3.0, 0.0, 8.0, 2e-5), (3.0, 0.1, 8.0, 2e-4), (12.0, 0.0, 8.0, 2e-3)]
)
def test_a_measured_response_is_carried_to_the_camera_s_frequencies(sigma, tail, finer, bound):
    """Against the same edge asked at 6401 frequencies; of light on a grid eight times as fine as the pixels."""
    y, x = np.mgrid[:200, :300] - np.array([99.5, 149.5])[:, None, None]
    away = x * math.cos(0.1) - y * math.sin(0.1)
    step = (1 - tail) * 0.5 * (1 + special.erf(away / sigma / math.sqrt(2))) + tail * (
        0.5 + np.arctan(away / 20) / math.pi
    )
    edge, fine = slanted_edge(0.1 + 0.8 * step), slanted_edge(0.1 + 0.8 * step, samples=6401)
    found = curves.of_edge(edge.frequency, edge.sfr, finer)
    assert_allclose(found, np.interp(curves.PER_PIXEL / finer, fine.frequency, fine.sfr), atol=bound)


def test_beyond_what_a_coarse_picture_sees_nothing_is_said():
    edge = np.linspace(0, 1, 201)
    found = curves.of_edge(edge, np.exp(-edge), 0.5)
    assert_allclose(found[: NYQUIST + 1], np.exp(-2 * curves.PER_PIXEL[: NYQUIST + 1]), rtol=1e-9)
    assert np.isnan(found[NYQUIST + 1 :]).all()


def test_a_measured_edge_has_the_curve_of_the_transfer_functions():
    """Below the Nyquist frequency within what the stage states of its figures, before the mosaic; and MTF50 lies on
    it.
    """
    found = etendue.simulate(document(("edge_resolution",)))["edge_resolution"].to_dataset()
    assert found.esfr.dims == ("stage", "frequency")
    below = found.sel(frequency=slice(0, 0.5))
    assert_allclose(below.esfr, below.esfr_analytic, atol=5e-3)
    for stage in found.stage.values:
        one = found.sel(stage=stage)
        assert_allclose(np.interp(one.edge_mtf50_cycles, one.frequency, one.esfr), 0.5, atol=1e-3)


def test_a_warp_and_a_picture_without_an_edge_have_no_curve():
    warped = etendue.simulate(document(("resolution",), middle=({"use": "distortion", "k1": 0.01},)))["resolution"]
    assert np.isnan(warped.mtf).all()
    assert np.isnan(warped.factor_mtf).all()
    even = document(("edge_resolution",), scene={"use": "uniform"})
    found = etendue.simulate(even)["edge_resolution"]
    assert (found.edge_flags == FLAGS["no_edge"]).all()
    assert np.isnan(found.esfr).all()
    assert np.isnan(found.esfr_analytic).all()
    assert not np.isnan(found.frequency_lp_mm).any()


def test_over_pixel_pitches_cycles_a_pixel_are_shared_and_cycles_a_mm_stand_beside(tmp_path):
    """In memory as in the archive, where CF's attribute makes them coordinates of the curves."""
    asked = document(("resolution", "edge_resolution"), {"pixel_pitch": [2.0, 4.0]}, rows=64, columns=64)
    asked["keep"] = ["resolution", "edge_resolution"]
    held = etendue.simulate(asked)
    etendue.simulate(asked, archive=tmp_path / "a")
    with xarray.open_datatree(tmp_path / "a" / "data.zarr", engine="zarr", chunks=None) as tree:
        for stage in ("resolution", "edge_resolution"):
            assert_identical(tree[stage].to_dataset().load(), held[stage].to_dataset())
    mtf = held["resolution"].mtf
    assert mtf.frequency_lp_mm.dims == ("pixel_pitch", "frequency")
    assert_allclose(
        mtf.frequency_lp_mm * mtf.pixel_pitch * 1e-3, np.broadcast_to(mtf.frequency, (2, curves.SAMPLES)), rtol=1e-12
    )
    assert_allclose(mtf.nyquist_lp_mm, [250.0, 125.0], rtol=1e-12)
    assert (mtf.frequency.units, mtf.frequency_lp_mm.units) == ("cycles/pixel", "cycles/mm")
    lens = mtf.sel(stage="lens").isel(frequency=slice(0, None, 2)).sel(pixel_pitch=4.0)  # the same places in cycles/mm
    assert_allclose(mtf.sel(stage="lens", pixel_pitch=2.0)[: NYQUIST + 1], lens, atol=1e-12)


def test_what_limits_carries_its_name(tmp_path):
    """CF's flags: the same in memory and in the archive, and one for every label of ``factor``; a NaN has none."""
    asked = document(("resolution", "edge_resolution"), rows=64, columns=64)
    asked["keep"] = ["resolution.limiting_factor", "edge_resolution"]  # without the dim beside it
    held = etendue.simulate(asked)
    etendue.simulate(asked, archive=tmp_path / "a")
    with xarray.open_datatree(tmp_path / "a" / "data.zarr", engine="zarr", chunks=None) as tree:
        for stage, factors in (("resolution", FACTORS), ("edge_resolution", EVERY_FACTOR)):
            attributes = tree[stage].limiting_factor.attrs
            assert attributes == held[stage].limiting_factor.attrs
            assert attributes["flag_meanings"].split() == list(factors)
            assert attributes["flag_values"] == list(range(len(factors)))
        flags = tree["edge_resolution"].edge_flags.attrs
        assert dict(zip(flags["flag_meanings"].split(), flags["flag_masks"], strict=True)) == FLAGS

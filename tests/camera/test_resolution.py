"""What a run resolves: the analytic probe against closed forms, the edge probe against the analytic one, and what
limits.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import special

import etendue
from etendue.api import Grid, Line
from etendue.compute.joined.otf import Otf
from etendue_camera.colour.encoding import bt709_encode, srgb_encode
from etendue_camera.optics.stages.lens import Diffraction
from etendue_camera.resolution import two_points
from etendue_camera.resolution.stages.analytic import FACTORS, Resolution
from etendue_camera.resolution.stages.edge import EVERY_FACTOR, EdgeProbe, _span
from etendue_camera.resolution.stages.edge_figures import FLAGS
from etendue_camera.resolution.stages.luminance import check_encoding, decoded
from etendue_camera.sensor import silicon
from etendue_camera.sensor.stages.pixel import Diffusion, Pixel
from tests.run.small import assert_same_bits

REFERENCE = Path(__file__).parents[1] / "data" / "physics_reference.json"
QE = (0.4, 0.5, 0.35)
NARROW = (549.5, 550.5)
WHITE = (400.0, 450.0, 500.0, 550.0, 600.0, 650.0, 700.0)


def transfers(*stages, edges=NARROW, rendered=None, grid=None):
    """The transfer functions up to each stage, as the engine gives them."""
    parts = tuple((type(stage).__name__.lower(), stage) for stage in stages)
    return [(name, Otf(parts[: i + 1], edges, rendered, grid)) for i, (name, _) in enumerate(parts)]


def figures(*stages, edges=NARROW, rendered=None, grid=None, **parameters):
    seen = transfers(*stages, edges=edges, rendered=rendered, grid=grid)
    return Resolution(**parameters).run(seen, seen[-1][1].weights)


def pixel(pitch=5.4, **parameters):
    return Pixel(pixel_pitch=pitch, peak_qe=QE, **parameters)


# -- analytic -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "case", next(g for g in json.loads(REFERENCE.read_text())["groups"] if g["name"] == "system_mtf_x")["cases"]
)
def test_lens_diffusion_and_pixel_are_the_product_of_the_reference(case, monkeypatch):
    """60-digit values, signed: within 1e-14 times the condition, and 2e-15 of what three factors round."""
    given = {name: float(text) for name, text in case["in"].items()}
    monkeypatch.setattr(silicon, "absorption", lambda wavelength: np.full(np.shape(wavelength), given["alpha_per_um"]))
    diode = Diffusion(
        depletion_depth=given["Ld_um"],
        diffusion_depth=given["L_um"],
        diffusion_length=given["Ln_um"],
        nodes=0,
    )
    edges = (1e3 * given["lam_um"] - 0.5, 1e3 * given["lam_um"] + 0.5)
    aperture = pixel(given["w_um"], aperture_fraction=1.0)
    otf = transfers(Diffraction(f_number=given["N"]), diode, aperture, edges=edges)[-1][1]
    wanted = float(case["out"])
    assert_allclose(
        otf(np.array([given["f_cyc_per_um"]]))[0, 0], wanted, rtol=1e-14 * max(1, case.get("cond", 1)), atol=2e-15
    )


def test_a_lens_alone_resolves_what_its_closed_forms_say():
    """Sparrow 0.947155 and Rayleigh 1.219670 lambda N; the contrast of a circular aperture is one half at 0.403973
    of its cut-off.
    """
    found = figures(Diffraction(f_number=4.0), cut_off_contrast=1e-6, highest=1.0, rendering=False)
    unit = 0.55 * 4.0
    assert_allclose(found["sparrow"], 0.947155 * unit, rtol=1e-4)  # the spline and the last millionth of contrast
    assert_allclose(found["rayleigh"], 1.219670 * unit, rtol=1e-4)
    assert_allclose(found["mtf50"], 0.4039727533 / unit, rtol=1e-9)
    assert_allclose(found["mtf50_lp_mm"], found["mtf50"] * 1e3, rtol=1e-15)
    assert_allclose(found["cut_off"], 1 / unit, rtol=2e-4)


def test_the_kernel_of_two_points_sees_the_sign_of_a_reversed_contrast():
    """Large pixels behind a fast lens: the transfer function is negative behind their zero, which contrast does not
    say.
    """
    stages = (Diffraction(f_number=2.0), pixel(4.0, aperture_fraction=1.0))
    found = figures(*stages, highest=1.0)["rayleigh"][1]
    otf = transfers(*stages)[1][1]
    signed = two_points.separations(lambda f: otf(f)[0], 1 / (0.55 * 2.0))[0]
    sized = two_points.separations(lambda f: np.abs(otf(f)[0]), 1 / (0.55 * 2.0))[0]
    assert_allclose(found, signed, rtol=1e-3)
    assert not abs(sized / signed - 1) < 0.05


@pytest.mark.parametrize("angle", [0.0, 90.0, 30.0, 45.0, -20.0])
def test_along_a_slant_a_square_pixel_is_two_boxes(angle):
    """sinc(f w cos) sinc(f w sin) at MTF50 is one half; along an axis it is the box's own."""
    found = figures(pixel(4.0, aperture_fraction=1.0), angle=angle)["mtf50"][0]
    turn = math.radians(angle)
    assert_allclose(np.sinc(4 * found * math.cos(turn)) * np.sinc(4 * found * math.sin(turn)), 0.5, rtol=1e-9)


def test_the_rendering_of_the_chart_belongs_to_the_curve_only_where_that_is_asked_for():
    """A Gaussian of 2 um alone has its MTF50 at sqrt(ln 2/2)/(2 pi); a pixel of 1/1000 um leaves it alone."""
    tiny = pixel(1e-3)
    with_chart = figures(tiny, rendered=(2.0, 0.0), rendering=True)["mtf50"][0]
    assert_allclose(with_chart, math.sqrt(math.log(2) / 2) / (2 * math.pi), rtol=1e-6)
    assert math.isnan(figures(tiny, rendered=(2.0, 0.0))["mtf50"][0])


def test_effective_resolution_ends_at_nyquist_and_counts_line_widths_over_the_frame():
    line = Line(120, 0.0, 1.0, "1", (-238.0, 4.0))
    found = figures(pixel(4.0), grid=Grid.of({"y": line, "x": line}), pixel_pitch=4.0)
    assert found["nyquist"] == 0.125
    assert found["mtf50"][0] > 0.125
    assert_allclose(found["effective_lp_mm"][0], 125.0, rtol=1e-15)
    assert_allclose(found["effective_cycles"][0], 0.5, rtol=1e-15)
    assert_allclose(found["effective_line_widths"][0], 120.0, rtol=1e-15)  # one line width is half a cycle: one pixel


def test_a_camera_that_nothing_limits_below_nyquist_is_still_at_nyquist():
    """Half contrast lies beyond the search: the pixels are what ends it."""
    found = figures(pixel(1e-2), pixel_pitch=1.0, highest=1.0)
    assert math.isnan(found["mtf50"][0])
    assert found["effective_cycles"][0] == 0.5


@pytest.mark.parametrize(
    ("f_number", "pitch", "fraction", "factor"),
    [(22.0, 1.0, 0.741, "lens"), (22.0, 5.4, 0.741, "lens"), (1.4, 8.0, 1.0, "geometry"), (2.0, 4.0, 0.3, "sampling")],
)
def test_the_factor_that_limits_is_the_one_whose_removal_gains_most(f_number, pitch, fraction, factor):
    found = figures(
        Diffraction(f_number=f_number),
        Diffusion(),
        pixel(pitch, aperture_fraction=fraction),
        edges=WHITE,
        pixel_pitch=pitch,
        highest=8.0,
    )
    assert FACTORS[int(found["limiting_factor"])] == factor
    assert found["resolution_gain"].min() >= 1.0


def test_gains_are_quotients_of_mtf50():
    stages = (Diffraction(f_number=5.6), Diffusion(), pixel(4.0))
    own = {"edges": WHITE, "pixel_pitch": 4.0, "rendering": False}
    whole = figures(*stages, **own)["mtf50"][-1]
    without_lens = figures(*stages[1:], **own)["mtf50"][-1]
    without_diffusion = figures(stages[0], stages[2], **own)["mtf50"][-1]
    gain = figures(*stages, **own)["resolution_gain"]
    assert_allclose(gain[:2], [without_lens / whole, without_diffusion / whole], rtol=1e-9)


# -- in a run -----------------------------------------------------------------------------------------------------


def document(tail=(), sweep=None, scene=None, camera=None, rows=96, columns=128, middle=(), **more):
    """A slanted edge with a margin, up to the pixels, and what follows."""
    return {
        "name": "edge",
        "precision": "float64",
        "seed": 5,
        "camera": {"peak_qe": list(QE), "pixel_pitch": 4.0, "f_number": 4.0, "focal_length": 50, **(camera or {})},
        "stages": [
            {
                "use": "slanted_edge",
                "name": "scene",
                "white_luminance": 2e4,
                "width": 776.0,
                "height": 648.0,
                "spacing": 2.0,
                "wavelength_from": 400.0,
                "wavelength_to": 700.0,
                "bin_width": 100.0,
                **(scene or {}),
            },
            {"use": "irradiance"},
            *middle,
            {"use": "diffraction", "name": "lens"},
            {"use": "diffusion"},
            {"use": "pixel", "rows": rows, "columns": columns},
            *({"use": use} if isinstance(use, str) else use for use in tail),
        ],
        **({"sweep": sweep} if sweep else {}),
        **more,
    }


BRIGHT = {"full_well_density": 1e9, "bits": 16}  # Poisson noise of 1e10 electrons is 1e-5 of them
READ_OUT = ("mosaic", "exposure", "shot_noise", "full_well", "read_noise", "adc", "linearise")
COLOUR = (
    "white",
    "balance_mosaic",
    {"use": "demosaic_bilinear", "name": "demosaic"},
    "colour_fit",
    "camera_to_xyz",
    "display",
    "encode",
)


def test_resolution_is_chosen_by_stage_and_axes():
    tree = etendue.simulate(document(("resolution",), {"f_number": [2.8, 11]}))
    found = tree["resolution"].mtf50
    assert found.dims == ("f_number", "stage")
    assert (
        found.sel(stage="lens", f_number=2.8)
        > found.sel(stage="pixel", f_number=2.8)
        > found.sel(stage="pixel", f_number=11)
    )
    assert list(tree["resolution"].factor.values) == list(FACTORS)


def test_a_warp_ends_the_analytic_curve():
    """A gain does not: light stays where it is."""
    warp = {"use": "distortion", "k1": 0.01}
    warped = etendue.simulate(document(("resolution",), middle=({"use": "falloff"}, warp)))["resolution"].to_dataset()
    assert np.isnan(warped.mtf50).all()
    assert np.isnan(warped.resolution_gain).all()
    assert not np.isnan(
        etendue.simulate(document(("resolution",), middle=({"use": "falloff"},)))["resolution"].mtf50
    ).any()


@pytest.mark.parametrize("angle", [2.0, 5.0, 10.0, 40.0, -85.0])
def test_a_measured_edge_is_the_analytic_one_before_the_mosaic(angle):
    """0.5 % is the bound for 200 x 400 pixels; 0.15 % of it on these few. `benchmarks/limits_map.py` has the larger
    frame.
    """
    found = etendue.simulate(document(("edge_resolution",), scene={"angle": angle}))["edge_resolution"].to_dataset()
    assert list(found.stage.values) == ["irradiance", "lens", "diffusion", "pixel"]
    assert (abs(found.edge_difference / found.edge_analytic) < 1.5e-3).all()
    nearer = angle if abs(angle) <= 45 else -(angle + 90)
    assert_allclose(found.edge_angle, nearer, atol=0.01)
    assert np.isnan(found.edge_mtf50_low).all()
    assert (found.edge_flags & (FLAGS["no_edge"] | FLAGS["noisy"] | FLAGS["clipped"]) == 0).all()


def test_behind_the_mosaic_edges_are_measured_in_every_colour_state_and_nothing_is_analytic():
    """Without noise and patterns; display values are decoded first: a grey edge resolves the same in linear and
    encoded values.
    """
    light = {"white_luminance": 1e10}
    chain = [{"use": "exposure", "prnu": 0, "dark_nonuniformity": 0} if use == "exposure" else use for use in READ_OUT]
    doc = document((*chain, *COLOUR, "edge_resolution"), camera={"integration_time": 0.001, **BRIGHT}, scene=light)
    found = etendue.simulate(doc)["edge_resolution"].to_dataset()
    assert list(found.stage.values) == [
        "irradiance",
        "lens",
        "diffusion",
        "pixel",
        "linearise",
        "balance_mosaic",
        "demosaic",
        "camera_to_xyz",
        "display",
        "encode",
    ]
    behind = found.isel(stage=slice(4, None))
    assert np.isnan(behind.edge_analytic).all()
    assert np.isfinite(behind.edge_mtf50).all()
    assert_allclose(
        behind.edge_mtf50.sel(stage="linearise"), found.edge_mtf50.sel(stage="pixel"), rtol=2e-4
    )  # one colour's sites
    assert_allclose(behind.edge_mtf50.sel(stage="encode"), behind.edge_mtf50.sel(stage="display"), rtol=1e-3)
    assert EVERY_FACTOR[int(found.limiting_factor)] != "noise"
    assert float(found.resolution_gain.sel(factor="demosaic")) > 1.1  # bilinear


@pytest.mark.parametrize(
    ("encoding", "encode"), [("sRGB", srgb_encode), ("BT.709", bt709_encode), ("power", lambda v: v**0.45)]
)
def test_display_values_are_decoded_by_their_own_curve_and_no_other(encoding, encode):
    linear = np.linspace(-0.1, 1.1, 240).reshape(3, 8, 10)
    encoded = encode(np.clip(linear, 0, 1))
    pictures = [("linear", linear)], [("encoded", encoded)]
    check_encoding(*pictures, encoding, 0.45)
    assert_allclose(decoded(encoded, encoding, 0.45), np.clip(linear, 0, 1), atol=1e-12)
    with pytest.raises(ValueError, match="give this stage the encoding"):
        check_encoding(*pictures, "power", 0.8)


def test_noise_limits_where_the_interval_is_wide_and_the_interval_holds_the_truth():
    """A hundred times less light."""
    doc = document(
        (*READ_OUT, *COLOUR, "edge_resolution"), {"integration_time": [2e-5, 2e-3]}, camera={"full_well_density": 4000}
    )
    found = etendue.simulate(doc)["edge_resolution"].to_dataset()
    assert EVERY_FACTOR[int(found.limiting_factor[0])] == "noise"
    assert EVERY_FACTOR[int(found.limiting_factor[1])] != "noise"
    sharp = found.isel(integration_time=1)
    mosaic = sharp.sel(stage="linearise")
    assert mosaic.edge_mtf50_low < sharp.sel(stage="pixel").edge_analytic < mosaic.edge_mtf50_high
    width = found.edge_mtf50_high - found.edge_mtf50_low
    assert width.sel(stage="linearise")[1] < width.sel(stage="linearise")[0] or np.isnan(
        width.sel(stage="linearise")[0]
    )


def test_a_region_in_um_holds_the_edge_that_is_found_in_the_whole():
    region = {"use": "edge_resolution", "region_height": 300.0, "region_width": 400.0, "centre_x": 10.0}
    whole = etendue.simulate(document(("edge_resolution",)))["edge_resolution"].to_dataset()
    part = etendue.simulate(document((region,)))["edge_resolution"].to_dataset()
    assert_allclose(part.edge_mtf50, whole.edge_mtf50, rtol=2e-3)
    nowhere = {**region, "centre_x": 190.0, "region_width": 130.0}
    none = etendue.simulate(document((nowhere,)))["edge_resolution"].to_dataset()
    assert (none.edge_flags == FLAGS["no_edge"]).all()
    assert np.isnan(none.edge_mtf50).all()


def edge_figures(doc):
    return etendue.simulate(doc)["edge_resolution"].to_dataset()


ALL = (*READ_OUT, *COLOUR, "edge_resolution")
MEDIUM = {"integration_time": 1e-3, "full_well_density": 4000}
LONG = {**MEDIUM, "integration_time": 4e-3}  # the pixels of the bright field are full


@pytest.mark.parametrize(
    "frame",
    [{"centre_x": -2000.0}, {"centre_x": 2000.0}, {"centre_y": -2000.0}, {"centre_y": 2000.0}],
    ids=lambda f: str(*f.items()),
)
def test_a_region_beside_the_frame_on_any_side_shows_no_edge(frame):
    """Nothing of it counts from the far side: in light and in the mosaic, whose clipped pixels it does not see
    either.
    """
    region = {"use": "edge_resolution", "region_height": 300.0, "region_width": 400.0, **frame}
    found = edge_figures(document((*READ_OUT, region), camera=LONG))
    assert (found.edge_flags == FLAGS["no_edge"]).all()


def test_a_region_that_reaches_over_the_frame_is_what_of_it_is_inside():
    """Its left half stands outside: the stretch that is left starts at the first pixel."""
    assert _span(-10.0, 20.0, 0.5, 1.0, 100) == (0, 0)
    assert _span(0.0, 20.0, 0.5, 1.0, 100) == (0, 10)
    assert _span(100.0, 20.0, 0.5, 1.0, 100) == (90, 100)
    assert _span(300.0, 20.0, 0.5, 1.0, 100) == (100, 100)
    assert _span(-300.0, 20.0, 0.5, 1.0, 100) == (0, 0)


def test_a_pixel_is_the_cameras_also_in_front_of_it():
    """The light stands on a grid of 2 um, half a pixel: cycles per pixel are cycles per um times the pitch, at every
    stage.
    """
    found = edge_figures(document(("edge_resolution",)))
    assert_allclose(found.edge_mtf50_cycles, found.edge_mtf50 * 4.0, rtol=1e-14)
    assert (np.diff(found.edge_aliasing) < 0).all()  # the same Nyquist, and a lower curve at each stage
    assert found.edge_aliasing[1] > 0.01  # above the Nyquist frequency of the light's own grid there is nothing of it
    sharp = edge_figures(
        document(("edge_resolution",), camera={"pixel_pitch": 8.0, "f_number": 2.0}, rows=64, columns=72)
    )
    above = sharp.edge_mtf50 > 0.5 / 8.0
    assert above.any()
    assert ((sharp.edge_flags & FLAGS["above_nyquist"] > 0) == above).all()


def test_effective_resolution_of_an_edge_ends_at_nyquist_in_all_three_units():
    """8 um: 62.5 line pairs/mm, half a cycle per pixel, one line width per pixel of 64 rows; below it, the measured
    figure.
    """
    sharp = edge_figures(
        document(("edge_resolution",), camera={"pixel_pitch": 8.0, "f_number": 2.0}, rows=64, columns=72)
    )
    lens = sharp.sel(stage="lens")
    assert lens.edge_mtf50 > 0.0625
    assert_allclose(
        [lens.edge_effective_lp_mm, lens.edge_effective_cycles, lens.edge_effective_line_widths],
        [62.5, 0.5, 64],
        rtol=1e-14,
    )
    found = edge_figures(document(ALL, camera=MEDIUM))
    per_um = np.minimum(found.edge_mtf50, 0.125)
    assert (per_um < 0.125).all()
    assert_allclose(found.edge_effective_lp_mm, 1e3 * per_um, rtol=1e-14)
    assert_allclose(found.edge_effective_cycles, 4.0 * per_um, rtol=1e-14)
    assert_allclose(found.edge_effective_line_widths, 2 * 96 * 4.0 * per_um, rtol=1e-14)


def test_what_is_clipped_in_the_mosaic_is_flagged_in_every_picture_made_of_it():
    """Behind it values are mixed, and nothing of them shows that they stand at the end of a scale. What limits is
    not known.
    """
    found = edge_figures(document(ALL, {"integration_time": [1e-3, 4e-3]}, camera=MEDIUM))
    clipped = (found.edge_flags & FLAGS["clipped"]) > 0
    assert not clipped.isel(integration_time=0).any()
    assert_allclose(clipped.isel(integration_time=1), [False] * 4 + [True] * 6)
    assert np.isfinite(found.limiting_factor[0])
    assert np.isnan(found.limiting_factor[1])


def test_of_a_series_that_exposure_is_looked_at_whose_edge_is_measured():
    """The second frame is clipped, eight times as long; the first is measured."""
    read_out = [{"use": "bracket", "repeats": 1, "brackets": [0, 3]}, *READ_OUT]
    found = edge_figures(document((*read_out, "edge_resolution"), camera=MEDIUM))
    assert (found.edge_flags & (FLAGS["clipped"] | FLAGS["no_edge"]) == 0).all()
    assert np.isfinite(found.limiting_factor)
    reverse = [{**use, "brackets": [3, 0]} if isinstance(use, dict) else use for use in read_out]
    assert np.isnan(edge_figures(document((*reverse, "edge_resolution"), camera=MEDIUM)).limiting_factor)


def test_what_limits_is_not_said_where_the_gain_of_the_lens_is_not_known():
    """Behind a warp there is no transfer function: demosaicing is the largest gain that is known, and not for that
    the limit.
    """
    warp = {"use": "distortion", "k1": 0.01}
    found = edge_figures(document(ALL, middle=(warp,), camera=MEDIUM))
    assert np.isnan(found.resolution_gain.sel(factor="lens"))
    assert found.resolution_gain.sel(factor="demosaic") > 1.1
    assert np.isnan(found.limiting_factor)


@pytest.mark.parametrize(("rows", "columns"), [(31, 40), (1, 128)])
def test_a_frame_too_small_to_be_measured_is_not_limited_by_noise(rows, columns):
    found = edge_figures(document(ALL, rows=rows, columns=columns, camera=MEDIUM))
    assert found.edge_flags.sel(stage="pixel") == FLAGS["no_edge"]
    assert np.isnan(found.limiting_factor)


@pytest.mark.parametrize("angle", [40.0, -40.0])
def test_the_analytic_figure_is_that_across_the_edge_and_not_that_of_its_mirror_image(angle):
    """Oblique astigmatism with defocus resolves 1.6 times as much across one diagonal as across the other."""
    doc = document(("edge_resolution",), scene={"angle": angle})
    astigmatic = {"use": "wavefront", "name": "lens", "zernike": [0, 0, 0, 0.05, 0.1]}
    doc["stages"] = [astigmatic if stage.get("name") == "lens" else stage for stage in doc["stages"]]
    found = edge_figures(doc)
    assert (abs(found.edge_difference / found.edge_analytic) < 1.5e-3).all()
    assert_allclose(found.edge_mtf50.sel(stage="lens"), {40.0: 0.0742, -40.0: 0.0457}[angle], atol=5e-4)


def test_of_a_coloured_edge_luminance_is_measured():
    """Three blurs, one of each colour: the weights of sRGB's Y have an MTF50 of their own, which no plane has."""
    y, x = np.mgrid[:96, :128]
    distance = (x - 63.5) * math.cos(0.1) + (y - 47.5) * math.sin(0.1)
    planes = np.stack([0.1 + 0.4 * (1 + special.erf(distance / (sigma * math.sqrt(2)))) for sigma in (2.5, 1.0, 4.0)])

    def mtf50(picture):
        grid = Grid.of({"y": Line(96, 0.0, 1.0, "1", (0.0, 4.0)), "x": Line(128, 0.0, 1.0, "1", (0.0, 4.0))})
        seen = dict.fromkeys((*EdgeProbe.reads, "rgb_linear", "stage"), ())
        given = {**seen, "rgb_linear": [("display", picture, grid)], "stage": ("display",)}
        return EdgeProbe(pixel_pitch=4.0).run(**given)["edge_mtf50"][0]

    luminance = np.tensordot((0.2126, 0.7152, 0.0722), planes, 1)
    assert_allclose(mtf50(planes), mtf50(np.stack([luminance] * 3)), rtol=1e-3)
    assert all(abs(mtf50(np.stack([plane] * 3)) / mtf50(planes) - 1) > 0.05 for plane in planes)


def test_half_a_region_is_refused():
    with pytest.raises(ValueError, match="give both"):
        EdgeProbe(region_height=10.0)


def test_every_scheduler_measures_the_same_bits():
    doc = document((*READ_OUT, *COLOUR, "edge_resolution"), {"f_number": [2.8, 8], "integration_time": [1e-3, 2e-3]})
    first, second = (
        etendue.simulate(doc, scheduler=name)["edge_resolution"].to_dataset() for name in ("serial", "threads")
    )
    for name in first.data_vars:
        assert_same_bits(first[name].values, second[name].values, name)

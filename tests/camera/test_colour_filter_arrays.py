"""Colour filter arrays in the camera: every array reaches the display or says why not; windows keep the sensor's
phase.
"""

import itertools

import numpy as np
import pytest

import etendue
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.pipeline.file import from_document
from etendue.plan.planner import make_plan
from tests.camera.test_levels import camera

CHAIN = ("diffusion", "pixel", "mosaic", "exposure", "adc", "linearise")
COLOUR = ("white", "colour_fit", "camera_to_xyz", "balance", "display", "encode")
NOISELESS = {"prnu": 0, "dark_nonuniformity": 0}


def whole(pattern, peak_qe, demosaicer="demosaic_any", chart="uniform", stages=COLOUR, **tables):
    """A noise-free camera with this array."""
    quantities = {
        "pattern": pattern,
        "peak_qe": peak_qe,
        "pixel_pitch": 2.0,
        "bits": 16,
        "full_well_density": 2e4,
        "integration_time": 0.2,
        **tables.pop("camera", {}),
    }
    document = camera(
        "diffusion",
        "pixel",
        "mosaic",
        "charge_fraction",
        demosaicer,
        *stages,
        chart=chart,
        camera=quantities,
        scene={"white_luminance": 100, "width": 48, "height": 48, **tables.pop("scene", {})},
        charge_fraction={"reference_time": 0.2},
        **tables,
    )
    return document


CLEAR = {"sensitivity_kind": "filter_transmittance"}
ARRAYS = [
    ("GRBG", [0.4, 0.5, 0.3], {}),
    ("quad-RGGB", [0.4, 0.5, 0.3], {}),
    ("X-Trans", [0.4, 0.5, 0.3], {}),
    ("RGBW", [0.6, 0.7, 0.6, 0.9], CLEAR),
    ("GBR/RGB/BRG", [0.4, 0.5, 0.3], {}),
]


@pytest.mark.parametrize(("pattern", "peak_qe", "more"), ARRAYS, ids=[a[0] for a in ARRAYS])
def test_a_grey_surface_is_grey_on_the_display_whatever_the_array(pattern, peak_qe, more):
    light = {"reflectance": 0.18, "white_luminance": 50}  # at which the clear pixels of RGBW keep below the well
    tree = etendue.simulate(whole(pattern, peak_qe, scene=light, camera={"illuminant": "A", **more}))
    xyz, white = tree["camera_to_xyz"].xyz_scene.values, tree["colour_fit"].white_xyz.values
    np.testing.assert_allclose(xyz, 0.18 * np.broadcast_to(white[:, None, None], xyz.shape), rtol=1e-11)
    # the display's white is D65 as printed with four digits, that of the balance D65 as tabulated
    np.testing.assert_allclose(tree["display"].rgb_linear.values, 0.18, rtol=1e-3)
    assert tree["colour_fit"].fit_residual.item() < 0.03


@pytest.mark.parametrize(
    ("pattern", "peak_qe", "more"), [*ARRAYS[1:4], ("RCCC", [0.6, 0.9], CLEAR), ("mono", [0.9], CLEAR)]
)
def test_every_array_runs_from_a_chart_to_the_display_with_its_channels_by_name(pattern, peak_qe, more):
    scene = {"width": 120, "height": 96, "spacing": 1.0, "bin_width": 40, "wavelength_from": 380, "wavelength_to": 780}
    tree = etendue.simulate(whole(pattern, peak_qe, chart="composite", scene=scene, camera=more))
    assert np.isfinite(tree["encode"].rgb_display.values).all()
    letters = {"RGBW": "RGBW", "RCCC": "RC", "mono": "W"}.get(pattern, "RGB")
    for stage, variable in (
        ("pixel", "photon_rate"),
        ("demosaic_any", "rgb_camera"),
        ("white", "white"),
        ("colour_fit", "colour_matrix"),
    ):
        assert "".join(tree[stage][variable].channel.values) == letters
    assert tree["colour_fit"].colour_matrix.dims == ("component", "channel")


def test_fewer_colours_fit_worse_and_the_plan_says_so():
    residuals = {}
    for pattern, peak_qe in (
        ("RGBW", [0.6, 0.7, 0.6, 0.9]),
        ("RGGB", [0.6, 0.7, 0.6]),
        ("RCCC", [0.6, 0.9]),
        ("mono", [0.9]),
    ):
        document = whole(pattern, peak_qe, camera=CLEAR)
        residuals[pattern] = etendue.simulate(document)["colour_fit"].fit_residual.item()
        said = " ".join(make_plan(from_document(document), installed_stages()).warnings)
        assert ("too few for colour" in said) == (pattern in ("RCCC", "mono"))
        assert ("luminance" in said) == (pattern == "mono")
    assert residuals["RGBW"] <= residuals["RGGB"] < residuals["RCCC"] < residuals["mono"]


def test_a_monochrome_picture_is_luminance_in_the_colour_of_the_white():
    tree = etendue.simulate(whole("mono", [0.9], chart="step_wedge", scene={"width": 96, "spacing": 1.0}, camera=CLEAR))
    xyz, white = tree["camera_to_xyz"].xyz_scene.values, tree["colour_fit"].white_xyz.values
    np.testing.assert_allclose(xyz, xyz[1] * white[:, None, None], rtol=1e-10, atol=1e-12)


def window(pattern, row, column, demosaicer, *, rows=18, columns=20, height=16, width=17):
    pixel = {
        "rows": rows + 8,
        "columns": columns + 8,
        "first_row": row,
        "first_column": column,
        "window_rows": height,
        "window_columns": width,
    }
    scene = {"width": 2.0 * (columns + 10), "height": 2.0 * (rows + 10), "pitch": 20.0, "spot_sigma": 2.5}
    peak_qe = [0.4, 0.5, 0.3]
    return whole(pattern, peak_qe, demosaicer, chart="points", stages=(), pixel=pixel, scene=scene)


@pytest.mark.parametrize("pattern", ["RGGB", "X-Trans", "quad-GBRG"])
@pytest.mark.parametrize(("row", "column"), [(0, 0), (1, 0), (0, 1), (3, 5)])
def test_a_window_of_the_sensor_equals_the_crop_of_the_whole_wherever_it_begins(pattern, row, column):
    """Odd rows and columns too: a mask belongs to the sensor, and the demosaicer sees it from where the window
    begins.
    """
    for demosaicer in (
        "demosaic_any",
        *(("demosaic_bilinear", "demosaic_colour_difference") if pattern == "RGGB" else ()),
    ):
        full = etendue.simulate(window(pattern, 0, 0, demosaicer, height=24, width=26))
        part = etendue.simulate(window(pattern, row, column, demosaicer))
        for stage, variable, border in (("mosaic", "photocurrent", 0), (demosaicer, "rgb_camera", 4)):
            found, crop = (
                part[stage][variable],
                full[stage][variable].isel(y=slice(row, row + 16), x=slice(column, column + 17)),
            )
            assert np.array_equal(found.y, crop.y) and np.array_equal(found.x, crop.x)
            inner = {"y": slice(border, 16 - border), "x": slice(border, 17 - border)}
            # the same light, evaluated at the same places in another order
            np.testing.assert_allclose(
                found.isel(inner).values, crop.isel(inner).values, rtol=1e-9, atol=1e-9 * float(crop.max())
            )


def test_nearest_sees_the_window_s_own_order():
    """Whole 2 x 2 cells are its unit, so a window that begins inside one is not a crop; its samples are at their
    places.
    """
    for row, column in itertools.product((0, 1), repeat=2):
        tree = etendue.simulate(window("RGGB", row, column, "demosaic_nearest"))
        planes, raw = tree["demosaic_nearest"].rgb_camera, tree["charge_fraction"].mosaic_linear.values
        red = np.s_[row % 2 :: 2, column % 2 :: 2]  # where the sensor's rows and columns are even
        np.testing.assert_array_equal(planes.sel(channel="R").values[red], raw[red])


def test_a_mask_from_letters_or_a_file_is_the_mask_by_name(tmp_path):
    (tmp_path / "mask.csv").write_text("# a Bayer cell\nG,R\nB,G\n")
    named, letters, file = (
        etendue.simulate(whole(pattern, [0.4, 0.5, 0.3]))["display"].rgb_linear.values
        for pattern in ("GRBG", "GR/BG", str(tmp_path / "mask.csv"))
    )
    np.testing.assert_array_equal(named, letters)
    np.testing.assert_array_equal(named, file)


def test_sensitivities_are_found_by_the_letters_of_the_columns_in_any_order(tmp_path):
    def table(header, *columns):
        path = tmp_path / f"{'-'.join(header)}.csv"
        rows = [f"{w},{','.join(f'{c(w):.6f}' for c in columns)}" for w in range(380, 785, 20)]
        path.write_text("\n".join(["wavelength_nm," + ",".join(header), *rows]))
        return str(path)

    def bell(centre):
        return lambda w: float(np.exp(-(((w - centre) / 50) ** 2)))

    red, green, blue, wide = bell(610), bell(540), bell(460), bell(550)
    ordered, other = table("RGB", red, green, blue), table(("blue", "red", "W", "g"), blue, red, wide, green)
    results = [
        etendue.simulate(whole("RGGB", [0.4, 0.5, 0.3], camera={"sensitivity": path}))["pixel"].photon_rate.values
        for path in (ordered, other)
    ]
    np.testing.assert_array_equal(*results)
    # a white column serves RGBW and mono; a table with a single column serves mono whatever its name is
    for pattern, peaks, path in (
        ("RGBW", [0.4, 0.5, 0.3, 0.6], other),
        ("mono", [0.6], other),
        ("mono", [0.6], table(("panchromatic",), wide)),
    ):
        rates = etendue.simulate(whole(pattern, peaks, camera={"sensitivity": path}))["pixel"].photon_rate
        np.testing.assert_allclose(rates.isel(channel=-1).values, rates.values[-1, 0, 0], rtol=1e-12)


def test_a_clear_pixel_collects_what_its_silicon_does():
    """filter_transmittance without a column: peak x D(0) x surface, so W is at least as bright as any filter with
    that peak.
    """
    rates = etendue.simulate(whole("RGBW", [0.8], camera={**CLEAR, "surface_transmission": 0.9}))[
        "pixel"
    ].photon_rate.values[:, 0, 0]
    assert rates[3] > rates[:3].max()
    bare = etendue.simulate(whole("mono", [0.8], camera={**CLEAR, "surface_transmission": 0.9}))[
        "pixel"
    ].photon_rate.values[0, 0, 0]
    np.testing.assert_allclose(rates[3], bare, rtol=1e-12)


@pytest.mark.parametrize(
    ("pattern", "peak_qe", "demosaicer", "more", "says"),
    [
        (
            "RGBW",
            [0.5],
            "demosaic_any",
            {},
            "channel W, but the sensitivity 'Nikon 5100 .NPL.' has columns R, G, B only",
        ),
        ("X-Trans", [0.5], "demosaic_bilinear", {}, "Bayer arrays only.*use demosaic_any"),
        ("mono", [0.5, 0.5], "demosaic_any", CLEAR, "peak_qe has 2 values, but the pattern 'mono' has 1 channels: W"),
        ("RGBG", [0.5], "demosaic_any", {}, "allowed: RGGB"),
        ("missing.csv", [0.5], "demosaic_any", {}, "no such file"),
    ],
)
def test_arrays_that_cannot_be_are_refused_before_anything_is_computed(pattern, peak_qe, demosaicer, more, says):
    with pytest.raises(RequestError, match=says):
        etendue.simulate(whole(pattern, peak_qe, demosaicer, camera=more))


def test_a_file_without_letters_is_refused_by_name(tmp_path):
    (tmp_path / "mask.csv").write_text("# nothing\n")
    with pytest.raises(RequestError, match=r"mask\.csv: there are no letters"):
        etendue.simulate(whole(str(tmp_path / "mask.csv"), [0.5]))

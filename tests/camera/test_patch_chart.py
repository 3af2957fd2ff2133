"""A chart of one's own reflectances: every patch reflects what its column says, in its place, and nothing else does."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.pipeline.file import read_pipeline
from etendue.plan.planner import make_plan
from etendue_camera import spectra
from etendue_camera.scene.stages.patch_chart import PatchChart

EDGES = tuple(range(400, 701, 50))
ROUNDING = 1e-12  # a product of three numbers and a weight that is 1 within float64 in the middle of a patch


def table(folder, *columns):
    rows = np.linspace(400, 700, 7)
    head = ",".join(["wavelength_nm", *(f"p{n}" for n in range(len(columns)))])
    lines = [",".join(f"{value:.6g}" for value in (rows[i], *(column[i] for column in columns))) for i in range(7)]
    path = folder / "reflectances.csv"
    path.write_text("\n".join([head, *lines]))
    return str(path)


def chart(path, **values):
    words = {
        "width": 240.0,
        "height": 160.0,
        "spacing": 2.0,
        "wavelength_from": 400.0,
        "wavelength_to": 700.0,
        "bin_width": 50.0,
    }
    return PatchChart(reflectances=path, white_luminance=100.0, illuminant="D65", **{**words, **values})


def drawn(stage):
    """Reflectance (wavelength, y, x), and the table's bin means (patch, wavelength)."""
    _, grids = stage.describe()
    grid = grids["radiance"]
    y, x = (np.array(grid.line(dim).values()) for dim in "yx")
    made = stage.run(y, x, stage.prepare({"out_wavelength_edges": EDGES}))
    return made["radiance"] / made["white_radiance"][:, None, None], spectra.table_from_csv(
        stage.reflectances, EDGES, outside="hold"
    )[1].T


def middles(cube, rows, columns):
    """What stands in the middle of each place of a grid of patches, row by row: (rows * columns, wavelength)."""
    ny, nx = cube.shape[1:]
    return np.array(
        [
            cube[:, int((i + 0.5) * ny / rows), int((j + 0.5) * nx / columns)]
            for i in range(rows)
            for j in range(columns)
        ]
    )


@settings(max_examples=20)
@given(count=st.integers(1, 9), across=st.integers(0, 9), seed=st.integers(0, 99))
def test_every_patch_has_its_own_reflectance_row_by_row(tmp_path_factory, count, across, seed):
    columns = np.random.default_rng(seed).random((count, 7))
    stage = chart(table(tmp_path_factory.mktemp("chart"), *columns), across=across, width=720.0, height=720.0)
    cube, wanted = drawn(stage)
    rows, beside = stage.layout(count)
    assert rows * beside >= count > (rows - 1) * beside
    found = middles(cube, rows, beside)
    assert_allclose(found[:count], wanted, atol=ROUNDING)
    assert_allclose(found[count:], stage.background, atol=ROUNDING)


def test_patches_as_grey_as_their_background_leave_an_even_frame(tmp_path):
    stage = chart(table(tmp_path, *[[0.3] * 7] * 6), background=0.3)
    assert stage.known().uniform
    assert_allclose(drawn(stage)[0], 0.3, atol=ROUNDING)


@pytest.mark.parametrize(
    ("frame", "layout"), [((240.0, 160.0), (4, 6)), ((160.0, 240.0), (6, 4)), ((960.0, 40.0), (1, 24))]
)
def test_patches_come_out_nearly_square(tmp_path, frame, layout):
    path = table(tmp_path, *[[0.1 + 0.03 * n] * 7 for n in range(24)])
    assert chart(path, width=frame[0], height=frame[1]).layout(24) == layout


def test_what_reflects_less_than_nothing_is_refused_by_name(tmp_path):
    with pytest.raises(ValueError, match=r"p1 falls to -0.1"):
        chart(table(tmp_path, [0.1] * 7, [-0.1] * 7)).describe()


@pytest.mark.parametrize(
    "overrides", [{"scene.use": "patch_chart", "scene.reflectances": ""}, {"colour_fit.reflectances": ""}]
)
@pytest.mark.parametrize(("top", "refused"), [(90.0, True), (2.01, True), (2.0, False), (1.0, False)])
def test_percents_are_refused_and_what_fluoresces_is_not(tmp_path, overrides, top, refused):
    """In the same words wherever reflectances are read."""
    path = table(tmp_path, [0.1 * top] * 7, [top] * 7)
    asked = {key: value or path for key, value in overrides.items()}
    pipeline = read_pipeline(Path(__file__).parents[2] / "pipelines" / "smallest.toml", asked)
    if refused:
        with pytest.raises(
            RequestError, match=rf"p1 of .* reaches {top:g}: a reflectance is a fraction; divide per cent values by 100"
        ):
            make_plan(pipeline, installed_stages())
    else:
        make_plan(pipeline, installed_stages())

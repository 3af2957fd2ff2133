"""The scene of dead leaves: its leaves belong to its seed, and a camera's blur can be read from them."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.resolution.contrast import mtf50
from etendue_camera.resolution.texture import texture_response
from etendue_camera.scene.stages.texture import DeadLeaves

CHART = {"white_luminance": 100.0, "width": 64.0, "height": 48.0, "smallest": 2.0, "largest": 20.0, "bin_width": 100.0}


def drawn(**values):
    scene = DeadLeaves(**{**CHART, **values})
    grid = scene.plane()
    y, x = (grid[d].start + grid[d].step * np.arange(grid[d].size) for d in ("y", "x"))
    return scene.run(out_y=y, out_x=x, prepared=np.ones(1))["radiance"][0]


def test_a_finer_grid_shows_the_same_leaves():
    """Each sample the mean of the four that take its place: cells show the same chart at any spacing."""
    coarse = drawn(light="cells", softness=0.0, oversampling=8)
    fine = drawn(light="cells", softness=0.0, oversampling=8, spacing=0.5)
    assert fine.shape == (96, 128)
    # leaves of 2 samples: 8-fold painting errs by a few thousandths at borders
    assert np.std(fine.reshape(48, 2, 64, 2).mean((1, 3)) - coarse) < 1e-3


def test_the_seed_is_the_charts_and_the_window_moves_with_the_frame():
    assert_array_equal(drawn(), drawn())
    assert np.abs(drawn() - drawn(seed=2)).max() > 0.1
    assert_allclose(
        drawn(centre_y=1.0, centre_x=-2.0), drawn(), atol=2e-6
    )  # positions of 2 mm round in float32 painting


def test_levels_are_kept():
    value = drawn(low=0.25, high=0.5)
    assert value.min() >= 0.25
    assert value.max() <= 0.5


def test_the_softness_is_read_back_from_the_texture():
    picture, original = (drawn(softness=s, width=300.0, height=300.0) for s in (1.2, 0.7))
    found = texture_response(picture, original, known=lambda f: np.exp(-2 * (np.pi * 0.7 * f) ** 2))
    expected = mtf50(lambda f: np.exp(-2 * (np.pi * 1.2 * f) ** 2)[None], None, 0.5, 64)
    assert_allclose(found.mtf50, expected, rtol=0.01)  # 300 x 300 samples

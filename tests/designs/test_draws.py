"""The random draw as a factor: each number is one draw of all noise, whatever the other factors are."""

from __future__ import annotations

import numpy as np
import pytest
import xarray

from etendue.errors import RequestError
from etendue_lab.designs.indices import indices, mixed_of
from etendue_lab.designs.samples import samples_of
from etendue_lab.designs.sensitivity import sensitivity
from tests.designs.given import STAGES, plan_of, ran

CAMERA = (
    STAGES.replace('"slanted_edge"', '"uniform"')
    .replace('"1000 cd m-2"', '"60 cd m-2"')
    .replace('integration_time = "4 ms"', "read_noise = 4\ndsnu = 0\ndark_current_density = 0")
    .replace('use = "lens_numbers"', 'use = "adc"\n[[stages]]\nuse = "exposure_report"')
)
DESIGN = """
[design]
method = "saltelli"
points = 256
seed = 5
[design.factors]
integration_time = { from = "3.8 ms", to = "4.2 ms" }
noise = { from = 0, to = 99999 }
"""


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("draws") / "a"
    ran(folder, text=CAMERA + DESIGN)
    return folder


def test_the_share_of_the_draw_is_that_of_the_variances(archive):
    """Mean charge of a frame of N pixels: shot and read noise give (E s + r^2) / N, the time the variance of s; a draw
    that scales with sqrt(s) alone has nearly all of it in first order, as s varies by 10 %.
    """
    found = xarray.open_datatree(archive / "data.zarr", engine="zarr")
    means = found["read_noise"]["charge"].mean(("y", "x")).values
    expected = found["exposure"]["expected_charge"]
    of_time, of_draw = float(expected.mean(("y", "x")).var()), float(expected.mean() + 16) / 16
    own = indices(mixed_of(means, 2), resampled=199)
    truth = np.array([of_time, of_draw]) / (of_time + of_draw)
    assert 0.2 < truth[1] < 0.8  # both matter
    for found in (own.first, own.total):
        assert ((found[:, 1] <= truth) & (truth <= found[:, 2])).all(), (found, truth)


def test_rows_with_one_number_differ_by_their_other_factors_alone(archive):
    """Read noise is the same in rows of a point that share the number, bit for bit, and uncorrelated in others."""
    found = xarray.open_datatree(archive / "data.zarr", engine="zarr")
    added = (found["read_noise"]["charge"] - found["shot_noise"]["charge"]).values
    numbers = found["read_noise"]["noise"].values
    first: dict[str, int] = {}
    same = [(row, first.setdefault(number, row)) for row, number in enumerate(numbers)]
    assert len(first) == 2 * 256
    for row, earlier in same:
        np.testing.assert_allclose(added[row], added[earlier], atol=2e-4)  # of charges up to 1000 in float32
    distinct = added[list(first.values())].reshape(len(first), -1) / 4
    assert abs(distinct.mean()) < 6 / np.sqrt(distinct.size)
    assert abs((distinct[1:] * distinct[:-1]).mean()) < 6 / np.sqrt(distinct.size)
    assert abs((distinct**2).mean() - 1) < 6 * np.sqrt(2 / distinct.size)


def test_a_sample_is_the_camera_with_that_number(archive):
    found = xarray.open_datatree(archive / "data.zarr", engine="zarr")["read_noise"].to_dataset()
    row = found.isel(sample=7)
    alone = ran(None, {"noise": row["noise"].item(), "integration_time": row["integration_time"].item()}, CAMERA)
    np.testing.assert_array_equal(alone.tree["read_noise"]["charge"].values, row["charge"].values)


def test_the_common_draw_is_none_of_the_numbered_ones():
    drawn = [ran(None, {"noise": noise}, CAMERA).tree["read_noise"]["charge"].values for noise in ("common", 0, 1)]
    assert not any(np.array_equal(drawn[i], drawn[j]) for i in range(3) for j in range(i))


def test_it_is_told_that_the_draw_is_a_factor(archive):
    made = samples_of(archive)
    assert {factor.key: factor.subject for factor in made.factors}["noise"] == "noise"
    assert made.draws(made.metrics("mean_snr")[0]) == []
    notes = sensitivity(made, ["mean_snr"])["metrics"][0]["notes"]
    assert any("factor noise" in note for note in notes)


@pytest.mark.parametrize("written", [-1, 1.5, "often", True])
def test_another_value_is_refused_with_what_is_expected(written):
    with pytest.raises(RequestError, match="noise.*expected one of independent, common, or a whole number from 0"):
        plan_of({"noise": written}, CAMERA)


@pytest.mark.parametrize("written", [{"from": 3, "to": 3}, {"from": 0}, {"from": 0.5, "to": 2}, {"normal": [0, 1]}])
def test_another_range_of_draws_is_refused(written):
    with pytest.raises(RequestError, match=r"noise.*two whole numbers \{ from, to \}"):
        plan_of({"design.factors": {"noise": written}}, CAMERA + DESIGN)

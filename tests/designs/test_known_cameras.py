"""What the engine computes over a design is the plain function of its factors, and so are the indices."""

from __future__ import annotations

import numpy as np
import pytest

from etendue_lab.designs.samples import samples_of
from etendue_lab.designs.sensitivity import indices_of
from tests.designs import cameras, functions
from tests.designs.given import ran
from tests.designs.known import ISHIGAMI, G


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return functions.ran(tmp_path_factory.mktemp("functions"))


@pytest.fixture(scope="module")
def camera(tmp_path_factory):
    archive = tmp_path_factory.mktemp("camera") / "a"
    ran(archive, text=cameras.PIPELINE)
    return samples_of(archive)


@pytest.mark.parametrize(("name", "known", "stage"), [("ishigami", ISHIGAMI, "i"), ("g", G, "g")])
def test_a_stage_gives_the_plain_function_and_other_factors_have_no_index(plain, name, known, stage):
    own = {factor.key: factor.values for factor in plain.factors if factor.key.startswith(f"{stage}.")}
    metric = plain.metrics(name)[0]
    assert len(own) == len(known.total) and len(metric.values) == 16 * (10 + 2)
    np.testing.assert_allclose(metric.values, known.function(np.stack(list(own.values()))), rtol=1e-13)
    found = indices_of(plain, metric)
    others = [n for n, factor in enumerate(plain.factors) if factor.key not in own]
    assert found.points == 16 and not found.total[others].any()


@pytest.mark.parametrize("known", cameras.CAMERAS, ids=lambda one: one.name)
def test_metrics_of_a_camera_are_their_closed_forms(camera, known):
    """Up to a constant factor, in dB a constant; quantisation and read noise are below 2e-5 of shot noise."""
    values = {factor.key: factor.values for factor in camera.factors}
    shares = [np.log(values[key] / low) / np.log(high / low) for key, (low, high) in cameras.ENDS.items()]
    metric, truth = camera.metrics(known.name)[0].values, known.function(shares)
    if known.name == "dr_elgamal":
        metric, truth = 10 ** (metric / 20), np.exp(truth)
    ratio = metric / truth
    np.testing.assert_allclose(ratio / ratio.mean(), 1, rtol=2e-5 if known.name == "mean_snr" else 1e-9)


@pytest.mark.parametrize("known", cameras.CAMERAS, ids=lambda one: one.name)
def test_first_order_indices_sum_to_one_without_products_and_total_ones_to_more(known):
    assert known.first.sum() <= 1 + 1e-12 and known.total.sum() >= 1 - 1e-12
    assert (known.first <= known.total + 1e-15).all()
    assert (known.first.sum() == pytest.approx(1)) == (known.name == "dr_elgamal")

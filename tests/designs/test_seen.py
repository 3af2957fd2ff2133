"""What people see of a design: one axis of samples with its factors, in plots and on the page."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.present.page.figures import figures
from etendue.present.page.opened import Opened
from etendue.present.plots.asked import PlotRequest
from etendue.present.plots.holdings import Holdings
from etendue.present.plots.kinds import draw, kind_of
from etendue.present.plots.opening import opened
from etendue.present.plots.rows import factors_of
from tests.designs.given import plan_of, ran

METRICS = ("airy_diameter", "cutoff_frequency")


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("seen") / "a"
    ran(folder, {"design.points": 16})
    return folder


def test_a_page_has_one_axis_of_samples_and_every_metric_along_it(archive):
    page = Opened(archive)
    assert [axis.dim for axis in page.axes] == ["sample"]
    assert all("/" in words for words in page.axes[0].factors)  # f/2.5, ...
    found = {one.variable: one for one in figures(page)[0]}
    airy = found["airy_diameter"]
    assert airy.axes == ("sample",) and len(np.unique(airy.values)) == 3 < len(airy.values) == 16


def test_plots_have_every_metric_along_the_samples(archive):
    holdings = Holdings(opened(archive))
    assert set(holdings.axes) == {"sample"}
    sample = plan_of({"design.points": 16}).axis("sample")
    own = {one.name: one for one in factors_of(holdings, "sample")}
    for number, factor in enumerate(sample.factors):
        assert tuple(own[factor.dim].values[row] for row in sample.values) == sample.column(number)
    assert kind_of(holdings, "") == ("parallel", ())


@pytest.mark.parametrize("kind", ["parallel", "scatter"])
def test_every_sample_is_drawn_with_its_factors_and_metrics(archive, kind):
    made = draw(Holdings(opened(archive)), kind, PlotRequest(METRICS))
    assert len(made.rows) == 16
    assert made.columns[0] == "row" and len(made.columns) == 1 + 3 + len(METRICS)
    assert made.data("png").startswith(b"\x89PNG")


@pytest.mark.parametrize("kind", ["indices", "convergence", "yield"])
def test_studies_of_a_design_are_plots_too(archive, kind):
    made = draw(Holdings(opened(archive)), kind, PlotRequest(("airy_diameter",)))
    assert made.rows and made.data("png").startswith(b"\x89PNG")

"""How a page opens: the camera to build lies on the front of detail against noise and gives up least; no figure
stands twice.
"""

import itertools

import numpy as np
import pytest

from etendue.present.page.document import document, start_of
from etendue.present.page.figures import MetricColumn
from etendue.present.page.opened import ArchivedAxis, Opened
from etendue.present.page.opening import MOST_OPEN, opening

F, T = (
    ArchivedAxis("f_number", "f_number", "f-number", "", (2.0, 4.0, 8.0)),
    ArchivedAxis("t", "t", "time", "s", (1.0, 2.0)),
)
P = ArchivedAxis("p", "p", "pitch", "um", (1.0, 2.0, 3.0))
AXES = (F, T, P)
EMPTY = {"stage": np.array([]), "error": np.array([]), "bound": np.array([]), "how": np.array([]), "at": {}}


def figure(variable, values, axes=("f_number", "t", "p"), stage="numbers", units="", dims=(), meanings=()):
    return MetricColumn(stage, variable, variable, units, tuple(axes), dims, np.asarray(values, float), {}, meanings)


def drawn(seed=1, units=""):
    """A camera's figures over three axes, drawn at random: detail, its double in other words, noise, clipping."""
    rng = np.random.default_rng(seed)
    detail, snr, clipped = (
        rng.uniform(20, 200, (3, 3)),
        rng.uniform(1, 100, (3, 2, 3)),
        rng.choice([0, 0, 0.2], (3, 2, 3)),
    )
    return [
        figure("mtf50_lp_mm", detail, ("f_number", "p")),
        figure("effective_lp_mm", detail, ("f_number", "p")),
        figure("mean_snr", snr, units=units),
        figure("clipped_fraction", clipped),
        figure("fit_condition", rng.uniform(1, 2, 3), ("p",)),
        figure("plate_scale", rng.uniform(1, 2, 3), ("p",)),
        figure("fit_residual", rng.uniform(0, 1, (3, 2, 3))),
        figure("gamut_clipped", rng.uniform(0, 1, (3, 2, 3))),
    ]


def opened(figures, axes=AXES):
    return opening(figures, axes, {axis.dim: 0 for axis in axes}, EMPTY)


@pytest.mark.parametrize("seed", range(20))
def test_the_choice_is_not_clipped_and_no_other_keeps_more_of_both(seed):
    figures = drawn(seed)
    made = opened(figures)["front"]
    detail, snr, clipped = figures[1].values[:, None, :] * np.ones((1, 2, 1)), figures[2].values, figures[3].values
    place = tuple(made["place"][axis.dim] for axis in AXES)
    usable = clipped <= 0.01
    shares = np.stack([detail / detail[usable].max(), snr / snr[usable].max()])
    assert usable[place] and made["burnt"] == (~usable).sum()
    assert made["shares"] == pytest.approx(shares[(slice(None), *place)].tolist())
    least = np.where(usable, shares.min(axis=0), -1)
    assert least[place] == least.max()
    for cell in itertools.product(*map(range, usable.shape)):
        beaten = detail[cell] > detail[place] and snr[cell] > snr[place]
        assert not (usable[cell] and beaten)


def test_the_front_is_of_detail_against_noise_and_of_what_a_sweep_moves_instead():
    figures = drawn()
    names = lambda made: made and [made["x"]["variable"], made["y"]["variable"]]  # noqa: E731
    assert names(opened(figures)["front"]) == ["effective_lp_mm", "mean_snr"]
    still = [figure("effective_lp_mm", 100.0, ()), *figures[2:]]
    assert names(opened(still)["front"]) == ["mean_snr", "clipped_fraction"]
    assert opened(figures[4:6])["front"] is None  # nobody says which way is better
    alone = [figure(one.variable, one.values.flat[0], ()) for one in figures]
    assert opened(alone, ())["front"] is None and opened(alone, ())["place"] == {}
    assert opened([], ()) == {
        "front": None,
        "place": {},
        "limits": [],
        "open": [],
        "subjects": [],
        "error": opened(alone, ())["error"],
    }


def test_the_choice_does_not_ask_for_the_unit():
    plain = opened(drawn())["front"]["place"]
    longer = [figure(f.variable, f.values * (1e3 if "lp_mm" in f.variable else 1), f.axes) for f in drawn()]
    assert opened(longer)["front"]["place"] == plain
    decibels = [
        figure(f.variable, 20 * np.log10(f.values), units="dB") if f.variable == "mean_snr" else f for f in drawn()
    ]
    assert opened(decibels)["front"]["place"] == plain


def test_where_every_camera_clips_the_best_of_them_is_chosen():
    figures = [
        figure("clipped_fraction", np.ones((3, 2, 3))) if f.variable == "clipped_fraction" else f for f in drawn()
    ]
    made = opened(figures)["front"]
    assert made["burnt"] == made["cells"] == 18 and made["place"]


def checked(made, figures):
    open_, folded = made["open"], [tuple(one) for subject in made["subjects"] for one in subject["figures"]]
    assert len(open_) <= MOST_OPEN
    assert len({one["variable"] for one in open_}) == len(open_)
    assert sorted(folded) == sorted((one.stage, one.variable) for one in figures)  # each once
    return {one["variable"] for one in open_}


def test_at_most_eight_figures_stand_open_none_twice_and_every_one_in_its_fold():
    seen = checked(opened(drawn()), drawn())
    assert seen == {
        "effective_lp_mm",
        "mean_snr",
        "clipped_fraction",
        "fit_residual",
    }  # no condition, no plate scale, no MTF50 again
    unknown = [figure(f"own_{n}", np.full(3, float(n)), ("p",)) for n in range(20)]
    assert len(checked(opened(unknown), unknown)) == MOST_OPEN
    twice = [figure("mean_snr", np.ones((3, 2, 3)), stage="one"), figure("mean_snr", np.ones((3, 2, 3)), stage="two")]
    assert checked(opened(twice), twice) == {"mean_snr"}


def test_what_limits_is_the_factor_at_the_choice_and_what_it_is_worth():
    index = figure("limiting_factor", [0, 1, 0], ("f_number",), meanings=("lens", "geometry"))
    gain = figure("resolution_gain", [[3, 1], [1, 2], [5, 1]], ("f_number",), dims=("factor",))
    detail, noise = figure("mtf50", [9, 8, 1], ("f_number",)), figure("mean_snr", [1, 8, 9], ("f_number",))
    made = opened([index, gain, detail, noise], (F,))
    assert made["place"] == {"f_number": 1}
    assert [(one["factor"], one["gain"], one["capped"]) for one in made["limits"]] == [("geometry", 2.0, None)]
    assert [(one["place"], one["values"]) for one in made["front"]["beside"]] == [(0, [9, 1]), (2, [1, 9])]


def test_detail_beyond_the_nyquist_frequency_is_said_to_be_capped():
    index = figure("limiting_factor", [0, 1], ("t",), meanings=("geometry", "sampling"))
    gain = figure("resolution_gain", [[2.3, 1.26], [1.1, 1.4]], ("t",), dims=("factor",))
    (limit,) = opened([index, gain], (T,))["limits"]
    assert (limit["factor"], limit["gain"], limit["capped"]) == ("geometry", 2.3, 1.26)


def test_the_page_of_an_archive_opens_at_the_choice_and_with_its_error(archive):
    own = Opened(archive)
    made = document(own, {})
    first = made["opening"]
    assert first["front"]["kinds"][0] == "noise"  # no stage of it tells what is resolved
    assert made["start"] == {**start_of(own), **first["front"]["place"]}
    stages = {row["name"]: row for row in made["stages"]}
    assert first["error"]["largest"] <= max(row["error"] for row in stages.values() if row["error"] is not None)
    assert first["error"]["largest"] >= stages["exposure_report"]["error_least"]

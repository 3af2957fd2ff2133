"""What stands in a plot are the numbers of the archive, each in its place; a front is a front; what failed is
marked.
"""

import numpy as np
import pytest
import xarray
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from etendue.errors import RequestError
from etendue.present.plots.arrangement import PlotDim, arranged
from etendue.present.plots.asked import PlotRequest
from etendue.present.plots.drawing.budget import by_stage
from etendue.present.plots.drawing.curves import curves
from etendue.present.plots.drawing.maps import factor_map, figure_map
from etendue.present.plots.drawing.pareto import front, pareto
from etendue.present.plots.holdings import Holdings
from etendue.present.plots.kinds import OWN, draw, kind_of, listed
from etendue.present.plots.labels import number_text, unit_text, value_text


def texts(axes):
    """The numbers in the cells of a panel, by (row, column)."""
    return {(round(t.get_position()[1]), round(t.get_position()[0])): t.get_text() for t in axes.texts}


def panels(plot):
    return [axes for axes in plot.figure.axes if axes.images]


def test_every_number_of_a_map_stands_in_its_cell(tree, holdings):
    plot = figure_map(holdings, "mean_snr")
    data = tree["exposure_report"].mean_snr
    assert len(panels(plot)) == 2
    for axes, time in zip(panels(plot), (0.002, 0.008), strict=True):
        assert axes.get_title() == value_text(time, "s")
        own = data.sel(integration_time=time).transpose("pixel_pitch", "f_number").values
        assert [t.get_text() for t in axes.get_xticklabels()] == ["f/2", "f/2.8", "f/5.6"]
        assert [t.get_text() for t in axes.get_yticklabels()] == ["3", "4"] and axes.get_ylim()[0] < axes.get_ylim()[1]
        assert texts(axes) == {place: number_text(float(value)) for place, value in np.ndenumerate(own)}
    assert len(plot.rows) == data.size and {tuple(row[:3]): row[3] for row in plot.rows}[0.008, 4.0, 2.0] == float(
        data.sel(f_number=2, pixel_pitch=4, integration_time=0.008)
    )


def test_shapes_of_a_stage_are_one_figure(tree, holdings):
    """encode has a group for each pitch; a map goes over both."""
    held = holdings.find("gamut_clipped")
    values = held.values()
    assert len(held.groups) == 2 and values.sizes == {"f_number": 3, "pixel_pitch": 2, "integration_time": 2}
    for child in tree["encode"].children.values():
        own = child.gamut_clipped
        np.testing.assert_array_equal(values.sel(pixel_pitch=own.pixel_pitch.values).values.astype("f4"), own.values)


def test_axes_in_any_order_are_drawn_in_theirs(tree):
    """An axis that grew stands unsorted in an archive."""
    data = tree["exposure_report"].to_dataset().isel(f_number=[2, 0, 1])
    plot = figure_map(Holdings(data), "mean_snr", at={"integration_time": 0.008})
    assert [t.get_text() for t in panels(plot)[0].get_xticklabels()] == ["f/2", "f/2.8", "f/5.6"]
    assert texts(panels(plot)[0])[0, 0] == number_text(
        float(data.mean_snr.sel(f_number=2, pixel_pitch=3, integration_time=0.008))
    )


def test_a_cell_that_failed_is_marked_and_none_of_its_numbers_is_drawn(tree):
    data = tree["exposure_report"].to_dataset().isel(integration_time=0).copy(deep=True)
    data["status"][0, 0], data["status"][1, 0], data["mean_snr"][0, 0] = 2, 4, 77.0
    data["mean_snr"][2, 1] = np.nan
    plot = figure_map(Holdings(data), "mean_snr")
    own = texts(panels(plot)[0])
    assert own[0, 0] == "×" and (0, 1) not in own and own[1, 2] == "–"
    assert (
        "77" not in own.values()
        and "failed" in plot.figure.get_supxlabel()
        and "not computed" in plot.figure.get_supxlabel()
    )
    assert not any(row[-1] == 77 for row in plot.rows)


def test_a_refusal_calls_the_archive_by_its_name(tree):
    data = tree["exposure_report"].to_dataset()[["status", "mean_snr"]]
    for kind, *names in (("mapp",), ("map", "nothing"), ("pareto",), ("pareto", "mean_snr")):
        with pytest.raises(RequestError, match="etendue plot 'my own' ") as refused:
            draw(Holdings(data, "'my own'"), kind, PlotRequest(tuple(names)))
        assert "ARCHIVE" not in str(refused.value)


@pytest.mark.parametrize(
    "cells", [{"f_number": [0], "pixel_pitch": [0], "integration_time": [0]}, {"f_number": [1]}, {}]
)
def test_any_number_of_axes_is_drawn(tree, cells):
    data = tree["exposure_report"].to_dataset().isel(cells)
    for asked in ("mean_snr", "clipped_fraction"):
        plot = figure_map(Holdings(data), asked)
        assert len(plot.rows) == data.mean_snr.size
        assert len(plot.data("png")) > 1000
    without = data.isel(f_number=0, pixel_pitch=0, integration_time=0)
    assert figure_map(Holdings(without), "mean_snr").rows == [[float(without.mean_snr)]]


def test_what_limits_is_named(tree, holdings):
    plot = factor_map(holdings)
    data, names = tree["resolution"].limiting_factor, tree["resolution"].factor.values.tolist()
    found = {tuple(row[:2]): row[2] for row in plot.rows}
    for f in data.f_number.values:
        for pitch in data.pixel_pitch.values:
            assert found[pitch, f] == names[int(data.sel(f_number=f, pixel_pitch=pitch))]


@given(
    points=arrays.arrays(
        float, st.tuples(st.integers(0, 40), st.sampled_from([2, 3])), elements=st.sampled_from([0.0, 1, 2, 3, np.nan])
    )
)
@settings(max_examples=60, deadline=None)
def test_a_front_is_what_nothing_beats_and_what_beats_the_rest(points):
    on = front(points)
    known = np.isfinite(points).all(axis=1)

    def beaten(one):
        others = points[known]
        return bool(np.any((others >= one).all(axis=1) & (others > one).any(axis=1)))

    assert on.tolist() == [bool(k) and not beaten(p) for k, p in zip(known, points, strict=True)]


def test_a_front_is_of_both_figures_in_the_declared_direction_and_is_named(tree, holdings):
    plot = pareto(holdings, "mean_snr", "clipped_fraction")
    snr, clipped = tree["exposure_report"].mean_snr.values, tree["exposure_report"].clipped_fraction.values
    want = {
        (float(s), float(c))
        for s, c in zip(snr.ravel(), clipped.ravel(), strict=True)
        if not np.any((snr >= s) & (clipped <= c) & ((snr > s) | (clipped < c)))
    }
    assert {tuple(row[-3:-1]) for row in plot.rows if row[-1]} == want
    words = "\n".join(t.get_text() for legend in plot.figure.legends for t in legend.get_texts())
    best = max((row for row in plot.rows if row[-1]), key=lambda row: row[-3])
    assert f"{value_text(best[0], '', 'f_number')}, {value_text(best[1], 'um')}, {value_text(best[2], 's')}" in words
    turned = pareto(holdings, "mean_snr", "clipped_fraction", ["lower", "higher"])
    assert {tuple(r[-3:-1]) for r in turned.rows if r[-1]} != want


def test_figures_over_different_axes_make_one_front(holdings):
    """Dynamic range knows no f-number, resolution no time."""
    plot = pareto(holdings, "mtf50_lp_mm", "dr_elgamal")
    assert plot.columns[:3] == ["f_number", "pixel_pitch", "integration_time"] and len(plot.rows) == 12


def test_a_curve_goes_through_the_numbers(tree, holdings):
    plot = curves(holdings, "mean_snr", x="f_number", lines="pixel_pitch", at={"integration_time": "8 ms"})
    (axes,) = plot.figure.axes
    data = tree["exposure_report"].mean_snr.sel(integration_time=0.008)
    for pitch, line in zip((3.0, 4.0), axes.lines, strict=True):
        np.testing.assert_allclose(line.get_xdata(), data.f_number.values)
        np.testing.assert_allclose(line.get_ydata(), data.sel(pixel_pitch=pitch).values)
        assert line.get_label() == value_text(pitch, "um")


def test_a_curve_over_its_own_dim_may_stand_over_what_lies_beside_it_with_nyquist():
    """As resolution archives its transfer functions: cycles/pixel, with cycles/mm beside it for each pitch."""
    f, pitch = np.linspace(0, 1, 5), np.array([2.0, 4.0])
    mtf = xarray.DataArray(
        np.stack([1 - 0.5 * f, 1 - f])[None] * np.ones((2, 1, 1)),
        dims=("pixel_pitch", "stage", "frequency"),
        name="mtf",
    )
    data = xarray.Dataset(
        {"mtf": mtf, "status": ("pixel_pitch", np.zeros(2, "u1"))},
        {
            "pixel_pitch": ("pixel_pitch", pitch, {"units": "um"}),
            "stage": ["lens", "pixel"],
            "frequency": ("frequency", f, {"units": "cycles/pixel"}),
            "frequency_lp_mm": (("pixel_pitch", "frequency"), f / pitch[:, None] * 1e3, {"units": "cycles/mm"}),
            "nyquist_lp_mm": ("pixel_pitch", 500 / pitch, {"units": "cycles/mm"}),
        },
    )
    holdings = Holdings(data)
    plain = curves(holdings, "mtf")
    assert [a.get_title() for a in plain.figure.axes] == ["2 µm", "4 µm"]
    assert any(line.get_linestyle() == "--" and line.get_xdata()[0] == 0.5 for line in plain.figure.axes[0].lines)
    other = curves(holdings, "mtf", x="frequency_lp_mm", at={"pixel_pitch": 4})
    np.testing.assert_allclose(other.figure.axes[0].lines[0].get_xdata(), f / 4 * 1e3)
    solid, dashed = (
        [line for line in other.figure.axes[0].lines if line.get_linestyle() == style] for style in ("-", "--")
    )
    np.testing.assert_allclose(solid[1].get_ydata(), 1 - f)
    assert [line.get_xdata()[0] for line in dashed] == [125.0]


def test_a_budget_is_the_ledger_by_stage(tree, holdings):
    ledger = tree["ledger"].to_dataset()
    rows = by_stage(holdings)
    assert [row[0] for row in rows] == list(dict.fromkeys(ledger.stage.values.tolist()))
    assert sum(row[1] for row in rows) == ledger.sizes["cell"]
    assert sum(row[5] for row in rows) == pytest.approx(float(ledger.seconds.sum()))


@pytest.mark.long
def test_every_kind_is_drawn_without_a_word_and_saved_the_same_twice(holdings, tmp_path):
    for kind in ("parallel", "scatter"):  # drawn in tests/designs
        with pytest.raises(RequestError, match="holds a grid, not a design"):
            draw(holdings, kind, PlotRequest())
    for kind in (*(OWN.keys() - {"parallel", "scatter"}), "limits"):  # a stage's own kind has a law there
        at = {"f_number": 2, "pixel_pitch": 3, "integration_time": 0.008} if kind == "show" else {}
        assert draw(holdings, kind, PlotRequest(at=at)).figure.axes
    plot = draw(holdings, "limits")
    for ending, begins in (
        ("png", b"\x89PNG"),
        ("svg", b"<?xml"),
        ("pdf", b"%PDF"),
        ("csv", b"pixel_pitch,f_number,limiting_factor"),
    ):
        assert plot.save(tmp_path / f"limits.{ending}").read_bytes().startswith(begins)
    assert draw(holdings, "limits").data("png") == (tmp_path / "limits.png").read_bytes()
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".csv", ".pdf", ".png", ".svg"]


@pytest.mark.parametrize(
    ("word", "kind"),
    [
        ("", "map"),
        ("mean_snr", "map"),
        ("limiting_factor", "limits"),
        ("rgb_display", "show"),
        ("white_radiance", "curves"),
        ("strip", "strip"),
    ],
)
def test_the_name_of_a_variable_says_how_it_is_drawn(holdings, word, kind):
    assert kind_of(holdings, word)[0] == kind
    assert kind_of(holdings, "mean_snr", ["dr_elgamal"]) == ("pareto", ("mean_snr", "dr_elgamal"))


@pytest.mark.parametrize(
    ("kind", "asked", "says"),
    [
        ("map", PlotRequest(("mean_snt",)), "did you mean 'mean_snr'"),
        ("map", PlotRequest(("rgb_display",)), "plot it with show or strip"),
        ("map", PlotRequest(("mean_snr",), x="f_numbr"), "did you mean 'f_number'"),
        ("map", PlotRequest(("mean_snr",), at={"f_number": 3}), "available: 2.0, 2.8, 5.6"),
        ("mp", PlotRequest(), "neither a kind of plot"),
        ("pareto", PlotRequest(("mean_snr", "fit_condition")), "--better fit_condition=higher"),
        ("pareto", PlotRequest(("mean_snr",)), "a front needs two metrics"),
        ("budget", PlotRequest(x="f_number"), "--x is for"),
        ("show", PlotRequest(("rgb_display",)), "choose one value each"),
        ("map", PlotRequest(("mean_snr", "dr_elgamal", "raw")), "map takes 1"),
    ],
)
def test_what_cannot_be_drawn_is_answered_with_what_can(holdings, kind, asked, says):
    with pytest.raises(RequestError, match=says.replace("(", r"\(")):
        draw(holdings, kind, asked)


def test_the_list_names_everything(holdings):
    document = listed(holdings)
    assert document["axes"]["integration_time"] == ["2 ms", "8 ms"]
    assert {one["name"]: one["kind"] for one in document["variables"]}["scene.white_radiance"] == "curve"


@given(sizes=st.lists(st.integers(1, 30), min_size=0, max_size=5), sides=st.sampled_from([1, 2]))
@settings(max_examples=60, deadline=None)
def test_every_dim_has_one_place_and_panels_are_few(sizes, sides):
    dims = [PlotDim(f"d{n}", tuple(range(size))) for n, size in enumerate(sizes)]
    place = arranged(dims, sides)
    placed = [dim.name for dim in (place.x, place.y, *place.panels) if dim] + list(place.fixed)
    assert sorted(placed) == sorted(dim.name for dim in dims)
    assert np.prod([len(dim.values) for dim in place.panels]) <= 16


@pytest.mark.parametrize(
    ("value", "units", "dim", "text"),
    [
        (2.8, "1", "f_number", "f/2.8"),
        (0.008, "s", "integration_time", "8 ms"),
        (5.4, "um", "pixel_pitch", "5.4 µm"),
        ("D65", "1", "illuminant", "D65"),
        (1, "s", "", "1 s"),
        (2e-5, "s", "", "20 µs"),
    ],
)
def test_values_are_written_as_people_say_them(value, units, dim, text):
    assert value_text(value, units, dim) == text
    assert [unit_text(u) for u in ("um-1", "mm-1", "electron um-2", "W m-2 nm-1")] == [
        "cycles/µm",
        "lp/mm",
        "electrons µm⁻²",
        "W m⁻² nm⁻¹",
    ]

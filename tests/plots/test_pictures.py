"""Pictures stand upright, with their true aspect and colours; what is not there is striped."""

import numpy as np
import pytest
import xarray
from click.testing import CliRunner
from PIL import Image

import etendue
from etendue.cli import main
from etendue.contract.arrays.drawn import Drawn
from etendue.contract.arrays.grid import Grid, Line
from etendue.errors import RequestError
from etendue.present.pictures import contact_sheet, details, small_maps
from etendue.present.pictures.appearance import HATCH, appearance
from etendue.present.plots import engine, pictures
from etendue.present.plots.drawing.strip import show_array, strip

AT = {"f_number": 2, "pixel_pitch": 3, "integration_time": "8 ms"}


def seen(plot):
    """The picture of a plot as it comes out on the page: (y, x, 3) bytes of its largest axes."""
    import io

    page = np.asarray(Image.open(io.BytesIO(plot.data("png"))).convert("RGB"))
    axes = max(plot.figure.axes, key=lambda a: a.get_position().width * a.get_position().height)
    box, (high, wide) = axes.get_position(), page.shape[:2]
    return page[round((1 - box.y1) * high) : round((1 - box.y0) * high), round(box.x0 * wide) : round(box.x1 * wide)]


def encoded(values):
    return xarray.DataArray(
        np.stack([values] * 3), dims=("channel", "y", "x"), coords={"channel": ["R", "G", "B"]}, name="rgb_display"
    )


@pytest.mark.parametrize("shape", [(6, 10), (10, 6), (1, 7), (64, 48), (700, 350)])
def test_the_first_row_is_drawn_on_top_and_width_to_height_is_true(shape):
    rows = np.linspace(1, 0, shape[0])[:, None] if shape[0] > 1 else np.ones((1, 1))
    columns = np.linspace(1, 0.5, shape[1])[None]
    page = seen(show_array(encoded(rows * columns))).astype(float)
    high, wide = page.shape[:2]
    assert abs(high * shape[1] - wide * shape[0]) <= max(shape)  # a dot
    assert shape[0] == 1 or page[: high // 4].mean() > page[-high // 4 :].mean()
    assert page[:, : wide // 4].mean() > page[:, -wide // 4 :].mean()


def test_samples_are_squares_of_whole_dots_with_their_values():
    values = np.random.default_rng(0).random((5, 8))
    page = seen(show_array(encoded(values)))
    times = page.shape[0] // 5
    assert page.shape[:2] == (5 * times, 8 * times)
    np.testing.assert_array_equal(
        page[times // 2 :: times, times // 2 :: times, 0], np.rint(255 * values).astype(np.uint8)
    )


def test_light_of_a_white_is_grey_and_of_a_red_is_red():
    middles = np.arange(405, 700, 10.0)

    def light(values):
        array = xarray.DataArray(
            np.ones((len(middles), 2, 2)) * values[:, None, None], dims=("wavelength", "y", "x"), name="radiance"
        )
        return pictures.drawn(array.assign_coords(wavelength=middles))[0, 0].astype(int)

    red = light((middles > 600).astype(float))
    assert red[0] > 150 > 60 > red[1]


def test_a_mosaic_has_the_colours_of_its_filters_as_its_window_sees_them():
    array = xarray.DataArray(
        np.full((4, 4), 100.0), dims=("y", "x"), name="raw", attrs={"drawn_as": "linear", "drawn_pattern": "RG/GB"}
    )
    picture = pictures.drawn(array).astype(int)
    assert (
        picture[0, 0, 0] > picture[0, 0, 2]
        and picture[1, 1, 2] > picture[1, 1, 0]
        and picture[0, 1, 1] > picture[0, 1, 0]
    )
    moved = pictures.drawn(array.assign_coords(y=[1.0, 2, 3, 4], x=[1.0, 2, 3, 4])).astype(int)
    np.testing.assert_array_equal(moved[0, 0], picture[1, 1])


def test_what_is_not_there_is_striped_and_said():
    values = np.ones((12, 12)) * 0.5
    values[:6] = np.nan
    picture = pictures.drawn(encoded(values))
    colours = {tuple(c) for c in picture[:6].reshape(-1, 3).tolist()}
    assert colours == set(HATCH) and {tuple(c) for c in picture[6:].reshape(-1, 3).tolist()} == {(128, 128, 128)}
    assert "no values" in show_array(encoded(np.full((4, 4), np.nan))).notes[0]
    assert {tuple(c) for c in pictures.drawn(encoded(np.ones((9, 9))), failed=True).reshape(-1, 3).tolist()} == set(
        HATCH
    )


def test_a_cell_that_failed_is_shown_as_such(tree):
    data = tree["encode"]["12x16"].to_dataset().copy(deep=True)
    data["status"][0, 0, 1] = 2
    plot = data.etendue.show("rgb_display", **AT)
    assert "failed" in plot.notes[0]
    assert data.etendue.show("rgb_display", **{**AT, "f_number": 2.8}).notes == []


def test_the_same_picture_by_every_way(archive, tree):
    array = tree["encode"]["12x16"].rgb_display
    page = seen(etendue.show(array, **AT))
    for other in (
        etendue.show(tree, "rgb_display", **AT),
        etendue.show(archive, **AT),
        tree.etendue.plot.show("encode.rgb_display", **AT),
        array.sel(f_number=2, pixel_pitch=3, integration_time=0.008).etendue.show(),
    ):
        np.testing.assert_array_equal(seen(other), page)
    own = array.sel(f_number=2, pixel_pitch=3, integration_time=0.008).values
    times = page.shape[0] // own.shape[1]
    np.testing.assert_array_equal(
        page[times // 2 :: times, times // 2 :: times], np.rint(255 * np.moveaxis(own, 0, -1)).astype(np.uint8)
    )
    with pytest.raises(RequestError, match="choose a value of f_number"):
        etendue.show(array)
    with pytest.raises(AttributeError, match="available: map, curves"):
        tree.etendue.plot.pie()


@pytest.mark.long
def test_xarray_opens_the_folder_of_an_archive(archive):
    backend = engine.EtendueBackend()
    assert (
        backend.guess_can_open(archive) and not backend.guess_can_open(archive.parent) and not backend.guess_can_open(7)
    )
    tree = backend.open_datatree(archive)
    xarray.testing.assert_identical(backend.open_dataset(archive, group="resolution"), tree["resolution"].to_dataset())


def test_a_strip_has_every_stage_in_order_with_the_same_place_of_each(tree, holdings):
    plot = strip(holdings)
    frames = tree["frames"].to_dataset()
    assert [row[0] for row in plot.rows] == [str(s).split(".")[0] for s in frames.stage.values]
    assert len([a for a in plot.figure.axes if a.images]) == 2 * len(plot.rows)
    other = strip(holdings, at=AT)
    assert {row[0] for row in other.rows} >= {"scene", "pixel", "adc", "encode"}
    assert [r[0] for r in strip(holdings, "rgb_display", at={"pixel_pitch": 3, "integration_time": 0.002}).rows] == [
        "f/2",
        "f/2.8",
        "f/5.6",
    ]


@pytest.mark.parametrize("words", [["--list"], ["mean_snr", "dr_elgamal", "-o", "b.svg", "--json"]])
def test_the_command_draws(archive, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, ["plot", str(archive), *words])
    assert done.exit_code == 0, done.output
    assert words == ["--list"] or any(tmp_path.iterdir())


def test_the_command_refuses_with_a_way_out(archive, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for words, says in (
        (["map", "mean_snt"], "mean_snr"),
        (["-o", "a.txt"], ".svg"),
        (["map", "--at", "f_number"], "axis=value"),
    ):
        done = CliRunner().invoke(main, ["plot", str(archive), *words])
        assert done.exit_code == 2 and says in done.output + (done.stderr or "")
    assert not any(tmp_path.iterdir())


def test_png_export_is_the_picture_in_true_colour(archive, tree, tmp_path):
    at = [word for name, value in {**AT, "integration_time": "8ms"}.items() for word in ("--at", f"{name}={value}")]
    done = CliRunner().invoke(main, ["export", str(archive), "--png", *at, "--output", str(tmp_path / "one.png")])
    assert done.exit_code == 0, done.output
    own = tree["encode"]["12x16"].rgb_display.sel(f_number=2, pixel_pitch=3, integration_time=0.008).values
    with Image.open(tmp_path / "one.png") as picture:
        assert picture.mode == "RGB" and "plotted" in picture.text["Description"]
        np.testing.assert_array_equal(
            np.asarray(picture), np.rint(255 * np.clip(np.moveaxis(own, 0, -1), 0, 1)).astype(np.uint8)
        )
    done = CliRunner().invoke(
        main, ["export", str(archive), "--png", "--variable", "radiance", "--output", str(tmp_path / "light.png")]
    )
    assert done.exit_code == 0 and Image.open(tmp_path / "light.png").size == (60, 45)
    assert CliRunner().invoke(main, ["export", str(archive), "--png", "--variable", "mean_snr"]).exit_code == 2


# -- the contact sheet ----------------------------------------------------------------------------------------


def test_the_part_shows_an_edge_and_not_a_ramp_or_a_texture():
    picture = np.full((120, 120, 3), 0.4) + np.random.default_rng(1).normal(0, 0.01, (120, 120, 1))
    picture[10:50, 10:50] = np.linspace(0.1, 0.9, 40)[:, None]  # a ramp
    picture[70:110, 10:50] = (np.indices((40, 40)).sum(axis=0) % 2)[..., None] * 0.8 + 0.1  # a texture
    picture[30:100, 90:] = 0.85  # an edge
    top, left = details.part_of(picture, 22)
    window = picture[top : top + 22, left : left + 22, 0]
    assert left + 22 > 90 and window.std() > 0.15  # its height or its side, not the ramp, the texture or the noise


def test_the_same_place_of_the_scene_is_kept_in_every_stage():
    fine = Grid.of({"y": Line(900, 0.0, 0.5), "x": Line(1200, 0.0, 0.5)})
    coarse = Grid.of({"y": Line(100, 0.0, 1.0, "pixel", (20.0, 4.0)), "x": Line(140, 0.0, 1.0, "pixel", (10.0, 4.0))})
    window = details.kept_window([fine, coarse])
    for grid in (fine, coarse):
        y, x = details.lines_of(grid)
        sides = (y, window.rows(y), window.top, window.bottom), (x, window.columns(x), window.left, window.right)
        for line, (first, last), low, high in sides:
            start, step = line.um()
            assert abs(start + (first - 0.5) * step - low) <= step or first == 0
            assert abs(start + (last - 0.5) * step - high) <= step or last == line.size
    first, last = window.columns(details.lines_of(coarse)[1])
    assert (first, last) == (0, 140) and np.ptp(window.columns(details.lines_of(fine)[1])) == 1120


def table(shapes):
    """Frames as a run leaves them: each brighter on top, with a part."""
    high, wide = max(s[0] for s in shapes), max(s[1] for s in shapes)
    preview = np.zeros((len(shapes), 3, high, wide), np.uint8)
    for number, (y, x) in enumerate(shapes):
        preview[number, :, :y, :x] = np.linspace(250, 50, y).astype(np.uint8)[:, None]
    count = len(shapes)
    own = {
        "preview": preview,
        "detail": np.full((count, 3, 9, 9), 90, np.uint8),
        "stage": [f"stage{n}" for n in range(count)],
        "variable": ["raw"] * count,
        "true_height": [s[0] for s in shapes],
        "true_width": [s[1] for s in shapes],
        "height": [s[0] for s in shapes],
        "width": [s[1] for s in shapes],
        "detail_height": [9] * count,
        "detail_width": [9] * count,
        "detail_place": np.full((count, 4), 0.25),
    }
    return {"arrays": {name: ((), np.asarray(values), {}) for name, values in own.items()}}


@pytest.mark.parametrize(
    "shapes", [[(256, 256)] * 3, [(192, 256), (90, 120)], [(17, 9)], [(180, 240)] * 9, [(1, 200)], [(256, 3)]]
)
def test_pictures_of_a_sheet_are_upright_with_their_aspect_and_fill_their_tiles(shapes, tmp_path):
    tiles = contact_sheet._tiles(table(shapes))
    longest = {max(t.picture.shape[:2]) for t in tiles}
    assert len(longest) == 1 and min(longest) >= 150
    for (y, x), tile in zip(shapes, tiles, strict=True):
        assert abs(tile.picture.shape[0] / tile.picture.shape[1] - y / x) < 0.02 * y / x + 1 / tile.picture.shape[1]
        assert y == 1 or tile.picture[0].mean() > tile.picture[-1].mean()
        assert max(tile.part.shape) <= details.SIDE
    contact_sheet.contact_sheet(table(shapes), tmp_path / "sheet.png", "a title that is long " * 20)
    with Image.open(tmp_path / "sheet.png") as sheet:
        page = np.asarray(sheet.convert("RGB")).astype(int)
    for edge in (page[:, :4], page[:, -4:]):
        assert (edge == 255).all()  # nothing is cut off


def test_a_white_picture_has_a_rim_and_is_said_to_be_white(tmp_path):
    shapes = [(64, 64), (64, 64)]
    blank = table(shapes)
    blank["arrays"]["preview"][1][:] = 255
    first = contact_sheet._tiles(blank)[0]
    assert first.text[1].endswith("64 x 64, all white")
    contact_sheet.contact_sheet(blank, tmp_path / "sheet.png", "t")
    with Image.open(tmp_path / "sheet.png") as sheet:
        page = np.asarray(sheet.convert("RGB"))
    left, middle = contact_sheet.GAP, contact_sheet.HEAD + contact_sheet.LABEL + len(first.picture) // 2
    assert (page[middle, left - 1] == contact_sheet.RIM).all() and (page[middle, left] == 255).all()


def test_maps_on_the_sheet_have_every_number_in_its_place_and_are_drawn_anew_below_the_same_pictures(tmp_path):
    one = small_maps.SmallMap(
        "s",
        "v",
        "dB",
        (("f_number", (2.0, 4.0, 8.0), ""), ("pitch", (1.0, 2.0), "um")),
        tuple(("s", (i,)) for i in range(6)),
        "",
    )
    figures = {("s", (i,)): {"v": np.array(float(i))} for i in range(5)}
    values = small_maps.values_of(one, figures)
    np.testing.assert_array_equal(values, [[0, 1, 2], [3, 4, np.nan]])
    (drawn,) = small_maps.all_drawn([one], figures, [("s", (5,))])
    darkness = [drawn[22 + 3 + 24 * (1 - r), :, :].astype(int).sum(axis=-1) for r in (0, 1)]
    assert (
        any((row == sum(small_maps.FAILED)).any() for row in darkness[1:])
        and not (darkness[0] == sum(small_maps.FAILED)).any()
    )
    shapes = table([(64, 64)])
    contact_sheet.contact_sheet(shapes, tmp_path / "a.png", "t")
    contact_sheet.with_maps(tmp_path / "b.png", tmp_path / "a.png", [drawn])
    contact_sheet.with_maps(tmp_path / "c.png", tmp_path / "b.png", [])
    a, b, c = (np.asarray(Image.open(tmp_path / f"{name}.png").convert("RGB")) for name in "abc")
    np.testing.assert_array_equal(a, c)
    np.testing.assert_array_equal(a, b[: a.shape[0]])
    assert b.shape[0] > a.shape[0]


def test_a_sweep_that_grows_has_its_new_cells_on_the_sheet(tmp_path):
    from etendue.contract.registry import installed_stages
    from etendue.plan.planner import make_plan
    from etendue.session import Options, execute, from_document

    def ran(values):
        document = {
            "name": "grows",
            "camera": {"pixel_pitch": 3, "f_number": 4, "peak_qe": [0.5, 0.5, 0.5], "integration_time": 0.01},
            "stages": [
                {
                    "use": "slanted_edge",
                    "name": "scene",
                    "width": 60,
                    "height": 60,
                    "white_luminance": 100,
                    "bin_width": 100,
                },
                {"use": "irradiance"},
                {"use": "pixel"},
                {"use": "lens_numbers"},
            ],
            "sweep": {"f_number": values},
        }
        outcome = execute(make_plan(from_document(document), installed_stages()), tmp_path / "a", Options("serial"))
        assert not outcome.failed
        return np.asarray(Image.open(tmp_path / "a" / "contact_sheet.png").convert("RGB"))

    before, after = ran([2.0, 4.0]), ran([2.0, 4.0, 8.0])
    assert after.shape != before.shape or not np.array_equal(after, before)
    rows = min(before.shape[0], after.shape[0]) - 120
    if after.shape[1] == before.shape[1]:
        np.testing.assert_array_equal(after[40:rows], before[40:rows])  # the pictures are the same


@pytest.mark.parametrize("how", ["mosaic", "planes", "encoded"])
def test_the_window_kept_of_a_large_picture_is_the_same_when_it_comes_row_by_row(how):
    """And that of the whole, in its colours, also from an odd row and column on."""
    from etendue.present.pictures import thumbnails

    drawn = Drawn("encoded" if how == "encoded" else "linear", pattern="RGGB" if how == "mosaic" else "")
    dims = ("y", "x") if how == "mosaic" else ("channel", "y", "x")
    seen = appearance(drawn, dims, channels=("R", "G", "B"))
    view = thumbnails.View(seen, rows=(131, 164), columns=(101, 135))
    array = np.random.default_rng(2).random((300, 280) if how == "mosaic" else (3, 300, 280)).astype(np.float32)
    gathered = view.gathering(array.shape)
    for start in range(0, 300, 37):
        gathered.take(start, array[..., start : start + 37, :])
    whole, rowed = view.of(array), gathered.made()
    np.testing.assert_array_equal(whole.window, rowed.window)
    assert whole.first == rowed.first == (131, 101) and whole.window.shape == (3, 33, 34)
    np.testing.assert_array_equal(whole.window, seen.rgb(array)[:, 131:164, 101:135])
    own = whole.window.sum(axis=0) if how == "mosaic" else whole.window
    np.testing.assert_array_equal(own, array[..., 131:164, 101:135])

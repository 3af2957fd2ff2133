"""The document of a page: its figures are the archive's, in every cell; what was not computed is not there."""

import shutil

import numpy as np
import pytest
import xarray

from etendue.archive.journaling.entries import Entry
from etendue.archive.journaling.journal import Journal
from etendue.present.page.document import document, start_of
from etendue.present.page.looks import picture, pictured
from etendue.present.page.opened import Opened
from etendue.present.page.report import reported
from etendue.present.page.shots import chosen, shots
from tests.page.conftest import HOSTILE, unpacked


@pytest.fixture(scope="module")
def made(archive):
    return document(Opened(archive), {})


def test_every_figure_is_the_store_s_with_its_axes_ascending(archive, made):
    tree = xarray.open_datatree(archive / "data.zarr", engine="zarr")
    assert [axis["values"] for axis in made["axes"]] == [[2.0, 4.0, 8.0], [0.002, 0.008]]
    assert {"white", "colour_matrix", "mean_snr", "airy_diameter", "white_radiance"} <= {
        one["variable"] for one in made["figures"]
    }
    for one in made["figures"]:
        stored = tree[one["stage"]].dataset
        array = stored[one["variable"]]
        whole = array.sortby([dim for dim in one["axes"]]).transpose(
            *one["axes"], *(dim["name"] for dim in one["dims"])
        )
        np.testing.assert_array_equal(
            unpacked(made, one["data"]).reshape(whole.shape), whole.to_numpy().astype(np.float32)
        )
        for dim in one["dims"]:
            first = dim["coordinates"][0]
            values = first["labels"] if "labels" in first else unpacked(made, first["data"]).tolist()
            assert values == stored[dim["name"]].to_numpy().tolist()


def test_the_rows_of_cells_are_the_ledger(archive, made):
    ledger = xarray.open_dataset(archive / "data.zarr", engine="zarr", group="ledger")
    cells = made["cells"]
    for name in ("stage", "how", "status"):
        column = cells["columns"][name]
        words = np.array(column["words"], dtype=object)[unpacked(made, column)]
        assert words.tolist() == ledger[name].to_numpy().tolist()
    np.testing.assert_array_equal(
        unpacked(made, cells["columns"]["error"]), ledger["error"].to_numpy().astype(np.float32)
    )
    places = unpacked(made, cells["at"]["f_number"])
    values = np.append(made["axes"][0]["values"], np.nan)[places]
    np.testing.assert_array_equal(values, ledger["at_f_number"].to_numpy())


def test_texts_of_strangers_are_kept_as_they_are(made):
    assert made["description"] == HOSTILE


def test_an_interrupted_run_shows_what_is_finished_and_no_more(archive, made, tmp_path):
    folder = tmp_path / "cut"
    shutil.copytree(archive, folder)
    (folder / "manifest.json").unlink()
    lines = (folder / "journal.jsonl").read_bytes().split(b"\n")
    wanted = [n for n, line in enumerate(lines) if b'"event":"done"' in line and b'"cell":"exposure_report ' in line]
    kept = [line for n, line in enumerate(lines) if n not in wanted[2:]]
    (folder / "journal.jsonl").write_bytes(b"\n".join(kept))
    journal = Journal(folder)
    journal.open()
    name = "exposure_report f_number=4.0 integration_time=0.008"
    journal.end([(name, Entry("failed", "0", status="failed"))])
    journal.close()
    found = document(Opened(folder), {})
    snr = next(one for one in found["figures"] if one["variable"] == "mean_snr")
    before = next(one for one in made["figures"] if one["variable"] == "mean_snr")
    values, all_values = unpacked(found, snr["data"]), unpacked(made, before["data"])
    known = np.isfinite(values)
    assert known.sum() == 2 and np.array_equal(values[known], all_values[known])
    assert not found["ended"] and not found["running"]
    assert [(row["stage"], row["cells"]) for row in found["failures"]["rows"]] == [("exposure_report", 1)]


def test_a_picture_of_display_values_is_the_contact_sheet_s(archive):
    opened = Opened(archive)
    frames = xarray.open_dataset(archive / "data.zarr", engine="zarr", group="frames")
    at = start_of(opened)
    one = picture(opened, "encode", "rgb_display", at)
    sheet = frames["preview"].sel(stage="encode").to_numpy()[:, :12, :18]
    np.testing.assert_array_equal(np.moveaxis(one.eight_bit(), -1, 0), sheet)


def test_light_is_seen_as_the_camera_s_display_sees_it(archive):
    """A neutral patch under the pipeline's light is neutral in no stage of the light, but every stage shows it in
    one hue.
    """
    opened = Opened(archive)
    scene, light = (
        picture(opened, stage, variable, {})
        for stage, variable in (("scene", "radiance"), ("irradiance", "irradiance"))
    )
    share = [one.linear / one.linear.sum(axis=0) for one in (scene, light)]
    np.testing.assert_allclose(
        share[0], share[1], rtol=2e-5, atol=2e-6
    )  # irradiance is radiance times a constant; float32


def test_a_mosaic_is_seen_through_its_filters(archive):
    opened = Opened(archive)
    one = picture(opened, "adc", "raw", {"f_number": 0, "integration_time": 0})
    shown = one.linear
    letters = one.filter_letters()
    assert [letters[0, 0], letters[0, 1], letters[1, 1]] == ["R", "G", "B"]
    for number, letter in enumerate("RGB"):
        assert not shown[number][letters != letter].any()
        np.testing.assert_array_equal(
            shown[number][letters == letter], np.maximum(one.array.astype(np.float32) - 64, 0)[letters == letter]
        )


@pytest.mark.parametrize(
    "sizes", [[], [1], [5], [64], [1000], [10, 10, 10], [3, 2, 2], [2] * 7, [10, 1660], [1, 7, 1, 9]]
)
def test_chosen_cells_hold_corners_and_the_start(sizes):
    start = [size // 2 for size in sizes]
    found = chosen(sizes, start)
    whole = int(np.prod(sizes, dtype=int))
    assert len(found) == len(set(found)) <= 64 and tuple(start) in found
    assert all(0 <= place < size for one in found for place, size in zip(one, sizes, strict=True))
    if whole <= 64:
        assert len(found) == whole
    if 2 ** sum(size > 1 for size in sizes) < 64:
        assert {tuple(0 for _ in sizes), tuple(size - 1 for size in sizes)} <= set(found)


def test_pictures_keep_to_their_budget_and_say_what_is_left_out(archive):
    opened = Opened(archive)
    start = {"f_number": 1, "integration_time": 1}
    large, small = shots(opened, start), shots(opened, start, budget=1000)
    assert [one["stage"] for one in large["strip"]] == [stage for stage, _ in pictured(opened)]
    assert set(map(tuple, large["series"][0]["sizes"].values())) == {(18, 12)}
    assert (
        len(large["series"][0]["pictures"]) == 6 and large["series"][0]["how"] == "lossless" and not large["left_out"]
    )
    assert (
        sum(len(one["pictures"]) for one in small["series"]) < sum(len(one["pictures"]) for one in large["series"])
        and small["left_out"]
    )


def test_what_is_damaged_is_named_and_not_shown(archive, tmp_path):
    folder = tmp_path / "damaged"
    shutil.copytree(archive, folder)
    shard = next(path for path in (folder / "data.zarr/encode/rgb_display").rglob("c*") if path.is_file())
    data = bytearray(shard.read_bytes())
    data[40] ^= 255
    shard.write_bytes(data)
    made = reported(Opened(folder))
    assert len(made["damaged"]) == 1 and made["damaged"][0].startswith("rgb_display of encode f_number=")
    assert len(next(one for one in made["pictures"]["series"] if one["variable"] == "rgb_display")["pictures"]) == 5

"""What a distribution brings looks like what is built in: in the lists, in the archive, on the contact sheet, in a
comparison.

``tests/plugins/halation`` is a whole distribution with a stage of a new role and a variable, a camera quantity, a
sensor and two tables of its own.
"""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import xarray

from tests.cli.test_plugins import hook, install
from tests.fresh import process
from tests.page.conftest import embedded_document

SITE = Path(__file__).parents[1] / "plugins" / "halation"
FROM = "etendue-halation"
PIPELINE = """
name = "film"
precision = "float32"
[camera]
sensor = "halation-film"
illuminant = "halation lamp"
[[stages]]
use = "slanted_edge"
name = "scene"
white_luminance = "5000 cd m-2"
width = "400 um"
height = "400 um"
spacing = "8 um"
wavelength_from = "400 nm"
wavelength_to = "700 nm"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "falloff"
[[stages]]
use = "halation"
[[stages]]
use = "pixel"
rows = 40
columns = 40
""" + "".join(
    f'[[stages]]\nuse = "{use}"\n'
    for use in """mosaic exposure shot_noise read_noise adc linearise white balance_mosaic demosaic_bilinear colour_fit
    camera_to_xyz balance display encode""".split()
)


def etendue(folder, *arguments, site=SITE):
    return process(*arguments, cwd=folder, env={**os.environ, "PYTHONPATH": str(site), "COLUMNS": "200"})


def told(folder, *arguments):
    done = etendue(folder, *arguments, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    place = tmp_path_factory.mktemp("film")
    (place / "film.toml").write_text(PIPELINE)
    return place


def test_a_stage_and_its_role_are_listed_like_the_built_in_ones(place):
    lines = etendue(place, "stages").stdout.splitlines()
    (row,) = [n for n, line in enumerate(lines) if line.startswith("halation ")]
    assert "light that comes back from behind the sensitive layer" in lines[row]
    assert [line.split()[0] for line in lines[row + 1 : row + 3]] == ["halation", "halation_backed"]
    assert all(line.rstrip().endswith(f"(from {FROM} 1.0)") for line in lines[row + 1 : row + 3])
    assert "halation, halation, from etendue-halation 1.0" in etendue(place, "stages", "halation").stdout


def test_a_camera_quantity_is_listed_with_who_brings_and_who_takes_it(place):
    found = told(place, "quantities", "film_base")[0]
    assert found.items() >= {"distribution": FROM, "default": 120.0, "units": "um", "range": "above 0 um"}.items()
    assert found["stages"] == ["halation", "halation_backed"]
    (line,) = [line for line in etendue(place, "quantities").stdout.splitlines() if line.startswith("film_base ")]
    assert "120.0 um" in line and f"thickness of the film's base (from {FROM} 1.0)" in line


def test_a_sensor_is_listed_with_who_brings_it(place):
    found = told(place, "sensors", "halation-film")[0]
    assert found["distribution"] == FROM and found["camera"]["film_base"]["value"] == "200 um"
    (line,) = [line for line in etendue(place, "sensors").stdout.splitlines() if line.startswith("halation-film ")]
    assert f"a film that is scanned (from {FROM} 1.0)" in line


@pytest.fixture(scope="module")
def archive(place):
    done = etendue(place, "run", "film.toml", "--sweep", "film_base=200,400", "--archive", "a", "--quiet")
    assert done.returncode == 0, done.stderr
    return place / "a"


def test_the_archive_has_names_and_units_of_what_was_brought(archive):
    with xarray.open_datatree(archive / "data.zarr", engine="zarr", chunks=None) as tree:
        halo = tree["halation/halo"]
        assert halo.attrs == {**halo.attrs, "long_name": "share of the light that comes back", "units": "percent"}
        assert halo.film_base.attrs == {"long_name": "film base", "units": "um", "parameter": "film_base"}
        thin, thick = (float(halo.sel(film_base=base).max()) for base in (200, 400))
        assert 0 < thin < thick
        assert tree["halation"].attrs["distribution"] == f"{FROM} 1.0"


def test_the_contact_sheet_shows_the_variable_as_its_distribution_says(archive):
    with xarray.open_datatree(archive / "data.zarr", engine="zarr", chunks=None) as tree:
        frames = tree["frames"].to_dataset()
        (number,) = np.flatnonzero(frames.variable.values == "halo")
        y, x = int(frames.height[number]), int(frames.width[number])
        shown = frames.preview.values[number, :, :y, :x].astype(float)
        far = [np.abs(shown - 255 * plane / 20).max() for plane in tree["halation/halo"].values]
    assert min(far) <= 0.5 + 1e-3 < max(far)  # from 0 to 20 percent, in 8 bits: one of the two cells
    assert (archive / "contact_sheet.png").stat().st_size > 0


def test_a_kind_of_plot_is_listed_drawn_and_refused_like_the_built_in_ones(archive, place):
    assert told(place, "plot", "a", "--list")["kinds"]["glow"] == "how much light comes back, pixel by pixel"
    assert told(place, "plot", "a", "glow", "-o", "glow.svg", "--at", "film_base=400 um")["kind"] == "glow"
    assert (place / "glow.svg").read_text().startswith("<?xml")
    for words, code, why in (
        (("glow", "--lines", "film_base"), 2, "--lines is for curves, not for glow"),
        (("glow", "halo", "halo"), 2, "glow takes 1 variable, not halo, halo"),
        (("nothing",), 3, "the kind of plot 'nothing' returns int; it must return a matplotlib figure"),
    ):
        refused = etendue(place, "plot", "a", *words)
        assert refused.returncode == code and why in refused.stderr


def test_a_section_of_its_own_stands_in_the_report_and_a_broken_one_says_why(archive, place):
    told(place, "report", "a", "-o", "report.html")
    made = embedded_document((place / "report.html").read_text())
    own, broken, wrong = made["sections"]
    assert (own["title"], own["origin"], own["why"]) == ("Light that comes back", f"{FROM} 1.0", "")
    text, table, picture = own["blocks"]
    assert text == {"paragraph": "<b>Read as text</b>: of the light behind the lens some comes back from the base."}
    assert [row[0] for row in table["table"]["rows"]] == ["least", "most"] and 0 < table["table"]["rows"][0][
        1
    ] <= table["table"]["rows"][1][1]
    assert picture["picture"].startswith("data:image/png;base64,") and picture["alt"] == "where it comes back"
    assert "nothing came back" in broken["why"] and not broken["blocks"]
    assert "block 1 cannot be read; expected a list of {'paragraph': text}" in wrong["why"]
    assert made["spelling"]["halo"] == "HALO" and made["words"]["cell"] == "camera"


def test_compare_ranks_the_alternatives_of_a_role_of_ones_own(place):
    words = ("--axis", "halation.use", "--noise-free", "--no-mtf50", "--repeat", "1", "-o", "compared")
    found = told(place, "compare", "film.toml", *words)
    assert sorted(row["label"] for row in found["rows"]) == ["halation", "halation_backed"]
    assert all(row["distribution"] == FROM and row["psnr_encoded"] for row in found["rows"])


def test_a_table_is_the_same_by_its_name_and_by_its_path(place, archive):
    """Keys are made of what is in it, and the record of a run holds a copy: nothing is computed twice, and the
    record is the same.
    """
    tables = {"camera.illuminant": "lamp.csv", "camera.sensitivity": "film.csv"}
    paths = [word for name, file in tables.items() for word in ("--set", f"{name}={SITE / 'halation' / file}")]
    again = told(place, "run", "film.toml", "--sweep", "film_base=200,400", "--archive", "a", *paths)
    assert (again["computed"], again["failed"]) == (0, 0) and again["reused"] > 0
    (record,) = (archive / "runs").glob("*.toml")
    assert record.read_text().count("../inputs/") == 2


def test_a_module_of_stages_finds_its_own_quantity_when_it_is_imported_alone(place):
    script = "from halation.stages import Halation; print(Halation().film_base)"
    done = process(code=script, env={**os.environ, "PYTHONPATH": str(SITE)})
    assert done.stdout == "120.0\n"


def test_a_manifest_that_needs_its_own_quantity_to_be_imported_is_told_so(tmp_path):
    source = "from etendue.api import quantity\nwide = quantity('film_base')\n" + hook(
        "quantities", {"film_base": {"default": 1.0}}
    )
    install(tmp_path / "site", "my-film", "my_film", source)
    (note,) = etendue(tmp_path, "stages", site=tmp_path / "site").stderr.splitlines()
    assert "my-film 1.0" in note and "in a separate manifest module" in note

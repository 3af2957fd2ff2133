"""An archive in Python does what the commands of the same names do with it."""

import json
import re
import shutil

import numpy as np
import pytest
from click.testing import CliRunner

import etendue
from etendue import stages as s
from etendue.cli import main
from etendue.errors import ArchiveError, RequestError


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    scene = s.uniform(name="scene", white_luminance="300 cd m-2", width="48 um", height="48 um", bin_width="100 nm")
    made = etendue.Pipeline(
        scene, s.irradiance(), s.pixel(), s.mosaic(), s.exposure(), s.shot_noise(), s.adc(), name="grey"
    )
    made = made.camera(peak_qe=[0.36, 0.44, 0.40], pixel_pitch="6 um", focal_length="7 mm").sweep(f_number=[2, 4])
    place = tmp_path_factory.mktemp("archives") / "grey"
    made.run(place, progress=False)
    return place


@pytest.fixture
def archive(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return etendue.Archive(folder)


def printed(*words):
    done = CliRunner().invoke(main, [*map(str, words), "--json"])
    assert done.exit_code in (0, 1), done.output
    return json.loads(done.stdout)


def timeless(document):
    return {name: value for name, value in document.items() if "second" not in name}


def test_documents_are_those_that_the_commands_print(archive, folder):
    assert timeless(archive.verify()) == timeless(printed("verify", folder))
    assert archive.verify()["whole"]
    assert archive.diff(archive) == printed("diff", folder, folder)
    assert archive.reproduce("serial")["reproduced"]


def test_what_is_damaged_is_named(archive, folder, tmp_path):
    shutil.copytree(folder, tmp_path / "copy")
    file = max(
        (tmp_path / "copy" / "data.zarr" / "adc").rglob("c/**/*"),
        key=lambda path: path.is_file() and path.stat().st_size,
    )
    data = bytearray(file.read_bytes())
    data[3] ^= 1
    file.write_bytes(data)
    assert not etendue.Archive(tmp_path / "copy").verify()["whole"]


def test_an_archive_that_cannot_be_opened_says_what_is_lost(folder, tmp_path):
    """A tree of it would have lost coordinates: what is damaged, and what mends it, can be asked all the same."""
    shutil.copytree(folder, tmp_path / "copy")
    shutil.rmtree(tmp_path / "copy" / "data.zarr" / "adc")
    broken = etendue.Archive(tmp_path / "copy")
    with pytest.raises(ArchiveError, match="verify .* --repair"):
        broken.tree["adc"].raw.load()
    assert not broken.verify()["whole"]
    for said in (repr(broken), broken._repr_html_()):
        assert "damaged" in said and "verify" in said and "adc" in said and "grey" in said


def test_files_are_those_that_the_commands_write(archive, folder, tmp_path):
    assert archive.report() == archive.report("grey-report.html") != archive.report(tmp_path / "other.html")
    (one,) = archive.export("png", "one.png", variables="raw", f_number=4)
    printed("export", folder, "--png", "--variable", "raw", "--at", "f_number=4", "-o", "two.png")
    assert one.read_bytes() == (tmp_path / "two.png").read_bytes()
    assert len(archive.export("tiff")) == 2
    with pytest.raises(RequestError, match=r"unknown kind of file 'jpg'"):
        archive.export("jpg")


def test_a_tree_is_lazy_and_plots_are_of_it(archive):
    np.testing.assert_array_equal(archive.tree["adc"].f_number, [2, 4])
    assert archive.plot.strip().figure.axes
    assert archive.show("raw", f_number=2).figure.axes


def test_a_notebook_shows_what_print_says_and_asks_nobody(archive):
    page = archive._repr_html_()
    assert "f_number" in page and "grey" in page
    assert not re.search(r"(src|href)\s*=\s*[\"']?(?!data:|#)\w+:", page)
    assert "grey" in repr(archive)


def test_what_is_no_archive_is_refused_at_once(tmp_path):
    with pytest.raises(ArchiveError):
        etendue.Archive(tmp_path)

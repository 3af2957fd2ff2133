"""Cubes written by each format's own library are read as what they are, and reach a picture; what is wrong is said
in one line.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import etendue
from etendue.cli.program import main
from etendue.contract.values.units import to_unit
from etendue.errors import RequestError
from etendue_camera.importing import formats, rasters
from etendue_camera.importing.cube import PLANCK_LIGHT, as_light, in_order, read_cube, wavelengths_of

WAVE = np.array([450.0, 500.0, 550.0, 600.0])
LIGHT = np.random.default_rng(5).uniform(0.1, 1.0, (4, 5, 6)).astype(np.float32)  # wavelength, y, x


def npy(path):
    np.save(path, LIGHT)


def npz(path):
    np.savez(path, radiance=np.moveaxis(LIGHT, 0, 2), wavelength=WAVE)


def mat(path):
    import scipy.io

    scipy.io.savemat(path, {"cube": np.moveaxis(LIGHT, 0, 2), "wavelengths": WAVE})


def hdf5(path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file.create_dataset("scan/cube", data=LIGHT)
        file.create_dataset("scan/wavelengths", data=WAVE)


def envi(path):
    reader = pytest.importorskip("spectral.io.envi")
    reader.save_image(
        str(path), np.moveaxis(LIGHT, 0, 2), metadata={"wavelength": WAVE / 1e3, "wavelength units": "micrometers"}
    )


def openexr(path):
    exr = pytest.importorskip("OpenEXR")
    layers = {f"S0.{w:.1f}nm".replace(".", ",", 2).replace("S0,", "S0."): LIGHT[i] for i, w in enumerate(WAVE)}
    exr.File({"type": exr.scanlineimage}, layers).write(str(path))


def tiff(path):
    import tifffile

    tifffile.imwrite(path, LIGHT, photometric="minisblack")


FORMATS = {
    "cube.npy": npy,
    "cube.npz": npz,
    "cube.mat": mat,
    "cube.h5": hdf5,
    "cube.hdr": envi,
    "cube.exr": openexr,
    "cube.tif": tiff,
}
SAID = {"cube.npz", "cube.mat", "cube.h5", "cube.hdr", "cube.exr"}  # whose wavelengths stand in the file


@pytest.mark.parametrize("name", FORMATS)
def test_a_file_is_read_as_the_formats_own_library_has_written_it(tmp_path, name):
    FORMATS[name](tmp_path / name)
    cube = read_cube(tmp_path / name)
    np.testing.assert_array_equal(cube.values, LIGHT)
    assert (cube.wavelength is not None) == (name in SAID)
    if name in SAID:
        np.testing.assert_allclose(cube.wavelength, WAVE, rtol=1e-12)


@pytest.mark.parametrize("name", FORMATS)
def test_a_cube_reaches_a_picture_with_its_own_light(tmp_path, name):
    FORMATS[name](tmp_path / name)
    words = [
        "import",
        str(tmp_path / name),
        "-o",
        str(tmp_path / "scene.zarr"),
        "--level",
        "radiance",
        "--spacing",
        "2",
        "--white-at",
        "2,3,3",
    ]
    done = CliRunner().invoke(main, [*words, "--wavelengths", "450:600:50"] if name not in SAID else words)
    assert done.exit_code == 0, done.output
    tree = etendue.simulate(
        {"stages": [{"use": "radiance_cube", "name": "scene", "file": str(tmp_path / "scene.zarr")}]},
        want=["radiance", "white_radiance"],
        f_number=4,
    )
    np.testing.assert_array_equal(tree["scene/radiance"].values, LIGHT)
    np.testing.assert_allclose(
        tree["scene/white_radiance"].values, LIGHT[:, 1:4, 2:5].mean(axis=(1, 2)), rtol=1e-6
    )  # float32


def test_photons_of_isetcam_are_the_radiance_that_carries_them(tmp_path):
    import scipy.io

    photons = LIGHT / (PLANCK_LIGHT / (WAVE * 1e-9))[:, None, None]
    last = {"photons": np.moveaxis(photons, 0, 2).astype(float)}
    light = {"data": {"photons": photons[:, 0, 0].astype(float)}}
    scipy.io.savemat(tmp_path / "scene.mat", {"scene": {"data": last, "spectrum": {"wave": WAVE}, "illuminant": light}})
    basis = np.linalg.qr(np.random.default_rng(1).normal(size=(4, 4)))[0]
    scipy.io.savemat(
        tmp_path / "basis.mat", {"mcCOEF": last["photons"] @ basis, "basis": {"basis": basis, "wave": WAVE}}
    )
    for name in ("scene", "basis"):
        cube, unit = as_light(read_cube(tmp_path / f"{name}.mat"), name)
        assert unit == "W m-2 sr-1 nm-1"
        np.testing.assert_allclose(cube.values, LIGHT, rtol=1e-6)  # through float32 on the way
    cube, _ = as_light(read_cube(tmp_path / "scene.mat"), "scene")
    np.testing.assert_allclose(cube.white, LIGHT[:, 0, 0], rtol=1e-6)


def test_every_unit_of_a_header_is_as_long_as_the_unit_of_a_pipeline():
    """An angstrom, which pipelines do not know, is a tenth of a nanometre."""
    known = {"nanometers": "nm", "nm": "nm", "micrometers": "um", "um": "um", "microns": "um", "meters": "m"}
    lengths = {word: to_unit(f"1 {unit}", "nm") for word, unit in known.items()} | {
        "angstroms": to_unit("1e-10 m", "nm")
    }
    assert pytest.approx(lengths, rel=1e-15) == rasters.TO_NM


def test_bands_are_sorted_and_whole_numbers_are_shares_of_their_largest(tmp_path):
    import tifffile

    tifffile.imwrite(tmp_path / "a.tif", np.round(LIGHT * 65535).astype(np.uint16), photometric="minisblack")
    done = CliRunner().invoke(
        main,
        [
            "import",
            str(tmp_path / "a.tif"),
            "-o",
            str(tmp_path / "a.zarr"),
            "--level",
            "relative",
            "--wavelengths",
            "600,550,500,450",
        ],
    )
    assert done.exit_code == 0 and "white_luminance" in done.output, done.output
    import xarray

    store = xarray.open_zarr(tmp_path / "a.zarr", consolidated=False)
    assert store.wavelength.values.tolist() == sorted(WAVE)
    np.testing.assert_allclose(store.radiance.values, LIGHT[::-1], atol=0.5 / 65535 + 1e-7)  # half a step


def importing(path, *words):
    return CliRunner().invoke(
        main, ["import", str(path / "a.npy"), "-o", str(path / "a.zarr"), "--wavelengths", "450:600:50", *words]
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ("--level", "relative"),
            ("reflectance, ", "1 = white", "size unknown", "12 x 10 um", 'spacing = "2 um"', "white_luminance = "),
        ),
        (
            ("--level", "radiance", "--spacing", "3"),
            ("spectral radiance, ", "18 x 15 um (width x height)", "--white-at", "# white_lum"),
        ),
        (("--level", "relative", "--scale", "4000"), ("note: 1 is white, but values reach ", "--white-at")),
    ],
)
def test_what_is_printed_says_what_the_values_are_and_how_large_the_picture_is(tmp_path, words, said):
    """6 samples wide, 5 high."""
    np.save(tmp_path / "a.npy", LIGHT)
    done = importing(tmp_path, *words)
    assert done.exit_code == 0 and all(word in done.output for word in said), done.output


def test_relative_values_are_divided_by_the_white_of_a_patch(tmp_path):
    """Counts of any scale by band come out as the reflectance of the patch where the patch is."""
    counts = LIGHT * np.array([10, 200, 3000, 7])[:, None, None]
    np.save(tmp_path / "a.npy", counts)
    done = importing(tmp_path, "--level", "relative", "--white-at", "2,3,1", "--white-reflectance", "0.5")
    assert done.exit_code == 0, done.output
    import xarray

    found = xarray.open_zarr(tmp_path / "a.zarr", consolidated=False).radiance.values
    np.testing.assert_allclose(found, 0.5 * LIGHT / LIGHT[:, 2:3, 3:4], rtol=1e-5)  # float32
    dark = LIGHT.copy()
    dark[1, 2, 3] = 0
    np.save(tmp_path / "a.npy", dark)
    assert "dark at 500 nm" in importing(tmp_path, "--level", "relative", "--white-at", "2,3,1").output


def test_a_picture_is_told_from_a_cube_by_its_name(tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"")
    with pytest.raises(RequestError, match="with the stage photograph"):
        read_cube(tmp_path / "a.jpg")


def test_axes_that_are_named_are_put_in_order():
    from etendue_camera.importing.cube import Cube

    moved = np.transpose(LIGHT, (1, 2, 0))
    np.testing.assert_array_equal(in_order(Cube(moved), "yxw").values, LIGHT)


@pytest.mark.parametrize(
    ("make", "words", "said"),
    [
        (None, (), "no such file"),
        (lambda p: (p / "a.npy").write_bytes(b"no"), (), "a.npy could not be read as .npy"),
        (lambda p: np.save(p / "a.npy", LIGHT[0]), (), "expected a numeric array with three axes"),
        (lambda p: np.save(p / "a.npy", LIGHT), (), "does not give its wavelengths: use --wavelengths"),
        (
            lambda p: np.save(p / "a.npy", LIGHT),
            ("--wavelengths", "450:600:50"),
            "does not give its level: use --level",
        ),
        (
            lambda p: np.save(p / "a.npy", LIGHT),
            ("--wavelengths", "450:600:75", "--level", "radiance"),
            "3 wavelengths for 4 bands",
        ),
        (
            lambda p: np.save(p / "a.npy", LIGHT),
            ("--wavelengths", "450:600:40", "--level", "radiance"),
            "expected FIRST:LAST:STEP",
        ),
        (
            lambda p: np.save(p / "a.npy", LIGHT),
            ("--wavelengths", "450:600:50", "--level", "radance"),
            "did you mean 'radiance'?",
        ),
        (lambda p: np.save(p / "a.npy", LIGHT), ("--axes", "yx"), "expected the letters w, y and x"),
        (
            lambda p: np.save(p / "a.npy", LIGHT - 1),
            ("--wavelengths", "450:600:50", "--level", "radiance"),
            "invalid radiance values, the first",
        ),
        (
            lambda p: np.save(p / "a.npy", LIGHT),
            ("--wavelengths", "450:600:50", "--level", "radiance", "--white-at", "0,0"),
            "lies outside",
        ),
        (
            lambda p: np.save(p / "a.npy", LIGHT),
            ("--wavelengths", "450:600:50", "--level", "radiance", "--white-at", "a"),
            "expected a row",
        ),
    ],
)
def test_what_is_wrong_is_one_line_and_nothing_is_written(tmp_path, make, words, said):
    if make:
        make(tmp_path)
    done = CliRunner().invoke(main, ["import", str(tmp_path / "a.npy"), "-o", str(tmp_path / "a.zarr"), *words])
    assert done.exit_code == 2 and said in done.output and len(done.output.strip().splitlines()) == 1, done.output
    assert not list(Path(tmp_path).glob("*.zarr")) and not list(Path(tmp_path).glob(".*"))


def test_an_array_is_named_where_there_are_several_and_a_missing_reader_with_its_command(tmp_path, monkeypatch):
    np.savez(tmp_path / "a.npz", one=LIGHT, two=LIGHT)
    with pytest.raises(RequestError, match="several three-axis arrays, one, two; choose one with --variable"):
        read_cube(tmp_path / "a.npz")
    assert read_cube(tmp_path / "a.npz", "two").values.shape == (4, 5, 6)
    (tmp_path / "a.hdr").write_text("ENVI\n")
    monkeypatch.setitem(__import__("sys").modules, "spectral.io.envi", None)
    with pytest.raises(RequestError, match=r"pip install 'etendue\[cubes\]'"):
        read_cube(tmp_path / "a.hdr")


def test_wavelengths_stand_in_a_range_a_list_or_a_file(tmp_path):
    (tmp_path / "w.csv").write_text("450\n500\n550\n600\n")
    for text in ("450:600:50", "450,500,550,600", str(tmp_path / "w.csv")):
        np.testing.assert_array_equal(wavelengths_of(text), WAVE)


@pytest.mark.parametrize("ending", formats.FORMATS)
def test_every_format_has_a_reader_and_stands_in_the_documents_and_the_help(ending):
    found = formats.FORMATS[ending]
    assert callable(found.reader())
    table = (Path(__file__).parents[2] / "docs" / "python.md").read_text()
    assert any(f"`{ending}`" in line.split("|")[1] for line in table.splitlines() if line.startswith("| `.")), ending
    assert found.name in " ".join(CliRunner().invoke(main, ["import", "--help"]).output.split())


def test_the_table_of_formats_names_none_that_is_not_read():
    table = (Path(__file__).parents[2] / "docs" / "python.md").read_text()
    named = [
        word
        for line in table.splitlines()
        if line.startswith("| `.")
        for word in re.findall(r"`(\.\w+)`", line.split("|")[1])
    ]
    assert set(named) == set(formats.FORMATS)


def test_numbers_that_a_header_reaches_through_a_link_out_of_its_folder_are_not_read(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "secret").write_bytes(bytes(96))
    (tmp_path / "here").mkdir()
    header = (
        "ENVI\nsamples = 2\nlines = 3\nbands = 4\ndata type = 4\ninterleave = bsq\nbyte order = 0\nheader offset = 0\n"
    )
    (tmp_path / "here" / "cube.hdr").write_text(header)
    (tmp_path / "here" / "cube.img").symlink_to(tmp_path / "elsewhere" / "secret")
    with pytest.raises(RequestError, match="a link out of the folder"):
        read_cube(tmp_path / "here" / "cube.hdr")
    pytest.importorskip("spectral")
    (tmp_path / "here" / "numbers").write_bytes(bytes(96))
    (tmp_path / "here" / "cube.img").unlink()
    (tmp_path / "here" / "cube.img").symlink_to("numbers")
    assert read_cube(tmp_path / "here" / "cube.hdr").values.shape == (4, 3, 2)

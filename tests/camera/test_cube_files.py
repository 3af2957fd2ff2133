"""A radiance cube is light only where it is whole: every chunk there, dims and units as they should be, finite,
nowhere below 0.
"""

import json
import os

import numpy as np
import pytest
import xarray
import zarr

import etendue
from etendue.contract.registry import installed_stages
from etendue.errors import PluginError

UNIT = "W m-2 sr-1 nm-1"


def dataset():
    light = np.random.default_rng(3).uniform(0.1, 1.0, (4, 8, 8))
    return xarray.Dataset(
        {
            "radiance": (("wavelength", "y", "x"), light, {"units": UNIT}),
            "white_radiance": (("wavelength",), np.ones(4)),
        },
        coords={"wavelength": [450.0, 500.0, 550.0, 600.0], "y": 2.0 * np.arange(8), "x": 2.0 * np.arange(8)},
    )


def stored(path, cube=None, version=3, **encoding):
    (dataset() if cube is None else cube).to_zarr(
        path, zarr_format=version, consolidated=False, encoding={"radiance": {"chunks": (1, 4, 4), **encoding}}
    )
    return path


def read(path):
    """What the plan and the run make of a store: light, or the refusal."""
    stage = installed_stages().load("radiance_cube")(file=str(path), illuminant="D65")
    _, grids = stage.describe()
    return stage.run(stage.prepare({"out_wavelength_edges": grids["radiance"].bands().edges}))


@pytest.mark.parametrize("options", [{}, {"version": 2}, {"shards": (2, 8, 8)}])
def test_a_whole_cube_is_read_as_it_is(tmp_path, options):
    found = read(stored(tmp_path / "cube.zarr", **options))
    assert np.array_equal(found["radiance"], dataset().radiance.values)


@pytest.mark.parametrize(
    ("options", "lost"),
    [({}, "radiance/c/1/0/1"), ({"version": 2}, "radiance/1.0.1"), ({"shards": (2, 8, 8)}, "radiance/c/1/0/0")],
)
def test_a_lost_chunk_is_named_while_planning(tmp_path, options, lost):
    path = stored(tmp_path / "cube.zarr", **options)
    (path / lost).unlink()
    with pytest.raises(ValueError, match=f"is missing the chunk {lost}, which would read as"):
        read(path)


def test_a_chunk_that_is_lost_inside_a_shard_is_named(tmp_path):
    path = stored(
        tmp_path / "cube.zarr", dataset().drop_vars("radiance").assign(radiance=dataset().radiance), shards=(2, 8, 8)
    )
    array = zarr.open_group(path, mode="a", use_consolidated=False)
    made = array.create_array(
        "radiance",
        shape=(4, 8, 8),
        chunks=(1, 4, 4),
        shards=(2, 8, 8),
        dtype="f8",
        fill_value=0.5,
        overwrite=True,
        dimension_names=("wavelength", "y", "x"),
    )
    made[...] = 1.0
    made[3, 4:, :4] = 0.5  # the fill value: zarr leaves the chunk out
    with pytest.raises(ValueError, match=r"radiance/c/1/0/0 \(chunk 1/1/0 of it\)"):
        read(path)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1e-9])
def test_what_is_no_light_is_refused_with_its_place(tmp_path, value):
    cube = dataset()
    cube.radiance.values[2, 3, 4] = value
    path = stored(tmp_path / "cube.zarr", cube)
    with pytest.raises(ValueError, match=r"in band 2, row 3, column 4 \(1 such values\)"):
        read(path)
    with pytest.raises(PluginError) as failed:  # as a cell: one line, no traceback
        etendue.simulate({"stages": [{"use": "radiance_cube", "file": str(path)}]})
    assert "Traceback" not in str(failed.value) and "\n" not in str(failed.value)


def changed(**variables):
    return lambda cube: cube.assign_coords(variables)


WRONG = {
    "ascend": lambda cube: cube.isel(wavelength=slice(None, None, -1)),
    "of one band needs wavelength_bounds": lambda cube: cube.isel(wavelength=[0]),
    "in this order; its dims are y, x, wavelength": lambda cube: cube.transpose("y", "x", "wavelength"),
    "'W m-2 sr-1 um-1'": lambda cube: cube.assign(radiance=cube.radiance.assign_attrs(units="W m-2 sr-1 um-1")),
    "wavelength in .* is in 'um'": changed(wavelength=("wavelength", [0.45, 0.5, 0.55, 0.6], {"units": "um"})),
    "wavelength has 1 values that are NaN": changed(wavelength=[450.0, 500.0, np.nan, 600.0]),
    "y in .* is not evenly spaced": changed(y=np.arange(8.0) ** 2),
    "complex128": lambda cube: cube.assign(radiance=cube.radiance + 0j),
    "no points along y": lambda cube: cube.isel(y=slice(0)),
    "white_radiance in .* is 0 to 0": lambda cube: cube.assign(white_radiance=0 * cube.white_radiance),
}


@pytest.mark.parametrize("words", WRONG)
def test_a_cube_of_another_form_is_refused_while_planning(tmp_path, words):
    path = tmp_path / "cube.zarr"
    WRONG[words](dataset()).to_zarr(path, consolidated=False, write_empty_chunks=True)
    stage = installed_stages().load("radiance_cube")(file=str(path), illuminant="D65")
    with pytest.raises(ValueError, match=words):
        stage.describe()


def test_packed_numbers_are_not_taken_for_light(tmp_path):
    path = stored(tmp_path / "cube.zarr", dtype="int16", scale_factor=1e-3, _FillValue=-1)
    with pytest.raises(ValueError, match="packed"):
        read(path)


def test_a_link_in_a_store_is_refused(tmp_path):
    path = stored(tmp_path / "cube.zarr")
    (path / "radiance/c/1/0/1").unlink()
    os.symlink(path / "radiance/c/1/0/0", path / "radiance/c/1/0/1")
    with pytest.raises(ValueError, match="contains a link, radiance/c/1/0/1"):
        read(path)


@pytest.mark.parametrize(
    ("shape", "words"),
    [([10**6, 10**6, 10**6], "values"), ([4, 10**6, 1000], "chunks"), ([4, 10**9, 1], "points along y")],
)
def test_an_absurd_header_is_refused_before_anything_is_read(tmp_path, shape, words, monkeypatch):
    path = stored(tmp_path / "cube.zarr")
    header = path / "radiance" / "zarr.json"
    header.write_text(json.dumps({**json.loads(header.read_text()), "shape": shape}))
    monkeypatch.setattr(zarr.Array, "__getitem__", lambda *_: pytest.fail("it was read"))
    with pytest.raises(ValueError, match=f"{words}, more than"):
        read(path)


@pytest.mark.parametrize("damage", [b"", b"{", b"\xff\xfe", b"[]", b'{"zarr_format": 3}'])
def test_a_damaged_header_is_one_line(tmp_path, damage):
    path = stored(tmp_path / "cube.zarr")
    (path / "radiance" / "zarr.json").write_bytes(damage)
    with pytest.raises(ValueError, match="has no variable 'radiance'") as refused:
        read(path)
    assert "\n" not in str(refused.value)


def test_a_damaged_chunk_is_one_line(tmp_path):
    path = stored(tmp_path / "cube.zarr")
    (path / "radiance/c/1/0/1").write_bytes(b"nothing that was ever packed")
    with pytest.raises(ValueError, match="could not be read") as refused:
        read(path)
    assert "\n" not in str(refused.value)

"""Cubes in array files: NumPy, MATLAB (including ISETCam's by their names), HDF5.

In:  a path, the name of the array if there are several.
Out: a ``Cube``; the wavelength axis is first if the file gives wavelengths, other axes are as in the file.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from etendue import plain_files
from etendue.errors import RequestError, nearest
from etendue.types.documents import Document, DocumentView
from etendue_camera.arrays import Array
from etendue_camera.importing.cube import Cube, needed

DEEPEST = 32  # nesting depth of HDF5 groups
WAVELENGTHS = ("wavelength", "wavelengths", "wave", "wl", "lambda", "bands")


def numpy_array(path: Path, variable: str) -> Cube:
    """Return the only array of a ``.npy`` file, which has no names."""
    # a file shorter than declared is rejected at once
    return Cube(np.array(np.load(path, mmap_mode="r", allow_pickle=False)))


def numpy_arrays(path: Path, variable: str) -> Cube:
    """Return a three-axis array of a ``.npz`` file, ``variable`` or the only one, and wavelengths by name."""
    plain_files.check_entries(path)
    with np.load(path, allow_pickle=False) as file:
        return chosen({name: file[name] for name in file.files}, variable, str(path))


def hdf5(path: Path, variable: str) -> Cube:
    """Return a three-axis data set of an HDF5 file, from any group, and the wavelengths found by their name."""
    h5py = needed("h5py", f"{path} (HDF5)")
    with h5py.File(path, "r") as file:
        return chosen(_datasets(file, h5py), variable, str(path))


def matlab(path: Path, variable: str) -> Cube:
    """Read ``.mat`` of any version; an ISETCam scene or multispectral picture is recognised by its names."""
    import scipy

    try:
        size = sum(math.prod(shape) * 8 for _, shape, _ in scipy.io.whosmat(path))
        plain_files.refuse_unfolding(size, path.stat().st_size, "it")
        held: DocumentView = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)
    except NotImplementedError:  # version 7.3 is HDF5, with axes reversed by MATLAB
        h5py = needed("h5py", f"{path} (MATLAB 7.3)")
        with h5py.File(path, "r") as file:
            held = {name: array.T for name, array in _datasets(file, h5py).items()}
    named = {name: value for name, value in held.items() if not name.startswith("__")}
    found = None if variable else _isetcam(named)
    if found is not None:
        return found
    return chosen(
        {name: np.asarray(value) for name, value in named.items() if isinstance(value, np.ndarray | float | int)},
        variable,
        str(path),
    )


def chosen(arrays: Mapping[str, Array], variable: str, path: str) -> Cube:
    """Return the named array, or the only array with three axes.

    Raises
    ------
    RequestError
        If there is none, or more than one.
    """
    cubes = [name for name, array in arrays.items() if array.ndim == 3]
    if variable and variable not in arrays:
        raise RequestError(f"{path} has no array {variable!r}{nearest(variable, arrays)}")
    if not variable and len(cubes) != 1:
        what = (
            f"several three-axis arrays, {', '.join(cubes)}"
            if cubes
            else f"no three-axis array, only {', '.join(arrays) or 'nothing'}"
        )
        raise RequestError(f"{path} has {what}; choose one with --variable NAME")
    values = arrays[variable or cubes[0]]
    return spectral(
        values, next((a.ravel() for n, a in arrays.items() if n.rpartition("/")[2].lower() in WAVELENGTHS), None)
    )


def spectral(values: Array, wavelength: Array | None) -> Cube:
    """Return a cube with the wavelength axis first: the axis as long as ``wavelength``, the last if several match."""
    if wavelength is None or values.ndim != 3:
        return Cube(values, wavelength)
    axes = [axis for axis in (2, 0, 1) if values.shape[axis] == len(wavelength)]
    return Cube(np.moveaxis(values, axes[0], 0) if axes else values, wavelength)


def _datasets(file: Any, h5py: Any) -> Document:
    """Return all numeric data of a file itself; references to other files are rejected."""
    found: Document = {}
    size = stored = 0

    for name, one in _members(file, h5py):
        if one.dtype.kind in "fiu":
            if one.is_virtual or one.external:
                raise RequestError(
                    f"{file.filename}: the data of {name} are in other files; copy them into this file with "
                    "h5repack or h5py"
                )
            size, stored = size + one.size * one.dtype.itemsize, stored + one.id.get_storage_size()
            plain_files.refuse_unfolding(size, stored, name)
            found[name] = one[()]
    return found


def _members(file: Any, h5py: Any) -> Iterator[tuple[str, Any]]:
    """Yield every data set by its path, each once; links are not followed."""
    open_, seen = [("", file, 0)], set[Any]()
    while open_:
        path, group, depth = open_.pop()
        for name in group:
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                continue
            one, own = group[name], f"{path}{name}"
            place = h5py.h5o.get_info(one.id).addr
            if place in seen:
                continue
            seen.add(place)
            if isinstance(one, h5py.Dataset):
                yield own, one
            elif isinstance(one, h5py.Group) and depth == DEEPEST:
                raise RequestError(f"{file.filename}: groups are nested more than {DEEPEST} deep; this is not a cube")
            elif isinstance(one, h5py.Group):
                open_.append((f"{own}/", one, depth + 1))


def _isetcam(named: DocumentView) -> Cube | None:
    """Return the cube of an ISETCam scene or multispectral file: photons s-1 sr-1 m-2 nm-1; None for other files.

    Such files contain the photons themselves, or coefficients of a basis (and perhaps a mean).
    """
    scene: Any = named.get("scene")
    if hasattr(scene, "data") and hasattr(scene.data, "photons"):
        wave = scene.spectrum.wave if hasattr(scene, "spectrum") else scene.data.wave
        light = getattr(scene, "illuminant", None)
        return _photons(scene.data.photons, wave, light, "a scene of ISETCam")
    if "photons" in named and ("wave" in named or "basis" in named):
        return _photons(
            named["photons"],
            named.get("wave", getattr(named.get("basis"), "wave", None)),
            named.get("illuminant"),
            "ISETCam",
        )
    basis: Any = named.get("basis")
    if "mcCOEF" in named and hasattr(basis, "basis"):
        photons = np.asarray(named["mcCOEF"], float) @ np.asarray(basis.basis, float).T
        if "imgMean" in named:
            photons = photons + np.ravel(named["imgMean"])
        return _photons(
            np.maximum(photons, 0.0), basis.wave, named.get("illuminant"), "a multispectral picture of ISETCam"
        )
    return None


def _photons(photons: Any, wave: Any, illuminant: Any, what: str) -> Cube:
    wave = np.ravel(np.asarray(wave, float))
    light: Any = getattr(illuminant, "data", None)
    light = getattr(light, "photons", light)
    white = None
    if isinstance(light, np.ndarray) and light.dtype.kind in "fiu" and light.size == wave.size:
        white = np.ravel(light).astype(float)
        if not hasattr(getattr(illuminant, "data", None), "photons"):  # older files: energy
            white = white * wave * 1e-9 / (6.62607015e-34 * 299792458.0)
    return Cube(np.moveaxis(np.asarray(photons), 2, 0), wave, "photons", white, (what,))

"""Files of point spread functions by image height and wavelength.

In:  a file, or arrays.
Out: heights (um), wavelengths (um), PSFs, spacings (um) and their source; or a file.

File formats
------------
``.npz``: arrays ``heights_um`` (K,), ``wavelengths_um`` (L,), ``psf`` (K, L, n, n) and ``spacing_um`` (() or (L,));
text ``source`` (optional).

``.csv``: for each height and wavelength a line ``height_um,<h>,wavelength_um,<w>,spacing_um,<s>``, followed by n lines
of n numbers; the first line has the lowest y, and the first number the lowest x. Lines that start with ``#`` are
comments. Every height must have every wavelength, and all PSFs the same n.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from etendue import plain_files, require
from etendue_camera.arrays import FloatArray

ARRAYS = ("heights_um", "wavelengths_um", "psf", "spacing_um")
HEAD = "height_um,<h>,wavelength_um,<w>,spacing_um,<s>"
Pictures = tuple[FloatArray, FloatArray, FloatArray, FloatArray, str]  # ARRAYS, and the source
Blocks = dict[tuple[float, float], tuple[float, list[list[float]]]]  # by height and wavelength: spacing, rows


def write(
    path: Path, heights: FloatArray, wavelengths: FloatArray, psf: FloatArray, spacing: FloatArray, source: str
) -> None:
    """Write a file in the format given by its extension."""
    if path.suffix == ".npz":
        np.savez_compressed(
            path, heights_um=heights, wavelengths_um=wavelengths, psf=psf, spacing_um=spacing, source=np.array(source)
        )
        return
    if path.suffix != ".csv":
        raise ValueError(f"{path} ends in {path.suffix!r}; a bank is written as .npz or .csv")
    with path.open("w", encoding="utf-8") as file:
        file.writelines(f"# {line}\n" for line in source.splitlines())
        for height, pictures in zip(heights, psf, strict=True):
            for wavelength, step, picture in zip(wavelengths, spacing, pictures, strict=True):
                file.write(
                    f"height_um,{float(height)!r},wavelength_um,{float(wavelength)!r},spacing_um,{float(step)!r}\n"
                )
                file.writelines(",".join(repr(float(v)) for v in row) + "\n" for row in picture)


def read(path: Path) -> Pictures:
    """Return the arrays and the source in a file; raise ``ValueError`` if it has neither of these formats."""
    if path.suffix == ".csv":
        return _stacked(path, *_blocks(path))
    if path.suffix != ".npz":
        raise ValueError(f"{path} ends in {path.suffix!r}; a bank is read from .npz or .csv")
    plain_files.check_entries(path)
    with np.load(path, allow_pickle=False) as found:
        missing = [name for name in ARRAYS if name not in found]
        require.that(
            not missing,
            f"{path} has no array {', '.join(missing)}; it must contain heights_um, wavelengths_um, psf and spacing_um",
        )
        heights, wavelengths, psf, spacing = (found[name] for name in ARRAYS)
        return heights, wavelengths, psf, spacing, str(found["source"]) if "source" in found else ""


def _blocks(path: Path) -> tuple[Blocks, str]:
    """Return the PSFs of a CSV file, and its comments."""
    blocks: Blocks = {}
    rows: list[list[float]] | None = None
    comments = []
    text = plain_files.table(path, 16 * plain_files.LARGEST_TABLE).decode("utf-8")
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("#"):
            comments.append(line[1:].strip())
            continue
        cells = [cell.strip() for cell in line.split(",")]
        if not any(cells):
            continue
        try:
            if cells[0] == "height_um":
                if cells[2::2] != ["wavelength_um", "spacing_um"]:
                    raise ValueError(f"expected {HEAD}")
                height, wavelength, spacing = (float(cell) for cell in cells[1::2])
                if (height, wavelength) in blocks:
                    raise ValueError(f"height {height:g} um, wavelength {wavelength:g} um occurs twice")
                rows = []
                blocks[height, wavelength] = (spacing, rows)
            elif rows is None:
                raise ValueError(f"numbers before the first line {HEAD}")
            else:
                rows.append([float(cell) for cell in cells])
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}") from None
    return blocks, "\n".join(comments)


def _stacked(path: Path, blocks: Blocks, source: str) -> Pictures:
    """Return the PSFs as arrays; raise ValueError unless every height has every wavelength and all sizes are equal."""
    heights, wavelengths = (sorted({key[i] for key in blocks}) for i in (0, 1))
    require.that(
        blocks and len(blocks) == len(heights) * len(wavelengths),
        f"{path} has {len(blocks)} pictures for {len(heights)} heights and {len(wavelengths)} wavelengths; it "
        f"needs each pair",
    )
    spacings = [{blocks[h, w][0] for h in heights} for w in wavelengths]
    require.that(not any(len(s) > 1 for s in spacings), f"{path}: pictures of one wavelength have different spacings")
    shapes = {(len(rows), len(row)) for _, rows in blocks.values() for row in rows}
    require.that(
        len(shapes) == 1 and len({*next(iter(shapes))}) == 1,
        f"{path}: pictures must all have the same number of lines and of numbers in a line, found {sorted(shapes)}",
    )
    psf = np.array([[blocks[h, w][1] for w in wavelengths] for h in heights])
    return np.array(heights), np.array(wavelengths), psf, np.array([s.pop() for s in spacings]), source

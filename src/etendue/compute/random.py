"""Random numbers by name: generators determined by words, and patterns tied to absolute positions.

In:  bytes that name a draw; a window in absolute positions.
Out: a generator; normals and uniforms by position, the same in every window that contains it.
Source: Salmon et al. 2011 (Philox).
"""

import hashlib
from collections.abc import Callable

import numpy as np
from numpy.typing import DTypeLike, NDArray

from etendue.types.arrays import Array, FloatArray

TILE = 64  # positions


def philox(seed_words: bytes) -> np.random.Generator:
    """Return a generator determined by a name: equal bytes give equal draws, in any order.

    Parameters
    ----------
    seed_words : bytes
        Any length.

    Returns
    -------
    numpy Generator over Philox
        Its 128-bit key is the BLAKE2b hash of the words; the counter starts at 0.
    """
    return np.random.Generator(np.random.Philox(key=_philox_key(seed_words)))


def renamed(generator: np.random.Generator, seed_words: bytes) -> np.random.Generator:
    """Set a generator from `philox` to the start of the draws of another name.

    Parameters
    ----------
    generator : numpy Generator over Philox
        Changed in place.
    seed_words : bytes
        Any length.

    Returns
    -------
    numpy Generator
        The same object; its draws equal those of ``philox(seed_words)``, bit for bit.

    Notes
    -----
    Creating a bit generator costs ten times as much as setting its state.
    """
    start = {"counter": np.zeros(4, np.uint64), "key": _philox_key(seed_words)}
    # The state also has a buffer of numbers generated in advance and half of a 64-bit number. Both are emptied, because
    # otherwise the first draws would still be those of the former name.
    rest = {"buffer": np.zeros(4, np.uint64), "buffer_pos": 4, "has_uint32": 0, "uinteger": 0}
    generator.bit_generator.state = {"bit_generator": "Philox", "state": start, **rest}
    return generator


def _philox_key(seed_words: bytes) -> NDArray[np.uint64]:
    # The byte order is fixed, so that a name gives the same draws on every machine.
    return np.frombuffer(hashlib.blake2b(seed_words, digest_size=16).digest(), "<u8").astype(np.uint64)


def tiled_normal(
    seed_words: bytes,
    first_row: int,
    first_column: int,
    rows: int,
    columns: int,
    dtype: DTypeLike = np.float32,
) -> Array:
    """Return standard normal numbers that depend only on the name of the pattern and their absolute position.

    Parameters
    ----------
    seed_words : bytes
        Name of the pattern.
    first_row, first_column : int
        Absolute position of the window; any sign.
    rows, columns : int
        Size of the window; not negative.
    dtype : float32 or float64
        Type of the result. Drawn in float32, so the numbers are the same in both.

    Returns
    -------
    (rows, columns) array, dimensionless
        Equals the crop of any larger window bit for bit.

    Raises
    ------
    ValueError
        If a size is negative.

    Notes
    -----
    One `philox` generator per 64 x 64 tile of absolute coordinates, named by seed_words and two 8-byte
    little-endian signed tile numbers. A window that cuts a tile draws all of it.
    """
    at = seed_words, first_row, first_column, rows, columns
    return _tiled(lambda generator: generator.standard_normal((TILE, TILE), dtype=np.float32), *at, dtype)


def tiled_uniform(seed_words: bytes, first_row: int, first_column: int, rows: int, columns: int) -> FloatArray:
    """Return uniform random numbers, 0 <= u < 1, that depend only on the name of the pattern and their absolute
    position; arguments, errors and tiles as in `tiled_normal`.

    Returns
    -------
    (rows, columns) array of float64, dimensionless
        Multiples of 2^-53 in every precision of a run: with 24 bits, the share of numbers below a threshold of 1e-6
        would be 1.3 % too large, and below 1e-8 six times too large.
    """
    at = seed_words, first_row, first_column, rows, columns
    return _tiled(lambda generator: generator.random((TILE, TILE)), *at, np.float64)


def _tiled(
    draw: Callable[[np.random.Generator], FloatArray],
    seed_words: bytes,
    first_row: int,
    first_column: int,
    rows: int,
    columns: int,
    dtype: DTypeLike,
) -> FloatArray:
    if rows < 0 or columns < 0:
        raise ValueError(f"the size of the window must not be negative; it is {rows} x {columns}")
    window = np.empty((rows, columns), dtype)
    generator = philox(seed_words)  # takes the name of each tile in turn
    for row in range(first_row // TILE, -(-(first_row + rows) // TILE)):
        for column in range(first_column // TILE, -(-(first_column + columns) // TILE)):
            name = seed_words + row.to_bytes(8, "little", signed=True) + column.to_bytes(8, "little", signed=True)
            tile = draw(renamed(generator, name))
            top, left = row * TILE - first_row, column * TILE - first_column
            inside = np.s_[max(top, 0) : top + TILE, max(left, 0) : left + TILE]
            window[inside] = tile[max(-top, 0) : rows - top, max(-left, 0) : columns - left]
    return window

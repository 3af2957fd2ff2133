"""Pairs as files: blocks of arrays, with the settings of every pair beside them.

In:  pairs, a folder.
Out: ``pairs-00000.npz``: each variable as float32 (number, channel, y, x), and the number of each pair;
     ``pairs-00000.json``: their settings. Existing blocks are kept.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from etendue.errors import Fault, RequestError
from etendue.result_files import check_folder, write_whole
from etendue.types.documents import Document
from etendue_lab.pairs.drawing import Pair, Pairs

REQUEST = "pairs.json"
Told = Callable[[int], None]  # called with the number of pairs that are on disk


def names_of(block: int) -> tuple[str, str]:
    """Return the files of a block."""
    return f"pairs-{block:05}.npz", f"pairs-{block:05}.json"


def request_of(pairs: Pairs, size: int) -> Document:
    plan = pairs.session.plan(list(pairs.variables), pairs.settings(0))
    return {
        "pipeline": pairs.pipeline.name,
        "key": plan.of(plan.wanted[0][0])[0].key,  # of the first pair: everything that its bits depend on
        "variables": list(pairs.variables),
        "over": [str(one) for one in pairs.ranges],
        "photographs": [Path(one).name for one in pairs.photographs],
        "seed": pairs.seed,
        "block": size,
    }


def write_blocks(pairs: Pairs, folder: Path, size: int = 64, workers: int = 2, told: Told = lambda count: None) -> int:
    """Write all missing pairs; return the number of pairs made now.

    Raises
    ------
    RequestError
        The folder cannot be written to, or holds other pairs.
    """
    check_folder(folder)
    request = request_of(pairs, size)
    known = _read(folder / REQUEST)
    if known is not None and known != json.loads(json.dumps(request)):
        differ = [key for key in request if known.get(key) != request[key]]
        raise RequestError(
            [Fault(str(folder), f"holds other pairs ({', '.join(differ)} differ); choose another --output")]
        )
    write_whole(folder, {REQUEST: json.dumps(request, indent=1).encode()})
    made = 0
    for block in range(-(-len(pairs) // size)):
        numbers = range(block * size, min((block + 1) * size, len(pairs)))
        arrays, settings = names_of(block)
        there = _read(folder / settings)
        # The file of settings is written after the arrays: if it exists, the block is complete.
        if there is None or there["numbers"] != list(numbers) or not (folder / arrays).is_file():
            own = list(_made(pairs, numbers, workers))
            write_whole(folder, {arrays: _stacked(own)})
            document = {"numbers": list(numbers), "settings": [one.settings for one in own]}
            write_whole(folder, {settings: json.dumps(document).encode()})
            made += len(own)
        told(numbers.stop)
    return made


def _made(pairs: Pairs, numbers: range, workers: int) -> Iterator[Pair]:
    """Yield pairs in order; a few pairs are computed in advance."""
    if workers == 1:
        yield from (pairs[number] for number in numbers)
        return
    with ThreadPoolExecutor(workers) as pool:
        left = iter(numbers)
        ahead = [pool.submit(pairs.__getitem__, number) for number in islice(left, 2 * workers)]
        while ahead:
            yield ahead.pop(0).result()
            ahead += [pool.submit(pairs.__getitem__, number) for number in islice(left, 1)]


def _stacked(own: list[Pair]) -> bytes:
    columns: dict[str, Any] = {name: np.stack([one.arrays[name] for one in own]) for name in own[0].arrays}
    file = io.BytesIO()
    np.savez(file, **{"number": np.array([one.number for one in own]), **columns})
    return file.getvalue()


def _read(path: Path) -> Document | None:
    try:
        found = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None

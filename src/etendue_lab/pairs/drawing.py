"""Pairs by number: the settings of a random camera, a photograph, and the pictures that the camera takes of it.

In:  a pipeline with a stage that reads a picture file, photographs, ranges of settings, a seed.
Out: for each number, arrays of the wanted variables and the settings of the camera; equal on every worker.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.contract.capabilities import is_source
from etendue.contract.registry import Registry, installed_stages
from etendue.contract.stage import parameters_of
from etendue.errors import Fault, RequestError
from etendue.evaluation.session import Session
from etendue.pipeline.file import PipelineFile
from etendue.types.documents import Document
from etendue_lab.search.asked import Range, read_ranges

if TYPE_CHECKING:
    from etendue.builder.pipeline import Pipeline
    from etendue.types.arrays import Array

PICTURES = frozenset((".png", ".jpg", ".jpeg", ".tif", ".tiff"))
VARIABLES = ("raw", "expected_charge")  # what a camera stores, and the mean charge of the same pixels without noise
BYTES = 256 << 20  # memory for results that are reused: scenes of photographs that occur again
SEEDS = 2**31


@dataclass(frozen=True)
class Pair:
    """One camera, and its pictures of one photograph. ``arrays``: float32, channel y x."""

    number: int
    settings: Document
    arrays: dict[str, Array]

    def digest(self) -> str:
        """Return a digest of the settings and of the bits of all arrays."""
        found = hashlib.sha256(repr(sorted(self.settings.items())).encode())
        for name, array in sorted(self.arrays.items()):
            found.update(f"{name} {array.shape}".encode())
            found.update(array.tobytes())
        return found.hexdigest()


@dataclass
class Pairs(Sequence[Pair]):
    """A sequence of pairs, computed on access. Picklable; a copy in another worker makes the same pairs.

    Attributes
    ----------
    scene : name ``STAGE.PARAMETER`` of the parameter that takes the photographs
    """

    pipeline: PipelineFile
    photographs: tuple[str, ...]
    ranges: tuple[Range, ...]
    variables: tuple[str, ...]
    seed: int
    total: int
    scene: str
    _session: Session | None = field(default=None, repr=False)

    def __len__(self) -> int:
        return self.total

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            return [self[n] for n in range(self.total)[number]]
        number = range(self.total)[number]
        settings = self.settings(number)
        record = self.session.metrics(self.variables, **settings)
        return Pair(number, settings, {name: _planes(array) for name, array in record.items()})

    def __iter__(self) -> Iterator[Pair]:
        return (self[number] for number in range(self.total))

    def __getstate__(self) -> Document:
        return {**vars(self), "_session": None}

    @property
    def session(self) -> Session:
        if self._session is None:
            self._session = Session(self.pipeline, BYTES)
        return self._session

    def settings(self, number: int) -> Document:
        """Return the settings of a pair; they depend only on the seed and the number."""
        draw = np.random.Generator(np.random.Philox(key=[self.seed, number]))
        photograph = self.photographs[int(draw.integers(len(self.photographs)))]
        own = {one.key: _drawn(one, draw) for one in self.ranges}
        return {self.scene: photograph, **own, "seed": int(draw.integers(SEEDS))}


def _planes(array: Any) -> Array:
    """Return a variable as float32 in the order channel y x; a mosaic has one channel."""
    found = np.asarray(array, np.float32)
    return found[np.newaxis] if found.ndim == 2 else found


def _drawn(one: Range, draw: np.random.Generator) -> Any:
    """Return a random value between the ends of a range, uniform in the value or in its logarithm."""
    if one.choices:
        return one.choices[int(draw.integers(len(one.choices)))]
    if one.whole:
        return int(draw.integers(int(one.low), int(one.high) + 1))
    share = float(draw.random())
    if one.logarithmic:
        return math.exp(math.log(one.low) + share * (math.log(one.high) - math.log(one.low)))
    return one.low + share * (one.high - one.low)


def photographs_of(place: str | Path | Iterable[str | Path]) -> tuple[str, ...]:
    """Return the picture files of a folder, or the given files, sorted by name.

    Raises
    ------
    RequestError
        There is no picture file.
    """
    if isinstance(place, str | Path):
        folder = Path(place)
        found = [p for p in folder.rglob("*") if p.suffix.lower() in PICTURES] if folder.is_dir() else [folder]
    else:
        found = [Path(one) for one in place]
    missing = [path for path in found if not path.is_file()]
    if missing or not found:
        what = f"no such file: {missing[0]}" if missing else f"no pictures ({', '.join(sorted(PICTURES))}) in it"
        raise RequestError([Fault(f"photographs {place}" if isinstance(place, str | Path) else "photographs", what)])
    return tuple(str(path.absolute()) for path in sorted(found))


def _scene_of(pipeline: PipelineFile, registry: Registry) -> str:
    """Return the parameter that takes the picture file, as ``STAGE.PARAMETER``."""
    for entry in pipeline.stages:
        kind = registry.load(entry.use) if entry.use in registry else None
        if kind is not None and is_source(kind):
            files = [name for name, (parameter, _, _) in parameters_of(kind).items() if parameter.file]
            if files:
                return f"{entry.name}.{files[0]}"
    raise RequestError([Fault("stages", 'no stage reads a picture; give the scene use = "photograph"')], pipeline.file)


def pairs_of(
    pipeline: PipelineFile,
    photographs: str | Path | Iterable[str | Path],
    over: Iterable[str] = (),
    variables: Iterable[str] = VARIABLES,
    seed: int = 0,
    count: int = 1000,
) -> Pairs:
    """Return pairs of random cameras; nothing is computed yet.

    Raises
    ------
    RequestError
        A range, a variable, the photographs or the pipeline are invalid.
    """
    registry, names = installed_stages(), tuple(dict.fromkeys(variables))
    ranges = read_ranges(pipeline, registry, over)
    if pipeline.sweep.keys() - {one.key for one in ranges}:
        axes = ", ".join(sorted(pipeline.sweep.keys() - {one.key for one in ranges}))
        raise RequestError(
            f"the pipeline sweeps {axes}, but every pair has one camera; set each to one value (--set), or draw it at "
            "random (--over)"
        )
    found = Pairs(pipeline, photographs_of(photographs), ranges, names, seed, count, _scene_of(pipeline, registry))
    plan = found.session.plan(list(names), found.settings(0))
    for stage, variable in plan.wanted:
        dims = plan.node(stage).writes[variable].dims
        if dims not in (("y", "x"), ("channel", "y", "x")):
            raise RequestError([Fault(variable, f"has the dims {' '.join(dims)}; expected y x, or channel y x")])
    return found


def pairs(
    pipeline: Pipeline, photographs: str | Path | Iterable[str | Path], over: Iterable[str] = (), **how: Any
) -> Pairs:
    """Return pictures of random cameras with their noise-free values: ``pairs[n]`` makes pair ``n``, equal on every
    worker.
    """
    return pairs_of(pipeline.written(), photographs, over, **how)

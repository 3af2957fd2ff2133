"""The form of a cell: the properties of a stage and its grids that the engine needs, computed once for all cells with
the same grids.

In:  a ``Job``.
Out: the expected outputs, the other arguments of ``run``, and the key of prepared tables.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from etendue.compute.job import Job
from etendue.compute.tables import Key, key_of_prepared
from etendue.contract.arrays.coordinates import coordinates_of
from etendue.contract.arrays.variables import Declaration, variable
from etendue.contract.capabilities import is_transfer
from etendue.contract.stage import SPECIAL, Stage, optional_ports, patterns_of
from etendue.types.arrays import Array


@dataclass(frozen=True)
class Output:
    """One expected output; ``counted``: its sum is reported."""

    variable: str
    declaration: Declaration
    shape: tuple[int, ...]
    dtype: np.dtype[np.generic]
    counted: bool

    @property
    def size(self) -> int:
        return math.prod(self.shape)


class StageForm:
    """Everything that depends only on a cell's stage class and grids, not on its parameters."""

    def __init__(self, job: Job) -> None:
        self.kind, self.writes, self.grids, self.input_grids = type(job.stage), job.writes, job.grids, job.input_grids
        self.precision, self.ports = job.precision, [port for port, _, _ in job.inputs]
        self.expected, self.asks = job.expected, job.asks
        self.transfer = is_transfer(self.kind)
        self._prepared: tuple[Stage, Key] | None = None

    def fits(self, job: Job) -> bool:
        return (
            self.kind is type(job.stage)
            and (self.grids is job.grids or self.grids == job.grids)
            and (self.input_grids is job.input_grids or self.input_grids == job.input_grids)
            and (self.writes is job.writes or self.writes == job.writes)
            and self.precision == job.precision
            and self.expected == job.expected
            and self.ports == [port for port, _, _ in job.inputs]
        )

    @cached_property
    def outputs(self) -> tuple[Output, ...]:
        return tuple(
            Output(
                name,
                declared,
                self.grids[name].shape(declared.dims),
                np.dtype(self.precision if declared.dtype == "float" else declared.dtype),
                bool(variable(name).counted),
            )
            for name, declared in self.writes.items()
        )

    @cached_property
    def counted(self) -> tuple[str, ...]:
        return tuple(output.variable for output in self.outputs if output.counted)

    @cached_property
    def beside(self) -> tuple[str, ...]:
        """The arguments of ``run`` that are not ports, in the order of ``run``."""
        ports = {*self.ports, *optional_ports(self.kind)}
        return tuple(name for name in self.asks if name not in ports)

    @cached_property
    def special(self) -> frozenset[str]:
        """The arguments of ``run`` that are neither ports, coordinates nor fixed patterns."""
        return SPECIAL & set(self.beside)

    @cached_property
    def patterns(self) -> tuple[str, ...]:
        """The arguments of ``run`` that are generators of fixed patterns."""
        return tuple(name for name in patterns_of(self.kind) if name in self.beside)

    @cached_property
    def coordinates(self) -> Mapping[str, Array]:
        return {**coordinates_of(self.grids), **coordinates_of(self.input_grids), **coordinates_of(self.grids, "out_")}

    def key_of_prepared(self, stage: Stage) -> Key:
        """Return the key of a stage's prepared tables; cached unless the stage reads files, which may change."""
        known = self._prepared  # read once: another thread may replace it
        if known is not None and known[0] is stage:
            return known[1]
        key, lasting = key_of_prepared(stage, self.input_grids, self.grids)
        if lasting:
            self._prepared = stage, key
        return key

    def lasts(self, stage: Stage) -> bool:
        """Return whether the prepared tables of a stage can be reused: ``run`` takes none, or their key is cached."""
        known = self._prepared
        return "prepared" not in self.special or (known is not None and known[0] is stage)


_LAST: dict[str, StageForm] = {}


def form_of(job: Job) -> StageForm:
    """Return the form of a cell; the form of the previous cell of the same stage is reused if it fits."""
    form: StageForm | None = job.form
    if form is None:
        form = _LAST.get(job.ref[0])
        if form is None or not form.fits(job):
            form = _LAST[job.ref[0]] = StageForm(job)
        job.form = form
    return form

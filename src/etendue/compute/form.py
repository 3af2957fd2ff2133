"""The form of a cell: what the engine asks of every cell of a stage, found out once for all that have the same grids.

In:  a ``Job``.
Out: what is to come back, what stands beside the arrays of the ports, and where what was prepared is remembered.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from etendue.compute.job import Job
from etendue.compute.tables import Key, key_of_prepared
from etendue.contract.capabilities import is_transfer
from etendue.contract.coordinates import coordinates_of
from etendue.contract.stage import SPECIAL, Stage, optional_ports, patterns_of
from etendue.contract.variables import Declaration, variable
from etendue.types.arrays import Array


@dataclass(frozen=True)
class Output:
    """What is to come back under a name; ``counted``: its sum is reported."""

    variable: str
    declaration: Declaration
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    counted: bool

    @property
    def size(self) -> int:
        return math.prod(self.shape)


class Form:
    """What does not depend on the parameters of a cell, only on its stage's class and its grids."""

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
        """What ``run`` asks for beside ports, in its order."""
        ports = {*self.ports, *optional_ports(self.kind)}
        return tuple(name for name in self.asks if name not in ports)

    @cached_property
    def special(self) -> frozenset[str]:
        """Of that what is no coordinate and no port, fixed patterns aside."""
        return SPECIAL & set(self.beside)

    @cached_property
    def patterns(self) -> tuple[str, ...]:
        """Of that the generators of fixed patterns."""
        return tuple(name for name in patterns_of(self.kind) if name in self.beside)

    @cached_property
    def coordinates(self) -> Mapping[str, Array]:
        return {**coordinates_of(self.grids), **coordinates_of(self.input_grids), **coordinates_of(self.grids, "out_")}

    def key_of_prepared(self, stage: Stage) -> Key:
        """Under what the tables of a stage are remembered; taken once for a stage without files, as they may change."""
        known = self._prepared  # looked at once: another thread may put another in its place
        if known is not None and known[0] is stage:
            return known[1]
        key, lasting = key_of_prepared(stage, self.input_grids, self.grids)
        if lasting:
            self._prepared = stage, key
        return key


_LAST: dict[str, Form] = {}


def form_of(job: Job) -> Form:
    """The form of a cell: that of the cell before it of the same name, as long as it fits."""
    form: Form | None = job.form
    if form is None:
        form = _LAST.get(job.ref[0])
        if form is None or not form.fits(job):
            form = _LAST[job.ref[0]] = Form(job)
        job.form = form
    return form

"""A pipeline that is evaluated many times, each time at other values: an evaluation computes only cells that a change
affects.

In:  a pipeline as written, a bound in bytes.
Out: trees and records of metrics, with the bits of a run.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.calls import called_methods
from etendue.errors import Fault, PluginError, RequestError
from etendue.evaluation.archived import ArchivedResults
from etendue.evaluation.asking import overrides_of, raise_failed
from etendue.evaluation.evaluating import evaluate
from etendue.evaluation.plans import Plans
from etendue.evaluation.remembering import remembered
from etendue.evaluation.results import Results
from etendue.pipeline.file import PipelineFile, overridden
from etendue.plan.model import Plan, StageVariable
from etendue.session import Options
from etendue.types.documents import DocumentView

if TYPE_CHECKING:
    from etendue.types.arrays import Array

BYTES = 1 << 30  # bytes of results that a session keeps by default


@dataclass(frozen=True)
class Row:
    """One evaluation: its settings, and the resulting metrics or the reason why there are none."""

    number: int
    settings: DocumentView
    metrics: DocumentView
    failed: str = ""


@called_methods
class Session:
    """Evaluations of one pipeline, from any thread.

    Parameters
    ----------
    pipeline : as read or written; a file that changes later is not read again
    bytes : bound on the kept results, bytes; the least recently used results are dropped first
    leave_out : whether stages may be left out if they have no effect on the results
    archive : folder of an archive whose results are reused if their keys match; nothing is written to it

    Examples
    --------
    >>> import etendue
    >>> session = etendue.Pipeline.read("pipelines/smallest.toml").session()
    >>> record = session.metrics("clipped_fraction", seed=2)
    >>> bool((record["clipped_fraction"] < 1).all())
    True
    """

    def __init__(
        self,
        pipeline: PipelineFile,
        bytes: int = BYTES,
        leave_out: bool = True,
        archive: str | Path | None = None,
    ) -> None:
        self.pipeline, self.leave_out = pipeline, leave_out
        self.results = Results(bytes, ArchivedResults(Path(archive)) if archive is not None else None)
        self.plans = Plans()

    def __call__(self, want: str | Iterable[str] | None = None, **values: Any) -> Any:
        """Return the ``xarray.DataTree`` of a run at other values, given as for ``etendue.simulate``, without its small
        pictures (``frames``).

        Raises
        ------
        RequestError
            The request is invalid; the message lists every fault, as for a run.
        EtendueError
            If cells failed; the message names the first.
        """
        return remembered(self.plan(want, values), self.results, Options(pictures=False)).tree

    def metrics(self, names: str | Iterable[str], **values: Any) -> dict[str, Any]:
        """Return variables at other values: for each name a number, or a read-only array with all values of the
        variable. Axes of a sweep come first, in their order.

        Raises
        ------
        RequestError, EtendueError
            The values are refused by the planner, or a cell fails.
        """
        plan = self.plan(names, values)
        wanted: dict[Any, frozenset[str]] = {}
        for stage, variable in plan.wanted:
            for cell in plan.of(stage):
                wanted[cell.ref] = wanted.get(cell.ref, frozenset()) | {variable}
        found = evaluate(plan, wanted, self.results)
        raise_failed(plan, found.failed)
        texts = {names} if isinstance(names, str) else set(names)
        record = {}
        for stage, variable in plan.wanted:
            name = f"{stage}.{variable}"
            record[name if name in texts else variable] = _joined(plan, (stage, variable), found.arrays)
        return record

    def rows(self, settings: Iterable[Mapping[str, Any]], names: str | Iterable[str]) -> Iterator[Row]:
        """Evaluate one row of settings after the other. The next settings are requested only after the previous row has
        been yielded, so a generator can choose them from the results of that row.

        If the stages refuse the settings, or a cell fails, the row is yielded with the reason.
        """
        names = [names] if isinstance(names, str) else list(names)
        for number, own in enumerate(settings):
            found, failed = dict[str, Any](), ""
            try:
                found = self.metrics(names, **own)
            except (RequestError, PluginError) as error:
                failed = str(error)
            yield Row(number, dict(own), found, failed)

    def plan(self, want: str | Iterable[str] | None, values: Mapping[str, Any]) -> Plan:
        """Return the plan of an evaluation at these values, which includes the cells that are in memory."""
        overrides: DocumentView = overrides_of(values, want)
        return self.plans.plan(overridden(self.pipeline, overrides) if overrides else self.pipeline, self.leave_out)

    @property
    def bytes(self) -> int:
        """Size of the results kept at present, bytes."""
        return self.results.bytes

    def clear(self) -> None:
        """Forget all results and plans."""
        self.results.clear()
        self.plans.clear()

    def __repr__(self) -> str:
        held = f"{self.results.bytes / 1e6:.0f} of {self.results.most / 1e6:.0f} MB"
        return f"<session of {self.pipeline.name}: {len(self.results)} results, {held}>"


def _joined(plan: Plan, one: StageVariable, arrays: Mapping[Any, Mapping[str, Array]]) -> Any:
    """Return a variable in all cells of its stage: as one array, or as a number if there is only one value."""
    stage, variable = one
    own = [arrays[cell.ref][variable] for cell in plan.of(stage)]
    if len(own) == 1:
        return own[0].item() if own[0].size == 1 else own[0]
    if len({array.shape for array in own}) > 1:
        raise RequestError(
            [
                Fault(
                    "",
                    f"{variable} changes its shape along an axis of the sweep; call the session to get the tree "
                    "instead",
                )
            ]
        )
    sizes = [len(plan.axis(dim).values) for dim in plan.node(stage).axes]
    whole = np.stack(own).reshape(*sizes, *own[0].shape)
    whole.setflags(write=False)
    return whole

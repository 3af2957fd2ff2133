"""Plans of earlier evaluations, so that the next evaluation plans only changed cells.

In:  a pipeline as written, with the values of an evaluation.
Out: its plan, as ``make_plan`` makes it.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass

from etendue.contract.registry import installed_stages
from etendue.contract.stage import file_state, files_of
from etendue.pipeline.file import PipelineFile
from etendue.plan.model import Plan
from etendue.plan.planner import plan_again

MOST_FORMS = 8  # forms of which plans are kept
MOST_CELLS = 2_000  # cells of the largest plan that is kept


@dataclass(frozen=True)
class _Kept:
    plan: Plan
    files: tuple[tuple[str, tuple[int, int]], ...]  # (path, state) of each file that the stages read

    @property
    def holds(self) -> bool:
        """Whether all files that the plan depends on are unchanged."""
        return all(file_state(path) == state for path, state in self.files)


class Plans:
    """Earlier plans, by the form of the pipeline: its names, axes and stages without values. Of each form, the first
    and the last plan are kept.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[Hashable, tuple[_Kept, ...]] = OrderedDict()

    def plan(self, pipeline: PipelineFile, leave_out: bool = True) -> Plan:
        """Return the plan of a pipeline.

        Raises
        ------
        RequestError
            As ``make_plan``.
        """
        names = tuple((one.name, one.use) for one in pipeline.stages)
        form = (pipeline.name, str(pipeline.folder), pipeline.wanted, pipeline.keep, tuple(pipeline.sweep), names)
        with self._lock:
            before = self._kept.get(form, ())
        plan = plan_again(pipeline, installed_stages(), leave_out, [one.plan for one in before if one.holds])
        if len(plan.cells) <= MOST_CELLS:
            kept = _Kept(plan, _files(plan))
            with self._lock:
                self._kept[form] = (*self._kept.get(form, ())[:1], kept)
                self._kept.move_to_end(form)
                while len(self._kept) > MOST_FORMS:
                    self._kept.popitem(last=False)
        return plan

    def clear(self) -> None:
        with self._lock:
            self._kept.clear()


def _files(plan: Plan) -> tuple[tuple[str, tuple[int, int]], ...]:
    stages = {cell.stage for cell in plan.cells.values()}
    paths = {path for stage in stages for path in files_of(stage).values()}
    return tuple((path, file_state(path)) for path in sorted(paths))

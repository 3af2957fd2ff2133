"""Results of a run of alternatives, indexed by position on the compared axis.

In:  the plan and the outcome of a comparison's run, the axis, the branches.
Out: arrays, reports and reasons by position.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any

from etendue.contract.arrays.grid import Line
from etendue.errors import Fault, RequestError
from etendue.plan.model import Alternative, CellRef, Plan, StageVariable
from etendue.present.pictures.crops import Plane
from etendue.session import Outcome
from etendue_lab.compare.axis import AxisRequest
from etendue_lab.compare.branches import Branched


@dataclass
class ComparedRow:
    """One alternative. Unknown values are None."""

    value: Any
    label: str
    use: str = ""
    distribution: str = ""
    version: str = ""
    psnr: float | None = None  # dB, on the result of the alternatives
    rmse: float | None = None
    psnr_white: float | None = None  # the same, with the brightest value of the alternative's reference as full scale
    psnr_encoded: float | None = None
    ssim: float | None = None
    delta_e: float | None = None  # mean CIEDE2000
    zipper: float | None = None
    false_colour: float | None = None
    mtf50: float | None = None  # cycles/pixel
    error: float | None = None  # rms, full scale 1, of the metric that ranks the rows: the ordinate of the plot
    mtf50_reference: float | None = None
    seconds: float | None = None  # CPU time of the stage
    mpixel_per_second: float | None = None
    seconds_per_mpixel: float | None = None
    pareto: bool = False  # on the Pareto front of quality and speed
    status: str = "done"  # refused: incompatible with this pipeline; failed: an error during the run
    reason: str = ""
    position: int | None = None  # on the axis


FIGURES = tuple(f.name for f in fields(ComparedRow) if f.type == "float | None")


class Reader:
    """Arrays and reports of a run by the position on the axis."""

    def __init__(self, plan: Plan, outcome: Outcome, asked: AxisRequest, branched: Branched) -> None:
        self.plan, self.outcome, self.asked = plan, outcome, asked
        axis = next((a for a in plan.axes if a.key == asked.key), None)
        if axis is None:
            raise RequestError([Fault(f"--axis {asked.key}", "the picture does not depend on this axis")])
        self.axis = axis
        self.dims = {a.dim for a in plan.axes if a.key in branched.axes(asked.key, None)}  # of both branches
        self.count = len(axis.values)
        places = [pair.reference[0] for pair in (branched.linear, branched.display, branched.colour) if pair]
        self.own_reference = any(self.dims & set(plan.node(name).axes) for name in places)

    def ref(self, name: str, position: int) -> CellRef:
        return (name, tuple(position if dim in self.dims else 0 for dim in self.plan.node(name).axes))

    def at(self, place: StageVariable, position: int) -> Any:
        return self.outcome.arrays.get(self.ref(place[0], position), {}).get(place[1])

    def of(self, found: tuple[str, Any], position: int = 0) -> Any:
        variable, node = found
        return (
            self.at((node.name, variable), position)
            if node is not None and node.name in [n.name for n in self.plan.nodes]
            else None
        )

    def why(self, position: int) -> str:
        """Return why a value of the axis has no result: the message of the first stage that failed."""
        for node in self.plan.nodes:
            report = self.outcome.reports.get(self.ref(node.name, position))
            if report is not None and report.status == "failed" and self.dims & set(node.axes):
                own = "" if node.name == self.asked.stage else f"{node.name}: "
                return own + report.message.strip().rpartition("\n")[2]
        return ""

    def shared_faults(self) -> list[str]:
        """Return the failures of stages that do not depend on the compared axis."""
        own = {node.name for node in self.plan.nodes if self.dims & set(node.axes)}
        return [
            f"{r.stage} failed: {r.message.strip().rpartition(chr(10))[2]}"
            for r in self.outcome.failed
            if r.stage not in own
        ]

    def alternative(self, position: int) -> Alternative | None:
        if not self.asked.stage:
            return None
        node = self.plan.node(self.asked.stage)
        return node.alternatives[position if self.asked.swaps and len(node.alternatives) > 1 else 0]

    def pictures(self, branched: Branched, rows: list[ComparedRow]) -> tuple[dict[int, Any], dict[int, Any]]:
        """Return the pictures to show: encoded pictures by position, and the pictures of the references."""
        pair = branched.display or branched.linear
        done = [row.position for row in rows if row.status == "done" and row.position is not None]
        ours, theirs = ({i: self.at(where, i) for i in done} for where in (pair.ours, pair.reference))
        both = [i for i in done if ours[i] is not None and theirs[i] is not None]
        return {i: ours[i] for i in both}, {i: theirs[i] for i in both}

    def planes(self, branched: Branched, positions: Iterable[int]) -> dict[int, Plane]:
        """Return the positions (um) of the rows and columns of the pictures on the image plane, by position on the
        axis.
        """
        name, variable = (branched.display or branched.linear).ours
        found = {}
        for i in positions:
            grid = self.plan.cells[self.ref(name, i)].grids[variable]
            y, x = grid["y"], grid["x"]
            if isinstance(y, Line) and isinstance(x, Line):
                found[i] = (y.um(), x.um())
        return found

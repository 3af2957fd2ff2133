"""What distributions say of the variables and quantities of a pipeline, where two of them say different things or one
says it wrongly.

In:  the alternatives at every stage.
Out: faults; none for names that this pipeline does not use.
"""

from __future__ import annotations

from etendue.contract.stage import parameters_of, writes_of
from etendue.contract.variables import disagree, variable
from etendue.errors import PluginError
from etendue.plan.alternatives import Entries
from etendue.plan.request import Request
from etendue.plugins import discovery


def check_vocabulary(request: Request, entries: Entries) -> None:
    """One fault for each name, wherever it is used first."""
    quantities: dict[str, str] = {}
    written: dict[str, str] = {}
    for stage, alternatives in entries.items():
        for one in alternatives:
            quantities |= {
                name: one.use
                for name, (p, _, _) in parameters_of(one.kind).items()
                if p.shared and name not in quantities
            }
            written |= {d.variable: stage for d in writes_of(one.kind).values() if d.variable not in written}
    for name, use in quantities.items():
        if clash := discovery.installed().clash("quantities", name):
            request.fault(request.pipeline.table.place(name), f"{use} takes it, and it is {clash}")
    for name, stage in written.items():
        try:
            variable(name)
        except PluginError as error:
            request.fault(f"stages.{stage}", str(error))
        if differ := disagree(name):
            request.fault(
                f"stages.{stage}", f"{differ} say different things of its variable {name!r}; uninstall one of them"
            )

"""The schedulers by name: their properties, and the function that runs batches.

In:  the value of ``--scheduler``.
Out: a ``Scheduler``. To add one, add a row here and the module that its ``place`` names.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from etendue.errors import RequestError, nearest
from etendue.types.documents import DocumentView

if TYPE_CHECKING:
    from etendue.run.watch import Stop


@dataclass(frozen=True)
class How:
    """Options for running batches: the last argument of every ``place``, after ``batches, deliver, before, after``.

    ``platform`` returns those properties of the platform that change bits of results; ``mark`` is path and content of a
    file that every worker must be able to read. A cluster refuses workers for which these differ.
    """

    address: str  # the value of ``--scheduler``
    workers: int
    stop: Stop
    cell_timeout: float | None = None
    platform: Callable[[], DocumentView] = dict
    mark: Any = None


@dataclass(frozen=True)
class Scheduler:
    """``place``: ``module:function`` of (batches, deliver, before, after, how); ``before`` and ``after`` are called in
    the owner's process.

    ``here``: cells are computed in the owner's process, where a cell cannot be stopped. ``far``: workers may be on
    other machines and see only shared folders. ``single``: one cell at a time. ``typed``: the name as the help shows
    it, if that differs from the name.
    """

    place: str
    here: bool = False
    far: bool = False
    single: bool = False
    typed: str = ""

    def run(self) -> Callable[..., None]:
        module, _, name = self.place.partition(":")
        found: Callable[..., None] = getattr(import_module(module), name)
        return found


_CLUSTER = "etendue.run.cluster.connect:run_on_cluster"
SCHEDULERS = {
    "serial": Scheduler("etendue.run.serial:run_serial", here=True, single=True),
    "threads": Scheduler("etendue.run.parallel:run_threads", here=True),
    "processes": Scheduler("etendue.run.parallel:run_processes"),
    "distributed": Scheduler(_CLUSTER, typed="distributed (a Dask cluster of this machine for the run)"),
    "tcp://": Scheduler(_CLUSTER, far=True, typed="tcp://host:port"),
    "tls://": Scheduler(_CLUSTER, far=True, typed="tls://host:port"),
}
NAMES = ", ".join(one.typed or name for name, one in SCHEDULERS.items())


def scheduler(text: str) -> Scheduler:
    """Return the scheduler of a name or address.

    Raises
    ------
    RequestError
        There is no such scheduler.
    """
    name = next((one for one in SCHEDULERS if one.endswith("://") and text.startswith(one)), text)
    if name not in SCHEDULERS:
        names = [one for one in SCHEDULERS if not one.endswith("://")]
        raise RequestError(f"--scheduler {text}: unknown scheduler{nearest(text, names)}, or tcp://host:port")
    return SCHEDULERS[name]


def far(text: str) -> str:
    """Return the given name or address if the workers of that scheduler may be on other machines, else ''."""
    return text if scheduler(text).far else ""


def check_scheduler(text: str) -> str:
    """Return the text if it names a scheduler; raise ``RequestError`` otherwise."""
    scheduler(text)
    return text

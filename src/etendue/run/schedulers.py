"""The schedulers by name: all that the rest of the house asks of them, and the function that runs batches.

In:  what ``--scheduler`` says.
Out: a ``Scheduler``. One more is a row here, and the module that its ``place`` names.
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
    """How batches are run: what every ``place`` is given behind ``batches, deliver, before, after``.

    ``platform`` gives what bits depend on, and ``mark`` is a file that all workers must see: a cluster refuses those
    that differ.
    """

    address: str  # what ``--scheduler`` said
    workers: int
    stop: Stop
    cell_timeout: float | None = None
    platform: Callable[[], DocumentView] = dict
    mark: Any = None


@dataclass(frozen=True)
class Scheduler:
    """``place``: ``module:function`` of (batches, deliver, before, after, how); ``before`` and ``after`` are told in
    the owner's process.

    ``here``: cells are computed in the owner's process, where nothing can stop one. ``far``: by workers that may be on
    other machines, and see only folders that all of them share. ``single``: one cell at a time.
    ``typed``: what help says, where that is more than its name.
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
    """The scheduler of a name or address.

    Raises
    ------
    RequestError
        There is none.
    """
    name = next((one for one in SCHEDULERS if one.endswith("://") and text.startswith(one)), text)
    if name not in SCHEDULERS:
        names = [one for one in SCHEDULERS if not one.endswith("://")]
        raise RequestError(f"--scheduler {text}: there is no such scheduler{nearest(text, names)}, or tcp://host:port")
    return SCHEDULERS[name]


def far(text: str) -> str:
    """The text, if its workers may be on other machines; else ''."""
    return text if scheduler(text).far else ""


def check_scheduler(text: str) -> str:
    """The text, if it names a scheduler."""
    scheduler(text)
    return text

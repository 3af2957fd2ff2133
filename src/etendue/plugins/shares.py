"""The share of each stage in what is lost at one place of a sweep, as distributions find it: ``etendue_shares``.

In:  nothing.
Out: a function of the folder of an archive and values of its axes.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint

from etendue.errors import RequestError
from etendue.plugins import discovery
from etendue.types.documents import Document


def shared_out() -> bool:
    """Whether anybody brings one."""
    return bool(discovery.installed().names("shares"))


def shares_at() -> Callable[..., Document]:
    """``function(folder, at, told)``: the document that reports and budgets show.

    Raises
    ------
    RequestError
        Nobody brings one.
    """
    found = discovery.installed()
    for name in found.names("shares"):
        brought = found.all("shares", name)[0]
        with discovery.foreign(f"shares of {brought.origin} cannot be loaded"):
            loaded: Callable[..., Document] = EntryPoint(name, str(brought.value), "").load()
        return loaded
    raise RequestError(f"no installed distribution finds the shares of stages{found.missed('shares', '')}")

"""Attribution of the loss at one place of a sweep to stages, as provided by distributions: ``etendue_shares``.

In:  nothing.
Out: a function of an archive's folder and axis values.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint

from etendue.errors import RequestError
from etendue.plugins import discovery
from etendue.types.documents import Document


def shared_out() -> bool:
    """Return True if any distribution provides an attribution."""
    return bool(discovery.installed().names("shares"))


def shares_at() -> Callable[..., Document]:
    """Return ``function(folder, at, told)``, which returns the document that reports and budgets show.

    Raises
    ------
    RequestError
        No distribution provides an attribution.
    """
    found = discovery.installed()
    for name in found.names("shares"):
        brought = found.all("shares", name)[0]
        with discovery.foreign(f"shares of {brought.origin} cannot be loaded"):
            loaded: Callable[..., Document] = EntryPoint(name, str(brought.value), "").load()
        return loaded
    raise RequestError(f"no installed distribution attributes losses to stages{found.missed('shares', '')}")

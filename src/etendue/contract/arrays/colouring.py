"""Colours of dims and patterns, as distributions define them by ``etendue_seen``, with a function for each.

In:  the name of a dim in front of y and x, or of a pattern of filters.
Out: the result of that function; a ``Pattern``. Nothing is imported before it is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint
from typing import Any

from etendue.errors import PluginError
from etendue.plugins import discovery

PATTERN = "pattern"  # the only name that is not a dim


@dataclass(frozen=True)
class Pattern:
    """Letters that repeat over y and x: ``rows`` of one period from position (0, 0), and ``tints``, the colour of each
    letter.
    """

    rows: tuple[str, ...]
    tints: Mapping[str, tuple[float, float, float]]

    @property
    def period(self) -> tuple[int, int]:
        return len(self.rows), len(self.rows[0])

    def moved(self, down: int, across: int) -> tuple[str, ...]:
        """Return the rows of one period from another position."""
        down, across = down % len(self.rows), across % len(self.rows[0])
        return tuple(row[across:] + row[:across] for row in (*self.rows[down:], *self.rows[:down]))


@cache
def function(name: str) -> Callable[..., Any] | None:
    """Return the function that a distribution provides for a dim, or for patterns; None if there is none."""
    brought = discovery.installed().first("seen", name)
    if brought is None:
        return None
    with discovery.foreign(f"the colours of {name}, of {brought.origin}, cannot be loaded"):
        found: Callable[..., Any] = EntryPoint(name, str(brought.value), "").load()
    return found


@cache
def flat_dims() -> tuple[str, ...]:
    """Return the dims in front of y and x whose entries together make one picture."""
    return tuple(name for name in discovery.installed().names("seen") if name != PATTERN)


@cache
def pattern(text: str) -> Pattern:
    """Return the pattern with this name or these letters.

    Raises
    ------
    PluginError
        If no distribution provides patterns.
    """
    read = function(PATTERN)
    if read is None:
        raise PluginError(
            f"no installed distribution reads the pattern {text!r}{discovery.installed().missed('seen', PATTERN)}"
        )
    return Pattern(*read(text))

"""How dims and patterns become colours, as distributions say by ``etendue_seen``: a function for each.

In:  the name of a dim in front of y and x, or of a pattern of filters.
Out: what the function gives; a ``Pattern``. Nothing is imported before it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint
from typing import Any

from etendue.errors import PluginError
from etendue.plugins import discovery

PATTERN = "pattern"  # the one name that is no dim


@dataclass(frozen=True)
class Pattern:
    """Letters that repeat over y and x: ``rows`` of one period from position (0, 0), ``tints`` the colour of each
    letter.
    """

    rows: tuple[str, ...]
    tints: Mapping[str, tuple[float, float, float]]

    @property
    def period(self) -> tuple[int, int]:
        return len(self.rows), len(self.rows[0])

    def moved(self, down: int, across: int) -> tuple[str, ...]:
        """Its rows as they stand from a position on."""
        down, across = down % len(self.rows), across % len(self.rows[0])
        return tuple(row[across:] + row[:across] for row in (*self.rows[down:], *self.rows[:down]))


@cache
def function(name: str) -> Callable[..., Any] | None:
    """What a distribution brings for a dim, or for patterns; None where nobody does."""
    brought = discovery.installed().first("seen", name)
    if brought is None:
        return None
    with discovery.foreign(f"how {name} is seen, of {brought.origin}, cannot be loaded"):
        found: Callable[..., Any] = EntryPoint(name, str(brought.value), "").load()
    return found


@cache
def flat_dims() -> tuple[str, ...]:
    """Dims in front of y and x that are one picture."""
    return tuple(name for name in discovery.installed().names("seen") if name != PATTERN)


@cache
def pattern(text: str) -> Pattern:
    """The pattern of a name or of letters.

    Raises
    ------
    PluginError
        Nobody brings patterns.
    """
    read = function(PATTERN)
    if read is None:
        raise PluginError(
            f"nothing that is installed reads the pattern {text!r}{discovery.installed().missed('seen', PATTERN)}"
        )
    return Pattern(*read(text))

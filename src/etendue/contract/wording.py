"""Wording and order in plots and pages, as distributions declare them: orders of preference, subjects, words, units.

In:  the name of a place, a subject, a word, a unit.
Out: its declaration; by default, words that fit any graph of stages.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

from etendue.contract.values import quantities
from etendue.errors import PluginError
from etendue.plugins import discovery

WORDS = {
    "cell": "setting",  # one combination of axis values
    "point": "setting",  # the same, as counted at the top of a page
    "place": "setting",  # the same, as the first title of a page names it
    "whole": "graph",  # all stages together
    "frame": "frame",  # what takes a picture
    "build": "Choose",  # before the axis values of the choice
    "chain": "Each picture is the output of the stage named below it.",
    "strip": "From stage to stage",
    "curves": "by stage, by name, over a dim of its own",
    "over": "go beyond a limit",  # of several cells that are not chosen
    "overs": "goes beyond a limit",  # of one such cell
    "over_what": "",
    "within": "that stay within their limits",
    "lost": "what",  # which stage loses ..., in few words
    "lost_words": "what",
}


@dataclass(frozen=True)
class Subject:
    """A subject of metrics. ``said``: the name of its first metric in a sentence; ``short``: the name at the head of a
    column, '' for the subject's own name. ``opens``: whether one of its metrics is expanded on a page, and may be
    plotted against a metric of another subject.
    """

    said: str = ""
    short: str = ""
    opens: bool = False


@dataclass(frozen=True)
class Unit:
    """``said``: the unit as written beside a plot; ``full``: a typical full scale, with which stages are tested;
    ``bits``: the shared quantity that gives the number of bits of the largest value in this unit; ``noise``: whether
    there is a variance of noise, in the square of this unit."""

    said: str = ""
    full: float = 1.0
    bits: str = ""
    noise: bool = False


_Form = TypeVar("_Form", Subject, Unit)


@cache
def first(place: str) -> tuple[str, ...]:
    """Return the names that distributions prefer at a place, the most preferred first."""
    found: dict[str, None] = {}
    for brought in discovery.installed().all("first", place):
        if isinstance(brought.value, list | tuple):
            found.update(dict.fromkeys(map(str, brought.value)))
    return tuple(found)


@cache
def words(of: frozenset[str] = frozenset()) -> Mapping[str, str]:
    """Return the words used in sentences. If names of distributions are given (such as those whose stages are in a
    graph), only the words of these distributions are used.
    """
    every, found = discovery.installed(), dict(WORDS)
    for name in every.names("words"):
        brought = [one for one in every.all("words", name) if not of or one.distribution in of]
        found |= {name: str(brought[0].value)} if brought else {}
    return found


@cache
def spelling() -> Mapping[str, str]:
    """Return how parts of names are spelled out; an entry that begins with ``_`` applies to the end of a name."""
    every = discovery.installed()
    return {name: str(own.value) for name in every.names("spelling") if (own := every.first("spelling", name))}


@cache
def subjects() -> Mapping[str, Subject]:
    """Return all declared subjects, in order."""
    return _all(Subject, "subjects")


@cache
def units() -> Mapping[str, Unit]:
    """Return the declarations of units."""
    return _all(Unit, "scales")


@cache
def prefixes() -> Mapping[str, str]:
    found = {}
    for name in quantities.names():
        try:
            found[name] = quantities.declared(name).prefix
        except PluginError:  # reported where the quantity is used
            continue
    return {name: prefix for name, prefix in found.items() if prefix}


def prefix(dim: str) -> str:
    """Return the text before values along a dim, in place of its name: ``f/`` of an f-number."""
    name = dim.rpartition(".")[2]
    return next((own for quantity, own in prefixes().items() if name.endswith(quantity)), "")


def _all(form: type[_Form], what: str) -> dict[str, _Form]:
    """Return all readable declarations; ``etendue stages`` reports the others."""
    every, found = discovery.installed(), dict[str, _Form]()
    for name in every.names(what):
        if brought := every.first(what, name):
            try:
                found[name] = discovery.made_of(form, f"{what} {name!r}", brought)
            except PluginError:
                continue
    return found

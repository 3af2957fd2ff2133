"""Which commands there are: the engine's own, and those that distributions bring by ``etendue_commands``.

In:  names.
Out: ``Command``: where it stands, how it is typed, what it does. A command's module is imported when it is called.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from types import ModuleType

import click

from etendue.errors import PluginError


@dataclasses.dataclass(frozen=True)
class Command:
    """``place``: ``module:function`` of a click command; ``usage``: what is typed behind its name; ``doc``: a few
    words for ``--help``.
    """

    place: str
    usage: str = ""
    doc: str = ""


_HERE = "etendue.cli"
OWN = {
    "run": Command(
        f"{_HERE}.runs:run", "FILE", "run a pipeline, archive it, show it; an archive that exists is resumed"
    ),
    "plan": Command(f"{_HERE}.runs:plan", "FILE", "what would run: cells, bytes, time, what is left out and why"),
    "rerun": Command(f"{_HERE}.runs:rerun", "DIR", "run an archive again into itself, from the archive alone"),
    "stages": Command(f"{_HERE}.catalogue:stages", "[NAME]", "what is installed: reads, writes, parameters"),
    "quantities": Command(f"{_HERE}.catalogue:quantities", "[NAME]", "what stages share: meaning, unit, range"),
    "show": Command(f"{_HERE}.runs:archive", "DIR", "what is in an archive; how far a run is"),
    "report": Command(f"{_HERE}.pages:report", "DIR", "one HTML page to read and send on"),
    "view": Command(f"{_HERE}.pages:view", "DIR", "every sample of every stage, live, in a browser"),
    "plot": Command(f"{_HERE}.plots:plot", "DIR [KIND]", "maps, curves, fronts, pictures of it; --list says which"),
    "verify": Command(f"{_HERE}.trust:verify", "DIR", "every byte as it was written? --repair mends it"),
    "reproduce": Command(f"{_HERE}.trust:reproduce", "DIR", "compute it again and compare, cell by cell"),
    "diff": Command(f"{_HERE}.trust:diff", "DIR DIR", "which cells of two archives differ, by how much, since what"),
    "compact": Command(f"{_HERE}.compacting:compact", "OLD NEW", "an archive written anew, its axes sorted"),
    "accuracy": Command(
        f"{_HERE}.accuracy:accuracy", "FILE", "error against run time, of every knob and of combinations"
    ),
    "new": Command(f"{_HERE}.beginnings:new", "NAME", "a commented pipeline to begin with"),
    "new-plugin": Command(
        f"{_HERE}.beginnings:new_plugin", "NAME --role R", "a stage of your own, in a distribution that installs"
    ),
    "schema": Command(f"{_HERE}.catalogue:schema", "", "the form of pipeline files, for editors"),
}


@cache
def offered() -> dict[str, Command]:
    """All commands by name. The engine's own go before others of the same name."""
    found = dict(OWN)
    for name, (command, _) in _brought().items():
        found.setdefault(name, command)
    return found


def _discovery() -> ModuleType:
    """What finds the commands of others: those of the engine are found without it."""
    from etendue.plugins import discovery

    return discovery


@cache
def _brought() -> dict[str, tuple[Command, str]]:
    """What distributions bring, with where it comes from; what cannot be read is left out."""
    discovery = _discovery()
    every, found = discovery.installed(), {}
    for name in every.names("commands"):
        for one in every.all("commands", name)[:1]:
            try:
                found[name] = discovery.made_of(Command, f"the command {name!r}", one), one.distribution
            except PluginError:
                continue
    return found


def loaded(name: str, command: Command) -> click.Command:
    """The command itself.

    Raises
    ------
    PluginError
        Its module cannot be imported, or holds no click command of this name.
    """
    from pkgutil import resolve_name

    if name in OWN:
        return resolve_name(command.place)  # type: ignore[no-any-return]
    origin = f"the command {name!r} of {_brought()[name][1]}"
    with _discovery().foreign(f"{origin} cannot be loaded"):
        found = resolve_name(command.place)
    if not isinstance(found, click.Command):
        raise PluginError(f"{origin} is {type(found).__name__}; expected a click command at {command.place}")
    return found


def listed() -> list[tuple[str, list[tuple[str, str]]]]:
    """Titles, and below each its commands as they are typed, with what they do."""
    own = [(_typed(name, one), one.doc) for name, one in OWN.items()]
    others: dict[str, list[tuple[str, str]]] = {}
    for name, (one, origin) in _brought().items():
        if name not in OWN:
            others.setdefault(origin, []).append((_typed(name, one), one.doc))
    return [("Commands", own), *((_title(origin), rows) for origin, rows in others.items())]


def _title(origin: str) -> str:
    return "Commands of what is installed with it" if origin == _discovery().OWN else f"Commands of {origin}"


def _typed(name: str, command: Command) -> str:
    return f"{name} {command.usage}".rstrip()


def missed(name: str) -> str:
    """'; ...': why nobody brings a command, where a distribution that may is broken."""
    return str(_discovery().installed().missed("commands", name))

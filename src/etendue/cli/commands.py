"""Command table: the engine's own commands, and those that distributions register with ``etendue_commands``.

In:  names.
Out: ``Command``: its location, usage and description. A command's module is imported when it is called.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from types import ModuleType

import click

from etendue.errors import PluginError


@dataclasses.dataclass(frozen=True)
class Command:
    """``place``: ``module:function`` of a click command; ``usage``: the arguments after its name; ``doc``: a short
    description for ``--help``.
    """

    place: str
    usage: str = ""
    doc: str = ""


_HERE = "etendue.cli"
OWN = {
    "run": Command(f"{_HERE}.runs:run", "FILE", "run a pipeline and archive the results; resume an existing archive"),
    "plan": Command(
        f"{_HERE}.runs:plan", "FILE", "show what would run: cells, bytes, time, omissions and their reasons"
    ),
    "rerun": Command(f"{_HERE}.runs:rerun", "DIR", "bring an archive up to date, from the archive alone"),
    "stages": Command(f"{_HERE}.catalogue:stages", "[NAME]", "list installed stages: inputs, outputs, parameters"),
    "quantities": Command(f"{_HERE}.catalogue:quantities", "[NAME]", "list shared quantities: meaning, unit, range"),
    "show": Command(f"{_HERE}.runs:archive", "DIR", "summarise an archive and the progress of its run"),
    "report": Command(f"{_HERE}.pages:report", "DIR", "write a self-contained HTML report"),
    "view": Command(f"{_HERE}.pages:view", "DIR", "browse every sample of every stage, live"),
    "plot": Command(
        f"{_HERE}.plots:plot", "DIR [KIND]", "plot maps, curves, Pareto fronts, pictures; --list shows which"
    ),
    "verify": Command(f"{_HERE}.trust:verify", "DIR", "check every byte; --repair fixes damage"),
    "reproduce": Command(f"{_HERE}.trust:reproduce", "DIR", "recompute and compare, cell by cell"),
    "diff": Command(f"{_HERE}.trust:diff", "DIR DIR", "list cells that differ between archives, with size and cause"),
    "compact": Command(f"{_HERE}.compacting:compact", "DIR [NEW]", "rewrite an archive with its axes sorted"),
    "accuracy": Command(f"{_HERE}.accuracy:accuracy", "FILE", "measure error against run time of accuracy settings"),
    "new": Command(f"{_HERE}.beginnings:new", "NAME", "create a commented pipeline to start from"),
    "new-plugin": Command(
        f"{_HERE}.beginnings:new_plugin", "NAME --role R", "create an installable package with a stage of your own"
    ),
    "schema": Command(f"{_HERE}.catalogue:schema", "", "print a JSON Schema of pipeline files, for editors"),
}


@cache
def offered() -> dict[str, Command]:
    """Return all commands by name. Commands of the engine take precedence over others of the same name."""
    found = dict(OWN)
    for name, (command, _) in _brought().items():
        found.setdefault(name, command)
    return found


def _discovery() -> ModuleType:
    """Return the discovery module. It is imported only for commands of other distributions."""
    from etendue.plugins import discovery

    return discovery


@cache
def _brought() -> dict[str, tuple[Command, str]]:
    """Return the commands that distributions register, with their origin; commands that cannot be read are omitted."""
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
    """Import and return the command.

    Raises
    ------
    PluginError
        The module of the command cannot be imported, or contains no click command of this name.
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
    """Return section titles, each with its commands as typed and their descriptions."""
    own = [(_typed(name, one), one.doc) for name, one in OWN.items()]
    others: dict[str, list[tuple[str, str]]] = {}
    for name, (one, origin) in _brought().items():
        if name not in OWN:
            others.setdefault(origin, []).append((_typed(name, one), one.doc))
    return [("Commands", own), *((_title(origin), rows) for origin, rows in others.items())]


def _title(origin: str) -> str:
    return "More commands" if origin == _discovery().OWN else f"Commands of {origin}"


def _typed(name: str, command: Command) -> str:
    return f"{name} {command.usage}".rstrip()


def missed(name: str) -> str:
    """Return the end of a message, '; ...', if a broken distribution may be why a command is missing; else ''."""
    return str(_discovery().installed().missed("commands", name))

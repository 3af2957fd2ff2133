"""Rewrite error messages for calls from Python: they name arguments instead of command-line options, and have a short
traceback.

In:  a function that is called from scripts and notebooks.
Out: the same function. If it refuses the request, the traceback shows only the call, and the message names its
     arguments.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from etendue.errors import ArchiveError, Fault, MachineError, RequestError

Called = TypeVar("Called", bound=Callable[..., Any])

PHRASES = (  # whole commands first, because they contain options
    ("etendue plot ARCHIVE pareto METRIC METRIC", "plot.pareto('METRIC', 'METRIC')"),
    ("etendue plot ARCHIVE --list", "etendue.Archive(...).tree.etendue.list()"),
    ("etendue compare --axis", "Pipeline.compare(...)"),
    ("omit --at", "give no values of axes"),
    ("choose cells with --at, such as --at ", "choose cells, such as with "),
    ("or write them with --all", "or write them with everything=True"),
    ("write over it with --force", "write over it with force=True"),
    ("elsewhere with --output", "elsewhere with output="),
)
TYPED = ("prune", "accept-platform", "recompute", "cell-timeout")  # options that only the command takes
KINDS = ("dng", "tiff", "png")  # kinds of exported files
ARGUMENTS = {"variable": "variables", "all": "everything"}
_LISTED = re.compile(r"\b(etendue [a-z-]+) lists them")
_COMMAND = re.compile(r"\betendue (?:[a-z]+\b)[^;:,()\n]*")
_TEXT = r"'[^']*'"
_AGAIN = re.compile(rf"\b(\w+)={_TEXT}(?: \1={_TEXT})+")
_PLACE = re.compile(r"--(?:at|set) (?=[\w.]+\b)")
_OPTION = re.compile(
    r"--([a-z][a-z-]*)(?: (?!(?:and|or|of|is|to|in|on|with|where|from|that|as|at|for|has|gives)\b)([^\s:;()]+))?"
)


def in_arguments(text: str) -> str:
    """Return a message that names arguments of a call: ``--scheduler thread`` becomes ``scheduler='thread'``, ``--at
    NAME=4`` becomes ``NAME=4``.

    Commands for the shell are not changed.
    """
    text = _LISTED.sub(r"they are listed by the command `\1`", text)
    for phrase, said in PHRASES:
        text = text.replace(phrase, said)
    kept: list[str] = []

    def keep(found: re.Match[str]) -> str:
        kept.append(found[0])
        return f"\0{len(kept) - 1}\0"

    text = _AGAIN.sub(_together, _OPTION.sub(_argument, _PLACE.sub("", _COMMAND.sub(keep, text))))
    return re.sub(r"\0(\d+)\0", lambda found: kept[int(found[1])], text)


def _together(found: re.Match[str]) -> str:
    """Join the repeated values of an option to a list."""
    return f"{found[1]}=[{', '.join(re.findall(_TEXT, found[0]))}]"


def _argument(found: re.Match[str]) -> str:
    name, value = found[1].replace("-", "_"), found[2]
    if found[1] in TYPED:
        return f"etendue run {found[0]}"
    if name in KINDS:
        return f"kind={name!r}" + (f" {value}" if value else "")
    name = ARGUMENTS.get(name, name)
    if value is None:
        return f"{name}="
    number = re.fullmatch(r"[-+]?[\d.]+(?:e[-+]?\d+)?", value)
    return f"{name}={value if number else repr(value)}"


def _said(error: RequestError | ArchiveError | MachineError) -> Exception:
    """Rewrite the texts of an error and return the same error; its line numbers and notes stay."""
    if isinstance(error, RequestError):
        faults = [Fault(in_arguments(one.place), in_arguments(one.message), one.line) for one in error.faults]
        error.faults = faults
        error.args = (str(error),)
    elif error.args and isinstance(error.args[0], str):
        error.args = (in_arguments(error.args[0]), *error.args[1:])
    return error


def called(function: Called) -> Called:
    """Wrap a function for scripts and notebooks: an error about the request is raised at the call, without internal
    frames.

    Errors of plugins and of etendue itself keep their complete traceback.
    """

    @wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        __tracebackhide__ = True  # hides the frame in IPython and pytest
        try:
            return function(*arguments, **named)
        except (RequestError, ArchiveError, MachineError) as error:
            refused = _said(error)
        raise refused.with_traceback(None) from None

    return call  # type: ignore[return-value]


def called_methods(kind: type[Any]) -> type[Any]:
    """Apply ``called`` to the public methods, properties and constructor of a class."""
    for name, value in list(vars(kind).items()):
        if isinstance(value, classmethod) and not name.startswith("_"):
            setattr(kind, name, classmethod(called(value.__func__)))
        elif isinstance(value, property) and value.fget is not None and not name.startswith("_"):
            setattr(kind, name, property(called(value.fget), doc=value.__doc__))
        elif (
            callable(value)
            and not isinstance(value, type | staticmethod)
            and (not name.startswith("_") or name in ("__init__", "__call__"))
        ):
            setattr(kind, name, called(value))
    return kind

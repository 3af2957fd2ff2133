"""Installed stages as functions that place them in a pipeline: ``from etendue import stages as s``;
``s.diffraction(terms=6)``.

In:  names of stages, including those of plugins, and their parameters as in a pipeline file.
Out: ``Placed`` values. Nothing is computed; a stage is imported when its signature, help or a call needs it.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any

from etendue.calls import called, called_methods
from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of, reads_of, writes_of
from etendue.contract.values.parameter import MISSING, Parameter
from etendue.contract.values.tables import tables
from etendue.contract.values.units import as_written
from etendue.errors import Fault, RequestError, nearest
from etendue.types.documents import Document, DocumentView


@dataclasses.dataclass(frozen=True)
class Placed:
    """One stage of a pipeline: its kind, name, parameters as written, and the stages from which it reads."""

    use: str
    values: DocumentView
    name: str
    reads_from: Mapping[str, str]

    def table(self) -> Document:
        """Return the stage as a ``[[stages]]`` table of a pipeline file."""
        own: Document = {"use": self.use}
        if self.name != self.use:
            own["name"] = self.name
        if self.reads_from:
            own["from"] = dict(self.reads_from)
        return {**own, **self.values}

    def with_values(self, **values: Any) -> Placed:
        """Return the stage with other values for some parameters."""
        return maker(self.use)(name=self.name, reads_from=self.reads_from, **{**self.values, **values})

    def __repr__(self) -> str:
        words = [f"{name}={value!r}" for name, value in self.values.items()]
        if self.name != self.use:
            words.insert(0, f"name={self.name!r}")
        if self.reads_from:
            words.append(f"reads_from={dict(self.reads_from)!r}")
        return f"{self.use}({', '.join(words)})"


@called_methods
class Maker:
    """A function that stands for one stage: called with parameters, it returns the ``Placed`` stage."""

    def __init__(self, use: str) -> None:
        self.__name__ = self.__qualname__ = use

    def __call__(
        self, *, name: str | None = None, reads_from: Mapping[str, str] | None = None, **values: Any
    ) -> Placed:
        own = self._own()
        given = {key: plain(value) for key, value in values.items() if value is not None}
        faults = [
            Fault(f"{self.__name__}.{key}", _unknown(key, own, parameters_of(self._kind)))
            for key in given
            if key not in own
        ]
        if faults:
            raise RequestError(faults)
        return Placed(self.__name__, given, name or self.__name__, dict(reads_from or {}))

    @cached_property
    def _kind(self) -> Any:
        return installed_stages().load(self.__name__)

    def _own(self) -> dict[str, tuple[Parameter, Any, Any]]:
        """Return the stage's own parameters, without shared quantities."""
        return {name: found for name, found in parameters_of(self._kind).items() if not found[0].shared}

    @property
    def __signature__(self) -> inspect.Signature:
        keyword = inspect.Parameter.KEYWORD_ONLY
        parameters = [
            inspect.Parameter(
                name, keyword, default=inspect.Parameter.empty if default is MISSING else default, annotation=kind
            )
            for name, (_, kind, default) in self._own().items()
        ]
        parameters += [
            inspect.Parameter("name", keyword, default=None, annotation=str | None),
            inspect.Parameter("reads_from", keyword, default=None, annotation=Mapping[str, str] | None),
        ]
        return inspect.Signature(parameters, return_annotation=Placed)

    @property
    def __doc__(self) -> str:  # type: ignore[override]
        kind = self._kind
        lines = [inspect.cleandoc(kind.__doc__ or ""), ""]
        for word, ports in (("Reads", reads_of(kind)), ("Writes", writes_of(kind))):
            lines += [f"{word} {declared}" for declared in ports.values()]
        shared = [name for name, (parameter, _, _) in parameters_of(kind).items() if parameter.shared]
        if shared:
            lines.append(f"Uses the shared {', '.join(shared)}: Pipeline.{next(iter(tables()))}(...)")
        own = self._own()
        if own:
            lines += ["", "Parameters", "----------"]
        for name, (parameter, _, default) in own.items():
            lines.append(f"{name} : {_form(parameter, default)}")
            if parameter.doc:
                lines.append(f"    {parameter.doc}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"<stage {self.__name__}{self.__signature__}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return maker, (self.__name__,)


class Stages:
    """All installed stages by name."""

    __name__ = "etendue.stages"

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("_") and name in installed_stages():
            return maker(name)
        raise AttributeError(
            f"unknown stage {name!r}{nearest(name, installed_stages().names())}; to list all: etendue stages"
        )

    def __dir__(self) -> list[str]:
        return installed_stages().names()

    def __repr__(self) -> str:
        return f"<{len(dir(self))} stages: {', '.join(dir(self))}>"

    def __reduce__(self) -> str:
        return "STAGES"


STAGES = Stages()
_MAKERS: dict[str, Maker] = {}


@called
def maker(use: str) -> Maker:
    """Return the function that places a stage; there is one per stage.

    Raises
    ------
    RequestError
        If the stage is unknown.
    """
    if use not in installed_stages():
        raise RequestError(
            [
                Fault(
                    "",
                    f"unknown stage {use!r}{nearest(use, installed_stages().names())}; to list all: etendue stages",
                )
            ]
        )
    return _MAKERS.setdefault(use, Maker(use))


def plain(value: Any) -> Any:
    """Convert a value for a document: tuples and arrays to lists, numpy scalars to numbers, paths to text."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if hasattr(value, "__fspath__"):
        return str(value)
    if isinstance(value, float) and math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return value


def _unknown(name: str, own: DocumentView, every: DocumentView) -> str:
    if name in every:
        return f"{name} is shared by stages; set it with Pipeline.{next(iter(tables()))}({name}=...)"
    return f"unknown parameter{nearest(name, own) or '; the stage has none'}"


def _form(parameter: Parameter, default: Any) -> str:
    parts = [parameter.units] if parameter.units not in ("", "1") else []
    parts += (
        [f"one of {', '.join(parameter.choices)}"]
        if parameter.choices
        else [text for text in (parameter.range_text(),) if text]
    )
    parts += ["required"] if default is MISSING else [f"default {as_written(default)}"]
    return ", ".join(parts)

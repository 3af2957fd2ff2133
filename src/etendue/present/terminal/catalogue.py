"""Lists of what is installed: stages by role, and the quantities that stages share.

In:  the registry.
Out: stages and shared quantities on the terminal, or as JSON.
"""

from __future__ import annotations

import math
import re
from inspect import cleandoc

from rich.console import Console
from rich.padding import Padding

from etendue.contract.registry import Registry
from etendue.contract.stage import parameters_of, reads_of, writes_of
from etendue.contract.values import quantities
from etendue.contract.values.parameter import MISSING
from etendue.contract.values.tables import tables
from etendue.errors import PluginError
from etendue.plugins import discovery
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.types.documents import Document


def stage_document(registry: Registry, name: str) -> Document:
    """Return one stage as JSON; a broken plugin gives the reason."""
    installed = registry.installed(name)
    document: Document = {"name": name, "distribution": installed.distribution, "version": installed.version}
    try:
        kind = registry.load(name)
    except PluginError as error:
        return {**document, "role": "", "reads": {}, "writes": {}, "parameters": {}, "doc": "", "broken": str(error)}
    parameters = {}
    for key, (parameter, kind_of, default) in parameters_of(kind).items():
        value = None if default is MISSING else (list(default) if isinstance(default, tuple) else default)
        if isinstance(value, float) and not math.isfinite(value):
            value = "inf"
        parameters[key] = {
            "type": getattr(kind_of, "__name__", str(kind_of)),
            "units": parameter.units,
            "default": value,
            "required": default is MISSING,
            "range": parameter.shown_range(),
            "choices": list(parameter.choices) if parameter.choices else None,
            "shared": parameter.shared,
            "fidelity": parameter.reference or None,
            "settings": ["inf" if v == math.inf else v for v in parameter.settings] if parameter.settings else None,
            "studied": parameter.studied,
            "doc": parameter.doc,
        }
    return {
        **document,
        "role": kind.role,
        "reads": {p: str(d) for p, d in reads_of(kind).items()},
        "writes": {p: str(d) for p, d in writes_of(kind).items()},
        "parameters": parameters,
        "doc": (kind.__doc__ or "").strip(),
    }


def print_stages(documents: list[Document]) -> None:
    """Print every stage on a line below its role, in the order in which roles are declared; then undeclared roles and
    broken stages.
    """
    console = _out()
    roles, working = discovery.installed(), [d for d in documents if "broken" not in d]
    declared = roles.names("roles")
    rows: list[Document] = []
    for role in dict.fromkeys([*declared, *sorted({d["role"] for d in working})]):
        own = [d for d in working if d["role"] == role]
        if own:
            said = roles.first("roles", role)
            rows.append({"name": role or "(no role)", "doc": str(said.value) if said else ""})
        rows += [{"name": f"  {d['name']}", "doc": first_sentence(d["doc"]) + _origin(d)} for d in own]
    columns = ("stage", "left", "name"), ("description", "left", "doc")
    console.print(_table("stages by role", *columns, rows=rows, wrap=("description",)))
    for role in sorted({d["role"] for d in working} - {"", *declared}):
        who = ", ".join(d["name"] for d in working if d["role"] == role)
        console.print(escape(f"note: no distribution describes the role {role!r} of {who} in etendue_roles()"))
    for d in documents:
        if "broken" in d:
            console.print(f"broken: {d['name']}: {escape(d['broken'])}")
    console.print("details of a stage: etendue stages NAME; shared quantities: etendue quantities")


def _origin(document: Document) -> str:
    """Return ' (from NAME VERSION)' for an item that is not built in."""
    return (
        "" if document["distribution"] == discovery.OWN else f" (from {document['distribution']} {document['version']})"
    )


def first_sentence(doc: str) -> str:
    """Return the first sentence, for lists; 'eq. 5' does not end one."""
    paragraph = " ".join(cleandoc(doc).split("\n\n")[0].split())
    return re.split(r"(?<=[.!?])(?<!\beq\.)(?<!\beqs\.)(?<!\bFig\.)\s", paragraph, maxsplit=1)[0]


def print_stage(document: Document) -> None:
    """Print one stage in full: description, inputs, outputs, and a paragraph for every parameter."""
    console = _out()
    role = f", {document['role']}" if document["role"] else ""
    console.print(escape(f"{document['name']}{role}, from {document['distribution']} {document['version']}"))
    if "broken" in document:
        console.print(f"broken: {escape(document['broken'])}")
        return
    console.print(escape(re.sub(r"(?<!\n)\n(?!\n)", " ", cleandoc(document["doc"]))))  # one line per paragraph
    for what in ("reads", "writes"):
        for declaration in document[what].values():
            console.print(f"{what:7s} {escape(declaration)}")
    for key, p in document["parameters"].items():
        _print_parameter(console, key, p)


def _print_parameter(console: Console, key: str, p: Document) -> None:
    units = f" {p['units']}" if p["units"] not in ("1", "") else ""
    value = f" in{units}" if units else ""
    if not p["required"]:
        value = " = ''" if p["default"] == "" else f" = {p['default']}{units}"
    allowed = f"one of {', '.join(p['choices'])}" if p["choices"] else p["range"]
    notes = [
        text
        for text in (
            "required" if p["required"] else "",
            f"under [{next(iter(tables()))}]" if p["shared"] else "",
            allowed,
        )
        if text
    ]
    console.print(escape(f"\n{key}{value}{'   (' + '; '.join(notes) + ')' if notes else ''}"))
    settings = f"; settings from cheapest: {', '.join(f'{v}' for v in p['settings'])}" if p["settings"] else ""
    for text in (
        p["doc"],
        f"accuracy setting (finer takes more time); reference: {p['fidelity']}{settings}" if p["fidelity"] else "",
    ):
        if text:
            console.print(Padding(escape(text), (0, 0, 0, 4)))


def quantity_document(name: str, registry: Registry | None = None) -> Document:
    """Return one shared quantity as JSON; with a registry, also the stages that take it. One that cannot be read gives
    the reason.
    """
    brought = discovery.installed().all("quantities", name)
    found: Document = {"name": name, "distribution": brought[0].distribution, "version": brought[0].version}
    try:
        if clash := discovery.installed().clash("quantities", name):
            raise PluginError(clash)
        found |= _plain(quantities.declared(name))
    except PluginError as error:
        return {
            **found,
            "units": "",
            "default": None,
            "required": False,
            "range": "",
            "choices": None,
            "doc": "",
            "broken": str(error),
        }
    if registry is not None:
        found["stages"] = [stage for stage in registry.names() if _takes(registry, stage, name)]
    return found


def _takes(registry: Registry, stage: str, name: str) -> bool:
    try:
        declared = parameters_of(registry.load(stage)).get(name)
    except PluginError:
        return False
    return declared is not None and declared[0].shared


def _plain(parameter: quantities.Quantity) -> Document:
    value = None if parameter.default is MISSING else parameter.default
    if isinstance(value, float) and not math.isfinite(value):
        value = "inf"
    return {
        "units": parameter.units,
        "default": value,
        "required": parameter.default is MISSING,
        "range": parameter.shown_range(),
        "choices": list(parameter.choices) if parameter.choices else None,
        "doc": parameter.doc,
    }


def print_quantities(documents: list[Document]) -> None:
    """Print every shared quantity on a line."""
    columns = (
        ("quantity", "left", "name"),
        ("default", "right", lambda d: "required" if d["required"] else _valued(d)),
        ("description", "left", lambda d: (f"broken: {d['broken']}" if "broken" in d else d["doc"]) + _origin(d)),
    )
    title = f"shared quantities, set under \\[{next(iter(tables()))}] in a pipeline"
    console = _out()
    console.print(_table(title, *columns, rows=documents, wrap=("description",)))
    console.print("range and stages of a quantity: etendue quantities NAME")


def _valued(document: Document) -> str:
    units = "" if document["units"] in ("1", "") else f" {document['units']}"
    return "''" if document["default"] == "" else f"{document['default']}{units}"


def print_quantity(document: Document) -> None:
    console = _out()
    console.print(escape(f"{document['name']}: {document['doc']}{_origin(document)}"))
    if "broken" in document:
        console.print(escape(f"broken: {document['broken']}"))
        return
    console.print(escape("required, no default" if document["required"] else f"default  {_valued(document)}"))
    allowed = f"one of {', '.join(document['choices'])}" if document["choices"] else document["range"]
    if allowed:
        console.print(escape(f"allowed  {allowed}"))
    console.print(f"used by  {', '.join(document['stages']) or 'no installed stage'}")

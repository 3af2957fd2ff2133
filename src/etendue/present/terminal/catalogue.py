"""Lists of installed items: stages by role, and the quantities that stages share.

In:  documents of ``contract.listing``.
Out: stages and shared quantities on the terminal.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from inspect import cleandoc

from rich.console import Console
from rich.padding import Padding

from etendue.contract.values.tables import table_of, tables
from etendue.plugins.discovery import OWN
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.types.documents import Document


def print_stages(documents: list[Document], roles: Mapping[str, str]) -> None:
    """Print every stage on a line below its role, in the order of ``roles``; then undeclared roles and broken
    stages.
    """
    console = _out()
    working = [d for d in documents if "broken" not in d]
    rows: list[Document] = []
    for role in dict.fromkeys([*roles, *sorted({d["role"] for d in working})]):
        own = [d for d in working if d["role"] == role]
        if own:
            rows.append({"name": role or "(no role)", "doc": roles.get(role, "")})
        rows += [{"name": f"  {d['name']}", "doc": first_sentence(d["doc"]) + _origin(d)} for d in own]
    columns = ("stage", "left", "name"), ("description", "left", "doc")
    console.print(_table("stages by role", *columns, rows=rows, wrap=("description",)))
    for role in sorted({d["role"] for d in working} - {"", *roles}):
        who = ", ".join(d["name"] for d in working if d["role"] == role)
        console.print(escape(f"note: no distribution describes the role {role!r} of {who} in etendue_roles()"))
    for d in documents:
        if "broken" in d:
            console.print(f"broken: {d['name']}: {escape(d['broken'])}")
    console.print("details of a stage: etendue stages NAME; shared quantities: etendue quantities")


def _origin(document: Document) -> str:
    """Return ' (from NAME VERSION)' for an item that is not built in."""
    return "" if document["distribution"] == OWN else f" (from {document['distribution']} {document['version']})"


def _one_of(choices: Sequence[str] | None) -> str:
    return f"one of {', '.join(choices)}" if choices else ""


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
    allowed = " ".join(filter(None, (_one_of(p["choices"]), p["range"])))
    notes = [
        text
        for text in (
            "required" if p["required"] else "",
            f"under [{table_of(key)}]" if p["shared"] else "",
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
    allowed = " ".join(filter(None, (_one_of(document["choices"]), document["range"])))
    if allowed:
        console.print(escape(f"allowed  {allowed}"))
    console.print(f"used by  {', '.join(document['stages']) or 'no installed stage'}")

"""Make a page for every installed stage and one for all camera quantities, from their declarations."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from etendue.contract.arrays.variables import parse_declaration, variable
from etendue.contract.listing import quantity_document, stage_document
from etendue.contract.registry import Registry, installed_stages
from etendue.contract.values import quantities as camera
from etendue.plugins import discovery
from etendue.present.terminal.catalogue import first_sentence
from making.markdown import paragraphs, shown, table, toctree

SEEN = {
    "*.transfer": "the transfer functions of the earlier stages",
    "*.datasheet": "the data sheets of the earlier stages",
}


def pages(root: Path, pictures: Mapping[str, str]) -> dict[str, str]:
    """Return pages by name: ``stages/index``, one for each stage, and ``quantities``. ``pictures`` gives the pictured
    variable of each stage.
    """
    registry = installed_stages()
    documents = [stage_document(registry, name) for name in registry.names()]
    working = [document for document in documents if "broken" not in document]
    used = users(root)
    made = {f"stages/{d['name']}": _page(d, working, used.get(d["name"], []), pictures.get(d["name"])) for d in working}
    return {**made, "stages/index": _index(working), "quantities": _quantities(registry)}


def users(root: Path) -> dict[str, list[str]]:
    """Return the shipped pipelines that use each stage, by stage name."""
    found: dict[str, list[str]] = {}
    for path in sorted((root / "pipelines").glob("*.toml")):
        for use in dict.fromkeys(stage["use"] for stage in tomllib.loads(path.read_text())["stages"]):
            found.setdefault(use, []).append(path.stem)
    return found


def roles(documents: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Return stages by role, in light order; undeclared roles come last."""
    declared = discovery.installed().names("roles")
    names = dict.fromkeys([*declared, *sorted({d["role"] for d in documents})])
    found = {name: [d for d in documents if d["role"] == name] for name in names}
    return {name: own for name, own in found.items() if own}


def said_of(role: str) -> str:
    """Return the sentence with which a distribution describes a role."""
    brought = discovery.installed().first("roles", role)
    return str(brought.value) if brought else ""


def _index(documents: list[dict[str, Any]]) -> str:
    parts = [
        "# Stages",
        "Stages by role, in light order. On the command line: `etendue stages` lists them, `etendue stages NAME` "
        "describes one.",
    ]
    for role, own in roles(documents).items():
        rows = [(f"[{d['name']}]({d['name']}.md)", shown(first_sentence(d["doc"]) + _origin(d))) for d in own]
        parts += [
            f"## {shown(role or 'without a role').capitalize()}",
            shown(said_of(role)),
            table(("stage", ""), rows),
        ]
    return "\n\n".join([*parts, toctree(sorted(d["name"] for d in documents), ":hidden:")])


def _origin(document: dict[str, Any]) -> str:
    return "" if document["distribution"] == discovery.OWN else f" (from {document['distribution']})"


def _page(document: dict[str, Any], every: list[dict[str, Any]], used: list[str], picture: str | None) -> str:
    name, role = document["name"], document["role"]
    parts = [f"# {name}", paragraphs(document["doc"])]
    if picture:
        parts.append(f"![{shown(picture)} after {shown(name)}](../pictures/{name}.png)")
    for word in ("reads", "writes"):
        declared = [parse_declaration(port, text) for port, text in document[word].items()]
        if declared:
            parts += [
                f"## {word.capitalize()}",
                table(("variable", "dims", "unit", ""), [_declared(one) for one in declared]),
            ]
    shared = [key for key, p in document["parameters"].items() if p["shared"] and key in camera.names()]
    own = {key: p for key, p in document["parameters"].items() if key not in shared}
    if own:
        parts += [
            "## Parameters",
            table(("name", "unit", "default", "allowed", ""), [_parameter(key, p) for key, p in own.items()]),
        ]
    if shared:
        parts += ["## Shared", ", ".join(f"[{shown(key)}](../quantities.md#{anchor(key)})" for key in shared)]
    if role:
        others = [d["name"] for d in every if d["role"] == role and d["name"] != name]
        parts += ["## Role", f"{shown(role.capitalize())}: {shown(said_of(role))}."]
        parts += (
            ["Others of this role: " + ", ".join(f"[{shown(one)}]({one}.md)" for one in others) + "."] if others else []
        )
    if used:
        parts += ["## Used in", ", ".join(f"[{one}.toml](../../../pipelines/{one}.toml)" for one in used)]
    parts.append(f"From {document['distribution']} {document['version']}.")
    return "\n\n".join(parts)


def _declared(one: Any) -> tuple[str, ...]:
    unit = "" if one.unit in ("", "1") else f"`{one.unit}`"
    dims = " ".join(dim for dim in one.dims if dim != ":")
    return f"`{one.variable}`", dims, unit, shown(_said(one.variable))


def _said(name: str) -> str:
    if name in SEEN:
        return SEEN[name]
    of_all = name.removeprefix("*.")
    return variable(of_all).long_name + (", of every earlier stage that writes it" if of_all != name else "")


def _parameter(name: str, p: dict[str, Any]) -> tuple[str, ...]:
    units = "" if p["units"] in ("", "1") else f"`{p['units']}`"
    default = "required" if p["required"] else "`''`" if p["default"] == "" else f"`{p['default']}`"
    allowed = ", ".join(f"`{one}`" for one in p["choices"]) if p["choices"] else shown(p["range"])
    knob = f"accuracy setting (finer takes more time); reference: {p['fidelity']}" if p["fidelity"] else ""
    return f"`{name}`", units, default, allowed, shown("; ".join(filter(None, [p["doc"].rstrip("."), knob])))


def anchor(name: str) -> str:
    """Return the anchor of a heading with this name."""
    return name.lower().replace(" ", "-")


def _quantities(registry: Registry) -> str:
    parts = [
        "# Camera quantities",
        "Values that several stages share, given once under `[camera]`. On the command line: `etendue quantities`.",
    ]
    for name in camera.names():
        d = quantity_document(name, registry)
        if "broken" in d:
            continue
        units = "" if d["units"] in ("", "1") else f" {d['units']}"
        value = (
            "required, no default"
            if d["required"]
            else "default `''`"
            if d["default"] == ""
            else f"default `{d['default']}{units}`"
        )
        allowed = "one of " + ", ".join(f"`{one}`" for one in d["choices"]) if d["choices"] else shown(d["range"])
        takers = ", ".join(f"[{shown(one)}](stages/{one}.md)" for one in d["stages"])
        said = "; ".join(filter(None, [value, allowed]))
        parts += [f"## {name}", shown(d["doc"]), said + ".", f"Used by {takers}." if takers else ""]
    return "\n\n".join(filter(None, parts))

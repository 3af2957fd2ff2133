"""What is installed, in words: stages by what they are for, and the quantities that stages share.

In:  the registry.
Out: stages and camera quantities on the terminal, or as JSON.
"""

from __future__ import annotations

import math
import re
from inspect import cleandoc
from typing import Any

from rich.padding import Padding

from etendue.errors import PluginError
from etendue.registry import Registry
from etendue.report.terminal import _out, _table, escape
from etendue.spec import camera
from etendue.spec.parameter import MISSING, Parameter
from etendue.spec.stage import parameters_of, reads_of, writes_of

GROUPS: tuple[tuple[str, frozenset[str]], ...] = (
    ("light and lens", frozenset({"radiance", "irradiance"})),
    ("pixel and colour filter array", frozenset({"photon_rate", "photocurrent"})),
    ("exposure, noise and read-out", frozenset({"expected_charge", "charge", "raw"})),
    ("raw corrections", frozenset({"mosaic_linear"})),
    ("reconstruction", frozenset({"rgb_camera"})),
    ("colour and display", frozenset({"white", "colour_matrix", "xyz_scene", "lms", "rgb_linear", "xyz_display", "rgb_display"})),
)
SCENES, FIGURES = "scenes", "figures and measures"


def stage_document(registry: Registry, name: str) -> dict[str, Any]:
    """One stage as JSON; a broken plugin says why it is broken."""
    installed = registry.installed(name)
    clash = registry.clash(name)
    document: dict[str, Any] = {"name": name, "distribution": installed.distribution, "version": installed.version}
    try:
        if clash:
            raise PluginError(f"offered by {' and '.join(clash)}; uninstall one of them")
        kind = registry.load(name)
    except PluginError as error:
        return {**document, "reads": {}, "writes": {}, "parameters": {}, "doc": "", "broken": str(error)}
    parameters = {}
    for key, (parameter, kind_of, default) in parameters_of(kind).items():
        value = None if default is MISSING else (list(default) if isinstance(default, tuple) else default)
        if isinstance(value, float) and not math.isfinite(value):
            value = "inf"
        parameters[key] = {
            "type": getattr(kind_of, "__name__", str(kind_of)), "units": parameter.units, "default": value, "required": default is MISSING,
            "range": parameter.shown_range(), "choices": list(parameter.choices) if parameter.choices else None,
            "camera": parameter.camera, "fidelity": parameter.reference or None, "doc": parameter.doc,
        }  # fmt: skip
    return {
        **document,
        "reads": {p: str(d) for p, d in reads_of(kind).items()},
        "writes": {p: str(d) for p, d in writes_of(kind).items()},
        "parameters": parameters,
        "doc": (kind.__doc__ or "").strip(),
    }


def group_of(document: dict[str, Any]) -> str:
    """What a stage is for, by what it writes."""
    written = {text.partition(":")[0] for text in document["writes"].values()}
    if not document["reads"] and written & {"radiance", "irradiance"}:
        return SCENES
    return next((title for title, variables in GROUPS if written & variables), FIGURES)


def print_stages(documents: list[dict[str, Any]]) -> None:
    """A table for every kind of stage, one line each, and what is broken."""
    console = _out()
    for title in (SCENES, *(name for name, _ in GROUPS), FIGURES):
        own = [d for d in documents if "broken" not in d and group_of(d) == title]
        if not own:
            continue
        table = _table(title, ("stage", "left"), ("what it is", "left"), wrap=("what it is",))
        for d in own:
            origin = "" if d["distribution"] == "etendue" else f" (from {d['distribution']} {d['version']})"
            table.add_row(d["name"], escape(first_sentence(d["doc"]) + origin))
        console.print(table)
    for d in documents:
        if "broken" in d:
            console.print(f"broken: {d['name']}: {escape(d['broken'])}")
    console.print("one of them in full: etendue stages NAME; what several of them share: etendue quantities")


def first_sentence(doc: str) -> str:
    """The first sentence, for lists; 'eq. 5' does not end one."""
    paragraph = " ".join(cleandoc(doc).split("\n\n")[0].split())
    return re.split(r"(?<=[.!?])(?<!\beq\.)(?<!\beqs\.)(?<!\bFig\.)\s", paragraph, maxsplit=1)[0]


def print_stage(document: dict[str, Any]) -> None:
    """One stage in full: what it is, reads, writes, and a paragraph for every parameter."""
    console = _out()
    console.print(f"{document['name']}, from {escape(document['distribution'])} {document['version']}")
    if "broken" in document:
        console.print(f"broken: {escape(document['broken'])}")
        return
    console.print(escape(re.sub(r"(?<!\n)\n(?!\n)", " ", cleandoc(document["doc"]))))  # a line for each paragraph
    for what in ("reads", "writes"):
        for declaration in document[what].values():
            console.print(f"{what:7s} {escape(declaration)}")
    for key, p in document["parameters"].items():
        units = f" {p['units']}" if p["units"] not in ("1", "") else ""
        value = f" in{units}" if units else ""
        if not p["required"]:
            value = " = ''" if p["default"] == "" else f" = {p['default']}{units}"
        allowed = f"one of {', '.join(p['choices'])}" if p["choices"] else p["range"]
        notes = [text for text in ("required" if p["required"] else "", "under [camera]" if p["camera"] else "", allowed) if text]
        console.print(escape(f"\n{key}{value}{'   (' + '; '.join(notes) + ')' if notes else ''}"))
        for text in (p["doc"], f"a finer setting costs time; reference: {p['fidelity']}" if p["fidelity"] else ""):
            if text:
                console.print(Padding(escape(text), (0, 0, 0, 4)))


def quantity_document(name: str, registry: Registry | None = None) -> dict[str, Any]:
    """One camera quantity as JSON; with a registry, also the stages that take it."""
    kind, default = camera.declared(name)
    found = {"name": name, **_plain(kind, default)}
    if registry is not None:
        found["stages"] = [stage for stage in registry.names() if _takes(registry, stage, name)]
    return found


def _takes(registry: Registry, stage: str, name: str) -> bool:
    try:
        declared = parameters_of(registry.load(stage)).get(name)
    except PluginError:
        return False
    return declared is not None and declared[0].camera


def _plain(parameter: Parameter, default: Any) -> dict[str, Any]:
    value = None if default is MISSING else default
    if isinstance(value, float) and not math.isfinite(value):
        value = "inf"
    return {
        "units": parameter.units, "default": value, "required": default is MISSING, "range": parameter.shown_range(),
        "choices": list(parameter.choices) if parameter.choices else None, "doc": parameter.doc,
    }  # fmt: skip


def print_quantities(documents: list[dict[str, Any]]) -> None:
    """Every camera quantity in a line."""
    columns = (("quantity", "left"), ("default", "right"), ("what it is", "left"))
    table = _table("quantities that stages share, under \\[camera] in a pipeline", *columns, wrap=("what it is",))
    for d in documents:
        table.add_row(d["name"], "required" if d["required"] else escape(_valued(d)), escape(d["doc"]))
    console = _out()
    console.print(table)
    console.print("one of them with its range and the stages that take it: etendue quantities NAME")


def _valued(document: dict[str, Any]) -> str:
    units = "" if document["units"] in ("1", "") else f" {document['units']}"
    return "''" if document["default"] == "" else f"{document['default']}{units}"


def print_quantity(document: dict[str, Any]) -> None:
    console = _out()
    console.print(escape(f"{document['name']}: {document['doc']}"))
    console.print(escape("required, no default" if document["required"] else f"default  {_valued(document)}"))
    allowed = f"one of {', '.join(document['choices'])}" if document["choices"] else document["range"]
    if allowed:
        console.print(escape(f"allowed  {allowed}"))
    console.print(f"taken by {', '.join(document['stages']) or 'no stage that is installed'}")

"""A JSON Schema of the pipeline file, with which editors complete and check it, including stages and quantities of
plugins.

In:  the registry, shared quantities.
Out: a schema of draft 7. It cannot check keys that depend on values of other keys (names of stages in a sweep, units,
     files); the planner does.
"""

from __future__ import annotations

from collections.abc import Sequence
from inspect import cleandoc
from typing import Any, get_args, get_origin

from etendue.contract.discretised import AUTO, Discretised
from etendue.contract.registry import Registry
from etendue.contract.stage import parameters_of, reads_of
from etendue.contract.values import quantities
from etendue.contract.values.names import LONGEST
from etendue.contract.values.parameter import MISSING, Parameter
from etendue.contract.values.tables import Table, tables
from etendue.errors import PluginError
from etendue.pipeline.about import KEYS, OF_AN_AUTHOR
from etendue.pipeline.form import ARCHIVE, DIGITS
from etendue.pipeline.presets import preset_names
from etendue.types.documents import Document, DocumentView

PLAIN = r"^[^\x00-\x1f\x7f]*$"  # no control characters
TEXT_OF_A_NUMBER = r"^\s*[-+]?(\d[\d_]*\.?\d*|\.\d+)([eE][-+]?\d+)?(\s*[^\d\s].*)?$|^\s*inf(inite)?\s*$"
NAMES = {"type": "array", "items": {"type": "string", "pattern": PLAIN}}
SPACED = {
    "type": "object",
    "properties": {
        "from": {"type": ["number", "string"]},
        "to": {"type": ["number", "string"]},
        "steps": {"type": "integer", "minimum": 1},
        "spacing": {"enum": ["linear", "log"]},
        "dim": {"type": "string"},
    },
    "additionalProperties": False,
    "required": ["from", "to", "steps"],
}
ZIPPED = {
    "type": "object",
    "properties": {"values": {"type": "array", "minItems": 1}, "dim": {"type": "string"}},
    "additionalProperties": False,
    "required": ["values", "dim"],
    "description": "values that change together with the values of every other axis of the same dim",
}
_NUMBER = {"type": ["number", "string"]}
FACTOR = {
    "anyOf": [
        {"type": "array", "minItems": 1, "description": "choices in equal shares"},
        {
            "type": "object",
            "properties": {
                "from": _NUMBER,
                "to": _NUMBER,
                "spacing": {"enum": ["linear", "log"]},
                **{
                    shape: {"type": "array", "items": _NUMBER, "minItems": count, "maxItems": count}
                    for shape, count in (("normal", 2), ("uniform", 2), ("triangular", 3))
                },
                "at_least": _NUMBER,
                "at_most": _NUMBER,
                "levels": {"type": "integer", "minimum": 1},
            },
            "additionalProperties": False,
        },
    ]
}
DESIGN = {
    "type": "object",
    "description": "samples over several parameters at once, along the dim 'sample'",
    "properties": {
        "method": {"enum": ["sobol", "halton", "random", "lhs", "saltelli", "list"], "default": "sobol"},
        "points": {"type": "integer", "minimum": 1},
        "seed": {"type": "integer", "minimum": 0, "default": 0},
        "file": {"type": "string", "description": "a CSV of samples, for method 'list'"},
        "rows": {"type": "array", "items": {"type": "integer", "minimum": 0}, "description": "only these samples"},
        "correlation": {"type": "array", "items": {"type": "array", "minItems": 3, "maxItems": 3}},
        "factors": {
            "type": "object",
            "additionalProperties": {"anyOf": [*FACTOR["anyOf"], {"type": "object", "additionalProperties": FACTOR}]},
        },
    },
    "additionalProperties": False,
}
OF_A_STAGE = {"anyOf": [{"type": "array"}, SPACED, ZIPPED]}  # axes in a table of their stage


def schema(registry: Registry) -> Document:
    """Return the schema of the whole file."""
    kinds = {name: kind for name in registry.names() if (kind := _loaded(registry, name)) is not None}
    every = [(name, *found) for kind in kinds.values() for name, found in parameters_of(kind).items()]
    types = {name: of for name, parameter, of, _ in every if parameter.shared}
    given = {
        name: _value(quantities.declared(name), quantities.declared(name).default, types.get(name))
        for name in quantities.names()
    }
    own = {name: _value(parameter, default, of) for name, parameter, of, default in every if parameter.shared}
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "a pipeline of etendue",
        "type": "object",
        "properties": {
            "name": {
                "type": "string",
                "minLength": 1,
                "maxLength": LONGEST,
                "pattern": r"^[^/\\.\-\x00-\x1f\x7f][^/\\\x00-\x1f\x7f]*$",
            },
            "description": {"type": "string"},
            "seed": {"type": "integer", "minimum": 0, "default": 0, "description": "seed of the random numbers"},
            "tolerance": {
                "type": "number",
                "minimum": 0,
                "exclusiveMaximum": 1,
                "default": 1e-4,
                "description": "largest error that each approximation or omission may add to its stage's output, "
                "relative to full scale",
            },
            "norm": {"enum": ["rms", "max"], "default": "rms"},
            "leave_out": {"type": "boolean", "default": True},
            "stand_ins": {
                "type": "boolean",
                "default": True,
                "description": "whether presets may contain stand-ins: typical values, used if no source gives a value",
            },
            "precision": {"enum": ["auto", "float32", "float64"], "default": "auto"},
            "wanted": {"anyOf": [NAMES, {"type": "string"}], "description": "variables to compute"},
            "keep": {
                "anyOf": [NAMES, {"type": "string"}],
                "description": "variables that are stored; all: everything computed; looks: pictures and metrics, not "
                "light by band",
            },
            ARCHIVE: {
                "type": "object",
                "properties": {"digits": {"enum": list(DIGITS), "default": DIGITS[0]}},
                "additionalProperties": False,
                "description": "storage of results; digits: exact, or rounded to the digits that are "
                "significant at the tolerance",
            },
            "requires": {"anyOf": [NAMES, {"type": "string"}], "description": "distributions whose stages are used"},
            "most_cells": {"type": "integer", "minimum": 1},
            "variant": {"type": "string"},
            "about": _about(),
            **{name: _shared(table, {**own, **given}) for name, table in tables().items()},
            "sweep": {
                "type": "object",
                "properties": {
                    **{
                        kind.preset: _presets(kind, {**own, **given})
                        for table in tables().values()
                        for kind in table.kinds()
                    },
                    **{name: _axis(name, types.get(name)) for name in quantities.names()},
                },
                "additionalProperties": {
                    "anyOf": [_list({}), SPACED, ZIPPED, {"type": "object", "additionalProperties": OF_A_STAGE}]
                },
            },
            "design": DESIGN,
            "stages": {"type": "array", "minItems": 1, "items": _stages(registry.names(), kinds)},
        },
        "additionalProperties": False,
        "required": ["stages"],
    }


def _stages(names: Sequence[str], kinds: DocumentView) -> Document:
    """Return the schema of one ``[[stages]]`` table, which depends on its ``use``."""
    return {
        "type": "object",
        "properties": {"use": {"enum": list(names), "description": "the stage"}},
        "required": ["use"],
        "allOf": [
            {"if": {"properties": {"use": {"const": name}}}, "then": _stage(name, kind)} for name, kind in kinds.items()
        ],
    }


def _loaded(registry: Registry, name: str) -> Any:
    try:
        return registry.load(name)
    except PluginError:
        return None


def _stage(name: str, kind: Any) -> Document:
    own = {key: found for key, found in parameters_of(kind).items() if not found[0].shared}
    properties: Document = {
        "use": {"const": name, "description": cleandoc(kind.__doc__ or "").split("\n\n")[0].replace("\n", " ")},
        "name": {"type": "string", "pattern": r"^\w+$", "description": "its name here; default: the stage's own"},
        "from": {
            "type": "object",
            "description": "stages it reads from, by port",
            "additionalProperties": False,
            "properties": {port: {"type": "string"} for port in reads_of(kind)},
        },
    }
    properties |= {key: _value(parameter, default, of) for key, (parameter, of, default) in own.items()}
    for key in kind.automatic if issubclass(kind, Discretised) else ():
        properties[key]["anyOf"].append({"const": AUTO})
    needed = [key for key, (_, _, default) in own.items() if default is MISSING]
    return {"properties": properties, "additionalProperties": False, **({"required": needed} if needed else {})}


def _value(parameter: Parameter, default: Any, kind: Any = None) -> Document:
    """Return the schema of one value: a number in the declared unit, or text that may have another unit."""
    words = [parameter.doc, f"in {parameter.units}" if parameter.units not in ("", "1") else "", parameter.range_text()]
    found: Document = _form(parameter, default, kind)
    said = "; ".join(word for word in words if word)
    if said:
        found["description"] = said
    if (
        default is not MISSING
        and isinstance(default, bool | int | float | str)
        and default not in (float("inf"), float("-inf"))
    ):
        found["default"] = default
    return found


def _form(parameter: Parameter, default: Any, kind: Any) -> Document:
    if get_origin(kind) is tuple or (kind is None and isinstance(default, tuple)):
        item = _form(
            Parameter(**{**_limits(parameter), "choices": parameter.choices}),
            MISSING,
            get_args(kind)[0] if kind else None,
        )
        whole = _list(item) | (
            {"minItems": parameter.length, "maxItems": parameter.length} if parameter.length is not None else {}
        )
        return {"anyOf": [whole, item]} if parameter.one_for_all else whole
    if parameter.numbered:
        return {
            "anyOf": [
                {"enum": list(parameter.choices or ())},
                {"type": "integer", "minimum": 0},
                {"type": "string", "pattern": "^[0-9]+$"},
            ]
        }
    if parameter.choices:
        return {"enum": list(parameter.choices)}
    if kind is bool or (kind is None and isinstance(default, bool)):
        return {"type": "boolean"}
    if kind is str:
        return (
            {"type": "string", "pattern": PLAIN} if parameter.file else {"type": ["string", "number"], "pattern": PLAIN}
        )
    if kind in (int, float):
        words = {"above": "exclusiveMinimum", "at_least": "minimum", "below": "exclusiveMaximum", "at_most": "maximum"}
        bounds = {words[name]: limit for name, limit in _limits(parameter).items() if limit is not None}
        number = {"type": "integer" if kind is int else "number", **bounds}
        return {"anyOf": [number, {"type": "string", "pattern": TEXT_OF_A_NUMBER}]}
    return {}


def _limits(parameter: Parameter) -> DocumentView:
    return {name: getattr(parameter, name) for name in ("above", "at_least", "below", "at_most")}


def _list(item: DocumentView) -> Document:
    return {"type": "array", "items": dict(item)}


def _axis(name: str, kind: Any) -> Document:
    declared = quantities.declared(name)
    values = _list(_form(declared, MISSING, kind)) | {"minItems": 1, "uniqueItems": True}
    return {"anyOf": [values, SPACED, ZIPPED], "description": declared.long_name or declared.doc}


def _shared(table: Table, given: DocumentView) -> Document:
    """Return the schema of a table of shared quantities, with its preset key."""
    named = {
        kind.preset: {**_names(kind), "description": f"values of a known {kind.preset}, or a file of them"}
        for kind in table.kinds()
    }
    return {
        "type": "object",
        "properties": {**named, **given},
        "additionalProperties": False,
    }


def _names(table: Table) -> Document:
    if table.find:
        return {"type": "string", "pattern": PLAIN}
    return {"anyOf": [{"enum": list(preset_names(table))}, {"type": "string", "pattern": r"\.toml$"}]}


def _presets(table: Table, given: DocumentView) -> Document:
    """Return the schema of the axis of presets: names, or tables of quantities."""
    name = _names(table)
    own = {
        "type": "object",
        "properties": {table.preset: name, "label": {"type": "string", "pattern": PLAIN}, **given},
        "additionalProperties": False,
        "anyOf": [{"required": [table.preset]}, {"required": ["label"]}],
    }
    return _list({"anyOf": [name, own]}) | {
        "minItems": 1,
        "description": f"{table.preset}s, each many shared quantities at once",
    }


def _about() -> Document:
    author = {
        "type": "object",
        "properties": {key: {"type": "string"} for key in OF_AN_AUTHOR},
        "additionalProperties": False,
    }
    texts = {key: {"type": "string"} for key in KEYS if key != "author"}
    return {
        "type": "object",
        "properties": {**texts, "author": {"anyOf": [author, _list(author)]}},
        "additionalProperties": False,
    }

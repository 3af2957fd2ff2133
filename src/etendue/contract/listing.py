"""Installed items as JSON: stages with their declarations, roles, and the quantities that stages share.

In:  the registry.
Out: documents; for an item that cannot be read, the reason.
"""

from __future__ import annotations

import math

from etendue.contract.registry import Registry
from etendue.contract.stage import parameters_of, reads_of, writes_of
from etendue.contract.values import quantities
from etendue.contract.values.parameter import MISSING
from etendue.errors import PluginError
from etendue.plugins import discovery
from etendue.types.documents import Document


def role_documents() -> dict[str, str]:
    """Return the description of every role, in the order of their declarations."""
    found = discovery.installed()
    return {name: str(said.value) if (said := found.first("roles", name)) else "" for name in found.names("roles")}


def stage_document(registry: Registry, name: str) -> Document:
    """Return one stage as JSON; for a broken plugin, return the reason."""
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


def quantity_document(name: str, registry: Registry | None = None) -> Document:
    """Return one shared quantity as JSON; with a registry, also the stages that take it. If the declaration of the
    quantity cannot be read, return the reason.
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

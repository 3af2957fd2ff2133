"""Divide the engine's own modules into those that can change a bit of a cell, and those that only pass on results.

The key of every cell covers the package ``compute`` and the few modules outside it that its bits depend on; the digest
of a stage's own code and of all it imports is added to it (``plan.identity.code``). No digest covers the packages in
``MOVES``, each for the reason given there. No digest covers manifests, because keys contain what they declare: classes
as code, and defaults, dims and patterns as values. A test computes cells of every kind of pipeline in fresh processes,
and fails if one of them imports a module, or reads a table, that is in neither list and in no digest.
"""

from __future__ import annotations

from pathlib import Path

_PACKAGES = Path(__file__).parents[3]


def _modules_in(room: str) -> tuple[str, ...]:
    folder = _PACKAGES.joinpath(*room.split("."))
    found = (path for path in sorted(folder.rglob("*.py")) if path.name != "__init__.py")
    return tuple(".".join(path.relative_to(_PACKAGES).with_suffix("").parts) for path in found)


ENGINE = (
    *_modules_in("etendue.compute"),
    "etendue.contract.capabilities",
    "etendue.contract.arrays.coordinates",  # the coordinates that stages get
    "etendue.contract.arrays.grid",
    "etendue.contract.stage",
    "etendue.contract.arrays.variables",  # dims and dtype of what is written
    "etendue.plan.stage_calls",  # builds a stage again with the values that a run has found
    "etendue.plan.expansion.seed_words",  # the key of random numbers
    "etendue.transfer.products",  # products of transfer functions
)

# The engine's modules that compute with transfer functions: part of the code digests of stages with a transfer function
# only.
TRANSFER_KERNELS = (
    "etendue.contract.values.units",  # the unit in which transfer functions receive the centres of bands
    "etendue.transfer.cell_pixels",
    "etendue.transfer.cells",
    "etendue.transfer.expansion",
    "etendue.transfer.sampling",
)

_VALUES = "keys contain the values that it states"
_DECIDES = "keys contain its decisions"
_WORDS = "messages, names and type declarations"
_AFTER = "works on computed results"

MOVES = {
    "etendue": "loads names on first use",
    "etendue.__main__": _AFTER,
    "etendue.accuracy.*": _AFTER,
    "etendue.api": "re-exports; names taken from it are followed to their definition",
    "etendue.archive.*": "stores and reads back bytes, with separate digests",
    "etendue.builder.*": "writes the pipeline's file",
    "etendue.cache": "keeps bytes between runs, under keys of everything that they depend on",
    "etendue.calls": _WORDS,
    "etendue.cli.*": _AFTER,
    "etendue.compute": _WORDS,
    "etendue.compute.joined": _WORDS,
    "etendue.contract": _WORDS,
    "etendue.contract.arrays": _WORDS,
    "etendue.contract.arrays.dims": "keys contain the dims that are bands, and their unit",
    "etendue.contract.arrays.drawn": _AFTER,
    "etendue.contract.arrays.facts": f"facts decide omissions, knobs and precision: {_DECIDES}",
    "etendue.contract.class_checks": "rejects classes of stages",
    "etendue.contract.ports": "the interface of a store of results",
    "etendue.contract.registry": "loads the class of a stage, whose code is in its key",
    "etendue.contract.stated": f"stated errors decide which knobs are set: {_DECIDES}",
    "etendue.contract.values": _WORDS,
    "etendue.contract.values.bounds": "rejects numbers and texts that are too large",
    "etendue.contract.values.late_bound": "represents a value until the run has found it",
    "etendue.contract.values.names": _WORDS,
    "etendue.contract.values.parameter": _VALUES,
    "etendue.contract.values.quantities": _VALUES,
    "etendue.contract.values.tables": _WORDS,
    "etendue.errors": _WORDS,
    "etendue.evaluation.*": "reads back bits under the keys of everything that they depend on",
    "etendue.interrupts": "signals",
    "etendue.pipeline.*": f"reads the pipeline's file; {_VALUES}",
    "etendue.plain_files": "reads files completely or raises an error",
    "etendue.plan.*": f"{_DECIDES}: parameters with their knobs, precision, inputs, grids, segments, seeds",
    "etendue.plugins.*": "finds the contents of distributions, whose code is in keys; restores what plugins "
    "change in the "
    "process",
    "etendue.present.*": _AFTER,
    "etendue.process": "restores the process state that foreign code changes",
    "etendue.result_files": _AFTER,
    "etendue.run.*": "orders, starts and passes on cells",
    "etendue.running": "passes results to the store",
    "etendue.session": "joins plan, run and archive",
    "etendue.streams": "standard streams",
    "etendue.telling": _WORDS,
    "etendue.testing.*": _AFTER,
    "etendue.transfer": _WORDS,
    "etendue.trust.*": _AFTER,
    "etendue.types.*": "names in annotations",
}
# Modules listed in ``MOVES`` that a process holds when it only computes cells; a test reports any other module.
HELD = (
    "etendue.pipeline.about",
    "etendue.pipeline.file",
    "etendue.pipeline.form",
    "etendue.pipeline.overrides",
    "etendue.pipeline.presets",
    "etendue.pipeline.zipped",
    "etendue.plan.cost",
    "etendue.plan.identity.keys",
    "etendue.plan.identity.once",
    "etendue.plan.identity.same_as",
    "etendue.plan.model",
    "etendue.plan.structure.cell",
    "etendue.plan.structure.nodes",
    "etendue.plugins.discovery",
    "etendue.plugins.guests",
    "etendue.plugins.hookspecs",
    "etendue.run.batches",
    "etendue.run.order",
    "etendue.types.arrays",
    "etendue.types.documents",
)


def only_moves(module: str) -> bool:
    """Return whether a module is in no digest, because it or its whole package is in ``MOVES``."""
    if module in ENGINE or module in MOVES:
        return module not in ENGINE
    parts = module.split(".")
    return any(".".join((*parts[:n], "*")) in MOVES for n in range(1, len(parts) + 1))

"""Of the engine's own modules: which can change a bit of a cell, and which only move what others compute.

The room ``compute`` is in the key of every cell, with the few modules outside it that its bits depend on; the digest of
a stage's own code, and of all it imports, stands beside it (``plan.code``). Rooms in ``MOVES`` are followed by no
digest, each for a reason; nor is a manifest: which class stands under a name, defaults, dims and patterns stand in keys
as that code and these values. A test computes cells of every kind of pipeline in fresh processes, and fails where one
of them imports a module, or reads a table, that is in neither and in no digest.
"""

from __future__ import annotations

from pathlib import Path

_PACKAGES = Path(__file__).parents[2]


def _modules_in(room: str) -> tuple[str, ...]:
    folder = _PACKAGES.joinpath(*room.split("."))
    found = (path for path in sorted(folder.rglob("*.py")) if path.name != "__init__.py")
    return tuple(".".join(path.relative_to(_PACKAGES).with_suffix("").parts) for path in found)


ENGINE = (
    *_modules_in("etendue.compute"),
    "etendue.contract.capabilities",
    "etendue.contract.coordinates",  # the coordinates that stages are given
    "etendue.contract.grid",
    "etendue.contract.stage",
    "etendue.contract.variables",  # dims and dtype of what is written
    "etendue.plan.asking",  # makes a stage again with what a run has found
    "etendue.plan.words",  # what random numbers are keyed by
    "etendue.transfer.products",  # products of transfer functions
)

# What the engine computes for transfer functions: in the digests of these, and of no other stages.
TRANSFER_KERNELS = (
    "etendue.contract.units",  # that in which they are given the middles of bands
    "etendue.transfer.cell_pixels",
    "etendue.transfer.cells",
    "etendue.transfer.expansion",
    "etendue.transfer.sampling",
)

_VALUES = "what it says of a value stands in keys as that value"
_DECIDES = "what it decides stands in keys"
_WORDS = "texts of messages, names and declarations of form"
_AFTER = "works on what has been computed"

MOVES = {
    "etendue": "opens names when they are asked for",
    "etendue.__main__": _AFTER,
    "etendue.accuracy.*": _AFTER,
    "etendue.api": "hands on: what is taken out of it is followed to where it stands",
    "etendue.archive.*": "stores and reads back bytes, under digests of their own",
    "etendue.builder.*": "writes the pipeline's file",
    "etendue.cache": "keeps bytes between runs, under keys that hold what they depend on",
    "etendue.calls": _WORDS,
    "etendue.cli.*": _AFTER,
    "etendue.compute": _WORDS,
    "etendue.compute.joined": _WORDS,
    "etendue.contract": _WORDS,
    "etendue.contract.bounds": "refuses what is too large",
    "etendue.contract.dims": "which dims are bands, and in which unit, stands in keys",
    "etendue.contract.drawn": _AFTER,
    "etendue.contract.facts": f"what is known before a run decides what is left out, knobs and precision: {_DECIDES}",
    "etendue.contract.found": "stands for a value until the run has found it",
    "etendue.contract.names": _WORDS,
    "etendue.contract.parameter": _VALUES,
    "etendue.contract.ports": "what a keeper of results is asked",
    "etendue.contract.quantities": _VALUES,
    "etendue.contract.registry": "loads the class of a stage, whose code stands in its key",
    "etendue.contract.tables": _WORDS,
    "etendue.contract.stated": f"stated errors decide which knobs are set: {_DECIDES}",
    "etendue.errors": _WORDS,
    "etendue.interrupts": "signals",
    "etendue.pipeline.*": f"reads the pipeline's file; {_VALUES}",
    "etendue.plain_files": "opens files, and reads them whole or not at all",
    "etendue.plan.*": f"{_DECIDES}: parameters with their knobs, precision, inputs, grids, segments, seeds",
    "etendue.plugins.*": "finds what distributions bring, whose code stands in keys; puts back what plugins change of "
    "the process",
    "etendue.present.*": _AFTER,
    "etendue.process": "puts back what foreign code changes of the process",
    "etendue.result_files": _AFTER,
    "etendue.run.*": "starts, orders and hands on cells",
    "etendue.running": "hands results to their keeper",
    "etendue.session": "joins plan, run and archive",
    "etendue.streams": "what is printed where",
    "etendue.telling": _WORDS,
    "etendue.testing.*": _AFTER,
    "etendue.transfer": _WORDS,
    "etendue.trust.*": _AFTER,
    "etendue.types.*": "names in annotations",
}
# Of the rooms that move, what a process holds that computes cells and does nothing else: another of their modules would
# be found by a test.
HELD = (
    "etendue.pipeline.about",
    "etendue.pipeline.file",
    "etendue.pipeline.form",
    "etendue.pipeline.overrides",
    "etendue.pipeline.presets",
    "etendue.plan.cost",
    "etendue.plan.keys",
    "etendue.plan.model",
    "etendue.plugins.discovery",
    "etendue.plugins.guests",
    "etendue.plugins.hookspecs",
    "etendue.run.batches",
    "etendue.run.order",
    "etendue.types.arrays",
    "etendue.types.documents",
)


def only_moves(module: str) -> bool:
    """Whether no digest follows a module: it stands among those that move, or in a package all of which does."""
    if module in ENGINE or module in MOVES:
        return module not in ENGINE
    parts = module.split(".")
    return any(".".join((*parts[:n], "*")) in MOVES for n in range(1, len(parts) + 1))

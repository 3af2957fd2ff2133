"""Of the engine's own modules: which can change a bit of a cell, and which only move what others compute.

The digest of ``ENGINE`` is in the key of every cell; that of a stage's own code, and of all it imports, stands beside it (``plan.code``).
``MOVES`` is followed by no digest, each module for a reason. A test computes cells of every kind of pipeline in fresh processes, and fails
where one of them imports a module, or reads a table, that is in neither list and in no digest.
"""

from __future__ import annotations

ENGINE = (
    "etendue.coordinates",  # the coordinates that stages are given
    "etendue.transfers",  # products of transfer functions
    "etendue.plan.asking",  # makes a stage again with what a run has found
    "etendue.plan.strips",  # the rows of strips, and those that a halo adds
    "etendue.plan.words",  # what random numbers are keyed by
    "etendue.run.bands",
    "etendue.run.cell",
    "etendue.run.form",
    "etendue.run.found",
    "etendue.run.given",
    "etendue.run.job",
    "etendue.run.jobs",
    "etendue.run.mapped",
    "etendue.run.otf",
    "etendue.run.ownership",
    "etendue.run.segment_bands",
    "etendue.run.segment_cells",
    "etendue.run.segments",
    "etendue.run.strips",
    "etendue.run.tables",
    "etendue.run.walks",
    "etendue.spec.capabilities",
    "etendue.spec.grid",
    "etendue.spec.stage",
    "etendue.spec.variables",  # dims and dtype of what is written
)

# Kernels that the engine calls for stages of a kind: in the digests of these, and of no others.
TRANSFER_KERNELS = ("etendue.physics.light.cell_pixels", "etendue.physics.light.expansion", "etendue.physics.light.sampling")
RANDOM_KERNELS = ("etendue.physics.electronics.noise",)

_VALUES = "what it says of a value stands in keys as that value"
_DECIDES = "what it decides stands in keys"
_WORDS = "texts of messages, names and declarations of form"
_AFTER = "works on what has been computed"

MOVES = {
    "etendue": "opens names when they are asked for",
    "etendue.__main__": _AFTER,
    "etendue.api": "hands on: what is taken out of it is followed to where it stands",
    "etendue.archive.*": "stores and reads back bytes, under digests of their own",
    "etendue.cache": "keeps bytes between runs, under keys that hold what they depend on",
    "etendue.cli.*": _AFTER,
    "etendue.composing.*": "writes the pipeline's file",
    "etendue.discovery": "finds what distributions bring: the code of a stage stands in its key, a table by its content",
    "etendue.errors": _WORDS,
    "etendue.export.*": _AFTER,
    "etendue.guests": "puts back what plugins change of the process; what they are given is made in run.ownership",
    "etendue.hookspecs": _WORDS,
    "etendue.importing.*": "makes the files of scenes, which count by content",
    "etendue.interrupts": "signals",
    "etendue.manifest": "which class stands under a name, and defaults: the code of one and the value of the other stand in keys",
    "etendue.page.*": _AFTER,
    "etendue.plan.*": f"{_DECIDES}: parameters with their knobs, precision, inputs, grids, segments, seeds",
    "etendue.plan.cost": "estimates; whether a segment is streamed stands in keys",
    "etendue.plan.keys": "makes the keys",
    "etendue.plan.model": f"{_DECIDES}: what reads what, what is looked at, what stands before it",
    "etendue.plan.numbers": "numbers of cells",
    "etendue.plots.*": _AFTER,
    "etendue.process": "puts back what foreign code changes of the process",
    "etendue.registry": "loads the class of a stage, whose code stands in its key",
    "etendue.report.*": _AFTER,
    "etendue.run": "starts, orders and hands on cells",
    "etendue.run.batches": "which cells are computed one after the other, and until when their results are held",
    "etendue.run.cluster.*": "sends batches to workers",
    "etendue.run.memory": "gives memory back",
    "etendue.run.order": "an order in which every cell stands behind what it reads",
    "etendue.run.parallel": "hands batches to threads and processes",
    "etendue.run.serial": "hands on batches",
    "etendue.run.watch": "signals",
    "etendue.run.workers": "starts processes, and sends them batches",
    "etendue.scaffolds.*": "writes files to begin with",
    "etendue.schema": _WORDS,
    "etendue.session": "joins plan, run and archive",
    "etendue.plain_files": "opens files, and reads them whole or not at all",
    "etendue.spec": _WORDS,
    "etendue.spec.about": _WORDS,
    "etendue.spec.bounds": "refuses what is too large",
    "etendue.spec.camera": _VALUES,
    "etendue.spec.facts": f"what is known before a run decides what is left out, knobs and precision: {_DECIDES}",
    "etendue.spec.found": "stands for a value until the run has found it",
    "etendue.spec.names": _WORDS,
    "etendue.spec.overrides": _VALUES,
    "etendue.spec.parameter": _VALUES,
    "etendue.spec.pipeline": f"reads the pipeline's file; {_VALUES}",
    "etendue.spec.ports": "what a keeper of results is asked",
    "etendue.spec.presets": _VALUES,
    "etendue.spec.roles": "names by which studies find stages",
    "etendue.spec.stated": f"stated errors decide which knobs are set: {_DECIDES}",
    "etendue.spec.toml": _WORDS,
    "etendue.streams": "what is printed where",
    "etendue.studies.*": _AFTER,
    "etendue.telling": _WORDS,
    "etendue.testing.*": _AFTER,
}
MOVED_DATA = {
    "better.toml": _WORDS,
    "quantities.toml": _VALUES,
    "roles.toml": _WORDS,
    "stages.toml": "which class stands under a name: its code stands in keys",
    "subjects.toml": _WORDS,
    "variables.toml": _WORDS,
}


def only_moves(module: str) -> bool:
    """Whether no digest follows a module: it stands among those that move, or in a package all of which does."""
    if module in ENGINE or module in MOVES:
        return module not in ENGINE
    parts = module.split(".")
    return any(".".join((*parts[:n], "*")) in MOVES for n in range(2, len(parts) + 1))

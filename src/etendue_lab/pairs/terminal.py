"""Terminal output of pairs.

In:  the document of a call.
Out: the number of pairs, the pairs per second, and the content of a block.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

from etendue.cli import options
from etendue.cli.saying import tell
from etendue.present.terminal.terminal import _out, escape
from etendue.types.documents import Document
from etendue_lab.pairs.blocks import write_blocks
from etendue_lab.pairs.drawing import VARIABLES, pairs_of


def print_pairs(document: Document) -> None:
    """Print the number of pairs, the pairs per second, and the content of a block."""
    console = _out()
    shapes = ", ".join(f"{name} {'x'.join(map(str, shape))}" for name, shape in document["shapes"].items())
    rate = f", {document['pairs_a_second']:.2g} pairs a second" if document["made"] else ""
    console.print(f"{document['pipeline']}: {document['pairs']} pairs, {document['made']} of them made now{rate}")
    console.print(f"{shapes}; float32; blocks of {document['block']} in {escape(document['folder'])}")


def pairs_command(given: options.Given, photographs: Path, output: Path | None, as_json: bool, **asked: Any) -> None:
    pipeline = given.pipeline()
    found = pairs_of(
        pipeline, photographs, asked["over"], asked["variables"] or VARIABLES, asked["seed"], asked["count"]
    )
    folder = output or Path(f"{pipeline.name}-pairs")
    began = time.perf_counter()

    def told(count: int) -> None:
        if sys.stderr.isatty() and not as_json:
            print(f"\r{count} of {len(found)} pairs", end="" if count < len(found) else "\n", file=sys.stderr)

    made = write_blocks(found, folder, asked["block"], asked["workers"] or os.cpu_count() or 1, told)
    seconds = time.perf_counter() - began
    document = {
        "pipeline": pipeline.name,
        "pairs": len(found),
        "made": made,
        "pairs_a_second": made / seconds,
        "shapes": {name: list(array.shape) for name, array in found[0].arrays.items()},
        "block": asked["block"],
        "folder": str(folder),
    }
    tell(as_json, document, print_pairs)

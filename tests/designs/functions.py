"""The functions of ``known`` as stages of a small plugin: what a design computes through the engine is what the plain
function gives.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from etendue.api import Stage, hookimpl, param
from etendue.plugins.hookspecs import GROUP
from etendue_lab.designs.samples import Samples, samples_of
from tests.designs.known import g_function, ishigami
from tests.run.small import command


def number() -> Any:
    return param(0.5, at_least=0, at_most=1)


@dataclass(frozen=True, kw_only=True)
class Ishigami(Stage):
    """Ishigami's function of three numbers; a fourth does nothing."""

    writes: ClassVar = {"ishigami": "[1]"}

    x0: float = number()
    x1: float = number()
    x2: float = number()
    x3: float = number()

    def run(self) -> dict[str, float]:
        return {"ishigami": float(ishigami((self.x0, self.x1, self.x2, self.x3)))}


@dataclass(frozen=True, kw_only=True)
class GFunction(Stage):
    """The g-function of Sobol' of six numbers."""

    writes: ClassVar = {"g": "[1]"}

    x0: float = number()
    x1: float = number()
    x2: float = number()
    x3: float = number()
    x4: float = number()
    x5: float = number()

    def run(self) -> dict[str, float]:
        return {"g": float(g_function((self.x0, self.x1, self.x2, self.x3, self.x4, self.x5)))}


@hookimpl
def etendue_stages() -> dict[str, type]:
    return {"ishigami_function": Ishigami, "g_function": GFunction}


PIPELINE = """
name = "functions"
precision = "float64"

[[stages]]
use = "ishigami_function"
name = "i"
[[stages]]
use = "g_function"
name = "g"

[design]
method = "saltelli"
points = 16
seed = 5
[design.factors]
"""
for stage, count in (("i", 4), ("g", 6)):
    PIPELINE += "".join(f'"{stage}.x{n}" = {{ from = 0, to = 1 }}\n' for n in range(count))


def ran(folder: Path) -> Samples:
    """The samples of the design, from a run with these stages installed."""
    told = folder / "functions-1.dist-info"
    told.mkdir()
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: functions\nVersion: 1\n")
    (told / "entry_points.txt").write_text(f"[{GROUP}]\nfunctions = {__name__}\n")
    (folder / "functions.toml").write_text(PIPELINE)
    path = os.pathsep.join([str(folder), str(Path(__file__).parents[2])])
    done = command(
        "run", folder / "functions.toml", "--archive", folder / "a", "--scheduler", "serial", PYTHONPATH=path
    )
    assert done.returncode == 0, done.stderr
    return samples_of(folder / "a")

"""What a command costs from the shell, from the first import to the prompt: wall and CPU time, the smallest of some
repeats.

    python benchmarks/startup.py [--root CHECKOUT ...] [--repeats N]

Each checkout runs by its own ``.venv``, in turns, so that a busy machine is busy for all of them; once before, for its
bytecode.
First: an empty folder of caches and no archive. Second: the same command again, on what the first has left.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent.parent
COMMANDS = {
    "run paper.toml, first": ("run", "{pipelines}/paper.toml", "--archive", "{folder}/paper"),
    "run paper.toml, second": ("run", "{pipelines}/paper.toml", "--archive", "{folder}/paper"),
    "plan sweep.toml, first": ("plan", "{pipelines}/sweep.toml"),
    "plan sweep.toml, second": ("plan", "{pipelines}/sweep.toml"),
    "run smallest.toml, second": ("run", "{pipelines}/smallest.toml", "--archive", "{folder}/smallest"),
    "show paper": ("show", "{folder}/paper"),
    "stages": ("stages",),
    "--help": ("--help",),
}


def measured(root: Path, words: list[str], cache: Path) -> tuple[float, float]:
    """Wall and CPU seconds of one command."""
    program = root / ".venv" / "bin" / "etendue"
    given = {**os.environ, "ETENDUE_CACHE": str(cache), "OMP_NUM_THREADS": "1"}
    given.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed package has its bytecode
    began = time.perf_counter()
    child = os.fork()
    if child == 0:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
        os.execve(program, [str(program), *words], given)
    _, status, used = os.wait4(child, 0)
    wall = time.perf_counter() - began
    if status:
        raise SystemExit(f"{program} {' '.join(words)}: exit code {os.waitstatus_to_exitcode(status)}")
    return wall, used.ru_utime + used.ru_stime


def once(root: Path, folder: Path) -> dict[str, tuple[float, float]]:
    """Every command, one after the other; what is second finds what was first."""
    found = {}
    for name, words in COMMANDS.items():
        if name.endswith("first"):
            shutil.rmtree(folder / "cache", ignore_errors=True)
        said = [word.format(pipelines=root / "pipelines", folder=folder) for word in words]
        if name.startswith("run smallest"):
            measured(root, said, folder / "cache")
        found[name] = measured(root, said, folder / "cache")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--root", type=Path, action="append", default=[], help="another checkout, with a .venv; may be repeated"
    )
    parser.add_argument("--repeats", type=int, default=5)
    asked = parser.parse_args()
    roots = [*(root.resolve() for root in asked.root), HERE]
    found: dict[Path, list[dict[str, tuple[float, float]]]] = {root: [] for root in roots}
    for repeat in range(-1, asked.repeats):
        for root in roots:
            with tempfile.TemporaryDirectory() as folder:
                found[root] = [*found[root][: max(repeat, 0)], once(root, Path(folder))]
    print(f"{'seconds, wall (CPU)':26s}" + "".join(f"{root.name[-14:]:>16s}" for root in roots))
    for name in COMMANDS:
        best = [[min(run[name][i] for run in found[root]) for i in range(2)] for root in roots]
        print(f"{name:26s}" + "".join(f"{f'{wall:.2f} ({cpu:.2f})':>16s}" for wall, cpu in best))


if __name__ == "__main__":
    main()

"""What planning, first calls and looking cost: CPU seconds and peak memory of commands, the lowest of some repeats.

    python benchmarks/looking.py [--other CHECKOUT] [--repeats N] [--only WORDS ...] [--folder FOLDER]

Both checkouts run under this Python, each from its own sources with its own folder of caches, in turn. *first* finds
no cache; everything else finds what earlier commands left. The large archive is pipelines/sweep.toml with 30 pitches
and 30 integration times: 9,000 exposures, 137,181 cells, about 2.5 GB for each checkout. It is made in FOLDER and
used again if it is there; without FOLDER these rows are left out.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

HERE = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Row:
    """One command. ``fresh`` names what is removed before each call."""

    name: str
    words: tuple[str, ...]
    goal: float
    fresh: tuple[str, ...] = ()
    large: bool = False


ROWS = (
    Row("plan sweep, first", ("plan", "{pipelines}/sweep.toml"), 0.7, ("cache",)),
    Row("plan sweep", ("plan", "{pipelines}/sweep.toml"), 0.7),
    Row("run sweep", ("run", "{pipelines}/sweep.toml", "--archive", "{folder}/sweep"), 0.76, ("sweep",)),
    Row("run sweep, again", ("run", "{pipelines}/sweep.toml", "--archive", "{folder}/sweep"), 1.0),
    Row("run paper", ("run", "{pipelines}/paper.toml", "--archive", "{folder}/paper"), 0.89, ("paper", "cache")),
    Row("run paper, again", ("run", "{pipelines}/paper.toml", "--archive", "{folder}/paper"), 0.82),
    Row("stages", ("stages",), 0.55),
    Row("show paper", ("show", "{folder}/paper"), 0.9),
    Row("plot map", ("plot", "{folder}/large", "map", "gamut_clipped", "--output", "{folder}/map.png"), 0.25, (), True),
    Row(
        "plot pareto",
        ("plot", "{folder}/large", "pareto", "gamut_clipped", "mtf50_lp_mm", "--output", "{folder}/p.png"),
        0.25,
        (),
        True,
    ),
    Row("run large, again", ("run", "{folder}/large.toml", "--archive", "{folder}/large"), 0.35, (), True),
    Row("report large", ("report", "{folder}/large", "--output", "{folder}/report.html"), 0.6, (), True),
    Row("verify large", ("verify", "{folder}/large"), 0.6, (), True),
    Row("show large", ("show", "{folder}/large"), 0.9, (), True),
)


def environment(root: Path, folder: Path) -> dict[str, str]:
    """Where Python finds ``root`` and its plugins, by the entry points of its own project files, and its caches."""
    projects = [root, *sorted(path.parent for path in (root / "plugins").glob("*/pyproject.toml"))]
    paths = [str(project / "src") for project in projects]
    told = folder / "installed"
    ours = {
        distribution.name: distribution for distribution in metadata.distributions() if "etendue" in distribution.name
    }
    for name in ours:  # what is installed here and not part of the checkout offers nothing
        described = told / f"{name.replace('-', '_')}-{ours[name].version}.dist-info"
        described.mkdir(parents=True, exist_ok=True)
        (described / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {ours[name].version}\n")
        (described / "entry_points.txt").write_text("")
    for project in projects:
        document = tomllib.loads((project / "pyproject.toml").read_text())["project"]
        described = (
            told / f"{document['name'].replace('-', '_')}-{ours[document['name']].version}.dist-info"
            if document["name"] in ours
            else None
        )
        if described is None:
            continue
        lines = []
        for group, entries in document.get("entry-points", {}).items():
            lines += [f"[{group}]", *(f"{name} = {value}" for name, value in entries.items()), ""]
        (described / "entry_points.txt").write_text("\n".join(lines))
    given = {**os.environ, "PYTHONPATH": os.pathsep.join([str(told), *paths]), "OMP_NUM_THREADS": "1"}
    given["ETENDUE_CACHE"] = str(folder / "cache")
    given.pop("PYTHONDONTWRITEBYTECODE", None)
    return given


def measured(words: list[str], given: dict[str, str], folder: Path) -> tuple[float, float]:
    """CPU seconds and peak memory (MB) of one command."""
    child = os.fork()
    if child == 0:
        os.chdir(folder)
        with open("output", "w") as output:
            os.dup2(output.fileno(), 1)
            os.dup2(output.fileno(), 2)
        os.execve(sys.executable, [sys.executable, "-m", "etendue", *words], given)
    _, status, used = os.wait4(child, 0)
    if status:
        raise SystemExit(f"{folder}: etendue {' '.join(words)}: {(folder / 'output').read_text()[-2000:]}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e6


def large_file(root: Path) -> str:
    text = (root / "pipelines" / "sweep.toml").read_text()
    return text.replace("steps = 10", "steps = 30")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--other", type=Path, help="another checkout, to run in turn with this one")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", nargs="*", default=[], help="rows whose names begin with one of these words")
    parser.add_argument("--folder", type=Path, help="where archives and caches are, and stay; default: a temporary one")
    asked = parser.parse_args()
    roots = [*([asked.other.resolve()] if asked.other else []), HERE]
    rows = [row for row in ROWS if not asked.only or any(row.name.startswith(word) for word in asked.only)]
    with tempfile.TemporaryDirectory() as temporary:
        table(
            roots,
            [row for row in rows if asked.folder or not row.large],
            (asked.folder or Path(temporary)).resolve(),
            asked.repeats,
        )


def table(roots: list[Path], rows: list[Row], above: Path, repeats: int) -> None:
    """Measure every row in every checkout in turn, and print it."""
    places = {root: above / f"{place}-{root.name}" for place, root in enumerate(reversed(roots))}
    given = {}
    for root, folder in places.items():
        folder.mkdir(parents=True, exist_ok=True)
        given[root] = environment(root, folder)
        (folder / "large.toml").write_text(large_file(root))
        measured(["run", str(root / "pipelines" / "paper.toml"), "--archive", "paper"], given[root], folder)
        if any(row.large for row in rows) and not (folder / "large").exists():
            measured(["run", "large.toml", "--archive", "large"], given[root], folder)
    print(
        f"{'CPU seconds (peak MB)':24s}"
        + "".join(f"{root.name[-14:]:>18s}" for root in roots)
        + f"{'ratio':>8s}{'goal':>7s}"
    )
    for row in rows:
        best = {root: (float("inf"), float("inf")) for root in roots}
        for _ in range(repeats):
            for root, folder in places.items():
                for name in row.fresh:
                    shutil.rmtree(folder / name, ignore_errors=True)
                words = [word.format(pipelines=root / "pipelines", folder=folder) for word in row.words]
                best[root] = tuple(map(min, best[root], measured(words, given[root], folder)))  # type: ignore[assignment]
        shown = "".join(f"{best[root][0]:10.2f} ({best[root][1]:5.0f})" for root in roots)
        ratio = f"{best[roots[-1]][0] / best[roots[0]][0]:8.2f}{row.goal:7.2f}" if len(roots) > 1 else ""
        print(f"{row.name:24s}{shown}{ratio}", flush=True)


if __name__ == "__main__":
    main()

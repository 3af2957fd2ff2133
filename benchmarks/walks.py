"""Walks: which files of the engine a value is handed to on its way through a call, in their order; which files one
plot, importer, scheduler, kind of store and command stand in.

    python benchmarks/walks.py [plan | archive | new] [--pipeline pipelines/sweep.toml] [--drawn]

``plan``: a pipeline through make_plan. ``archive``: a plan through a run into an archive. A function counts where it is
first handed the value: what is called for every cell counts for the first. A stay is a run of such calls in one file, a
return a stay in a file that was left before. ``new``: what another plot or command touches, counted at one that exists:
files under src that name it or are it, without its test and its page; exit code 1 above three.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).parents[1]
EXISTING = {  # one of each kind, by what its files say
    "plot": r"\bbudget_of\b|^def budget\(",
    "importer": r"rasters:envi|^def envi\(",
    "scheduler": r"\brun_serial\b",
    "kind of store": r"\"s3\"",
    "command": r"cli\.bodies\.compacting|\.compacting:compact|^def compact\((place.*)?\) -> None",
}


def walk(begin: Callable[[], Any], kind: type, house: str) -> list[str]:
    """Files in the order in which their functions are first handed something of a kind."""
    files: list[str] = []
    seen = set()

    def look(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event != "call" or code in seen or not code.co_filename.startswith(house):
            return
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        if any(isinstance(frame.f_locals.get(name), kind) for name in names):
            seen.add(code)
            name = code.co_filename.removeprefix(house)
            if not files or files[-1] != name:
                files.append(name)

    sys.setprofile(look)
    try:
        begin()
    finally:
        sys.setprofile(None)
    return files


def standing() -> int:
    """Print in which files one of each kind stands; 1 if it is more than three."""
    texts = {path.relative_to(ROOT / "src"): path.read_text() for path in sorted((ROOT / "src").rglob("*.py"))}
    worst = 0
    for kind, words in EXISTING.items():
        files = [str(path) for path, text in texts.items() if re.search(words, text, re.MULTILINE)]
        print(f"{kind:14} {len(files)}  {', '.join(files)}")
        worst = max(worst, len(files))
    return int(worst > 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("plan", "archive", "new"), default="plan")
    parser.add_argument("--pipeline", type=Path, default=ROOT / "pipelines" / "sweep.toml")
    parser.add_argument("--drawn", action="store_true", help="the walk itself, a line for each stay")
    asked = parser.parse_args()
    if asked.what == "new":
        sys.exit(standing())

    import etendue
    from etendue.contract.registry import installed_stages
    from etendue.plan.model import Plan
    from etendue.plan.planner import make_plan

    house = f"{Path(etendue.__file__).parent}/"
    if asked.what == "plan":
        pipeline, registry = etendue.read_pipeline(asked.pipeline), installed_stages()
        stays = walk(lambda: make_plan(pipeline, registry), type(pipeline), house)
    else:
        with tempfile.TemporaryDirectory() as folder:
            archive = Path(folder) / "archive"
            stays = walk(lambda: etendue.simulate(asked.pipeline, archive=archive, scheduler="serial"), Plan, house)
    visits = Counter(stays)
    most, times = visits.most_common(1)[0]
    print(f"stays {len(stays)} in {len(visits)} files, returns {len(stays) - len(visits)}; {most} {times} times")
    if asked.drawn:
        before: Counter[str] = Counter()
        for name in stays:
            print(f"  {'<-' if before[name] else '  '} {name}")
            before[name] += 1


if __name__ == "__main__":
    main()

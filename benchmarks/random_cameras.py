"""Whole cameras drawn at random, each of which obeys the laws or is refused with a reason.

    python benchmarks/random_cameras.py [--count 200] [--seed 1] [-o FOLDER]
    python benchmarks/random_cameras.py --replay 17

A camera (``drawn_cameras``) has a seed: --count of them follow --seed. Each is run through the public interface, with
warnings as errors, one thread. The plan may refuse it (at most 10 % of them, each with a reason); a failed cell, a
leaked warning or a traceback is a fault. What runs is held against the laws (``camera_laws`` of
``etendue_lab.stability``), on noise-free twins where noise would hide them.

Printed: how many held, were refused or broke a law; reasons of refusals and causes of violations, grouped, each with
its seeds. What breaks a law is written as FOLDER/SEED.toml (and FOLDER/SEED-LAW.toml, the twin on which it shows),
which ``etendue run`` replays. Exit 1 where a law is broken or too many are refused.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import sys
import tempfile
import time
import warnings
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import drawn_cameras

import etendue
from etendue.errors import PluginError, RequestError
from etendue.types.documents import Document
from etendue_lab.stability import camera_laws
from etendue_lab.stability.camera_laws import Broken, Failure, Refused

MOST_REFUSED = 0.1


def toml_of(document: Document) -> str:
    """The document as a pipeline file."""

    def word(value: Any) -> str:
        if isinstance(value, bool):
            return str(value).lower()
        if isinstance(value, str):
            return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
        if isinstance(value, list | tuple):
            return "[" + ", ".join(word(v) for v in value) + "]"
        return repr(float(value)) if isinstance(value, float) else str(value)

    def key(name: str) -> str:
        return name if re.fullmatch(r"[\w-]+", name) else f'"{name}"'

    def lines(table: Document) -> str:
        return "".join(f"{key(name)} = {word(value)}\n" for name, value in table.items())

    top = {name: value for name, value in document.items() if name not in ("camera", "stages", "sweep")}
    stages = "".join(f"\n[[stages]]\n{lines(stage)}" for stage in document["stages"])
    sweep = f"\n[sweep]\n{lines(document['sweep'])}" if document.get("sweep") else ""
    return f"{lines(top)}\n[camera]\n{lines(document['camera'])}{stages}{sweep}"


def run(document: Document, folder: Path) -> Any:
    """The tree of a document whose files are in the folder; raises ``Refused`` or ``Fault``."""
    path = folder / "run.toml"
    path.write_text(toml_of(document))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return etendue.simulate(path, scheduler="serial")
    except RequestError as error:
        raise Refused("; ".join(dict.fromkeys(f"{fault.place}: {fault.message}" for fault in error.faults))) from None
    except PluginError as error:
        last = str(error).strip().rpartition("\n")[2]
        stage = re.match(r"\d+ cells failed; the first: (\S+)", str(error))
        own = f"{stage[1]}: " if stage else ""
        raise Failure(
            "failed cell", own + (last if "\n" in str(error) else str(error).partition("}: ")[2] or str(error))
        ) from None
    except Warning as warning:
        raise Failure("leaked warning", f"{type(warning).__name__}: {warning}") from None
    except Exception as error:
        raise Failure("traceback", f"{type(error).__name__}: {error}") from error


@dataclass
class Verdict:
    """What came of one camera."""

    seed: int
    document: Document
    refused: str = ""
    broken: list[Broken] = field(default_factory=list)

    @property
    def word(self) -> str:
        return "refused" if self.refused else "broken" if self.broken else "held"


def judge(seed: int, folder: Path, small: bool = False) -> Verdict:
    """Draw a camera, run it, and hold it against the laws."""
    document = drawn_cameras.draw(seed, folder, small)
    verdict = Verdict(seed, document)
    try:
        tree = run(document, folder)
        verdict.broken = list(camera_laws.laws(document, tree, lambda twin: run(twin, folder)))
    except Refused as refused:
        verdict.refused = str(refused)
    except Failure as fault:
        verdict.broken = [Broken(fault.kind, str(fault))]
    return verdict


def cause(text: str) -> str:
    """The same words without their numbers and names, so that equal causes are counted together."""
    text = re.sub(r"stages\[\d+\] (\w+)[^:]*: ", r"\1: ", text)
    text = re.sub(r"\d+-(\w+\.\w+)", r"\1", text)
    return re.sub(r"-?\d[\d.]*(e[+-]?\d+)?", "#", text)


def keep(verdict: Verdict, folder: Path, kept: Path) -> None:
    """What replays a violation: the camera, the twins on which laws break, their files."""
    kept.mkdir(parents=True, exist_ok=True)
    for file in folder.glob(f"{verdict.seed}-*"):
        shutil.copy(file, kept / file.name)
    (kept / f"{verdict.seed}.toml").write_text(toml_of(verdict.document))
    for broken in verdict.broken:
        if broken.document is not None:
            (kept / f"{verdict.seed}-{broken.law.replace(' ', '_')}.toml").write_text(toml_of(broken.document))


def grouped(pairs: list[tuple[str, int]]) -> list[tuple[str, list[int], str]]:
    """Causes with their seeds and one example, the commonest first."""
    found: dict[str, list[int]] = defaultdict(list)
    example: dict[str, str] = {}
    for text, seed in pairs:
        found[cause(text)].append(seed)
        example.setdefault(cause(text), text)
    return sorted(((c, list(dict.fromkeys(s)), example[c]) for c, s in found.items()), key=lambda one: -len(one[1]))


def table(verdicts: list[Verdict]) -> str:
    """What is printed at the end."""
    count = {word: sum(v.word == word for v in verdicts) for word in ("held", "refused", "broken")}
    share = count["refused"] / max(len(verdicts), 1)
    out = [
        f"{len(verdicts)} cameras: {count['held']} held, {count['refused']} refused ({100 * share:.3g} %), "
        f"{count['broken']} broke a law"
    ]
    sections = (
        ("refused", [(v.refused, v.seed) for v in verdicts if v.refused]),
        *(
            (law, [(b.text, v.seed) for v in verdicts for b in v.broken if b.law == law])
            for law in dict.fromkeys(b.law for v in verdicts for b in v.broken)
        ),
    )
    for name, pairs in sections:
        if pairs:
            out.append(f"\n{name}: {len({seed for _, seed in pairs})} cameras")
        for _, seeds, example in grouped(pairs):
            shown = ", ".join(map(str, seeds[:8])) + (", ..." if len(seeds) > 8 else "")
            out.append(f"  {len(seeds):4d}  {example[:400]}\n        seeds {shown}")
    return "\n".join(out)


def wrong(verdicts: list[Verdict]) -> bool:
    refused = sum(v.word == "refused" for v in verdicts)
    return any(v.broken for v in verdicts) or refused > MOST_REFUSED * len(verdicts)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=200, help="cameras to draw")
    parser.add_argument("--seed", type=int, default=1, help="of the first of them")
    parser.add_argument("--replay", type=int, metavar="SEED", help="one camera: its pipeline, its verdict")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("random_cameras"), help="folder for what breaks a law"
    )
    given = parser.parse_args()
    seeds = [given.replay] if given.replay is not None else range(given.seed, given.seed + given.count)
    verdicts, began = [], time.perf_counter()
    for number, seed in enumerate(seeds, 1):
        with tempfile.TemporaryDirectory() as folder:
            verdicts.append(judge(seed, Path(folder)))
            if verdicts[-1].broken:
                keep(verdicts[-1], Path(folder), given.output)
        if sys.stderr.isatty():
            print(
                f"\r{number} of {len(seeds)}, {sum(bool(v.broken) for v in verdicts)} broke a law ",
                end="",
                file=sys.stderr,
                flush=True,
            )
    if given.replay is not None:
        print(toml_of(verdicts[0].document))
    print(table(verdicts))
    if any(v.broken for v in verdicts):
        print(f"\nwhat breaks a law can be replayed: {given.output}{os.sep}SEED.toml, SEED-LAW.toml; or --replay SEED")
    print(f"{time.perf_counter() - began:.1f} s")
    return int(wrong(verdicts))


if __name__ == "__main__":
    sys.exit(main())

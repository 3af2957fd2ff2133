"""Plan shipped pipelines into which mistakes were put, and count the outcomes.

In:  how many (default 3000), and a seed.
Out: counts of exit codes 0 and 2, of tracebacks, warnings, hangs (10 s of CPU, or 600 s of waiting) and of messages
     that are not lines a person can act on; each of the last four with its pipeline in ``mutants/``; CPU seconds.

    python benchmarks/faults/mutated_pipelines.py 3000

A mutant is a shipped file with one to three mistakes: a value, key, line or character is removed, duplicated, swapped
or replaced. Axes are shortened first, so that a valid mutant is planned in 50 ms.
"""

from __future__ import annotations

import random
import re
import signal
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from etendue.contract.registry import installed_stages
from etendue.errors import EtendueError, RequestError
from etendue.pipeline.file import parse_pipeline
from etendue.plan.planner import make_plan

FOLDER = Path(__file__).parents[2] / "pipelines"
VALUES = (
    "0",
    "-1",
    "1e-300",
    "1e300",
    "1e30",
    "-1e30",
    "nan",
    "inf",
    "-0.0",
    "true",
    "''",
    '""',
    '"x"',
    "[]",
    "{}",
    "[[1]]",
    "{ a = 1 }",
    "1_000_000_000",
    "99999999999999999999",
    '"1e9 km"',
    '"5.4 um"',
    '"1 kg"',
    '"\\u001b[31m"',
    '"\\u0000"',
    "[1, 2, 3]",
    "[0, 0, 0]",
    "0x" + "f" * 300,
    '"' + "a" * 3000 + '"',
    "2026-01-01",
    '"../../etc"',
    '"package:numpy/x"',
    '"."',
    "{ from = 1, to = 9, steps = 100000 }",
    "{ from = 0, to = 1, steps = 3, spacing = 'log' }",
    '["demosaic_bilinear", 3]',
    '"E"',
    '"3200 K"',
    '"555 nm"',
)
WORDS = (
    "use",
    "name",
    "from",
    "f_number",
    "camera",
    "sweep",
    "stages",
    "demosaic.use",
    "scene.width",
    "wanted",
    "keep",
    "bits",
    "pattern",
    "a" * 300,
)
SLOWEST = 10  # seconds of CPU, independent of the machine's load
LONGEST = 600  # seconds: waiting for something that never comes


class Hang(BaseException):
    """Raised by the alarm."""


def small(text: str) -> str:
    """Return the same pipeline with few steps on every axis: planning takes time per cell, whatever the size of the
    cells.
    """
    head, sweep, axes = text.partition("[sweep]")
    axes = re.sub(r"steps = \d+", "steps = 2", axes)
    return head + sweep + re.sub(r"= \[([^,\]]*, [^,\]]*), [^\]]*\]", r"= [\1]", axes)


def mutate(text: str, draw: random.Random) -> str:
    lines = text.splitlines()
    for _ in range(draw.choice((1, 1, 2, 3))):
        at = draw.randrange(len(lines))
        key, equals, _ = lines[at].partition("=")
        kind = draw.randrange(14)
        if kind > 9 and re.search(r"\d", lines[at]):  # another number, often one that is allowed
            found = re.search(r"\d+(\.\d+)?", lines[at])
            scaled = f"{float(found[0]) * draw.choice((0, 0.1, 0.5, 2, 3, 10, 1e3, 1e6, 1e12)):g}"
            lines[at] = lines[at][: found.start()] + scaled + lines[at][found.end() :]
        elif kind < 4 and equals:
            lines[at] = f"{key}= {draw.choice(VALUES)}"
        elif kind == 4 and equals:
            lines[at] = f"{draw.choice(WORDS)} ={lines[at].partition('=')[2]}"
        elif kind == 5:
            lines.insert(draw.randrange(len(lines)), lines[at])
        elif kind == 6:
            del lines[at]
            lines = lines or [""]
        elif kind == 7:
            other = draw.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        elif kind == 8 and lines[at]:
            place = draw.randrange(len(lines[at]))
            lines[at] = (
                lines[at][:place] + draw.choice('"[]{}=.#\\\0\x1b\t,é-_9') + lines[at][place + draw.randrange(2) :]
            )
        else:
            lines.insert(at, f"{draw.choice(WORDS)} = {draw.choice(VALUES)}")
    return "\n".join(lines)


def mutants(count: int, seed: int) -> Iterator[str]:
    draw = random.Random(seed)
    texts = [small(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.glob("*.toml"))]
    # one needs a plugin
    texts = [text for text in texts if all(one.use in installed_stages() for one in parse_pipeline(text).stages)]
    for _ in range(count):
        yield mutate(draw.choice(texts), draw)


def outcome(text: str) -> tuple[str, str]:
    """Return the outcome of planning a text, and its message."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            make_plan(parse_pipeline(text, "mutant.toml", FOLDER), installed_stages())
    except RequestError as error:
        said = str(error)
        plain = (
            said and "".join(said.splitlines()).isprintable() and all(len(line) < 1000 for line in said.splitlines())
        )
        return ("refused" if plain else "unreadable"), said
    except EtendueError as error:
        return "other error", str(error)
    except Warning:
        return "warning", traceback.format_exc()
    except Hang:
        return "hang", ""
    except Exception:
        return "traceback", traceback.format_exc()
    return "planned", ""


def main() -> None:
    count, seed = (*map(int, sys.argv[1:3]), *(3000, 1)[len(sys.argv[1:3]) :])
    counts: Counter[str] = Counter()
    seconds = []

    def stop(*_: object) -> None:
        raise Hang

    for alarm in (signal.SIGPROF, signal.SIGALRM):
        signal.signal(alarm, stop)
    for number, text in enumerate(mutants(count, seed)):
        signal.setitimer(signal.ITIMER_PROF, SLOWEST)
        signal.setitimer(signal.ITIMER_REAL, LONGEST)
        began = time.process_time()
        what, said = outcome(text)
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        seconds.append(time.process_time() - began)
        counts[what] += 1
        if what not in ("planned", "refused"):
            Path("mutants").mkdir(exist_ok=True)
            Path(f"mutants/{seed}-{number}.toml").write_text(text, encoding="utf-8")
            print(f"mutants/{seed}-{number}.toml: {what}: {said[-400:]}", flush=True)
    ordered = sorted(seconds)
    middle, late = ordered[count // 2], ordered[int(0.99 * count)]
    print(dict(counts), f"CPU: median {1e3 * middle:.0f} ms, 99 % {1e3 * late:.0f} ms, longest {ordered[-1]:.1f} s")
    raise SystemExit(bool(set(counts) - {"planned", "refused"}))


if __name__ == "__main__":
    main()

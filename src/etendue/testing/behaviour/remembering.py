"""Checks for hidden state: one picture that affects the next, buffers that are overwritten, state shared between
threads.

In:  a ``Bench``.
Out: nothing, or ``LawBroken``.

The results are compared with results of a process in which the stage has computed nothing else (``pristine``).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as Late
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from etendue.testing.behaviour import pristine
from etendue.testing.bench import FRAME, Arrays, Bench, digests
from etendue.testing.measured import hold, untried

LINES = 60  # number of lines of the stage's code at which another thread runs the stage as well
PATIENCE = 0.5  # seconds allowed for that run; a run that waits for a lock continues when the first run has ended
PICTURES = ("ordinary", "decades", "uniform")


def pictures(bench: Bench) -> list[Arrays]:
    """Return pictures of one size that differ in level, mean and shape."""
    return [bench.arrays(what, FRAME, factor) for what, factor in zip(PICTURES, (1.0, 0.31, 0.07), strict=True)]


def one_after_another(bench: Bench) -> None:
    """Compute pictures A, B, A in one process and B alone in a fresh process. Check that equal inputs give equal
    results and that returned arrays do not change later.
    """
    given = pictures(bench) if bench.reads else []
    found = []
    for inputs in given:
        trial = bench.run(inputs)
        if not trial.done:
            return
        found.append((trial, digests(trial.arrays)))
    for number, (trial, before) in enumerate(found):
        hold(
            digests(trial.arrays) == before,
            f"{bench.name} overwrites the array that it returned for {PICTURES[number]} input when it computes "
            "another picture: "
            "return a new array",
        )
    for number, inputs in enumerate(given):
        hold(
            digests(bench.run(inputs).arrays) == found[number][1],
            f"{bench.name} gives different bits for {PICTURES[number]} input after another picture: it keeps "
            "state between pictures",
        )
    alone = pristine.digests_alone(bench, list(reversed(given))) if given else None
    if given and alone is None:
        untried("it was not compared with a fresh process, because none can be started or it cannot import the stage")
    for number, own in enumerate(reversed(alone or [])):
        hold(
            own is None or own == found[number][1],
            f"{bench.name} gives different bits for {PICTURES[number]} input than in a process that computed another "
            "picture first: state of one picture affects the next",
        )


def one_inside_another(bench: Bench) -> None:
    """Compute another picture in another thread at every line of the stage's own code, and check that both results stay
    the same.
    """
    if not bench.reads:
        return
    first, second, *_ = pictures(bench)
    alone, other = bench.run(first), bench.run(second)
    if not (alone.done and other.done):
        return
    wanted, beside = digests(alone.arrays), digests(other.arrays)
    meanwhile: list[dict[str, str]] = []
    failed: list[str] = []

    def interrupt() -> None:
        trial = bench.run(second)
        meanwhile.append(digests(trial.arrays))
        if not trial.done:
            failed.append(trial.last_line)

    with ThreadPoolExecutor(1) as pool, stopping_at_lines_of(bench, lambda: _wait(pool, interrupt)):
        trial = bench.run(first)
    text = "state is shared between threads: keep it in local variables"
    hold(
        trial.done and not failed,
        f"{bench.name} fails while another thread runs it: {(failed or [trial.last_line])[0]}",
    )
    hold(digests(trial.arrays) == wanted, f"{bench.name} gives different bits while another thread runs it; {text}")
    hold(all(own == beside for own in meanwhile), f"{bench.name} gives different bits inside another run of it; {text}")


def _wait(pool: ThreadPoolExecutor, call: Callable[[], None]) -> None:
    try:
        pool.submit(call).result(PATIENCE)
    except Late:
        return  # the second run waits for a lock that the interrupted run holds


@contextmanager
def stopping_at_lines_of(bench: Bench, call: Callable[[], None]) -> Iterator[None]:
    """Call a function when this thread first reaches each line of the stage's own distribution."""
    folder = own_folder(bench)
    seen: set[tuple[str, int]] = set()
    before = sys.gettrace()

    def local(frame: FrameType, event: str, _: Any) -> Any:
        place = (frame.f_code.co_filename, frame.f_lineno)
        if event == "line" and place not in seen and len(seen) < LINES:
            seen.add(place)
            sys.settrace(None)
            try:
                call()
            finally:
                sys.settrace(enter)
        return local

    def enter(frame: FrameType, event: str, _: Any) -> Any:
        return local if folder and frame.f_code.co_filename.startswith(folder) else None

    sys.settrace(enter)
    try:
        yield
    finally:
        sys.settrace(before)


def own_folder(bench: Bench) -> str:
    """Return the folder of the package that contains a stage's code, or the file if it is a single module."""
    module = sys.modules.get(bench.kind.__module__)
    file = getattr(module, "__file__", None)
    if not file:
        return ""
    top = sys.modules.get(bench.kind.__module__.partition(".")[0])
    home = getattr(top, "__file__", None)
    return str(Path(home).parent) if home and Path(home).name == "__init__.py" else str(file)

"""Run the command in a process forked from one that has imported all modules, so that start-up costs nothing.

Also the checks of an archive after a fault: whether it equals that of an undisturbed run, whether it contains other
files, and whether readers of an interrupted one get correct values.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

LIGHT = """
name = "faults"
seed = 3
[camera]
pixel_pitch = "3 um"
peak_qe = [0.36, 0.44, 0.40]
[[stages]]
use = "slanted_edge"
name = "scene"
white_luminance = "1000 cd m-2"
width = "20 um"
height = "20 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "pixel"
rows = 4
columns = 4
"""
SENSOR = "".join(f'[[stages]]\nuse = "{use}"\n' for use in ("mosaic", "exposure", "shot_noise", "lens_numbers"))
SWEEP = '[sweep]\nf_number = [2, 4]\n"pixel.rows" = [4, 5]\n'
PIPELINE = LIGHT + SENSOR + SWEEP
TRACEBACK = 99  # the exit code of a command that raised


def import_all(words: list[str], said: Path) -> None:
    """Import everything that a run of this command imports, once for all of its children; no thread is started.

    Raises
    ------
    RuntimeError
        The command does not end in order.
    """

    def tell() -> None:
        said.with_suffix(".modules").write_text("\n".join(sys.modules))

    if code_of(start(words, said, after=tell)):
        raise RuntimeError(said.read_text())
    for name in (
        *said.with_suffix(".modules").read_text().split(),
        "etendue.archive.checks.verify",
        "etendue.archive.read.stored",
    ):
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    sys.modules["__main__"] = importlib.import_module(
        "etendue.__main__"
    )  # what worker processes import: the program, not the driver
    if len(os.listdir("/proc/self/task")) > 1:
        raise RuntimeError("an import has started a thread")


def start(
    words: list[str], said: Path, before: Callable[[], Any] | None = None, after: Callable[[], Any] | None = None
) -> int:
    """Return the process of a command, the leader of its own session; it calls ``before`` first and ``after`` last.

    Its output goes to a file.
    """
    child = os.fork()
    if child:
        return child
    code = 70
    try:
        os.setsid()
        out = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(out, 1)
        os.dup2(out, 2)
        sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)
        from etendue import cli, interrupts

        interrupts.install()
        if before is not None:
            before()
        code = _code(lambda: cli.main(words, prog_name="etendue"))
        if after is not None:
            after()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _code(work: Callable[[], Any]) -> int:
    try:
        found = work()
    except SystemExit as ended:
        found = ended.code
    except BaseException:
        import traceback

        traceback.print_exc()
        return TRACEBACK
    return found if isinstance(found, int) else 0


def code_of(child: int) -> int:
    """Wait for a child and return its exit code."""
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status)


def answer(work: Callable[[], str | None]) -> str:
    """Return the output of a function called in a process of its own, so that its threads are not in the next child."""
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        try:
            text = work() or ""
        except BaseException as error:
            text = f"{type(error).__name__}: {error}"
        with open(writer, "w") as pipe:
            pipe.write(text)
        sys.stdout.flush()
        os._exit(0)
    os.close(writer)
    with open(reader) as pipe:
        text = pipe.read()
    code_of(child)
    return text


def differs(archive: Path, whole: Path) -> str:
    """Return what differs from the archive of an undisturbed run, or is found by `verify`; '' if nothing.

    Ignored are measured times, the order of chunks in a shard, and pictures of stages that are not kept.
    """

    def compared() -> str:
        from etendue.archive.checks.verify import verify
        from tests.archive.tiny import store_of

        own, was = (
            {path: data for path, data in store_of(folder).items() if not path.startswith("frames/preview/")}
            for folder in (archive, whole)
        )
        off = sorted(path for path in {**own, **was} if own.get(path) != was.get(path))
        if off or not own:
            return f"different archive: {', '.join(off[:3])}"
        damages = verify(archive).damages
        return f"verify: {damages[0].path} {damages[0].kind}" if damages else ""

    return answer(compared)


def left_over(archive: Path, whole: Path) -> list[str]:
    """Return the files that only one of two archives has; every run leaves a record."""

    def names(folder: Path) -> set[str]:
        found = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
        return {name for name in found if not name.startswith("runs/")}

    return sorted(names(archive) ^ names(whole))


def misread(archive: Path, whole: Path) -> str:
    """Return what a reader of an interrupted archive gets that an undisturbed run does not compute; '' if nothing."""

    def read() -> str:
        from etendue.archive.read.stored import Stored
        from etendue.errors import EtendueError

        if not (archive / "journal.jsonl").exists():
            return ""
        try:
            own = Stored(archive)
        except EtendueError:  # nothing is stored yet
            return ""
        sound = Stored(whole)
        for name in own.finished:
            cell, right = own.cell(name), sound.cell(name)
            for variable in cell.variables:
                if cell.read(variable).tobytes() != right.read(variable).tobytes():
                    return f"{name} {variable} is misread"
        return ""

    return answer(read)


def finished_in(archive: Path) -> int:
    """Return the number of cells that are done according to the journal."""
    try:
        return len(
            {
                line.split(b'"cell":"')[1]
                for line in (archive / "journal.jsonl").read_bytes().splitlines()
                if b'"done"' in line[:20]
            }
        )
    except (OSError, IndexError):
        return 0


@dataclass
class Seen:
    """The results for a fault: how often it was as expected, and the other cases."""

    fault: str
    expected: str
    tried: int = 0
    right: int = 0
    wrong: list[str] = field(default_factory=list)
    HEAD: ClassVar = f"{'fault':62s} | {'expected':62s} | as expected"

    def count(self, wrong: str) -> None:
        """Add one result; '' means as expected."""
        self.tried += 1
        self.right += not wrong
        self.wrong += [wrong] if wrong else []

    def print(self) -> int:
        """Print the row and what was wrong; return how many were."""
        print(
            f"{self.fault:62s} | {self.expected:62s} | {self.right} of {self.tried}",
            *(f"    {text}" for text in self.wrong[:5]),
            sep="\n",
            flush=True,
        )
        return self.tried - self.right

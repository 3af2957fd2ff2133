"""Every file operation of a run made to fail, or to be the last: what the same command makes of what is left.

    python benchmarks/faults/file_operations.py [--every 1] [--kinds KIND ...] [--seed 0]

A small sweep is run once to number the operations below its archive (open, write, rename, remove, fsync, ...). Then, for every one
of them, in a process of its own:

killed before, killed after : the process ends there, at once
disk full, input/output error : the operation is refused
power lost (``--durable``) : the process ends there, and of what it wrote only what had been made safe is left: the content of a
    file as of its last fsync, the names in a folder as of the folder's. Of content that was not made safe nothing, a part, or all
    of it is there, by lot.

Behind each the same command runs again. Printed by kind of fault: how many ended in the archive of an undisturbed run, how many
did not, tracebacks, and files left over; every one that is wrong is named. Exit code 1 if there is any.
"""

from __future__ import annotations

import argparse
import builtins
import contextlib
import errno
import io
import os
import random
import shutil
import stat
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

PIPELINE = """
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
[[stages]]
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "lens_numbers"
[sweep]
f_number = [2, 4]
"pixel.rows" = [4, 5]
"""
CHANGES = ("write", "pwrite", "writev", "pwritev", "replace", "rename", "unlink", "remove", "mkdir", "rmdir", "ftruncate", "truncate",
           "fsync", "fdatasync", "copy_file_range", "sendfile", "link", "posix_fallocate")  # fmt: skip
KINDS = ("killed before", "killed after", "disk full", "input/output error", "power lost")
ENDED = 77


class Shadow:
    """What of a folder would outlive the loss of power: contents by file, and names by folder, as of the last fsync of each."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.contents: dict[int, bytes] = {}
        self.names: dict[int, dict[str, tuple[int, bool]]] = {}
        self.held: list[int] = []  # files stay open, so that no number of theirs is given to another
        self.known: set[int] = set()

    def hold(self, handle: int) -> None:
        number = os.fstat(handle).st_ino
        if number not in self.known:
            self.known.add(number)
            self.held.append(os.dup(handle))

    def synced(self, handle: int) -> None:
        state = os.fstat(handle)
        if stat.S_ISDIR(state.st_mode):
            with os.scandir(handle) as entries:
                self.names[state.st_ino] = {e.name: (e.inode(), e.is_dir(follow_symlinks=False)) for e in entries}
        else:
            with open(f"/proc/self/fd/{handle}", "rb") as file:
                self.contents[state.st_ino] = file.read()

    def lose_power(self, lot: random.Random) -> None:
        """Leave in the folder what would be left."""
        now: dict[int, bytes] = {}
        for folder, _, files in os.walk(self.root):
            for name in files:
                path = Path(folder) / name
                now[path.stat().st_ino] = path.read_bytes()
        for handle in self.held:  # of files that were removed as well
            state = os.fstat(handle)
            if stat.S_ISREG(state.st_mode) and state.st_ino not in now:
                with contextlib.suppress(OSError), open(f"/proc/self/fd/{handle}", "rb") as file:
                    now[state.st_ino] = file.read()
        top = self.root.stat().st_ino
        aside = self.root.with_name(self.root.name + ".left")
        self.put(aside, top, now, lot)
        shutil.rmtree(self.root)
        aside.rename(self.root)

    def put(self, place: Path, number: int, now: dict[int, bytes], lot: random.Random) -> None:
        place.mkdir()
        for name, (inode, folder) in self.names.get(number, {}).items():
            if folder:
                self.put(place / name, inode, now, lot)
                continue
            safe, newest = self.contents.get(inode), now.get(inode, b"")
            if safe is None or safe != newest:
                start = safe or b""
                more = newest if newest.startswith(start) else b""
                cut = lot.choice((len(start), lot.randrange(len(start), max(len(more), len(start)) + 1), max(len(more), len(start))))
                newest = more[:cut] if more else start
            (place / name).write_bytes(newest)


class Watched:
    """The operations of this process below a folder, numbered; one of them may be made to fail."""

    def __init__(self, root: Path, at: int, kind: str, lot: random.Random) -> None:
        self.root, self.at, self.kind, self.lot = root, at, kind, lot
        self.count = 0
        self.names: list[str] = []
        self.shadow = Shadow(root) if kind == "power lost" else None
        self.real = {name: getattr(os, name) for name in (*CHANGES, "open")}

    def below(self, target: Any, folder: Any) -> bool:
        try:
            if isinstance(target, int):
                path = os.readlink(f"/proc/self/fd/{target}")
            elif folder is not None:
                path = os.path.join(os.readlink(f"/proc/self/fd/{folder}"), os.fspath(target))
            else:
                path = os.path.abspath(os.fspath(target))
        except (OSError, TypeError):
            return False
        return f"{path}/".startswith(f"{self.root}/")

    def end(self) -> None:
        if self.shadow is not None:
            for name, real in self.real.items():
                setattr(os, name, real)
            self.shadow.lose_power(self.lot)
        os._exit(ENDED)

    def meet(self, name: str, work: Callable[[], Any]) -> Any:
        self.count += 1
        self.names.append(name)
        if self.count != self.at:
            return work()
        if self.kind == "disk full":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if self.kind == "input/output error":
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        if self.kind != "killed before":
            work()
        self.end()
        return None

    def wrapped(self, name: str) -> Callable[..., Any]:
        real = self.real[name]

        def call(*given: Any, **named: Any) -> Any:
            folder = named.get("dir_fd", named.get("src_dir_fd"))
            if not given or not self.below(given[1] if name in ("copy_file_range",) else given[0], folder):
                return real(*given, **named)
            if name == "open":
                flags = given[1] if len(given) > 1 else named.get("flags", 0)
                if not flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
                    return real(*given, **named)
                handle = self.meet(name, lambda: real(*given, **named))
                if self.shadow is not None:
                    self.shadow.hold(handle)
                return handle
            found = self.meet(name, lambda: real(*given, **named))
            if self.shadow is not None and name in ("fsync", "fdatasync"):
                self.shadow.synced(given[0])
            return found

        return call

    def install(self) -> None:
        for name in (*CHANGES, "open"):
            setattr(os, name, self.wrapped(name))
        opened = builtins.open

        def open_(file: Any, mode: str = "r", *given: Any, **named: Any) -> Any:
            if set(mode) & set("wax+") and not isinstance(file, int) and self.below(file, None):
                found = self.meet("open", lambda: opened(file, mode, *given, **named))
                if self.shadow is not None:
                    self.shadow.hold(found.fileno())
                return found
            return opened(file, mode, *given, **named)

        builtins.open = io.open = open_  # type: ignore[assignment]


def run_once(archive: Path, pipeline: Path, durable: bool, watched: Watched | None, said: Path) -> int:
    """The command, in a process split off from this one, which has imported all that it needs."""
    child = os.fork()
    if not child:
        code = 70
        try:
            out = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(out, 1)
            os.dup2(out, 2)
            sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)
            from etendue.cli import main

            if watched is not None:
                watched.install()
            arguments = ["run", str(pipeline), "--archive", str(archive), "--quiet", "--scheduler", "serial"]
            code = _code(lambda: main([*arguments, *(["--durable"] if durable else [])]))
            if watched is not None and not watched.at:
                said.with_suffix(".names").write_text(" ".join(watched.names))
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status)


def _code(work: Callable[[], Any]) -> int:
    try:
        found = work()
    except SystemExit as ended:
        found = ended.code
    except BaseException:
        import traceback

        traceback.print_exc()
        return 99
    return found if isinstance(found, int) else 0


def differs(archive: Path, whole: Path) -> str:
    from tests.run.small import assert_same_archives

    child = os.fork()  # zarr's threads are begun in a process of their own
    if not child:
        try:
            assert_same_archives(archive, whole, frames=False)
        except BaseException:
            os._exit(1)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    return "another archive" if status else ""


def left_over(archive: Path, whole: Path) -> list[str]:
    def names(folder: Path) -> set[str]:
        found = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
        return {name for name in found if not name.startswith("runs/")}

    return sorted(names(archive) ^ names(whole))


def main_() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--every", type=int, default=1, help="try every n-th operation")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    place = Path(tempfile.mkdtemp())
    pipeline = place / "faults.toml"
    pipeline.write_text(PIPELINE)
    os.environ["ETENDUE_CACHE"] = str(place / "cache")
    from etendue.archive import keeper, memory  # noqa: F401
    from etendue.plan import planner  # noqa: F401
    from etendue.report import pictures, tables  # noqa: F401

    if run_once(place / "whole", pipeline, False, None, place / "said"):
        print((place / "said").read_text())
        return 1
    totals = {}
    for durable in (False, True):
        run_once(
            place / f"counted{durable}", pipeline, durable, Watched(place / f"counted{durable}", 0, "", random.Random(0)), place / "said"
        )
        totals[durable] = (place / "said.names").read_text().split()
        print(f"{len(totals[durable])} operations{' with --durable' if durable else ''}: {dict(Counter(totals[durable]).most_common())}")
    wrong = 0
    print(f"{'fault':20} {'tried':>6} {'right':>6} {'wrong':>6} {'tracebacks':>11} {'left over':>10}   exit codes of the disturbed run")
    for kind in args.kinds:
        durable, seen, codes = kind == "power lost", Counter[str](), Counter[int]()
        faults = []
        for at in range(1 + args.seed % args.every, len(totals[durable]) + 1, args.every):
            archive = place / "archive"
            code = run_once(archive, pipeline, durable, Watched(archive, at, kind, random.Random(f"{args.seed} {at}")), place / "said")
            codes[code] += 1
            first = (place / "said").read_text()
            again = run_once(archive, pipeline, durable, None, place / "said")
            text = first + (place / "said").read_text()
            seen["tried"] += 1
            seen["tracebacks"] += "Traceback" in text
            problem = f"exit {again}" if again else differs(archive, place / "whole")
            left = [] if problem else left_over(archive, place / "whole")
            seen["left over"] += bool(left)
            seen["wrong" if problem else "right"] += 1
            if problem or left or "Traceback" in text:
                said = text.strip().splitlines()
                faults.append(f"  {totals[durable][at - 1]} {at}: {problem or left or 'traceback'}: {said[-1] if said else ''}"[:200])
            shutil.rmtree(archive, ignore_errors=True)
        wrong += seen["wrong"] + seen["tracebacks"] + seen["left over"]
        print(
            f"{kind:20} {seen['tried']:6} {seen['right']:6} {seen['wrong']:6} {seen['tracebacks']:11} {seen['left over']:10}   "
            f"{dict(sorted(codes.items()))}", flush=True,
        )  # fmt: skip
        print(*faults[:20], sep="\n", end="\n" if faults else "")
    shutil.rmtree(place)
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main_())

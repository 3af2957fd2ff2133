"""Faults in the environment of a run: concurrent runs and readers, file systems that refuse writes, clocks, names,
pipes.

    python benchmarks/faults/surroundings.py [--only places readers] [--count 10]

In:  a small sweep, run in processes forked from one that has imported all modules; a private mount namespace.
Out: a table: fault | expected | as expected, with counts. Everything else is named, and the exit code is then 1.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from forked import PIPELINE, Seen, answer, code_of, differs, import_all, left_over, misread, start
from processes import listening

NAMES = (
    "a b",
    "épreuve–試験",
    "-rf",
    "a'\"b",
    "a\nb",
    "x" * 200,
    "x" * 300,
    "con",
    "a:b",
    "$(id)",
    "%s{}",
    ".hidden",
    "a\tb",
)
HUGE = (
    ("width = ", '"30 mm"'),
    ("height = ", '"30 mm"'),
    ("rows = ", "6000"),
    ("columns = ", "6000"),
    ('"pixel.rows" = ', "[6000]"),
)


class Place:
    """A folder with the pipeline and the results of an undisturbed run."""

    def __init__(self, folder: Path, chance: random.Random) -> None:
        self.folder, self.chance, self.said, self.whole = folder, chance, folder / "said", folder / "whole"
        self.pipeline = folder / "faults.toml"
        self.pipeline.write_text(PIPELINE)
        import_all(self.words(folder / "imports"), self.said)
        if self.run(self.whole):
            raise RuntimeError(self.said.read_text())

    def words(self, archive: Path, *more: str) -> list[str]:
        return ["run", str(self.pipeline), "--archive", str(archive), "--json", "--quiet", *more]

    def run(self, archive: Path, *more: str) -> int:
        return code_of(start(self.words(archive, *more), self.said))

    def call(self, *words: str, before: Callable[[], object] | None = None) -> tuple[int, str]:
        """Return the exit code of a command, and its output."""
        code = code_of(start(list(words), self.said, before))
        return code, self.said.read_text(errors="replace")

    def copied(self, name: str = "copy") -> Path:
        shutil.rmtree(self.folder / name, ignore_errors=True)
        return Path(shutil.copytree(self.whole, self.folder / name))

    def computed(self) -> int:
        return int(json.loads(self.said.read_text().splitlines()[-1])["computed"])

    def ends_right(self, archive: Path) -> str:
        """Return what is wrong with the archive after the same command has run again; '' if nothing is."""
        code = self.run(archive)
        why = f"exit {code}: {self.said.read_text()[-200:]}" if code else differs(archive, self.whole)
        left = [] if why else left_over(archive, self.whole)
        return why or (f"left {left[:3]}" if left else "")


def in_words(code: int, said: str, wanted: int, *words: str) -> str:
    """Return '' if a command ended with this code and a few lines that contain these words; else what it did."""
    lines = [line for line in said.splitlines() if not line.startswith("note: ")]
    right = code == wanted and "Traceback" not in said and len(lines) <= 3 and all(word in said for word in words)
    return "" if right else f"exit {code}: {said[-300:]}"


def together(place: Place, count: int) -> Iterator[Seen]:
    """Run two runs on one archive at the same time."""
    seen = Seen("two runs on one archive at the same time", "exit 0, and exit 0 or 4 (in use); archive correct")
    for number in range(count):
        archive, second = place.folder / f"two{number}", place.folder / "second"
        first = start(place.words(archive), place.said)
        time.sleep(place.chance.uniform(0.0, 0.3))
        other = start(place.words(archive), second)
        codes = [code_of(first), code_of(other)]
        said = place.said.read_text() + second.read_text()
        wrong = (
            "" if 0 in codes and set(codes) <= {0, 4} and "Traceback" not in said else f"exit {codes}: {said[-300:]}"
        )
        seen.count(wrong or differs(archive, place.whole))
        shutil.rmtree(archive)
    yield seen


def readers(place: Place, count: int) -> Iterator[Seen]:
    """Read an archive while a run writes it."""
    seen, show = (
        Seen("read during a run", "every array returned is correct"),
        Seen("show during a run", "exit 0, or 2 with a message"),
    )
    for number in range(count):
        archive, child = place.folder / f"read{number}", start(place.words(place.folder / f"read{number}"), place.said)
        while os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
            seen.count(misread(archive, place.whole))
            code = code_of(start(["show", str(archive)], place.folder / "shown"))
            said = (place.folder / "shown").read_text()
            show.count("" if code in (0, 2) and "Traceback" not in said else f"exit {code}: {said[-300:]}")
        seen.count(differs(archive, place.whole) if not code_of(child) else place.said.read_text())
        shutil.rmtree(archive)
    yield seen
    yield show


def places(place: Place, count: int) -> Iterator[Seen]:
    """Use read-only folders and full disks, in a private mount namespace."""
    mount = place.folder / "mount"
    mount.mkdir()

    def mounted(words: str, *command: str) -> tuple[int, str]:
        script = f'{words} && exec "$@"'
        done = subprocess.run(
            ["unshare", "-m", "sh", "-c", script, "sh", *command], capture_output=True, text=True, check=False
        )
        return done.returncode, done.stdout + done.stderr

    if mounted("true", "true")[0]:
        print("(a private mount namespace is not available here: file systems are not tested)")
        return
    program = (sys.executable, "-m", "etendue")
    shutil.copytree(place.whole, mount / "whole")
    locked = f"mount --bind '{mount}' '{mount}' && mount -o remount,ro,bind '{mount}'"
    seen = Seen("run on a read-only file system", "exit 5, one line with the file system's message")
    for archive, more in (
        (mount / "whole", ()),
        (mount / "whole", ("--set", "camera.pixel_pitch=4 um")),
        (mount / "new", ()),
    ):
        seen.count(in_words(*mounted(locked, *program, *place.words(archive, *more)), 5, "Read-only file system"))
    yield seen
    seen = Seen("verify, show, diff on a read-only file system", "exit 0")
    for words in (("verify", mount / "whole"), ("show", mount / "whole"), ("diff", mount / "whole", place.whole)):
        code, said = mounted(locked, *program, *map(str, words))
        seen.count("" if not code else f"exit {code}: {said[-300:]}")
    yield seen
    seen = Seen("disk full after some bytes or files, then freed", "exit 5, one line; then exit 0, same archive")
    for room in (
        *(f"size={size}k" for size in (4, 64, 200, 300, 400, 480, 560, 700)),
        *(f"nr_inodes={n}" for n in (3, 9, 60, 200, 400)),
    ):
        archive = place.folder / "full"
        small = f"mount -t tmpfs -o {room} none '{mount}'"
        copied = f"{small} && trap 'cp -a {mount}/a {archive} 2>/dev/null' EXIT; set +e; \"$@\"; exit $?"
        done = subprocess.run(
            ["unshare", "-m", "sh", "-c", copied, "sh", *program, *place.words(mount / "a")],
            capture_output=True,
            text=True,
            check=False,
        )
        wrong = (
            ""
            if done.returncode == 0
            else min(
                in_words(done.returncode, done.stderr, 5, words) for words in ("No space left", "free on the disk")
            )
        )
        seen.count(wrong or place.ends_right(archive))
        shutil.rmtree(archive, ignore_errors=True)
    yield seen


def clocks(place: Place, count: int) -> Iterator[Seen]:
    """Use archives that were copied or moved, and whose files have other dates."""
    seen = Seen(
        "copied, moved; dates of 1970, 2038, 2100; other time zone", "verify finds nothing, a run computes nothing"
    )
    for stamp, zone in ((0, "UTC"), (2**31, "Pacific/Kiritimati"), (4_102_444_800, "America/St_Johns"), (None, "UTC")):
        archive = place.copied("moved à part")
        for path in archive.rglob("*") if stamp is not None else ():
            os.utime(path, (stamp, stamp))
        code, said = place.call("verify", str(archive), before=lambda zone=zone: os.environ.update(TZ=zone))
        wrong = f"verify {code}: {said[-200:]}" if code else ""
        code = place.run(archive)
        seen.count(wrong or (f"exit {code}" if code else f"{place.computed()} computed" if place.computed() else ""))
        shutil.rmtree(archive)
    yield seen


def memory(place: Place, count: int) -> Iterator[Seen]:
    """Plan frames larger than any memory, and run on a machine with little memory."""
    text = PIPELINE
    for word, value in HUGE:
        head, _, rest = text.partition(word)
        text = head + word + value + "\n" + rest.partition("\n")[2]
    place.pipeline.write_text(text)
    seen = Seen("frames larger than memory", "exit 5 before computing, with the bytes and a remedy")
    archive = place.folder / "large"
    for before in (None, partial(resource.setrlimit, resource.RLIMIT_AS, (2_000_000_000, 2_000_000_000))):
        wrong = in_words(
            *place.call(*place.words(archive), before=before), 5, "would be held at once", "GB are free", "shorten"
        )
        seen.count(wrong or ("an archive was created" if archive.exists() else ""))
    place.pipeline.write_text(PIPELINE)
    yield seen


def names(place: Place, count: int) -> Iterator[Seen]:
    """Use archives with unusual names."""
    seen = Seen(
        "names with spaces, quotes, newlines, other scripts, too long",
        "exit 0 and same archive, or exit 2 or 5 and nothing written",
    )
    for name in NAMES:
        archive = place.folder / "names" / name
        code, said = place.call(*place.words(archive))
        if code == 0:
            seen.count(differs(archive, place.whole))
        else:
            there = list((place.folder / "names").iterdir()) if (place.folder / "names").exists() else []
            seen.count(in_words(code, said, code if code in (2, 5) else 2) or (f"{there} is there" if there else ""))
        shutil.rmtree(place.folder / "names", ignore_errors=True)
    yield seen


def pipes(place: Place, count: int) -> Iterator[Seen]:
    """Close the reader of stdout, or hang up the terminal."""
    seen = Seen("stdout closed, `| true`, or full", "no traceback, no other Python message")
    words = (
        ["show", str(place.whole)],
        ["stages"],
        ["plan", str(place.pipeline)],
        place.words(place.folder / "piped"),
        ["--help"],
    )
    for command in words:
        for behind in ("| true", ">&-", "> /dev/full"):
            line = " ".join(f"'{word}'" for word in (sys.executable, "-m", "etendue", *command))
            done = subprocess.run(["sh", "-c", f"{line} {behind}"], capture_output=True, text=True, check=False)
            odd = "Traceback" in done.stderr or "Exception ignored" in done.stderr
            seen.count(f"{command[0]} {behind}: {done.stderr[-300:]}" if odd else "")
    seen_ = Seen("SIGHUP at a random instant", "exit 129, one line; then same archive")
    for number in range(count):
        archive = place.folder / f"hung up{number}"
        child = start(place.words(archive), place.said)
        time.sleep(place.chance.uniform(0.0, 0.3))
        os.kill(child, signal.SIGHUP)
        code, said = code_of(child), place.said.read_text()
        wrong = "" if code in (0, -signal.SIGHUP) else in_words(code, said, 129, "interrupted")
        seen_.count(wrong or place.ends_right(archive))
        shutil.rmtree(archive)
    yield seen
    yield seen_


def network(place: Place, count: int) -> Iterator[Seen]:
    """List the sockets on which a run listens."""
    for scheduler, allowed in (("threads", set()), ("processes", set()), ("distributed", {"0100007F"})):
        where = "loopback only" if allowed else "none"
        seen, archive = Seen(f"listening sockets of a run, {scheduler}", where), place.folder / "net"
        child, found = start(place.words(archive, "--scheduler", scheduler, "--workers", "2"), place.said), set[str]()
        while os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
            found |= set(listening(child))
            time.sleep(0.05)
        code = code_of(child)
        odd = (
            f"exit {code}: {place.said.read_text()[-300:]}"
            if code
            else "no socket was found"
            if allowed and not found
            else ""
        )
        seen.count(odd or (f"listens on {found}" if found - allowed else ""))
        shutil.rmtree(archive)
        yield seen


FAULTS: dict[str, Callable[[Place, int], Iterator[Seen]]] = {
    "together": together,
    "readers": readers,
    "places": places,
    "clocks": clocks,
    "memory": memory,
    "names": names,
    "pipes": pipes,
    "network": network,
}


def tried(folder: str, only: list[str], count: int, seed: int) -> str:
    place, wrong = Place(Path(folder), random.Random(seed)), 0
    for name in only:
        for seen in FAULTS[name](place, count):
            wrong += seen.print()
    return str(wrong)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", choices=FAULTS, default=list(FAULTS))
    parser.add_argument("--count", type=int, default=10, help="number of faults at random instants")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    print(Seen.HEAD, flush=True)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["ETENDUE_CACHE"] = f"{folder}/cache"
        told = answer(lambda: tried(folder, given.only, given.count, given.seed))
    print(told if not told.isdigit() else f"not as expected: {told}")
    return int(told != "0")


if __name__ == "__main__":
    sys.exit(main())

"""Open malicious archives and files: what does etendue open, wait for, hold in memory and print?

    python benchmarks/faults/hostile.py [--only fifo bomb] [--from KIND] [--commands verify show] [--verbose]

In:  a small archive with an input, and files of the kinds that pipelines name; each is manipulated in a copy.
Out: kind | command | exit code | CPU s and MB above those of a sound archive | what went wrong; exit code 1 if anything
     did.

A command goes wrong if it opens anything outside (seen by strace), does not end, exceeds its limit of time or memory,
prints more than 20 lines of 200 characters on stderr, shows a traceback, or reports an internal error. Requires Linux
and strace.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from hostile_kinds import ARCHIVES, FILES, LIGHT, sound_archive
from stranger_files import FILES as MORE_FILES
from stranger_kinds import STRANGERS

ARCHIVES, FILES = ARCHIVES | STRANGERS, FILES | MORE_FILES

QUICK, SLOW = (2.0, 200.0), (10.0, 400.0)  # CPU s, MB, above a sound archive's
BOUNDS = {"verify": QUICK, "show": QUICK, "plan": QUICK, "measure": QUICK}
READERS = ("verify", "show", "report", "reproduce", "rerun", "plot", "export")
WORDS = {"plot": ["plot", "tiny", "--list"], "export": ["export", "tiny", "--tiff", "--variable", "raw"]}
WAIT = 15.0  # s, after which a command counts as hanging; raise it with --wait on a busy machine
MOST = 20 * 200  # characters on stderr
OUTSIDE = ("/etc/passwd", "/dev/zero")
OPENED = re.compile(r" = \d+<([^>]*)>$")


@dataclass
class Seen:
    """The result of one command."""

    code: int
    cpu: float
    memory: float  # MB, the peak
    out: str
    err: str
    outside: list[str]
    hangs: bool


def watched(words: list[str], folder: Path, canary: Path, wait: float = WAIT) -> Seen:
    """Run a command line of etendue in a folder; files below ``canary`` are outside."""
    log, out, err = (folder / name for name in (".trace", ".out", ".err"))
    watch = ["strace", "-f", "--seccomp-bpf", "-y", "-qq", "-e", "trace=open,openat,connect", "-o", str(log)]
    start = [*watch, sys.executable, "-m", "etendue", *words]
    environment = {**os.environ, "ETENDUE_CACHE": str(folder.parent / ".cache"), "COLUMNS": "200"}
    with out.open("wb") as first, err.open("wb") as second:
        process = subprocess.Popen(
            start,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=first,
            stderr=second,
            env=environment,
            start_new_session=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (12 << 30, 12 << 30)),
        )
        until, hangs = time.monotonic() + wait, False
        while True:
            pid, status, used = os.wait4(process.pid, os.WNOHANG)
            if pid:
                break
            if time.monotonic() > until and not hangs:
                hangs = True
                os.killpg(process.pid, signal.SIGKILL)
            time.sleep(0.02)
    process.returncode = os.waitstatus_to_exitcode(status)
    opened = [found[1] for line in log.read_text(errors="replace").splitlines() if (found := OPENED.search(line))]
    outside = sorted({path for path in opened if path.startswith((f"{canary}/", *OUTSIDE))})
    said = [path.read_text(errors="replace") for path in (out, err)]
    return Seen(process.returncode, used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3, *said, outside, hangs)


def remove(folder: Path) -> None:
    """Remove a folder of any depth: ``shutil.rmtree`` recurses for every level."""
    subprocess.run(["rm", "-rf", str(folder)], check=True)


def faults_of(seen: Seen, command: str, base: Seen) -> list[str]:
    """Return what went wrong with a command, in words."""
    seconds, memory = BOUNDS.get(command, SLOW)
    found = {
        "hangs": seen.hangs,
        f"opened {', '.join(seen.outside)[:120]}": bool(seen.outside),
        f"{seen.cpu - base.cpu:.1f} s CPU": seen.cpu - base.cpu > seconds,
        f"{seen.memory - base.memory:.0f} MB": seen.memory - base.memory > memory,
        f"{len(seen.err)} characters on stderr": len(seen.err) > MOST or len(seen.err.splitlines()) > 20,
        "internal error": "Traceback" in seen.err or "internal error in etendue" in seen.err,
        f"killed by signal {-seen.code}": seen.code < 0 and not seen.hangs,
    }
    return [text for text, wrong in found.items() if wrong]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--from", dest="first", default="", metavar="KIND", help="this kind and all after it")
    parser.add_argument("--commands", nargs="*", default=[])
    parser.add_argument("--wait", type=float, default=WAIT)
    parser.add_argument("--verbose", action="store_true")
    asked = parser.parse_args()
    wrong, tried = 0, 0
    with tempfile.TemporaryDirectory() as text:
        place = Path(text).resolve()
        canary = place / "outside"
        canary.mkdir()
        (canary / "secret.txt").write_text(LIGHT)
        sound = sound_archive(place / "sound")
        kinds = [(name, act, READERS) for name, act in ARCHIVES.items()] + [(name, *one) for name, one in FILES.items()]
        kinds = kinds[next(number for number, one in enumerate(kinds) if asked.first in one[0]) :]
        bases: dict[str, Seen] = {}
        print(f"{'kind':42} {'command':10} {'code':>4} {'CPU s':>6} {'MB':>5}  what went wrong")
        for name, act, commands in kinds:
            if asked.only and not any(word in name for word in asked.only):
                continue
            for command in [one for one in commands if not asked.commands or one in asked.commands]:
                folder = place / "case"
                words = WORDS.get(command, [command, "tiny"])
                if command not in bases:  # from a sound archive; for a file, what Python takes at least
                    remove(folder)
                    shutil.copytree(sound, folder / "tiny")
                    bases[command] = watched(
                        words if command in READERS else ["stages", "pixel"], folder, canary, asked.wait
                    )
                remove(folder)
                folder.mkdir()
                if name in ARCHIVES:
                    shutil.copytree(sound, folder / "tiny")
                    act(folder / "tiny", canary)
                else:
                    words = [command, str(act(folder, canary))]
                seen = watched(words, folder, canary, asked.wait)
                found = faults_of(seen, command, bases[command])
                wrong, tried = wrong + bool(found), tried + 1
                more, larger = seen.cpu - bases[command].cpu, seen.memory - bases[command].memory
                print(f"{name:42} {command:10} {seen.code:4} {more:6.1f} {larger:5.0f}  {'; '.join(found)}", flush=True)
                if asked.verbose:
                    print("    | " + "\n    | ".join(line[:300] for line in (seen.out + seen.err).splitlines()[-8:]))
            remove(folder)
        print(f"{wrong} of {tried} went wrong")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()

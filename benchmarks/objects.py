"""What an archive costs on an object store: seconds and requests, beside the same run on disk.

    python benchmarks/objects.py [pipelines/smallest.toml ...] [--latency 20]

A local S3 server (moto, `pip install 'moto[s3]' flask flask-cors`) on loopback; ``--latency`` milliseconds are slept in
front of every request of ours, as a store far away takes them. Each command is a process of its own; requests are
counted in it. First run, the same command again, ``show``, ``verify``, a run from a machine that knows nothing of the
archive, one that adds a value to an axis there.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
import tomllib
import urllib.request
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
COUNTING = """
import atexit, json, os, sys, time
from collections import Counter
if os.environ.get("COUNT_TO"):
    from etendue.archive.remote import objects
    counts, late = Counter(), float(os.environ["LATENCY"]) / 1000
    asked = {"get": "get", "part": "get", "pieces": "get", "put": "put", "delete": "delete", "list": "list"}
    for kind, name in asked.items():
        def counted(self, *rest, real=getattr(objects.Objects, kind), name=name):
            time.sleep(late)
            counts[name] += 1
            return real(self, *rest)
        setattr(objects.Objects, kind, counted)
    atexit.register(lambda: open(os.environ["COUNT_TO"], "w").write(json.dumps(counts)))
"""


def serve() -> tuple[subprocess.Popen[bytes], str]:
    """An S3 server with one bucket."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    own = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    for _ in range(600):
        try:
            urllib.request.urlopen(
                urllib.request.Request(f"http://127.0.0.1:{port}/bucket", method="PUT"), timeout=10
            ).read()
            return own, f"http://127.0.0.1:{port}"
        except OSError:
            time.sleep(0.1)
    own.kill()
    raise SystemExit("the S3 server does not answer: pip install 'moto[s3]' flask flask-cors")


def command(place: Path, words: list[str], latency: float, **more: str) -> tuple[float, dict[str, int]]:
    """One command: seconds of wall clock, requests by kind."""
    told = place / "requests.json"
    told.unlink(missing_ok=True)
    paths = os.pathsep.join([str(place), *filter(None, [os.environ.get("PYTHONPATH", "")])])
    environment = {
        **os.environ,
        "PYTHONPATH": paths,
        "COUNT_TO": str(told),
        "LATENCY": str(latency),
        "OMP_NUM_THREADS": "1",
        **more,
    }
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "etendue", *words], env=environment, capture_output=True, text=True, cwd=place
    )
    seconds = time.perf_counter() - began
    if done.returncode:
        raise SystemExit(done.stderr)
    return seconds, json.loads(told.read_text()) if told.exists() else {}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "files", nargs="*", type=Path, default=[ROOT / "pipelines/smallest.toml", ROOT / "pipelines/paper.toml"]
    )
    parser.add_argument("--latency", type=float, default=20.0)
    given = parser.parse_args()
    server, endpoint = serve()
    keys = {
        "AWS_ENDPOINT_URL": endpoint,
        "AWS_ACCESS_KEY_ID": "a",
        "AWS_SECRET_ACCESS_KEY": "b",
        "AWS_REGION": "us-east-1",
    }
    try:
        for number, file in enumerate(given.files):
            measure(file.resolve(), f"s3://bucket/{number}/{file.stem}", keys, given.latency)
    finally:
        server.kill()
        server.wait()


def measure(file: Path, url: str, keys: dict[str, str], latency: float) -> None:
    place = Path(tempfile.mkdtemp())
    (place / "sitecustomize.py").write_text(COUNTING)
    here, there = keys | {"ETENDUE_WORK": str(place / "here")}, keys | {"ETENDUE_WORK": str(place / "there")}
    run, more = ["run", str(file), "--quiet"], ["--sweep", "f_number=2,2.8,5.6,11"]
    rows = []
    command(place, [*run, "--archive", "warm"], latency)  # tables and compiled code
    rows.append(("run, on disk", *command(place, [*run, "--archive", "disk"], latency)))
    rows.append(("run", *command(place, [*run, "--archive", url], latency, **here)))
    rows.append(("run again, on disk", *command(place, [*run, "--archive", "disk"], latency)))
    rows.append(("run again", *command(place, [*run, "--archive", url], latency, **here)))
    rows.append(("run again, elsewhere", *command(place, [*run, "--archive", url], latency, **there)))
    rows.append(("show", *command(place, ["show", url], latency, **there)))
    rows.append(("verify, on disk", *command(place, ["verify", "disk", "--quiet"], latency)))
    rows.append(("verify", *command(place, ["verify", url, "--quiet"], latency, **there)))
    if "f_number" in tomllib.loads(file.read_text()).get("sweep", {}):
        rows.append(
            ("run with another value, elsewhere", *command(place, [*run, *more, "--archive", url], latency, **there))
        )
    size = sum(path.stat().st_size for path in (place / "disk").rglob("*") if path.is_file())
    files = sum(path.is_file() for path in (place / "disk").rglob("*"))
    print(f"{file.name}: {files} files, {size / 1e6:.1f} MB; {latency:g} ms in front of every request")
    for name, seconds, counts in rows:
        print(
            f"  {name:36s} {seconds:6.2f} s   {'  '.join(f'{n} {kind}' for kind, n in sorted(counts.items())) or '-'}"
        )


if __name__ == "__main__":
    main()

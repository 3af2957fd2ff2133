"""Processes of this machine that act as other machines: a Dask scheduler, workers under nannies, and their packages.

In:  a folder to work in, an environment.
Out: clusters that end with all their processes.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from processes import children

HERE = Path(__file__).resolve().parent


def free_port() -> int:
    with socket.socket() as door:
        door.bind(("127.0.0.1", 0))
        return int(door.getsockname()[1])


def environment(*folders: Path) -> dict[str, str]:
    path = os.pathsep.join([*map(str, folders), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}


def brought(site: Path, version: str) -> Path:
    """Install the plugin as pip would."""
    info = site / f"toil-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: toil\nVersion: {version}\n")
    (info / "entry_points.txt").write_text("[etendue]\ntoil = toil\n")
    (info / "RECORD").write_text("toil.py,,\n")
    (site / "toil.py").write_text((HERE / "toil.py").read_text() + ("" if version == "1.0" else f"\n# {version}\n"))
    return site


def fake(folder: Path, distribution: str, version: str) -> Path:
    """Write metadata that claim that another version of a distribution is installed."""
    info = folder / f"{distribution}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: {version}\n")
    return folder


@dataclass
class Cluster:
    """A scheduler and workers as processes of this machine, each worker under a nanny of its own."""

    folder: Path
    env: dict[str, str]
    words: tuple[str, ...] = ()
    port: int = field(default_factory=free_port)
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def address(self) -> str:
        return f"tcp://127.0.0.1:{self.port}"

    def spawn(
        self, module: str, *words: str, env: dict[str, str] | None = None, before: tuple[str, ...] = ()
    ) -> subprocess.Popen[bytes]:
        command = [
            *before,
            sys.executable,
            "-m",
            f"distributed.cli.{module}",
            *words,
            "--host",
            "127.0.0.1",
            "--no-dashboard",
        ]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
        return subprocess.Popen(command, cwd=self.folder, env=env or self.env, **quiet)  # type: ignore[call-overload, no-any-return]

    def start_scheduler(self) -> None:
        self.scheduler = self.spawn("dask_scheduler", "--port", str(self.port))

    def add(
        self, *words: str, env: dict[str, str] | None = None, before: tuple[str, ...] = ()
    ) -> subprocess.Popen[bytes]:
        process = self.spawn(
            "dask_worker", self.address, "--nthreads", "1", *self.words, *words, env=env, before=before
        )
        self.workers.append(process)
        return process

    def wait_for(self, workers: int) -> None:
        import distributed

        until = time.monotonic() + 60
        while True:
            try:
                with distributed.Client(self.address, timeout="5s", set_as_default=False) as client:
                    client.wait_for_workers(workers, timeout=60)
                    return
            except (OSError, TimeoutError):
                if time.monotonic() > until:
                    raise

    def __enter__(self) -> Cluster:
        self.start_scheduler()
        return self

    def __exit__(self, *_: object) -> None:
        for process in (*self.workers, self.scheduler):
            for pid in (*children(process.pid), process.pid):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            process.wait()


@contextlib.contextmanager
def cluster(folder: Path, env: dict[str, str], workers: int = 2, *words: str) -> Iterator[Cluster]:
    with Cluster(folder, env, words) as made:
        for _ in range(workers):
            made.add()
        made.wait_for(workers)
        yield made

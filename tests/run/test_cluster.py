"""A cluster that is not there, and one that loses workers. The second needs half a minute of processes: ETENDUE_CLUSTER=1."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from etendue.errors import MachineError
from tests.cli.test_plugins import install
from tests.run import misbehaving
from tests.run.misbehaving import DIES
from tests.run.small import environment
from tests.run.test_misbehaving import PIPELINE, check, run

pytest.importorskip("distributed")


def test_a_scheduler_that_cannot_be_reached_is_said_to_be_that(monkeypatch):
    from etendue.run import cluster
    from etendue.run.watch import Stop

    monkeypatch.setattr(cluster, "ANSWER", "0.3s")
    with pytest.raises(MachineError, match=r"tcp://127.0.0.1:9: no Dask scheduler answers there .*dask scheduler.*--scheduler threads"):
        cluster.run_on_cluster([], frozenset(), None, None, "tcp://127.0.0.1:9", Stop(), None)


@pytest.mark.skipif(not os.environ.get("ETENDUE_CLUSTER"), reason="slow")
def test_only_the_guilty_cell_fails_and_a_scheduler_that_dies_is_named(tmp_path):
    install(tmp_path / "site", "naughty-light", "naughty_light", Path(misbehaving.__file__).read_text())
    (tmp_path / "file.toml").write_text(PIPELINE)
    address = "tcp://127.0.0.1:18787"
    env = environment(PYTHONPATH=str(tmp_path / "site"))
    quiet = {"env": env, "cwd": tmp_path, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    dask = [sys.executable, "-m"]
    scheduler = subprocess.Popen(
        [*dask, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "18787", "--no-dashboard"], **quiet
    )
    workers = subprocess.Popen(
        [*dask, "distributed.cli.dask_worker", address, "--nworkers", "2", "--nthreads", "1", "--host", "127.0.0.1", "--no-dashboard"],
        **quiet,
    )
    try:
        time.sleep(6)
        ways = ["behaves", "leaves", "gives lists"]
        check(tmp_path, run(tmp_path, ways, "--scheduler", address, "--archive", "a"), "a", {"leaves": "every worker died"}, ways[::2])
        ways[1] = "hangs"
        done = run(tmp_path, ways, "--scheduler", address, "--archive", "b", "--cell-timeout", "2")
        check(tmp_path, done, "b", {"hangs": DIES["hangs"][1]}, ways[::2])
        process = subprocess.Popen(
            [sys.executable, "-m", "etendue", "run", "file.toml", "--set", "naughty.how=hangs", "--scheduler", address, "--archive", "c"],
            cwd=tmp_path, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        journal = tmp_path / "c" / "journal.jsonl"
        until = time.monotonic() + 60
        while not (journal.exists() and '"start"' in journal.read_text()) and time.monotonic() < until:
            time.sleep(0.1)
        time.sleep(2)
        scheduler.kill()
        _, said = process.communicate(timeout=60)
        assert process.returncode == 5
        assert "the scheduler is gone" in said and address in said and len(said.splitlines()) == 1
    finally:
        for process in (workers, scheduler):
            process.send_signal(signal.SIGTERM)
        workers.wait(30)

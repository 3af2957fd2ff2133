"""Runs that are killed at any instant, interrupted or terminated: what is there is right, and the next run finishes it.

``ETENDUE_KILLS`` sets how many random kills are tried.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import xarray

from tests.run.small import assert_same_archives, command, environment, text_of

KILLS = int(os.environ.get("ETENDUE_KILLS", "8"))
AXES = {"f_number": [2, 4, 5.6], "pixel_pitch": [2.0, 2.6], "integration_time": [0.001, 0.002, 0.004, 0.008]}
FINELY = """
from etendue import session
whole = session.partition
session.partition = lambda jobs, seconds: whole(jobs, 0.0)  # a batch, and so a journal line, for every cell
"""
DRAWN_OUT = (
    FINELY
    + """
import os, time, types
from etendue.archive.records import disk

def replace(*paths, **folders):  # half of the kills should fall between chunks, and some between a shard and its place
    if paths[1].startswith("c."):
        time.sleep(0.02)
    os.replace(*paths, **folders)
    if paths[1].startswith("c."):
        time.sleep(0.02)

def pwritev(handle, pieces, offset):  # and some in the middle of a write
    time.sleep(0.002)
    if len(pieces) > 1:
        return os.pwritev(handle, pieces[:1], offset)
    return os.pwritev(handle, pieces, offset)

disk.os = types.SimpleNamespace(**{**vars(os), "replace": replace, "pwritev": pwritev})
"""
)
SLOWLY = (
    FINELY
    + """
import time
from etendue_camera.sensor import cfa
picked = cfa.pick

def pick(*arguments):
    time.sleep(0.2)
    return picked(*arguments)

cfa.pick = pick
"""
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The pipeline file, an uninterrupted archive of it, and how long that took."""
    place = tmp_path_factory.mktemp("kill")
    (place / "small.toml").write_text(text_of(**AXES))
    for name, source in (("finely", FINELY), ("drawn out", DRAWN_OUT), ("slowly", SLOWLY)):
        (place / name).mkdir()
        (place / name / "sitecustomize.py").write_text(source)
    began = time.monotonic()
    done = command(
        "run", place / "small.toml", "--archive", place / "whole", "--quiet", PYTHONPATH=str(place / "finely")
    )
    assert done.returncode == 0, done.stderr
    return place, time.monotonic() - began


def start(*arguments, **more):
    return subprocess.Popen(
        [sys.executable, "-m", "etendue", *map(str, arguments)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(**more),
        preexec_fn=lambda: signal.signal(
            signal.SIGINT, signal.SIG_DFL
        ),  # a shell ignores it for what it runs in the background
    )


def done_cells(archive):
    try:
        text = (archive / "journal.jsonl").read_text()
    except FileNotFoundError:
        return 0
    return text.count('"event":"done"')


def wait_for(condition, process=None, seconds=60):
    for _ in range(int(seconds / 0.005)):
        if condition() or (process is not None and process.poll() is not None):
            return
        time.sleep(0.005)
    raise AssertionError("waited in vain")


@pytest.mark.long
def test_a_run_killed_at_random_instants_is_finished_by_the_next(whole, tmp_path):
    """A kill may hit anything: imports, creation of arrays, chunks, journal, tables, consolidation."""
    place, seconds = whole
    total = done_cells(place / "whole")
    chance = random.Random(20)
    died = {"before any cell": 0, "between cells": 0, "after all cells": 0, "not at all": 0}
    for number in range(KILLS):
        archive = tmp_path / f"{number}"
        for _ in range(chance.choice((1, 1, 2))):
            scheduler = chance.choice(("serial", "threads"))
            python = str(place / "drawn out")
            process = start(
                "run",
                place / "small.toml",
                "--archive",
                archive,
                "--quiet",
                "--scheduler",
                scheduler,
                "--workers",
                2,
                PYTHONPATH=python,
            )
            if chance.random() < 0.3:  # anywhere, imports and the end too
                time.sleep(seconds * chance.uniform(0.2, 1.2))
            else:
                before = done_cells(archive)
                wait_for(lambda a=archive, n=before: done_cells(a) > n, process)
                time.sleep(chance.uniform(0.0, 1.0))
            process.kill()
            code = process.wait()
            process.stderr.close()
            count = done_cells(archive)
            died[
                "not at all"
                if code == 0
                else "before any cell"
                if not count
                else "between cells"
                if count < total
                else "after all cells"
            ] += 1
        done = command("run", place / "small.toml", "--archive", archive, "--quiet")
        assert done.returncode == 0, done.stderr
        assert_same_archives(archive, place / "whole")
        assert not [*archive.rglob("*.partial"), *archive.rglob("*.part")]
    print(died)


@pytest.mark.long
def test_a_run_killed_at_every_stage_of_its_journal_is_finished_by_the_next(whole, tmp_path):
    """Kills aimed by progress, not by time: after so many finished cells."""
    place, _ = whole
    total = done_cells(place / "whole")
    for part in (0.0, 0.3, 0.7, 0.99):
        archive = tmp_path / f"{part}"
        process = start("run", place / "small.toml", "--archive", archive, "--quiet", PYTHONPATH=str(place / "finely"))
        wait_for(lambda a=archive, p=part: done_cells(a) > p * total, process)
        process.kill()
        process.wait()
        process.stderr.close()
        assert done_cells(archive) > part * total
        done = command("run", place / "small.toml", "--archive", archive, "--json")
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["computed"] < total or part == 0.0
        assert_same_archives(archive, place / "whole")


BETWEEN = """
import os
from etendue.archive.write.store import ArchiveWriter

left = [int(os.environ["DIE_AFTER"])]
reported = ArchiveWriter.reported

def die(self, reports):
    reports = list(reports)
    if left[0] <= 0:
        os._exit(9)
    left[0] -= len(reports)
    reported(self, reports)

ArchiveWriter.reported = die
"""


def run_until(place, archive, die_after, *arguments):
    """A run that dies between the writing of chunks and the journal line that would say so."""
    main = "import sys; from etendue.cli import main; sys.argv = ['etendue', *sys.argv[1:]]; main()"
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            f"{BETWEEN}\n{main}",
            "run",
            str(place / "small.toml"),
            "--archive",
            str(archive),
            "--quiet",
            *arguments,
        ],
        env=environment(DIE_AFTER=str(die_after), PYTHONPATH=str(place / "finely")),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 9, done.stderr


@pytest.mark.long
@pytest.mark.parametrize("die_after", [0, 60, 150])
def test_killed_between_rename_and_journal_line(whole, tmp_path, die_after):
    place, _ = whole
    run_until(place, tmp_path / "a", die_after)
    assert command("run", place / "small.toml", "--archive", tmp_path / "a", "--quiet").returncode == 0
    assert_same_archives(tmp_path / "a", place / "whole")


@pytest.mark.long
@pytest.mark.parametrize("die_after", [0, 40])
def test_killed_with_another_parameter_and_put_back(whole, tmp_path, die_after):
    """Chunks of the other parameter stand in their places, and no journal line says so."""
    place, _ = whole
    archive = tmp_path / "a"
    assert command("run", place / "small.toml", "--archive", archive, "--quiet").returncode == 0
    run_until(place, archive, die_after, "--set", "camera.focal_length=8 mm", "--scheduler", "serial")
    # Whoever looks at the broken archive sees no cell called done that the other parameter has touched.
    with xarray.open_datatree(archive / "data.zarr", engine="zarr", chunks=None, consolidated=False) as tree:
        assert (tree["diffraction/status"].values == 4).all()
        assert (tree["sharpen/32x32/status"].values == 4).all()
        assert (tree["scene/status"].values <= 1).all()
    done = command("run", place / "small.toml", "--archive", archive, "--json")
    assert done.returncode == 0, done.stderr
    assert_same_archives(archive, place / "whole")


@pytest.mark.parametrize(
    ("sent", "code"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.long)]
)
@pytest.mark.parametrize(
    "scheduler", ["threads", *(pytest.param(name, marks=pytest.mark.long) for name in ("serial", "processes"))]
)
def test_an_interrupted_run_ends_in_order_and_can_be_looked_at_and_resumed(whole, tmp_path, sent, code, scheduler):
    place, _ = whole
    archive = tmp_path / "a"
    process = start(
        "run",
        place / "small.toml",
        "--archive",
        archive,
        "--quiet",
        "--scheduler",
        scheduler,
        PYTHONPATH=str(place / "slowly"),
    )
    wait_for(lambda: done_cells(archive) > 5, process)
    process.send_signal(sent)
    _, said = process.communicate(timeout=60)
    assert process.returncode == code, said
    assert "archive is intact" in said
    with xarray.open_datatree(archive / "data.zarr", engine="zarr", chunks=None) as tree:
        status = tree["ledger/status"].values.tolist()
        assert 5 < sum(s in ("done", "left_out") for s in status) < len(status)
        groups = [node for node in tree.subtree if "status" in node and node.path != "/ledger"]
        assert sum((node["status"].values <= 1).sum() for node in groups) == sum(
            s in ("done", "left_out") for s in status
        )
    done = command("run", place / "small.toml", "--archive", archive, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["reused"] > 0
    assert_same_archives(archive, place / "whole")


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as handle:
            return handle.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not os.path.exists("/proc/self/task"), reason="needs /proc to find the workers")
def test_worker_processes_end_when_their_owner_is_killed(whole, tmp_path):
    place, _ = whole
    process = start(
        "run",
        place / "small.toml",
        "--archive",
        tmp_path / "a",
        "--quiet",
        "--scheduler",
        "processes",
        "--workers",
        2,
        PYTHONPATH=str(place / "slowly"),
    )
    wait_for(lambda: done_cells(tmp_path / "a") > 5, process)
    children = [
        pid for task in Path(f"/proc/{process.pid}/task").glob("*/children") for pid in task.read_text().split()
    ]
    assert len(children) >= 2
    process.kill()
    process.wait()
    process.stderr.close()
    wait_for(lambda: not any(alive(pid) for pid in children), seconds=20)

"""A copy taken in the middle of a run, file by file: what it lacks is computed, and what it has is kept."""

from __future__ import annotations

import json
import shutil

import pytest

from etendue.archive.checks.verify import verify
from etendue.session import Options, execute
from tests.archive.tiny import store_of, tiny_plan

SERIAL = Options("serial")


@pytest.fixture
def copied(whole, tmp_path):
    """As ``cp -r`` leaves it that has passed the shards before they were put in their places, and the journal behind
    that.
    """
    shutil.copytree(whole, tmp_path / "a")
    archive = tmp_path / "a"
    (archive / "manifest.json").unlink()
    lines = [json.loads(line) for line in (archive / "journal.jsonl").read_bytes().splitlines()]
    for line in (line for line in lines if line["event"] == "shard" and line["kept"]):
        shard = archive / line["path"]
        data = shard.read_bytes()
        shard.unlink()
        for part, start, to, length in line["kept"]:
            place = shard.with_name(f".{shard.name}.{part}.part")
            place.write_bytes(
                (place.read_bytes() if place.exists() else b"").ljust(start, b"\0")[:start] + data[to : to + length]
            )
    with (archive / "journal.jsonl").open("w") as file:
        file.writelines(
            json.dumps({k: v for k, v in line.items() if k != "sum"}) + "\n"
            for line in lines
            if line["event"] != "closed"
        )
    return archive


@pytest.mark.parametrize("lost", [0, 1, 3])
def test_the_first_run_in_a_copy_goes_through(copied, whole, tmp_path, lost):
    parts = sorted(copied.rglob("*.part"))
    for part in parts[:lost]:
        part.unlink()
    outcome = execute(tiny_plan(tmp_path), copied, SERIAL)
    assert not outcome.failed
    assert (outcome.computed > 0) == (lost > 0)  # what lies in parts that the journal calls shards is found there
    assert verify(copied).whole
    assert store_of(copied) == store_of(whole)

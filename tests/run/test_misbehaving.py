"""Whatever a stage does while it runs ends its own cell, named with its distribution; every other cell is as if it
had not been.
"""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray

from etendue.run import workers
from tests.cli.test_plugins import install
from tests.fresh import process
from tests.run import misbehaving
from tests.run.misbehaving import DIES, FAILS, FINE, WHOLE
from tests.run.small import command, environment

PIPELINE = """
name = "file"
precision = "float32"
[[stages]]
use = "lamp"
[[stages]]
use = "naughty"
[[stages]]
use = "witness"
"""
SHAPES = {
    "gives nothing": "NoneType",
    "gives an array": "ndarray",
    "gives too little": "declares ['irradiance']",
    "gives too many": "'7'",
}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    place = tmp_path_factory.mktemp("misbehaving")
    install(place / "site", "naughty-light", "naughty_light", Path(misbehaving.__file__).read_text())
    (place / "file.toml").write_text(PIPELINE)
    return place


def run(place, ways, *arguments):
    sweep = "naughty.how=[" + ",".join(json.dumps(way) for way in ways) + "]"
    return process(
        "run",
        "file.toml",
        "--sweep",
        sweep,
        "--json",
        *arguments,
        cwd=place,
        env=environment(PYTHONPATH=str(place / "site")),
    )


def check(place, done, archive, fails, fine):
    """Exit code 3, each failure told with stage and distribution, each other cell with its own values."""
    assert done.returncode == (3 if fails else 0), done.stderr
    assert "Traceback" not in done.stderr
    assert "resource_tracker" not in done.stderr
    assert len(done.stderr.splitlines()) < 20, done.stderr
    document = json.loads(done.stdout)  # whatever plugins print
    told = {failure["cell"][1]["naughty_how"]: failure for failure in document["failures"]}
    assert set(told) == set(fails)
    for how, words in fails.items():
        message = told[how]["message"]
        assert words in message, how
        assert told[how]["cell"][0] == "naughty"
        assert told[how]["by"] == "naughty of naughty-light 1.0"
        assert f"naughty.how={how}" in told[how]["again"]
        assert len(message.splitlines()) <= 24 and len(message) < 12_000, how
        assert all(c == "\n" or c.isprintable() for c in message), how
        assert str(place) not in message and sys.prefix not in message, how
    with xarray.open_datatree(place / archive / "data.zarr", engine="zarr", chunks=None) as tree:
        given = tree["lamp/irradiance"].values
        assert np.isfinite(given).all()
        for how in fine:
            assert tree["naughty/irradiance"].sel(naughty_how=how).values.tobytes() == given.tobytes(), how
            assert tree["witness/seen_light"].sel(naughty_how=how).values.tobytes() == (2 * given).tobytes(), how
        for how in fails:
            assert tree["naughty/status"].sel(naughty_how=how).values == 2
            assert tree["witness/status"].sel(naughty_how=how).values == 3
    assert not list((place / archive).rglob("*.partial"))
    assert all(path.stat().st_mode & 0o600 == 0o600 for path in (place / archive).rglob("*"))


@pytest.mark.parametrize("scheduler", [pytest.param("serial", marks=pytest.mark.long), "threads", "processes"])
def test_a_stage_that_breaks_off_ends_its_cell_alone(place, scheduler):
    fails = {**{how: words for how, (_, words) in FAILS.items()}, **SHAPES}
    assert set(SHAPES) == set(WHOLE)
    done = run(place, [*fails, *FINE], "--scheduler", scheduler, "--workers", "2", "--archive", scheduler)
    check(place, done, scheduler, fails, FINE)


@pytest.mark.long
def test_a_worker_that_dies_or_hangs_ends_the_cell_at_which_it_was_alone(place):
    """In one batch with cells that behave: these are computed all the same, and again nothing but the guilty ones
    fails.
    """
    fine = ["behaves", "gives its input", "gives lists"]
    ways = [fine[0], "leaves below Python", "crashes", fine[1], "is killed", "hangs", fine[2]]
    done = run(place, ways, "--scheduler", "processes", "--workers", "2", "--archive", "dies", "--cell-timeout", "2")
    check(place, done, "dies", {how: words for how, (_, words) in DIES.items()}, fine)


def test_a_time_limit_without_a_process_that_could_be_stopped_is_refused(place):
    done = run(place, ["behaves"], "--cell-timeout", "2", "--archive", "limited")
    assert done.returncode == 2
    assert "--scheduler processes" in json.loads(done.stdout)["faults"][0]["message"]
    assert not (place / "limited").exists()


def test_results_are_all_that_stands_on_stdout(place):
    done = command(
        "run",
        place / "file.toml",
        "--set",
        "naughty.how=chatters",
        "--archive",
        place / "said",
        PYTHONPATH=str(place / "site"),
    )
    assert done.returncode == 0, done.stderr
    assert "from" not in done.stdout
    for text in ("from a plugin", "from below a plugin", "from C"):
        assert text in done.stderr
    assert done.stderr.count("nobody's business") == 1  # one line, as a note
    assert str(place) not in done.stderr


def test_a_worker_whose_owner_is_gone_ends_without_a_word(monkeypatch):
    """The owner was killed while a batch was under way: there is nobody to whom it could be told."""

    class Ended(BaseException):
        pass

    class Closed:
        def recv_bytes(self):
            return pickle.dumps(((), (), (), frozenset(), {}, ()))

        def send_bytes(self, data):
            raise BrokenPipeError

    def leave(code):
        raise Ended(code)

    monkeypatch.setattr(workers, "begin_worker", lambda: None)
    monkeypatch.setattr(workers, "end_now", leave)
    with pytest.raises(Ended, match="1"):
        workers.serve(Closed())

"""Code of other distributions at work: what it changes of the process is put back, what it is given is its own, it ends
nothing else.

``tests/run/test_misbehaving.py`` has the same of whole runs.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import subprocess
import sys
import threading
import warnings
from contextlib import ExitStack

import numpy as np
import pytest

from etendue.compute.ownership import handed
from etendue.compute.tables import PatternRandom
from etendue.contract.arrays.grid import Grid, Line
from etendue.plugins.guests import Guest, ordinary
from etendue.process import NOT_COLLECTING, StateBefore
from etendue_camera.mosaic.stages.demosaic import DemosaicBilinear
from tests.cli.test_plugins import MODULE, install
from tests.run.small import environment

LIBRARY = ctypes.CDLL(None)
UPWARD = {"x86_64": 0x800, "aarch64": 0x400000}.get(os.uname().machine)
CHANGES = {
    "the umask to 077": lambda: os.umask(0o077),
    "the recursion limit to 4321": lambda: sys.setrecursionlimit(4321),
    "the floating-point rounding mode": lambda: LIBRARY.fesetround(UPWARD),
}


def state():
    umask = os.umask(0)
    os.umask(umask)
    return umask, sys.getrecursionlimit(), LIBRARY.fegetround(), os._exit


@pytest.mark.parametrize("what", CHANGES)
@pytest.mark.skipif(UPWARD is None or not hasattr(LIBRARY, "fesetround"), reason="other names of ways to round")
def test_what_a_guest_has_set_is_put_back_and_said_by_its_name(what):
    before = state()
    with pytest.warns(RuntimeWarning, match=f"guest {what} changed {what}; restored"), Guest(f"guest {what}"):
        CHANGES[what]()
    assert state() == before


@pytest.mark.skipif(os.uname().machine != "x86_64", reason="a register of another processor")
def test_numbers_below_the_smallest_normal_one_are_there_again():
    """A library that was compiled for speed takes them away from whoever loads it."""
    environment_of_numbers = (ctypes.c_byte * 64)()
    LIBRARY.fegetenv(environment_of_numbers)
    kept = bytes(environment_of_numbers)
    control = int.from_bytes(kept[28:32], "little") | 0x8040
    flushing = (ctypes.c_byte * 64).from_buffer_copy(kept[:28] + control.to_bytes(4, "little") + kept[32:])
    seen = []

    def fast():
        with Guest("fast"):
            LIBRARY.fesetenv(flushing)
            seen.append(ordinary())

    with pytest.warns(RuntimeWarning, match="the floating-point rounding mode"):
        fast()
    assert seen == [False]
    assert ordinary() and np.nextafter(np.float32(0), np.float32(1)) * np.float32(1) > 0


def test_guests_at_once_put_back_what_stood_before_all_of_them():
    before, changed, last = state(), threading.Event(), threading.Event()

    def first():
        with warnings.catch_warnings(action="ignore"), Guest("first"):
            os.umask(0o077)
            changed.set()
            last.wait(10)

    thread = threading.Thread(target=first)
    thread.start()
    changed.wait(10)
    with warnings.catch_warnings(action="ignore"), Guest("second"):
        pass
    last.set()
    thread.join()
    assert state() == before


def test_one_that_sets_nothing_is_not_spoken_of():
    with warnings.catch_warnings(action="error"), Guest("quiet"), Guest("quiet"):
        pass


def test_the_end_of_the_process_is_that_of_the_guest_alone():
    real = os._exit
    with Guest("leaves"), pytest.raises(SystemExit, match=r"os._exit\(3\)"):
        os._exit(3)
    assert os._exit is real


def test_a_guest_is_handed_arrays_of_its_own_and_the_engine_what_there_is():
    class Foreign(DemosaicBilinear):
        __module__ = "foreign"

    array = np.arange(6.0)
    array.flags.writeable = False
    given = {"raw": array, "seen": [("adc", array)], "words": frozenset()}
    assert handed(DemosaicBilinear(), given) is given
    own = handed(Foreign(), given)
    for one in (own["raw"], own["seen"][0][1]):
        assert np.array_equal(one, array) and not np.shares_memory(one, array)
        with pytest.raises(ValueError, match="WRITEABLE|writeable"):
            one.flags.writeable = True
    grid = Grid.of({"y": Line(4), "x": Line(4)})
    whole = PatternRandom(b"1", grid, "float32").normal("prnu")
    apart = handed(Foreign(), {"rng_sensor": PatternRandom(b"1", grid, "float32")})["rng_sensor"].normal("prnu")
    assert np.array_equal(whole, apart) and not np.shares_memory(whole, apart)


BESIDE = """
import atexit, os, sys, threading, time
from etendue.api import hookimpl
{}

@hookimpl
def etendue_stages():
    return {{}}
"""
IMPORTED = {  # what a distribution does when it is imported, of which nobody uses anything -> what is said
    "hidden": (
        "os.umask(0o777); sys.setrecursionlimit(87_654)",
        "hidden 1.0, when it was imported, changed the umask to 777",
    ),
    "leaving": ("os._exit(0)", ""),
    "forking": ("os.fork()", "a process that forking 1.0, when it was imported, had forked returned from it"),
    "late": (
        "threading.Timer(0.05, os._exit, (0,)).start(); atexit.register(os._exit, 0)",
        "a plugin called os._exit(0) in a thread",
    ),
}


def test_distributions_that_are_only_installed_end_nothing_and_leave_files_that_can_be_read(tmp_path):
    for name, (does, _) in IMPORTED.items():
        install(tmp_path / "site", name, name, BESIDE.format(does))
    install(
        tmp_path / "site",
        "twice-light",
        "twice_light",
        MODULE.replace("Stage\n", "Stage, hookimpl\n", 1)
        + "\n@hookimpl\ndef etendue_stages():\n    return {'twice': Twice}\n",
    )
    (tmp_path / "file.toml").write_text(
        '[[stages]]\nuse = "uniform"\nwhite_luminance = "1000 cd m-2"\nwidth = "8 um"\nheight = "8 um"\nbin_width = '
        '"100 nm"\n'
        '[[stages]]\nuse = "irradiance"\n[[stages]]\nuse = "twice"\n'
    )
    done = subprocess.run(
        [sys.executable, "-m", "etendue", "run", "file.toml", "--archive", "a", "--json"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env=environment(PYTHONPATH=str(tmp_path / "site")),
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)
    for _, said in IMPORTED.values():
        assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert all(path.stat().st_mode & 0o600 == 0o600 for path in (tmp_path / "a").rglob("*"))
    stages = subprocess.run(
        [sys.executable, "-m", "etendue", "stages"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env=environment(PYTHONPATH=str(tmp_path / "site")),
        timeout=120,
        check=False,
    )
    assert stages.returncode == 0 and "twice" in stages.stdout
    assert "leaving 1.0 cannot be read: its manifest leaving: SystemExit: os._exit(0)" in stages.stdout + stages.stderr


def test_who_begins_while_another_ends_takes_nothing_of_what_it_left_for_what_stood_before():
    """Slowly: the folder is being put back while somebody else begins."""
    stands, begun = ["before"], threading.Event()
    state = StateBefore(lambda: stands[0])
    who, before = state.begin()
    stands[0] = "left behind"
    seen = []

    def begins():
        begun.set()
        seen.append(state.begin()[1])

    def slowly():
        thread.start()
        begun.wait(10)
        thread.join(0.2)
        stands[0] = before

    thread = threading.Thread(target=begins)
    state.end(who, slowly)
    thread.join(10)
    assert seen == ["before"]


def test_the_collector_pauses_until_the_last_plan_is_made():
    """A second thread that began meanwhile would otherwise have found it paused, and left it so."""
    first, second = ExitStack(), ExitStack()
    first.enter_context(NOT_COLLECTING)
    second.enter_context(NOT_COLLECTING)
    first.close()
    assert not gc.isenabled()
    second.close()
    assert gc.isenabled()


def test_a_collector_that_is_switched_off_stays_so():
    gc.disable()
    try:
        with NOT_COLLECTING:
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()

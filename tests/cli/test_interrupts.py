"""Signals before, during and behind a run: one line, the right code, nothing left behind. Few of the instants that
the benchmark tries.
"""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from etendue import interrupts
from etendue.cli import main
from etendue.errors import ArchiveInUse
from tests.run.small import environment

HERE = Path(__file__).parent.parent.parent

SLOW_IMPORTS = """
import importlib.abc, sys, time

class Slowly(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name in {names!r}:
            print("importing", name, file=sys.stderr, flush=True)
            time.sleep(30)

sys.meta_path.insert(0, Slowly())
"""


@pytest.mark.long
def test_a_signal_while_anything_is_imported_is_answered_in_one_line(tmp_path):
    """The first heavy import, that of numpy, and that of what runs the batches: each is stopped in its middle."""
    for number, (name, sent) in enumerate(
        (("click", signal.SIGINT), ("numpy", signal.SIGTERM), ("dask", signal.SIGINT))
    ):
        place = tmp_path / str(number)
        place.mkdir()
        (place / "sitecustomize.py").write_text(SLOW_IMPORTS.format(names=(name,)))
        process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "etendue",
                "run",
                str(HERE / "pipelines" / "smallest.toml"),
                "--archive",
                str(place / "a"),
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment(PYTHONPATH=str(place)),
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )
        for line in process.stderr:
            if line == f"importing {name}\n":
                break
        process.send_signal(sent)
        out, said = process.communicate(timeout=20)
        assert process.returncode == 128 + sent, name
        assert said.startswith("interrupted") and len(said.splitlines()) == 1, said
        assert out == ""


@pytest.mark.long
@pytest.mark.skipif(not os.path.exists("/proc/self/task"), reason="needs /proc")
def test_a_run_interrupted_at_some_instants_leaves_nothing_and_is_mended(tmp_path):
    """The driver of the benchmark, once; the signal comes twice, as of an impatient hand."""
    spec = importlib.util.spec_from_file_location("signals_driver", HERE / "benchmarks" / "faults" / "signals.py")
    driver = importlib.util.module_from_spec(spec)
    sys.modules["signals_driver"] = driver
    spec.loader.exec_module(driver)
    (tmp_path / "lamp.toml").write_text(
        '[[stages]]\nuse = "uniform"\nwhite_luminance = "1000 cd m-2"\nwidth = "8 um"\nheight = "8 um"\nbin_width = '
        '"100 nm"\n'
        '[[stages]]\nuse = "irradiance"\n'
    )
    for ended in driver.measure(tmp_path / "lamp.toml", 1, "threads", 5, 1, tmp_path):
        assert ended.kind != "raw", ended
        assert not ended.left and ended.mended, ended


@pytest.mark.long
def test_a_stage_that_hangs_in_a_thread_does_not_hold_ctrl_c_up(tmp_path):
    from tests.cli.test_plugins import MODULE, install_twice

    source = "import time\n" + MODULE.replace(
        'return {"irr', "print('asleep', flush=True); time.sleep(600); return {\"irr"
    )
    install_twice(tmp_path / "site", source)
    (tmp_path / "file.toml").write_text(
        'name = "a"\n[[stages]]\nuse = "uniform"\nwhite_luminance = "1000 cd m-2"\nwidth = "8 um"\nheight = "8 '
        'um"\nbin_width = "100 nm"\n'
        '[[stages]]\nuse = "irradiance"\n[[stages]]\nuse = "twice"\n'
    )
    process = subprocess.Popen(
        [sys.executable, "-m", "etendue", "run", "file.toml", "--quiet"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(PYTHONPATH=str(tmp_path / "site")),
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stderr.readline() == "asleep\n"
    process.send_signal(signal.SIGINT)
    out, said = process.communicate(timeout=60)  # a tenth of what the stage sleeps
    assert (process.returncode, out, said) == (130, "", interrupts.INTACT + "\n")
    assert (tmp_path / "a" / "run.id").read_text() == "abandoned"  # what still sleeps in the stage could write no more


def test_in_a_process_of_somebody_else_ctrl_c_is_held_and_given_back():
    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        reached = []

        def body():
            with interrupts.held():
                os.kill(os.getpid(), signal.SIGINT)
                reached.append(True)

        with pytest.raises(interrupts.Interrupted) as caught:
            body()
        assert reached and caught.value.exit_code == 130
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        with interrupts.held():
            interrupts.check()  # the one before is over
    finally:
        signal.signal(signal.SIGINT, before)


def test_whose_keyboard_interrupt_it_is():
    found = []
    thread = threading.Thread(target=lambda: found.append(interrupts.is_ours(KeyboardInterrupt())))
    thread.start()
    thread.join()
    assert found == [False]  # no signal reaches a thread beside the main one
    assert interrupts.is_ours(interrupts.Interrupted(2))
    assert not interrupts.is_ours(SystemExit(0)) and not interrupts.is_ours(ArchiveInUse("x"))


@pytest.mark.parametrize(("number", "code"), [(0, 1), (signal.SIGTERM, 143)])
def test_an_error_that_follows_a_signal_is_told_as_the_signal(monkeypatch, number, code):
    def end(code):
        raise SystemExit(code)

    monkeypatch.setattr(interrupts._SignalState, "noted", number)
    monkeypatch.setattr(interrupts, "end_now", end)
    failing = click.Command("show", callback=lambda: {}[4])
    monkeypatch.setattr(type(main), "get_command", lambda self, ctx, name: failing)
    assert CliRunner().invoke(main, ["show"]).exit_code == code

"""The engine without a camera: built without it, installed with a small domain, and all that a run has done to it."""

import json
import re
import time

import pytest

from tests.alone.apart import DOMAIN, Apart
from tests.architecture.test_words_of_a_camera import WORDS

BEAM, BEAMS = DOMAIN / "pipelines" / "beam.toml", DOMAIN / "pipelines" / "beams.toml"
CELLS = 90
STILL = {"plot"}  # commands whose help has words of a camera; may only become fewer
COMMANDS = {
    "run",
    "plan",
    "rerun",
    "stages",
    "quantities",
    "show",
    "report",
    "view",
    "plot",
    "verify",
    "reproduce",
    "diff",
    "compact",
    "accuracy",
    "new",
    "new-plugin",
    "schema",
}
PYTEST = (
    "-m",
    "pytest",
    "-q",
    "-c",
    "/dev/null",
    "-p",
    "no:cacheprovider",
    "--import-mode=importlib",
)  # not as the repository asks for
IMPORTS = """
import importlib, pkgutil, sys, etendue

names = [one.name for one in pkgutil.walk_packages(etendue.__path__, "etendue.") if not one.name.endswith("__main__")]
for name in names:
    importlib.import_module(name)
found = [name for name in sys.modules if name.startswith(("etendue_camera", "etendue_lab"))]
assert not found, found
print(len(names))
"""
SLOWLY = """
import time
from etendue import session

whole = session.partition
session.partition = lambda jobs, seconds: whole(jobs, 0.0)  # a batch, and so a journal line, for every cell
from etendue_array import kernels

taper = kernels.taper

def slow(*arguments):
    time.sleep(0.2)
    return taper(*arguments)

kernels.taper = slow
"""


@pytest.fixture(scope="module")
def apart(tmp_path_factory):
    return Apart(tmp_path_factory.mktemp("apart"))


@pytest.fixture(scope="module")
def swept(apart):
    """The archive of the sweep, computed on threads."""
    apart.etendue("run", BEAMS, "--archive", "threads", "--scheduler", "threads", "--workers", 2, "--quiet")
    return apart.place / "threads"


@pytest.mark.long
def test_every_module_of_the_engine_can_be_imported_without_the_others(apart):
    assert int(apart.run("-c", IMPORTS)) > 250


@pytest.mark.long
def test_commands_are_those_of_the_engine_alone(apart):
    listed = re.findall(
        r"^  ([a-z][\w-]*)(?: [A-Z\[-].*)?  ", apart.etendue("--help").partition("Commands:")[2], flags=re.M
    )
    assert set(listed) == COMMANDS
    stages = {one["name"] for one in json.loads(apart.etendue("stages", "--json"))}
    assert stages == {"plane_wave", "second_wave", "microphone_noise", "phasors", "delay_and_sum", "beam_figures"}
    spoken = {name for name in COMMANDS if WORDS.search(apart.etendue(name, "--help"))}
    assert spoken <= STILL


@pytest.mark.long
def test_a_sweep_is_planned_and_run_by_threads_processes_and_a_cluster_to_the_same_bits(apart, swept):
    planned = json.loads(apart.etendue("plan", BEAMS, "--json"))
    assert sum(stage["cells"] for stage in planned["stages"]) == CELLS
    for scheduler in ("processes", "distributed"):
        apart.etendue("run", BEAMS, "--archive", scheduler, "--scheduler", scheduler, "--workers", 2, "--quiet")
        assert "threads and " + scheduler + ": equal" in apart.etendue("diff", "threads", scheduler)


@pytest.mark.long
def test_a_run_that_is_killed_goes_on_where_it_was(apart, swept):
    slow = apart.place / "slow"
    slow.mkdir()
    (slow / "sitecustomize.py").write_text(SLOWLY)
    journal = apart.place / "killed" / "journal.jsonl"
    process = apart.started("run", BEAMS, "--archive", "killed", "--scheduler", "serial", PYTHONPATH=str(slow))
    began = time.monotonic()
    while process.poll() is None and not (journal.exists() and journal.read_text().count('"event":"done"') > 20):
        if time.monotonic() - began > 300:
            pytest.fail("nothing was finished in five minutes")
        time.sleep(0.02)
    process.kill()
    assert process.wait() == -9
    done = json.loads(apart.etendue("run", BEAMS, "--archive", "killed", "--json"))
    assert 0 < done["computed"] < CELLS
    assert "threads and killed: equal" in apart.etendue("diff", "threads", "killed")


@pytest.mark.long
def test_an_archive_is_shown_checked_computed_again_drawn_and_reported(apart, swept):
    assert "15 done" in apart.etendue("show", swept)
    assert "whole" in apart.etendue("verify", swept)
    assert "the same bits" in " ".join(
        apart.etendue("reproduce", swept).split()
    )  # lines are as long as the folder's name allows
    drawn = (("map", "beam_width"), ("curves", "beam_width"), ("pareto", "beam_width", "white_noise_gain"), ("budget",))
    for kind, *variables in drawn:
        apart.etendue("plot", swept, kind, *variables, "-o", f"{kind}.png")
        assert (apart.place / f"{kind}.png").read_bytes()[:4] == b"\x89PNG"
    apart.etendue("report", swept, "-o", "report.html")
    assert "beam_width" in (apart.place / "report.html").read_text()
    apart.etendue("compact", swept, "compacted")
    assert "threads and compacted: equal" in apart.etendue("diff", swept, "compacted")
    assert "0 cells computed, 90 reused" in apart.etendue("rerun", swept, "--quiet")


@pytest.mark.long
def test_what_one_begins_with_runs(apart):
    apart.etendue("new", "mine")
    assert "6 cells computed" in apart.etendue("run", "mine.toml", "--quiet")
    apart.etendue("new-plugin", "etendue-my-noise", "--role", "self noise")
    begun = apart.place / "etendue-my-noise"
    assert " passed" in apart.run(*PYTEST, begun / "tests", PYTHONPATH=str(begun / "src"))


@pytest.mark.long
def test_the_domain_keeps_its_own_laws_there(apart):
    """Closed forms and the conformance kit, in the environment without a camera."""
    assert " passed" in apart.run(*PYTEST, DOMAIN / "tests")

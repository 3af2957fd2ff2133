"""Laws are tried on the same examples in every run, so that a change is judged by what it changes.

HYPOTHESIS_PROFILE=explore tries new ones.
"""

import gc
import inspect
import os
import tempfile
from functools import partialmethod
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

os.environ.setdefault(
    "ETENDUE_CACHE", str(Path(tempfile.gettempdir()) / f"etendue-tests-{os.getuid()}")
)  # not the user's own

MEMORY, ROOM = Path("/dev/shm"), 8 << 30  # tests leave 3 GB at most


def has_room(folder: Path) -> bool:
    """Whether files of tests fit into this folder of the main memory, and programs can be started there."""
    try:
        place, told = os.statvfs(folder), Path("/proc/meminfo").read_text()
    except (AttributeError, OSError):
        return False
    free = 1024 * int(told.partition("MemAvailable:")[2].split()[0])
    usable = os.access(folder, os.W_OK) and not place.f_flag & os.ST_NOEXEC
    return usable and min(place.f_bavail * place.f_frsize, free) > ROOM


if has_room(MEMORY):  # archives wait for their disk at every step: where others write too, most of the time
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))

if (
    "mix_stderr" in inspect.signature(CliRunner).parameters
):  # before click 8.2; as later: stderr apart, output both of them
    CliRunner.__init__ = partialmethod(CliRunner.__init__, mix_stderr=False)
    Result.output = property(lambda result: result.stdout + result.stderr)

gc.disable()  # until all tests are made: what is made of them stays


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """Leave 12,000 tests and all modules out of every later collection, which took 0.3 s with them."""
    gc.collect()
    gc.freeze()
    gc.enable()


def pytest_pycollect_makeitem(collector: pytest.Module, obj: object) -> list[pytest.Item] | None:
    """Make no test of a class of long ones where none runs: each worker makes 8,000 of 25,000 for nothing."""
    long = any(mark.name == "long" for mark in getattr(obj, "pytestmark", ())) if inspect.isclass(obj) else False
    return [] if long and "not long" in collector.config.getoption("markexpr") else None


@pytest.fixture(autouse=True, scope="session")
def _nothing_remembered() -> None:
    """Every call of ``simulate`` computes: laws compare runs, not a run with its own memory."""
    from etendue.evaluation.remembering import MEMORY

    MEMORY.clear(0)

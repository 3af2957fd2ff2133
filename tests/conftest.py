"""Laws are tried on the same examples in every run, so that a change is judged by what it changes.

HYPOTHESIS_PROFILE=explore tries new ones.
"""

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

if (
    "mix_stderr" in inspect.signature(CliRunner).parameters
):  # before click 8.2; as later: stderr apart, output both of them
    CliRunner.__init__ = partialmethod(CliRunner.__init__, mix_stderr=False)
    Result.output = property(lambda result: result.stdout + result.stderr)


def pytest_pycollect_makeitem(collector: pytest.Module, obj: object) -> list[pytest.Item] | None:
    """Make no test of a class of long ones where none runs: each worker makes 8,000 of 25,000 for nothing."""
    long = any(mark.name == "long" for mark in getattr(obj, "pytestmark", ())) if inspect.isclass(obj) else False
    return [] if long and "not long" in collector.config.getoption("markexpr") else None


@pytest.fixture(autouse=True, scope="session")
def _nothing_remembered() -> None:
    """Every call of ``simulate`` computes: laws compare runs, not a run with its own memory."""
    from etendue.evaluation.remembering import MEMORY

    MEMORY.clear(0)

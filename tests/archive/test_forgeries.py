"""An archive that says something else, with every digest computed anew, is named by reproduce; what it cannot tell,
it lists.
"""

from __future__ import annotations

import importlib.util
import shutil
import sys
from pathlib import Path

import pytest

from etendue.archive.checks.verify import sha256_of
from etendue.session import Options, execute
from etendue.trust.comparing import NOT_CHECKED
from etendue.trust.reproducing import reproduce
from tests.archive.tiny import tiny_plan

ROOT = Path(__file__).parents[2]
FAULTS = ROOT / "benchmarks" / "faults"
SERIAL = Options("serial")
FEW = (  # of every way of comparing some
    "a coordinate reversed",
    "dims swapped",
    "a byte order",
    "a status",
    "an error in the ledger",
    "a parameter in the record",
    "a comment in the pipeline to be run",
    "an extra attribute",
    "an extra array",
    "a missing coordinate",
    "bytes in the summary",
    "a picture",
    "a key in the journal",
    "a number of a cell",
    "an axis value throughout",
    "a digest of code",
    "a source",
    "overrides",
    "an extra field",
    "the digest of an input",
    "a number in an outdated cell",
    "a group in the journal",
    "attributes of Zarr 2",
    "a duplicate seed",
    "a missing description",
)


@pytest.fixture(scope="module")
def driver():
    sys.path.insert(0, str(FAULTS))
    try:
        found = importlib.util.spec_from_file_location("forgeries", FAULTS / "forgeries.py")
        module = sys.modules["forgeries"] = importlib.util.module_from_spec(found)
        found.loader.exec_module(module)
        yield module
    finally:
        sys.path.remove(str(FAULTS))
        for name in ("forgeries", "forgery_kinds", "forgery_words", "hostile_kinds"):
            sys.modules.pop(name, None)


@pytest.fixture(scope="module")
def sound(driver, tmp_path_factory):
    return driver.sound_archive(tmp_path_factory.mktemp("sound") / "a")


@pytest.mark.parametrize("kind", FEW)
def test_a_consistent_forgery_is_named(driver, sound, tmp_path, kind):
    found = driver.tried(sound, kind, driver.FORGERIES[kind], tmp_path / "forged")
    assert not found.wrong


@pytest.mark.parametrize("kind", ["when a run began", "a drawing", "an author"])
def test_what_no_computing_can_tell_is_listed(driver, sound, tmp_path, kind):
    assert not driver.tried(sound, kind, driver.SAID[kind][0], tmp_path / "forged", driver.SAID[kind][1]).wrong


def test_what_was_not_forged_is_sound_and_digests_tell_the_copy_from_the_forgery(driver, sound, tmp_path):
    assert not driver.tried(sound, "nothing", driver.sealed, tmp_path / "sealed").wrong
    shutil.copytree(sound, tmp_path / "copy")
    assert sha256_of(tmp_path / "copy") == sha256_of(sound)
    driver.SAID["seconds, consistently"][0](tmp_path / "copy")
    assert sha256_of(tmp_path / "copy") != sha256_of(sound)


def test_archives_of_many_runs_are_reproduced(tmp_path):
    """Grown, of other parameters over values that are there no more, and with less kept than there is."""
    runs = (
        {"sweep.f_number": [4]},
        {"sweep.f_number": [2, 4]},
        {"sweep.f_number": [2], "camera.peak_qe": [0.3, 0.4, 0.4]},
        {"sweep.f_number": [2], "camera.peak_qe": [0.3, 0.4, 0.4], "keep": ["photon_rate"]},
    )
    for number, overrides in enumerate(runs):
        execute(tiny_plan(tmp_path, overrides), tmp_path / "a", SERIAL)
        if number % 2:
            found = reproduce(tmp_path / "a", SERIAL)
            assert (found.differences, found.damages, found.verdict) == ([], [], "the same bits")
    assert any("does not hold" in one.what for one in found.not_checked)


def test_the_page_lists_what_is_not_checked():
    text = (ROOT / "docs" / "trust.md").read_text()
    assert all(f"| {one.what} |" in text for one in NOT_CHECKED)


@pytest.mark.long
def test_every_consistent_forgery_is_named_or_listed(driver):
    assert [one for one in driver.every() if one.wrong] == []

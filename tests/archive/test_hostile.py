"""Archives and files made to do harm: nothing outside is opened on their word, nothing waits, what is said is short.

The kinds are those of ``benchmarks/faults/hostile.py``, which also counts memory and time, and watches from outside.
"""

import importlib.util
import shutil
import sys
from collections import Counter
from pathlib import Path

import pytest
from click.testing import CliRunner

from etendue.cli import main

HERE = Path(__file__).parents[2] / "benchmarks" / "faults" / "hostile_kinds.py"


def _kinds():
    spec = importlib.util.spec_from_file_location("hostile_kinds", HERE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def some(kinds, most=2):
    """Kinds as parameters: of a family, which begin with one word, so many by default; all of them are long laws."""
    seen = Counter()
    for kind in kinds:
        family = kind.split()[0]
        seen[family] += 1
        yield kind if seen[family] <= most else pytest.param(kind, marks=pytest.mark.long)


KINDS = _kinds()
OPENED, WATCHING = [], []


def _watch(event, arguments):
    if WATCHING and event == "open" and isinstance(arguments[0], str | bytes):
        OPENED.append(arguments[0] if isinstance(arguments[0], str) else arguments[0].decode(errors="replace"))


sys.addaudithook(_watch)


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return KINDS.sound_archive(tmp_path_factory.mktemp("hostile") / "sound")


@pytest.fixture
def outside(tmp_path):
    folder = tmp_path / "outside"
    folder.mkdir()
    (folder / "secret.txt").write_text(KINDS.LIGHT)
    return folder


def called(words, outside):
    """A command, and what it opened below ``outside`` or of the system."""
    OPENED.clear()
    WATCHING.append(True)
    try:
        done = CliRunner().invoke(main, list(map(str, words)))
    finally:
        WATCHING.clear()
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    assert "internal error in etendue" not in done.output and len(done.stderr) < 4000
    assert not [path for path in OPENED if path.startswith((str(outside), "/etc/passwd", "/dev/zero"))]
    return done


@pytest.mark.timeout(120)
@pytest.mark.parametrize("kind", some(KINDS.ARCHIVES))
def test_an_archive_made_to_do_harm_is_verified_unharmed(kind, sound, outside, tmp_path):
    folder = shutil.copytree(sound, tmp_path / "tiny")
    KINDS.ARCHIVES[kind](folder, outside)
    called(["verify", folder], outside)


@pytest.mark.long
@pytest.mark.timeout(300)
@pytest.mark.parametrize("kind", KINDS.ARCHIVES)
def test_an_archive_made_to_do_harm_is_looked_at_unharmed(kind, sound, outside, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = shutil.copytree(sound, tmp_path / "tiny")
    KINDS.ARCHIVES[kind](folder, outside)
    for words in (
        ["show", folder],
        ["plot", folder, "--list"],
        ["report", folder],
        ["export", folder, "--tiff", "--variable", "raw"],
    ):
        called(words, outside)


LEADING_OUT = [
    kind for kind in KINDS.ARCHIVES if kind.startswith(("pipeline", "manifest names")) or kind.endswith("is a link")
]


@pytest.mark.timeout(120)
@pytest.mark.parametrize("kind", some(LEADING_OUT))
def test_no_word_of_an_archive_has_other_files_read(kind, sound, outside, tmp_path, monkeypatch):
    """Also where its pipeline is run again, and nothing from outside is copied into it."""
    monkeypatch.chdir(tmp_path)
    folder = shutil.copytree(sound, tmp_path / "tiny")
    before = {path.name for path in (folder / "inputs").iterdir()}
    KINDS.ARCHIVES[kind](folder, outside)
    for words in (["reproduce", folder], ["rerun", folder], ["plan", folder / "runs" / "0001.toml"]):
        done = called(words, outside)
        assert done.exit_code != 0 or kind.startswith("manifest") or words[0] == "plan" or kind == "input is a link", (
            done.output
        )
    if not (folder / "inputs").is_symlink():
        assert {path.name for path in (folder / "inputs").iterdir()} <= before


def test_what_an_archive_recorded_lifts_no_bound_unless_its_reader_does(sound, outside, tmp_path):
    folder = shutil.copytree(sound, tmp_path / "tiny")
    assert "more than the 5 allowed" in called(["rerun", folder, "--most-cells", "5"], outside).stderr
    KINDS.ARCHIVES["pipeline raises the cell limit"](folder, outside)
    assert "more than the 1000000 allowed" in called(["rerun", folder], outside).stderr
    assert (
        called(["rerun", folder, "--most-cells", str(10**18)], outside).exit_code == 5
    )  # and memory for it is asked for before it is taken


@pytest.mark.timeout(120)
@pytest.mark.parametrize("kind", [kind for kind in KINDS.FILES if "bomb" not in kind])
def test_a_file_made_to_do_harm_is_refused_in_words(kind, outside, tmp_path, monkeypatch):
    if "HDF5" in kind or "MATLAB" in kind:
        pytest.importorskip("h5py", reason="HDF5 is read by h5py, of the extra cubes")
    monkeypatch.chdir(tmp_path)
    make, commands = KINDS.FILES[kind]
    folder = tmp_path / "case"
    folder.mkdir()
    path = make(folder, outside)
    for command in commands:
        done = called([command, path], outside)
        assert done.exit_code in (2, 5) and done.stderr.strip(), done.output


def test_an_array_that_unfolds_is_refused_before_it_does(outside, tmp_path):
    path = KINDS.npz_bomb(tmp_path / "p.npz", 40_000_000)  # 320 MB from 311 kB
    assert "without compression" in called(["import", path], outside).stderr

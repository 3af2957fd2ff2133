"""What was made of installed code is read again as long as that code stands as it was, and never afterwards."""

import os
import sys
from importlib import import_module, invalidate_caches

import pytest

from etendue import cache
from etendue.plugins import unchanged
from tests.cli.test_plugins import MODULE, hook, install
from tests.fresh import process

CALL = """
import sys
from etendue.plugins import unchanged
unchanged.SETTLED = float("-inf")  # of files that a test, or a checkout, has just written
from etendue.cli import main
try:
    main(prog_name="etendue")
finally:
    print(*(name for name in sys.modules if ".stages." in name), file=sys.stderr)
"""


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder on the path with a package, another with a library that it imports, and a cache of its own."""
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(unchanged, "SETTLED", float("-inf"))
    site, other = tmp_path / "site", tmp_path / "other"
    (site / "film_kept" / "tables").mkdir(parents=True), other.mkdir()
    (site / "film_kept" / "__init__.py").write_text("import film_kept_library\n")
    (site / "film_kept" / "later.py").write_text("")  # which nobody has imported
    (site / "film_kept" / "tables" / "grain.csv").write_text("1\n")
    (other / "film_kept_library.py").write_text("")
    info = site / "film_kept-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Name: film_kept\nVersion: 1.0\n")
    monkeypatch.setattr(sys, "path", [*sys.path, str(site), str(other)])
    invalidate_caches()
    import_module("film_kept")
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith("film_kept")]:
        del sys.modules[name]


def edit(path, text="value = 1\n"):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


CHANGES = {
    "a module of the package": lambda at: edit(at / "site" / "film_kept" / "__init__.py"),
    "a module that was not imported": lambda at: edit(at / "site" / "film_kept" / "later.py"),
    "a new module": lambda at: edit(at / "site" / "film_kept" / "stages.py"),
    "a table of the package": lambda at: edit(at / "site" / "film_kept" / "tables" / "grain.csv", "2\n"),
    "a table that is gone": lambda at: (at / "site" / "film_kept" / "tables" / "grain.csv").unlink(),
    "a library": lambda at: edit(at / "other" / "film_kept_library.py"),
    "a library before it on the path": lambda at: edit(at / "site" / "film_kept_library.py"),
    "another version": lambda at: (at / "site" / "film_kept-1.0.dist-info").rename(
        at / "site" / "film_kept-1.1.dist-info"
    ),
    "its entry points": lambda at: edit(at / "site" / "film_kept-1.0.dist-info" / "entry_points.txt", "[etendue]\n"),
    "another distribution": lambda at: edit(at / "site" / "grain-1.0.dist-info" / "METADATA", "Name: grain\n"),
    "the path": lambda at: sys.path.append(str(at)),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_document_is_read_again_until_something_it_was_made_of_changes(place, change):
    unchanged.keep("films", {"grain": [1.5, None]}, {"film_kept"})
    edit(place / "site" / "notes.txt", "beside")  # which nothing imports
    (place / "site" / "film_kept" / "__pycache__").mkdir(exist_ok=True)
    assert unchanged.recall("films") == {"grain": [1.5, None]}
    assert unchanged.recall("papers") is None
    change(place)
    assert unchanged.recall("films") is None


def test_of_what_has_just_changed_nothing_is_kept(place, monkeypatch):
    monkeypatch.setattr(unchanged, "SETTLED", 3600.0)
    unchanged.keep("films", {}, {"film_kept"})
    assert unchanged.recall("films") is None
    past = os.stat(unchanged.__file__).st_mtime - 7200  # a copied file keeps its time, but not that of its place
    os.utime(place / "site" / "film_kept" / "later.py", (past, past))
    unchanged.keep("films", {}, {"film_kept"})
    assert unchanged.recall("films") is None


def test_what_json_cannot_hold_is_not_kept(place):
    unchanged.keep("films", {"grain": (1, 2)}, {"film_kept"})
    assert unchanged.recall("films") is None


@pytest.mark.parametrize(
    "damage", [lambda data: data[:-3], lambda data: data.replace(b"grain", b"brain"), lambda _: b""]
)
def test_a_damaged_entry_is_none(place, damage):
    unchanged.keep("films", {"grain": 1}, {"film_kept"})
    (entry,) = (cache.folder() / unchanged.KIND).iterdir()
    entry.write_bytes(damage(entry.read_bytes()))
    assert unchanged.recall("films") is None


def test_stages_are_listed_alike_whether_or_not_they_are_loaded(tmp_path):
    env = {**os.environ, "COLUMNS": "160"}
    kept, none = ({**env, "ETENDUE_CACHE": str(place)} for place in (tmp_path / "cache", os.devnull))
    assert ".stages." in process("stages", env=kept, code=CALL).stderr
    for words in ((), ("--json",), ("adc",)):
        again = process("stages", *words, env=kept, code=CALL)
        assert again.stdout == process("stages", *words, env=none).stdout
        assert ".stages." not in again.stderr
    assert len(again.stdout.splitlines()) > 5


def test_a_stage_that_is_broken_is_listed_as_it_is_now(tmp_path):
    site = tmp_path / "site"
    install(site, "twice-light", "twice_light", hook("stages", {"twice": "twice_light_stages:Twice"}))
    env = {**os.environ, "ETENDUE_CACHE": str(tmp_path / "cache"), "PYTHONPATH": str(site)}
    assert "broken: twice" in process("stages", env=env, code=CALL).stdout
    (site / "twice_light_stages.py").write_text(MODULE)
    assert "Twice the light" in process("stages", env=env, code=CALL).stdout

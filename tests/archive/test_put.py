"""Files of a store are written one after the other, and only those that differ: laws of ``disk.put``."""

from __future__ import annotations

import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from etendue.archive.read.tree import ROOT, content_first
from etendue.archive.records import disk
from etendue.errors import ArchiveError

NAME = st.sampled_from(["a", "a-b", "c", "d", "0", "zz", "é"])
FOLDER = st.lists(NAME, max_size=3).map(tuple)
FILES = {"a/c/0": b"1", f"a/{ROOT}": b"{}", "b/c/0/0": b"22", f"b/{ROOT}": b"{}", ROOT: b"{}"}


def put(folder, files):
    """Write files and return those that were there at the first call of ``change``; None if there was none."""

    def there():
        return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}

    seen = []
    disk.put(folder, sorted(files.items(), key=lambda one: content_first(one[0])), change=lambda: seen.append(there()))
    return (seen or [None])[0], there()


@given(st.lists(st.tuples(FOLDER, st.sampled_from([ROOT, "c", "0"])), unique=True))
def test_metadata_comes_after_all_below_it_and_folders_are_visited_once(files):
    paths = sorted(("/".join([*folder, name]) for folder, name in files), key=content_first)
    folders = [path.rpartition("/")[0] for path in paths]
    for number, path in enumerate(paths):
        if path.rpartition("/")[2] == ROOT:
            below = path.removesuffix(ROOT)
            assert not any(later.startswith(below) for later in paths[number + 1 :])
    assert all(folders.index(one) == number or folders[number - 1] == one for number, one in enumerate(folders))


def test_what_is_there_already_stays(tmp_path):
    assert put(tmp_path, FILES) == ({}, FILES)
    before = {path: os.stat(tmp_path / path) for path in FILES}
    assert put(tmp_path, FILES) == (None, FILES)
    assert put(tmp_path, {**FILES, "b/c/0/0": b"23"}) == (FILES, {**FILES, "b/c/0/0": b"23"})
    after = {path: os.stat(tmp_path / path) for path in FILES}
    assert {path for path in FILES if after[path] != before[path]} == {"b/c/0/0"}


@pytest.mark.parametrize("place", ["b", "b/c", "b/c/0"])
def test_nothing_is_written_through_a_link_or_over_a_folder(tmp_path, place):
    own, other = tmp_path / "own", tmp_path / "other"
    for folder in (own, other):
        folder.mkdir()
        put(folder, FILES)
    (own / place).rename(tmp_path / "away")
    (own / place).symlink_to(other / place)
    with pytest.raises(ArchiveError, match="is a link"):
        put(own, {path: data + b" " for path, data in FILES.items()})
    assert put(other, FILES) == (None, FILES)
    (own / place).unlink()
    put(own, FILES)
    (own / "b/c/0/0").unlink()
    (own / "b/c/0/0").mkdir()
    with pytest.raises(ArchiveError, match="is not a regular file"):
        put(own, FILES)

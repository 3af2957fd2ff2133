"""Folders are known to take files before a run, files are whole, and documents hold what JSON can."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from etendue.errors import MachineError, RequestError
from etendue.result_files import check_folder, finite, write_whole


def test_a_folder_is_made_and_nothing_is_left_in_it(tmp_path):
    check_folder(tmp_path / "a/b")
    check_folder(tmp_path / "a/b")
    assert list((tmp_path / "a/b").iterdir()) == []


@pytest.mark.parametrize("name", ["file", "file/inside", "x" * 300])
def test_what_cannot_be_a_folder_is_named(tmp_path, monkeypatch, name):
    (tmp_path / "file").write_text("mine")
    monkeypatch.chdir(tmp_path)  # a long path is told by its beginning
    with pytest.raises(RequestError, match=name[:30]):
        check_folder(Path(name))
    assert [path.name for path in tmp_path.iterdir()] == ["file"] and (tmp_path / "file").read_text() == "mine"


def test_files_replace_those_of_their_names_and_no_others(tmp_path):
    (tmp_path / "a").write_text("old")
    (tmp_path / "c").write_text("mine")
    assert write_whole(tmp_path, {"b": b"2", "a": b"1"}) == [tmp_path / "b", tmp_path / "a"]
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a": b"1", "b": b"2", "c": b"mine"}


def test_where_one_file_cannot_be_written_all_stay_as_they_were(tmp_path):
    (tmp_path / "a").write_text("old")
    with pytest.raises(MachineError, match="cannot be written"):
        write_whole(tmp_path, {"a": b"new", "x" * 300: b""})
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "old"}


def test_a_folder_in_place_of_a_file_leaves_no_temporary_name(tmp_path):
    (tmp_path / "a").mkdir()
    with pytest.raises(MachineError):
        write_whole(tmp_path, {"a": b"1"})
    (tmp_path / "file").write_text("")
    with pytest.raises(MachineError):
        write_whole(tmp_path / "file", {"a": b"1"})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "file"]


def test_documents_have_null_for_unknown_and_a_word_for_endless():
    given = {
        "a": [math.nan, (math.inf, -math.inf)],
        2: np.float32(0.5),
        "c": np.int64(3),
        "d": np.float64("nan"),
        "e": None,
        "f": "x",
    }
    found = finite(given | {"g": {"h": True}})
    assert found == {"a": [None, ["inf", "-inf"]], "2": 0.5, "c": 3, "d": None, "e": None, "f": "x", "g": {"h": True}}
    json.dumps(found, allow_nan=False)

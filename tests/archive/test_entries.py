"""What is said of cells, in columns: the same as a dict of entries; lines read in one go mean what they mean word by
word.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from etendue.archive.journaling.accepting import Former, accepted
from etendue.archive.journaling.blocks import ShardContents
from etendue.archive.journaling.entries import EVENTS, Entries, Entry
from etendue.archive.journaling.journal import Journal, Read, _checked, _take, _take_own, read, summed
from etendue.archive.records.names import STATUS
from etendue.archive.sharding.shards import ChunkPlace, Index
from etendue.contract.ports import WrittenChunk
from etendue.trust.comparing import unchecked

NUMBER = st.integers(0, 2**62)
WRITTEN = st.builds(
    WrittenChunk,
    st.sampled_from(["a/c.0", "a/c.1"]),
    st.integers(0, 7),
    st.sampled_from(["p", "q"]),
    NUMBER,
    NUMBER,
    NUMBER,
)
KEYS = st.one_of(
    st.binary(min_size=16, max_size=16).map(bytes.hex), st.sampled_from(["", "AB" * 16, "no digest", "ab"])
)
ENTRY = st.builds(
    Entry,
    event=st.sampled_from(EVENTS),
    key=KEYS,
    files=st.lists(WRITTEN, max_size=3).map(tuple),
    status=st.sampled_from(STATUS),
    seconds=st.floats(allow_nan=False),
    clipped=st.sampled_from([0.0, 0.5]),
    clipped_flux=st.sampled_from([0.0, 0.25]),
    floored=st.sampled_from([0.0, 3.0]),
    platform=st.sampled_from(["", "elsewhere"]),
    fresh=st.booleans(),
)
NAMES = st.sampled_from(["scene", "pixel f=1", "pixel f=2"])


@settings(max_examples=50)
@given(st.lists(st.tuples(NAMES, ENTRY), max_size=8))
def test_columns_say_what_a_dict_of_entries_says(said):
    columns, plain = Entries(), {}
    for name, entry in said:
        columns[name] = plain[name] = entry
    assert dict(columns) == plain
    assert list(columns.done()) == [name for name, one in plain.items() if one.event == "done"]
    for name, one in plain.items():
        assert columns.standing(name, one.key) == ("" if one.event == "start" else one.status)
        assert columns.standing(name, one.key + "x") == ""
        assert columns.took(name) == one.seconds
    done = {name: one for name, one in plain.items() if one.event == "done"}
    assert columns.done_among(["nobody", *plain]) == list(done)
    assert columns.done_otherwise((name, "" if name == "scene" else one.key) for name, one in plain.items()) == [
        name for name, one in done.items() if name == "scene" and one.key
    ]
    assert list(columns.told()) == [
        (name, one.event, one.status, one.seconds, one.clipped) for name, one in plain.items()
    ]
    chunks = [file for one in done.values() for file in one.files]
    assert {path: [columns.files[n] for n in own] for path, own in columns.by_shard().items()} == {
        path: [file for file in chunks if file.path == path] for path in {file.path for file in chunks}
    }
    assert columns.shards().keys() == columns.by_shard().keys() and columns.shards(plain) == {}
    outdated = columns.counts(done)
    assert sum(count for (_, status), count in outdated.items() if status == "outdated") == len(done)
    columns.close()
    assert dict(columns) == {name: replace(one, fresh=False) for name, one in plain.items()}


@settings(max_examples=50)
@given(st.lists(st.tuples(st.integers(0, 5), st.one_of(st.none(), WRITTEN), st.booleans()), max_size=20))
def test_the_chunks_of_a_shard_are_held_as_in_a_dict(steps):
    held, plain = ShardContents("a/c.0", 6), {}
    for slot, one, moved in steps:
        if one is None:
            assert held.pop(slot, None) == plain.pop(slot, None)
            continue
        held[slot] = plain[slot] = (
            one,
            ChunkPlace("a/c.0" if moved else f"{one.part}.part", one.offset, one.size, one.digest),
        )
    assert dict(held) == plain
    assert held.lying() == {place.file for _, place in plain.values()}
    there = {slot: (place.offset, place.size) for slot, (_, place) in plain.items() if place.file == "a/c.0"}
    for index in (there, Index.of(6, there)):
        assert held.lies_as(index) == (len(there) == len(plain))
    for slot, (offset, size) in there.items():
        assert not held.lies_as(Index.of(6, {**there, slot: (offset + 1, size)}))
        assert not held.lies_as(Index.of(6, {other: own for other, own in there.items() if other != slot}))
    assert all((slot in held) == (slot in plain) for slot in range(6))


def test_an_index_says_of_each_slot_what_was_put_there():
    places = {0: (0, 10), 3: (10, 7)}
    assert dict(Index.of(5, places)) == places
    assert [slot in Index.of(5, places) for slot in (-1, 0, 1, 3, 4, 5)] == [False, True, False, True, False, False]


LINES = [
    b'{"event":"start","cell":"pixel f=1","key":"00112233445566778899aabbccddeeff"}',
    b'{"event":"done","cell":"pixel '
    b'f=1","key":"00112233445566778899aabbccddeeff","status":"left_out","seconds":1,"clipped":0.5,'
    b'"clipped_flux":0.0,"floored":2.0,"platform":"x","files":[["a/c.0",3,"p",0,12,77]]}',
    b'{"event":"failed","cell":"scene","key":"","status":"failed","seconds":0.25,"clipped":0.0,"clipped_flux":0.0,"floored":0.0,"files":[]}',
]


@pytest.mark.parametrize("line", LINES)
def test_a_line_read_in_one_go_says_what_it_says_word_by_word(line):
    quick, slow = Read(), Read()
    assert _take_own(quick, summed(line))
    _take(slow, _checked(summed(line)))
    assert dict(quick.entries) == dict(slow.entries)
    for found, take in (
        (quick, lambda: _take_own(quick, summed(line))),
        (slow, lambda: _take(slow, _checked(summed(line)))),
    ):
        found.outdated = {"pixel f=1", "scene", "pixel f=2"}
        take()
    assert quick.outdated == slow.outdated == {"pixel f=1", "scene", "pixel f=2"} - set(quick.entries)


@pytest.mark.parametrize("path", ["/etc/passwd", "a/../../b", ".."])
@pytest.mark.parametrize("word", ["a/c.0", "p"])
def test_a_path_that_leads_out_of_the_archive_says_nothing(path, word, tmp_path):
    line = LINES[1].replace(f'"{word}"'.encode(), f'"{path}"'.encode())
    (tmp_path / "journal.jsonl").write_bytes(summed(line) + b"\n")
    found = read(tmp_path / "journal.jsonl")
    assert (len(found.entries), found.damaged) == (0, 1)
    assert not found.said.files.texts


@pytest.mark.parametrize("line", LINES)
def test_a_changed_byte_of_a_line_is_found(line, tmp_path):
    whole = summed(line)
    for place in range(0, len(whole), 5):
        changed = whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :]
        if b"\n" in changed:
            continue
        (tmp_path / "journal.jsonl").write_bytes(changed + b"\n")
        found = read(tmp_path / "journal.jsonl")
        assert (len(found.entries), found.damaged) == (0, 1), changed


@pytest.mark.parametrize("number", ["-1", "9223372036854775808", "1.5", "true"])
def test_a_number_that_fits_no_file_is_damage_or_kept_as_it_is(number, tmp_path):
    line = LINES[1].replace(b"77]", f"{number}]".encode())
    (tmp_path / "journal.jsonl").write_bytes(summed(line) + b"\n" + summed(LINES[2]) + b"\n")
    found = read(tmp_path / "journal.jsonl")
    assert found.damaged == (number != "-1")
    assert found.entries["scene"].status == "failed"


def test_a_run_that_asks_for_other_cells_is_recorded_and_one_that_repeats_the_last_is_not(tmp_path):
    """What the last run was asked for says which cells are not computed yet, though it computed none itself."""
    journal = Journal(tmp_path)
    journal.open()
    for planned, lines in (({"pixel": 2}, 1), ({"pixel": 2}, 1), ({"pixel": 3}, 2), ({"pixel": 2}, 3)):
        journal.begin_run(planned, {})
        assert read(tmp_path / "journal.jsonl").run.planned == planned
        assert (tmp_path / "journal.jsonl").read_bytes().count(b"\n") == lines
    journal.close()


def test_a_cell_that_was_accepted_twice_comes_from_where_it_was_computed():
    plan = SimpleNamespace(cells={("pixel", (n,)): SimpleNamespace(key=f"today {n}") for n in (0, 1)})
    finished = [
        (("pixel", (0,)), Entry("done", "then 0")),
        (("pixel", (1,)), Entry("done", "then 1", platform="first")),
    ]
    found = accepted(Former({}, "second"), plan, finished)
    assert [(entry.key, entry.platform) for _, entry in found] == [("today 0", "second"), ("today 1", "first")]
    assert accepted(Former(), plan, finished) == []


def test_lines_of_cells_that_are_gone_are_no_lines_of_cells_that_nobody_has():
    """What a run removed was of an earlier pipeline, and is said to be removed; what failed there has no files."""
    said = Entries()
    said["pixel f=1"], said["pixel f=2"] = Entry("removed", "", status="not_computed"), Entry("failed", "")
    journal = SimpleNamespace(entries=said, said=said, outdated=set())
    found = unchecked(SimpleNamespace(journal=journal, manifest=None), SimpleNamespace(names={}), False, False, False)
    (lines,) = [one for one in found if "journal lines" in one.what]
    assert lines.what.startswith("1 ") and lines.why.startswith("pixel f=2")

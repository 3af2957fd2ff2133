"""A journal that is read from the cache says what its lines say; any other byte in it is read anew."""

from __future__ import annotations

import pytest

from etendue.archive.journaling import index, journal
from etendue.archive.journaling.entries import Entry
from etendue.archive.journaling.journal import NAME, Journal, read
from etendue.contract.ports import WrittenChunk


@pytest.fixture
def written(tmp_path, monkeypatch):
    """A journal with every kind of line about cells, and a cache of its own; the smallest journal is worth an entry."""
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(index, "SMALLEST", 100)
    one = Journal(tmp_path)
    one.open()
    one.set_axes({"a": {"x": [1.0, 2.0, float("inf")]}})
    one.begin_run({"a": 3, "b": 1}, {"a": 3, "b": 1})
    one.start((f"a x={n}", "ab" * 16) for n in range(3))
    for n in range(2):
        chunk = WrittenChunk(f"data.zarr/a/v/c.{n}", n, "part", 8 * n, 8, 7 + n)
        one.end([(f"a x={n}", Entry("done", "ab" * 16, (chunk, chunk), seconds=0.5, clipped=0.25 * n))])
    one.end([("b", Entry("failed", "no digest", (), "failed", platform="elsewhere"))])
    one.closed()
    one.set_outdated(["a x=1"])
    one.close()
    return tmp_path


def state(found):
    return [
        list(found.said.items()),
        found.said.rows_of_chunks().tolist(),
        *(
            getattr(found, name)
            for name in ("axes", "arrays", "run", "shards", "records", "outdated", "damaged", "torn")
        ),
    ]


def lines_read(folder, monkeypatch):
    """What the journal says, and how many of its lines about cells were read for it."""
    taken, own = [], journal._take_own
    with monkeypatch.context() as patch:
        patch.setattr(journal, "_take_own", lambda found, line: taken.append(own(found, line)) or taken[-1])
        return state(read(folder / NAME)), sum(taken)


def test_the_cache_says_what_the_lines_say(written, monkeypatch):
    plain, lines = lines_read(written, monkeypatch)
    assert lines == 6
    assert lines_read(written, monkeypatch) == (plain, 0)


def test_lines_appended_since_are_read_on_top(written, monkeypatch):
    lines_read(written, monkeypatch)
    more = Journal(written)
    more.open()
    more.start([("a x=0", "cd" * 16)])
    more.close()
    said, lines = lines_read(written, monkeypatch)
    assert lines == 1
    monkeypatch.setattr(index, "SMALLEST", 1 << 40)
    assert lines_read(written, monkeypatch) == (said, 7)


@pytest.mark.parametrize("change", ["byte", "shorter", "other line"])
def test_a_journal_that_differs_in_any_byte_is_read_anew(written, monkeypatch, change):
    lines_read(written, monkeypatch)
    data = (written / NAME).read_bytes()
    at = data.index(b'"seconds":0.5')
    changed = {
        "byte": data[: at + 12] + b"6" + data[at + 13 :],
        "shorter": data[: data.index(b'{"event":"closed"')],
        "other line": data.replace(b'{"event":"closed"', b'{"event":"opened"'),
    }[change]
    (written / NAME).write_bytes(changed)
    said, lines = lines_read(written, monkeypatch)
    assert lines >= 5
    monkeypatch.setattr(index, "SMALLEST", 1 << 40)
    assert lines_read(written, monkeypatch) == (said, lines)


@pytest.mark.parametrize("damage", [b"", b"nothing of the kind", "cut"])
def test_a_damaged_entry_costs_time_alone(written, monkeypatch, damage):
    plain = lines_read(written, monkeypatch)
    (entry,) = (written / "cache" / index.KIND).iterdir()
    entry.write_bytes(entry.read_bytes()[:-9] if damage == "cut" else damage)
    assert lines_read(written, monkeypatch) == plain


def test_a_flipped_bit_anywhere_in_an_entry_costs_time_alone(written, monkeypatch):
    plain = lines_read(written, monkeypatch)
    (entry,) = (written / "cache" / index.KIND).iterdir()
    whole = entry.read_bytes()
    for at in range(0, len(whole), 7):
        entry.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        assert lines_read(written, monkeypatch) == plain, at


def test_the_entries_written_last_stay(written, monkeypatch):
    monkeypatch.setattr(index, "MOST", 2)
    for number in range(4):
        folder = written / f"copy{number}"
        folder.mkdir()
        (folder / NAME).write_bytes((written / NAME).read_bytes())
        lines_read(folder, monkeypatch)
    kept = {path.name for path in (written / "cache" / index.KIND).iterdir()}
    assert kept == {index._key(written / f"copy{number}" / NAME) for number in (2, 3)}

"""Whatever happens to a file that is no chunk of a cell: a run restores the archive to the last byte, or refuses and
names the file.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import zlib
from pathlib import Path

import pytest

from etendue.archive.checks.verify import verify
from etendue.archive.journaling.journal import Journal
from etendue.archive.write.compact import compact
from etendue.cli import main
from etendue.errors import ArchiveError, EtendueError
from etendue.session import Options, execute
from tests.archive.tiny import store_of

pytestmark = pytest.mark.long

MANY = int(os.environ.get("ETENDUE_DAMAGES", "1"))  # times two flipped bits and another damage, for every kind
KINDS = (
    "data.zarr/zarr.json",  # root
    "data.zarr/scene/zarr.json",  # group
    "data.zarr/irradiance/irradiance/zarr.json",  # variable
    "data.zarr/lens_numbers/hyperfocal_distance/zarr.json",  # one number a cell
    "data.zarr/irradiance/f_number/zarr.json",  # axis
    "data.zarr/irradiance/f_number/c/0",
    "data.zarr/pixel/zarr.json",  # a group of shapes
    "data.zarr/pixel/4x4/back/c/0",  # an axis of texts
    "data.zarr/scene/wavelength_bounds/zarr.json",
    "data.zarr/pixel/5x4/y_um/c/0",
    "data.zarr/pixel/5x4/status/zarr.json",
    "data.zarr/pixel/4x4/status/c/0/0/0",
    "data.zarr/ledger/zarr.json",
    "data.zarr/ledger/key/zarr.json",
    "data.zarr/summary/stage/c/0",
    "data.zarr/frames/zarr.json",
    "data.zarr/frames/preview/zarr.json",
    "data.zarr/frames/preview/c/0/0/0/0",
    "journal.jsonl",
    "manifest.json",
    "runs/0001.json",
    "runs/0001.toml",
    "run.id",
    "lock",
    "ro-crate-metadata.json",
    "contact_sheet.png",
    "inputs",
)


def run(plan, archive, **options):
    return execute(plan, archive, Options("serial", **options))


def attempt(plan, archive):
    """Run it; what it was refused with."""
    try:
        run(plan, archive)
    except EtendueError as error:
        return error
    return None


def show(archive, capsys):
    """Exit code and stderr of ``etendue show``."""
    with pytest.raises(SystemExit) as stopped:
        main(["show", str(archive)], prog_name="etendue")
    return stopped.value.code, capsys.readouterr().err


def flipped(data, chance):
    out = bytearray(data)
    out[chance.randrange(len(out))] ^= 1 << chance.randrange(8)
    return bytes(out)


def damages(data, chance):
    """What is left of a file; None: nothing, and text: a folder of that name."""
    yield "removed", None
    for number in range(2 * MANY):
        yield f"flipped {number}", flipped(data, chance) if data else b"\x00"
    others = [
        ("cut", data[: len(data) // 2]),
        ("empty", b""),
        ("a list", b'[{"attributes": 3}, null, "x"]\n'),
        ("not UTF-8", b"\xff\xfe" + data[2:]),
        ("an object", b'{"attributes": [1], "shape": {}, "nodes": 3, "metadata": {"..": 1}}\n'),
        ("a folder", "folder"),
    ]
    yield from chance.sample(others, min(MANY, len(others)))


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_written_again_or_named(whole, plan, kind, tmp_path, capsys):
    shutil.copytree(whole, tmp_path / "a")
    archive, sound = tmp_path / "a", store_of(whole)
    path = archive / kind if kind != "inputs" else next((archive / "inputs").iterdir())
    chance = random.Random(kind)
    before = path.read_bytes()
    for name, left in damages(before, chance):
        path.unlink()
        if left == "folder":
            path.mkdir()
        elif left is not None:
            path.write_bytes(left)
        code, said = show(archive, capsys)
        assert code in (0, 2), (name, said)
        assert len(said.splitlines()) == (code == 2), (name, said)
        error = attempt(plan, archive)
        if error is not None:
            assert error.exit_code == 2, (name, error)
            assert any(word in str(error) for word in (path.name, path.parent.name, "another platform")), (name, error)
            assert left == "folder" or kind == "runs/0001.json", (name, error)
            if left == "folder":
                path.rmdir()
                path.write_bytes(before)
                run(plan, archive)
            else:
                assert "--accept-platform" in str(error)
                run(plan, archive, accept_platform=True)
        if path.is_dir():
            path.rmdir()
        if not path.exists():  # what somebody else says of an earlier run
            path.write_bytes(before)
            run(plan, archive)
        assert store_of(archive) == sound, name
    code, said = show(archive, capsys)
    assert code == 0, said
    assert run(plan, archive).mended == []


def changed(archive, path, change):
    file = archive / "data.zarr" / path / "zarr.json"
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))


WORDS = {
    "dtype": lambda d: d.update(data_type="float64"),
    "endianness": lambda d: d["codecs"][0]["configuration"]["codecs"][0]["configuration"].update(endian="big"),
    "codecs": lambda d: d["codecs"][0]["configuration"].update(codecs=d["codecs"][0]["configuration"]["codecs"][:1]),
    "chunk grid": lambda d: d["chunk_grid"]["configuration"].update(chunk_shape=[2, 1, 1, 1]),
    "chunk key encoding": lambda d: d["chunk_key_encoding"]["configuration"].update(separator="/"),
    "shape": lambda d: d["shape"].__setitem__(0, 1),
    "fill value": lambda d: d.update(fill_value=0.0),
    "dimension names": lambda d: d.update(dimension_names=d["dimension_names"][::-1]),
    "units": lambda d: d["attributes"].update(units="lux"),
}


def test_every_word_of_the_metadata_is_that_of_the_plan(whole, plan, tmp_path):
    """Each makes other numbers, or none, of the same chunks: they are right, and what says how to read them is
    written again.
    """
    shutil.copytree(whole, tmp_path / "a")
    for name, change in WORDS.items():
        changed(tmp_path / "a", "irradiance/irradiance", change)
        assert store_of(tmp_path / "a") != store_of(whole), name
        outcome = run(plan, tmp_path / "a")
        assert outcome.computed == 0, name
        assert outcome.mended == ["data.zarr/irradiance/irradiance"], name
        assert store_of(tmp_path / "a") == store_of(whole), name


def test_metadata_removed_costs_no_cell(whole, plan, tmp_path):
    shutil.copytree(whole, tmp_path / "a")
    for path in (tmp_path / "a" / "data.zarr").rglob("zarr.json"):
        path.unlink()
    outcome = run(plan, tmp_path / "a")
    assert outcome.computed == 0
    assert len(outcome.mended) > 20
    assert store_of(tmp_path / "a") == store_of(whole)


def test_a_damaged_record_is_not_believed(whole, plan, tmp_path):
    """Nobody goes on with cells of a platform that no record can name."""
    shutil.copytree(whole, tmp_path / "a")
    path: Path = tmp_path / "a" / "runs" / "0001.json"
    record = json.loads(path.read_text())
    path.write_text(json.dumps({**record, "platform": {**record["platform"], "numpy": "0.0.1"}}))
    with pytest.raises(EtendueError, match=r"no readable record.*--accept-platform"):
        run(plan, tmp_path / "a")
    assert run(plan, tmp_path / "a", accept_platform=True).computed == 0
    assert run(plan, tmp_path / "a").computed == 0  # a record of its own stands behind the damaged one


@pytest.mark.parametrize("event", ["done", "shard", "arrays", "axes", "blocks", "record"])
@pytest.mark.parametrize("out", ["../../", "/etc/"])
def test_a_line_that_leads_out_of_the_archive_says_nothing(whole, plan, tmp_path, event, out):
    """Under a right checksum, as somebody writes it who wants others to write, or read, elsewhere."""
    archive = tmp_path / "below" / "a"
    shutil.copytree(whole, archive)
    journal, changed = archive / "journal.jsonl", 0
    lines = journal.read_bytes().splitlines(keepends=True)
    for number, line in enumerate(lines):
        document = json.loads(line)
        if document["event"] != event or (event == "done" and not document["files"]):
            continue
        if event == "done":
            document["files"][0][0] = out + document["files"][0][0]
        else:
            key = "path" if "path" in document else "group"
            document[key] = out + document[key]
        body = json.dumps(
            {key: value for key, value in document.items() if key != "sum"}, separators=(",", ":")
        ).encode()
        lines[number] = body[:-1] + b',"sum":"%08x"}\n' % zlib.crc32(body)
        changed += 1
    journal.write_bytes(b"".join(lines))
    assert Journal(archive).damaged == changed > 0
    assert "journal.jsonl" in {damage.path for damage in verify(archive).damages}
    with pytest.raises(ArchiveError, match="journal"):
        compact(archive, tmp_path / "below" / "new")
    run(plan, archive)
    assert store_of(archive) == store_of(whole)
    assert [p.name for p in tmp_path.iterdir()] == ["below"] and [p.name for p in (tmp_path / "below").iterdir()] == [
        "a"
    ]


def test_a_line_of_the_journal_with_another_digit_says_nothing(whole, plan, tmp_path):
    shutil.copytree(whole, tmp_path / "a")
    journal = tmp_path / "a" / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    number = max(n for n, line in enumerate(lines) if b'"done"' in line and b'"cell":"pixel' in line)
    assert b'"clipped":0.0' in lines[number]
    lines[number] = lines[number].replace(b'"clipped":0.0', b'"clipped":0.5')
    journal.write_bytes(b"".join(lines))
    assert run(plan, tmp_path / "a").computed == 1
    assert store_of(tmp_path / "a") == store_of(whole)

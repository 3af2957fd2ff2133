"""An archive answers for itself: run again, reproduced, compared, verified and repaired from what is in it."""

from __future__ import annotations

import importlib.util
import json
import math
import platform
import shutil
import socket
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rocrate.rocrate import ROCrate

from etendue.archive.checks.verify import verify
from etendue.archive.read.comparing import Compared
from etendue.archive.read.differences import differences
from etendue.archive.read.differing import between, together
from etendue.archive.read.inspection import Damage
from etendue.archive.read.stored import Stored
from etendue.archive.records.rerun import recorded
from etendue.cli import main
from etendue.contract.ports import CellReport
from etendue.contract.registry import installed_stages
from etendue.errors import ArchiveError, RequestError
from etendue.pipeline.file import parse_pipeline, read_pipeline
from etendue.plan.ancestry import ancestry
from etendue.plan.planner import make_plan
from etendue.present.terminal.trust import print_reproduction
from etendue.session import Options, execute
from etendue.trust.comparing import alike
from etendue.trust.repairing import repair
from etendue.trust.reproducing import document, reproduce
from etendue.trust.sayings import Deviation
from etendue.trust.verdict import CellResult, Reproduction, judged, judged_cell
from tests.archive.tiny import TEXT, tiny_file, tiny_plan

SERIAL = Options("serial")
SHARD = "data.zarr/irradiance/irradiance/c.0.0.0.0"
FAULTS = Path(__file__).parents[2] / "benchmarks" / "faults"


@pytest.fixture
def archive(whole, tmp_path):
    """A copy, somewhere else than its pipeline and its input."""
    shutil.copytree(whole, tmp_path / "moved" / "a")
    return tmp_path / "moved" / "a"


def arrays(archive):
    stored = Stored(archive)
    cells = {name: stored.cell(name) for name in stored.finished}
    return {
        (name, variable): cell.read(variable).tobytes() for name, cell in cells.items() for variable in cell.variables
    }


def etendue(capsys, *words):
    """Exit code, stdout, stderr."""
    with pytest.raises(SystemExit) as stopped:
        main([str(word) for word in words], prog_name="etendue")
    out = capsys.readouterr()
    return stopped.value.code or 0, out.out, out.err


def flip(path, at=10):
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(data)


# -- run again -----------------------------------------------------------------------------------------------------


def test_an_archive_runs_again_into_itself_and_computes_what_is_lost(archive, whole, capsys):
    assert etendue(capsys, "rerun", archive, "--scheduler", "serial", "--quiet", "--json")[0] == 0
    (archive / SHARD).unlink()
    code, out, _ = etendue(capsys, "rerun", archive, "--scheduler", "serial", "--quiet", "--json")
    assert (code, json.loads(out)["computed"]) == (0, 2)  # both f-numbers stood in that file
    assert arrays(archive) == arrays(whole)


def test_what_an_archive_needs_to_run_again_is_named_where_it_is_lost(archive, capsys):
    (name,) = (archive / "inputs").iterdir()
    flip(name)
    code, _, err = etendue(capsys, "rerun", archive)
    assert code == 2
    assert name.name in err
    assert "--from" in err
    name.unlink()
    with pytest.raises(ArchiveError, match="is missing. Put the file"):
        recorded(archive).pipeline()
    flip(archive / "runs/0001.json")
    with pytest.raises(ArchiveError, match=r"0001.json is damaged"):
        recorded(archive)
    (archive / "runs/0001.json").unlink()
    with pytest.raises(ArchiveError, match="record"):
        recorded(archive)
    with pytest.raises(ArchiveError, match="not an archive"):
        recorded(archive.parent)


# -- reproduced ----------------------------------------------------------------------------------------------------


def test_an_archive_comes_out_again_to_the_last_bit(archive):
    before = {p: p.stat().st_mtime_ns for p in archive.rglob("*") if p.is_file()}
    found = reproduce(archive, SERIAL)
    assert found.verdict == "the same bits"
    assert {(c.cell, c.variable) for c in found.cells} == set(arrays(archive))
    assert {
        p: p.stat().st_mtime_ns for p in archive.rglob("*") if p.is_file()
    } == before  # and nothing of it was touched
    kept = reproduce(archive, SERIAL, into=archive.parent / "again")
    assert kept.verdict == "the same bits"
    pictures = [[one.why for one in each.not_checked if "pictures" in one.what] for each in (found, kept)]
    assert pictures == [[], ["--into"]]  # only a copy has pictures that are not held against those of the archive
    assert arrays(archive.parent / "again") == arrays(archive)


def test_cells_of_all_runs_are_reproduced(tmp_path):
    """Values that a later run left out are there still."""
    tiny_file(tmp_path)
    for values in ([2, 4], [2, 8]):
        execute(tiny_plan(tmp_path, {"sweep.f_number": values}), tmp_path / "a", SERIAL)
    found = reproduce(tmp_path / "a", SERIAL)
    assert found.verdict == "the same bits"
    assert "irradiance f_number=4.0" in {cell.cell for cell in found.cells}
    (tmp_path / "a" / SHARD).unlink()
    mended = repair(tmp_path / "a", (), SERIAL)
    assert mended.after.whole and "irradiance f_number=4.0" in mended.before.lost
    assert mended.computed == len(mended.before.lost)  # those of earlier runs count like the others


def test_a_cell_that_cannot_be_read_is_not_reproduced(archive, capsys):
    flip(archive / SHARD)
    code, out, _ = etendue(capsys, "reproduce", archive, "--scheduler", "serial", "--json")
    found = json.loads(out)
    assert code == 1
    assert [(cell["cell"], cell["found"]) for cell in found["not_the_same"]] == [("irradiance f_number=2.0", "damaged")]


def rewritten(archive, change):
    """Another record, and nothing that vouches for the one that was."""
    path, journal = archive / "runs/0001.json", archive / "journal.jsonl"
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))
    lines = [json.loads(line) for line in journal.read_text().splitlines()]
    lines = [{**line, "text": path.read_text()} if line["event"] == "record" else line for line in lines]
    journal.write_text("".join(json.dumps({k: v for k, v in line.items() if k != "sum"}) + "\n" for line in lines))
    (archive / "manifest.json").unlink()


def test_a_stage_that_is_not_installed_is_named(archive, capsys):
    rewritten(archive, lambda r: r["nodes"]["pixel"].update(stage=["pixel_of_mine"], distributions=["my-pixels 1.2"]))
    code, _, err = etendue(capsys, "reproduce", archive)
    assert code == 2
    assert "'pixel_of_mine' of my-pixels 1.2 is not installed here" in err
    assert "my-pixels==1.2" in err


def test_other_code_and_another_platform_are_named(archive):
    def elsewhere(record):
        record["nodes"]["pixel"].update(code=["0" * 32], distributions=["etendue 0.0.1"])
        record["platform"]["numpy"] = "0.0.1"

    rewritten(archive, elsewhere)
    found = reproduce(archive, SERIAL)
    assert {cell.found for cell in found.cells} == {"same"}
    assert [(one.where, found.reproduced) for one in found.differences] == [
        ("nodes.pixel.code", False)
    ]  # whose keys are of this code
    assert list(found.platform) == ["numpy"]
    assert {(row["stage"], row["what"]) for row in found.software} == {("pixel", "code"), ("pixel", "distributions")}


@pytest.mark.parametrize(
    ("elsewhere", "off", "allowed", "verdict"),
    [
        (False, 0.0, None, "same"),
        (False, 1e-9, 1.0, "beyond"),
        (True, 1e-4, 1e-3, "within"),
        (True, 1e-2, 1e-3, "beyond"),
        (True, 1e-4, None, "unknown"),
    ],
)
def test_bits_count_on_the_same_platform_and_stated_errors_on_another(elsewhere, off, allowed, verdict):
    one = np.linspace(0, 1, 100)
    compared = Compared.of("v", between(one, one + off))
    assert judged("s", "s", compared, allowed, elsewhere).found == verdict


def test_errors_of_all_stages_before_a_cell_are_allowed_together(tmp_path):
    """Each may err by what it states, and all in one direction."""
    plan = tiny_plan(tmp_path)
    ref = plan.of("pixel")[0].ref
    errors = [plan.cells[one].error[0] for one in ancestry(plan, [ref])]
    assert max(errors) < sum(errors)
    one = np.linspace(0, 1, 100)
    for off, verdict in ((0.5 * (max(errors) + sum(errors)), "within"), (1.01 * sum(errors), "beyond")):
        report = CellReport(*ref, "done", written=(Compared.of("v", between(one, one + off)),))
        (found,) = judged_cell(plan, ref, "cell", report, "", True)
        assert (found.found, found.allowed) == (verdict, pytest.approx(sum(errors)))


def reproduction(*found, **more):
    cells = [CellResult("pixel", f"pixel {n}", "v", one) for n, one in enumerate(found)]
    record = {"pipeline": "tiny", "began": "today"}
    return Reproduction(Path("a"), record, more.pop("platform", {}), [], ["pixel"], cells, **more)


@pytest.mark.parametrize(
    ("found", "more", "verdict"),
    [
        (["same", "same"], {}, "the same bits"),
        (["same", "within"], {}, "within the stated errors"),
        ([], {}, "nothing to compare"),
        *((["same", worse], {}, "not reproduced") for worse in ("beyond", "unknown", "damaged", "failed")),
        (["same"], {"damages": [Damage("changed", "run.id", "it does not name the last run")]}, "not reproduced"),
        (["same"], {"differences": [Deviation("manifest.json", "status", "done", "failed")]}, "not reproduced"),
    ],
)
def test_an_archive_is_reproduced_if_every_cell_is_and_nothing_else_differs(found, more, verdict):
    one = reproduction(*found, **more)
    assert (one.verdict, one.reproduced) == (verdict, verdict in ("the same bits", "within the stated errors"))


def test_every_array_of_a_table_is_the_same_within_or_wrong(capsys):
    print_reproduction(document(reproduction("same", *("within beyond unknown damaged failed".split()))))
    (row,) = [line.split() for line in capsys.readouterr().out.splitlines() if line.split()[:2] == ["pixel", "6"]]
    assert row[:5] == ["pixel", "6", "1", "1", "4"]


def test_nothing_and_less_than_nothing_differ_where_bits_count():
    assert not alike(0.0, -0.0, 0.0) and alike(0.0, -0.0, 1e-6)
    assert alike(float("nan"), float("nan"), 0.0) and not alike(0.0, float("nan"), 1e-6)
    assert alike(1.0, 1.0 + 1e-9, 1e-6) and not alike(1.0, 1.0 + 1e-9, 0.0)


# -- compared ------------------------------------------------------------------------------------------------------


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40), st.floats(-1e3, 1e3))
def test_the_size_of_a_difference_is_that_of_what_was_added(values, step):
    one = np.array(values)
    other = one + step
    found, off = between(one, other), np.abs(one - other)
    assert found.same == (one.tobytes() == other.tobytes())
    assert found.largest == off.max()
    assert found.rms == pytest.approx(math.hypot(*off) / math.sqrt(off.size), rel=1e-12, abs=1e-300)
    assert between(one, one).same


def test_undefined_values_and_other_shapes_are_no_numbers():
    one = np.array([1.0, np.nan, np.inf])
    assert between(one, one.copy()).same
    assert between(one, np.array([np.nan, np.nan, np.inf])).undefined == 1
    assert between(one, np.array([1.0, np.nan, -np.inf])).undefined == 1
    assert between(one, np.array([1.0, np.inf, np.inf])).undefined == 1
    assert "float32" in between(one, one.astype(np.float32)).why
    assert between(one, one[:2]).relative is None


def test_the_rms_is_that_of_the_values_defined_in_both():
    one = np.arange(1.0, 5.0)
    holes = np.concatenate([one, np.full(4, np.nan)])
    whole = between(holes, holes + 1)
    parts = together(between(holes[n : n + 3], holes[n : n + 3] + 1) for n in (0, 3, 6))
    assert (whole.rms, whole.scale, whole.defined) == (1.0, 4.0, 4)
    assert (parts.rms, parts.scale, parts.defined) == (pytest.approx(1.0), 4.0, 4)
    assert between(one, one + 1e-200 * (one == 1)).same
    assert between(1e-200 * one, 2e-200 * one).relative == pytest.approx(math.sqrt(7.5) / 4)


def test_two_archives_differ_since_a_parameter(archive, tmp_path, capsys):
    assert all(stage.equal for stage in differences(archive, archive))
    tiny_file(tmp_path)
    plan = tiny_plan(tmp_path, {"camera.transmittance": 0.5, "sweep.f_number": [4, 8]})
    execute(plan, tmp_path / "b", SERIAL)
    found = {stage.name: stage for stage in differences(archive, tmp_path / "b")}
    assert found["scene"].equal
    assert (found["irradiance"].cells, found["irradiance"].only_first, found["irradiance"].only_second) == (
        1,
        ["irradiance f_number=2.0"],
        ["irradiance f_number=8.0"],
    )
    (off,) = (one.difference for one in found["irradiance"].differing if one.variable == "irradiance")
    assert off.largest == pytest.approx(0.5 * off.scale, rel=1e-6)  # half of the light
    assert "transmittance: 1" in found["irradiance"].since
    assert found["pixel"].since == "its input irradiance has changed"
    code, out, _ = etendue(capsys, "diff", archive, tmp_path / "b", "--json")
    assert (code, json.loads(out)["equal"]) == (1, False)


def test_an_axis_meets_a_fixed_value(archive, tmp_path):
    tiny_file(tmp_path)
    text = TEXT.replace("f_number = [2, 4]\n", "").replace("[camera]", "[camera]\nf_number = 4")
    (tmp_path / "tiny.toml").write_text(text)
    execute(make_plan(read_pipeline(tmp_path / "tiny.toml"), installed_stages()), tmp_path / "b", SERIAL)
    found = {stage.name: stage for stage in differences(archive, tmp_path / "b")}
    assert (found["pixel"].same, len(found["pixel"].only_first), found["pixel"].only_second) == (4, 4, [])


# -- described for strangers ---------------------------------------------------------------------------------------

ABOUT = """
[about]
title = "A small camera"
license = "CC-BY-4.0"
author = ["Lovelace, Ada", { name = "Imaging Group", orcid = "0000-0002-1825-0097", affiliation = "Engines" }]
"""


def test_an_archive_is_a_crate_that_names_licence_authors_inputs_and_runs(tmp_path):
    file = tiny_file(tmp_path, TEXT + ABOUT)
    execute(make_plan(read_pipeline(file), installed_stages()), tmp_path / "a", SERIAL)
    execute(make_plan(read_pipeline(file, {"camera.transmittance": 0.5}), installed_stages()), tmp_path / "a", SERIAL)
    crate = ROCrate(tmp_path / "a")
    assert crate.mainEntity.id == "runs/0002.toml"
    assert "ComputationalWorkflow" in crate.mainEntity.type
    assert crate.root_dataset["license"].id == "https://spdx.org/licenses/CC-BY-4.0"
    assert [one["name"] for one in crate.root_dataset["author"]] == ["Lovelace, Ada", "Imaging Group"]
    listed = {entity.id for entity in crate.data_entities}
    assert {f"inputs/{p.name}" for p in (tmp_path / "a/inputs").iterdir()} | {
        "runs/0001.json",
        "runs/0002.json",
        "CITATION.cff",
    } <= listed
    assert all((tmp_path / "a" / path).exists() for path in listed)
    assert {"https://w3id.org/ro/wfrun/provenance/0.5", "https://w3id.org/ro/wfrun/workflow/0.5"} <= {
        one.id for one in crate.root_dataset["conformsTo"]
    }
    runs = [entity for entity in crate.get_by_type("CreateAction") if entity.id.startswith("#run-")]
    assert [(run["instrument"].id, bool(run["endTime"])) for run in runs] == [
        ("runs/0002.toml", True),
        ("runs/0001.toml", True),
    ]
    graph = json.loads((tmp_path / "a/ro-crate-metadata.json").read_text())["@graph"]
    ids = [entity["@id"] for entity in graph]
    assert len(ids) == len(set(ids))
    assert 'family-names: "Lovelace"' in (tmp_path / "a/CITATION.cff").read_text()
    again = read_pipeline(tmp_path / "a/runs/0002.toml")
    assert again.about == read_pipeline(file).about


def test_nothing_in_an_archive_names_the_machine_or_its_user(tmp_path, monkeypatch):
    somebody, machine, home = "somebody-by-name", "machine-by-name", tmp_path / "home-of-somebody"
    home.mkdir()
    for name, value in {"USER": somebody, "LOGNAME": somebody, "HOME": str(home), "HOSTNAME": machine}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(socket, "gethostname", lambda: machine)
    monkeypatch.setattr(platform, "node", lambda: machine)
    execute(tiny_plan(home), home / "a", SERIAL)
    for path in (home / "a").rglob("*"):
        if path.is_file():
            data = path.read_bytes()
            assert not [
                word for word in (somebody, machine, str(home), str(tmp_path), sys.prefix) if word.encode() in data
            ], path


@pytest.mark.parametrize(
    ("about", "place"),
    [
        ('licence = "MIT"', "about.licence"),
        ('license = "all mine, no?"', "about.license"),
        ("author = 3", "about.author"),
        ('author = { name = "A", orcid = "12" }', "about.author.orcid"),
        ("title = 1", "about.title"),
    ],
)
def test_what_is_wrong_with_about_is_named(about, place):
    with pytest.raises(RequestError) as refused:
        make_plan(
            parse_pipeline(TEXT.replace('sensitivity = "camera.csv"', "") + f"[about]\n{about}\n"), installed_stages()
        )
    assert [fault.place for fault in refused.value.faults] == [place]


# -- verified and repaired -----------------------------------------------------------------------------------------


def test_every_byte_of_a_sound_archive_is_vouched_for(whole, capsys):
    code, out, _ = etendue(capsys, "verify", whole, "--json")
    found = json.loads(out)
    assert (code, found["whole"], found["damages"], found["beside"]) == (0, True, [], [])
    assert found["cells"] == len({name for name, _ in arrays(whole)})


def test_a_damage_is_named_by_array_and_cell_and_costs_one_cell(archive, whole, capsys):
    flip(archive / SHARD)
    code, out, _ = etendue(capsys, "verify", archive, "--json")
    (damage,) = json.loads(out)["damages"]
    assert code == 1
    assert (damage["array"], damage["cell"], damage["path"]) == (
        "irradiance/irradiance",
        "irradiance f_number=2.0",
        SHARD,
    )
    code, out, _ = etendue(capsys, "verify", archive, "--repair", "--scheduler", "serial", "--json")
    assert (code, json.loads(out)["computed"]) == (0, 1)
    assert arrays(archive) == arrays(whole)


def test_nothing_is_read_in_the_place_of_what_is_lost(tmp_path, capsys):
    """Plain Zarr gives zeros for a shard that is not there; whoever asks etendue is told."""
    file = Path(__file__).parents[2] / "pipelines" / "smallest.toml"
    one = {
        "sweep.f_number": [2],
        "sweep.pixel_pitch": ["5.4 um"],
        "sweep.integration_time": ["2 ms"],
        "wanted": ["raw"],
    }
    execute(make_plan(read_pipeline(file, one), installed_stages()), tmp_path / "a", SERIAL)
    (shard,) = (path for path in (tmp_path / "a/data.zarr/adc").rglob("c*") if "/raw/" in str(path) and path.is_file())
    words = ("export", tmp_path / "a", "--tiff", "--variable", "raw", "--output", tmp_path / "out")
    data = shard.read_bytes()
    flip(shard, len(data) // 3)
    code, _, err = etendue(capsys, *words)
    assert (code, "differ from what was written" in err, "--repair" in err) == (2, True, True)
    shard.unlink()
    for command in (words, ("show", tmp_path / "a")):
        code, _, err = etendue(capsys, *command)
        assert (code, shard.name in err, "--repair" in err) == (2, True, True), command
    shard.write_bytes(data)
    assert etendue(capsys, *words)[0] == 0


def test_what_does_not_belong_to_an_archive_is_moved_and_never_removed(archive):
    (archive / "data.zarr/scene/mine.txt").write_text("words")
    (archive / "notes.txt").write_text("beside it, where it may stay")
    (archive / "runs/link").symlink_to("/etc/hostname")
    found = verify(archive)
    assert {(damage.kind, damage.path) for damage in found.damages} == {
        ("added", "data.zarr/scene/mine.txt"),
        ("odd", "runs/link"),
    }
    assert found.beside == ["notes.txt"]
    assert repair(archive, [], SERIAL).after.whole
    assert (archive / "strays/mine.txt").read_text() == "words"
    assert (archive / "strays/link").is_symlink()
    assert (archive / "notes.txt").exists()


def test_a_repair_that_was_broken_off_is_made_good_by_the_next(archive, whole, monkeypatch):
    """Between giving a cell up and computing it anew."""
    flip(archive / SHARD)
    with monkeypatch.context() as patched:
        patched.setattr("etendue.trust.repairing.execute", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            repair(archive, [], SERIAL)
    assert not verify(archive).whole
    assert repair(archive, [], SERIAL).after.whole
    assert arrays(archive) == arrays(whole)


def test_what_a_journal_named_before_lines_were_taken_out_is_no_foreign_file(archive):
    """Its chunks are ours and are named no more: to be computed again, not to be moved away."""
    journal = archive / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(line for line in lines if b'"cell":"pixel ' not in line))
    damages = [one for one in verify(archive).damages if one.path.startswith("data.zarr/pixel/")]
    assert {one.kind for one in damages} == {"changed"}
    assert all("no longer names its chunks" in one.what for one in damages if not one.cell)


def test_a_run_that_was_broken_off_is_no_damage_to_its_cells(archive):
    (archive / "manifest.json").unlink()
    (damage,) = verify(archive).damages
    assert (damage.kind, damage.path, damage.cell) == ("unfinished", "manifest.json", "")


# -- many kinds of damage ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def driver():
    sys.path.insert(0, str(FAULTS))
    try:
        found = importlib.util.spec_from_file_location("damages", FAULTS / "damages.py")
        module = sys.modules["damages"] = importlib.util.module_from_spec(found)
        found.loader.exec_module(module)
        yield module
    finally:
        sys.path.remove(str(FAULTS))
        sys.modules.pop("damages", None)


FEW = (
    "chunk edited, checksum valid",
    "two chunks swapped",
    "chunk missing from an index",
    "array deleted",
    "link in place of a chunk file",
    "shape edited",
    "two columns swapped",
    "cell's line deleted",
    "manifest deleted",
    "record deleted",
    "input deleted",
)


def assert_held(rows):
    for kind, row in rows.items():
        assert row.wrong == [], kind
        assert row.count == row.found == row.named == row.repaired, kind
        assert row.computed <= row.lost, kind


@pytest.mark.long
def test_damages_are_found_named_and_repaired(driver):
    assert set(FEW) <= set(driver.KINDS)
    assert_held(driver.damaged(1, 1, FEW))


@pytest.mark.long
def test_every_kind_of_damage_is_found_named_and_repaired(driver):
    assert_held(driver.damaged(1, 1))

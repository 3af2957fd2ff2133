"""Every wrong file beside this one is refused with lines a person can act on.

A file says what is expected of it: one comment ``# expect: place | fragment`` per fault, and ``# here`` at the end of
the lines that are at fault (none where something is lacking).
"""

import json
from pathlib import Path

import pytest

from etendue.cli import main
from tests.fresh import process

FOLDER = Path(__file__).parent
FILES = sorted(path.name for path in FOLDER.glob("*.toml"))
READABLE = 220  # characters: two and a half lines of a terminal


def expected(name):
    """(place, fragment) of every fault, and the numbers of the lines that are at fault."""
    lines = (FOLDER / name).read_text().splitlines()
    faults = [line.removeprefix("# expect:").partition("|") for line in lines if line.startswith("# expect:")]
    return [(place.strip(), text.strip()) for place, _, text in faults], [
        n for n, line in enumerate(lines, 1) if line.endswith("# here")
    ]


def etendue(arguments, capsys):
    """Exit code, stdout and stderr of a command, in this process."""
    with pytest.raises(SystemExit) as stopped:
        main(arguments, prog_name="etendue")
    captured = capsys.readouterr()
    return stopped.value.code, captured.out, captured.err


def test_there_are_many_ways_to_be_wrong_and_all_of_them_are_marked():
    assert len(FILES) >= 110
    assert all(expected(name)[0] for name in FILES)


@pytest.mark.parametrize("name", FILES)
def test_a_wrong_file_is_refused_with_file_line_place_and_a_way_out(name, capsys, monkeypatch):
    monkeypatch.chdir(FOLDER)
    faults, here = expected(name)
    code, out, err = etendue(["plan", name], capsys)
    lines = err.splitlines()
    assert (code, out) == (2, "")
    assert "Traceback" not in err
    assert "".join(lines).isprintable()  # nothing that a terminal would obey
    assert len(lines) == len(faults) <= 6, err
    for line in lines:
        assert line.startswith(f"{name}:")
        assert len(line) < READABLE, line
    for place, fragment in faults:
        assert any(f" {place}: " in line and fragment in line if place else fragment in line for line in lines), (
            place,
            fragment,
            err,
        )
    assert [int(line.split(":")[1]) for line in lines if line.split(":")[1].isdigit()] == here


@pytest.mark.parametrize("name", FILES)
def test_the_same_faults_are_json_on_stdout(name, capsys, monkeypatch):
    monkeypatch.chdir(FOLDER)
    code, out, err = etendue(["plan", name, "--json"], capsys)
    document = json.loads(out)
    assert (code, err) == (2, "")
    assert list(document) == ["faults"]
    for fault in document["faults"]:
        assert {"file", "place", "message"} <= set(fault)
        assert fault["file"] == name
        assert fault["message"]
    for place, fragment in expected(name)[0]:
        assert any(fault["place"].startswith(place) and fragment in fault["message"] for fault in document["faults"])


@pytest.mark.parametrize("name", FILES)
def test_run_refuses_it_too_and_leaves_no_archive_behind(name, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    code, out, err = etendue(["run", str(FOLDER / name)], capsys)
    assert (code, out) == (2, "")
    assert len(err.splitlines()) == len(expected(name)[0])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["several_faults.toml", "not_toml.toml", "sensor_wider_than_the_light.toml"])
def test_as_a_command_of_its_own_it_is_the_same(name, capsys, monkeypatch):
    monkeypatch.chdir(FOLDER)
    done = process("plan", name, cwd=FOLDER)
    assert (done.returncode, done.stdout, done.stderr) == etendue(["plan", name], capsys)


@pytest.mark.parametrize(
    ("missing", "fragment"),
    [("severel_faults.toml", "no such file; did you mean 'several_faults.toml'?"), (".", "is a directory")],
)
def test_a_file_that_cannot_be_read_is_named(missing, fragment, capsys, monkeypatch):
    monkeypatch.chdir(FOLDER)
    code, _, err = etendue(["plan", missing], capsys)
    assert code == 2
    assert err.startswith(f"{missing}: ")
    assert fragment in err


def test_a_file_of_numbers_that_no_computer_reads_is_not_valid_toml(tmp_path, capsys):
    (tmp_path / "long.toml").write_text("seed = " + "1" * 5000)
    (tmp_path / "deep.toml").write_text("a = " + "[" * 20000 + "]" * 20000)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    for name, fragment in (("long", "not valid TOML"), ("deep", "not valid TOML"), ("binary", "cannot be read")):
        code, _, err = etendue(["plan", str(tmp_path / f"{name}.toml")], capsys)
        assert code == 2
        assert fragment in err
        assert len(err.splitlines()) == 1


def test_faults_of_a_setting_name_no_line_of_the_file(capsys, monkeypatch):
    """What was given on the command line does not stand in the file."""
    monkeypatch.chdir(FOLDER.parent.parent / "pipelines")
    _, _, err = etendue(
        ["plan", "smallest.toml", "--set", "camera.focal_length=-1 mm", "--set", "pixel.rows=x"], capsys
    )
    assert [line.partition(" ")[0] for line in err.splitlines()] == ["smallest.toml:", "smallest.toml:"]


def test_a_setting_of_an_absent_stage_names_the_stages_there_are(capsys, monkeypatch):
    monkeypatch.chdir(FOLDER.parent.parent / "pipelines")
    _, _, err = etendue(["plan", "smallest.toml", "--set", "wavefront.z4=1"], capsys)
    assert "cannot set 'wavefront': unknown name; the stages of this pipeline: scene, irradiance, " in err
    _, _, err = etendue(["plan", "smallest.toml", "--set", "demosic.floor=1"], capsys)
    assert "did you mean 'demosaic'?" in err


def test_a_line_that_is_not_toml_is_shown_without_its_comment(tmp_path, capsys):
    (tmp_path / "twice.toml").write_text("seed = = 1    # the same for all noise\n")
    _, _, err = etendue(["plan", str(tmp_path / "twice.toml")], capsys)
    assert ":1: not valid TOML: Invalid value: 'seed = = 1'; text, " in err

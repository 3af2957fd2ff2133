"""Foreign text is shown without what a terminal obeys, bounded, and without folders of this machine."""

from __future__ import annotations

import importlib.util
import os
import re
import sys
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from etendue import errors
from etendue.archive import places
from etendue.cli.bodies import runs
from etendue.cli.program import main
from etendue.contract.values.units import UnitError, to_unit
from etendue.errors import ArchiveError, PluginError
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.telling import LONGEST_LINE, MOST_LINES, foreign, plain, printable, said, told, where, without_folders

LONGEST = MOST_LINES * (LONGEST_LINE + 40)


@given(st.text())
def test_what_is_shown_holds_no_control_character_and_is_bounded(text):
    shown = plain(text * 50)
    assert all(c == "\n" or c.isprintable() or not (ord(c) < 32 or 127 <= ord(c) < 160) for c in shown)
    assert not set(shown) & set("\u202e\u202d\u2066\u2028\x1b\x00\x07\r")
    assert len(shown.split("\n")) <= MOST_LINES
    assert len(shown) <= LONGEST


@given(
    st.text(
        st.characters(exclude_categories=["C", "Zl", "Zp"], exclude_characters="/\u061c\u200e\u200f"),
        max_size=LONGEST_LINE,
    )
)
def test_ordinary_text_of_any_language_stays_as_it_is(text):
    assert printable(text) == text == plain(text)


def test_lines_that_are_left_out_are_counted_and_the_last_one_stays():
    shown = plain("\n".join(f"line {i}" for i in range(100))).split("\n")
    assert len(shown) == MOST_LINES
    assert shown[-2:] == [f"... ({100 - MOST_LINES + 1} more lines)", "line 99"]


def test_folders_of_this_machine_are_not_shown_and_nothing_else_is_taken_for_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    elsewhere = "/usr/share/x.dat"  # below no folder of packages, wherever this project lies
    assert without_folders(f"cannot read '{tmp_path}/data/a.csv': no") == "cannot read 'data/a.csv': no"
    assert without_folders(f"in {elsewhere}:3") == "in x.dat:3"
    for text in (
        "W m-2 nm-1/sr",
        "electron/s",
        "https://example.org/a/b",
        "tcp://host:1/x/y",
        "1/2/3",
        "a/b/c.py",
        "/nowhere/at/all",
    ):
        assert without_folders(text) == text


def test_an_exception_is_told_with_its_place_and_its_words_last():
    try:
        {}["missing"]
    except KeyError as error:
        lines = told(error).split("\n")
    assert lines[-1] == "KeyError: 'missing'"
    assert "test_telling.py:" in lines[0] and os.getcwd() not in lines[0]
    assert (
        said(PermissionError(13, "Permission denied", f"{sys.prefix}/secret"))
        == "PermissionError: Permission denied: secret"
    )


def test_foreign_code_breaks_off_as_a_plugin_error_and_refuses_as_it_is():
    with (
        pytest.raises(PluginError, match=r"Mine.grid failed: test_telling.py:\d+, SystemExit: 3"),
        foreign("Mine.grid"),
    ):
        raise SystemExit(3)
    for own in (ValueError("too small"), ArchiveError("damaged")):
        with pytest.raises(type(own), match=str(own)), foreign("Mine.grid"):
            raise own


def test_a_plugin_below_a_folder_named_like_the_package_keeps_its_file_and_line(tmp_path):
    folder = tmp_path / "etendue" / "plugins"
    folder.mkdir(parents=True)
    (folder / "mine.py").write_text("def grid():\n    return {}['missing']\n")
    spec = importlib.util.spec_from_file_location("mine_below_etendue", folder / "mine.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with pytest.raises(KeyError) as raised:
        module.grid()
    assert where(raised.value) == "mine.py:2, "


def test_our_own_code_is_not_the_place_at_which_a_plugin_broke():
    with pytest.raises(UnitError) as raised:
        to_unit("a b c", "m")
    assert where(raised.value).startswith("test_telling.py:")


def test_the_terminal_is_sent_nothing_that_a_file_or_a_plugin_says(capsys):
    bad = "\x1b[2Jred\x07\u202e[bold]"
    console = _out()
    console.print(escape(bad), bad.replace("[bold]", ""))
    table = _table("t", ("a", "left"))
    table.add_row(escape(bad))
    console.print(table)
    shown = capsys.readouterr().out
    assert "\x1b" not in shown and "\x07" not in shown and "\u202e" not in shown
    assert "[bold]" in shown


def test_every_class_of_errors_ends_with_the_code_that_its_page_says():
    said = dict(re.findall(r"(\w+Error|ArchiveInUse|StoreLost) .*exit (\d)", errors.__doc__))
    classes = [one for one in vars(errors).values() if isinstance(one, type) and issubclass(one, errors.EtendueError)]
    assert {one.__name__: str(one.exit_code) for one in classes if one is not errors.EtendueError} == said


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (MemoryError(), 5),
        (OSError(28, "No space left on device"), 5),
        (errors.MachineError("full"), 5),
        (errors.StoreLost("gone"), 1),
        (errors.ArchiveInUse("taken"), 4),
        (errors.ArchiveError("none"), 2),
        (errors.RequestError("wrong"), 2),
        (RuntimeError("a fault of ours"), 1),
    ],
)
def test_a_command_ends_with_the_code_of_what_stopped_it_and_one_line(error, code, monkeypatch):
    def stopped(*_, **__):
        raise error

    monkeypatch.setattr(places, "reading", stopped)
    done = CliRunner().invoke(main, ["show", "a"])
    assert done.exit_code == code
    assert done.stderr.count("\n") == 1 and done.stdout == ""


@pytest.mark.parametrize(("failed", "code"), [([], 0), (["a cell"], 3)])
@pytest.mark.parametrize("command", ["run", "rerun"])
def test_a_run_ends_with_three_where_a_cell_failed_also_when_it_is_run_again(command, failed, code, monkeypatch):
    made = SimpleNamespace(warnings=[], name="made")
    for name, does in {
        "pipeline_of": lambda *_: made,
        "planned": lambda *_: made,
        "with_kept_choices": lambda asked, *_: (asked, []),
        "recorded": lambda folder: SimpleNamespace(pipeline=lambda most: made),
        "execute": lambda *_: SimpleNamespace(failed=failed, answers=None),
        "_answers": lambda *_, **__: None,
        "outcome_document": lambda outcome: {},
    }.items():
        monkeypatch.setattr(runs, name, does)
    assert CliRunner().invoke(main, [command, "a", "--json"]).exit_code == code


@pytest.mark.parametrize("place", ["s3://bucket/a", "s3://bucket/a/"])
def test_the_place_that_was_asked_for_stands_where_the_folder_of_work_did(place, tmp_path):
    told = {"archive": tmp_path, "lines": [f"{tmp_path}/journal.jsonl is damaged"], "cells": 3}
    found = {"archive": "s3://bucket/a", "lines": ["s3://bucket/a/journal.jsonl is damaged"], "cells": 3}
    assert places.named(told, tmp_path, place) == found
    assert places.named(told, tmp_path, tmp_path) is told

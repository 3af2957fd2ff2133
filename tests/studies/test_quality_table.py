"""The table of ``etendue quality``: columns go where a terminal is narrow, numbers stay whole."""

import io
import re

import pytest
from rich.console import Console

from etendue_lab.quality import terminal
from etendue_lab.quality.figures import UNITS
from etendue_lab.quality.study import SCALARS
from etendue_lab.quality.terminal import COLUMNS, print_quality


def printed(monkeypatch, **options):
    """The table of two cells with every figure and two axes, as a console of so many columns has it."""
    row = dict.fromkeys((*UNITS, *SCALARS), 19.23456) | {"status": "done", "reason": "", "integration_time": 0.0125}
    axes = [{"name": "demosaic.use", "units": None}, {"name": "integration_time", "units": "s"}]
    rows = [row | {"demosaic.use": use} for use in ("demosaic_bilinear", "demosaic_colour_difference")]
    document = {
        "pipeline": "tiny",
        "axes": axes,
        "rows": rows,
        "ideal": {"left_out": [], "replaced": {}},
        "samples_per_degree": 34.0,
    }
    console = Console(file=io.StringIO(), highlight=False, color_system=None, **options)
    monkeypatch.setattr(terminal, "_out", lambda: console)
    print_quality(document | {"notes": [], "files": []})
    text = console.file.getvalue()
    return text, [line for line in text.splitlines() if line.lstrip().startswith("demosaic_")]


@pytest.mark.parametrize("width", [80, 100, 140])
def test_a_narrow_terminal_has_fewer_columns_and_every_number_whole(monkeypatch, width):
    text, rows = printed(monkeypatch, width=width, force_terminal=True)
    assert "…" not in text and len(rows) == 2
    assert all(
        len(line.rstrip()) <= width and set(re.findall(r"19\S*", line)) <= {"19.23", "19.2346", "19.2", "1923.46%"}
        for line in rows
    )
    assert ("more " in text) == (len(rows[0].split()) < 2 + len(COLUMNS))
    assert len(rows[0].split()) >= 5


def test_a_terminal_that_is_too_narrow_for_anything_cuts_no_number(monkeypatch):
    text, rows = printed(monkeypatch, width=30, force_terminal=True)
    assert "…" not in text and all("19.23" in line for line in rows)


def test_a_pipe_has_every_column(monkeypatch):
    text, rows = printed(monkeypatch, width=80)
    assert "…" not in text and "more " not in text
    assert all(len(line.split()) == 2 + len(COLUMNS) for line in rows)

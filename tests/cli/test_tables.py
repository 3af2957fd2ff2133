"""A table of a command is one set of rows: what a terminal prints stands in its JSON, row by row, column by column."""

import json
import re
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, NamedTuple

import numpy as np
import pytest

from etendue.accuracy.answers.error import AnswerError, AnswerErrors, Part
from etendue.contract.listing import quantity_document, role_documents, stage_document
from etendue.contract.registry import installed_stages
from etendue.contract.values import quantities
from etendue.pipeline.presets import preset_names
from etendue.present.terminal import terminal
from etendue.present.terminal.cells import cells
from etendue.present.terminal.outcome import outcome_document
from etendue.result_files import finite
from etendue_camera.cameras.bodies import body
from etendue_camera.cli import cameras
from etendue_camera.cli.sensors import sensor_document
from etendue_lab.calibrate.study import calibrated
from etendue_lab.compare import ranking
from etendue_lab.compare.compared import ComparedRow
from etendue_lab.compare.study import Comparison
from etendue_lab.designs.samples import Samples
from etendue_lab.designs.sensitivity import sensitivity
from etendue_lab.designs.yields import required, yields
from etendue_lab.emva.frames import measured
from etendue_lab.search.asked import Asked, Goal, Limit, Metric, Range
from etendue_lab.search.study import Found, Trial
from etendue_lab.stability.rows import LawCase, counts, document, groups, single
from tests.designs.given import samples
from tests.run.small import plan_of, run
from tests.studies.desk import measurement

ROOT = Path(__file__).parents[2]
WRITTEN = json.loads((ROOT / "tests" / "data" / "tables.json").read_text())  # by commands, with few rows
ENGINE, LAB = "etendue.present.terminal", "etendue_lab"


class Case(NamedTuple):
    """What is handed to ``print``, the JSON of the same command, and where the rows of its tables stand in it."""

    print: str
    tables: tuple[Callable[[Any], list[Any]], ...]
    given: Callable[[], tuple[tuple[Any, ...], Any]]
    derived: frozenset[str] = frozenset()  # what rows hold beside what stands in the JSON


def written(command: str, *more: Any) -> Callable[[], tuple[tuple[Any, ...], Any]]:
    return lambda: ((WRITTEN[command], *more), WRITTEN[command])


def a_list(documents: Callable[[], list[Any]]) -> Callable[[], tuple[tuple[Any, ...], Any]]:
    return lambda: ((own := documents(),), own)


def a_run() -> tuple[tuple[Any, ...], Any]:
    outcome = run(plan_of({"wanted": ["raw"]}))
    return (outcome,), outcome_document(outcome)


def an_answer() -> tuple[tuple[Any, ...], Any]:
    parts = {"bins": Part(0.2, 0.3), "spacing": Part(0.1, 0.2)}
    errors = {name: AnswerError("stage", name, unit, parts) for name, unit in (("picture", ""), ("level", "dB"))}
    document = AnswerErrors(errors, errors, {}).document()
    return (document,), document


def a_comparison() -> tuple[tuple[Any, ...], Any]:
    rows = [ComparedRow(use, use, psnr=30.0, seconds=0.1, mtf50=0.2, mtf50_reference=0.5) for use in ("one", "other")]
    place = ("demosaic", "rgb_camera")
    found = Comparison("small", "demosaic.use", rows, place, place, "", "1 frame", (4, 4), {}, [])
    return (found, []), ranking.document(found)


def a_search() -> tuple[tuple[Any, ...], Any]:
    asked = Asked(
        (Goal(Metric("mtf50", "mean"), True), Goal(Metric("noise"))),
        (Limit(Metric("clipped"), True, 0.1),),
        (Range("f_number", 1.0, 8.0), Range("demosaic.use", choices=("a", "b"))),
    )
    trials = [Trial(n, {"f_number": 2.0 + n, "demosaic.use": "a"}, (n / 3, n / 7), (n - 3.0,)) for n in range(5)]
    document = Found("small", asked, tuple(trials)).document()
    return (document,), document


def cases_of_laws(every: bool) -> tuple[tuple[Any, ...], Any]:
    rows = [LawCase("blur", law, "ordinary", True, 1e-7, 1e-6) for law in ("matrix", "digits")]
    return (single(rows) if every else groups(rows), every, counts(rows)), document(rows)


def sourced(name: str) -> Callable[[Any], list[Any]]:
    return lambda sensor: [{"key": key, **one} for key, one in sensor[name].items()]


def of(*names: str) -> Callable[[Any], Any]:
    def rows(document: Any) -> Any:
        for name in names:
            document = document[name]
        return document

    return rows


def measured_errors(found: Any) -> list[Any]:
    """A row of each variable, and one of what is encoded, before its encoding."""
    errors = [{"name": name, **one} for name, one in found["global_error"].items()]
    return [*errors, *({} for one in errors if "linear" in one)]


def real_frames() -> tuple[tuple[Any, ...], Any]:
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "frames.npz", **measurement(levels=8, stack=2, size=32))
        document = measured(Path(folder) / "frames.npz", None, None)
    return (document,), document


def a_calibration() -> tuple[tuple[Any, ...], Any]:
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "frames.npz", **measurement(levels=8, stack=2, size=32))
        document, _ = calibrated(Path(folder) / "frames.npz", check=True)
    return (document,), document


def of_a_design() -> Samples:
    spreads = {"a": {"normal": [10, 2]}, "b": {"normal": [5, 1]}}
    return samples(lambda a, b: {"sum": a + b}, "saltelli", 16, 0, spreads)


def what_matters() -> tuple[tuple[Any, ...], Any]:
    found = sensitivity(of_a_design(), ["sum"])
    return (found,), found


def a_yield() -> tuple[tuple[Any, ...], Any]:
    found = yields(of_a_design(), required(["sum >= 13"]))
    return (found,), found


MERGED = frozenset({"curve", "rest", "last"})
CASES = {
    "plan": Case(f"{ENGINE}.terminal:print_plan", (of("stages"),), written("plan")),
    "run": Case(f"{ENGINE}.outcome:print_outcome", (of("stages"),), a_run),
    "run --measure": Case(
        f"{ENGINE}.global_error:print_global_error",
        (measured_errors,),
        written("run"),
    ),
    "run, its answer": Case(
        f"{ENGINE}.answers:print_answers",
        (lambda found: [{"name": name, **one} for name, one in found["errors"].items()],),
        an_answer,
        frozenset({"mostly"}),
    ),
    "accuracy": Case(
        f"{ENGINE}.accuracy:print_accuracy",
        (
            lambda found: [p for curve in found["curves"] for p in curve["points"]],
            of("frontier"),
            of("cheapest"),
        ),
        written("accuracy", []),
        MERGED,
    ),
    "reproduce": Case(f"{ENGINE}.trust:print_reproduction", (of("stages"),), written("reproduce")),
    "diff": Case(f"{ENGINE}.trust:print_differences", (of("stages"),), written("diff")),
    "stages": Case(
        f"{ENGINE}.catalogue:print_stages",
        (lambda found: [*found, {}, {}],),  # below the headings of two roles
        lambda: (
            (own := [stage_document(installed_stages(), one) for one in ("adc", "mosaic")], role_documents()),
            own,
        ),
    ),
    "quantities": Case(
        f"{ENGINE}.catalogue:print_quantities", (of(),), a_list(lambda: [*map(quantity_document, quantities.names())])
    ),
    "sensors": Case(
        "etendue_camera.cli.sensors:print_sensors", (of(),), a_list(lambda: [*map(sensor_document, preset_names())])
    ),
    "sensors NAME": Case(
        "etendue_camera.cli.sensors:print_sensor",
        (sourced("camera"), sourced("facts")),
        lambda: ((own := next(one for name in preset_names() if (one := sensor_document(name))["facts"]),), own),
    ),
    "cameras": Case(
        "etendue_camera.cli.cameras:print_listing",
        (of("bodies"), of("lenses")),
        lambda: ((own := cameras.listing("raspberry", True, True),), own),
    ),
    "cameras NAME": Case(
        "etendue_camera.cli.cameras:print_one",
        (sourced("camera"), sourced("facts")),
        lambda: ((own := cameras.document_of(body("Raspberry Pi Camera Module 2 IMX219")),), own),
    ),
    "noise": Case(f"{LAB}.noise.terminal:print_noise", (of("mosaic"), of("rows")), written("noise")),
    "information": Case(
        f"{LAB}.information.terminal:print_information", (of("rows"), of("neq")), written("information")
    ),
    "losses": Case(f"{LAB}.losses.terminal:print_losses", (of("losses", 0, "stages"),), written("losses")),
    "emva": Case(f"{LAB}.emva.terminal:print_emva", (of("channels", 0, "figures"),), written("emva")),
    "calibrate": Case(
        f"{LAB}.calibrate.terminal:print_calibration",
        (of("channels", 0, "parameters"), of("checks", 0, "levels")),
        a_calibration,
    ),
    "emva FRAMES": Case(f"{LAB}.emva.frames:print_measured", (of("channels", 0, "figures"),), real_frames),
    "measure": Case(
        f"{LAB}.measure.terminal:print_photograph",
        (
            of("edges"),
            of("stars"),
            *[of("noise", 0, "channels")] * 2,  # in linear light, and in numbers of the file
            lambda found: [*found["chart"]["patches"], {}, {}],  # mean and max
        ),
        written("measure"),
    ),
    "sensitivity": Case(f"{LAB}.designs.terminal:print_sensitivity", (of("metrics", 0, "factors"),), what_matters),
    "yield": Case(
        f"{LAB}.designs.terminal:print_yields", (of("places", 0, "fails"), of("places", 0, "tighter")), a_yield
    ),
    "quality": Case(f"{LAB}.quality.terminal:print_quality", (of("rows"),), written("quality")),
    "optimise": Case(f"{LAB}.search.terminal:print_search", (of("best"),), a_search),
    "compare": Case(f"{LAB}.compare.ranking:print_comparison", (of("rows"),), a_comparison),
    **{
        f"stability{' --all' * every}": Case(
            f"{LAB}.stability.terminal:print_stability",
            (lambda found: [{}, *found["cases"]],),  # below the name of the stage
            partial(cases_of_laws, every),
            frozenset({"told", "cases", "verdict"}),
        )
        for every in (False, True)
    },
}


class Row(dict[str, Any]):
    """A row that tells which of its keys are read."""

    def __init__(self, row: Any) -> None:
        super().__init__(row)
        self.read: set[str] = set()

    def __getitem__(self, key: str) -> Any:
        self.read.add(key)
        return super().__getitem__(key)

    def get(self, key: str, *none: Any) -> Any:
        self.read.add(key)
        return super().get(key, *none)


@pytest.mark.parametrize("command", CASES)
def test_a_table_has_the_rows_and_columns_of_the_json(command, monkeypatch, capsys):
    case, drawn = CASES[command], []

    def drawing(columns, rows):
        if not isinstance(next(iter(rows), None), list):  # else a part of a wide table, already as text
            drawn.append((list(columns), list(rows)))
        return cells(columns, rows)

    monkeypatch.setattr(terminal, "cells", drawing)
    given, document = case.given()
    resolve_name(case.print)(*given)
    printed = capsys.readouterr().out
    found = json.loads(json.dumps(finite(document)))
    assert len(drawn) == len(case.tables)
    for (columns, rows), place in zip(drawn, case.tables, strict=True):
        own = place(found)
        assert len(rows) == len(own)
        keys = {key for row in own for key in row} | case.derived
        for column in columns:
            assert column[0].partition("\n")[0] in printed
            seen = [Row(row) for row in rows]
            assert len(cells([column], seen)) == len(own)
            read = set().union(*(row.read for row in seen))
            assert read and read <= keys, (column[0], read - keys)


def test_every_module_that_prints_a_table_is_under_this_law():
    own = {case.print.partition(":")[0] for case in CASES.values()}
    for path in (ROOT / "src").rglob("*.py"):
        text, module = path.read_text(), ".".join(path.relative_to(ROOT / "src").with_suffix("").parts)
        if module != f"{ENGINE}.terminal":
            taken = re.search(r"^from etendue\.present\.terminal\.terminal import .*_(table|print_whole)\b", text, re.M)
            assert not taken or module in own, module
            assert "rich.table" not in text or not re.search(r"\b(Table|add_column)\(", text), module

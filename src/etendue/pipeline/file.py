"""A pipeline file: shared quantities, stages, sweep, and wanted variables. Parses text into values and faults; no stage
is imported here.

In:  TOML text (or the same as a mapping), overrides from the command line.
Out: a ``PipelineFile`` whose entries still hold values as written; ``plan.wiring.graph`` resolves them against the
     stages.
"""

from __future__ import annotations

import re
import tomllib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from decimal import Decimal
from itertools import combinations
from pathlib import Path

from etendue import plain_files
from etendue.contract.values import quantities
from etendue.contract.values.bounds import LARGEST_FILE, MOST_CELLS, MOST_LISTED, document_fault, dotted_fault
from etendue.contract.values.names import unfit_stage
from etendue.contract.values.tables import Table, table_in, tables
from etendue.contract.values.units import as_written
from etendue.errors import Fault, RequestError, nearest
from etendue.pipeline.about import About, read_about
from etendue.pipeline.form import ARCHIVE, DIGITS, Words
from etendue.pipeline.overrides import TOP, apply_overrides, axes_of, axis_name, by_one_name
from etendue.pipeline.presets import preset_at
from etendue.pipeline.zipped import Zip, put_together, taken_apart
from etendue.types.documents import Document, DocumentView

PRECISIONS, NORMS = ("auto", "float32", "float64"), ("rms", "max")


@dataclass(frozen=True)
class StageEntry:
    """One ``[[stages]]`` table: values as written."""

    name: str
    use: str
    values: DocumentView
    origin: Mapping[str, str]  # from = { port = "stage" }
    place: str


class PipelineSource(ABC):
    """Base class of pipelines, whether read from a file or written in Python."""

    @abstractmethod
    def written(self) -> PipelineFile:
        """Return the pipeline as if it had been read from a file."""


@dataclass(frozen=True)
class PipelineFile(PipelineSource):
    """A pipeline as written; only its form has been checked."""

    name: str
    stages: tuple[StageEntry, ...]
    shared: DocumentView = field(default_factory=dict)  # quantities that stages share
    table: Table = field(default_factory=Table)  # the table of the file that holds them
    named: Mapping[str, str] = field(default_factory=dict)  # presets by the key that names them
    presets: Mapping[str, DocumentView] = field(default_factory=dict)  # their values by key; ``shared`` overrides them
    sweep: DocumentView = field(default_factory=dict)  # by axis its distinct values
    zipped: Mapping[str, Zip] = field(default_factory=dict)  # the axes that share a dim
    design: DocumentView = field(default_factory=dict)
    rows: Mapping[str, tuple[int, ...]] = field(default_factory=dict)  # rows of shared dims; without entry, all
    wanted: tuple[str, ...] | None = None
    keep: tuple[str, ...] | None = None  # None: all that is computed; LOOKS: pictures and metrics
    seed: int = 0
    tolerance: float = 1e-4
    norm: str = "rms"
    leave_out: bool = True  # whether stages that a scene does not need may be left out
    stand_ins: bool = True  # whether presets may have typical values where no source gives one
    precision: str = "auto"
    digits: str = DIGITS[0]  # digits of results: all, or those significant at the tolerance
    requires: tuple[str, ...] = ()  # distributions whose stages it uses
    most_cells: int = MOST_CELLS  # a larger sweep is refused
    variant: str = ""
    description: str = ""
    about: About = field(default_factory=About)
    file: str = ""
    folder: Path = Path(".")
    text: str = ""
    overrides: tuple[tuple[str, object], ...] = ()  # values from the command line that replace those of the file
    faults: tuple[Fault, ...] = ()  # faults of form; the planner reports them with its own faults
    whole: bool = True  # whether every stage table could be read
    lines: Mapping[str, int] = field(default_factory=dict)  # line numbers of tables and keys in the file

    def written(self) -> PipelineFile:
        return self

    @property
    def digits_left(self) -> float:
        """The tolerance to which the digits of results are rounded; 0: all digits are kept."""
        return 0.0 if self.digits == DIGITS[0] else self.tolerance

    @property
    def preset_name(self) -> str:
        """The preset that the table's first key names."""
        return self.named.get(self.table.preset, "")

    @property
    def preset(self) -> Document:
        """The values of all presets that are not an axis of the sweep."""
        return {name: v for word, own in self.presets.items() if word not in self.sweep for name, v in own.items()}

    @property
    def presets_swept(self) -> tuple[str, ...]:
        """The keys of presets that are an axis of the sweep."""
        return tuple(word for word in self.table.words() if word in self.sweep)

    def document(self) -> Document:
        """Return the document of a file from which this pipeline would be read."""
        lists, tables = ("wanted", "keep", "requires"), ("stages", "sweep", "design", "about", ARCHIVE)
        words = {word: getattr(self, word) for word in TOP if word not in (*lists, *tables)}
        names = {word: list(getattr(self, word)) for word in lists if getattr(self, word) is not None}
        shared = {**self.named, **self.shared}
        origins = {one.name: {"from": dict(one.origin)} if one.origin else {} for one in self.stages}
        stages = [{"use": one.use, "name": one.name, **origins[one.name], **one.values} for one in self.stages]
        return {
            **words,
            **names,
            self.table.name: shared,
            "sweep": put_together(self.sweep, self.zipped),
            **({"design": dict(self.design)} if self.design else {}),
            **({ARCHIVE: {"digits": self.digits}} if self.digits != DIGITS[0] else {}),
            "about": self.about.document(),
            "stages": stages,
        }

    def located(self, faults: Iterable[Fault]) -> list[Fault]:
        """Return the faults with their lines in the file, sorted by line."""
        found = [fault if fault.line else replace(fault, line=self._line(fault.place)) for fault in faults]
        return sorted(dict.fromkeys(found), key=lambda fault: fault.line or 0)

    def _line(self, place: str) -> int | None:
        stage = re.match(r"(stages\[\d+\])(?: [\w\-]+)?(?:\.([\w\-]+))?", place)
        if stage:
            return self.lines.get(f"{stage[1]}.{stage[2]}", self.lines.get(stage[1], 0)) or None
        while place and place not in self.lines:
            place = place.rpartition(".")[0]
        return self.lines.get(place, 0) or None


def read_pipeline(path: Path, overrides: DocumentView | None = None) -> PipelineFile:
    """Read a file and apply overrides such as ``{"TABLE.NAME": "4", "sweep.NAME": [...]}``.

    Raises
    ------
    RequestError
        If the file is missing, too large or not TOML. Faults of form are kept in the pipeline for ``make_plan`` to
        raise.

    Examples
    --------
    >>> from pathlib import Path
    >>> import etendue
    >>> etendue.read_pipeline(Path("pipelines/smallest.toml"), {"sweep.sharpen.strength": [0, 0.2]}).name
    'smallest'
    """
    name = str(path)
    try:
        piped = str(path).startswith(("/dev/stdin", "/dev/fd/", "/proc/self/fd/"))
        with path.open("rb") if piped else plain_files.open_plain(path) as file:
            content = file.read(LARGEST_FILE + 1)  # a pipe has no known size
        if len(content) > LARGEST_FILE:
            raise RequestError(f"the file is too large for a pipeline: more than {LARGEST_FILE} bytes", name)
        if content.count(b",") > MOST_LISTED:
            raise RequestError(
                f"the file lists more than {MOST_LISTED} values; write a long axis as {{ from, to, steps }}", name
            )
        text = content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except IsADirectoryError:
        raise RequestError("is a directory; give the pipeline file in it", name) from None
    except FileNotFoundError:
        folder = path.parent if path.parent.is_dir() else Path(".")
        hint = nearest(path.name, [p.name for p in folder.glob("*.toml")]).replace("; valid:", "; pipelines beside it:")
        raise RequestError(f"no such file{hint}", name) from None
    except (OSError, UnicodeDecodeError) as error:
        raise RequestError(f"cannot be read: {error}", name) from None
    return parse_pipeline(text, name, path.parent, overrides)


def parse_pipeline(
    text: str, file: str = "", folder: Path = Path("."), overrides: DocumentView | None = None
) -> PipelineFile:
    """Return the pipeline in a TOML text; ``file`` and ``folder`` are for messages and relative paths.

    Faults of form (unknown keys, two stages of one name) are kept in ``faults``, so that the planner can report them
    together with all other faults.
    """
    fault = dotted_fault(text)
    if fault:
        raise RequestError([fault], file)
    try:
        document = tomllib.loads(text, parse_float=Decimal)
    except RecursionError:
        raise RequestError("not valid TOML: nested too deeply", file) from None
    except ValueError as error:  # TOMLDecodeError, or a number of thousands of digits
        raise RequestError([_not_toml(text, str(error))], file) from None
    lines = _lines(text)
    refuse_large(document, file, lines)
    given = by_one_name(overrides or {}, document)
    for place in apply_overrides(document, given, file):
        lines[place] = 0  # the value is no longer the one in the file
    return replace(
        from_document(document, file, folder), folder=folder, text=text, lines=lines, overrides=tuple(given.items())
    )


def overridden(pipeline: PipelineFile, overrides: DocumentView) -> PipelineFile:
    """Return a pipeline with other values, as if its file had contained them."""
    document = pipeline.document()
    given = by_one_name(overrides, document)
    lines = {**pipeline.lines, **dict.fromkeys(apply_overrides(document, given, pipeline.file), 0)}
    made = from_document(document, pipeline.file, pipeline.folder)
    return replace(
        made,
        folder=pipeline.folder,
        text=pipeline.text,
        lines=lines,
        overrides=tuple({**dict(pipeline.overrides), **given}.items()),
        faults=tuple(dict.fromkeys((*pipeline.faults, *made.faults))),
        whole=pipeline.whole and made.whole,
    )


def refuse_large(document: DocumentView, file: str = "", lines: Mapping[str, int] = {}) -> None:
    """Refuse a document that is too large: too many keys, nested too deeply, a number of too many digits."""
    fault = document_fault(document)
    if fault:
        raise RequestError([replace(fault, line=lines.get(fault.place))], file)


def _not_toml(text: str, message: str) -> Fault:
    """Return the fault of a text that is not TOML, with the line and the usual reason, which the parser's message
    omits.
    """
    match = re.search(r" \(at line (\d+), column \d+\)$", message)
    if not match:
        return Fault("", f"not valid TOML: {message}")
    number = int(match[1])
    line = text.splitlines()[number - 1] if number <= len(text.splitlines()) else ""
    line = re.sub(r"\s#[^\"']*$", "", line).strip()[:80]  # without its comment
    reason = message[: match.start()]
    hint = ""
    if "overwrite" in reason or "twice" in reason:
        hint = "; a key or a table appears twice"
    elif "newline" in reason or "Invalid value" in reason:
        hint = '; text, and a number with a unit, must be in quotes: "5.4 um"'
    return Fault("", f"not valid TOML: {reason}: {line!r}{hint}" if line else f"not valid TOML: {reason}{hint}", number)


_HEADER = re.compile(r"^\s*(\[\[?)\s*([\w.\-]+)\s*\]\]?\s*(?:#.*)?$")
_KEY = re.compile(r"""^\s*([\w\-]+(?:\s*\.\s*[\w\-]+)*|"[^"]*"|'[^']*')\s*=""")


def _lines(text: str) -> dict[str, int]:
    """Return line numbers of tables and keys: ``stages[3]``, ``stages[3].strength``, ``TABLE.NAME``, ``seed``."""
    found: dict[str, int] = {}
    table, stages, inside = "", 0, ""
    for number, line in enumerate(text.splitlines(), 1):
        if inside:  # inside a multi-line string
            inside = "" if line.count(inside) % 2 else inside
            continue
        header, key = _HEADER.match(line), _KEY.match(line)
        if header:
            table = header[2]
            if (header[1], table) == ("[[", "stages"):
                stages += 1
                table = f"stages[{stages}]"
            elif table.startswith("stages."):
                table = f"stages[{stages}]{table.removeprefix('stages')}"
            found.setdefault(table, number)
        elif key:
            name = re.sub(r"\s", "", key[1]) if key[1][0] not in "\"'" else key[1][1:-1]
            found.setdefault(f"{table}.{name}" if table else name, number)
        inside = next((mark for mark in ('"""', "'''") if line.count(mark) % 2), "")
    axes = {
        f"sweep.{axis_name(place.removeprefix('sweep.'), {})}": n
        for place, n in found.items()
        if place.startswith("sweep.")
    }
    return {**axes, **found}


def from_document(document: DocumentView, file: str = "", folder: Path = Path(".")) -> PipelineFile:
    """Return a pipeline from a document. Faults of its form are in ``faults``; a document beyond the size limits is
    refused.
    """
    refuse_large(document, file, {})
    faults: list[Fault] = []
    table = table_in(document)
    for key in document:
        if key not in (*TOP, table.name):
            faults.append(Fault(key, f"unknown key{_meant(key, table)}"))
    words = Words(document, faults)

    seed, tolerance, norm = words.whole("seed", 0, 0), words.share("tolerance", 1e-4), words.choice("norm", NORMS)
    most_cells, leave_out = words.whole("most_cells", MOST_CELLS, 1), words.flag("leave_out", True)
    precision, norm, digits = (
        words.choice("precision", PRECISIONS),
        words.choice("norm", NORMS),
        words.digits(tolerance),
    )
    shared = words.table(table.name)
    words.table("sweep")  # reports a fault if it is not a table
    sweep, zipped = taken_apart(axes_of(document, faults), faults)
    named, presets = _presets(table, shared, sweep, folder, faults)
    stages, whole = _stages(document.get("stages"), faults)
    return PipelineFile(
        name=words.name(Path(file).stem or "pipeline"),
        stages=stages,
        shared={key: value for key, value in shared.items() if key not in table.words()},
        table=table,
        named=named,
        presets=presets,
        sweep=sweep,
        zipped=zipped,
        design=words.table("design"),
        wanted=words.names("wanted"),
        keep=words.names("keep"),
        seed=seed,
        tolerance=tolerance,
        norm=norm,
        leave_out=leave_out,
        stand_ins=words.flag("stand_ins", True),
        precision=precision,
        digits=digits,
        requires=words.names("requires") or (),
        most_cells=most_cells,
        variant=words.text("variant", ""),
        description=words.text("description", ""),
        about=read_about(document.get("about", {}), faults),
        file=file,
        faults=tuple(faults),
        whole=whole,
    )


def _meant(key: str, table: Table) -> str:
    """Return a hint at the key that an unknown key may have been meant for."""
    if key in tables():
        return f"; this file already has its quantities under [{table.name}]"
    if key in quantities.names():
        return f"; {key} is a {table.name} quantity, set under [{table.name}]"
    return nearest(key, [*TOP, *tables()])


def _presets(
    table: Table, shared: DocumentView, sweep: DocumentView, folder: Path, faults: list[Fault]
) -> tuple[dict[str, str], dict[str, Document]]:
    """Return the presets that a table names and their values, by key; the names themselves are not quantities."""
    named, values = dict[str, str](), dict[str, Document]()
    for kind in table.kinds():
        name, place = shared.get(kind.preset, ""), table.place(kind.preset)
        if not isinstance(name, str):
            faults.append(Fault(place, f"expected the name of a {kind.preset}, got {as_written(name)}"))
        elif name and kind.find and kind.preset in sweep:
            named[kind.preset] = name  # without effect: its axis sets the values, and it may not be found here
        elif name:
            try:
                values[kind.preset] = preset_at(name, kind, folder).values()
                named[kind.preset] = name
            except RequestError as error:
                faults += [Fault(place, fault.message) for fault in error.faults]
    for first, second in combinations(values, 2):
        if both := sorted(values[first].keys() & values[second].keys()):
            more = f" and {len(both) - 3} more" if len(both) > 3 else ""
            what = f"{', '.join(both[:3])}{more}"
            faults.append(Fault(table.place(second), f"{first} and {second} both give {what}; name only one of them"))
    return named, values


def _stages(value: object, faults: list[Fault]) -> tuple[tuple[StageEntry, ...], bool]:
    """Return the stages that could be read, and whether all stages could be read."""
    if not isinstance(value, list) or not value:
        faults.append(Fault("stages", "expected at least one [[stages]] table with a key 'use'"))
        return (), False
    entries, seen, whole = [], dict[str, str](), True
    for number, table in enumerate(value, 1):
        place = f"stages[{number}]"
        use = table.get("use") if isinstance(table, dict) else None
        if not isinstance(table, dict):
            faults.append(Fault(place, f"expected a table, got {as_written(table)}"))
        elif not isinstance(use, str):
            got = f", got {as_written(use)}" if use is not None else ""
            faults.append(Fault(place, f"requires a key 'use' with the name of a stage{got}; see: etendue stages"))
        if not isinstance(use, str):
            whole = False
            continue
        name = table.get("name", use)
        unfit = unfit_stage(name) if isinstance(name, str) else "expected letters, digits and _"
        if unfit:
            faults.append(Fault(f"{place}.name", unfit if "table" in unfit else f"{unfit}, got {as_written(name)}"))
            whole = False
            continue
        place = f"{place} {name}"
        if name in seen:
            faults.append(Fault(place, f"{name!r} is also the name of {seen[name]}; give one of them another 'name'"))
            continue
        seen[name] = place.partition(" ")[0]
        origin = table.get("from", {})
        if not isinstance(origin, dict) or not all(isinstance(v, str) for v in origin.values()):
            faults.append(Fault(f"{place}.from", 'expected a table of ports and stages, such as { PORT = "STAGE" }'))
            origin = {}
        values = {key: v for key, v in table.items() if key not in ("use", "name", "from")}
        entries.append(StageEntry(name, use, values, origin, place))
    return tuple(entries), whole

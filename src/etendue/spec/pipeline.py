"""A pipeline file: camera, stages, sweep, what is wanted. Text in, values and faults out; no stage is imported here.

In:  TOML text (or the same as a mapping), overrides from the command line.
Out: a ``Pipeline`` whose entries still hold values as written; ``plan.graph`` resolves them against the stages.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

from etendue.errors import Fault, RequestError, nearest

TOP = ("name", "seed", "tolerance", "precision", "wanted", "keep", "camera", "stages", "sweep", "variant", "description")
LARGEST_FILE = 1 << 20


@dataclass(frozen=True)
class StageEntry:
    """One ``[[stages]]`` table: values as written."""

    name: str
    use: str
    values: Mapping[str, Any]
    origin: Mapping[str, str]  # from = { port = "stage" }
    place: str


@dataclass(frozen=True)
class Pipeline:
    """A pipeline as written, checked for form only."""

    name: str
    stages: tuple[StageEntry, ...]
    camera: Mapping[str, Any] = field(default_factory=dict)
    sweep: Mapping[str, Any] = field(default_factory=dict)
    wanted: tuple[str, ...] | None = None
    keep: tuple[str, ...] | None = None  # None: all that is computed
    seed: int = 0
    tolerance: float = 1e-4
    precision: str = "auto"
    variant: str = ""
    description: str = ""
    file: str = ""
    folder: Path = Path(".")
    text: str = ""


def _finite(value: Any, place: str, faults: list[Fault]) -> None:
    if isinstance(value, float | Decimal) and not math.isfinite(float(value)):
        faults.append(Fault(place, f"{value} is not a finite number"))


def read_pipeline(path: Path, overrides: Mapping[str, Any] | None = None) -> Pipeline:
    """Read a file and apply ``{"camera.f_number": "4", "sweep.f_number": [...]}`` on top of it.

    Raises
    ------
    RequestError
        The file is missing, too large, not TOML, or of the wrong form; all faults of form at once.
    """
    name = str(path)
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise RequestError(f"the file is larger than {LARGEST_FILE} bytes; that is no pipeline", name)
        text = path.read_text(encoding="utf-8")
    except IsADirectoryError:
        raise RequestError("is a directory; name the pipeline file in it", name) from None
    except FileNotFoundError:
        folder = path.parent if path.parent.is_dir() else Path(".")
        hint = nearest(path.name, [p.name for p in folder.glob("*.toml")])
        raise RequestError(f"there is no such file{hint}", name) from None
    except (OSError, UnicodeDecodeError) as error:
        raise RequestError(f"cannot be read: {error}", name) from None
    return parse_pipeline(text, name, path.parent, overrides)


def parse_pipeline(text: str, file: str = "", folder: Path = Path("."), overrides: Mapping[str, Any] | None = None) -> Pipeline:
    """The pipeline in a TOML text; ``file`` and ``folder`` serve messages and relative paths."""
    try:
        document = tomllib.loads(text, parse_float=Decimal)
    except tomllib.TOMLDecodeError as error:
        raise RequestError(f"not valid TOML: {error}", file) from None
    except RecursionError:
        raise RequestError("not valid TOML: nested too deeply", file) from None
    apply_overrides(document, overrides or {}, file)
    return replace(from_document(document, file), folder=folder, text=text)


def apply_overrides(document: dict[str, Any], overrides: Mapping[str, Any], file: str = "") -> None:
    """Put ``camera.x``, ``sweep.axis``, ``<stage>.<parameter>`` or a top-level key into the document."""
    faults = []
    for key, value in overrides.items():
        head, _, tail = key.partition(".")
        stages = document.get("stages")
        named = {str(s.get("name", s.get("use"))): s for s in stages if isinstance(s, dict)} if isinstance(stages, list) else {}
        if head in ("camera", "sweep") and tail:
            document.setdefault(head, {})[tail] = value
            if head == "camera" and isinstance(document.get("sweep"), dict):
                document["sweep"].pop(tail, None)
        elif tail and head in named:
            named[head][tail] = value
            if isinstance(document.get("sweep"), dict):
                document["sweep"].pop(key, None)
        elif not tail and head in TOP:
            document[head] = value
        else:
            valid = [*named, "camera", "sweep"] if tail else [*TOP]
            faults.append(Fault(f"--set {key}", f"there is no {head!r} to set{nearest(head, valid)}"))
    if faults:
        raise RequestError(faults, file)


def from_document(document: Mapping[str, Any], file: str = "") -> Pipeline:
    """Check the form of a document; raises ``RequestError`` with every fault of form."""
    faults: list[Fault] = []
    for key in document:
        if key not in TOP:
            faults.append(Fault(key, f"unknown key{nearest(key, TOP)}"))

    def text_of(key: str, default: str) -> str:
        value = document.get(key, default)
        if not isinstance(value, str) or (key == "name" and (not value or "/" in value or value.startswith("."))):
            faults.append(Fault(key, f"expected {'a plain name' if key == 'name' else 'text'}, got {value!r}"))
            return default
        return value

    def names_of(key: str) -> tuple[str, ...] | None:
        value = document.get(key)
        if value is None or (key == "keep" and value == "all"):
            return None
        if isinstance(value, str):
            value = [value]
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            faults.append(Fault(key, f"expected a list of variables, got {value!r}"))
            return None
        return tuple(value)

    seed = document.get("seed", 0)
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        faults.append(Fault("seed", f"expected a whole number of at least 0, got {seed!r}"))
        seed = 0
    tolerance = document.get("tolerance", 1e-4)
    if isinstance(tolerance, bool | str) or not 0 <= float(tolerance) < 1:
        faults.append(Fault("tolerance", f"expected a number of at least 0 and below 1, got {tolerance!r}"))
        tolerance = 1e-4
    precision = text_of("precision", "auto")
    if precision not in ("auto", "float32", "float64"):
        faults.append(Fault("precision", f"{precision!r} is not a precision{nearest(precision, ('auto', 'float32', 'float64'))}"))
    tables = {}
    for key in ("camera", "sweep"):
        table = document.get(key, {})
        if not isinstance(table, dict):
            faults.append(Fault(key, f"expected a table, got {table!r}"))
            table = {}
        tables[key] = table
        for name, value in table.items():
            _finite(value, f"{key}.{name}", faults)
    pipeline = Pipeline(
        name=text_of("name", Path(file).stem or "pipeline"),
        stages=_stages(document.get("stages"), faults),
        camera=tables["camera"],
        sweep=tables["sweep"],
        wanted=names_of("wanted"),
        keep=names_of("keep"),
        seed=seed,
        tolerance=float(tolerance),
        precision=precision,
        variant=text_of("variant", ""),
        description=text_of("description", ""),
        file=file,
    )
    if faults:
        raise RequestError(faults, file)
    return pipeline


def _stages(value: Any, faults: list[Fault]) -> tuple[StageEntry, ...]:
    if not isinstance(value, list) or not value:
        faults.append(Fault("stages", "expected at least one [[stages]] table with a key 'use'"))
        return ()
    entries, seen = [], dict[str, str]()
    for number, table in enumerate(value, 1):
        place = f"stages[{number}]"
        if not isinstance(table, dict):
            faults.append(Fault(place, f"expected a table, got {table!r}"))
            continue
        use = table.get("use")
        if not isinstance(use, str):
            faults.append(Fault(place, "needs a key 'use' with the name of a stage"))
            continue
        name = table.get("name", use)
        if not isinstance(name, str) or not name.replace("_", "a").replace("-", "a").isalnum():
            faults.append(Fault(f"{place}.name", f"expected letters, digits and _, got {name!r}"))
            continue
        place = f"{place} {name}"
        if name in seen:
            faults.append(Fault(place, f"two stages are named {name!r}: this and {seen[name]}; give one another 'name'"))
        seen.setdefault(name, place)
        origin = table.get("from", {})
        if not isinstance(origin, dict) or not all(isinstance(v, str) for v in origin.values()):
            faults.append(Fault(f"{place}.from", "expected a table of ports and stages, such as { irradiance = \"falloff\" }"))
            origin = {}
        values = {key: v for key, v in table.items() if key not in ("use", "name", "from")}
        for key, v in values.items():
            _finite(v, f"{place}.{key}", faults)
        entries.append(StageEntry(name, use, values, origin, place))
    return tuple(entries)

"""Options shared by several commands, each declared once, and the objects they give.

In:  arguments of the command line.
Out: ``Given``, which reads the pipeline.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from etendue.errors import Fault, RequestError
from etendue.run.schedulers import NAMES, check_scheduler
from etendue.types.documents import Document

if TYPE_CHECKING:
    from etendue.contract.registry import Registry
    from etendue.pipeline.file import PipelineFile
    from etendue.present.terminal.progress import TerminalProgress
    from etendue.session import Options


class _Place(click.ParamType):  # type: ignore[type-arg]  # a generic to mypy; before click 8.4 it cannot be subscripted
    """Location of an archive: a folder, or ``s3://bucket/prefix/name``."""

    name = "place"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path | str:
        return str(value) if "://" in str(value) else Path(value)


class _Held(click.ParamType):  # type: ignore[type-arg]
    """``E`` for all variables, or ``METRIC=E``; parsed to (metric, error limit), '' for all."""

    name = "error"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, float]:
        if isinstance(value, tuple):  # converted before
            return value
        metric, _, text = str(value).rpartition("=")
        try:
            error = float(text)
        except ValueError:
            self.fail(f"{value!r} is neither a number nor METRIC=NUMBER, such as contrast=0.1", param, ctx)
        if not 0 < error <= (math.inf if metric else 1.0):
            self.fail(f"{error:g} must be above 0{'' if metric else ' and at most 1'}", param, ctx)
        return metric.strip(), error


class _Folder(click.ParamType):  # type: ignore[type-arg]
    """A local folder; URLs are refused."""

    name = "folder"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        if "://" in str(value):
            self.fail(
                f"{value}: must be a local folder; upload it to the object store when it is complete",
                param,
                ctx,
            )
        return Path(value)


PLACE, FOLDER, HELD = _Place(), _Folder(), _Held()
Adds = Callable[[Any], Any]
REPEAT = "; may be repeated."
WORDS = ("method", "points", "seed", "file", "rows", "correlation")  # of a design; other names are factors
SETTING = "Override a value: QUANTITY=4 or STAGE.PARAMETER=0.3" + REPEAT
FILE = click.argument("file", type=click.Path(path_type=Path))
NAME = click.argument("name", required=False)
SWEEPS = click.option(
    "--sweep",
    "sweeps",
    multiple=True,
    metavar="AXIS=V,V,..",
    help="Sweep an axis: QUANTITY=1,2,4, STAGE.PARAMETER=0,1 or STAGE.use=a,b" + REPEAT,
)
DESIGNS = click.option(
    "--design",
    "designs",
    multiple=True,
    metavar="NAME=VALUE",
    help='Draw values of parameters: method=sobol, points=256, seed=1, or a factor such as "gain={ from = 1, to = 8 }"'
    + REPEAT,
)
WANT = click.option(
    "--want", multiple=True, metavar="VARIABLE", help="Compute only this variable (or stage.variable)" + REPEAT
)
TOLERANCE = click.option(
    "--tolerance",
    metavar="T",
    help="Error that one approximation or omission may add to the output of its stage, relative to full scale.",
)
ROUND = click.option(
    "--digits",
    metavar="D",
    help="Digits of stored pictures: exact (all), or stated (only those that are significant at the tolerance).",
)
NOTHING_LEFT_OUT = click.option(
    "--nothing-left-out",
    is_flag=True,
    help="Use the reference: every stage, in 64 bits, with every accuracy setting that the file omits at its finest.",
)
NO_STAND_INS = click.option(
    "--no-stand-ins",
    is_flag=True,
    help="Refuse presets that contain stand-ins (typical values, used if no source gives a value), and list the "
    "stand-ins.",
)
JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON on stdout.")
SCHEDULER = click.option(
    "--scheduler",
    default="threads",
    show_default=True,
    metavar="S",
    help=f"{NAMES}.",
)
MOST_CELLS = click.option(
    "--most-cells",
    type=click.IntRange(1),
    metavar="N",
    help="Maximum number of cells of the archive's pipeline. Default: 1,000,000, even if the pipeline states "
    "another limit.",
)
WORKERS = click.option(
    "--workers", type=click.IntRange(1), metavar="N", help="Number of threads or processes. Default: one per core."
)


def from_here(here: Path, place: Path | str) -> Path | str:
    """Resolve a place against ``here``, the working directory at the start, because a plugin may change it."""
    return here / place if isinstance(place, Path) else place


def settings(example: str = SETTING) -> Adds:
    return click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help=example)


def output(help: str) -> Adds:
    return click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FOLDER", help=help)


@dataclass(frozen=True)
class Given:
    """The options of a command line that describe a pipeline."""

    file: Path
    settings: tuple[str, ...] = ()
    sweeps: tuple[str, ...] = ()
    designs: tuple[str, ...] = ()
    want: tuple[str, ...] = ()
    tolerance: str | None = None
    digits: str | None = None
    nothing_left_out: bool = False
    no_stand_ins: bool = False

    def pipeline(self) -> PipelineFile:
        from etendue.pipeline.file import read_pipeline

        return read_pipeline(self.file, overrides(self))


@dataclass(frozen=True)
class Way:
    """Options for running a command and for its output during the run."""

    scheduler: str = "threads"
    workers: int | None = None
    quiet: bool = False
    as_json: bool = False

    @property
    def silent(self) -> bool:
        return self.quiet or self.as_json

    def options(self, **more: Any) -> Options:
        """The options of a run."""
        from etendue.session import Options

        return Options(check_scheduler(self.scheduler), self.workers or 0, **more)


def installed() -> Registry:
    """Return the registry of all installed stages."""
    from etendue.contract.registry import installed_stages

    return installed_stages()


def progress(silent: bool) -> type[TerminalProgress] | None:
    """Return the class that shows the progress of a plan; None if silent."""
    from etendue.present.terminal.progress import TerminalProgress

    return None if silent else TerminalProgress


def _gathered(kind: type[Any], name: str) -> Adds:
    """Return a decorator that collects the options named by a dataclass into one argument."""

    def adds(function: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(function)
        def gathering(**words: Any) -> None:
            own = {field.name: words.pop(field.name) for field in fields(kind) if field.name in words}
            function(**{name: kind(**own)}, **words)

        return gathering

    return adds


gather, gather_way = _gathered(Given, "given"), _gathered(Way, "way")


def pipeline_options(function: Callable[..., None]) -> Any:
    """Add all options that describe a pipeline."""
    for option in (
        gather,
        JSON,
        NO_STAND_INS,
        NOTHING_LEFT_OUT,
        ROUND,
        TOLERANCE,
        WANT,
        DESIGNS,
        SWEEPS,
        settings(),
        FILE,
    ):
        function = option(function)
    return function


def number(text: str) -> Any:
    """Parse a command-line value: number, true/false, list, table, or text (units allowed)."""
    from decimal import Decimal, InvalidOperation

    stripped = text.strip()
    if stripped in ("true", "false"):
        return stripped == "true"
    if stripped.startswith("[") or stripped.startswith("{"):
        import tomllib

        try:
            return tomllib.loads(f"v = {stripped}", parse_float=Decimal)["v"]
        except (ValueError, RecursionError):
            return stripped
    try:
        value = Decimal(stripped)
    except InvalidOperation:
        return stripped
    whole = stripped.lstrip("+-").isdigit()
    return int(value) if whole else value


def knob_settings(words: tuple[str, ...]) -> dict[str, tuple[Any, ...]]:
    """Parse ``STAGE.KNOB`` or ``STAGE.KNOB=V,V,..`` into the settings of each knob; () for a knob without settings.

    Raises
    ------
    RequestError
        A knob is given twice, or a setting is neither a number nor a word.
    """
    from decimal import Decimal

    found: dict[str, tuple[Any, ...]] = {}
    for text in words:
        key, equals, rest = (part.strip() for part in text.partition("="))
        values = [number(part) for part in rest.split(",")] if equals else []
        if not key or key in found or any(isinstance(value, list | dict) or value == "" for value in values):
            raise RequestError([Fault(f"--knob {text}", "expected STAGE.KNOB or STAGE.KNOB=V,V,.., each knob once")])
        found[key] = tuple(float(value) if isinstance(value, Decimal) else value for value in values)
    return found


def overrides(given: Given) -> Document:
    """Return the values that override values of the file.

    Raises
    ------
    RequestError
        A setting is not ``name=value``.
    """
    found: Document = {}
    faults = []
    for option, texts in (("--set", given.settings), ("--sweep", given.sweeps), ("--design", given.designs)):
        for text in texts:
            key, equals, value = text.partition("=")
            if not equals or not key.strip():
                faults.append(Fault(f"{option} {text}", "expected name=value"))
                continue
            if option == "--set":
                found[key.strip()] = number(value)
            else:
                written = value.strip().startswith(("[", "{"))  # as it would stand in the file
                words = option == "--design" and key.strip() in WORDS
                place = "design." if words else "design.factors." if option == "--design" else "sweep."
                listed = not (written or words)
                found[f"{place}{key.strip()}"] = [number(v) for v in value.split(",")] if listed else number(value)
    if faults:
        raise RequestError(faults)
    if given.want:
        found["wanted"] = [v for text in given.want for v in text.split(",")]
    if given.tolerance is not None:
        found["tolerance"] = number(given.tolerance)
    if given.digits is not None:
        found["archive.digits"] = given.digits
    if given.no_stand_ins:
        found["stand_ins"] = False
    return found

"""A pipeline written in Python: the content of a pipeline file, as an immutable value that is built by method calls.

In:  placed stages, shared quantities, axes of a sweep, wanted variables.
Out: the same pipeline as TOML, its plan, its results, studies of it.
"""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.builder.methods import Extended
from etendue.builder.shown import Planned, table_page
from etendue.builder.simulating import at_choices_of, opened, with_errors
from etendue.builder.stages import Placed, maker, plain
from etendue.calls import called_methods
from etendue.contract.registry import installed_stages
from etendue.contract.stage import Stage
from etendue.contract.values import quantities as shared_quantities
from etendue.contract.values.tables import SHARED, preset_keys, tables
from etendue.errors import Fault, RequestError, nearest
from etendue.evaluation.session import BYTES, Session
from etendue.pipeline import toml
from etendue.pipeline.file import PipelineFile as Written
from etendue.pipeline.file import PipelineSource, parse_pipeline, read_pipeline
from etendue.pipeline.overrides import TOP, axis_name
from etendue.pipeline.zipped import put_together
from etendue.plan.planner import make_plan
from etendue.present.terminal.progress import TerminalProgress
from etendue.run.schedulers import check_scheduler
from etendue.session import Options, execute
from etendue.types.documents import Document, DocumentView

if TYPE_CHECKING:
    from etendue.session import Outcome

APART = {"stages", "sweep", "design", "about"}  # keys of a pipeline file that have methods of their own


def span(first: Any, last: Any, steps: int, spacing: str = "linear") -> Document:
    """Return evenly spaced values for an axis: ``span("1 um", "3 um", 5)``; ``spacing``: ``linear`` or ``log``.

    Examples
    --------
    >>> import etendue
    >>> etendue.span("1 um", "3 um", 5)
    {'from': '1 um', 'to': '3 um', 'steps': 5, 'spacing': 'linear'}
    """
    return {"from": first, "to": last, "steps": steps, "spacing": spacing}


@called_methods
@dataclass(frozen=True)
class Pipeline(Extended, PipelineSource):
    """A graph of stages: placed stages in order, and everything else that a pipeline file can state.

    Every method returns a new pipeline and leaves the original unchanged.

    Parameters
    ----------
    *stages : ``etendue.stages.NAME(...)``, in their order
    name, seed, tolerance, ... : keys of a pipeline file

    Examples
    --------
    >>> import etendue
    >>> made = etendue.Pipeline.read("pipelines/smallest.toml").sweep(sharpen__strength=[0, 0.2, 0.4])
    >>> made.axes["sharpen.strength"]
    [0, 0.2, 0.4]
    >>> print(made.to_toml().partition("\\n")[0])
    name = "smallest"
    """

    stages: tuple[Placed, ...]
    words: DocumentView = field(default_factory=dict)
    quantities: DocumentView = field(default_factory=dict)
    axes: DocumentView = field(default_factory=dict)
    drawn: DocumentView = field(default_factory=dict)  # the design
    told: DocumentView = field(default_factory=dict)
    table: str = SHARED  # the name of the table of shared quantities
    folder: Path = Path(".")

    def __init__(self, *stages: Placed, name: str = "pipeline", **words: Any) -> None:
        faults = [Fault(f"stage {n}", _no_stage(one)) for n, one in enumerate(stages, 1) if not isinstance(one, Placed)]
        faults += [Fault(word, _no_word(word)) for word in words if word not in TOP or word in APART]
        if faults:
            raise RequestError(faults)
        object.__setattr__(self, "stages", tuple(stages))
        object.__setattr__(self, "words", {"name": name, **{key: plain(value) for key, value in words.items()}})
        for one in ("quantities", "axes", "drawn", "told"):
            object.__setattr__(self, one, {})
        object.__setattr__(self, "table", next(iter(tables())))
        object.__setattr__(self, "folder", Path.cwd())

    # -- construction ------------------------------------------------------------------------------------------------

    @classmethod
    def read(cls, path: str | Path) -> Pipeline:
        """Read the pipeline of a file, to change it; its comments are lost. Relative paths remain relative to the
        folder of the file.
        """
        written = read_pipeline(Path(path))
        if written.faults:
            raise RequestError(written.located(written.faults), written.file)
        document = tomllib.loads(written.text)
        made = cls(name=written.name)
        words = {key: value for key, value in document.items() if key not in (*APART, *tables())}
        return made._with(
            stages=tuple(_placed(table) for table in document["stages"]),
            words={"name": written.name, **words},
            quantities=document.get(written.table.name, {}),
            table=written.table.name,
            axes=put_together(written.sweep, written.zipped),
            drawn=document.get("design", {}),
            told=document.get("about", {}),
            folder=Path(path).parent.absolute(),
        )

    def _with(self, **parts: Any) -> Pipeline:
        made = copy.copy(self)
        for name, value in parts.items():
            object.__setattr__(made, name, value)
        return made

    def add(self, *stages: Placed) -> Pipeline:
        """Return the pipeline with further stages at the end."""
        return replaced(self, (*self.stages, *stages))

    def insert(self, before: str, *stages: Placed) -> Pipeline:
        """Return the pipeline with further stages in front of the named one."""
        at = self._position(before)
        return replaced(self, (*self.stages[:at], *stages, *self.stages[at:]))

    def swap(self, name: str, stage: Placed) -> Pipeline:
        """Return the pipeline with the named stage replaced by another, under the same name."""
        at = self._position(name)
        if isinstance(stage, Placed):
            stage = replace(stage, name=name)
        return replaced(self, (*self.stages[:at], stage, *self.stages[at + 1 :]))

    def remove(self, *names: str) -> Pipeline:
        """Return the pipeline without the named stages."""
        gone = {self._position(name) for name in names}
        return replaced(self, tuple(one for at, one in enumerate(self.stages) if at not in gone))

    def stage(self, name: str, **values: Any) -> Pipeline:
        """Return the pipeline with other parameter values for the named stage."""
        at = self._position(name)
        return replaced(self, (*self.stages[:at], self.stages[at].with_values(**values), *self.stages[at + 1 :]))

    def shared(self, **quantities: Any) -> Pipeline:
        """Return the pipeline with these values of shared quantities or of a preset: numbers in the declared unit, or
        texts with a unit.

        For each installed table, a method with the name of the table does the same for the quantities in it.
        """
        given = {_bare(name): plain(value) for name, value in quantities.items()}
        return self._with(quantities={**self.quantities, **given})

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name not in tables():
            return super().__getattr__(name)
        return self._with(table=name).shared

    def sweep(self, **axes: Any) -> Pipeline:
        """Return the pipeline with these axes: ``QUANTITY=[2, 4]``, ``QUANTITY=span("1 um", "3 um", 5)``,
        ``STAGE__PARAMETER=[0, 1]``, ``STAGE__use=["a", s.b()]``.
        """
        found = {}
        for name, values in axes.items():
            if isinstance(values, str) or not isinstance(values, Mapping | Iterable):
                raise RequestError([Fault(f"sweep.{name}", f"expected a list of values or span(...), got {values!r}")])
            whole = values if isinstance(values, Mapping) else [_choice(one) for one in values]
            found[axis_name(name.replace("__", "."), self.document())] = plain(whole)
        return self._with(axes={**self.axes, **found})

    def design(self, method: str = "sobol", points: int = 256, seed: int = 0, **factors: Any) -> Pipeline:
        """Return the pipeline with a design, that is, samples of these factors: ``QUANTITY={"from": 1, "to": 8,
        "levels": 16}``, ``STAGE__PARAMETER={"normal": [3, 0.3]}``, a list of choices. ``file`` and ``correlation`` are
        as in a pipeline file.

        Examples
        --------
        >>> import etendue
        >>> made = etendue.Pipeline.read("pipelines/smallest.toml").sweep()
        >>> made = made.design(points=8, sharpen__strength={"from": 0, "to": 0.4})
        >>> made.drawn["factors"]
        {'sharpen.strength': {'from': 0, 'to': 0.4}}
        """
        words: Document = {
            word: plain(factors.pop(word)) for word in ("file", "correlation", "rows") if word in factors
        }
        named = {axis_name(name.replace("__", "."), self.document()): plain(one) for name, one in factors.items()}
        own: Document = {"method": method, "points": points, "seed": seed, "factors": named, **words}
        empty = ("points",) * (method == "list") + ("factors",) * (not named)
        left = {name: values for name, values in self.axes.items() if name not in named}
        return self._with(drawn={word: one for word, one in own.items() if word not in empty}, axes=left)

    def want(self, *variables: str) -> Pipeline:
        """Return the pipeline with the variables to compute: ``rgb_display``, or ``stage.variable``. Stages that these
        variables do not need are not run.
        """
        return self._with(words={**self.words, "wanted": list(variables)})

    def keep(self, *variables: str) -> Pipeline:
        """Return the pipeline with the variables to store; by default, all computed variables. ``looks``: pictures and
        metrics, not light by band.
        """
        return self._with(words={**self.words, "keep": list(variables)})

    def set(self, **words: Any) -> Pipeline:
        """Return the pipeline with other keys of a pipeline file: ``seed``, ``tolerance``, ``precision``,
        ``description``; shared quantities as in ``shared``.
        """
        quantities = {
            word: words.pop(word) for word in [*words] if _bare(word) in (*preset_keys(), *shared_quantities.names())
        }
        faults = [Fault(word, _no_word(word)) for word in words if word not in TOP or word in APART]
        if faults:
            raise RequestError(faults)
        return self.shared(**quantities)._with(
            words={**self.words, **{key: plain(value) for key, value in words.items()}}
        )

    def about(self, **words: Any) -> Pipeline:
        """Return the pipeline with these authors and this licence in the table ``[about]``."""
        return self._with(told={**self.told, **plain(words)})

    def _position(self, name: str) -> int:
        names = [one.name for one in self.stages]
        if name not in names:
            raise RequestError(
                [
                    Fault(
                        "",
                        f"the pipeline has no stage {name!r}{nearest(name, names)}; it has {', '.join(names)}",
                    )
                ]
            )
        return names.index(name)

    # -- results -----------------------------------------------------------------------------------------------------

    def document(self) -> Document:
        """Return the content of a pipeline file."""
        parts = {self.table: self.quantities, "sweep": self.axes, "design": self.drawn, "about": self.told}
        own = {name: dict(table) for name, table in parts.items() if table}
        return {**self.words, **own, "stages": [one.table() for one in self.stages]}

    def to_toml(self, path: str | Path | None = None) -> str:
        """Return the pipeline as the text of a file; write it if a path is given."""
        text = toml.dumps(self.document())
        if path is not None:
            Path(path).write_text(text, encoding="utf-8")
        return text

    def written(self) -> Written:
        """Return the pipeline in the form in which it would be read from a file, which studies accept."""
        return parse_pipeline(self.to_toml(), folder=self.folder)

    def plan(self, leave_out: bool = True) -> Planned:
        """Return the plan of a run.

        Raises
        ------
        RequestError
            The pipeline is invalid; the message lists every fault.
        """
        return Planned(make_plan(self.written(), installed_stages(), leave_out))

    def run(
        self,
        archive: str | Path | None = None,
        *,
        want: str | Iterable[str] | None = None,
        scheduler: str = "threads",
        workers: int = 0,
        leave_out: bool = True,
        progress: bool = True,
        durable: bool = False,
        errors: bool | float = True,
    ) -> Outcome:
        """Run the pipeline: compute the unfinished cells, with a progress bar in terminals and notebooks.

        Parameters
        ----------
        archive : folder that keeps the results and from which a run resumes; None: in memory
        want : variable or variables to compute, instead of the pipeline's ``wanted``
        errors : whether to measure the errors of the wanted variables, in at most 10 % of the stages' time; a number is
            the maximum time in seconds, ``math.inf``: no limit

        Returns
        -------
        Outcome
            ``tree``: the ``xarray.DataTree`` (from an archive, loaded lazily); also the computed, reused and failed
            cells.
        """
        chosen = self if want is None else self.want(*([want] if isinstance(want, str) else want))
        made = make_plan(at_choices_of(chosen.written(), archive), installed_stages(), leave_out)
        outcome = execute(
            made,
            archive,
            Options(check_scheduler(scheduler), workers, durable),
            TerminalProgress(made) if progress else None,
        )
        with_errors(outcome, errors)
        if archive is not None or outcome.answers:
            outcome.tree = opened(outcome, archive)
        return outcome

    def session(self, bytes: int = BYTES, leave_out: bool = True, archive: str | Path | None = None) -> Session:
        """Return a session, which evaluates the pipeline many times at different values. The session keeps results of
        at most ``bytes`` bytes, and computes only cells that a change affects. ``archive``: a folder from which
        finished results are also read.
        """
        return Session(at_choices_of(self.written(), archive), bytes, leave_out, archive)

    def __repr__(self) -> str:
        chain = " -> ".join(one.name if one.name == one.use else f"{one.name} ({one.use})" for one in self.stages)
        axes = f"; swept: {', '.join(self.axes)}" if self.axes else ""
        return f"<pipeline {self.words['name']}: {chain or 'no stages yet'}{axes}>"

    def _repr_html_(self) -> str:
        rows = [
            (one.name, one.use, ", ".join(f"{key} = {value}" for key, value in one.values.items()))
            for one in self.stages
        ]
        shared_text = ", ".join(f"{key} = {value}" for key, value in self.quantities.items())
        axes = ", ".join(self.axes)
        notes = [f"{self.table}: {shared_text}"] * bool(shared_text) + [f"swept: {axes}"] * bool(axes)
        columns = (("stage",), ("use",), ("parameters",))
        return table_page(f"pipeline {self.words['name']}", columns, rows, [escape(note) for note in notes])


def replaced(pipeline: Pipeline, stages: tuple[Any, ...]) -> Pipeline:
    """Return the pipeline with other stages.

    Raises
    ------
    RequestError
        If one of them is not a placed stage, or two have the same name.
    """
    faults = [Fault(f"stage {n}", _no_stage(one)) for n, one in enumerate(stages, 1) if not isinstance(one, Placed)]
    if faults:
        raise RequestError(faults)
    return pipeline._with(stages=stages)


def _placed(table: DocumentView) -> Placed:
    own = {key: value for key, value in table.items() if key not in ("use", "name", "from")}
    return Placed(table["use"], own, table.get("name", table["use"]), table.get("from", {}))


def _choice(one: Any) -> Any:
    """Return a value of an axis ``STAGE__use`` in the form of a pipeline file; a stage becomes its name, or a table of
    its name and parameters.
    """
    if isinstance(one, Placed):
        return {"use": one.use, **one.values} if one.values else one.use
    return getattr(one, "__name__", one) if callable(one) else one


def _bare(word: str) -> str:
    """Return the name of a quantity without its table: ``NAME`` for ``TABLE__NAME``."""
    head, mark, name = word.partition("__")
    return name if mark and head in tables() else word


def number(text: str) -> Any:
    try:
        return int(text)
    except ValueError:
        try:
            return float(text)
        except ValueError:
            return text


def _no_stage(one: Any) -> str:
    if callable(one):
        return f"expected a placed stage, got the function {one!r}; call it"
    if isinstance(one, Stage):
        return f"expected a placed stage, got {one!r} itself; install your own stage, then use etendue.stages.NAME(...)"
    return f"expected a placed stage such as etendue.stages.NAME(), got {one!r}"


def _no_word(word: str) -> str:
    if word in APART:
        return f"is set by the method {word}(...)" if word != "stages" else "give stages as positional arguments"
    if word in shared_quantities.names():
        own = next(iter(tables()))
        return f"is a {own} quantity; use Pipeline.{own}({word}=...)"
    return f"is not a key of a pipeline{nearest(word, TOP)}"


__all__ = ["Pipeline", "Planned", "maker", "span"]

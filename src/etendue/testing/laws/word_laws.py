"""The laws on the declarations of a stage, before anything is computed.

In:  an instance of a stage.
Out: nothing, or a broken law.
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
import math
import pickle
from collections.abc import Mapping

from etendue.contract.arrays import variables
from etendue.contract.arrays.facts import UNKNOWN, Facts
from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import Probe, is_source, is_transfer
from etendue.contract.stage import Stage, arguments_of, looks, looks_at_stages, parameters_of, reads_of, writes_of
from etendue.contract.values.units import same_unit
from etendue.errors import PluginError
from etendue.plan import stage_calls
from etendue.plan.stage_calls import lacking
from etendue.plugins import discovery
from etendue.testing.bench import FRAME, ODD_FRAMES, Bench, LawBroken
from etendue.testing.checks import check_parameter
from etendue.testing.measured import hold


class WordLaws:
    """Mix-in of ``StageConformance``."""

    bench: Bench
    stage: Stage

    def test_the_declaration_is_well_formed(self) -> None:
        """Ports, dims and units can be parsed, arguments are named, and policies are known to the engine."""
        kind, name, _ = type(self.stage), type(self.stage).__name__, self.bench
        try:
            reads, writes = reads_of(kind), writes_of(kind)
            arguments_of(kind), parameters_of(kind)
        except (TypeError, ValueError) as error:
            raise LawBroken(f"{name}: {error}") from None
        hold(bool(writes), f"{name} writes nothing")
        for d in writes.values():
            usual = (
                variables.variable(d.variable).units if discovery.installed().first("variables", d.variable) else d.unit
            )
            hold(
                same_unit(usual, d.unit),
                f"{name} writes {d.variable} in {d.unit}, but the vocabulary has it in {usual}",
            )
        hold((kind.run is not None) != is_transfer(kind), f"{name} must have either run or transfer")
        hold(kind.nan in ("error", "keep"), f"{name}.nan is {kind.nan!r}; allowed: 'error' and 'keep'")
        hold(
            kind.negative in ("error", "clip", "keep"),
            f"{name}.negative is {kind.negative!r}; allowed: 'error', 'clip' and 'keep'",
        )
        hold(
            kind.gain is None or 0 <= kind.gain < math.inf,
            f"{name}.gain is {kind.gain}; allowed: None and finite numbers of at least 0",
        )
        seen = [d.variable for d in reads.values() if looks(d) and not looks_at_stages(looks(d))]
        hold(
            not seen or issubclass(kind, Probe),
            f"{name} looks at all stages ({', '.join(seen)}), which only a Probe may",
        )
        hold(not is_source(kind) or not reads, f"{name} defines describe, like a source, but reads {', '.join(reads)}")
        if kind.grid is Stage.grid and not is_source(kind):
            known = {dim for d in reads.values() for dim in d.dims} | set(kind.creates) | {"stage"}
            for declaration in writes.values():
                for dim in declaration.dims:
                    hold(dim in known, lacking(kind, dim, declaration.variable))
        hold(
            not is_transfer(kind) or len(reads) == 1 == len(writes),
            f"{name} has transfer, so it must read and write exactly one variable each",
        )
        for library in kind.libraries:
            try:
                importlib.metadata.version(library)
            except importlib.metadata.PackageNotFoundError:
                raise LawBroken(f"{name}.libraries names {library!r}, which is not an installed distribution") from None

    def test_it_is_a_value(self) -> None:
        """A stage is frozen, hashable and equal to its copy, and can be restored from its repr and its pickle."""
        stage, kind = self.stage, type(self.stage)
        for field in dataclasses.fields(stage):
            try:
                setattr(stage, field.name, getattr(stage, field.name))
            except dataclasses.FrozenInstanceError:
                continue
            raise LawBroken(f"{kind.__name__}.{field.name} can be changed; use @dataclass(frozen=True, kw_only=True)")
        try:
            hash(stage)
        except TypeError as error:
            raise LawBroken(f"{stage!r} is not hashable: {error}") from None
        hold(dataclasses.replace(stage) == stage, f"a copy of {stage!r} is not equal to it")
        try:
            same = pickle.loads(pickle.dumps(stage)) == stage
        except Exception as error:
            raise LawBroken(f"{stage!r} cannot be sent to another process: {error}") from None
        hold(same, f"pickle restores {stage!r} as another value, so other processes would compute something else")
        text = repr(stage)
        try:
            again = eval(text.replace(kind.__qualname__, kind.__name__, 1), {"inf": math.inf, kind.__name__: kind})
        except Exception as error:
            raise LawBroken(f"the repr {text} cannot be read back: {error}") from None
        hold(again == stage, f"the repr {text} evaluates to another value")

    def test_every_parameter_has_a_unit_and_refuses_what_is_out_of_range(self) -> None:
        for name, (parameter, kind, default) in parameters_of(type(self.stage)).items():
            check_parameter(f"{type(self.stage).__name__}.{name}", name, parameter, kind, default, self.stage)

    def test_the_grid_is_a_pure_function(self) -> None:
        """``grid`` called twice returns the same result, leaves its inputs unchanged, and accepts or clearly refuses
        any frame size.
        """
        stage = self.stage
        if is_source(type(stage)):
            hold(stage.describe() == stage.describe(), f"{stage!r} returns another description when called twice")  # type: ignore[attr-defined]
            return
        if type(stage).grid is Stage.grid:
            return
        for frame in (FRAME, *ODD_FRAMES):
            given = self.bench.input_grids(frame)
            kept = dict(given)
            try:
                first, second = stage.grid(given), stage.grid(dict(given))
            except ValueError as error:
                hold(frame != FRAME, f"{stage!r}.grid refuses an ordinary grid: {error}")
                continue
            hold(given == kept, f"{stage!r}.grid changes the mapping it is given")
            hold(first == second, f"{stage!r}.grid returns another grid when called again")
            unknown = sorted(set(first) - set(self.bench.writes))
            hold(not unknown, f"{stage!r}.grid returned {', '.join(unknown)}, which it does not write")
            hold(all(isinstance(g, Grid) for g in first.values()), f"{stage!r}.grid returned values that are no Grid")

    def test_noise_about_black_is_met_with_a_word_of_its_own(self) -> None:
        """Values that noise makes negative are ordinary: a stage that refuses them must declare this explicitly and not
        by the default of ``negative``.
        """
        kind = type(self.stage)
        own = next(base for base in kind.__mro__ if "negative" in vars(base))
        for port, declaration in reads_of(kind).items() if own is Stage else ():
            hold(
                not variables.variable(declaration.variable).below_zero,
                f"{kind.__name__} declares nothing about negative values and therefore refuses the negative "
                f"values of {port}, which noise causes, so that runs and compare fail; declare negative = "
                "'keep' or 'clip', or negative = 'error' if that is intended",
            )

    def test_its_notes_are_of_their_form(self) -> None:
        """``warn`` gets the facts of the outputs of the stage and the grids of its inputs, and returns texts."""
        stage, kind, bench = self.stage, type(self.stage), self.bench
        facts: Facts | Mapping[str, Facts] = UNKNOWN
        if is_source(kind):
            facts = stage.describe()[0]  # type: ignore[attr-defined]
        elif kind.carry is not Stage.carry:
            facts = stage.carry(bench.facts(bench.arrays("ordinary")), bench.input_grids())
        try:
            stage_calls.texts(stage, "warn", facts, bench.input_grids())
            stage_calls.texts(stage, "warn_among", {"it": kind})
        except PluginError as error:
            if not isinstance(error.__cause__, ValueError):  # by which a stage refuses
                raise LawBroken(f"{bench.name}: {error}") from None

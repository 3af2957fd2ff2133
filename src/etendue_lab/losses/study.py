"""``etendue losses``: each stage's share of a camera's lost contrast, signal-to-noise ratio and colour.

In:  a pipeline as written, the reflectance of a grey card.
Out: for each stage its Shapley value and the metric of the camera without it; for pairs of stages the predicted and the
     actual loss.

A removed stage is replaced by its ideal (decision 0026): a lens that spreads no light, a point-like pixel, a noise
source that adds nothing, every channel at every pixel. For the numerical error of stages, see ``accuracy``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from etendue.contract.registry import Registry
from etendue.contract.stage import reads_of
from etendue.errors import EtendueError, RequestError
from etendue.pipeline import derived
from etendue.pipeline.file import PipelineFile
from etendue.plan.planner import make_plan
from etendue.session import Options, collect
from etendue.types.documents import Document
from etendue_camera.colour import difference
from etendue_camera.roles import Displaying
from etendue_lab.compare.axis import one_camera
from etendue_lab.information.fine_detail import CHARGE, FineDetail, fine_detail
from etendue_lab.losses.games import Contrast, Game, SignalToNoise
from etendue_lab.losses.shapley import fewest, shares
from etendue_lab.noise.flat_field import MOSAIC
from etendue_lab.quality.figures import Shot
from etendue_lab.quality.ideal import Ideal, ideal_of

if TYPE_CHECKING:
    from etendue.types.arrays import Array

ANALYTIC = 1024  # coalitions evaluated from formulas: exact up to ten stages
RUNS = 64  # default number of coalitions that are run: exact up to six stages
LINEAR = "rgb_linear"


@dataclass
class LossReport:
    """Losses of a camera, and each stage's share."""

    pipeline: str
    reflectance: float
    games: list[Game] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def document(self) -> Document:
        """Return the report as JSON."""
        return {
            "pipeline": self.pipeline,
            "reflectance": self.reflectance,
            "losses": [_document(game) for game in self.games],
            "notes": self.notes,
        }


def losses(
    pipeline: PipelineFile,
    registry: Registry,
    reflectance: float = 0.18,
    runs: int = RUNS,
    seed: int = 0,
    options: Options | None = None,
    told: Callable[[str], None] = lambda text: None,
) -> LossReport:
    """Compute each stage's share of the losses of a camera.

    Parameters
    ----------
    pipeline : Pipeline
        A sweep is ignored. Contrast and noise are computed for a grey card in place of its scene, colour for its own
        scene.
    registry : Registry
    reflectance : float
        Reflectance of the card, greater than 0 and at most 1.
    runs : int
        Maximum number of cameras run for colour; 0: none. The shares of colour are exact if this number covers all
        subsets of the stages; otherwise random orders are used.
    seed : int
        Seed of random orders.
    told : callable
        Called with a short text for each camera before it is run.

    Raises
    ------
    RequestError
        The pipeline or one of these values is invalid; a stage does not declare its noise.
    """
    if runs < 0 or seed < 0:
        raise RequestError(f"--runs {runs} --seed {seed}: must be whole numbers of at least 0")
    alone, notes = one_camera(pipeline)
    detail = fine_detail(alone, registry, reflectance, options, None, notes)
    report = LossReport(pipeline.name, reflectance, notes=notes)
    contrast = Contrast(detail)
    snr = SignalToNoise(detail, _gains(detail, registry, options, notes))
    for one in (
        SharedLoss("contrast", "dB", "mean contrast up to Nyquist", contrast.players, contrast.loss, contrast.contrast),
        SharedLoss("SNR", "dB", "SNR of the grey card", snr.players, snr.loss, snr.snr),
    ):
        report.games.append(_game(one, ANALYTIC, seed))
    if runs:
        _colour(report, alone, registry, runs, seed, options, told)
    return report


@dataclass(frozen=True)
class SharedLoss:
    """A loss to be shared among stages."""

    name: str
    unit: str
    figure: str  # name of the metric shown beside the loss
    players: tuple[str, ...]
    loss: Callable[[frozenset[str]], float]  # loss with only some of the stages real
    figure_of: Callable[[frozenset[str]], float]


def _game(shared: SharedLoss, most: int, seed: int) -> Game:
    known: dict[frozenset[str], float] = {}
    players, figure_of = shared.players, shared.figure_of

    def once(present: frozenset[str]) -> float:
        if present not in known:
            known[present] = shared.loss(present)
        return known[present]

    found, every = shares(once, players, most, seed), frozenset(players)
    pairs = {}
    for one, other in combinations(players, 2):
        left = every - {one, other}
        if found.orders and left not in known:
            continue
        pairs[one, other] = (found.of_pair(one, other), once(every) - once(left))
    without = {name: figure_of(every - {name}) for name in players if not found.orders or every - {name} in known}
    ends = figure_of(frozenset()), figure_of(every)
    return Game(shared.name, shared.unit, shared.figure, found, *ends, without, pairs)


def _gains(detail: FineDetail, registry: Registry, options: Options | None, notes: list[str]) -> dict[str, float]:
    """Return the transmission of each stage that only absorbs light."""
    found = {}
    for node in detail.plan.nodes:
        if (
            node.is_transfer
            or not node.kind.pointwise
            or "irradiance" not in node.writes
            or node.name not in detail.before
        ):
            continue
        if "irradiance" not in {v for _, _, v in node.inputs[0]}:
            continue
        try:
            plan = make_plan(without_stages(detail.plan.pipeline, {node.name}), registry, leave_out_allowed=False)
            ref = next((n.name, ()) for n in plan.nodes if CHARGE in n.writes)
            charge = detail.window(collect(plan, {ref: (CHARGE,)}, options).arrays[ref][CHARGE])
        except (EtendueError, KeyError) as error:
            notes.append(f"{node.name}: its transmission is unknown ({str(error).splitlines()[0]})")
            continue
        own = sum(detail.signal()[str(detail.mask[p])] - detail.dark for p in detail.order) / len(detail.order)
        found[node.name] = own / (float(charge.mean()) - detail.dark)
    return found


def without_stages(pipeline: PipelineFile, out: Collection[str]) -> PipelineFile:
    """Return the pipeline without the stages in ``out``, each of which writes the variable that it reads. It has no
    line numbers, as they no longer match the file.
    """
    return replace(derived.without_stages(pipeline, out), lines={})


# -- colour -------------------------------------------------------------------------------------------------------


def _colour(
    report: LossReport,
    pipeline: PipelineFile,
    registry: Registry,
    runs: int,
    seed: int,
    options: Options | None,
    told: Callable[[str], None],
) -> None:
    try:
        cameras = _Cameras(pipeline, registry, options, told)
        least = min(2 ** len(cameras.players), fewest(len(cameras.players)))
        if runs < least:
            raise ValueError(f"{len(cameras.players)} stages need at least {least} cameras: --runs {least}")
        report.notes += [note for note in cameras.ideal.notes if note not in report.notes]
        what = "rms CIEDE2000 to the ideal camera"
        colour = SharedLoss("colour", "CIEDE2000^2", what, cameras.players, cameras.loss, cameras.figure)
        report.games.append(_game(colour, runs, seed))
    except (RequestError, ValueError) as error:
        text = error.faults[0].message if isinstance(error, RequestError) and error.faults else str(error)
        report.notes.append(f"no shares of colour: {text}")


class _Cameras:
    """The same camera with some of its stages ideal, run with its own scene.

    Mosaic, noise, converter, mosaic corrections and the demosaicer are one player: the ideal camera replaces all of
    them by every channel at every pixel.
    """

    def __init__(
        self, pipeline: PipelineFile, registry: Registry, options: Options | None, told: Callable[[str], None]
    ) -> None:
        self.pipeline, self.registry, self.options, self.told = pipeline, registry, options, told
        self.ideal: Ideal = ideal_of(pipeline, registry)
        demosaic = next(iter(self.ideal.replaced))
        self.mosaic = f"mosaic to {demosaic}"
        kinds = {e.name: registry.load(e.use) for e in pipeline.stages if e.use in registry}
        on_it = {n for n, kind in kinds.items() if MOSAIC in {d.variable for d in reads_of(kind).values()}}
        self.beside = frozenset(on_it & set(self.ideal.left_out))
        self.players = (*(n for n in self.ideal.left_out if n not in self.beside), self.mosaic)
        self.pictures: dict[frozenset[str], float] = {}
        self.reference = self._lab(frozenset())

    def loss(self, present: frozenset[str]) -> float:
        """Return the mean squared colour difference (CIEDE2000) from the ideal camera. The mean squares of independent
        errors add up.
        """
        if present not in self.pictures:
            apart = difference.delta_e_2000(self._lab(present), self.reference) if present else np.zeros(1)
            self.pictures[present] = float(np.mean(np.square(apart)))
        return float(self.pictures[present])

    def figure(self, present: frozenset[str]) -> float:
        return math.sqrt(self.loss(present))

    def _lab(self, present: frozenset[str]) -> Array:
        self.told(
            f"the camera with {', '.join(n for n in self.players if n in present) or 'nothing'} real, all else ideal"
        )
        if self.mosaic in present:
            camera = without_stages(self.pipeline, set(self.ideal.left_out) - present - self.beside)
        else:
            camera = ideal_of(self.pipeline, self.registry, keep=present - {self.mosaic}).pipeline
        camera = replace(camera, faults=())
        plan = make_plan(derived.wanting(camera), self.registry)
        node = next((n for n in reversed(plan.nodes) if LINEAR in n.writes), None)
        if node is None:
            raise ValueError("no stage writes rgb_linear: put 'display' after the demosaicer")
        plan = make_plan(derived.wanting(camera, [(node.name, LINEAR)]), self.registry)
        found = collect(plan, {(node.name, ()): (LINEAR,)}, self.options)
        failed = next((r for r in found.reports.values() if r.status == "failed"), None)
        if failed is not None:
            raise ValueError(f"stage {failed.stage!r} failed: {failed.message.splitlines()[-1]}")
        stages = (plan.cells[n.name, ()].stage for n in reversed(plan.nodes) if LINEAR in n.writes)
        display = next((stage for stage in stages if isinstance(stage, Displaying)), None)
        if display is None:
            raise ValueError("no stage declares the primaries of the display")
        matrix = np.asarray(display.to_xyz())
        shot = Shot(None, rgb_linear=np.asarray(found.arrays[node.name, ()][LINEAR], np.float64), to_xyz=matrix)
        return difference.lab(shot.xyz(), matrix.sum(axis=1))


# -- JSON ---------------------------------------------------------------------------------------------------------


def _document(game: Game) -> Document:
    found = game.shares
    stages = [
        {
            "stage": name,
            "loss": float(found.values[i]),
            "share": float(found.values[i] / found.gross) if found.gross else math.nan,
            "standard_error": float(found.errors[i]),
            "figure_without": game.without.get(name, math.nan),
        }
        for i, name in enumerate(found.players)
    ]
    pairs = [
        {
            "stages": [one, other],
            "interaction": float(found.interactions[found.order[one], found.order[other]]),
            "predicted": predicted,
            "found": lost,
        }
        for (one, other), (predicted, lost) in game.pairs.items()
    ]
    return {
        "what": game.name,
        "unit": game.unit,
        "figure": game.figure,
        "ideal": game.ideal,
        "camera": game.camera,
        "loss": found.total,
        "lost_before_gains": found.gross,
        "stages": stages,
        "pairs": pairs,
        "coalitions": found.coalitions,
        "orders": found.orders or None,
    }

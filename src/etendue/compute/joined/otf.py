"""Transfer functions as other stages see them: the product of all stages up to one, at any frequency.

In:  the ``Job`` of a stage that reads ``"*.transfer"``.
Out: ``Otf`` values, each with the name of the last stage in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from etendue.compute.job import Job
from etendue.compute.tables import TABLES, Made, prepared_for
from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import ChannelTransfer, Summed, Transfer
from etendue.contract.stage import Stage, state_of
from etendue.transfer.products import Product, behind_filters, between, weights
from etendue.types.arrays import Array

REMEMBERED = 64  # frequencies from which a table is cached: a search uses the same coarse grid in every cell of a sweep
BLOCK = 16  # frequencies of a slanted line per block; each block evaluates a square and takes its diagonal


def transfers_of(job: Job) -> list[tuple[str, Otf]]:
    """Return, for every transfer stage before a stage, its name and the transfer function up to and including it."""
    look = job.looking
    assert look is not None
    port, pairs = next((port, pairs) for port, what, pairs in look.ports if what == "transfer")
    every = tuple((name, stage) for (name, _), stage in zip(pairs, look.transfers, strict=True))
    chains = look.chains or [tuple(range(i + 1)) for i in range(len(every))]
    grids = look.grids.get(port) or [None] * len(every)
    whole = look.whole or [True] * len(every)
    found = []
    for number, (name, stage) in enumerate(every):
        if isinstance(stage, Transfer):
            parts = tuple((n, s) for n, s in (every[i] for i in chains[number]) if isinstance(s, Transfer))
            behind = _behind(number, every, chains) if isinstance(stage, Summed) else ()
            found.append(
                (name, Otf(parts, look.bands, look.rendered, grids[number], whole[number], behind, look.light))
            )
    return found


def _behind(
    pixel: int, every: Sequence[tuple[str, Stage]], chains: Sequence[Sequence[int]]
) -> tuple[tuple[str, ChannelTransfer], ...]:
    """Return the stages that move charge after a pixel stage, in order; if the pipeline branches, the stages on the
    first branch.
    """
    found: list[int] = []
    for number, (_, stage) in enumerate(every):
        if isinstance(stage, ChannelTransfer) and stage.moves_charge() and {pixel, *found} <= set(chains[number]):
            found.append(number)
    return tuple((name, stage) for name, stage in (every[i] for i in found) if isinstance(stage, ChannelTransfer))


def weights_of(stage: Summed, edges: tuple[float, ...]) -> Array:
    """Return the (channel, band) weights of the bands of a stage that ends in a sum."""
    return weights(stage, prepared_for(stage, edges))


@dataclass(frozen=True)
class Otf:
    """The product of the transfer functions of some stages. Frequencies in cycles/um; values are 1 at 0, and complex
    for shifts.

    ``parts`` are (name, stage) in the order of the light, ``edges`` the edges of the bands. Stages that a plan has left
    out are included: the product is taken from the stages, not from arrays. ``grid`` is the grid of the last stage's
    output. ``whole`` is False if an earlier stage moves light without being a transfer function (a warp, a blur that
    varies over the field): the product is then not the complete blur. ``behind`` are the stages that move charge
    between pixels, if the last part is a pixel: they are not in the product, only in ``channels`` and
    ``channels_along``. ``light`` is the light of a white surface in front of the pixel by band, with maximum 1; None if
    unknown.
    """

    parts: tuple[tuple[str, Transfer], ...]
    edges: tuple[float, ...]
    rendered: tuple[float, float] | None = None
    grid: Grid | None = None
    whole: bool = True
    behind: tuple[tuple[str, ChannelTransfer], ...] = ()
    light: tuple[float, ...] | None = None

    def __call__(self, frequency: Array) -> Array:
        """Return the transfer function, (band, n), at frequencies (n,) along x."""
        fx = np.asarray(frequency, dtype=float)
        return self.along(np.zeros_like(fx), fx)

    def along(self, fy: Array, fx: Array) -> Array:
        """Return the transfer function, (band, n), at points (n,), on a line in any direction or elsewhere."""
        fy, fx = np.broadcast_arrays(np.asarray(fy, dtype=float), np.asarray(fx, dtype=float))
        if fy.ndim != 1:
            raise ValueError(f"fy and fx must be two lists of equal length; they have shape {fy.shape}")
        product: Array = np.ones((len(self.edges) - 1, fx.size))
        for _, stage in self.parts:
            product = product * _remembered("along", _along, stage, fy, fx, self.edges)
        return product

    def plane(self, fy: Array, fx: Array) -> Array:
        """Return the transfer function, (band, m, n), at all pairs of frequencies (m,) along y and (n,) along x."""
        fy, fx = np.asarray(fy, dtype=float), np.asarray(fx, dtype=float)
        product: Array = np.ones((len(self.edges) - 1, fy.size, fx.size))
        for _, stage in self.parts:
            product = product * _remembered("plane", _plane, stage, fy, fx, self.edges)
        return product

    def channels(self, fy: Array, fx: Array, light: Array | None = None, weights: Array | None = None) -> Array:
        """Return the transfer function of grey detail in each channel, (channel, m, n), at all pairs of frequencies,
        including charge that moves between pixels.

        ``light``: light of a white surface by band, (band,), in any scale; None: equal in every band. ``weights``: the
        weights of the pixel, if the pixel is left out.
        """
        fy, fx = np.asarray(fy, dtype=float), np.asarray(fx, dtype=float)
        return self._of_channels(
            self.plane(fy, fx), lambda stage, white: self._between(stage, fy, fx, white), light, weights
        )

    def channels_along(self, fy: Array, fx: Array, light: Array | None = None, weights: Array | None = None) -> Array:
        """Return the result of `channels` at points (n,) of a line in any direction, (channel, n)."""
        fy, fx = np.broadcast_arrays(np.asarray(fy, dtype=float), np.asarray(fx, dtype=float))

        def moved(stage: ChannelTransfer, white: Array) -> Array:
            return _on_line(lambda y, x: self._between(stage, y, x, white), fy, fx)

        return self._of_channels(self.along(fy, fx), moved, light, weights)

    def _of_channels(
        self, bands: Array, moved: Callable[[ChannelTransfer, Array], Array], light: Array | None, weights: Array | None
    ) -> Array:
        white, zero = np.ones(len(self.edges) - 1) if light is None else np.asarray(light, dtype=float), np.zeros(1)
        stages = [stage for _, stage in self.behind]
        still = [self._between(stage, zero, zero, white)[..., 0, 0] for stage in stages]
        shares = (self.weights if weights is None else weights) * white
        return behind_filters(bands, shares, [moved(stage, white) for stage in stages], still)

    def _between(self, stage: ChannelTransfer, fy: Array, fx: Array, white: Array) -> Array:
        def make() -> Array:
            return between(stage, fy, fx, white, prepared_for(stage, self.edges))

        if max(fy.size, fx.size) < REMEMBERED:
            return make()
        return TABLES.get(("between", state_of(stage), self.edges, fy.tobytes(), fx.tobytes(), white.tobytes()), make)

    def without(self, names: Iterable[str]) -> Otf:
        """Return the product without these stages."""
        left_out = {names} if isinstance(names, str) else set(names)
        parts = tuple(part for part in self.parts if part[0] not in left_out)
        return replace(self, parts=parts, behind=tuple(one for one in self.behind if one[0] not in left_out))

    @property
    def stages(self) -> tuple[tuple[str, Stage], ...]:
        """All stages, in the order of the light."""
        return (*self.parts, *self.behind)

    def once(self, what: Hashable, make: Callable[[], Made]) -> Made:
        """Return the result of ``make()``, cached by the parameters of these stages; ``what`` names the result and
        everything else on which it depends.
        """
        return TABLES.get(
            ("of a product", what, tuple(state_of(stage) for _, stage in self.stages), self.edges, self.rendered), make
        )

    @property
    def weights(self) -> Any:
        """The weights of the bands for each filter, (channel, band); None before the pixel."""
        stage = next((stage for _, stage in self.parts if isinstance(stage, Summed)), None)
        return None if stage is None else weights_of(stage, self.edges)

    @property
    def middles(self) -> Array:
        """The middle of every band, in the unit in which transfer functions take it."""
        return Product(tuple(stage for _, stage in self.parts), self.edges, prepared_for).middles[:, 0, 0]

    def scene_along(self, fy: Array, fx: Array) -> Any:
        """Return the transfer function, (n,), with which the scene's ideal chart was blurred; 1 if unknown
        (photographs).
        """
        fy, fx = np.asarray(fy, dtype=float), np.asarray(fx, dtype=float)
        softness, cell = self.rendered or (0.0, 0.0)
        return np.exp(-2 * (math.pi * softness) ** 2 * (fy**2 + fx**2)) * np.sinc(cell * fy) * np.sinc(cell * fx)


def _remembered(
    what: str, make: Callable[..., Array], stage: Transfer, fy: Array, fx: Array, edges: tuple[float, ...]
) -> Array:
    if max(fy.size, fx.size) < REMEMBERED:
        return make(stage, fy, fx, edges)
    key = ("otf", what, state_of(stage), edges, fy.tobytes(), fx.tobytes())
    return TABLES.get(key, lambda: make(stage, fy, fx, edges))


def _plane(stage: Transfer, fy: Array, fx: Array, edges: tuple[float, ...]) -> Array:
    """Return the transfer function at pairs of frequencies, (band or 1, m, n)."""
    return Product((stage,), edges, prepared_for).at(fy[:, None], fx[None, :])


def _along(stage: Transfer, fy: Array, fx: Array, edges: tuple[float, ...]) -> Array:
    """Return the transfer function at n frequencies along a line, (band or 1, n)."""
    if stage.radial:
        fy, fx = np.zeros_like(fx), np.hypot(fy, fx)
    return _on_line(lambda y, x: _plane(stage, y, x, edges), fy, fx)


def _on_line(plane: Callable[[Array, Array], Array], fy: Array, fx: Array) -> Array:
    """Return the values of ``plane`` on a line of frequencies, (..., n). Stages evaluate grids only, so a slanted line
    is assembled from the diagonals of small grids.
    """
    if not fy.any():
        return plane(fy[:1], fx)[..., 0, :]
    if not fx.any():
        return plane(fy, fx[:1])[..., 0]
    blocks = [slice(i, i + BLOCK) for i in range(0, fx.size, BLOCK)]
    return np.concatenate([np.diagonal(plane(fy[b], fx[b]), axis1=-2, axis2=-1) for b in blocks], axis=-1)

"""The product of the transfer functions of some stages; the only place that calls a stage's ``transfer``.

In:  stages in light order, edges of bands, the tables that each stage has prepared.
Out: their product at separable frequencies, for all bands or some of them; for channels, the mean over bands including
     charge that moves between them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.contract.arrays.coordinates import coordinates_of
from etendue.contract.arrays.dims import dim
from etendue.contract.arrays.grid import Bands, Grid
from etendue.contract.capabilities import ChannelTransfer, Summed, Transfer, bands_of
from etendue.contract.stage import Stage
from etendue.errors import PluginError
from etendue.telling import foreign
from etendue.types.arrays import Array

EVERY = slice(None)


def alone(stage: Stage, edges: tuple[float, ...]) -> Any:
    """Return the tables that a stage prepares for bands with these edges, without a cache."""
    with foreign(f"{type(stage).__name__}.prepare"):
        return stage.prepare(coordinates_of({"": Grid.of({bands_of(type(stage)): Bands(edges)})}))


@dataclass(frozen=True)
class Product:
    """The product of the transfer functions of ``stages``. ``prepared`` is a function that returns the tables of a
    stage for the bands; the default function computes them without a cache.
    """

    stages: tuple[Transfer, ...]
    edges: tuple[float, ...]
    prepared: Callable[[Stage, tuple[float, ...]], Any] = field(default=alone, compare=False)

    @cached_property
    def middles(self) -> NDArray[np.float64]:
        """The middle of every band, (band, 1, 1), in the unit in which transfer functions receive it."""
        own = next((name for stage in self.stages if (name := bands_of(type(stage)))), "")
        return np.array(Bands(self.edges).values())[:, None, None] * dim(own).factor

    @cached_property
    def _prepared(self) -> list[Any]:
        return [self.prepared(stage, self.edges) for stage in self.stages]

    @property
    def radial(self) -> bool:
        """Whether every stage depends only on the magnitude of the frequency."""
        return all(stage.radial for stage in self.stages)

    def at(self, fy: Array, fx: Array, bands: slice = EVERY) -> Array:
        """Return (band or 1, m, n) at frequencies fy (m, 1), fx (1, n), cycles/um; 1 without stages."""
        middles = self.middles[bands]
        product: Array = np.ones((1, 1, 1))
        for stage, prepared in zip(self.stages, self._prepared, strict=True):
            product = product * asked(stage, fy, fx, middles, prepared)
        return product

    def along(self, frequency: Array) -> Array:
        """Return the product at frequencies along x (cycles/um), (band, n)."""
        found = self.at(np.zeros((1, 1)), frequency[None, :])[:, 0]
        return np.broadcast_to(found, (self.middles.size, frequency.size))


def asked(stage: Transfer, fy: Array, fx: Array, middles: Array, prepared: Any) -> Array:
    """Return the values of ``stage.transfer``, (band or 1, m, n); raise an error that names the stage if they are not
    finite or their shape does not match the frequencies.
    """
    name = f"{type(stage).__name__}.transfer"
    with foreign(name):
        given = (fy, fx, middles) if prepared is None else (fy, fx, middles, prepared)
        found = np.asarray(stage.transfer(*given))
    if found.dtype.kind not in "fiubc" or found.ndim > 3:
        raise PluginError(f"{name} gave {found.dtype} of shape {found.shape}; expected numbers over (band, y, x)")
    shape = (np.size(middles), np.shape(fy)[0], np.shape(fx)[1])
    if any(n not in (1, most) for n, most in zip(found.shape[::-1], shape[::-1], strict=False)):
        raise PluginError(f"{name} gave shape {found.shape}, but {shape} was requested")
    return found.reshape((1,) * (3 - found.ndim) + found.shape)


def between(stage: ChannelTransfer, fy: Array, fx: Array, light: Array, prepared: Any) -> Array:
    """Return the values of ``stage.channel_transfer``, (channel, channel, m, n); raise an error that names the stage if
    they are not finite or their shape does not match the frequencies (m,), (n,)."""
    name = f"{type(stage).__name__}.channel_transfer"
    with foreign(name):
        found = np.asarray(stage.channel_transfer(fy, fx, light, prepared))
    if (
        found.dtype.kind not in "fc"
        or found.ndim != 4
        or found.shape[0] != found.shape[1]
        or found.shape[2:] != (len(fy), len(fx))
    ):
        raise PluginError(
            f"{name} gave {found.dtype} of shape {found.shape}; expected numbers over (channel, channel, "
            f"{len(fy)}, {len(fx)})"
        )
    return found


def behind_filters(bands: Array, shares: Array, moved: Sequence[Array] = (), still: Sequence[Array] = ()) -> Array:
    """Return the transfer function of each channel for grey detail: the weighted mean over bands, including the charge
    that moves between channels.

    Parameters
    ----------
    bands : (band, ...) array
        Transfer functions of the stages before the filters, 1 at frequency 0.
    shares : (channel, band) array
        Light of a white surface in each channel, in any scale.
    moved : sequence of (channel, channel, ...) arrays
        Transfer of charge by consecutive stages, see `between`.
    still : sequence of (channel, channel) arrays
        The same transfer at frequency 0.

    Returns
    -------
    (channel, ...) array
        1 at frequency 0.
    """
    found, level = np.tensordot(shares, bands, 1), shares.sum(axis=1)
    for one, at_zero in zip(moved, still, strict=True):
        found, level = np.einsum("cs...,s...->c...", one, found), at_zero @ level
    scale = np.where(level == 0, 1.0, level)
    return found / scale.reshape(-1, *[1] * (found.ndim - 1))


def weights(stage: Summed, prepared: Any) -> Array:
    """Return ``stage.weights`` as (channel, band), read-only."""
    name = f"{type(stage).__name__}.weights"
    with foreign(name):
        found = np.array(stage.weights(prepared))
    if found.dtype.kind not in "fiub" or found.ndim != 2:
        raise PluginError(f"{name} gave {found.dtype} of shape {found.shape}; expected numbers by (channel, band)")
    found.flags.writeable = False
    return found


def shares(stage: Summed, prepared: Any, weights: Array) -> Array:
    """Return the weights (channel, band) divided by the sum of their channel; 0 for a channel without weight."""
    sums = weights.sum(axis=1, keepdims=True)
    own = np.divide(weights, sums, out=np.zeros_like(weights), where=sums != 0)
    name = f"{type(stage).__name__}.shares"
    with foreign(name):
        given = stage.shares(prepared)
    if given is None:
        return own
    found = np.array(given, dtype=float)
    if found.shape != own.shape or not np.allclose(found, own, rtol=1e-9, atol=1e-12):
        raise PluginError(f"{name} must give the weights divided by the sum of their channel")
    return found

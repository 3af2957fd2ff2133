"""What is known of a variable before it is computed.

Facts decide what may be left out and with which precision a scene must be carried. A fact that is not known is
``None`` and then nothing is concluded from it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Facts:
    """Noise-free values of one variable.

    Attributes
    ----------
    uniform : the same value at every position
    low, high : bounds on the values, in the variable's unit
    contrast : largest over smallest value; inf where the scene holds exact black
    band_limit : frequency above which the scene holds less than a hundredth of its contrast, cycles/um
    rendered : of a scene, with what its ideal chart was drawn: (rms width of a Gaussian, side of the cells over which values
        are means), um, each 0 where it does not apply
    """

    uniform: bool | None = None
    low: float | None = None
    high: float | None = None
    contrast: float | None = None
    band_limit: float | None = None
    rendered: tuple[float, float] | None = None

    def scaled(self, low: float, high: float | None = None) -> Facts:
        """Facts after multiplication by a factor between ``low`` and ``high`` (both above 0)."""
        high = low if high is None else high
        return replace(
            self,
            uniform=self.uniform if low == high else False,
            low=None if self.low is None else min(self.low * low, self.low * high),
            high=None if self.high is None else max(self.high * low, self.high * high),
            contrast=None if self.contrast is None or low <= 0 else self.contrast * (high / low),
        )


UNKNOWN = Facts()

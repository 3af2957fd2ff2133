"""Report of information along a camera, and its JSON form.

In:  predicted and measured values of ``information``.
Out: a document.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from etendue.types.documents import Document

ENDS = (0.0, 0.25, 0.5)  # cycles/pixel at which the table shows NEQ
FAINTEST = 1e-2  # fraction of the largest NEQ below which measured and predicted are not compared


@dataclass
class StageRow:
    """Values up to and including one stage, all channels together."""

    stage: str
    what: str  # photons, blur, noise, or the picture that it writes
    bits: float  # per pixel, over the Nyquist square
    bits_line: float  # per pixel of a line along x
    quanta: tuple[float, ...]  # NEQ at ENDS along x
    observer: float  # SNRi of the spot
    channels: dict[str, float]  # bits per pixel of each channel alone


@dataclass
class NeqCurve:
    """NEQ of one channel of one picture along x."""

    stage: str
    variable: str
    channel: str
    frequency: tuple[float, ...]  # cycles/pixel
    predicted: tuple[float, ...]
    found: tuple[float, ...]
    periodograms: int  # number of periodograms averaged into each value, per row of frequencies
    standard_error: float  # relative standard error of the measured noise power
    bits_predicted: float  # per pixel of a line
    bits_found: float

    @property
    def apart(self) -> float:
        """Largest |measured / predicted - 1| over the frequencies at which the predicted NEQ exceeds a hundredth of its
        maximum. Smaller values lie near zeros of the picture's response.
        """
        least = FAINTEST * max(self.predicted, default=0.0)
        return max((abs(f / p - 1) for f, p in zip(self.found, self.predicted, strict=True) if p > least), default=0.0)


@dataclass
class InformationReport:
    """Information from the light to the last picture."""

    pipeline: str
    reflectance: float
    ratio: float
    size: float  # full width of the spot at half maximum, pixels
    contrast: float  # of the spot
    electrons: dict[str, float]
    block: int
    rows: list[StageRow] = field(default_factory=list)
    curves: list[NeqCurve] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def document(self) -> Document:
        """Return the report as JSON."""
        rows: list[Document] = []
        before: float | None = None
        for row in self.rows:
            lost = None if before is None else before - row.bits
            rows.append(
                {
                    "stage": row.stage,
                    "what": row.what,
                    "bits_per_pixel": row.bits,
                    "lost": lost,
                    "bits_per_pixel_of_a_line": row.bits_line,
                    "neq": [
                        {"cycles_per_pixel": f, "quanta_per_pixel": q} for f, q in zip(ENDS, row.quanta, strict=True)
                    ],
                    "snri": row.observer,
                    "channels": row.channels,
                }
            )
            before = row.bits
        curves = [
            {
                "stage": c.stage,
                "variable": c.variable,
                "channel": c.channel,
                "cycles_per_pixel": list(c.frequency),
                "predicted": list(c.predicted),
                "found": list(c.found),
                "largest_difference": c.apart,
                "periodograms": c.periodograms,
                "standard_error": c.standard_error,
                "bits_per_pixel_of_a_line": {"predicted": c.bits_predicted, "found": c.bits_found},
            }
            for c in self.curves
        ]
        return {
            "pipeline": self.pipeline,
            "reflectance": self.reflectance,
            "contrast_ratio": self.ratio,
            "object": {"width_pixels": self.size, "contrast": self.contrast},
            "electrons": self.electrons,
            "block": self.block,
            "rows": rows,
            "neq": curves,
            "notes": self.notes,
        }

"""Report of noise after every stage of a camera, and its JSON form.

In:  predicted and measured values of ``noise``.
Out: a document.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from etendue.types.documents import Document


@dataclass
class StageNoise:
    """One picture of one stage: values per channel, and correlations of the first channel pairs."""

    stage: str
    variable: str
    channels: tuple[str, ...]
    predicted: list[float]  # standard deviations
    found: list[float]
    found_error: list[float]  # standard error of the measured values
    between: dict[str, tuple[float, float]]  # 'R G' -> correlation at one pixel, predicted and measured
    neighbours: list[tuple[float, float]]  # correlation of horizontal neighbours by channel, predicted and measured


@dataclass
class NoiseReport:
    """Noise after every stage of a camera."""

    pipeline: str
    reflectance: float
    frames: int
    signal: dict[str, float]  # channel -> mean charge, electron
    # channel -> standard deviation of the mosaic: predicted, measured, standard error
    mosaic: dict[str, tuple[float | None, float, float]]
    rows: list[StageNoise] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def document(self) -> Document:
        """Return the report as JSON."""
        rows = []
        for row in self.rows:
            for i, channel in enumerate(row.channels):
                rows.append(
                    {
                        "stage": row.stage,
                        "variable": row.variable,
                        "channel": channel,
                        "predicted": row.predicted[i],
                        "found": row.found[i],
                        "standard_error": row.found_error[i],
                        "neighbours": {"predicted": row.neighbours[i][0], "found": row.neighbours[i][1]},
                        "correlation": {
                            pair: {"predicted": p, "found": f}
                            for pair, (p, f) in row.between.items()
                            if channel in pair.split()
                        },
                    }
                )
        mosaic = [
            {"channel": c, "electrons": self.signal.get(c), "predicted": p, "found": f, "standard_error": e}
            for c, (p, f, e) in self.mosaic.items()
        ]
        return {
            "pipeline": self.pipeline,
            "reflectance": self.reflectance,
            "frames": self.frames,
            "mosaic": mosaic,
            "rows": rows,
            "notes": self.notes,
        }

"""The figure of a check: photon transfer, measured and predicted, with residuals below.

In:  the checks of a calibration.
Out: a plot.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from etendue.present.plots.plot import Plot, new_figure
from etendue.types.documents import Document

BAND = 1.96


def photon_transfer(checks: list[Document], name: str, notice: str = "") -> Plot:
    """Draw every channel: points with their intervals, the prediction with its band, residuals in per cent."""
    figure = new_figure(7.0, 6.0)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1), gridspec_kw={"hspace": 0.08})
    rows: list[list[str | float]] = []
    for number, check in enumerate(checks):
        peak = max(float(row["variance"]) for row in check["levels"])
        shown = [row for row in check["levels"] if row["variance"] > 0.05 * peak]
        x, measured, predicted = (_of(shown, key) for key in ("signal", "variance", "variance_predicted"))
        order = np.argsort(x)
        error = (_of(shown, "variance_high") - _of(shown, "variance_low")) / 2
        color = f"C{number}"
        upper.errorbar(x, measured, error, fmt="o", ms=3, lw=1, color=color, label=f"measured, {check['channel']}")
        inside = np.array([row["judged"] for row in shown])[order]
        band = error[order]
        upper.plot(x[order][inside], predicted[order][inside], color="0.2", lw=1.2, label="predicted, unscaled")
        upper.fill_between(
            x[order][inside],
            (predicted[order] - band)[inside],
            (predicted[order] + band)[inside],
            color="0.2",
            alpha=0.2,
            label="95 % of a measured variance" if not number else None,
        )
        residual = 100 * (measured / predicted - 1)
        lower.errorbar(
            x[order][inside], residual[order][inside], (100 * error / predicted)[order][inside], fmt="o", ms=3, lw=1,
            color=color,
        )  # fmt: skip
        rows += [
            [str(check["channel"]), *(float(one[i]) for one in (x, measured, predicted))] for i in range(len(shown))
        ]
    lower.axhline(0, color="0.2", lw=1)
    for level in (-3, 3):
        lower.axhline(level, color="0.6", lw=0.8, ls=":", label="limit" if level > 0 else None)
    lower.set_ylim(-5, 5)
    upper.set_ylabel("temporal variance, DN$^2$")
    lower.set_ylabel("measured - predicted, %")
    lower.set_xlabel("signal above the dark, DN (judged from 2 to 90 % of saturation)")
    lower.legend(frameon=False, fontsize=8, loc="upper right")
    upper.set_title(f"Photon transfer of {name}", fontsize=10, loc="left")
    upper.legend(frameon=False, fontsize=8)
    if notice:
        figure.get_layout_engine().set(rect=(0, 0.035, 1, 0.965))
        figure.text(0.99, 0.01, notice, ha="right", va="bottom", fontsize=6, color="0.35")
    return Plot(figure, ["channel", "signal", "variance", "variance_predicted"], rows)


def _of(rows: list[Document], key: str) -> Any:
    return np.array([row[key] for row in rows], float)

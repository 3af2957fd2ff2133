"""The manifest of the studies: commands, plots, and methods of pipelines and archives, through the hooks that any
distribution uses.
"""

from __future__ import annotations

from etendue.api import hookimpl
from etendue.types.documents import Document

_CLI = "etendue_lab.cli"


@hookimpl
def etendue_commands() -> Document:
    return {
        name: {"place": f"{_CLI}.{place}", "usage": usage, "doc": doc}
        for name, place, usage, doc in (
            (
                "compare",
                "comparisons:compare",
                "FILE --axis demosaic.use",
                "rank alternatives by quality against run time",
            ),
            ("quality", "comparisons:quality", "FILE", "compare every camera of a sweep with the ideal camera"),
            ("noise", "comparisons:noise", "FILE", "report noise after every stage, predicted and measured"),
            ("emva", "emva:emva", "FILE", "measure a sensor by EMVA 1288, beside expected values"),
            ("calibrate", "calibrate:calibrate", "FRAMES", "make a sensor file from real frames, and check it"),
            ("measure", "measure:measure", "PICTURE", "measure a photograph: MTF, noise, ColorChecker"),
            (
                "information",
                "information:information",
                "FILE",
                "report bits per pixel of fine detail and where they are lost",
            ),
            ("losses", "information:losses", "FILE", "report each stage's share of lost contrast, SNR and colour"),
            ("optimise", "search:optimise", "FILE", "search for the settings that make a metric best"),
            (
                "pairs",
                "search:pairs",
                "FILE --photographs FOLDER",
                "make training data: pictures of random cameras with noise-free values",
            ),
            (
                "sensitivity",
                "designs:sensitivity",
                "ARCHIVE METRIC...",
                "report how much each factor of a design matters for metrics",
            ),
            ("yield", "designs:yield_", "ARCHIVE --require 'METRIC >= 60'", "report the share of units that pass"),
            ("stability", "stability:stability", "[STAGE]", "test every stage at numerically hard inputs"),
        )
    }


@hookimpl
def etendue_methods() -> dict[str, str]:
    return {
        "Pipeline.compare": "etendue_lab.compare.python:compare",
        "Pipeline.optimise": "etendue_lab.search.study:optimise",
        "Pipeline.pairs": "etendue_lab.pairs.drawing:pairs",
        "Pipeline.quality": "etendue_lab.quality.python:quality",
    }


@hookimpl
def etendue_shares() -> dict[str, str]:
    return {"losses": "etendue_lab.losses.archived:losses_at"}


@hookimpl
def etendue_plots() -> Document:
    return {
        "limits": {
            "place": "etendue.present.plots.asked:names_of",
            "doc": "the factor that limits resolution, over two axes",
            "uses": ("x", "y", "panels", "at"),
            "index": True,
        },
        "indices": {
            "place": "etendue_lab.designs.drawing:index_bars",
            "doc": "the indices of every factor of a design, with intervals",
            "uses": ("at",),
        },
        "convergence": {
            "place": "etendue_lab.designs.drawing:converging",
            "doc": "the indices of a design against the number of points, with intervals",
            "uses": ("at",),
        },
        "yield": {
            "place": "etendue_lab.designs.drawing:yield_curve",
            "doc": "the share of the samples of a design that reach a limit, against the limit",
            "uses": ("at",),
        },
    }


@hookimpl
def etendue_sections() -> Document:
    return {"designs": {"place": "etendue_lab.designs.report:section", "title": "Samples of a design"}}


@hookimpl
def etendue_words() -> dict[str, str]:
    return {"lost": "contrast, SNR and colour", "lost_words": "contrast, signal-to-noise ratio and colour"}

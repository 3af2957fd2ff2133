"""What this distribution provides: a demosaicer."""

from __future__ import annotations

from etendue.api import hookimpl


@hookimpl
def etendue_stages() -> dict[str, str]:
    return {"demosaic_menon": "etendue_demosaic_menon.stages:DemosaicMenon"}

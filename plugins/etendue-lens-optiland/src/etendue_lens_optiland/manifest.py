"""What this distribution brings to etendue: a lens that is traced, in four stages."""

from __future__ import annotations

from etendue.api import hookimpl


@hookimpl
def etendue_stages() -> dict[str, str]:
    return {
        "real_lens": "etendue_lens_optiland.stages:Blur",
        "real_lens_distortion": "etendue_lens_optiland.stages:Distortion",
        "real_lens_illumination": "etendue_lens_optiland.stages:Illumination",
        "real_lens_numbers": "etendue_lens_optiland.stages:Numbers",
    }

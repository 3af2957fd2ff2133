"""What this distribution provides: three demosaicers, two denoisers, a deconvolution."""

from __future__ import annotations

from etendue.api import hookimpl


@hookimpl
def etendue_stages() -> dict[str, str]:
    return {
        "opencv_bilinear": "etendue_other_libraries.from_opencv:Bilinear",
        "opencv_edge_aware": "etendue_other_libraries.from_opencv:EdgeAware",
        "opencv_vng": "etendue_other_libraries.from_opencv:GradientNumber",
        "skimage_nl_means": "etendue_other_libraries.from_skimage:NonLocalMeans",
        "skimage_richardson_lucy": "etendue_other_libraries.from_skimage:RichardsonLucy",
        "scipy_wiener": "etendue_other_libraries.from_scipy:LocalWiener",
    }

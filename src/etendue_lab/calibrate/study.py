"""``etendue calibrate``: all channels of a measurement, the sensor file, the check.

In:  a path.
Out: the document, and the text of the sensor file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from etendue.types.documents import Document
from etendue_lab.calibrate import sensor_file
from etendue_lab.calibrate.calibration import calibrate
from etendue_lab.calibrate.checking import check as check_of
from etendue_lab.calibrate.edge_blur import EdgePhotograph, edge_blur
from etendue_lab.frames.frame_set import Window
from etendue_lab.frames.moments import sites
from etendue_lab.frames.reading import open_frames

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Geometry:
    """Inputs that frames of uniform light do not determine: the geometry of the pixel, and an edge photograph for the
    lens.
    """

    pitch: float | None = None  # um
    aperture: float | None = None  # side of the light-sensitive square over the pitch
    edge: Path | None = None
    edge_window: str | None = None


def calibrated(
    path: Path, window: str | None = None, pattern: str | None = None, geometry: Geometry = Geometry(),
    check: bool = False,
) -> tuple[Document, str]:  # fmt: skip
    """Calibrate a measurement.

    Raises
    ------
    RequestError
        The path is not a measurement, or its frames give no photon transfer curve.
    """
    frames = open_frames(path, Window.read(window) if window else None, pattern)
    places = sites(frames)
    models = [calibrate(frames, site, name, CONFIDENCE) for name, site in places.items()]
    digests = frames.digests()
    blur = None
    if geometry.edge is not None and geometry.pitch and geometry.aperture:
        place = Window.read(geometry.edge_window, "--edge-window") if geometry.edge_window else None
        edge = EdgePhotograph(geometry.edge, geometry.pitch, geometry.aperture, place)
        blur = edge_blur(edge, frames, models, places, CONFIDENCE)
    document: Document = {
        "measurement": path.name,
        "confidence": CONFIDENCE,
        "rows": frames.shape[0],
        "columns": frames.shape[1],
        "frames": len(frames.frames),
        "digests": digests,
        "channels": [
            {
                "channel": model.channel,
                "parameters": [
                    {
                        "name": name,
                        "value": one.value,
                        "low": one.low,
                        "high": one.high,
                        "unit": one.unit,
                        "how": model.how[name],
                    }
                    for name, one in model.values.items()
                ],
                "order": model.response.order if model.response.bend else 0,
                "waves": [vars(one) for one in model.dark.waves] if model.dark else [],
                "needs": model.needs,
                "tests": model.tests,
            }
            for model in models
        ],
        "edge": None
        if blur is None
        else {
            "file": blur.file,
            "digest": blur.digest,
            "sigma": blur.sigma.value,
            "sigma_low": blur.sigma.low,
            "sigma_high": blur.sigma.high,
            "mtf50": blur.mtf50.value,
            "mtf50_low": blur.mtf50.low,
            "mtf50_high": blur.mtf50.high,
            "angle": blur.angle,
            "misfit": blur.misfit,
        },
        "checks": [check_of(frames, one, places[one.channel]) for one in models] if check else [],
        "notes": list(frames.notes),
    }
    if any(model.response.bend < 0 for model in models):
        document["notes"].append(
            "the response rises above a line, which a sensor file cannot describe; the file therefore contains no bend"
        )
    return document, sensor_file.text(models, frames, geometry.pitch, geometry.aperture or 1.0, digests, blur)

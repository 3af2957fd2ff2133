"""``etendue calibrate``: all channels of a measurement, the sensor file, the check.

In:  a path.
Out: the document, and the text of the sensor file.
"""

from __future__ import annotations

from pathlib import Path

from etendue.types.documents import Document
from etendue_lab.calibrate import sensor_file
from etendue_lab.calibrate.checking import check as check_of
from etendue_lab.calibrate.sensor_model import calibrate
from etendue_lab.frames.frame_set import Window
from etendue_lab.frames.moments import sites
from etendue_lab.frames.reading import open_frames

CONFIDENCE = 0.95


def calibrated(
    path: Path, window: str | None, pattern: str | None, pitch: float | None, check: bool
) -> tuple[Document, str]:
    """Calibrate a measurement.

    Raises
    ------
    RequestError
        It is no measurement, or holds no photon transfer curve.
    """
    frames = open_frames(path, Window.read(window) if window else None, pattern)
    places = sites(frames)
    models = [calibrate(frames, site, name, CONFIDENCE) for name, site in places.items()]
    digests = frames.digests()
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
        "checks": [check_of(frames, one, places[one.channel]) for one in models] if check else [],
        "notes": list(frames.notes),
    }
    if any(model.response.bend < 0 for model in models):
        document["notes"].append(
            "the response rises above a line, which the sensor file cannot say: no bend is written"
        )
    return document, sensor_file.text(models, frames, pitch, digests)

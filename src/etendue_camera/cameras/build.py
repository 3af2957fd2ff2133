"""Write the packaged tables of cameras from copies of their sources: python -m etendue_camera.cameras.build FOLDER

In:  a folder with ``ssf`` (rawtoaces-data) and ``libcamera`` (its vc4 tunings).
Out: ``data/cameras``: one table per sensitivity, the tunings without the parts that nothing reads, both licences.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from etendue_camera.cameras.sensitivities import sensitivity
from etendue_camera.cameras.tunings import tuning

DATA = Path(__file__).parents[1] / "data" / "cameras"
READ = ("rpi.black_level", "rpi.lux", "rpi.noise", "rpi.agc", "rpi.alsc", "rpi.ccm")


def file_of(camera: str) -> str:
    """Return the name of the file of a camera's sensitivity."""
    return re.sub(r"[^a-z0-9]+", "-", camera.casefold()).strip("-") + ".csv"


def main(folder: Path) -> None:
    names = []
    for path in sorted((folder / "ssf").glob("*.json")):
        found = sensitivity(path.read_bytes(), path.name)
        (DATA / "sensitivities" / file_of(found.camera)).write_text(found.csv(), encoding="utf-8")
        names.append(f"{found.camera},{file_of(found.camera)},{found.per},{found.creator},{found.licence}\n")
    head = "# AcademySoftwareFoundation/rawtoaces-data e9b8503, Apache-2.0\ncamera,file,per,creator,licence\n"
    (DATA / "sensitivities.csv").write_text(head + "".join(names), encoding="utf-8")
    (DATA / "LICENSE-rawtoaces-data").write_bytes((folder / "ssf" / "LICENSE").read_bytes())
    for path in sorted((folder / "libcamera").glob("*.json")):
        tuning(path.read_bytes(), path.name)
        document = json.loads(path.read_bytes())
        document["algorithms"] = [
            {key: _read_part(key, own)} for one in document["algorithms"] for key, own in one.items() if key in READ
        ]
        text = json.dumps(document, separators=(",", ":"))
        (DATA / "tunings" / path.name).write_text(text + "\n", encoding="utf-8")


def _read_part(key: str, own: dict[str, object]) -> dict[str, object]:
    """Return the parameters of an algorithm that this package reads."""
    if key == "rpi.alsc":
        return {"luminance_lut": own["luminance_lut"]} if "luminance_lut" in own else {}
    if key == "rpi.agc":
        channels = own.get("channels", [own])
        assert isinstance(channels, list)
        return {"channels": [{"exposure_modes": one.get("exposure_modes", {})} for one in channels]}
    return own


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""Build the shipped tables: ``python -m etendue_camera.spectra.build``.

In:  the installed colour-science.
Out: ``data/spectra.npz``; its version and digest on stdout.
"""

from importlib.resources import files
from pathlib import Path

from etendue_camera.spectra import shipped


def main() -> None:
    found = shipped.made()
    data = shipped.packed(found)
    place = Path(str(files("etendue_camera") / "data" / "spectra.npz"))
    place.write_bytes(data)
    tables = sum(len(array) for name, array in found.items() if name.endswith("/names"))
    print(
        f"{place.name}: {tables} tables of colour-science {found[shipped.VERSION]}, {len(data)} bytes, digest "
        f"{shipped.digest_of(data)}"
    )


if __name__ == "__main__":
    main()

"""The file behind the name of a spectral table that a distribution provides."""

from __future__ import annotations

from etendue.plugins.discovery import table_file as spectrum

LIBRARY = "colour-science"  # instead of a path: a table of this library
ENDINGS = (".csv", ".spdx")  # extensions of files with tables by wavelength

__all__ = ["ENDINGS", "LIBRARY", "spectrum"]

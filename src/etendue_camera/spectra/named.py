"""The file behind the name of a spectrum: of a table that a distribution brings."""

from __future__ import annotations

from etendue.plugins.discovery import table_file as spectrum

LIBRARY = "colour-science"  # in place of a path: a table of this library
ENDINGS = (".csv", ".spdx")  # of files with tables by wavelength

__all__ = ["ENDINGS", "LIBRARY", "spectrum"]

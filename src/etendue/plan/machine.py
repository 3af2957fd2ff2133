"""Resources of the machine, read before anything runs."""

from __future__ import annotations

import os
from pathlib import Path


def available_memory() -> int:
    """Return the bytes available without swapping, counting the system's file cache as free; 0 if unknown."""
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    except (ValueError, OSError):
        pass
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (ValueError, OSError):
        return 0

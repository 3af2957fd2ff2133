"""Whether a plan fits the machine: memory and disk, before anything runs."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from etendue.errors import MachineError
from etendue.plan.cost import cell_bytes
from etendue.plan.model import Plan
from etendue.plan.strips import peak_memory
from etendue.telling import human_bytes


def check_machine(plan: Plan, archive: Path | None) -> None:
    """Refuse a plan that cannot fit, naming the axis that makes it so."""
    need = sum(
        cell_bytes(n, c, plan.precision, [v for v in n.writes if (n.name, v) in plan.kept]) for n in plan.nodes for c in plan.of(n.name)
    )
    available = available_memory()
    peak = peak_memory(plan) + (need if archive is None else 0)
    if available and peak > available:
        where = "held in memory" if archive is None else "held at once"
        way_out = _way_out(plan, peak_memory(plan, 1), available)
        raise MachineError(f"about {human_bytes(peak)} would be {where}, {human_bytes(available)} are free{way_out}")
    if archive is not None:
        folder = archive.absolute()
        while not folder.exists():
            folder = folder.parent
        held = sum(512 * f.stat().st_blocks for f in archive.rglob("*") if f.is_file()) if archive.exists() and need > 1e9 else 0
        free = shutil.disk_usage(folder).free + held
        if need > free:
            raise MachineError(
                f"about {human_bytes(need)} would be stored, {human_bytes(free)} are free on the disk{_way_out(plan, _of_one(plan), free)}"
            )


def _of_one(plan: Plan) -> int:
    """Bytes that are kept of the largest cell."""
    return max(
        (cell_bytes(n, c, plan.precision, [v for v in n.writes if (n.name, v) in plan.kept]) for n in plan.nodes for c in plan.of(n.name)),
        default=0,
    )  # fmt: skip


def _way_out(plan: Plan, one: int, room: int) -> str:
    """What makes a plan smaller: where a single cell takes more than there is, or nothing is swept, only smaller cells."""
    longest = max(plan.axes, key=lambda a: len(a.values), default=None)
    if longest is None or one > room:
        what = f"one cell takes {human_bytes(one)}" if one > room else "nothing is swept"
        return f"; {what}: take a wider spacing of the scene, a wider bin_width, a smaller window on the sensor, or a shorter 'keep'"
    return f"; the axis {longest.key} has {len(longest.values)} values; shorten 'keep' or the sweep"


def available_memory() -> int:
    """Bytes that can be had without swapping; the system's cache of files counts as free."""
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

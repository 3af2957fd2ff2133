"""Progress on the terminal: of a plan, of a run, and of trials.

All of it goes to stderr; if stderr is not a terminal, nothing is printed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console

from etendue.contract.ports import CellReport
from etendue.plan.model import Plan
from etendue.present.terminal.terminal import escape, human_rate

if TYPE_CHECKING:
    from rich.progress import Progress
    from rich.status import Status


class TerminalProgress:
    """A progress bar on stderr; silent if stderr is not a terminal."""

    def __init__(self, plan: Plan) -> None:
        self.console = Console(stderr=True)
        self.progress: Progress | None = None

    def begin(self, cells: int) -> None:
        if not self.console.is_terminal or not cells:
            return
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        self.progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("cells {task.fields[rate]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=self.console,
            transient=True,
        )
        self.progress.start()
        self.task = self.progress.add_task("starting", total=cells, rate="")

    def starting(self, stages: tuple[str, ...]) -> None:
        if self.progress:
            self.progress.update(
                self.task, description=stages[-1][:24] if len(stages) == 1 else f"{stages[0]} .. {stages[-1]}"[:40]
            )

    def finished(self, reports: tuple[CellReport, ...]) -> None:
        if self.progress:
            self.progress.advance(self.task, len(reports))
            speed = self.progress.tasks[0].speed  # recent speed
            self.progress.update(self.task, rate=human_rate(speed) if speed else "")

    def end(self) -> None:
        if self.progress:
            self.progress.stop()
            self.progress = None


@contextmanager
def trying(silent: bool = False) -> Iterator[Callable[[str], None]]:
    """Show the present trial on stderr; silent if stderr is not a terminal."""
    console = Console(stderr=True)
    if silent or not console.is_terminal:
        yield lambda text: None
        return
    with console.status("") as status:
        yield lambda text: status.update(f"trying {escape(text)}")


@contextmanager
def planning() -> Iterator[Callable[[int, int], None]]:
    """Show the progress of planning on stderr once it takes longer than a second."""
    console, began = Console(stderr=True), time.monotonic()
    said: Status | None = None

    def told(done: int, total: int) -> None:
        nonlocal said
        if said is None and time.monotonic() - began > 1.0:
            said = console.status("")
            said.start()
        if said is not None:
            said.update(f"planning {done} of {total} cells")

    try:
        yield told
    finally:
        if said is not None:
            said.stop()

"""The program ``etendue``: signal handlers are active from before the first heavy import until the process ends."""

from __future__ import annotations

import gc
import sys

from etendue import interrupts

# New objects before the youngest generation is collected, until cells are computed. The modules and the plan of a
# command stay to its end; scanning them after every 700 new objects takes a tenth of the time of a short command.
AT_ONCE = 200_000


def main() -> None:
    """Run the command line as the main program of the process."""
    interrupts.install()
    gc.set_threshold(AT_ONCE, *gc.get_threshold()[1:])
    code = 1
    try:
        from etendue.cli import main as command

        command(prog_name="etendue")
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    _flush()
    _last_words()
    _flush()
    # without interpreter shutdown: no leftover thread delays the exit, and no late signal meets a half-closed state
    interrupts.end_now(code)


def _last_words() -> None:
    """Run the exit handlers of the process."""
    import atexit

    interrupts.ends()
    try:
        atexit._run_exitfuncs()
    except BaseException:  # already reported on stderr
        pass


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError, AttributeError):
            pass


if __name__ == "__main__":
    main()

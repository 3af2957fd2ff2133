"""The program ``etendue``: signals are answered before anything heavy is imported, and to the very end."""

from __future__ import annotations

import sys

from etendue import interrupts


def main() -> None:
    """Run the command line as a process of its own."""
    interrupts.install()
    code = 1
    try:
        from etendue.cli import main as command

        command(prog_name="etendue")
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    _flush()
    _last_words()
    _flush()
    interrupts.end_now(
        code
    )  # a thread that is left behind holds nobody up, and a late signal finds no interpreter half taken down


def _last_words() -> None:
    """What was asked to be done at the end of the process."""
    import atexit

    interrupts.ends()
    try:
        atexit._run_exitfuncs()
    except BaseException:  # said on stderr by whoever raised it
        pass


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError, AttributeError):
            pass


if __name__ == "__main__":
    main()

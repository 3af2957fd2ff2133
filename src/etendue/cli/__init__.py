"""The command line: words in, results on stdout, one clear message on stderr, an exit code.

In:  the arguments of the process.
Out: what a command of ``runs``, ``catalogue``, ``comparisons`` or ``exports`` shows.

``program`` holds the commands together and turns errors into messages; ``options`` declares what commands share, once;
``saying`` writes to stdout. What a command does stands in ``bodies``, or with the study that brings it, and is imported
when the command is called (``saying.later``), so that ``--help`` costs nothing.
"""

from etendue.cli.program import main

__all__ = ["main"]

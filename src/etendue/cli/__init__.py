"""The command line: words in, results on stdout, one clear message on stderr, an exit code.

In:  the arguments of the process.
Out: what a command of ``runs``, ``catalogue``, ``comparisons`` or ``exports`` shows.

``program`` holds the commands together and turns errors into messages; ``options`` declares what commands share, once;
``saying`` writes to stdout. Bodies import what they need when they run, so that ``--help`` costs nothing.
"""

from etendue.cli.program import main

__all__ = ["main"]

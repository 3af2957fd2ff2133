"""The command line: parse arguments, print results on stdout and one clear message on stderr, set the exit code.

In:  the arguments of the process.
Out: what a command of ``runs``, ``catalogue``, ``comparisons`` or ``exports`` prints.

``program`` collects the commands and turns errors into messages; ``options`` declares shared options once; ``saying``
writes to stdout. Commands import what they need when they run, so that ``--help`` stays fast.
"""

from etendue.cli.program import main

__all__ = ["main"]

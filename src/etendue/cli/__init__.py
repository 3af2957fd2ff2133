"""The command line: arguments in, results on stdout, errors as one clear message on stderr, an exit code.

In:  the arguments of the process.
Out: the output of a command of ``runs``, ``catalogue``, ``comparisons`` or ``exports``.

``program`` collects the commands and turns errors into messages; ``options`` declares shared options once; ``saying``
writes to stdout. The implementation of a command is in ``bodies``, or in the study that provides it, and is imported
when the command is called (``saying.later``), so that ``--help`` stays fast.
"""

from etendue.cli.program import main

__all__ = ["main"]

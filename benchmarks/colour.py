"""Colour through the whole camera: runs colours.py.

    python benchmarks/colour.py [--plot FILE]

This file bears the name of the library colour-science, and Python looks in this folder first: whoever imports
``colour`` from a benchmark comes here and is sent on to the library.
"""

import importlib
import sys
from pathlib import Path

if __name__ == "__main__":
    from colours import main

    main()
elif __name__ == "colour":  # the library itself looks here a second time, under another name, and finds nothing
    here = Path(__file__).resolve().parent
    kept = sys.path[:]
    sys.path[:] = [p for p in kept if Path(p or ".").resolve() != here]
    try:
        del sys.modules[__name__]
        importlib.invalidate_caches()
        sys.modules[__name__] = importlib.import_module(__name__)
    finally:
        sys.path[:] = kept

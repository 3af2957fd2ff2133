"""Laws are tried on the same examples in every run, so that a change is judged by what it changes.

HYPOTHESIS_PROFILE=explore tries new ones.
"""

import os
import tempfile
from pathlib import Path

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

os.environ.setdefault("ETENDUE_CACHE", str(Path(tempfile.gettempdir()) / f"etendue-tests-{os.getuid()}"))  # not the user's own

"""Tables of user-supplied reflectances: fractions, not per cent.

In:  the path of a table.
Out: nothing, or a ValueError that names the column.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from etendue_camera.spectra.bins import csv_rows

HIGHEST = 2.0  # a fluorescent white reaches about 1.3; values in per cent are above for all but black surfaces


def require_shares(what: str, path: str | Path) -> None:
    """Raise ValueError for reflectances that are not fractions, such as percentages.

    Raises
    ------
    ValueError
        If a column exceeds 2.
    """
    names, _, values = csv_rows(path)
    highest = values.max(axis=0)
    worst = int(np.argmax(highest))
    if highest[worst] > HIGHEST:
        raise ValueError(
            f"{what}: {names[worst]} of {path} reaches {highest[worst]:g}: a reflectance is a fraction; divide per "
            f"cent values by 100 (up to {HIGHEST:g} is accepted, for fluorescence)"
        )

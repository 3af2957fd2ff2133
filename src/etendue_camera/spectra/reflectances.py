"""Tables of reflectances of one's own: shares of the light, not percents.

In:  the path of a table.
Out: nothing, or a refusal that names the column.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from etendue_camera.spectra.bins import csv_rows

HIGHEST = 2.0  # a fluorescent white reaches some 1.3 where it shines; percents of all but black surfaces are above


def require_shares(what: str, path: str | Path) -> None:
    """Refuse reflectances that cannot be shares.

    Raises
    ------
    ValueError
        A column goes above 2.
    """
    names, _, values = csv_rows(path)
    highest = values.max(axis=0)
    worst = int(np.argmax(highest))
    if highest[worst] > HIGHEST:
        raise ValueError(
            f"{what}: {names[worst]} of {path} reaches {highest[worst]:g}: a reflectance is a share; divide percents "
            f"by 100 "
            f"(up to {HIGHEST:g} passes, for what fluoresces)"
        )

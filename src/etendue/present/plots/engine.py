"""Backend for ``xarray.open_datatree``: opens the folder of an archive with ``engine="etendue"`` or no engine, and
registers the accessors.

In:  the folder of an archive.
Out: its tree, or one group of it, lazy.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import xarray
from xarray.backends import BackendEntrypoint

from etendue.present.plots import accessor
from etendue.present.plots.opening import opened

accessor.register()


class EtendueBackend(BackendEntrypoint):
    """Backend that xarray finds automatically if etendue is installed (entry point ``xarray.backends``)."""

    description = "Archives of etendue"
    supports_groups = True
    open_dataset_parameters = ("filename_or_obj", "drop_variables", "group")

    def open_dataset(
        self, filename_or_obj: Any, *, drop_variables: str | Iterable[str] | None = None, group: str = ""
    ) -> xarray.Dataset:
        return opened(Path(filename_or_obj))[group or "/"].to_dataset().drop_vars(drop_variables or [])

    def open_datatree(
        self, filename_or_obj: Any, *, drop_variables: str | Iterable[str] | None = None
    ) -> xarray.DataTree:
        tree = opened(Path(filename_or_obj))
        return (
            tree.map_over_datasets(lambda data: data.drop_vars(drop_variables, errors="ignore"))
            if drop_variables
            else tree
        )

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        try:
            folder = Path(filename_or_obj)
        except TypeError:
            return False
        return (folder / "data.zarr").is_dir() and (folder / "journal.jsonl").is_file()

"""The trials of a search on disk: a stopped search continues and gives the same trials.

In:  a folder, the request and the pipeline.
Out: finished trials by number; each new trial adds a line to the file.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

from etendue.errors import Fault, RequestError
from etendue.result_files import check_folder, write_whole
from etendue.types.documents import Document, DocumentView

REQUEST, TRIALS = "search.json", "trials.jsonl"


class Memory:
    """The record of a search in a folder; empty without a folder.

    Raises
    ------
    RequestError
        The folder cannot be written to, or belongs to another search.
    """

    def __init__(self, folder: Path | None, request: DocumentView) -> None:
        self.folder = folder
        self.trials: list[Document] = []
        if folder is None:
            return
        check_folder(folder)
        wanted = json.loads(json.dumps(request))
        known = _document(folder / REQUEST)
        if known is not None and known != wanted:
            differ = [key for key in wanted if known.get(key) != wanted[key]]
            raise RequestError(
                [Fault(str(folder), f"holds another search ({', '.join(differ)} differ); choose another --output")]
            )
        if known is None:
            write_whole(folder, {REQUEST: json.dumps(request, indent=1).encode()})
        self.trials = self._read(folder / TRIALS)

    def _read(self, path: Path) -> list[Document]:
        """Return the trials; remove an incomplete last line from the file."""
        if not path.exists():
            return []
        whole, found = 0, list[Document]()
        with path.open("rb") as file:
            for line in file:
                try:
                    trial = json.loads(line) if line.endswith(b"\n") else None
                except ValueError:
                    trial = None
                if not isinstance(trial, dict) or trial.get("number") != len(found):
                    break
                found.append(trial)
                whole += len(line)
        if whole < path.stat().st_size:
            os.truncate(path, whole)
        return found

    def of(self, number: int, settings: DocumentView) -> Document | None:
        """Return the stored result of trial ``number``; None if the trial is not finished.

        Raises
        ------
        RequestError
            The stored trial had other settings, so the search cannot be replayed.
        """
        if number >= len(self.trials):
            return None
        known = self.trials[number]
        if known["settings"] != json.loads(json.dumps(dict(settings))):
            raise RequestError(
                [
                    Fault(
                        str(self.folder),
                        f"trial {number} had other settings, {known['settings']}; this version searches in "
                        "another way: choose another --output",
                    )
                ]
            )
        return known

    def add(self, trial: DocumentView) -> None:
        """Write a finished trial; it is on disk when this returns."""
        if self.folder is None:
            return
        with (self.folder / TRIALS).open("ab") as file:
            file.write(json.dumps(dict(trial)).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())


def _document(path: Path) -> Document | None:
    try:
        found = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None

"""The place of an archive: a folder, or a URL of an object store. This module provides a folder to code that needs one.

In:  a path, or ``s3://bucket/prefix/name``.
Out: a folder that exists as long as it is needed; texts and documents in which the URL replaces that folder.
"""

from __future__ import annotations

import dataclasses
import fcntl
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue import interrupts
from etendue.archive.records.owner import Behind, stand, unless_written
from etendue.archive.remote import stubs
from etendue.archive.remote.lease import look
from etendue.archive.remote.objects import Objects, zarr_store
from etendue.calls import called
from etendue.errors import ArchiveError, EtendueError, RequestError

if TYPE_CHECKING:
    import xarray

READING = "reading-"


class Url(str):
    """A place on an object store, with the ``/`` of paths."""

    def __truediv__(self, name: str) -> Url:
        return Url(f"{self.rstrip('/')}/{name}")


def is_url(place: object) -> bool:
    """Return True if a place is on an object store."""
    return "://" in str(place)


@contextmanager
def reading(place: str | Path, exact: bool = False, inputs: bool = True) -> Iterator[Path]:
    """Yield a folder from which an archive can be read.

    For an archive on an object store, small objects are fetched now, all others when they are read; nothing is written
    to the store. ``exact``: fetch the indexes of shards instead of deriving them from the journal; ``inputs``: also
    fetch the input files of pipelines.

    Raises
    ------
    ArchiveError
        There is no archive, or the store cannot be reached.
    ArchiveInUse
        A run is replacing the cells that are read.
    """
    if not is_url(place):
        with unless_written(Path(place)):
            yield Path(place)
        return
    from etendue.archive.mirror import work_place

    work = work_place()
    work.mkdir(parents=True, exist_ok=True)
    _sweep(work)
    own = Path(tempfile.mkdtemp(prefix=READING, dir=work))
    held = os.open(own / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(held, fcntl.LOCK_SH)
        yield from _fetched(str(place), own, exact, inputs)
    finally:
        os.close(held)
        shutil.rmtree(own, ignore_errors=True)


def _fetched(url: str, own: Path, exact: bool, inputs: bool) -> Iterator[Path]:
    from etendue.archive.fetching import Here, fetch

    objects = Objects(url)
    here, found = Here(own, objects.url), objects.list()
    if not {"journal.jsonl", "data.zarr/zarr.json", "manifest.json"} & found.keys():
        raise ArchiveError(f"{objects.url} is not an archive of etendue")
    seen = look(objects)
    fetch(objects, here, seen, found, exact, inputs)
    here.save()
    (here.folder / "lock").touch()
    stand(here.folder, Behind(seen.held() > 0))
    try:
        with _said(objects.url, here.folder):
            yield here.folder
    finally:
        stand(here.folder, None)
        stubs.forget(here.folder)


def _sweep(work: Path) -> None:
    """Remove folders that killed readers have left."""
    for place in work.glob(f"{READING}*"):
        try:
            held = os.open(place / "lock", os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            continue
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(place, ignore_errors=True)
        except BlockingIOError:
            pass
        finally:
            os.close(held)


@contextmanager
def writing(place: str | Path, far: str = "", exact: bool = False) -> Iterator[Path]:
    """Yield a folder into which a run may write; its changes are on the object store at the end. ``far``: the
    scheduler, if its workers may be on other machines.

    Raises
    ------
    ArchiveError, ArchiveInUse, StoreLost
        The store cannot be reached, or another run is writing there.
    RequestError
        The workers of a cluster would not see the folder.
    """
    if not is_url(place):
        yield Path(place)
        return
    from etendue.archive.mirror import Mirror

    if far and not os.environ.get("ETENDUE_WORK"):
        raise RequestError(
            f"--scheduler {far} with {place}: workers of a cluster store results in a folder that all of them can "
            "access; "
            "set ETENDUE_WORK=DIR to one on a shared file system, or use another scheduler"
        )
    mirror = Mirror(str(place), exact)
    try:
        with mirror as folder, _said(mirror.objects.url, folder):
            interrupts.say(f"interrupted; finished results are kept in {mirror.here.place}, run again to continue")
            yield folder
    finally:
        for text in mirror.notes:
            print(f"note: {text}", file=sys.stderr)


@contextmanager
def _said(url: str, folder: Path) -> Iterator[None]:
    """Replace the working folder by the URL in errors."""
    try:
        yield
    except RequestError as error:
        faults = [
            dataclasses.replace(f, place=named(f.place, folder, url), message=named(f.message, folder, url))
            for f in error.faults
        ]
        raise RequestError(faults, named(error.file, folder, url)) from None
    except EtendueError as error:
        error.args = tuple(named(one, folder, url) for one in error.args)
        raise


def named(value: Any, folder: Path, place: str | Path) -> Any:
    """Return a document in which the place of an archive replaces the working folder."""
    if not is_url(place):
        return value
    if isinstance(value, str | Path):
        return str(value).replace(str(folder), str(place).rstrip("/")) if str(folder) in str(value) else value
    if isinstance(value, dict):
        return {key: named(one, folder, place) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(named(one, folder, place) for one in value)
    return value


def placed(outcome: Any, folder: Path, place: str | Path) -> Any:
    """Return the outcome of a run with the requested place instead of the working folder."""
    if not is_url(place):
        return outcome
    return dataclasses.replace(outcome, archive=Url(place), pictures=named(outcome.pictures, folder, place))


@called
def open_archive(place: str | Path) -> xarray.DataTree:
    """Open an archive as a lazy ``xarray.DataTree``: arrays are read on access.

    An archive in a folder can also be opened during its run and after an interrupted one: every finished cell can be
    read, and ``status`` says which cells are finished. On an object store, only published results are visible.

    Raises
    ------
    ArchiveError
        There is no archive, or nothing in it can be read yet. In a folder, reading an array with lost chunks raises
        it too.
    """
    if not is_url(place):
        from etendue.archive.read.vouched.verified_store import open_archive as opened

        return opened(place)
    import xarray

    from etendue.archive.read.left_out import tree_with_left_out

    tree = tree_with_left_out(xarray.open_datatree(zarr_store(str(place)), engine="zarr"))
    tree.encoding["source"] = f"{str(place).rstrip('/')}/data.zarr"
    return tree

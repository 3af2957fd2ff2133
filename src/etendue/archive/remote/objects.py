"""Access to an object store: put, fetch, list and remove whole objects below one URL, with readable errors.

In:  ``s3://bucket/prefix/name`` (``file:///folder`` and ``memory:///name`` for trying things out), the usual AWS_*
     environment variables.
Out: bytes, tags of objects (ETag), one clear line per error.

A put replaces an object completely or not at all. A conditional put (``if_tag``) does not overwrite an object that
another process has put.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

from etendue.errors import ArchiveError, RequestError, StoreLost, shortened
from etendue.types.documents import Document

SCHEMES = ("s3", "file", "memory")
EXTRA = "pip install 'etendue[objects]'"
DATA = "data.zarr"
LARGE = 16 << 20  # bytes; larger objects are uploaded in parts, which the store assembles
KEYS = "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY (AWS_SKIP_SIGNATURE=true: none, for a public bucket)"
ROLES = (
    "AWS_ACCESS_KEY_ID",
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
)
_memory: Document = {}  # stores in memory, by URL


class Conflict(Exception):
    """Another process has written the object since it was read."""


class Unconditional(Exception):
    """The store does not support conditional writes."""


@dataclass(frozen=True)
class StoredObject:
    """An object on the store."""

    size: int
    tag: str  # changes whenever other bytes are put
    modified: float  # seconds since 1970, by the clock of the store


def plain_url(text: str) -> str:
    """Return a URL in its normal form.

    Raises
    ------
    RequestError
        The scheme is unknown, or the URL does not name an object below a bucket.
    """
    scheme, _, rest = text.partition("://")
    if scheme not in SCHEMES:
        raise RequestError(
            f"{text}: unknown scheme {scheme}://; archives are kept in folders or at s3://bucket/prefix/name"
        )
    rest = rest.rstrip("/") if scheme == "s3" else "/" + rest.strip("/")
    if scheme == "s3" and "@" in rest.split("/")[0]:
        raise RequestError(f"s3://...: a URL must not contain keys; set {KEYS}")
    if not re.fullmatch(r"[^/]+(/[^/]+)+" if scheme == "s3" else r"(/[^/]+)+", rest) or {"..", "."} & set(
        rest.split("/")
    ):
        raise RequestError(f"{text}: name an archive below a bucket, s3://bucket/prefix/name")
    return f"{scheme}://{rest}"


class Objects:
    """The objects below one URL. Threads may share it.

    Attributes
    ----------
    counts : requests by kind: one per object fetched, put or removed, and one per thousand listed
    """

    def __init__(self, url: str) -> None:
        self.url = plain_url(url)
        self.counts: Counter[str] = Counter()
        try:
            import obstore
        except ImportError:
            raise ArchiveError(f"{self.url}: object stores need the package obstore: {EXTRA}") from None
        self.api = obstore
        with self._asked("opening it"):
            self.store = _store(self.url)

    @property
    def name(self) -> str:
        return self.url.rpartition("/")[2]

    def list(self) -> dict[str, StoredObject]:
        """Return every object by its path below the URL."""
        found: dict[str, StoredObject] = {}
        with self._asked("listing it"):
            for page in self.api.list(self.store, chunk_size=1000):
                self.counts["list"] += 1
                for one in page:
                    found[one["path"]] = StoredObject(one["size"], one["e_tag"] or "", one["last_modified"].timestamp())
        self.counts["list"] += not found
        return {path: one for path, one in found.items() if not {"", ".", ".."} & set(path.split("/"))}

    def get(self, path: str) -> tuple[bytes, StoredObject]:
        """Return an object; raise ``FileNotFoundError`` if it does not exist."""
        with self._asked(f"fetching {path}"):
            self.counts["get"] += 1
            found = self.api.get(self.store, path)
            meta = found.meta
            return bytes(found.bytes()), StoredObject(
                meta["size"], meta["e_tag"] or "", meta["last_modified"].timestamp()
            )

    def part(self, path: str, start: int, length: int) -> bytes:
        """Return a byte range of an object; fewer bytes if the object ends earlier."""
        with self._asked(f"fetching {path}"):
            self.counts["get"] += 1
            return bytes(self.api.get_range(self.store, path, start=start, length=length)) if length else b""

    def pieces(self, path: str) -> Iterator[bytes]:
        """Yield an object in pieces."""
        with self._asked(f"fetching {path}"):
            self.counts["get"] += 1
            for piece in self.api.get(self.store, path).stream(min_chunk_size=LARGE):
                yield bytes(piece)

    def put(self, path: str, data: bytes | Path, if_tag: str | None = None) -> str:
        """Put an object and return its tag. ``if_tag``: only if the present object has this tag; '': only if the object
        does not exist.

        Raises
        ------
        Conflict
            The condition does not hold.
        Unconditional
            The store does not support conditional writes.
        """
        known: Any = self.api.exceptions
        mode: Any = None if if_tag is None else {"e_tag": if_tag} if if_tag else "create"
        with self._asked(f"putting {path}"):
            self.counts["put"] += 1
            try:
                return str(
                    self.api.put(self.store, path, data, mode=mode, chunk_size=LARGE, max_concurrency=2)["e_tag"] or ""
                )
            except (known.AlreadyExistsError, known.PreconditionError, FileExistsError):
                raise Conflict from None
            except (known.NotSupportedError, NotImplementedError):
                raise Unconditional from None
            except known.BaseError as error:
                if if_tag is not None and ("501 " in str(error) or "NotImplemented" in str(error)):
                    raise Unconditional from None
                raise

    def delete(self, paths: Iterable[str]) -> None:
        """Remove objects by name; missing objects are ignored."""
        gone = list(paths)
        with self._asked("removing objects"):
            self.counts["delete"] += len(gone)
            for path in gone if self.url.startswith("file:") else ():
                with suppress(FileNotFoundError):
                    self.api.delete(self.store, path)
            if gone and not self.url.startswith("file:"):
                self.api.delete(self.store, gone)

    @contextmanager
    def _asked(self, doing: str) -> Iterator[None]:
        """Replace errors of the store by errors with a readable message."""
        try:
            yield
        except self.api.exceptions.BaseError as error:
            raise _said(self.url, doing, error) from None
        except FileNotFoundError as error:
            if "NoSuchBucket" in str(error):
                raise _said(self.url, doing, error) from None
            raise FileNotFoundError(2, "no such object", doing.rpartition(" ")[2]) from None
        except PermissionError as error:
            raise _said(self.url, doing, error) from None


def _said(url: str, doing: str, error: Exception) -> Exception:
    text = str(error)
    if "NoSuchBucket" in text:
        bucket = url.removeprefix("s3://").partition("/")[0]
        return ArchiveError(f"{url}: there is no bucket {bucket!r}; create it first or use another")
    if "/latest/api/token" in text or "/latest/meta-data" in text or "169.254." in text:
        return ArchiveError(f"{url}: no credentials found; set {KEYS}")
    if type(error).__name__ in ("UnauthenticatedError", "PermissionDeniedError", "PermissionError") or " 403 " in text:
        code = re.search(r"<Code>(\w+)</Code>", text)
        return ArchiveError(
            f"{url}: access denied while {doing}{f' ({code.group(1)})' if code else ''}; check {KEYS}, and AWS_REGION"
        )
    line = shortened(re.sub(r"^Generic \w+ error: ", "", text.partition("\n")[0]).strip(), 240)
    return StoreLost(f"{url}: the store cannot be reached or has failed while {doing} ({line})")


def _store(url: str) -> Any:
    from obstore.store import LocalStore, MemoryStore, S3Store

    scheme = url.partition(":")[0]
    if scheme == "memory":
        return _memory.setdefault(url, MemoryStore())
    if scheme == "file":
        return LocalStore(url.removeprefix("file://"), mkdir=True)
    endpoint = endpoint_of(url)
    config: Any = {"endpoint": endpoint} if endpoint else {}
    client: Any = {"timeout": "300s", "connect_timeout": "5s"}
    client |= {"allow_http": True} if endpoint.startswith("http://") else {}
    anonymous = os.environ.get("AWS_SKIP_SIGNATURE", "").lower() in ("1", "true", "yes", "on")
    # a cloud machine may have a role: probe once, without retries
    if not anonymous and not any(map(os.environ.get, ROLES)):
        import obstore

        once: Any = {"max_retries": 0, "retry_timeout": timedelta(seconds=2)}
        probe = S3Store.from_url(
            url, config=config, client_options=client | {"timeout": "2s", "connect_timeout": "2s"}, retry_config=once
        )
        next(iter(obstore.list(probe, chunk_size=1)), None)
    patient: Any = {"max_retries": 8, "retry_timeout": timedelta(seconds=60)}
    return S3Store.from_url(url, config=config, client_options=client, retry_config=patient)


def endpoint_of(url: str) -> str:
    """Return the endpoint that identifies the store together with a URL."""
    names = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT") if url.startswith("s3:") else ()
    return next((os.environ[name] for name in names if os.environ.get(name)), "")


def zarr_store(url: str) -> Any:
    """Return the store of an archive for zarr and xarray, read-only; a store in memory is copied in its present state.

    Raises
    ------
    ArchiveError
        There is no archive.
    """
    from zarr.storage import ObjectStore

    whole = Objects(url)
    try:
        whole.get(f"{DATA}/zarr.json")
    except FileNotFoundError:
        raise ArchiveError(f"{whole.url} is not an archive that can be opened (it holds no {DATA}/zarr.json)") from None
    inner = Objects(f"{whole.url}/{DATA}")
    if inner.url.startswith("memory:"):
        for path in whole.list():
            if path.startswith(f"{DATA}/"):
                inner.api.put(inner.store, path.removeprefix(f"{DATA}/"), whole.get(path)[0])
    return ObjectStore(inner.store, read_only=True)

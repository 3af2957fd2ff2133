"""Who owns an archive: what stands in ``run.id``, so that the workers of a run that is over stop.

In:  nothing, or what is in the file.
Out: a name for a run, which tells whether it was changed since.
"""

from __future__ import annotations

import uuid
import zlib

ABANDONED = "abandoned"  # in place of the owner's name: a stage did not end when the run was interrupted


def fresh_id() -> str:
    """A name that no other run has, its checksum behind it."""
    name = uuid.uuid4().hex
    return f"{name}{zlib.crc32(name.encode()):08x}"


def is_id(text: bytes) -> bool:
    """Whether ``run.id`` holds what a run has written there; earlier ones wrote no checksum."""
    return text == ABANDONED.encode() or len(text) == 32 or (len(text) == 40 and text[32:] == f"{zlib.crc32(text[:32]):08x}".encode())

"""The chunks of a shard as one array: small chunks are read and checked together.

In:  an archive opened for reading, one of its shards.
Out: the values of all its finished cells, in the order of ``by_shard``; None if a chunk must be examined separately.
"""

from __future__ import annotations

import numpy as np

from etendue.archive.read.reading import StoredArchive
from etendue.archive.records.manifest import DATA
from etendue.archive.sharding.chunks import decode_all
from etendue.archive.sharding.shards import ChunkPlace, ShardFiles, fits
from etendue.errors import ArchiveError
from etendue.types.arrays import Array

GAPS = 4  # a shard is read as a whole if it is at most this many times as large as the wanted chunks


def shard_column(archive: StoredArchive, path: str, files: ShardFiles) -> Array | None:
    """Return the chunks of a shard as one array, each checked against its digest; None if a chunk is damaged, or is not
    at the place given by journal and index.
    """
    group, _, variable = path.removeprefix(f"{DATA}/").rpartition("/")[0].rpartition("/")
    form, said = archive.form(group, variable), archive.journal.said.files
    if archive.journal.files_a_cell or form.pieces > 1 or not form.slots or archive.finder.behind_link(path):
        return None
    numbers = np.asarray(archive.by_shard[path])
    columns = (said.slot, said.part, said.offset, said.size, said.digest)
    slot, part, offset, size, digest = (np.asarray(own)[numbers] for own in columns)
    parts = [said.texts[text] for text in part.tolist()]
    at = archive.finder.all_at(path, form.slots, slot, parts, offset, size)
    begin, end = int(at.min()), int((at + size).max())
    if begin < 0 or end - begin > GAPS * int(size.sum()):
        return None
    places = [ChunkPlace(path, *one) for one in zip(at.tolist(), size.tolist(), digest.tolist(), strict=True)]
    try:
        data = files.read(ChunkPlace(path, begin, end - begin, 0))
        chunks = [data[one.offset - begin : one.offset - begin + one.size] for one in places]
        return decode_all(chunks, form.dtype, form.shape, form.codec) if all(map(fits, chunks, places)) else None
    except (OSError, ArchiveError):
        return None

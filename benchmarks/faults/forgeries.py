"""Check that ``etendue reproduce`` detects archives with changed content and recomputed digests.

Each kind is applied to a copy of one small archive. ``verify`` must find nothing (otherwise the forgery would not be
consistent); ``reproduce`` must name it and exit with 1, or list it among what it does not check.

    python benchmarks/faults/forgeries.py [--only WORD ...]
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from forgery_kinds import FORGERIES, SAID, Forge, sealed
from forgery_words import SAID_WORDS, WORDS
from hostile_kinds import sound_archive

from etendue.archive.checks.verify import verify
from etendue.errors import EtendueError
from etendue.session import Options
from etendue.trust.reproducing import reproduce

FORGERIES = FORGERIES | WORDS
SAID = SAID | SAID_WORDS


@dataclass
class Found:
    """The result for one forgery. ``wrong``: what differs from the expected result."""

    kind: str
    named: str = ""
    listed: str = ""
    wrong: str = ""


def tried(sound: Path, kind: str, forge: Forge, place: Path, said: str = "") -> Found:
    """Try one forgery; ``said``: the entry under which it must be listed instead of being found."""
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(sound, place)
    forge(place)
    found = Found(kind)
    damages = [f"{one.path}: {one.what}" for one in verify(place).damages]
    try:
        seen = reproduce(place, Options("serial"))
    except EtendueError as error:
        found.named = str(error).split("\n")[0]
        found.wrong = "nothing was forged" if kind == "nothing" else ""
        return found
    found.listed = next((one.what for one in seen.not_checked if said and one.what.startswith(said)), "")
    differs = [f"{one.file} {one.where}".strip() for one in seen.differences]
    differs += [f"{one.cell} {one.variable}" for one in seen.cells if one.found not in ("same", "within")]
    found.named = f"{differs[0]}{f' and {len(differs) - 1} more' if differs[1:] else ''}" if differs else ""
    if damages:
        found.wrong = f"verify finds it: {damages[0]}"
    elif kind == "nothing":
        found.wrong = found.named
    elif said:
        found.wrong = "" if found.listed and seen.reproduced else f"not listed as {said!r}: {found.named}"
    else:
        found.wrong = "" if differs and not seen.reproduced else "not found"
    return found


def every(only: list[str] | None = None) -> list[Found]:
    """Try every kind, preceded by an archive that was only resealed."""
    kinds = [("nothing", sealed, ""), *((kind, forge, "") for kind, forge in FORGERIES.items())]
    kinds += [(kind, forge, said) for kind, (forge, said) in SAID.items()]
    with tempfile.TemporaryDirectory() as text:
        place = Path(text).resolve()
        sound = sound_archive(place / "sound")
        chosen = [one for one in kinds if not only or any(word in one[0] for word in only)]
        return [tried(sound, kind, forge, place / "forged", said) for kind, forge, said in chosen]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=[])
    rows = every(parser.parse_args().only)
    print(f"{'forgery':44} {'is':10} where")
    for one in rows:
        state = "NOT FOUND" if one.wrong else "sound" if one.kind == "nothing" else "listed" if one.listed else "named"
        print(f"{one.kind:44} {state:10} {one.wrong or one.listed or one.named}"[:180])
    wrong = sum(bool(one.wrong) for one in rows)
    print(f"{len(rows) - wrong} of {len(rows)} as required")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()

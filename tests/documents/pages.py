"""The pages that are followed step by step: their blocks in order, and the commands in them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
STEPS = [
    "first_picture.md",
    "tutorials/phone.md",
    "tutorials/demosaicer.md",
    "tutorials/archive.md",
    "tutorials/lecture.md",
    "own_data.md",
    "designs.md",
    "not_a_camera.md",
]

_BLOCK = re.compile(r"^```(bash|python|toml|csv|xml)\n(.*?)^```", flags=re.S | re.M)
_LINE = re.compile(r"`(etendue [^`]+)`")


def blocks(page: str) -> Iterator[tuple[str, str]]:
    """Language and text of every block of a page."""
    return ((found[1], found[2]) for found in _BLOCK.finditer((DOCS / page).read_text()))


def file_of(text: str) -> str:
    """The name that the comment in the first line of a block gives to the file that it shows."""
    return text.partition("\n")[0].strip("# <!->")


def commands(page: str) -> list[tuple[list[str], int]]:
    """The commands in blocks of bash, as words, and the exit code that the line names, or 0."""
    return [command for language, text in blocks(page) if language == "bash" for command in commands_of(text)]


def commands_of(text: str) -> list[tuple[list[str], int]]:
    """The commands of a block, as words, and the exit code that the line names, or 0."""
    found = []
    for line in filter(str.strip, text.splitlines()):
        code = re.search(r"# .*exit code (\d)", line)
        found.append((shlex.split(line, comments=True), int(code[1]) if code else 1 if line.endswith("# fails") else 0))
    return [(words, code) for words, code in found if words]


def asked_in_text(page: str) -> list[list[str]]:
    """Commands of etendue between backticks in the text."""
    text = re.sub(r"^```.*?^```", "", (DOCS / page).read_text(), flags=re.S | re.M)
    return [shlex.split(words) for words in _LINE.findall(text)]

"""Convert plain text to markdown: text between backticks is kept, everything else is escaped."""

import re
from collections.abc import Iterable, Sequence
from inspect import cleandoc

_CODE = re.compile(r"(``.+?``|`[^`]+`)", flags=re.S)
_BAR = re.compile(r"(?<!\\)\|")
_SIGNS = re.compile(r"([\\*_\[\]<>|$~#])")


def shown(text: str) -> str:
    """Return the text as one line of markdown."""
    parts = _CODE.split(" ".join(text.split()))
    return "".join(part if number % 2 else _SIGNS.sub(r"\\\1", part) for number, part in enumerate(parts))


def paragraphs(text: str) -> str:
    """Return the paragraphs of a docstring or of a command's help; preformatted ones (``\\b``) become code blocks."""
    made = []
    for paragraph in re.split(r"\n\s*\n", cleandoc(text)):
        if paragraph.lstrip().startswith("\b"):
            made.append("```text\n" + paragraph.lstrip().removeprefix("\b").strip("\n") + "\n```")
        elif paragraph.strip():
            made.append(shown(paragraph))
    return "\n\n".join(made)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table from cells of markdown; bars inside cells are escaped, also in code."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(
        "| " + " | ".join(_BAR.sub(r"\|", cell.replace("\n", " ")) for cell in row) + " |" for row in lines
    )


def toctree(pages: Iterable[str], *options: str) -> str:
    """Return a toctree of the pages below this one."""
    return "\n".join(["```{toctree}", *options, "", *pages, "```"])

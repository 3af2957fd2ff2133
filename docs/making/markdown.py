"""Plain text as markdown: what stands between backticks stays, everything else is shown as it is written."""

import re
from collections.abc import Iterable, Sequence
from inspect import cleandoc

_CODE = re.compile(r"(``.+?``|`[^`]+`)", flags=re.S)
_BAR = re.compile(r"(?<!\\)\|")
_SIGNS = re.compile(r"([\\*_\[\]<>|$~#])")


def shown(text: str) -> str:
    """One line of markdown that shows the text."""
    parts = _CODE.split(" ".join(text.split()))
    return "".join(part if number % 2 else _SIGNS.sub(r"\\\1", part) for number, part in enumerate(parts))


def paragraphs(text: str) -> str:
    """The paragraphs of a docstring or of a command's help; those that are to stand as they are (``\\b``) as a block
    of code.
    """
    made = []
    for paragraph in re.split(r"\n\s*\n", cleandoc(text)):
        if paragraph.lstrip().startswith("\b"):
            made.append("```text\n" + paragraph.lstrip().removeprefix("\b").strip("\n") + "\n```")
        elif paragraph.strip():
            made.append(shown(paragraph))
    return "\n\n".join(made)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table whose cells are markdown already; a bar in one, in code too, is none between them."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(
        "| " + " | ".join(_BAR.sub(r"\|", cell.replace("\n", " ")) for cell in row) + " |" for row in lines
    )


def toctree(pages: Iterable[str], *options: str) -> str:
    """Which pages stand below this one."""
    return "\n".join(["```{toctree}", *options, "", *pages, "```"])

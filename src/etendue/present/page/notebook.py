"""The live page in a notebook: the page of ``etendue view`` in a frame that sends its requests to the kernel instead of
a server.

In:  the folder of an archive.
Out: a widget. Needs ``anywidget``, which ``pip install "etendue[view]"`` installs.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from etendue.errors import EtendueError, MachineError
from etendue.present.page.html import page, static
from etendue.present.page.live import HttpRefusal, Live


def view(archive: str | Path, height: int = 900) -> Any:
    """Return a widget, ``height`` pixels high, that shows an archive, even while a run writes to it.

    Raises
    ------
    ArchiveError
        The folder is not an archive, or the archive is damaged.
    MachineError
        anywidget is not installed.
    """
    kind = _kind()
    live = Live(Path(archive))
    widget = kind(html=page(live.shown("frame")), height=height)
    widget.on_msg(lambda shown, asked, buffers: answer(live, shown, asked))
    return widget


def answer(live: Live, widget: Any, asked: Any) -> None:
    """Send the answer to a request under the request's number."""
    number = asked.get("number") if isinstance(asked, dict) else None
    if not isinstance(number, int):
        return
    question, words = live.answers.get(str(asked.get("what"))), asked.get("words")
    words = {str(name): str(value) for name, value in words.items()} if isinstance(words, dict) else {}
    try:
        if question is None:
            raise HttpRefusal(404, "there is no page at this address")
        _, body, extra = question(words)
    except (HttpRefusal, EtendueError, ValueError) as error:
        widget.send({"number": number, "why": str(error)})
        return
    widget.send({"number": number, "said": extra.get("X-Picture", "")}, [body])


@cache
def _kind() -> Any:
    try:
        import anywidget
        import traitlets
    except ImportError:
        raise MachineError('a page in a notebook needs anywidget: pip install "etendue[view]"') from None

    class Page(anywidget.AnyWidget):  # type: ignore[misc, unused-ignore]
        """The frame and its message channel."""

        _esm = static("notebook.js")
        html = traitlets.Unicode().tag(sync=True)
        height = traitlets.Int(900).tag(sync=True)

    return Page

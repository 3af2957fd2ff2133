"""Rendering of a summary: HTML for a notebook, lines for a terminal.

In:  a ``Glance``.
Out: HTML without scripts, with inline styles and embedded pictures: nothing is loaded from the network; every text is
     escaped.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape

from etendue.contract.wording import words as called
from etendue.present.html_tables import table
from etendue.present.plots.drawing.strip import Tile
from etendue.present.plots.summary.contents import MOST_PICTURES, MOST_ROWS, Glance
from etendue.present.terminal.cells import Column
from etendue.telling import human_seconds, printable

SIDE = 128  # largest side of a small picture, in dots
QUALITY = 82  # quality of WebP
WORDS = {
    "done": "done",
    "left_out": "left out",
    "failed": "failed",
    "skipped": "skipped",
    "not_computed": "not computed",
    "unfinished": "being computed",
}
SOFT = "opacity:0.72"
RED = "#d43f3a"


def text(one: Glance) -> str:
    """Return the summary in a line or two."""
    axes = " × ".join(f"{number} {name}" for name, _, number in one.axes)
    where = f"in {one.place}" if one.place else "in memory"
    there = [f"{_stages(one)}, {_cells(one)}"] if one.stages else []
    said = f"<etendue {printable(one.name)}: {'; '.join([*there, *([axes] if axes else []), one.state, where])}>"
    notes = [f"  {printable(note)}" for note in one.notes]
    return "\n".join(
        [said, *notes, *(f"  failed: {_where(row)}" for row in one.failed[:MOST_ROWS]), *_more(one.failed)]
    )


def page(one: Glance, run: str = "") -> str:
    """Return the summary as HTML. ``run``: the results of the last run."""
    bad = bool(one.counts.get("failed")) or one.state.startswith("damaged")
    head = (
        f'<div><b style="font-size:1.15em">{safe(one.name)}</b> '
        f"&nbsp;<span{_style(f'color:{RED};font-weight:600') if bad else ''}>"
        f"{safe(one.state)}</span></div>"
    )
    facts = [*([_stages(one), _cells(one)] if one.stages else []), one.place or "in memory", *([run] if run else [])]
    parts = [head, f"<div{_style(SOFT)}>{' · '.join(map(safe, facts))}</div>"]
    if one.failed:
        parts.append(table("Failed", FAILED, one.failed[:MOST_ROWS], _more(one.failed), colour=RED))
    if one.axes:
        parts.append(table("Swept", SWEPT, one.axes))
    if one.pictures:
        parts.append(_strip(one.pictures, one.at))
    if one.figures:
        parts.append(_figures(one))
    if one.omitted:
        rows = one.omitted[:MOST_ROWS]
        parts.append(table("Left out or approximated", OMITTED, rows, _more(one.omitted), folded=True))
    parts += [f"<div>{safe(note)}</div>" for note in one.notes]
    parts.append(_commands(one.commands))
    return f'<div class="etendue" style="max-width:70em;line-height:1.45">{"".join(parts)}</div>'


def _figures(one: Glance) -> str:
    """Return the table of metrics; no line breaks between a number and its unit."""
    columns: list[Column] = [
        ("metric", "left", lambda own: own.title + f" ({own.name})" * (own.title.replace(" ", "_") != own.name)),
        (_unbroken(f"at {one.at}") if one.at else "value", "left", lambda own: _unbroken(own.said)),
        ("over the sweep", "left", lambda own: _unbroken(own.spanned)),
    ]
    return table("Metrics", columns if one.axes else columns[:2], one.figures)


def _unbroken(words: str) -> str:
    return words.replace(" ", "\N{NO-BREAK SPACE}")


def _style(style: str) -> str:
    return f' style="{style}"'


def safe(words: str) -> str:
    return escape(printable(str(words)))


def _stages(one: Glance) -> str:
    return _count(one.stages, "stage")


def _cells(one: Glance) -> str:
    said = ", ".join(f"{number} {WORDS.get(status, status)}" for status, number in one.counts.items())
    return f"{_count(one.cells, 'cell')}{f' ({said})' if set(one.counts) - {'done'} else ''}"


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def _where(row: tuple[str, str, str]) -> str:
    stage, where, message = row
    return printable(f"{stage}{' at ' + where if where else ''}{': ' + message if message else ''}")


def _more(rows: Sequence[object]) -> list[str]:
    return [f"and {len(rows) - MOST_ROWS} more"] if len(rows) > MOST_ROWS else []


FAILED = (
    ("stage",),
    ("at", "left", lambda row: row[1] or "–"),
    ("why", "left", lambda row: row[2] or "reported in the ledger when the run ends"),
)
SWEPT = (("axis",), ("values",), ("", "left", 2, lambda number: _count(number, "value")))
OMITTED = (
    ("stage", "left", "stage"),
    ("cells", "left", "{cells} of {of}".format_map),
    ("why", "left", lambda row: f"{'coarser: ' if row['kind'] == 'coarser' else ''}{row['why']}"),
    ("error bound", "left", "bound", lambda most: f"{most:.1g}" if most > 0 else "0", "0"),
    ("time saved", "left", "saved", lambda saved: human_seconds(saved) if saved > 0 else ""),
)


def _strip(tiles: Sequence[Tile], at: str) -> str:
    """Return small pictures side by side, in the order of the stages."""
    shown = [
        f"<figure{_style('margin:0;flex:0 0 auto;max-width:10.5em')}>{_image(one)}{_caption(one)}</figure>"
        for one in tiles[:MOST_PICTURES]
    ]
    left = f"<div>and {len(tiles) - MOST_PICTURES} more pictures</div>" if len(tiles) > MOST_PICTURES else ""
    title = f"{called()['strip']}{', at ' + at if at else ''}"
    return (
        f'<div style="margin-top:.6em"><b>{safe(title)}</b></div>'
        f'<div style="display:flex;flex-wrap:wrap;gap:8px 10px;align-items:flex-end;margin:.3em '
        f'0">{"".join(shown)}</div>{left}'
    )


def _caption(one: Tile) -> str:
    said = f"{one.size[1]} × {one.size[0]}"
    return (
        f'<figcaption style="font-size:.78em;line-height:1.25;overflow-wrap:anywhere"><b>{safe(one.stage)}</b><br>'
        f"<span{_style(SOFT)}>{safe(one.variable)}<br>{said}</span></figcaption>"
    )


def _image(one: Tile) -> str:
    from PIL import Image

    picture = Image.fromarray(one.picture)
    largest = max(picture.size)
    scale = SIDE // largest if largest <= SIDE else SIDE / largest
    size = tuple(max(1, round(side * scale)) for side in picture.size)
    file = io.BytesIO()
    how = Image.Resampling.NEAREST if largest <= SIDE else Image.Resampling.BOX
    picture.resize((size[0], size[1]), how).save(file, "WEBP", quality=QUALITY, method=4)
    data = base64.b64encode(file.getvalue()).decode()
    words = safe(f"{one.variable} after {one.stage}")
    return (
        f'<img src="data:image/webp;base64,{data}" width="{size[0]}" height="{size[1]}" alt="{words}" '
        f'style="display:block;margin:0">'
    )


def _commands(commands: Iterable[tuple[str, str]]) -> str:
    rows = "".join(
        f'<div><code style="user-select:all">{safe(command)}</code> <span{_style(SOFT)}>{safe(what)}</span></div>'
        for command, what in commands
    )
    return f'<div style="margin-top:.6em"><b>Next steps</b>{rows}</div>' if rows else ""

"""A study of its own: how much light comes back, as a plot and as a section of a page."""

import io

from matplotlib.figure import Figure


def _drawn(halo):
    figure = Figure(figsize=(3, 2))
    figure.subplots().imshow(halo.values)
    return figure


def glow(holdings, asked):
    halo = holdings.find(asked.figures[0] if asked.figures else "halo", "picture")
    return _drawn(halo.values(asked.cell(halo)))


def nothing(holdings, asked):
    return 42


def section(tree):
    if "halation" not in tree.children:
        return []
    halo, picture = tree["halation"]["halo"], io.BytesIO()
    _drawn(halo[0]).savefig(picture, format="png")
    return [
        {"paragraph": "<b>Read as text</b>: of the light behind the lens some comes back from the base."},
        {"table": {"head": ["", "percent"], "rows": [["least", halo.min().values], ["most", halo.max().values]]}},
        {"picture": picture.getvalue(), "alt": "where it comes back"},
    ]


def silent(tree):
    return []


def broken(tree):
    raise ZeroDivisionError("nothing came back")


def wrong(tree):
    return [{"html": "<script>alert(1)</script>"}]

"""What this distribution brings to plots and pages: a kind of plot, a section."""

from etendue.api import hookimpl


@hookimpl
def etendue_plots():
    doc = "how far each figure moves along an axis, the largest first"
    return {"tornado": {"place": "etendue_study.drawn:tornado", "takes": 0, "doc": doc}}


@hookimpl
def etendue_sections():
    return {"slopes": {"place": "etendue_study.drawn:section", "title": "What moves most"}}

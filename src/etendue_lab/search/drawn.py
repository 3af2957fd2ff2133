"""The history of a search as a plot: every trial and the best trial so far or, for two goals, their Pareto front; next
to it the importance of the settings.

In:  the document of a search.
Out: a plot.
"""

from __future__ import annotations

from typing import Any

from etendue.present.plots.plot import Plot, new_figure
from etendue.types.documents import Document


def drawn(document: Document) -> Plot:
    """Plot the trials of a search."""
    goals = [*document["minimise"], *document["maximise"]]
    finished = [one for one in document["trials"] if one["values"]]
    figure = new_figure(9.0 if document["importance"] else 7.0, 4.0)
    if document["importance"]:
        axes, beside = figure.subplots(1, 2, width_ratios=[3, 1])
        _importance(beside, document, goals[0])
    else:
        axes = figure.add_subplot()
    if len(goals) > 1:
        _front(axes, document, finished, goals)
    else:
        _history(axes, document, finished, goals[0])
    axes.spines[["top", "right"]].set_visible(False)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False)
    names = [text.partition(" = ")[0] for text in document["over"]]
    rows = [
        [one["number"], *(one["settings"][name] for name in names), *one["values"], one["allowed"]] for one in finished
    ]
    return Plot(figure, ["trial", *names, *goals, "within limits"], rows)


def _importance(axes: Any, document: Document, goal: str) -> None:
    names = list(reversed(document["importance"]))
    axes.barh(names, [100 * document["importance"][name] for name in names], color="C0")
    axes.set(xlabel="importance, %", title=f"for {goal}", xlim=(0, 100))
    axes.spines[["top", "right"]].set_visible(False)


def _apart(finished: list[Document]) -> list[tuple[str, str, list[Document]]]:
    """Return two groups of trials, those within the limits and the others, each with a label and a colour. Empty groups
    are left out.
    """
    kinds = (("within the limits", "C0", True), ("beyond a limit", "0.7", False))
    found = [
        (label, colour, [one for one in finished if one["allowed"] is allowed]) for label, colour, allowed in kinds
    ]
    return [one for one in found if one[2]]


def _history(axes: Any, document: Document, finished: list[Document], goal: str) -> None:
    for label, colour, own in _apart(finished):
        axes.plot([o["number"] for o in own], [o["values"][0] for o in own], "o", ms=3, color=colour, label=label)
    best, steps = list[float](), list[int]()
    better = max if document["maximise"] else min
    for one in finished:
        if one["allowed"]:
            best.append(better([one["values"][0], *best[-1:]]))
            steps.append(one["number"])
    axes.step(steps, best, where="post", color="C1", label="best so far")
    failed = [one["number"] for one in document["trials"] if one["failed"]]
    if failed:
        axes.plot(failed, [0.02] * len(failed), "x", color="C3", transform=axes.get_xaxis_transform(), label="failed")
    axes.set(xlabel="trial", ylabel=goal)


def _front(axes: Any, document: Document, finished: list[Document], goals: list[str]) -> None:
    for label, colour, own in _apart(finished):
        axes.plot([o["values"][0] for o in own], [o["values"][1] for o in own], "o", ms=3, color=colour, label=label)
    front = [list(one["values"].values()) for one in document["best"]]
    axes.plot(
        [one[0] for one in front],
        [one[1] for one in front],
        "o-",
        color="C1",
        label="Pareto front: no trial is better in both",
    )
    axes.set(xlabel=goals[0], ylabel=goals[1])

"""The study drawn: a plot, and a section of a page."""


def tornado(holdings, asked):
    """Bars for each figure along the first axis that moves any."""
    from matplotlib.figure import Figure

    moved = _moved(holdings.tree)
    drawn = Figure(figsize=(6, 3), layout="constrained")
    plane = drawn.subplots()
    for axis, changes in moved[:1]:
        plane.barh(list(changes)[::-1], [100 * change for change in changes.values()][::-1])
        plane.set_xlabel(f"change along {axis}, %")
    return drawn


def section(tree):
    """A table for each axis; nothing where there is none."""
    blocks = []
    for axis, changes in _moved(tree):
        blocks.append({"paragraph": f"From the first to the last value of {axis}:"})
        rows = [[name, f"{100 * change:+.1f} %"] for name, change in changes.items()]
        blocks.append({"table": {"head": ["figure", "change"], "rows": rows}})
    return blocks


def _moved(tree):
    from etendue_study.study import changes

    return list(changes(tree).items())

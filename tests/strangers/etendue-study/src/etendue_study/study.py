"""How far figures move along an axis: from the first of its values to the last, relative to the larger of the two.

In:  a pipeline and two values, or the tree of an archive.
Out: changes by figure, the largest first.
"""

import etendue


def slopes(pipeline, **moved):
    """{"stage.figure": relative change} of a pipeline, when one quantity has the second of two values in place of
    the first.
    """
    ((name, values),) = moved.items()
    tree = etendue.simulate(pipeline.sweep(**{name: list(values)}), scheduler="serial")
    return changes(tree)[name]


def changes(tree):
    """{axis: {"stage.figure": change}} of an archive; where there are further axes, in the mean of the others."""
    found = {}
    for stage, figure in figures(tree):
        for axis in figure.dims:
            ends = figure.isel({axis: 0}), figure.isel({axis: -1})
            largest = abs(ends[0]).where(abs(ends[0]) > abs(ends[1]), abs(ends[1]))
            moved = float(((ends[1] - ends[0]) / largest.where(largest > 0)).mean())
            if moved == moved:
                found.setdefault(str(axis), {})[f"{stage}.{figure.name}"] = moved
    return {axis: dict(sorted(own.items(), key=lambda one: -abs(one[1]))) for axis, own in found.items()}


def figures(tree):
    """Numbers that have no dims but axes: their stage, and the array."""
    for stage, node in tree.children.items():
        if stage in ("ledger", "summary", "frames"):
            continue
        axes = node.dataset["status"].dims if "status" in node.dataset else ()
        for name, array in node.dataset.data_vars.items():
            if name != "status" and array.dims and set(array.dims) <= set(axes) and array.dtype.kind == "f":
                yield stage, array

"""The layout of an archive (groups, arrays, dims and coordinates), from a plan and the stored cells.

A stage is a group; its variables have the axes that affect them, followed by their own dims. If an axis changes the
grid, the group holds only attributes and one child per shape, named by the shape.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from etendue.archive.records.names import ROW, SAME_AS, STATUS
from etendue.archive.structure.drawing import drawing_attributes
from etendue.archive.structure.groups import ArchivedLayout, alike, groups_of
from etendue.archive.structure.naming import Homes, Whole
from etendue.contract.arrays.dims import dim as declared
from etendue.contract.arrays.grid import Bands, Coordinate, Labels, Line
from etendue.contract.arrays.variables import NOT_IN_IT, variable
from etendue.contract.values import quantities
from etendue.plan.marks import not_in_it
from etendue.plan.model import Axis, Cell, CellRef, Node, Plan
from etendue.types.documents import Document

STATUS_ATTRIBUTES = {
    "long_name": "status of the cell",
    "units": "1",
    "flag_values": [0, 1, 2, 3, 4],
    "flag_meanings": " ".join(STATUS),
}
BOUNDS = "_bounds"  # suffix to the name of a dim of bands, for their edges


@dataclass
class CoordinateLayout:
    """A coordinate array: its dims, values and attributes."""

    dims: tuple[str, ...]
    values: Any
    attrs: Document


@dataclass
class VariableLayout:
    """One variable of one group."""

    name: str
    axes: tuple[str, ...]
    dims: tuple[str, ...]
    shape: tuple[int, ...]  # of one cell
    dtype: str
    attrs: Document
    beside: str = ""  # the dim along which it is a coordinate of other variables


@dataclass
class GroupLayout:
    """One group with arrays: a stage, or one shape of a stage."""

    path: str
    node: str
    axes: dict[str, list[Any]]
    variables: dict[str, VariableLayout]
    coordinates: dict[str, CoordinateLayout]
    cells: Mapping[CellRef, tuple[int, ...]] = field(default_factory=dict)
    attrs: Document = field(default_factory=dict)
    same_as: dict[str, str] = field(default_factory=dict)  # by variable without an array: path of the equal array

    @property
    def every(self) -> tuple[str, ...]:
        """All readable variables, in the order of the declaration."""
        return (*self.variables, *self.same_as)


@dataclass
class Layout:
    """All groups of a plan and the group of every cell; ``moves``: stored groups and their new form."""

    groups: dict[str, GroupLayout]
    parents: dict[str, Document]
    home: Mapping[CellRef, str]
    moves: dict[str, str] = field(default_factory=dict)


def layout_of(plan: Plan, before: ArchivedLayout | None = None) -> Layout:
    """Return the layout of all kept variables of a plan; ``before`` describes the present content of the archive."""
    groups: dict[str, GroupLayout] = {}
    parents: dict[str, Document] = {}
    homes: dict[str, str | dict[CellRef, str]] = {}
    moves: dict[str, str] = {}
    for node in plan.nodes:
        kept = [v for v in node.writes if (node.name, v) in plan.kept]
        if not kept:
            continue
        cells = plan.of(node.name)
        attrs = _node_attributes(node)
        home, becomes = groups_of(node, cells, kept, before or ArchivedLayout())
        homes[node.name] = home
        if isinstance(home, str):
            own = {dim: list(plan.axis(dim).values) for dim in node.axes}
            groups[home] = GroupLayout(home, node.name, own, {}, {}, Whole(cells), attrs)
            _fill(plan, node, groups[home], cells, kept, cells[:1] if alike(cells) else cells)
            continue
        parents[node.name] = attrs
        moves |= {node.name: becomes} if becomes else {}
        axes = [(dim, plan.axis(dim).values) for dim in node.axes]
        found: dict[str, dict[str, dict[Any, None]]] = {}
        cells_of: dict[str, list[Cell]] = {}
        for cell in cells:
            path = home[cell.ref]
            if path not in groups:
                groups[path] = GroupLayout(path, node.name, {dim: [] for dim in node.axes}, {}, {})
                found[path], cells_of[path] = {dim: {} for dim in node.axes}, []
            cells_of[path].append(cell)
            for (dim, values), i in zip(axes, cell.ref[1], strict=True):
                found[path][dim][values[i]] = None
        for path, values_of in found.items():
            groups[path].axes.update({dim: list(values) for dim, values in values_of.items()})
            own_cells = cells_of[path]
            groups[path].cells = _places(plan, node, groups[path], own_cells)
            _fill(plan, node, groups[path], own_cells, kept, own_cells)
    return _shared(plan, Layout(groups, parents, Homes(plan, homes), moves))


def _shared(plan: Plan, layout: Layout) -> Layout:
    """Record, for each group, the variables without an array (all their cells are left out) and the arrays that have
    their values.
    """
    for group in layout.groups.values():
        first = next(iter(group.cells))
        for name in (v for v in plan.node(group.node).writes if (group.node, v) in plan.same_as):
            group.same_as[name] = f"/{layout.home[plan.stored(first, name)]}/{name}"
        if group.same_as:
            paths = list(group.same_as.values())
            group.attrs = {**group.attrs, SAME_AS: paths[0] if len(paths) == 1 else paths}
    return layout


def _places(plan: Plan, node: Node, group: GroupLayout, cells: Sequence[Cell]) -> dict[CellRef, tuple[int, ...]]:
    """Return the positions of cells in the arrays of a group that has only some of the values on its axes."""
    at = [{value: place for place, value in enumerate(group.axes[dim])} for dim in node.axes]
    places = [[own.get(value, -1) for value in plan.axis(dim).values] for dim, own in zip(node.axes, at, strict=True)]
    return {cell.ref: tuple(own[i] for own, i in zip(places, cell.ref[1], strict=True)) for cell in cells}


def _fill(
    plan: Plan, node: Node, group: GroupLayout, every: Sequence[Cell], kept: Sequence[str], cells: Sequence[Cell]
) -> None:
    """Add the variables and coordinates of all cells of a group; ``cells`` must include every grid of the group."""
    for dim in group.axes:
        axis = plan.axis(dim)
        group.coordinates[dim] = CoordinateLayout((dim,), group.axes[dim], _said_of(axis))
        if axis.rows:
            _add_factors(plan, group, axis)
    for name in kept:
        declaration = node.writes[name]
        grid = cells[0].grids[name]
        dims = declaration.dims
        for dim in dims:
            if dim not in group.coordinates:
                _dim_coordinate(node, group, dim, {c.ref: c.grids[name][dim] for c in cells})
        if (node.name, name) in plan.same_as:
            continue
        attrs = {"units": declaration.unit, "long_name": variable(name).long_name}
        attrs |= drawing_attributes(plan, node, every, name)
        averaged = [
            dim
            for dim in dims
            if all(isinstance(c.grids[name][dim], Line) and c.grids[name].line(dim).cells for c in cells)
        ]
        if averaged:  # as in the CF conventions
            attrs["cell_methods"] = " ".join(f"{dim}: mean" for dim in averaged)
        attrs |= _flags(name, cells[0])
        unseen = not_in_it(plan, node, name)
        attrs |= {NOT_IN_IT: ", ".join(unseen)} if unseen else {}
        dtype = plan.precision if declaration.dtype == "float" or plan.expected else declaration.dtype
        group.variables[name] = VariableLayout(
            name, node.axes, dims, grid.shape(dims), dtype, attrs, variable(name).beside
        )


def _said_of(axis: Axis) -> Document:
    if axis.rows:
        name = f"combination of factors along {axis.of}" if axis.of else axis.dim
        return {"long_name": name, "units": "1", "parameter": axis.key}
    return {"long_name": quantities.long_name(axis.key), "units": axis.units or "1", "parameter": axis.key}


def _add_factors(plan: Plan, group: GroupLayout, axis: Axis) -> None:
    """Add every factor of an axis of rows as a coordinate along this axis; for an axis of combinations, also add the
    rows, with the combination of each row.
    """
    there = dict(zip(axis.values, axis.rows, strict=True))
    for number, factor in enumerate(axis.factors):
        values = [factor.values[there[value][number]] for value in group.axes[axis.dim]]
        group.coordinates[factor.dim] = CoordinateLayout((axis.dim,), values, _said_of(factor))
    if axis.of:
        rows = [(row, axis.values[at]) for row, at in zip(plan.axis(axis.of).values, axis.places, strict=True)]
        own = [(row, value) for row, value in rows if value in set(group.axes[axis.dim])]
        attrs = {"long_name": f"{axis.dim} of every {axis.of}: select with .sel", "units": "1"}
        group.coordinates[axis.of] = CoordinateLayout((axis.of,), [row for row, _ in own], _said_of(plan.axis(axis.of)))
        group.coordinates[f"{axis.dim}{ROW}"] = CoordinateLayout((axis.of,), [value for _, value in own], attrs)


def _flags(name: str, cell: Cell) -> Document:
    """Return the attributes that name the values of a variable, as in the CF conventions; NaN means no value."""
    known = variable(name)
    named = known.flags or known.masks
    if named:
        return {"flag_masks" if known.masks else "flag_values": list(named.values()), "flag_meanings": " ".join(named)}
    labels = next((g[known.names] for g in cell.grids.values() if known.names in g), None) if known.names else None
    if not isinstance(labels, Labels):
        return {}
    meanings = ["_".join(str(entry).split()) for entry in labels.entries]
    return {"flag_values": [float(i) for i in range(len(meanings))], "flag_meanings": " ".join(meanings)}


def coordinates_of(group: GroupLayout, own: VariableLayout) -> list[str]:
    """Return the variables of a group that are coordinates of another variable."""
    return [
        v.name
        for v in group.variables.values()
        if v.beside and v.beside in own.dims and v is not own and not own.beside
    ]


def _dim_coordinate(node: Node, group: GroupLayout, dim: str, by_cell: Mapping[CellRef, Coordinate]) -> None:
    first = next(iter(by_cell.values()))
    if isinstance(first, Bands):
        bands = declared(dim)
        name, standard = bands.long_name or dim, {"standard_name": bands.standard_name} if bands.standard_name else {}
        group.coordinates[dim] = CoordinateLayout(
            (dim,), first.values(), {"units": bands.units, "long_name": name, **standard, "bounds": f"{dim}{BOUNDS}"}
        )
        bounds = [list(pair) for pair in zip(first.edges[:-1], first.edges[1:], strict=True)]
        edges = {"units": bands.units, "long_name": f"edges of the {name} bins"}
        group.coordinates[f"{dim}{BOUNDS}"] = CoordinateLayout((dim, "bound"), bounds, edges)
        return
    if isinstance(first, Labels):
        attrs = {"long_name": dim} | ({"units": first.units} if first.units else {})
        group.coordinates[dim] = CoordinateLayout((dim,), first.values(), attrs)
        return
    lines = {ref: c for ref, c in by_cell.items() if isinstance(c, Line)}
    same = all((c.start, c.step) == (first.start, first.step) for c in lines.values())
    if same:
        said = {"um": f"{dim} on the image plane", "1": f"pixel index along {dim}"}
        attrs = {"units": first.units, "long_name": said.get(first.units, dim)}
        group.coordinates[dim] = CoordinateLayout((dim,), first.values(), attrs)
    else:
        group.coordinates[dim] = CoordinateLayout(
            (dim,), list(range(first.size)), {"units": "1", "long_name": f"sample index along {dim}"}
        )
    if first.position is not None or not same:
        _positions(node, group, dim, lines)


def _positions(node: Node, group: GroupLayout, dim: str, lines: Mapping[CellRef, Line]) -> None:
    """Add the positions of a dim as the coordinate ``<dim>_um``, along the axes that change them; if the dim has
    another unit than um or 1, add ``<dim>_at`` in that unit instead.
    """
    moving = []
    for number, axis in enumerate(node.axes):
        rest: dict[tuple[int, ...], set[tuple[float, float]]] = {}
        for ref, line in lines.items():
            rest.setdefault((*ref[1][:number], *ref[1][number + 1 :]), set()).add(line.um())
        if any(len(found) > 1 for found in rest.values()):
            moving.append(axis)
    size = next(iter(lines.values())).size
    numbers = [node.axes.index(axis) for axis in moving]
    first: dict[tuple[int, ...], Line] = {}
    for ref, line in lines.items():
        place = group.cells[ref]
        first.setdefault(tuple(place[number] for number in numbers), line)

    def nested(left: list[str], at: tuple[int, ...]) -> Any:
        if left:
            return [nested(left[1:], (*at, i)) for i in range(len(group.axes[left[0]]))]
        if at not in first:
            return [float("nan")] * size
        start, step = first[at].um()
        return [start + step * i for i in range(size)]

    own = next(iter(lines.values()))
    if own.position is None and own.units not in ("um", "1"):
        name, attrs = f"{dim}_at", {"units": own.units, "long_name": dim}
    else:
        name, attrs = f"{dim}_um", {"units": "um", "long_name": f"{dim} of the centres on the image plane"}
    group.coordinates[name] = CoordinateLayout((*moving, dim), nested(moving, ()), attrs)


def _node_attributes(node: Node) -> Document:
    one = node.alternatives[0]
    return {
        "stage": [a.use for a in node.alternatives] if len(node.alternatives) > 1 else one.use,
        "distribution": f"{one.distribution} {one.version}",
        "order": node.number,
    }

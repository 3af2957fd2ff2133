"""Stages written on labelled arrays: ``run`` gets an ``xarray.Dataset`` and returns one.

In:  a class of stages whose ``run(self, data, ...)`` works on a Dataset of the variables declared in ``reads``.
Out: the same class with a ``run`` on plain arrays, which adds coordinates and attributes, and checks the result against
     the declaration.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from etendue.contract.arrays.dims import PLACE, dim
from etendue.contract.arrays.variables import Declaration, variable
from etendue.contract.stage import SPECIAL, Stage, identity_of, reads_of, writes_of
from etendue.contract.values.units import same_unit
from etendue.errors import PluginError

if TYPE_CHECKING:
    import xarray as xr

    from etendue.types.arrays import Array

_Kind = TypeVar("_Kind", bound=type[Stage])


def labelled(kind: _Kind) -> _Kind:
    """Let ``run`` of a stage work on labelled arrays.

    ``run(self, data)`` reads ``data["signal"]`` with the coordinates of its dims: centres of bands, ``y``, ``x`` (with
    ``y_um``, ``x_um`` on the image plane), and the attributes of the vocabulary. Coordinates of dims that only
    ``writes`` declares are in ``data`` too. It returns a Dataset (or a mapping of arrays) of the variables declared in
    ``writes``, with dims in any order. In addition to ``data`` it may have the arguments ``prepared``, ``rng``, fixed
    patterns and ``asked``.

    Raises
    ------
    TypeError
        If ``run`` has another argument.
    """
    body = kind.run
    asked = [name for name in list(inspect.signature(body).parameters)[1:] if name != "data"]
    unknown = [name for name in asked if not (name in SPECIAL or identity_of(name))]
    if unknown:
        raise TypeError(
            f"{kind.__name__}.run asks for {', '.join(unknown)} besides data; allowed: {', '.join(sorted(SPECIAL))}"
        )
    reads, writes = reads_of(kind), writes_of(kind)
    dims = tuple(
        dict.fromkeys(
            own for declared in (*reads.values(), *writes.values()) for own in declared.dims if own != "stage"
        )
    )
    wanted = [name for own in dims for name in ((own, f"{own}_um") if own in PLACE else (own,))]

    def run(self: Stage, *arrays: Any, **given: Any) -> dict[str, Array]:
        given |= dict(zip(names[1:], arrays, strict=False))
        data = _dataset({port: (d, given[port]) for port, d in reads.items() if port in given}, dims, given)
        found = body(self, data, **{name: given[name] for name in asked})
        return _arrays(kind.__name__, found, writes, data)

    names = ["self", *reads, *wanted, *asked]
    run.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in names]
    )
    run.__doc__ = body.__doc__
    kind.run = run
    return kind


def _dataset(
    arrays: Mapping[str, tuple[Declaration, Array]], dims: Iterable[str], given: Mapping[str, Array]
) -> xr.Dataset:
    """Return the input variables with labels, and the coordinates of the output variables."""
    import xarray as xr

    coordinates: dict[str, Any] = {}
    for own in dims:
        if given.get(own) is not None:
            coordinates[own] = (own, given[own], {"units": dim(own).units} if dim(own).units else {})
        if own in PLACE and given.get(f"{own}_um") is not None:
            coordinates[f"{own}_um"] = (
                own,
                given[f"{own}_um"],
                {"units": "um", "long_name": f"{own} on the image plane"},
            )
    variables = {}
    for port, (declared, array) in arrays.items():
        attributes = {"units": declared.unit, "long_name": variable(declared.variable).long_name}
        variables[port] = (declared.dims, array, attributes)
    return xr.Dataset(variables, coords=coordinates)


def _arrays(name: str, found: Any, writes: Mapping[str, Declaration], data: xr.Dataset) -> dict[str, Array]:
    """Return the written variables as arrays with their dims in declared order.

    Raises
    ------
    PluginError
        If a variable is missing, or has other dims, another unit or other coordinates than declared.
    """
    import numpy as np
    import xarray as xr

    if not isinstance(found, Mapping):
        raise PluginError(f"{name}.run returned {type(found).__name__}, not a Dataset of the variables it writes")
    arrays: dict[str, Array] = {}
    extra = sorted(
        set(map(str, found)) - {d.variable for d in writes.values()} - set(data.variables) - {"y_um", "x_um"}
    )
    if extra:
        raise PluginError(f"{name}.run returned {', '.join(extra)}, which it does not write")
    # units that arithmetic has passed on are no statement of the stage
    carried = {str(one.attrs.get("units")) for one in (*data.data_vars.values(), *data.coords.values())}
    for declared in writes.values():
        if declared.variable not in found:
            if declared.optional:
                continue
            raise PluginError(
                f"{name}.run returned {', '.join(map(str, found)) or 'nothing'}, but declares {declared.variable}"
            )
        array = found[declared.variable]
        if not isinstance(array, xr.DataArray):
            arrays[declared.variable] = np.asarray(array)
            continue
        if set(array.dims) != set(declared.dims):
            dims = " ".join(map(str, array.dims))
            raise PluginError(
                f"{name} returned {declared.variable} with the dims '{dims}', but declares '{' '.join(declared.dims)}'"
            )
        unit = array.attrs.get("units", declared.unit)
        if unit not in carried and not same_unit(unit, declared.unit):
            raise PluginError(f"{name} returned {declared.variable} in {unit}, but declares {declared.unit}")
        for own in declared.dims:
            if own in array.coords and own in data.coords and not array.coords[own].equals(data.coords[own]):
                raise PluginError(
                    f"{name} returned {declared.variable} with other values of {own} than in its input; a stage "
                    "that changes the grid "
                    f"must define grid()"
                )
        arrays[declared.variable] = array.transpose(*declared.dims).to_numpy()
    return arrays

"""Results in memory are those that an archive of the same plan gives back."""

import numpy as np
import xarray
from xarray.testing import assert_identical

from etendue.contract.registry import installed_stages
from etendue.pipeline.file import parse_pipeline
from etendue.plan.planner import make_plan
from tests.run.small import plan_of, run

WHITE = """
name = "white"
wanted = ["white.white"]
keep = ["white.white"]
[camera]
peak_qe = [0.36, 0.44, 0.40]
f_number = 4
pixel_pitch = "4 um"
integration_time = "4 ms"
full_well_density = "2000 electron um-2"
[[stages]]
use = "uniform"
name = "scene"
white_luminance = "1000 cd m-2"
width = "40 um"
height = "40 um"
spacing = "1 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "white"
[sweep]
"white.use" = ["white", { use = "white", label = "again" }]
integration_time = ["2 ms", "4 ms"]
"""


def test_a_stage_swept_under_the_name_of_its_variable_gives_the_tree_of_its_archive(tmp_path):
    plan = make_plan(parse_pipeline(WHITE), installed_stages())
    held, stored = run(plan), run(plan, tmp_path / "a")
    assert not held.failed
    assert not stored.failed
    with xarray.open_datatree(tmp_path / "a" / "data.zarr", engine="zarr", chunks=None) as tree:
        ours, theirs = held.tree["white"].to_dataset(), tree["white"].to_dataset().load()
        assert ours["white"].dims == ("white", "integration_time", "channel")
        assert set(ours.variables) == set(theirs.variables)
        for name in ours.variables:
            assert ours[name].dims == theirs[name].dims
            assert ours[name].values.tolist() == theirs[name].values.tolist()
        assert_identical(ours["white"].variable.astype(float), theirs["white"].variable.astype(float))


def told(node):
    """Everything that a group holds, as values that nothing changes any more."""
    held = node.to_dataset(inherit=False)
    words = {name: (one.dims, one.dtype, dict(one.attrs), dict(one.encoding)) for name, one in held.variables.items()}
    indexes = {name: (index.name, index.tolist()) for name, index in held.indexes.items()}
    return repr((words, dict(held.attrs), indexes)), {
        name: one.values.tobytes() if one.dtype.kind in "biuf" else repr(one.values.tolist())
        for name, one in held.variables.items()
    }


def overwrite(array):
    if array.dtype.kind in "biuf" and array.flags.writeable:
        array[...] = 1 - array


def test_what_is_changed_in_place_in_one_group_is_changed_in_no_other():
    """Groups whose axes are equal share what nobody can change, and nothing else; but what is left out everywhere is
    the array of another group, and only changes with that.
    """
    tree = run(plan_of({"sweep.f_number": [2, 5.6]})).tree
    nodes = {node.path: node for node in tree.subtree}
    assert len({node.coords["y"].values.tobytes() for node in nodes.values() if "y" in node.coords}) < len(nodes) / 2
    for path, node in nodes.items():
        followers = {other for other in nodes if str(nodes[other].attrs.get("same_as", "")).rpartition("/")[0] == path}
        others = {other: told(nodes[other]) for other in nodes if other != path and other not in followers}
        own = told(node)
        for name in list(node.variables):
            variable = node[name].variable
            variable.attrs["changed"] = variable.encoding["changed"] = True
            overwrite(variable.values)
        for index in node.to_dataset(inherit=False).indexes.values():
            overwrite(np.asarray(index))
            index.name = f"changed in {path}"
        node.attrs["changed"] = True
        if len(node.variables):
            assert told(node) != own
        node.coords["y"] = ("y", np.arange(node.sizes["y"]) + 0.5) if "y" in node.sizes else 0
        assert {other: told(nodes[other]) for other in others} == others


def test_indexes_are_those_that_xarray_makes_of_the_coordinates():
    plan = plan_of({"sweep.f_number": [2, 5.6], "sweep.demosaic.use": ["demosaic_bilinear", "demosaic_nearest"]})
    for node in run(plan).tree.subtree:
        held = node.to_dataset(inherit=False)
        plain = {name: (one.dims, one.values, one.attrs) for name, one in held.variables.items()}
        made = xarray.Dataset(
            {name: plain[name] for name in held.data_vars}, {name: plain[name] for name in held.coords}, held.attrs
        )
        assert_identical(held, made)
        assert list(held.variables) == list(made.variables)
        assert list(held.xindexes) == list(made.xindexes)
        for name, index in held.xindexes.items():
            other = made.xindexes[name]
            assert index.equals(other) and index.index.identical(other.index) and index.coord_dtype == other.coord_dtype
            assert held[name].values.flags.writeable == made[name].values.flags.writeable

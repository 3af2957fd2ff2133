"""Results in memory are those that an archive of the same plan gives back."""

import xarray
from xarray.testing import assert_identical

from etendue.contract.registry import installed_stages
from etendue.pipeline.file import parse_pipeline
from etendue.plan.planner import make_plan
from tests.run.small import run

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

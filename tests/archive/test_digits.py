"""Digits that follow the tolerance: pictures are multiples of a step that the plan knows, wherever they are read, and
no other value changes its digits.
"""

from __future__ import annotations

import shutil
import warnings

import numpy as np
import pytest
import xarray
import zarr

import etendue
from etendue.archive.checks.verify import verify
from etendue.compute import rows as strips
from etendue.compute.rounded import BLOCK, rounded
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.evaluation.session import Session
from etendue.pipeline.file import parse_pipeline
from etendue.plan import cost
from etendue.plan.expansion.digits import SMALLEST, exponent
from etendue.plan.planner import make_plan, summary
from etendue.session import Options, collect, execute
from etendue.trust.repairing import repair
from etendue.trust.reproducing import reproduce

TEXT = """
name = "digits"
seed = 1
tolerance = 1e-3
[camera]
pixel_pitch = "3 um"
peak_qe = [0.36, 0.44, 0.40]
focal_length = "7 mm"
f_number = 4
integration_time = "4 ms"
diffusion_depth = "10 um"
[archive]
digits = "stated"
[[stages]]
use = "slanted_edge"
name = "scene"
white_luminance = "1000 cd m-2"
width = "96 um"
height = "96 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "lens_gaussian"
name = "lens"
sigma = "3 um"
[[stages]]
use = "diffusion"
[[stages]]
use = "pixel"
rows = 32
columns = 32
[[stages]]
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "full_well"
[[stages]]
use = "adc"
[[stages]]
use = "linearise"
[[stages]]
use = "white"
[[stages]]
use = "balance_mosaic"
[[stages]]
use = "demosaic_directional"
name = "demosaic"
[[stages]]
use = "colour_fit"
[[stages]]
use = "camera_to_xyz"
[[stages]]
use = "display"
[[stages]]
use = "encode"
[sweep]
integration_time = ["0.4 ms", "4 ms"]
"""
EXACT = {"archive.digits": "exact"}


def plan_of(over=None, text=TEXT, **how):
    return make_plan(parse_pipeline(text, overrides=over or {}), installed_stages(), **how)


def run(plan, archive=None, **options):
    outcome = execute(plan, archive, Options(**{"scheduler": "serial", "pictures": False, **options}))
    assert not outcome.failed
    return outcome


def arrays_of(plan, known=None):
    refs = {ref: [v for v in plan.node(ref[0]).writes] for ref in plan.cells}
    return collect(plan, refs, Options("serial"), known=known or {}).arrays


def same(one, other):
    assert one.keys() == other.keys()
    for ref, own in one.items():
        for name, array in own.items():
            np.testing.assert_array_equal(np.asarray(array), np.asarray(other[ref][name]), err_msg=f"{ref} {name}")


@pytest.fixture(scope="module")
def plan():
    return plan_of()


@pytest.fixture(scope="module")
def arrays(plan):
    return arrays_of(plan)


@pytest.fixture(scope="module")
def whole(plan, tmp_path_factory):
    folder = tmp_path_factory.mktemp("digits") / "whole"
    run(plan, folder)
    return folder


# -- rounding ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["float32", "float64"])
@pytest.mark.parametrize("power", [-126, -100, -10, 0, 7, 100])
def test_values_are_the_nearest_multiples(kind, power):
    step = 2.0**power
    given = (np.random.default_rng(1).normal(size=BLOCK + 3) * 1000 * step).astype(kind)
    found = rounded(given, step)
    wide = found.astype(np.float64)
    assert found.dtype == given.dtype and found.shape == given.shape
    assert np.array_equal(wide / step, np.rint(wide / step))
    assert np.abs(wide - given.astype(np.float64)).max() <= step / 2
    assert np.array_equal(rounded(found, step), found)
    order = np.argsort(given)
    assert (np.diff(found[order]) >= 0).all()
    assert not np.signbit(found[found == 0]).any()


@pytest.mark.parametrize("kind", ["float32", "float64"])
def test_what_has_no_digits_below_the_step_stays(kind):
    info = np.finfo(kind)
    given = np.array([np.nan, np.inf, -np.inf, info.max, -info.max, 2.0**60, 0.0, info.smallest_subnormal], kind)
    for step in (2.0**-126, 2.0**-30, 1.0, 2.0**30):
        found = rounded(given, step)
        np.testing.assert_array_equal(found[:5], given[:5])
        assert found[5] == given[5] and found[6] == 0 and found[7] == 0
    assert rounded(np.array(0.3, kind), 0.25) == 0.25 and rounded(np.zeros((0, 3), kind), 1.0).shape == (0, 3)


def test_the_step_is_the_largest_power_of_two_within():
    for step in (1e-3, 1.0, 0.9999, 3e4, 2.0**-126):
        power = exponent(step, "float32")
        assert 2.0**power <= step < 2.0 ** (power + 1)
    assert [exponent(own, "float32") for own in (0.0, np.inf, np.nan, 2.0 ** (SMALLEST["float32"] - 1))] == [None] * 4


# -- where it happens --------------------------------------------------------------------------------------------------


def test_pictures_are_multiples_of_their_steps_and_nothing_else_is_rounded(plan, arrays):
    seen = set()
    for ref, own in arrays.items():
        for name, array in own.items():
            power = plan.cells[ref].digits.get(name)
            picture = array.dtype.kind == "f" and plan.node(ref[0]).writes[name].dims[-2:] == ("y", "x")
            assert plan.cells[ref].left_out or (power is not None) is picture, (ref, name)
            if power is not None:
                seen.add(name)
                assert np.array_equal(np.ldexp(array, -power), np.rint(np.ldexp(array, -power))), (ref, name)
    assert seen >= {"radiance", "irradiance", "photon_rate", "expected_charge", "charge", "rgb_camera", "rgb_display"}


def test_rounding_changes_no_value_of_light_by_more_than_the_tolerance(plan, arrays):
    other = arrays_of(plan_of(EXACT))
    scene = ("scene", ())
    exact, found = other[scene]["radiance"], arrays[scene]["radiance"]
    assert 0 < np.abs(found - exact).max() <= plan.digits * exact.max()
    for name in ("white_radiance",):
        np.testing.assert_array_equal(arrays[scene][name], other[scene][name])
    rate = [own["pixel", ()]["photon_rate"] for own in (arrays, other)]
    assert 0 < np.abs(rate[0] - rate[1]).max() <= 3 * plan.digits * rate[1].max()  # after scene, irradiance and itself


def test_memory_archive_strips_bands_and_resumed_runs_have_the_same_bits(plan, arrays, whole, tmp_path, monkeypatch):
    tree, memory = etendue.open_archive(whole), run(plan).tree
    for node in plan.nodes:
        for name in node.writes:
            xarray.testing.assert_identical(
                tree[node.name][name].load().drop_attrs(), memory[node.name][name].drop_attrs()
            )
    kept = {"keep": ["scene", "lens", "exposure"]}
    run(plan_of(kept), tmp_path / "resumed")
    again = run(plan, tmp_path / "resumed")  # from what is stored
    assert {ref[0] for ref in again.reused} >= {"scene", "lens", "exposure"}
    resumed = etendue.open_archive(tmp_path / "resumed")
    for node in plan.nodes:
        for name in node.writes:
            xarray.testing.assert_equal(resumed[node.name][name].load(), tree[node.name][name].load())
    for name, value in {"LARGEST_WHOLE": 0, "STRIP": 1, "TILE": 8, "HALOS": 2}.items():
        monkeypatch.setattr(strips, name, value)
    same(arrays_of(plan), arrays)
    known = {ref: dict(own) for ref, own in arrays.items() if ref[0] in ("scene", "exposure")}
    same(
        {r: a for r, a in arrays_of(plan, known).items() if r not in known},
        {r: a for r, a in arrays.items() if r not in known},
    )


def test_bands_of_large_light_are_rounded_alike(tmp_path, monkeypatch):
    over = {"wanted": ["photon_rate", "lens.irradiance"], "leave_out": False}
    monkeypatch.setattr(cost, "LARGEST_WHOLE", 1000)
    banded = plan_of(over)
    outcome = run(banded, tmp_path / "banded")
    found = etendue.open_archive(tmp_path / "banded")["lens"]["irradiance"].values
    power = banded.cells["lens", ()].digits["irradiance"]
    assert np.array_equal(np.ldexp(found, -power), np.rint(np.ldexp(found, -power)))
    assert outcome.computed and verify(tmp_path / "banded").whole


def test_plain_zarr_reads_the_rounded_values(whole, arrays):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        group = zarr.open_group(whole / "data.zarr", mode="r")
        np.testing.assert_array_equal(group["scene/radiance"][:], arrays["scene", ()]["radiance"])
    shown = group["encode/rgb_display"].metadata.to_dict()["codecs"][0]["configuration"]["codecs"]
    assert [codec["name"] for codec in shown] == ["bytes", "blosc", "crc32c"]
    assert "zstd" in str(shown[1])


# -- keys and archives -------------------------------------------------------------------------------------------------


def test_digits_are_in_keys_and_only_where_they_are_stated(plan):
    bare = plan_of(text=TEXT.replace('[archive]\ndigits = "stated"\n', ""))
    exact = plan_of(EXACT)
    assert {ref: c.key for ref, c in bare.cells.items()} == {ref: c.key for ref, c in exact.cells.items()}
    for node in plan.nodes:
        for cell in plan.of(node.name):
            other = exact.cells[cell.ref]
            assert cell.seed == other.seed
            behind = node.name in ("scene", "irradiance", "encode", "exposure")
            assert not behind or cell.key != other.key
    assert plan_of({"tolerance": 1e-4}).cells["scene", ()].key != plan.cells["scene", ()].key
    doors = plan_of({"archive.digits": "stated"}, TEXT.replace('[archive]\ndigits = "stated"\n', ""))
    assert doors.cells["scene", ()].key == plan.cells["scene", ()].key


@pytest.mark.long
def test_a_change_of_digits_is_said_and_leaves_what_a_fresh_run_does(plan, whole, tmp_path):
    shutil.copytree(whole, tmp_path / "turned")
    exact = plan_of(EXACT)
    outcome = run(exact, tmp_path / "turned")
    assert outcome.reasons["scene"] == "digits: stated, tolerance 0.001 -> exact"
    run(exact, tmp_path / "fresh")
    for name in ("fresh", "whole"):
        if name == "whole":
            assert run(plan, tmp_path / "turned").reasons["encode"] == "digits: exact -> stated, tolerance 0.001"
        assert verify(tmp_path / "turned").whole
        other, turned = (
            etendue.open_archive(whole if name == "whole" else tmp_path / name),
            etendue.open_archive(tmp_path / "turned"),
        )
        for stage in ("scene", "adc", "encode"):
            xarray.testing.assert_equal(turned[stage].to_dataset().load(), other[stage].to_dataset().load())


def test_an_archive_is_extended_verified_reproduced_and_repaired(whole, tmp_path):
    archive = tmp_path / "more"
    shutil.copytree(whole, archive)
    more = plan_of({"sweep.integration_time": ["0.4 ms", "4 ms", "9 ms"]})
    outcome = run(more, archive)
    assert {ref[1] for ref in outcome.reused} >= {(0,), (1,)} and not outcome.reasons
    assert verify(archive).whole
    assert reproduce(archive, Options("serial")).reproduced
    shard = next((archive / "data.zarr/encode/rgb_display").glob("c.*"))
    data = bytearray(shard.read_bytes())
    data[20] ^= 1
    shard.write_bytes(data)
    assert not verify(archive).whole
    repair(archive, (), Options("serial"))
    assert verify(archive).whole


def test_a_session_keeps_results_of_other_digits_apart(arrays):
    session = Session(parse_pipeline(TEXT))
    trees = [session(want="expected_charge", archive__digits=word) for word in ("stated", "exact", "stated")]
    one, other, again = (np.asarray(tree["exposure"]["expected_charge"]) for tree in trees)
    assert np.array_equal(one, again) and not np.array_equal(one, other)
    np.testing.assert_array_equal(one[1], arrays["exposure", (1,)]["expected_charge"])
    tree = etendue.simulate(TEXT, want="expected_charge", archive__digits="exact", errors=False)
    np.testing.assert_array_equal(tree["exposure"]["expected_charge"], other)


# -- full scale --------------------------------------------------------------------------------------------------------


def test_a_dark_exposure_keeps_digits_for_what_brightens_it(plan):
    dark, light = (plan.cells["demosaic", (n,)].digits["rgb_camera"] for n in (0, 1))
    assert dark < light - 2  # a tenth of the light
    for n in (0, 1):
        assert plan.cells["display", (n,)].digits["rgb_linear"] == exponent(1e-3, "float32")


def test_points_are_relative_to_what_the_lens_leaves_of_them():
    text = TEXT.replace('use = "slanted_edge"', 'use = "points"').replace('sigma = "3 um"', 'sigma = "12 um"')
    over = {"wanted": ["lens.irradiance", "photon_rate"]}
    plan = plan_of(over, text)
    found, exact = arrays_of(plan), arrays_of(plan_of({**EXACT, **over}, text))
    for ref in (("lens", ()), ("pixel", ())):
        for name, power in plan.cells[ref].digits.items():
            full = np.abs(exact[ref][name]).max()
            assert power is None or 2.0**power <= 2 * 1e-3 * full
            assert np.abs(found[ref][name] - exact[ref][name]).max() <= 4e-3 * full  # four hand-overs


def test_one_pixel_and_64_bits():
    over = {"pixel.rows": 1, "pixel.columns": 1, "precision": "float64", "wanted": ["expected_charge", "photon_rate"]}
    plan = plan_of(over)
    for ref, own in arrays_of(plan).items():
        for name, power in plan.cells[ref].digits.items():
            scaled = np.ldexp(own[name], -power)
            assert own[name].dtype == np.float64 and np.array_equal(scaled, np.rint(scaled))


def test_the_plan_states_the_bytes_and_the_rounding_is_in_the_measured_error(plan):
    said = summary(plan)
    assert said["digits"]["tolerance"] == 1e-3 and 0 < said["digits"]["bytes"] < said["bytes"] / 2
    assert summary(plan_of(EXACT))["digits"] is None


@pytest.mark.parametrize(
    ("over", "text"),
    [
        ({"tolerance": 0}, "tolerance, which is 0"),
        ({"archive.digits": "statd"}, "did you mean 'stated'"),
        ({"archive.digits": 3}, "expected text"),
        ({"archive.digit": "stated"}, r"the only key of \[archive\] is digits"),
        ({"archive": "stated"}, "expected a table"),
    ],
)
def test_wrong_digits_are_refused(over, text):
    with pytest.raises(RequestError, match=text):
        plan_of(over)

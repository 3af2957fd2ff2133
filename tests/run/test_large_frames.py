"""Frames of real size: light made and transformed some rows at a time has the bits of the whole, in less memory."""

import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

from etendue import session
from etendue.compute.bands import StageBands
from etendue.compute.joined import segment_bands
from etendue.contract.registry import installed_stages
from etendue.plan import cost, planner
from etendue.transfer import expansion, rings, sampling
from tests.run.small import assert_same_bits


@pytest.fixture
def in_strips(monkeypatch):
    """Count every plane as a large one, and every light as too large to hold."""

    def choose(chosen: bool) -> None:
        monkeypatch.setattr(sampling, "LARGE", 0 if chosen else 1 << 40)
        monkeypatch.setattr(sampling, "TOGETHER", 1 << 10)

    return choose


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("shape", [(1, 1), (1, 90), (70, 1), (31, 200), (97, 64), (300, 211)])
def test_a_large_plane_is_transformed_with_the_bits_of_a_small_one(shape, precision, in_strips):
    plane = np.random.default_rng(5).random(shape).astype(precision)
    place = ((0.0, 2.0, (shape[0] + 1) // 2), (0.0, 1.0, shape[1]))
    found = []
    for large in (False, True):
        in_strips(large)
        half = sampling.transform(plane)
        kept = half.copy()
        planes = [sampling.planes_of(half, *shape), sampling.sample(half, *shape, *place)]
        assert_array_equal(half, kept)
        few = np.ascontiguousarray(sampling.transform(plane, 3))
        found.append([kept, few, *planes, sampling.planes_of(half, *shape, own=True)])
    for one, other in zip(*found, strict=True):
        assert_same_bits(one, other)


def test_a_large_plane_is_transformed_in_little_memory_beside_its_transform(in_strips):
    in_strips(True)
    plane = np.ones((900, 800))
    sampling.planes_of(sampling.transform(plane), *plane.shape, own=True)  # loads libraries, which do not count
    tracemalloc.start()
    half = sampling.transform(plane)
    _, made = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    back = sampling.planes_of(half, *plane.shape, own=True)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # beside the transform only what lies beyond the frame; the way back takes the plane itself
    assert made < 2 * half.nbytes
    assert peak < 1.3 * (half.nbytes + back.nbytes)


@pytest.mark.parametrize("step", [1.0, 0.4])
def test_a_scene_is_looked_at_with_the_same_numbers_in_strips(step, in_strips):
    plane = np.random.default_rng(2).random((83, 120)).astype(np.float32)
    widths = rings.blur_widths(*plane.shape, step, 1.0)
    found = []
    for large in (False, True):
        in_strips(large)
        found.append(rings.largest_behind(plane, step, 1.0, widths))
    assert_array_equal(*found)


def pipeline(file: str, **scene: float) -> dict:
    return {
        "name": "rows",
        "camera": {"peak_qe": [0.4, 0.5, 0.3], "pixel_pitch": 2.8, "f_number": 4.0, "focal_length": 0.6},
        "wanted": ["photon_rate"],
        "keep": ["photon_rate"],
        "stages": [
            {
                "use": "photograph",
                "name": "scene",
                "file": file,
                "white_luminance": 100,
                "width": 280,
                "height": 210,
                "spacing": 1.4,
                "wavelength_from": 380,
                "wavelength_to": 700,
                "bin_width": 80,
                **scene,
            },
            {"use": "irradiance"},
            {"use": "optical_filter", "cut_off": 500},
            {"use": "falloff"},
            {"use": "vignetting", "rim_radius": 0.1, "rim_distance": 0.5},
            {"use": "angular_response", "power": 2},
            {"use": "diffraction"},
            {"use": "diffusion"},
            {"use": "pixel"},
        ],
    }


@pytest.mark.parametrize("size", [(200, 150), (61, 47)], ids=["sample for sample", "resampled"])
@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_light_made_some_rows_at_a_time_has_the_bits_of_whole_bands(size, depth, tmp_path, monkeypatch, in_strips):
    columns, rows = size
    values = np.random.default_rng(1).integers(0, np.iinfo(depth).max, (rows, columns), depth, endpoint=True)
    file = str(tmp_path / "picture.png")
    Image.fromarray(values).save(file)
    monkeypatch.setattr(cost, "LARGEST_WHOLE", 0)
    plan = planner.make_plan(session.from_document(pipeline(file)), installed_stages())
    asked = []
    rows_of = StageBands.rows
    monkeypatch.setattr(StageBands, "rows", lambda self, bands, own: asked.append(own) or rows_of(self, bands, own))
    found = []
    for large in (False, True):
        in_strips(large)
        asked.clear()
        outcome = session.execute(plan, None, session.Options("serial", pictures=False))
        assert not outcome.failed
        found.append(outcome.arrays["pixel", ()]["photon_rate"])
        assert any(own != slice(None) for own in asked) is large
    assert found[0].any()
    assert_same_bits(*found)


@pytest.mark.parametrize("seen", ["440,1\n600,1\n", "300,1\n800,1\n"], ids=["dark bands", "every band"])
@pytest.mark.parametrize("gathered", [1, 1 << 13])
@pytest.mark.parametrize("pixel", [{}, {"wavelength_terms": 4}, {"wavelength_terms": 4, "kept_frequencies": 0.5}])
def test_bands_gathered_some_rows_at_a_time_have_the_bits_of_whole_bands(
    seen, gathered, pixel, tmp_path, monkeypatch, in_strips
):
    """Eleven or four bands of sixteen on three or four planes; ranges of samples end within rows."""
    values = np.random.default_rng(3).integers(0, 255, (150, 200), np.uint8, endpoint=True)
    values[:70] = 0  # the first samples are dark in every band
    file, table = str(tmp_path / "picture.png"), tmp_path / "filter.csv"
    Image.fromarray(values).save(file)
    table.write_text(f"wavelength_nm,transmission\n{seen}")
    document = pipeline(file, bin_width=20)
    document["stages"][2] = {"use": "optical_filter", "table": str(table)}
    document["stages"][-1] = {"use": "pixel", "wavelength_terms": 3, **pixel}
    monkeypatch.setattr(cost, "LARGEST_WHOLE", 0)
    monkeypatch.setattr(expansion, "BLOCK", 1 << 10)
    monkeypatch.setattr(segment_bands, "GATHERED", gathered)
    monkeypatch.setattr(segment_bands, "LARGEST_SHARED", 0)
    plan = planner.make_plan(session.from_document(document), installed_stages(), False)
    asked = []
    rows_of = StageBands.rows
    monkeypatch.setattr(StageBands, "rows", lambda self, bands, own: asked.append(bands) or rows_of(self, bands, own))
    found = []
    for large in (False, True):
        in_strips(large)
        asked.clear()
        outcome = session.execute(plan, None, session.Options("serial", pictures=False))
        assert not outcome.failed
        found.append(outcome.arrays["pixel", ()]["photon_rate"])
        assert any(bands.stop - bands.start > 1 for bands in asked) is large
    assert found[0].any()
    assert_same_bits(*found)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (2, 3), (12, 7), (13, 8), (700, 301)])
def test_transforms_combined_in_place_have_the_bits_of_sums(rows, columns, precision):
    rng = np.random.default_rng(8)
    frequencies = np.fft.fftfreq(rows), np.arange(columns) / (2 * columns)
    plane = expansion.RadialPlane(*frequencies, precision)
    tables = rng.random((2, 3, plane.nodes.size))
    transforms = [
        (rng.random((rows, columns)) + 1j * rng.random((rows, columns))).astype(np.result_type(precision, "complex64"))
        for _ in range(3)
    ]
    sums = [np.zeros_like(transforms[0]) for _ in tables]
    for own, table in zip(sums, tables, strict=True):
        for transform, factor in zip(transforms, table, strict=True):
            plane.add_product(own, transform, factor)
    plane.combine(transforms, tables)
    assert len(transforms) == 2
    for one, other in zip(transforms, sums, strict=True):
        assert_same_bits(one, other)


def test_a_frame_without_light_gives_none(tmp_path, monkeypatch, in_strips):
    file = str(tmp_path / "black.png")
    Image.fromarray(np.zeros((150, 200), np.uint8)).save(file)
    monkeypatch.setattr(cost, "LARGEST_WHOLE", 0)
    in_strips(True)
    plan = planner.make_plan(session.from_document(pipeline(file)), installed_stages())
    outcome = session.execute(plan, None, session.Options("serial", pictures=False))
    assert not outcome.failed
    assert not outcome.arrays["pixel", ()]["photon_rate"].any()

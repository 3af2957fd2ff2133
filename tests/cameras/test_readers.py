"""Readers of other programs' files: what they hold is what is read, and a wrong or hostile file gets one line."""

import json
import math
import struct

import numpy as np
import pytest

from etendue.errors import RequestError
from etendue_camera import spectra
from etendue_camera.cameras import bodies, camconst, dng, files, lensfun, sensitivities, tunings
from etendue_camera.cameras.databases import lens_folder
from etendue_camera.cameras.tuned import FOLDER, packaged_tuning
from tests.cameras import database

SSF = {
    "header": {"manufacturer": "Acme", "model": "Box 1", "document_creator": "us", "license": "CC0-1.0"},
    "spectral_data": {
        "units": "relative",
        "index": {"main": ["R", "G", "B"]},
        "data": {"main": {"400": [0.0, 0.1, 1.0], "500": [0.1, 2.0, 0.3], "600": [1.0, 0.2, 0.0]}},
    },
}
TUNING = {
    "version": 2.0,
    "target": "bcm2835",
    "algorithms": [
        {"rpi.black_level": {"black_level": 4096}},
        {"rpi.noise": {"reference_constant": 0, "reference_slope": 2.0}},
        {"rpi.alsc": {"luminance_lut": [1.0 + 0.01 * i for i in range(192)]}},
    ],
}
CONSTANTS = """/* of a test: "not // read" */
{"camera_constants": [
  { // a comment
    "make_model": ["Acme Box 1", "Acme Box 2"], "dcraw_matrix": [10000,0,0,0,10000,0,0,0,10000],
    "ranges": {"black": 512, "white": [{"iso": [50, 100], "levels": [16000, 15000]}, {"iso": 200, "levels": 16200},]},
  },
]}"""


def code(document) -> bytes:
    return json.dumps(document).encode()


def test_every_packaged_sensitivity_is_a_camera_with_three_columns_that_see():
    names = bodies.sensitivities()
    assert len(names) == 52
    for name in names:
        channels, nodes, values = spectra.camera_rows(name)
        assert channels == ("R", "G", "B") and nodes[0] == 380 and nodes[-1] == 780 and len(nodes) == 81
        assert values.min() >= 0 and values.max() == 1
        peaks = nodes[values.argmax(axis=0)]
        assert peaks[2] < peaks[1] < peaks[0], name  # blue, green, red


def test_a_sensitivity_is_read_as_it_is_written_and_is_per_energy_unless_it_says_otherwise():
    own = sensitivities.sensitivity(code(SSF), "x.json")
    assert own.camera == "Acme Box 1" and own.per == "energy" and own.licence == "CC0-1.0"
    assert own.values.tolist() == [[0.0, 0.1, 1.0], [0.1, 2.0, 0.3], [1.0, 0.2, 0.0]]
    assert own.csv().splitlines()[3] == "400,0,0.05,0.5"  # relative to the largest of all
    quanta = {**SSF, "spectral_data": {**SSF["spectral_data"], "units": "relative, quantum"}}
    assert sensitivities.sensitivity(code(quanta), "x.json").per == "photon"


def test_every_packaged_tuning_is_read_and_its_full_scale_follows_from_its_slope():
    for path in FOLDER.glob("*.json"):
        own = packaged_tuning(path.stem)
        if own.slope:
            # at full scale the signal-to-noise ratio of a Poisson count is the root of the charge
            signal = tunings.TOP - own.black
            assert math.isclose(signal / (own.slope * math.sqrt(signal)), math.sqrt(own.full_scale()))
            assert math.isclose(own.gain(16) * own.full_scale(), signal)
    assert round(packaged_tuning("imx477").full_scale()) == 8025  # measured elsewhere: 8168
    assert packaged_tuning("imx708").looks_like_a_default() and not packaged_tuning("imx477").looks_like_a_default()


def test_the_shading_of_a_tuning_is_a_fall_off_of_at_most_one():
    r, relative = tunings.tuning(code(TUNING), "x.json").fall_off()
    assert r.max() < 1 and relative.max() == 1 and relative.shape == (192,)


def test_camera_constants_are_read_through_comments_and_trailing_commas():
    found = camconst.constants(CONSTANTS.encode(), "camconst.json")
    one = found["Acme Box 2"]
    assert one.black == 512 and one.white == 15000 and one.by_iso[-1] == (200, 16200)
    assert np.array_equal(one.matrix, np.eye(3))


def test_every_lens_entry_is_there_or_refused_with_its_name():
    own = lensfun.parsed(database.text().encode(), "x.xml")
    assert [one.model for one in own.lenses].count("Acme 50mm f/1.8") == 2 and len(own.lenses) == 4
    assert dict(own.refused) == {
        "Acme 8mm Fisheye": "its projection is fisheye; only rectilinear lenses can be used",
        "Acme 85mm": "its distortion has the model 'acm'; known are poly3, poly5, ptlens",
    }
    assert own.bodies_of(["Screw"]) == ("Alpha", "Screw")
    zoom = next(one for one in own.lenses if "20-40" in one.model)
    assert zoom.focal == (20, 40) and zoom.aperture[0] == 2.8 and len(zoom.vignetting) == 3


def test_a_real_database_is_read_whole():
    folder = lens_folder()
    if folder is None:
        pytest.skip("no lensfun database is installed, and ETENDUE_CAMERAS names none")
    own = lensfun.read_database(folder.glob("*.xml"))
    assert own.lenses and all(name and why for name, why in own.refused)
    for one in own.lenses:
        assert one.focal[0] <= one.focal[1] and one.mounts and one.half_diagonal() > one.half_side() > 0


def directory(tags, order="<"):
    """A TIFF of one directory: (tag, type, count, bytes)."""
    head, body = b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", len(tags)), b""
    start = len(head) + 12 * len(tags) + 4
    for tag, kind, count, data in sorted(tags):
        where = data.ljust(4, b"\0") if len(data) <= 4 else struct.pack("<I", start + len(body))
        body += data if len(data) > 4 else b""
        head += struct.pack("<HHI", tag, kind, count) + where
    return head + struct.pack("<I", 0) + body


def a_raw():
    warp = struct.pack(">I6d2d", 1, 1.0, 0.02, 0.0, 0.0, 0.0, 0.0, 0.5, 0.5)
    light = struct.pack(">5d2d", 0.5, 0.1, 0.0, 0.0, 0.0, 0.5, 0.5)
    ops = struct.pack(">I", 2) + b"".join(
        struct.pack(">IIII", which, 0x01030000, 0, len(body)) + body for which, body in ((1, warp), (3, light))
    )
    return directory([
        (256, 4, 1, struct.pack("<I", 60)), (257, 4, 1, struct.pack("<I", 40)), (262, 3, 1, struct.pack("<H", 32803)),
        (33421, 3, 2, struct.pack("<2H", 2, 2)), (33422, 1, 4, bytes([1, 0, 2, 1])),
        (50708, 2, 6, b"Box 1\0"), (50714, 3, 1, struct.pack("<H", 256)), (50717, 3, 1, struct.pack("<H", 4095)),
        (51041, 12, 2, struct.pack("<2d", 1 / 8000, 1e-7)), (51022, 7, len(ops), ops),
        (50721, 10, 9, struct.pack("<18i", *[v for one in np.eye(3).ravel() for v in (int(one * 1e4), 10**4)])),
        (50778, 3, 1, struct.pack("<H", 21)),
    ])  # fmt: skip


def test_a_dng_says_levels_pattern_matrix_noise_and_lens():
    own = dng.raw(a_raw(), "x.dng")
    assert (own.model, own.width, own.black, own.white, own.pattern) == ("Box 1", 60, 256, 4095, "GRBG")
    assert math.isclose(own.full_scale(), 8000) and math.isclose(own.read_noise(), 8000 * math.sqrt(1e-7))
    assert own.matrices[0][0] == 21 and np.array_equal(own.matrices[0][1], np.eye(3))
    r = np.array([0.0, 0.5, 1.0])
    assert np.allclose(own.fall_off(r), 1 / (1 + 0.5 * r**2 + 0.1 * r**4))
    assert np.allclose(own.real(r)[:, 0], r * (1 + 0.02 * r**2))


def test_a_dng_becomes_a_body_whose_charge_is_that_of_its_noise_profile(tmp_path):
    path = tmp_path / "x.dng"
    path.write_bytes(a_raw())
    own = files.named_in(path)
    density = float(str(own.camera["full_well_density"].value).split()[0])
    pitch = float(str(own.camera["pixel_pitch"].value).split()[0])
    assert math.isclose(density * pitch**2, 8000, rel_tol=1e-5) and own.camera["bits"].value == 12
    assert set(files.lens_tables(dng.raw(a_raw(), "x"), pitch)) == {"distortion", "falloff"}


@pytest.mark.parametrize("mask", ["RGGB", "GBRG"])
def test_a_raw_file_of_ours_is_read_as_it_was_written(mask, tmp_path):
    from etendue_camera.export import dng as ours

    white, matrix = np.array([0.5, 1.0, 0.6]), np.diag([0.95, 1.0, 1.09])
    rows = (mask[:2], mask[2:])
    frame = ours.RawFrame(
        np.full((8, 10), 100, np.uint16), rows, 64, 4095, white, matrix, "D65", f_number=2.8, iso=200, model="test"
    )
    ours.write(tmp_path / "a.dng", frame)
    own = dng.raw((tmp_path / "a.dng").read_bytes(), "a.dng")
    assert (own.model, own.width, own.height, own.black, own.white) == ("etendue test", 10, 8, 64, 4095)
    assert own.pattern == mask and own.iso == 200 and own.noise == () and len(own.matrices) == 1


WRONG = {
    "sensitivity of nothing": (sensitivities.sensitivity, b"{}"),
    "sensitivity of text": (sensitivities.sensitivity, code({**SSF, "spectral_data": {"index": 3}})),
    "sensitivity not finite": (sensitivities.sensitivity, code(SSF).replace(b"2.0", b"NaN")),
    "sensitivity nested": (sensitivities.sensitivity, b"[" * 100_000),
    "tuning of another target": (tunings.tuning, code({**TUNING, "target": "pisp"})),
    "tuning without black": (tunings.tuning, code({**TUNING, "algorithms": []})),
    "tuning not finite": (tunings.tuning, code(TUNING).replace(b"4096", b"Infinity")),
    "constants of nothing": (camconst.constants, b"[]"),
    "constants of a text": (camconst.constants, CONSTANTS.replace("512", '"a"').encode()),
    "lenses that are no XML": (lensfun.parsed, b"<lensdatabase><lens>"),
    "lenses of another root": (lensfun.parsed, b"<html/>"),
    "lenses with entities": (lensfun.parsed, b'<!DOCTYPE x [<!ENTITY a "b">]><lensdatabase>&a;</lensdatabase>'),
    "lenses with files": (lensfun.parsed, b'<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><lensdatabase>&a;</lensdatabase>'),
    "lenses nested": (lensfun.parsed, b"<lensdatabase>" + b"<a>" * 100_000),
    "a DNG of nothing": (dng.raw, b"II*\0"),
    "a DNG of a loop": (dng.raw, b"II*\0\x08\0\0\0\0\0\x08\0\0\0"),
    "a DNG cut off": (dng.raw, a_raw()[:150]),
    "a DNG of a huge tag": (dng.raw, directory([(50708, 2, 10**6, b"12345678")])),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_or_hostile_file_gets_one_line(name):
    read, data = WRONG[name]
    with pytest.raises(ValueError) as error:
        read(data, "their.file")
    text = str(error.value)
    assert "their.file" in text and "\n" not in text and len(text) < 300


def test_noise_profiles_of_darktable_are_refused_by_name_with_the_reason(tmp_path):
    path = tmp_path / "noiseprofiles.json"
    path.write_text('{"version": 0, "noiseprofiles": []}')
    with pytest.raises(RequestError, match="darktable.*do not give electrons"):
        files.named_in(path)
    other = tmp_path / "other.json"
    other.write_text("{}")
    with pytest.raises(RequestError, match="none of these"):
        files.named_in(other)

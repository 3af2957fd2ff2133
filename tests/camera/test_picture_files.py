"""A picture is read as it is, every bit of it, or refused with its name, what it holds and what is allowed."""

import re
import struct
import zlib

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageFile, ImageOps

from etendue.contract.registry import installed_stages
from etendue_camera.colour.encoding import srgb_encode
from etendue_camera.picture_files import MOST_PIXELS, read_picture

SHAPE = (6, 9)


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def write_png(path, rows, columns, depth, colour, pixels, *chunks):
    """A PNG from its parts (ISO/IEC 15948): every row with filter type ``sub`` or none, in turn."""
    each = len(pixels) // rows
    step = max(1, each // columns)
    body = bytearray()
    for row in range(rows):
        line = pixels[row * each : (row + 1) * each]
        if row % 2:
            line = bytes((line[i] - (line[i - step] if i >= step else 0)) % 256 for i in range(each))
        body += bytes([row % 2]) + line
    header = struct.pack(">IIBBBBB", columns, rows, depth, colour, 0, 0, 0)
    parts = [chunk(b"IHDR", header), *chunks, chunk(b"IDAT", zlib.compress(bytes(body), 9)), chunk(b"IEND", b"")]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))
    return str(path)


@pytest.fixture
def values():
    return np.random.default_rng(5).integers(0, 65536, (*SHAPE, 3)).astype(np.uint16)


@pytest.mark.parametrize(("colour", "channels"), [(0, 1), (2, 3)])
def test_a_png_of_16_bits_keeps_all_of_them(tmp_path, values, colour, channels):
    whole = values[..., :channels]
    found = read_picture(write_png(tmp_path / "deep.png", *SHAPE, 16, colour, whole.astype(">u2").tobytes()))
    assert np.array_equal(found.values, whole)
    assert found.full == 65535


def test_a_png_of_16_bits_with_an_opaque_alpha_channel_is_the_one_without(tmp_path, values):
    opaque = np.concatenate([values, np.full((*SHAPE, 1), 65535, np.uint16)], axis=-1)
    assert np.array_equal(
        read_picture(write_png(tmp_path / "a.png", *SHAPE, 16, 6, opaque.astype(">u2").tobytes())).values, values
    )


def test_every_way_of_writing_the_same_picture_gives_the_same_values(tmp_path, values):
    """8 bits: RGB and palette, PNG and TIFF, packed and not; grey as one channel."""
    few = (values // 8192 * 32).astype(np.uint8)
    picture = Image.fromarray(few)
    grey = picture.convert("L")
    for name, options in (
        ("a.png", {}),
        ("a.tif", {}),
        ("b.tif", {"compression": "tiff_lzw"}),
        ("c.tif", {"compression": "tiff_deflate"}),
    ):
        picture.save(tmp_path / name, **options)
        assert np.array_equal(read_picture(str(tmp_path / name)).values, few), name
        grey.save(tmp_path / name, **options)
        assert np.array_equal(read_picture(str(tmp_path / name)).values[..., 0], np.asarray(grey)), name
    palette = picture.quantize(64)
    palette.save(tmp_path / "p.png")
    palette.save(tmp_path / "p.tif")
    for name in ("p.png", "p.tif"):
        assert np.array_equal(read_picture(str(tmp_path / name)).values, np.asarray(palette.convert("RGB"))), name
    two = Image.fromarray(few[..., 0] > 99)
    for name in ("o.png", "o.tif"):
        two.save(tmp_path / name)
        assert np.array_equal(read_picture(str(tmp_path / name)).values[..., 0], 255 * np.asarray(two)), name


@pytest.mark.parametrize(
    "options", [{}, {"photometric": "minisblack"}, {"planarconfig": "separate"}, {"compression": "zlib"}]
)
def test_a_tiff_keeps_its_depth(tmp_path, values, options):
    for kind, full in ((np.uint8, 255), (np.uint16, 65535), (np.uint32, 2**32 - 1), (np.float32, 1), (np.float64, 1)):
        grey = options.get("photometric") == "minisblack"
        whole = (values / 65535 * full).astype(kind)
        written = whole[..., 0] if grey else np.moveaxis(whole, -1, 0) if "planarconfig" in options else whole
        tifffile.imwrite(tmp_path / "a.tif", written, **({"photometric": "rgb"} | options))
        found = read_picture(str(tmp_path / "a.tif"))
        assert np.array_equal(found.values, whole[..., :1] if grey else whole), kind
        assert found.full == full


@pytest.mark.parametrize("way", range(1, 9))
def test_a_picture_stands_the_way_up_that_its_file_says(tmp_path, values, way):
    picture = Image.fromarray((values >> 8).astype(np.uint8))
    exif = picture.getexif()
    exif[0x0112] = way
    upright = np.asarray(ImageOps.exif_transpose(_with(picture, exif)))
    for name, options in (("a.png", {}), ("a.tif", {}), ("b.tif", {"compression": "tiff_lzw"})):
        picture.save(tmp_path / name, exif=exif, **options)
        assert np.array_equal(read_picture(str(tmp_path / name)).values, upright), name


def _with(picture, exif):
    copy = picture.copy()
    copy.getexif().update(exif)
    return copy


def wrong(folder):
    """Name of a case, its file, and words of the refusal."""
    rgb = np.full((4, 4, 3), 99, np.uint8)
    made = {}

    def save(name, picture, **options):
        picture.save(folder / name, **options)
        return name

    def tiff(name, array, **options):
        tifffile.imwrite(folder / name, array, **options)
        return name

    clear = np.dstack([rgb, np.array([[255] * 4] * 3 + [[0] * 4], np.uint8)])
    made["alpha"] = save("alpha.png", Image.fromarray(clear)), "4 transparent pixels"
    made["alpha of a TIFF"] = (
        tiff("alpha.tif", clear, photometric="rgb", extrasamples=["unassalpha"]),
        "4 transparent pixels",
    )
    made["a transparent colour"] = (
        save("key.png", Image.fromarray(rgb), transparency=(99, 99, 99)),
        "16 transparent pixels",
    )
    made["CMYK"] = save("cmyk.jpg", Image.fromarray(rgb).convert("CMYK")), "mode CMYK"
    made["CMYK TIFF"] = tiff("cmyk.tif", np.dstack([rgb, rgb[..., :1]]), photometric="separated"), "SEPARATED"
    made["signed"] = tiff("signed.tif", rgb.astype(np.int32), photometric="rgb"), "int32"
    for name, value in (("NaN", np.nan), ("negative", -0.1), ("above", 6e10), ("inf", np.inf)):
        floats = np.full((4, 4), 0.5, np.float32)
        floats[1, 2] = value
        made[name] = tiff(f"{name}.tif", floats), "row 1, column 2"
    made["pages"] = tiff("pages.tif", np.stack([rgb, rgb]), photometric="rgb", metadata=None), "2 pictures"
    moving = [Image.fromarray(np.full((4, 4, 3), level, np.uint8)) for level in (9, 99)]
    made["animated"] = (
        save("moving.png", moving[0], save_all=True, append_images=moving[1:], duration=100),
        "2 pictures",
    )
    made["another kind"] = save("kind.bmp", Image.fromarray(rgb)), "BMP"
    (folder / "cut.png").write_bytes((folder / "alpha.png").read_bytes()[:60])
    made["cut off"] = "cut.png", "cut.png"
    (folder / "text.png").write_text("no picture")
    made["no picture"] = "text.png", "could not be read as a picture"
    return made


def test_what_cannot_be_read_as_it_is_is_refused_in_one_line(tmp_path):
    for name, (file, words) in wrong(tmp_path).items():
        with pytest.raises(ValueError) as refused:
            read_picture(str(tmp_path / file))
        text = str(refused.value)
        assert file in text and words in text, (name, text)
        assert "\n" not in text and len(text) - len(str(tmp_path)) < 220, (name, text)


@pytest.mark.parametrize(("rows", "columns"), [(8000, 10000), (32768, 32768)])
def test_a_picture_that_unfolds_is_refused_before_it_does(tmp_path, rows, columns, monkeypatch):
    """80 million and 1 thousand million pixels of one colour, in files of some 10 and 100 kB: Pillow itself stops at
    179 million.
    """
    header = struct.pack(">IIBBBBB", columns, rows, 1, 0, 0, 0, 0)
    body = zlib.compress(bytes(rows * (1 + columns // 8)), 9)
    path = tmp_path / "bomb.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", body) + chunk(b"IEND", b""))
    monkeypatch.setattr(ImageFile.ImageFile, "load", lambda self: pytest.fail("it was unfolded"))
    with pytest.raises(ValueError, match=re.escape(f"pixels, more than the {MOST_PIXELS:.3g}")):
        read_picture(str(path))


WIDE = chunk(b"iCCP", b"x\0\0" + zlib.compress(b"\0" * 128 + b"Display P3"))


def test_a_profile_or_gamma_that_is_not_applied_is_said(tmp_path):
    grey = bytes(range(12))
    for name, part, words in (
        ("srgb", chunk(b"sRGB", b"\0"), ""),
        ("plain", chunk(b"gAMA", struct.pack(">I", 45455)), ""),
        ("linear", chunk(b"gAMA", struct.pack(">I", 100000)), "gamma (1)"),
        ("steep", chunk(b"gAMA", struct.pack(">I", 38462)), "gamma (0.38462)"),
        (
            "primaries",
            chunk(b"cHRM", struct.pack(">8I", 31270, 32900, 68000, 32000, 26500, 69000, 15000, 6000)),
            "primaries (red at 0.68",
        ),
        ("points", chunk(b"cICP", bytes([12, 13, 0, 1])), "Display P3, sRGB"),
        ("srgb points", chunk(b"cICP", bytes([1, 13, 0, 1])), ""),
        ("bright", chunk(b"cICP", bytes([9, 16, 0, 1])), "Rec. 2020, PQ"),
        ("points before a profile", chunk(b"cICP", bytes([1, 13, 0, 1])) + WIDE, ""),
        ("other points", chunk(b"cICP", bytes([9, 13, 0, 1])) + WIDE, "Rec. 2020, sRGB"),
        ("wide", WIDE, "Display P3"),
    ):
        note = read_picture(write_png(tmp_path / f"{name}.png", 3, 4, 8, 0, grey, part)).note
        assert (words in note) if words else not note, (name, note)


@pytest.mark.parametrize(
    ("space", "index", "said"), [(2, None, True), (65535, "R03", True), (1, "R98", False), (None, None, False)]
)
def test_adobe_rgb_of_a_camera_without_a_profile_is_said(tmp_path, space, index, said):
    """As DCF has it: by the colour space of EXIF, or by the interoperability index."""
    exif = Image.Exif()
    own = ({0xA001: space} if space else {}) | ({0xA005: {1: index}} if index else {})
    if own:
        exif[0x8769] = own
    Image.new("RGB", (9, 6)).save(tmp_path / "a.jpg", exif=exif)
    assert ("Adobe RGB" in read_picture(str(tmp_path / "a.jpg")).note) == said


@pytest.mark.parametrize("cut", [90, 121])
def test_a_damaged_exif_table_is_read_without_a_word(tmp_path, recwarn, cut):
    """Cut off within its own table: Pillow warns, and the picture is as it is."""
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0x9286] = b"x" * 100
    Image.new("RGB", (9, 6)).save(tmp_path / "a.jpg", exif=exif.tobytes()[:-cut])
    assert read_picture(str(tmp_path / "a.jpg")).values.shape == (6, 9, 3)
    assert not [str(one.message) for one in recwarn]


@pytest.mark.parametrize(("brand", "name"), [(b"heic", "HEIC"), (b"mif1", "HEIC"), (b"avif", "AVIF")])
def test_what_telephones_write_instead_of_jpeg_is_named(tmp_path, brand, name):
    (tmp_path / "a.jpg").write_bytes(b"\0\0\0\x18ftyp" + brand + bytes(100))
    with pytest.raises(ValueError, match=f"is {name}; convert it to PNG, JPEG or TIFF"):
        read_picture(str(tmp_path / "a.jpg"))


def test_a_photograph_of_16_bits_has_the_reflectance_that_was_written(tmp_path):
    """From linear light through the file and back: half a step of 16 bits, 8e-6 of full scale; 8 bits would be 2e-3."""
    linear = np.linspace(0.0, 1.0, 3 * 16 * 16).reshape(3, 16, 16)
    encoded = np.round(65535 * srgb_encode(linear)).astype(np.uint16).transpose(1, 2, 0)
    path = write_png(tmp_path / "deep.png", 16, 16, 16, 2, encoded.astype(">u2").tobytes())
    stage = installed_stages().load("photograph")(
        file=path, white_luminance=100.0, width=16.0, height=16.0, illuminant="D65"
    )
    from etendue_camera.scene.stages.photograph import _linear_photograph

    found = np.stack(_linear_photograph(path, 16, 16))
    assert np.abs(found - linear).max() < 2.4 * 0.5 / 65535
    assert stage.describe()[0].contrast == np.inf

"""Real frames are read from every kind of file alike, one at a time, and faulty ones give one clear line."""

import json
import re
import tracemalloc
import warnings
import zipfile

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from PIL import Image

from etendue.cli import main
from etendue.errors import RequestError
from etendue_lab.frames import transfer
from etendue_lab.frames.frame_set import Window
from etendue_lab.frames.moments import moments, sites
from etendue_lab.frames.reading import open_frames
from tests.studies.desk import TRUE, measurement

SIGMAS = 2.2  # half intervals of 95 %: 4.3 standard errors, one in 50,000


@pytest.fixture(scope="module")
def arrays():
    return measurement(levels=12, stack=4)


@pytest.fixture(scope="module")
def npz(arrays, tmp_path_factory):
    path = tmp_path_factory.mktemp("desk") / "frames.npz"
    np.savez_compressed(path, **arrays)
    return path


def rows_of(arrays):
    """Every frame with its time, photons and kind."""
    for kind in ("light", "dark"):
        for i, pair in enumerate(arrays[kind]):
            photons = arrays["light_photons_per_pixel"][i] if kind == "light" else 0
            for frame in pair:
                yield frame, float(arrays[f"{kind}_time_s"][i]), float(photons), kind
        for frame in arrays[f"{kind}_stack"]:
            photons = arrays["light_stack_photons_per_pixel"] if kind == "light" else 0
            yield frame, float(arrays[f"{kind}_stack_time_s"]), float(photons), kind


def as_csv(arrays, folder, suffix):
    lines = ["file,time_s,photons,kind"]
    order = np.random.default_rng(1).permutation(len(rows := list(rows_of(arrays))))
    for number in order:  # in any order
        frame, time, photons, kind = rows[number]
        name = f"f{number}.{suffix}"
        if suffix == "npy":
            np.save(folder / name, frame[None])
        elif suffix == "png":
            Image.fromarray(frame).save(folder / name)
        else:
            tifffile.imwrite(folder / name, frame)
        lines.append(f"{name},{time!r},{photons!r},{kind}")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    return folder


def as_descriptor(arrays, folder):
    lines = ["# a set", "v 3.0", "n 12 64 64"]
    for number, (frame, time, photons, kind) in enumerate(rows_of(arrays)):
        Image.fromarray(frame).save(folder / f"f{number}.png")
        nanoseconds = time * 1e9
        lines += [f"b {nanoseconds!r} {photons!r}" if kind == "light" else f"d {nanoseconds!r}", f"i f{number}.png"]
    path = folder / "set.txt"
    path.write_text("\n".join(lines))
    return path


def levels_of(frames):
    """The mean and frames of every level; times to a femtosecond."""
    found = {}
    for one in frames.levels():  # a stack is a level of its own beside a pair of the same exposure
        count, total = found.get(key := (round(one.time, 15), one.light), (0, 0.0))
        own = len(one.frames)
        found[key] = (count + own, total + round(own * float(moments(frames, one).mean[0]) * 64 * 64))
    return found


@pytest.mark.parametrize("suffix", ["npy", "png", "tif"])
def test_a_table_of_files_in_any_order_gives_the_levels_of_the_arrays(arrays, npz, tmp_path, suffix):
    assert levels_of(open_frames(as_csv(arrays, tmp_path, suffix))) == levels_of(open_frames(npz))


def test_a_descriptor_gives_the_levels_of_the_arrays(arrays, npz, tmp_path):
    assert levels_of(open_frames(as_descriptor(arrays, tmp_path))) == levels_of(open_frames(npz))


def test_moments_are_those_of_the_definition(arrays, npz):
    frames = open_frames(npz, Window(3, 5, 40, 32))
    level = next(one for one in frames.levels() if not one.dark and len(one.frames) > 2)
    own = moments(frames, level)
    stack = np.stack([frames.cut(one) for one in level.frames]).astype(float)
    still = stack - stack.mean(axis=(1, 2), keepdims=True)
    variance = still.var(axis=0, ddof=1).mean() * stack[0].size / (stack[0].size - 1)
    assert own.mean[0] == pytest.approx(stack.mean(), rel=1e-13)
    assert own.variance[0] == pytest.approx(variance, rel=1e-9)  # sums of squares of codes up to 4095
    assert own.spatial[0] == pytest.approx(stack.mean(0).var(ddof=1) - own.variance[0] / len(stack), rel=1e-8)
    assert own.histogram.sum() == stack.size


def test_figures_hold_the_truth(npz):
    frames = open_frames(npz)
    found = transfer.figures(frames, transfer.curve(frames)).values
    for name in ("gain", "quantum_efficiency", "read_noise", "prnu", "dark_current", "dsnu"):
        one = found[name]
        assert abs(one.value - TRUE[name]) < SIGMAS * max(one.high - one.value, one.value - one.low), (name, one)
        assert one.low < one.value < one.high


def test_light_may_vary_at_one_time_with_one_level_of_dark(tmp_path):
    arrays = measurement(levels=12, stack=4, dark_current=0.0)
    arrays["light_time_s"], arrays["dark_time_s"] = np.full(12, 0.0), np.zeros(1)
    arrays["dark"] = arrays["dark"][:1]
    for kind in ("light", "dark"):
        arrays[f"{kind}_stack_time_s"] = 0.0
    np.savez(tmp_path / "one.npz", **arrays)
    frames = open_frames(tmp_path / "one.npz")
    found = transfer.figures(frames, transfer.curve(frames))
    assert found.values["gain"].low < TRUE["gain"] < found.values["gain"].high
    assert "two or more" in found.needs["dark_current"]


def test_a_bend_widens_the_interval_of_the_gain_to_that_at_the_dark():
    """With a bend of 4 % at the top the curve is less steep than the gain, which the interval still holds."""
    wide = []
    for bend in (0.0, 0.04):
        arrays = measurement(seed=4, levels=24, size=128, bend=bend, order=1)
        wide.append(_gain(arrays))
    assert wide[1].high - wide[1].low > 3 * (wide[0].high - wide[0].low)
    assert wide[1].value < 0.98 * TRUE["gain"] < wide[1].high


def _gain(arrays):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "a.npz", **arrays)
        frames = open_frames(Path(folder) / "a.npz")
        return transfer.figures(frames, transfer.curve(frames)).values["gain"]


def test_a_pattern_of_nothing_is_never_certainly_zero(tmp_path):
    np.savez(tmp_path / "a.npz", **measurement(dsnu=0.0, prnu=0.0))
    frames = open_frames(tmp_path / "a.npz")
    found = transfer.figures(frames, transfer.curve(frames)).values
    for name in ("dsnu", "prnu"):
        assert found[name].low == 0 < found[name].high


def test_memory_holds_a_few_frames_however_many_there_are(tmp_path):
    side, count = 1024, 40
    path = tmp_path / "many.npy"
    stored = np.lib.format.open_memmap(path, "w+", np.uint16, (count, side, side))
    stored[:] = np.arange(count, dtype=np.uint16)[:, None, None] % 7 + 50
    del stored
    (tmp_path / "a.csv").write_text("file,time_s,relative_light,kind\nmany.npy,0.1,0,dark\n")
    frames = open_frames(tmp_path / "a.csv")
    tracemalloc.start()
    moments(frames, frames.levels()[0])
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 26 * side * side  # sums 12 bytes a pixel, a frame and its strips; the file has 80


WRONG = {
    "no frames": ("file,time_s,photons,kind\n", "holds no frames"),
    "no columns": ("a,b\n1,2\n", "expected the columns"),
    "a missing file": ("file,time_s,photons\nabsent.png,1,2\n", "file not found"),
    "words for numbers": ("file,time_s,photons\ngood.npy,soon,2\n", "line 2: time_s is 'soon'"),
    "a file elsewhere": ("file,time_s,photons\n../../etc/passwd,1,2\n", "relative to the table's folder"),
    "negative light": ("file,time_s,photons\ngood.npy,1,-2\n", "at or above 0"),
    "two sizes": ("file,time_s,photons\ngood.npy,1,2\nwide.npy,1,2\n", "one size"),
    "a text as picture": ("file,time_s,photons\ntext.png,1,2\n", "text.png"),
    "fractions": (
        "file,time_s,photons\nhalf.npy,1,0\ngood.npy,1,3\ngood.npy,1,4\ngood.npy,1,5\n",
        "raw codes must be whole numbers",
    ),
    "one frame": ("file,time_s,photons\ngood.npy,1,0\ngood.npy,1,3\ngood.npy,1,4\ngood.npy,1,5\n", "the only frame"),
    "no dark": ("file,time_s,photons\ngood.npy,1,3\n", "no dark frames"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_faulty_measurements_give_one_line(tmp_path, fault):
    text, said = WRONG[fault]
    np.save(tmp_path / "good.npy", np.full((1, 16, 16), 7, np.uint16))
    np.save(tmp_path / "wide.npy", np.full((1, 16, 18), 7, np.uint16))
    np.save(tmp_path / "half.npy", np.full((2, 16, 16), 0.5))
    (tmp_path / "text.png").write_text("no picture")
    (tmp_path / "a.csv").write_text(text)
    result = CliRunner().invoke(main, ["emva", str(tmp_path)])
    assert result.exit_code == 2
    assert said in " ".join(result.output.split())
    assert "Traceback" not in result.output


def test_a_line_of_a_table_may_stand_for_all_frames_of_an_exposure(arrays, npz, tmp_path):
    inner = tmp_path / "session"
    rows = []
    for kind in ("light", "dark"):
        for level, (stack, time) in enumerate(zip(arrays[kind], arrays[f"{kind}_time_s"], strict=True)):
            where = inner / f"{kind} {level}"
            where.mkdir(parents=True)
            for number, plane in enumerate(stack):
                np.save(where / f"{number}.npy", plane)
            light = arrays["light_photons_per_pixel"][level] if kind == "light" else 0
            rows.append(f"{where.name}{'/*.npy' if level % 2 else ''},{time},{light},{kind}")
    (inner / "frames.csv").write_text("\n".join(["file,time_s,photons,kind", *rows]) + "\n")
    # the table is in a folder of the one that is named
    found = {(one.time, one.light): len(one.frames) for one in open_frames(tmp_path).levels()}
    expected = dict.fromkeys(zip(arrays["light_time_s"], arrays["light_photons_per_pixel"], strict=True), 2)
    expected |= dict.fromkeys(((time, 0.0) for time in arrays["dark_time_s"]), 2)
    assert found == expected
    (inner / "frames.csv").write_text("file,time_s,photons\nnone*.npy,1,2\n")
    with pytest.raises(RequestError, match="no file matches"):
        open_frames(tmp_path)


def _bomb(path):
    """Times that unfold to 320 MB, in a file of 320 kB."""
    np.savez_compressed(path, light=np.zeros((3, 2, 8, 8), np.uint16), dark=np.zeros((1, 2, 8, 8), np.uint16))
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as file, file.open("light_time_s.npy", "w") as member:
        header = {"descr": "<f8", "fortran_order": False, "shape": (40 << 20,)}
        np.lib.format.write_array_header_1_0(member, header)
        for _ in range(320):
            member.write(bytes(1 << 20))


HOSTILE = {
    "a time array that unfolds": (_bomb, "expected a number for each level"),
    "objects": (lambda path: np.savez(path, light=np.array([{}, {}])), "as objects|needed"),
    "words for times": (lambda path: _saved(path, light_time_s=np.array(["a", "b", "c"])), "of type <U1"),
    "no zip": (lambda path: path.write_text("frames"), "cannot be read as .npz"),
    "codes beyond 32 bits": (lambda path: _saved(path, light=np.full((3, 2, 8, 8), 1 << 40)), "at most 20 bits"),
    "infinite numbers": (
        lambda path: _saved(path, light=np.full((3, 2, 8, 8), np.inf)),
        "raw codes must be whole numbers",
    ),
    "single frames": (lambda path: _saved(path, light=np.ones((3, 1, 8, 8), np.uint16)), "the only frame"),
    "no levels": (lambda path: _saved(path, light=np.ones((0, 2, 8, 8), np.uint16), light_time_s=[]), "0 levels"),
}


def _saved(path, **own):
    np.savez(path, **{
        "light": np.ones((3, 2, 8, 8), np.uint16), "light_time_s": np.arange(1.0, 4), "dark_time_s": np.ones(1),
        "dark": np.ones((1, 2, 8, 8), np.uint16), **own,
    })  # fmt: skip


@pytest.mark.parametrize("kind", HOSTILE)
@pytest.mark.parametrize("command", ["emva", "calibrate"])
def test_hostile_arrays_give_one_line_and_no_file(tmp_path, kind, command):
    make, said = HOSTILE[kind]
    make(tmp_path / "a.npz")
    tracemalloc.start()
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a file that is left open
        result = CliRunner().invoke(
            main, [command, str(tmp_path / "a.npz"), *(["-o", str(tmp_path / "mine.toml")] * (command == "calibrate"))]
        )
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert result.exit_code == 2
    assert re.search(said, " ".join(result.output.split())), result.output
    assert "Traceback" not in result.output
    assert most < 64 << 20
    assert [one.name for one in tmp_path.iterdir()] == ["a.npz"]


def test_frames_of_one_exposure_must_be_stored_alike(tmp_path):
    np.save(tmp_path / "a.npy", np.full((2, 16, 16), 70, np.uint8))
    np.save(tmp_path / "b.npy", np.full((2, 16, 16), 70, np.uint16))
    (tmp_path / "a.csv").write_text("file,time_s,photons\na.npy,1,0\nb.npy,1,0\n" + "b.npy,1,5\n" * 3)
    frames = open_frames(tmp_path / "a.csv")
    with pytest.raises(RequestError, match="all frames must have the same number of bits"):
        moments(frames, frames.levels()[0])


def test_a_truncated_file_is_told(npz, tmp_path):
    (tmp_path / "cut.npz").write_bytes(npz.read_bytes()[:5000])
    with pytest.raises(RequestError, match="cut.npz"):
        open_frames(tmp_path / "cut.npz")


def test_the_command_prints_what_its_json_holds(npz):
    told = CliRunner().invoke(main, ["emva", str(npz), "--window", "0,0,64,48"])
    held = CliRunner().invoke(main, ["emva", str(npz), "--window", "0,0,64,48", "--json"])
    assert told.exit_code == held.exit_code == 0, told.output
    document = json.loads(held.output)
    assert (document["rows"], document["columns"]) == (48, 64)
    gain = next(one for one in document["channels"][0]["figures"] if one["figure"] == "gain")
    assert f"{gain['value']:.4g}" in told.output
    assert CliRunner().invoke(main, ["emva", str(npz), "--window", "60,0,64,64"]).exit_code == 2


def test_a_mosaic_is_measured_site_by_site(npz):
    frames = open_frames(npz, pattern="RGGB")
    assert list(sites(frames)) == ["R", "Gr", "Gb", "B"]
    curve = transfer.curve(frames, sites(frames)["Gb"])
    assert curve.moments[0].pixels == 32 * 32
    shifted = open_frames(npz, Window(1, 0, 32, 32), pattern="RGGB")  # a window keeps the sensor's mosaic
    assert list(sites(shifted)) == ["Gr", "R", "B", "Gb"]

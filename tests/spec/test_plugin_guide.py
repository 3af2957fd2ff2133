"""What docs/plugins.md shows works as it stands there."""

import re
import sys
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest

from etendue.contract.arrays import variables
from etendue.contract.registry import Registry
from etendue.contract.values import quantities as camera
from etendue.plugins import discovery
from etendue.plugins.discovery import Discovery
from etendue.testing import check_stage

TEXT = (Path(__file__).parents[2] / "docs" / "plugins.md").read_text()
PYTHON, TOML = (re.findall(rf"^```{language}\n(.*?)^```", TEXT, flags=re.M | re.S) for language in ("python", "toml"))


def block(words):
    (found,) = [text for text in PYTHON if words in text]
    return found


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A distribution with these files and this entry point, installed."""

    def put(module, **files):
        info = tmp_path / "my_camera-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-camera\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(
            TOML[0].replace("project.entry-points.", "").replace('"my_camera"', module)
        )
        for name, text in files.items():
            path = tmp_path / f"{name.replace('__', '/')}.py"
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)
        monkeypatch.syspath_prepend(tmp_path)
        found = Discovery(entry_points(group="etendue"))
        monkeypatch.setattr(discovery, "installed", lambda: found)
        return Registry(found)

    yield put
    for name in [name for name in sys.modules if name.split(".")[0] == "my_camera"]:
        del sys.modules[name]


def test_the_smallest_plugin_is_small_and_works(package):
    text = block("by a tenth per mm")
    assert sum(bool(line.strip()) for line in text.splitlines()) <= 12
    assert len(TOML[0].splitlines()) == 2
    registry = package("my_camera", my_camera=text)
    y, x = np.arange(-300.0, 301, 100), np.arange(-400.0, 401, 100)
    found = registry.load("vignette")().run(np.ones((2, 7, 9), np.float32), y, x)["irradiance"]
    assert found.dtype == np.float32
    np.testing.assert_allclose(found[0], 1 - 1e-4 * np.hypot(y[:, None], x), rtol=1e-6)
    assert registry.installed("vignette").origin == "my-camera 1.0"


def test_a_package_with_words_of_its_own_keeps_all_it_says(package):
    registry = package(
        "my_camera.manifest",
        my_camera__stages=block("hood_length: float"),
        my_camera__manifest=block("def etendue_sensors"),
    )
    kind = registry.load("vignette")
    assert check_stage(kind(loss=0.3)) == []
    assert variables.variable("light_lost").shown == "map"
    assert camera.declared("hood_length").units == "mm"
    assert registry.found.notes() == []


def test_the_demosaicer_in_a_few_lines_loads(package):
    registry = package("my_camera", my_camera=block("class DemosaicMine"))
    assert registry.load("demosaic_mine").role == ""


def test_every_hook_and_every_word_of_a_variable_is_in_the_guide():
    for what in discovery.HOOKS:
        assert f"`etendue_{what}`" in TEXT
    table = TEXT.partition("### What a variable declares")[2].partition("\n|")[2].partition("\n\n")[0]
    keys = " ".join(line.split(" | ")[0] for line in table.splitlines())
    assert [word for word in variables.Variable.__dataclass_fields__ if f"`{word}`" not in keys] == []


def test_the_stage_on_labels_loads_and_keeps_the_laws(package):
    registry = package("my_camera", my_camera=block("@labelled"))
    assert check_stage(registry.load("vignette")(loss=0.3)) == []

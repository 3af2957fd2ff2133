"""What plugins import of etendue is what docs/plugins.md names: those that are shipped, those that are scaffolded,
those that are shown.
"""

import ast
import re
import threading
from pathlib import Path

import pytest

from etendue.contract.registry import installed_stages
from etendue.pipeline.distribution import beginning, files
from etendue_camera import models

ROOT = Path(__file__).parents[2]
PUBLIC = ("etendue.api", "etendue_camera", "etendue_camera.api", "etendue_camera.models", "etendue.testing")
ROLES = sorted({installed_stages().load(name).role for name in installed_stages().names()})


def private(source):
    """Modules of etendue that a source imports beyond the public rooms; a whole ``import etendue`` is what users
    write.
    """
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {one.name for one in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{one.name}" if node.module == "etendue" else node.module for one in node.names}
    ours = {one for one in found if one.split(".")[0] == "etendue" and one not in ("etendue", "etendue.stages")}
    return {one for one in ours if not any(one == room or one.startswith(f"{room}.") for room in PUBLIC)}


def test_the_document_names_the_rooms():
    said = (ROOT / "docs" / "plugins.md").read_text().partition("`my_camera.py`")[0]
    assert set(re.findall(r"`(etendue(?:_camera)?(?:\.\w+)?)`", said)) == set(PUBLIC)


@pytest.mark.parametrize(
    "path", sorted((ROOT / "plugins").glob("*/*/**/*.py")), ids=lambda path: str(path.relative_to(ROOT / "plugins"))
)
def test_a_shipped_plugin_imports_public_rooms_alone(path):
    assert not private(path.read_text())


@pytest.mark.parametrize("role", ROLES)
def test_a_scaffold_imports_public_rooms_alone(role):
    texts = files(beginning(installed_stages(), "begun", role, None))
    assert not {path: found for path, text in texts.items() if path.endswith(".py") and (found := private(text))}


@pytest.mark.parametrize("page", ["plugins.md", "tutorials/demosaicer.md"])
def test_a_plugin_that_a_page_shows_imports_public_rooms_alone(page):
    blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / "docs" / page).read_text(), flags=re.S | re.M)
    whole = [block for block in blocks if "import" in block]
    assert whole and not [found for block in whole if (found := private(block))]


def test_every_built_in_stage_is_a_model_under_the_name_of_its_class():
    kinds = {
        installed_stages().load(name)
        for name in installed_stages().names()
        if installed_stages().installed(name).distribution == "etendue"
    }
    assert {getattr(models, name) for name in dir(models)} == kinds
    with pytest.raises(AttributeError, match="did you mean 'DemosaicBilinear'"):
        models.DemosaicBilinaer  # noqa: B018


def test_a_model_is_there_while_the_registry_waits_for_the_plugin_that_asks():
    """Loading a plugin's stage holds the registry, and imports its module, which asks for its model."""
    found = []
    with installed_stages()._lock:
        asking = threading.Thread(target=lambda: found.append(models.DemosaicBilinear), daemon=True)
        asking.start()
        asking.join(60)
    assert found


def test_the_code_of_a_stage_that_builds_upon_another_is_that_of_both(tmp_path, monkeypatch):
    """An edit in the model's kernel makes other keys, as one in the plugin's own file does."""
    from etendue.plan.identity import code

    for path, text in files(beginning(installed_stages(), "begun", "demosaicing", None)).items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path / "src"))
    from etendue_begun.stages import Begun  # type: ignore[import-not-found]

    assert {"etendue_begun.stages", "etendue_camera.mosaic.stages.demosaic", "etendue_camera.mosaic.bilinear"} <= set(
        code.code_of(Begun).sources
    )


def test_every_name_of_the_door_for_plugins_opens():
    from etendue import api

    assert [name for name in api.__all__ if getattr(api, name, None) is None] == []

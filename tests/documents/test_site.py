"""The documents lead where they say, on a code host and on the site alike; what the site makes covers what is
installed.
"""

from __future__ import annotations

import importlib
import json
import re
import sys

import pytest

import etendue
import etendue.api
from etendue.cli import main
from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of, reads_of, writes_of
from etendue.contract.values import quantities as camera
from etendue.pipeline.presets import preset, preset_names
from tests.documents.pages import DOCS, ROOT

PAGES = sorted(path for path in DOCS.rglob("*.md") if not {"made", "_build"} & set(path.relative_to(DOCS).parts))
FILES = [*PAGES, *(path for path in sorted(ROOT.glob("*.md")) if path.name != "CHANGELOG.md")]


@pytest.fixture(scope="module")
def making():
    """The package that makes pages of what is installed."""
    sys.path.insert(0, str(DOCS))
    try:
        yield lambda name: importlib.import_module(f"making.{name}")
    finally:
        sys.path.remove(str(DOCS))


def anchors(text: str) -> set[str]:
    """Anchors of the headings of a page, as a code host and MyST make them."""
    heads = re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```", "", text, flags=re.S | re.M), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_link_between_files_leads_somewhere(path):
    text = re.sub(r"^```.*?^```", "", path.read_text(), flags=re.S | re.M)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, part = target.partition("#")
        leads_to = (path.parent / file).resolve() if file else path
        assert leads_to.exists(), f"{path.name} leads to {target}"
        assert not part or part in anchors(leads_to.read_text()), f"{leads_to.name} has no heading {part}"


def test_every_page_stands_in_a_list_of_pages():
    """A page in no toctree is found by nobody."""
    listed = set()
    for path in PAGES:
        for block in re.findall(r"^```{toctree}\n(.*?)^```", path.read_text(), flags=re.S | re.M):
            names = [line for line in block.splitlines() if line and not line.startswith(":")]
            globbed = ":glob:" in block
            listed |= {
                found
                for name in names
                for found in (path.parent.glob(f"{name}.md") if globbed else [path.parent / f"{name}.md"])
            }
    assert set(PAGES) - {found.resolve() for found in listed} == {DOCS / "index.md"}


def test_there_is_a_page_for_every_command_with_every_option(making):
    pages = making("commands").pages()
    assert pages.keys() == {"commands/index", *(f"commands/{name}" for name in main.list_commands(None))}
    for name in main.list_commands(None):
        command = main.get_command(None, name)
        for option in (word for p in command.params for word in p.opts if word.startswith("--")):
            assert option in pages[f"commands/{name}"], f"{name} {option}"


def test_there_is_a_page_for_every_stage_with_every_parameter_and_a_part_for_every_quantity(making):
    pages = making("stages").pages(ROOT, {})
    registry = installed_stages()
    for name in registry.names():
        page = pages[f"stages/{name}"]
        for parameter in parameters_of(registry.load(name)):
            assert parameter in page.replace("\\", ""), f"{name}.{parameter}"
        assert f"[{name}]({name}.md)" in pages["stages/index"]
    assert [line[3:] for line in pages["quantities"].splitlines() if line.startswith("## ")] == list(camera.names())


def test_what_is_public_in_python_is_on_a_page(making):
    pages = making("python").pages()
    for name in set(etendue.__all__) - {"stages"}:
        assert f":: etendue.{name}\n" in pages["python/etendue"]
    for name in etendue.api.__all__:
        assert f":: etendue.api.{name}\n" in pages["python/api"]
    subjects = {path.parent.name for path in (ROOT / "src/etendue_camera").glob("*/stages")} | {"light"}
    assert {f"python/{subject}" for subject in subjects} <= pages.keys()


def test_a_picture_is_taken_behind_a_stage_that_stands_in_a_camera_and_behind_one_that_does_not(making, tmp_path):
    """Of 128 x 160 pixels, drawn in colour; the stage in the place of its role."""
    gallery = making("gallery")
    base = gallery.still(etendue.Pipeline.read(ROOT / "pipelines" / "smallest.toml"))
    assert not base.axes
    swapped = gallery.in_place(base, "demosaic_nearest")
    assert [p.use for p in swapped.stages if p.name == "demosaic"] == ["demosaic_nearest"]
    behind = [p.use for p in gallery.in_place(base, "denoise").stages]
    assert behind[behind.index("denoise") - 1] == "demosaic_residual"
    kinds = [p for p in swapped.stages if p.use in ("demosaic_nearest", "mosaic")]
    seen = gallery._seen(swapped, "smallest", kinds, {"demosaic_nearest": "rgb_camera", "mosaic": "photocurrent"})
    assert {name: picture.pixels.shape for name, picture in seen.items()} == {
        "demosaic_nearest": (96, 128, 3),
        "mosaic": (96, 128, 3),
    }
    red, green, blue = (seen["mosaic"].pixels[..., n] > 0 for n in range(3))
    assert not (red & green).any() and not (red & blue).any() and green.mean() >= red.mean()
    seen["mosaic"].save(tmp_path / "mosaic.png")
    from PIL import Image

    assert Image.open(tmp_path / "mosaic.png").mode == "RGB"


def test_words_for_who_comes_from_elsewhere_are_words_of_ours():
    """What stands as code in the right column is a stage, variable, quantity, parameter, key of a file, command or
    pipeline.
    """
    registry = installed_stages()
    kinds = {name: registry.load(name) for name in registry.names()}
    known = {
        *kinds,
        *camera.names(),
        *(p for kind in kinds.values() for p in parameters_of(kind)),
        "seed",
        "keep",
        "file",
    }
    known |= {d.variable for kind in kinds.values() for of in (reads_of, writes_of) for d in of(kind).values()}
    known |= {
        choice for kind in kinds.values() for p, _, _ in parameters_of(kind).values() for choice in p.choices or ()
    }
    rows = [
        line
        for line in (DOCS / "coming_from.md").read_text().splitlines()
        if line.startswith("| ") and "---" not in line
    ]
    assert len(rows) > 40
    words = [word for row in rows for word in re.findall(r"`([^`]+)`", row.split(" | ")[1])]
    assert {word for word in words if re.fullmatch(r"[a-z]\w*", word)} - known - {
        "threads",
        "processes",
        "distributed",
    } == set()
    assert {word.split()[1] for word in words if word.startswith("etendue ")} <= set(main.list_commands(None))
    assert all((ROOT / word).exists() for word in words if word.startswith("pipelines/"))


def test_every_picture_of_a_page_has_a_command_that_draws_it(making):
    assert {path.name for path in (ROOT / "docs" / "pages").iterdir()} == set(making("screens").MADE)


def test_every_value_of_a_packaged_sensor_stands_on_a_page_with_its_source(making):
    text = making("sensors").page()
    for name in preset_names():
        part = text.partition(f"## {name}\n")[2].partition("\n## ")[0]
        for quantity, one in preset(name).shared.items():
            (row,) = (line for line in part.splitlines() if line.startswith(f"| `{quantity}` |"))
            assert not one.source.startswith("http") or f"](<{one.source}>)" in row


def link(status, info="", uri="https://a.b/c"):
    return json.dumps(
        {"filename": "made/sensors.md", "lineno": 7, "status": status, "code": 0, "uri": uri, "info": info}
    )


@pytest.mark.parametrize(
    ("lines", "said", "code"),
    [
        ([link("working"), link("unchecked", uri="#a")], "1 links tried, 0 broken", 0),
        (
            [link("working"), link("broken", "404 Client Error: Not Found")],
            "made/sensors.md:7: https://a.b/c is broken: 404 Client Error",
            1,
        ),
        ([link("working"), link("broken", "Failed to resolve: NameResolutionError")], "2 links tried, 1 broken", 1),
        ([link("redirected", "https://d.e/")], "https://a.b/c leads to https://d.e/", 0),
        (
            [link("timeout"), link("broken", "Max retries exceeded: NameResolutionError")],
            "none of 2 links could be reached",
            3,
        ),
        ([link("broken", "404 Client Error: Not Found")], "1 links tried, 1 broken", 1),
        ([link("unchecked")], "0 links tried, 0 broken", 0),
    ],
)
def test_links_that_lead_out_are_judged_and_a_lacking_net_is_told_from_a_lacking_page(making, lines, said, code):
    told, found = making("links").judged(lines)
    assert found == code and any(said in line for line in told), told


def test_the_gallery_is_divided_by_the_subjects_of_the_camera(making):
    gallery = making("gallery")
    registry = installed_stages()
    names = ("diffraction", "mosaic", "demosaic_bilinear", "sharpen")
    found = gallery._subjects([gallery.stage_document(registry, name) for name in names])
    subjects = {one["name"]: subject for subject, own in found.items() for one in own}
    assert [subjects[name] for name in names] == ["optics", "sensor", "mosaic", "restoration"]

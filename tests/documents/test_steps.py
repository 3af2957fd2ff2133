"""What the pages say to type is there, and does what they say; those that are followed step by step are followed
here.
"""

from __future__ import annotations

import ast
import os
import shutil
from pathlib import Path

import click
import pytest

from etendue.cli import main
from tests.documents.pages import DOCS, ROOT, STEPS, asked_in_text, blocks, commands, commands_of, file_of
from tests.fresh import process

OTHERS = {"python3", ".venv/bin/pip", ".", "pip", "pytest"}  # what makes an environment, and what runs in one


def checked(words: list[str]) -> None:
    """Whether a command, its options and the number of its arguments are known; nothing is run."""
    command = main.get_command(click.Context(main), words[0])
    if command is None:
        raise KeyError(words[0])
    context = click.Context(command, info_name=words[0])
    command.make_parser(context).parse_args(list(words[1:]))


@pytest.mark.parametrize("page", STEPS)
def test_every_command_of_a_page_is_one_with_these_options(page):
    found = [words for words, _ in commands(page)]
    assert sum(words[0] == "etendue" for words in found) >= 5
    assert {words[0] for words in found} - {"etendue"} <= OTHERS
    for words in [*found, *asked_in_text(page)]:
        if words[0] == "etendue":
            checked(words[1:])


def test_an_option_that_is_not_there_is_found():
    with pytest.raises(click.NoSuchOption):
        checked(["run", "mine.toml", "--swep", "f_number=2"])
    with pytest.raises(KeyError):
        checked(["rum", "mine.toml"])


def brought(folder: Path, name: str) -> Path:
    """A distribution that lies in a folder, as ``pip install -e`` leaves it: its sources and its metadata on one
    path.
    """
    sources = folder / name / "src"
    name = Path(name).name
    metadata = sources / f"{name.replace('-', '_')}-0.1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1.0\n")
    module = name.removeprefix("etendue-")
    (metadata / "entry_points.txt").write_text(f"[etendue]\n{module} = {name.replace('-', '_')}.manifest\n")
    return sources


class Reader:
    """Follows a page in a folder: types its commands, adds to its files, puts its Python in their place."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.path = folder, [str(ROOT / "src")]

    def types(self, words: list[str], code: int) -> None:
        if words[0] == "pip":
            self.path.insert(0, str(brought(self.folder, words[-1].partition("[")[0])))
        elif words[0] in ("etendue", "pytest"):
            self._runs(words, code)

    def _runs(self, words: list[str], code: int) -> None:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*self.path, os.environ.get("PYTHONPATH", "")])}
        if words[0] == "etendue":
            done = process(*words[1:], cwd=self.folder, env=environment)
        else:
            script = "import pytest, sys; sys.exit(pytest.main(sys.argv[1:]))"
            done = process(
                *words[1:], "-n", "0", "-p", "no:cacheprovider", code=script, cwd=self.folder, env=environment
            )
        assert done.returncode == code, f"{' '.join(words)}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"

    def puts(self, language: str, text: str) -> None:
        """Tables as files; TOML at the end of the one pipeline; a module in the place of the plugin's; lines of a
        class above ``run``.
        """
        stage = next(self.folder.glob("*/src/*/stages.py"), None)
        if language in ("csv", "xml"):
            (self.folder / file_of(text)).write_text(text)
        elif language == "toml":
            (pipeline,) = self.folder.glob("*.toml")
            pipeline.write_text(pipeline.read_text() + "\n" + text)
        elif stage is not None and text.startswith('"""'):
            stage.write_text(text)
        elif stage is not None:
            stage.write_text(stage.read_text().replace("    def run(", f"{text}\n    def run(", 1))
        else:
            here = Path.cwd()
            os.chdir(self.folder)
            try:
                exec(text, {})
            finally:
                os.chdir(here)

    def follows(self, page: str) -> None:
        for language, text in blocks(page):
            if language != "bash":
                self.puts(language, text)
                continue
            for words, code in commands_of(text):
                self.types(words, code)
                if "first.png" in words:
                    sheet, first = self.folder / "mine" / "contact_sheet.png", self.folder / "first.png"
                    self.at_first = sheet.exists(), first.stat().st_size > 1e4


@pytest.mark.long
@pytest.mark.parametrize("page", STEPS)
def test_a_page_is_followed_to_its_end(tmp_path, page):
    if page not in (
        "first_picture.md",
        "tutorials/demosaicer.md",
        "tutorials/archive.md",
    ):  # in the folder of the repository
        shutil.copytree(ROOT / "pipelines", tmp_path / "pipelines")
    if page == "not_a_camera.md":
        shutil.copytree(ROOT / "plugins" / "etendue-array", tmp_path / "plugins" / "etendue-array")
    reader = Reader(tmp_path)
    reader.follows(page)
    if page == "first_picture.md":  # it is there after the commands that lead to it
        assert reader.at_first == (True, True)
    pictures = {
        "first_picture.md": "first_map.png",
        "tutorials/phone.md": "defocused.png",
        "tutorials/lecture.md": "stops.png",
    }
    assert page not in pictures or (tmp_path / pictures[page]).exists()


def test_the_stage_on_labels_that_a_page_shows_computes_as_the_one_that_is_installed():
    """The methods, word for word."""
    (shown,) = (text for language, text in blocks("not_a_camera.md") if language == "python")
    own = (ROOT / "plugins" / "etendue-array" / "src" / "etendue_array" / "beam.py").read_text()

    def method(text, name):
        (kind,) = (one for one in ast.parse(text).body if isinstance(one, ast.ClassDef) and one.name == "DelayAndSum")
        (found,) = (one for one in kind.body if isinstance(one, ast.FunctionDef) and one.name == name)
        found.returns = None
        for argument in found.args.args:
            argument.annotation = None
        return ast.dump(found)

    for name in ("grid", "run"):
        assert method(shown, name) == method(own, name)


def test_pictures_of_the_documents_are_in_true_colour_and_small():
    from PIL import Image

    found = sorted((DOCS / "pictures").glob("*.png"))
    assert len(found) > 5
    for path in found:
        assert Image.open(path).mode in ("RGB", "RGBA") and path.stat().st_size <= 300_000, path.name

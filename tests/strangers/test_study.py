"""A study that somebody else brings, by public means only: a command, a method of pipelines, a kind of plot, a
section of a page.
"""

import ast
import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from etendue.plugins.discovery import HOOKS
from tests.fresh import process

HERE = Path(__file__).parent / "etendue-study"
SOURCE = HERE / "src"
ROOT = Path(__file__).parents[2]
BEAM = ROOT / "plugins" / "etendue-array" / "pipelines" / "beam.toml"
PUBLIC = ("etendue", "etendue.api", "etendue.cli", "etendue.cli.saying", "etendue_study.study")


def installed(folder):
    """The distribution as pip would leave it."""
    project = tomllib.loads((HERE / "pyproject.toml").read_text())["project"]
    info = folder / f"etendue_study-{project['version']}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    points = project["entry-points"]["etendue"].items()
    (info / "entry_points.txt").write_text("[etendue]\n" + "".join(f"{name} = {module}\n" for name, module in points))
    (folder / "etendue_study").symlink_to(SOURCE / "etendue_study")
    return folder


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    return installed(tmp_path_factory.mktemp("site"))


@pytest.fixture
def etendue(site, tmp_path):
    def call(*arguments):
        return process(*arguments, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(site), "COLUMNS": "120"})

    return call


def test_it_imports_what_is_public_alone():
    found = set()
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                found.add(node.module)
            elif isinstance(node, ast.Import):
                found |= {one.name for one in node.names}
    assert {name for name in found if name.startswith("etendue")} <= set(PUBLIC)
    assert found - set(PUBLIC) <= {"click", "matplotlib.figure"}


def test_its_command_stands_in_help_without_being_imported(etendue, site):
    listed = etendue("--help")
    assert listed.returncode == 0
    assert "slopes FILE NAME=V,V" in listed.stdout and "which figure moves most" in listed.stdout
    source = "import sys\nfrom etendue.cli.program import main\ntry: main(['--help'])\nexcept SystemExit: pass\n"
    source += "assert not {'etendue_study.command', 'etendue_study.study', 'numpy', 'xarray'} & set(sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", source], env={**os.environ, "PYTHONPATH": str(site)}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    own = etendue("slopes", "--help")
    assert own.returncode == 0 and "How far every figure of a pipeline moves" in own.stdout


def test_its_command_does_what_it_says(etendue):
    """The beam of twice the frequency is half as wide, or nearly."""
    done = etendue("slopes", BEAM, "tone=1000,2000", "--json")
    assert done.returncode == 0, done.stderr
    changes = json.loads(done.stdout)
    assert -0.55 < changes["figures.beam_width"] < -0.45
    assert changes["beam.white_noise_gain"] == 0
    assert [abs(change) for change in changes.values()] == sorted(map(abs, changes.values()), reverse=True)
    assert "figures.beam_width" in etendue("slopes", BEAM, "tone=1000,2000").stdout


def test_what_is_wrong_with_a_request_is_said_in_a_line(etendue):
    for words, said in (("tone", "has no two values"), ("tne=1,2", "did you mean 'tone'")):
        done = etendue("slopes", BEAM, words)
        assert done.returncode == 2 and len(done.stderr.splitlines()) == 1 and said in done.stderr


def test_its_method_is_one_of_pipelines(site):
    source = f"import etendue\nfound = etendue.Pipeline.read({str(BEAM)!r}).slopes(microphones=[8, 16])\n"
    source += "assert abs(found['beam.white_noise_gain'] - 0.5) < 1e-6, found"
    done = subprocess.run(
        [sys.executable, "-c", source], env={**os.environ, "PYTHONPATH": str(site)}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(not {"plots", "sections"} <= set(HOOKS), reason="plots and sections cannot be brought yet")
def test_its_plot_and_its_section_stand_beside_the_engines_own(etendue, tmp_path):
    done = etendue("run", BEAM, "--sweep", "tone=1000,2000", "--archive", "beams", "--quiet")
    assert done.returncode == 0, done.stderr
    assert "how far each figure moves along an axis" in etendue("plot", "beams", "--list").stdout
    drawn = etendue("plot", "beams", "tornado", "-o", "tornado.png")
    assert drawn.returncode == 0, drawn.stderr
    assert (tmp_path / "tornado.png").read_bytes()[:4] == b"\x89PNG"
    made = etendue("report", "beams", "-o", "beams.html")
    assert made.returncode == 0, made.stderr
    page = (tmp_path / "beams.html").read_text()
    assert "What moves most" in page and "From the first to the last value of tone" in page

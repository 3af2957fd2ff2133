"""An environment in which there is an engine and one domain, and nothing of a camera: made of wheels, as a user's is.

The libraries that they need are those of this environment, as links: its distributions of etendue are not among them.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOMAIN = ROOT / "plugins" / "etendue-array"
HOUSES = ("etendue_camera", "etendue_lab")
BESIDE = ("README.md", "LICENSE")


def engine_alone(place: Path) -> Path:
    """A copy of the repository's package without the two houses, and without their entry points."""
    (place / "src").mkdir(parents=True)
    shutil.copytree(ROOT / "src" / "etendue", place / "src" / "etendue", ignore=shutil.ignore_patterns("__pycache__"))
    for name in BESIDE:
        shutil.copy(ROOT / name, place)
    text = (ROOT / "pyproject.toml").read_text()
    packages = re.sub("".join(rf'(, )?"src/{house}"|' for house in HOUSES).rstrip("|"), "", text)
    project = re.sub(r"^\[project\.entry-points\.etendue\]\n(?:\w.*\n)+", "", packages, flags=re.M)
    build, _, _ = project.partition("[tool.ruff]")
    assert not any(house in build for house in HOUSES), build
    (place / "pyproject.toml").write_text(build)
    return place


class Apart:
    """The environment, and what is done in it."""

    def __init__(self, place: Path) -> None:
        self.place, self.env = place, place / "env"
        subprocess.run([sys.executable, "-m", "venv", self.env], check=True)
        self.python = self.env / "bin" / "python"
        self._pip("wheel", "--no-deps", "--wheel-dir", place / "wheels", engine_alone(place / "engine"), DOMAIN)
        self._pip("install", "--no-deps", "--no-index", *(place / "wheels").glob("*.whl"))
        libraries = place / "libraries"
        libraries.mkdir()
        for path in (
            one for own in dict.fromkeys(map(sysconfig.get_path, ("purelib", "platlib"))) for one in Path(own).iterdir()
        ):
            if (
                not re.match(r"_?_?(editable_impl_)?etendue|pip|.*\.pth$|__pycache__", path.name)
                and not (libraries / path.name).exists()
            ):
                (libraries / path.name).symlink_to(path)
        (site,) = self.env.glob("lib/python*/site-packages")
        (site / "libraries.pth").write_text(f"{libraries}\n")

    def _pip(self, *words: object) -> None:
        done = subprocess.run([self.python, "-m", "pip", "-q", *map(str, words)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr

    @property
    def environment(self) -> dict[str, str]:
        """That of this process, without what would lead back to the repository."""
        return {**{k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "COVERAGE"))}, "COLUMNS": "120"}

    def run(self, *words: object, code: int = 0, **more: str) -> str:
        """What a program of this environment prints."""
        done = subprocess.run(
            [self.python, *map(str, words)],
            capture_output=True,
            text=True,
            cwd=self.place,
            env={**self.environment, **more},
        )
        assert done.returncode == code, (words, done.stdout[-3000:], done.stderr[-3000:])
        return done.stdout

    def etendue(self, *words: object, code: int = 0, **more: str) -> str:
        return self.run("-m", "etendue", *words, code=code, **more)

    def started(self, *words: object, **more: str) -> subprocess.Popen[bytes]:
        """A command that goes on beside."""
        return subprocess.Popen(
            [self.python, "-m", "etendue", *map(str, words)],
            cwd=self.place,
            env={**self.environment, **more},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

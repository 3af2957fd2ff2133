"""The commands of CI, each under its name, in the environment that is active, or else in that of nox: ``nox -l`` lists
them.

``pythons`` and ``lowest`` make environments of their own, with uv; a Python that is not installed is an error.
"""

import os
import sys
from pathlib import Path

import nox

nox.options.default_venv_backend = "none"
nox.options.error_on_missing_interpreters = True
nox.options.sessions = ["lint", "types", "imports", "house", "tests"]
if "VIRTUAL_ENV" not in os.environ:  # .venv/bin/nox without an activated environment: the tools beside nox
    os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
os.environ.setdefault("UV_PYTHON_DOWNLOADS", "never")
PLUGINS = [
    "-e",
    "plugins/etendue-demosaic-malvar",
    "-e",
    "plugins/etendue-demosaic-menon",
    "-e",
    "plugins/etendue-array",
]
EXTRAS = ["test", "distributed", "cubes", "view", "raw", "objects"]


@nox.session
def lint(session: nox.Session) -> None:
    """Style and form of all Python files."""
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")


@nox.session
def types(session: nox.Session) -> None:
    """Types of the package, strictly."""
    session.run("mypy")


@nox.session
def imports(session: nox.Session) -> None:
    """Imports point one way."""
    session.run("lint-imports")


@nox.session
def house(session: nox.Session) -> None:
    """How much there is of the house: no figure above the one recorded."""
    session.run("python", "benchmarks/house.py", "--against", "benchmarks/house.json")


@nox.session
def tests(session: nox.Session) -> None:
    """The laws; those that take long aside. Words behind -- go to pytest."""
    session.run("pytest", *session.posargs)


@nox.session
def long(session: nox.Session) -> None:
    """The laws that take long: kills at random instants, clusters, whole pipelines."""
    session.run("pytest", "-m", "long", *session.posargs)


@nox.session(python=["3.11", "3.12", "3.13"], venv_backend="uv")
def pythons(session: nox.Session) -> None:
    """The paper's camera and the laws under each Python that is supported. Words behind -- go to pytest."""
    session.install("-e", ".[test]", *PLUGINS)
    session.run(
        "etendue", "run", "pipelines/paper.toml", "--archive", f"{session.create_tmp()}/paper", "--recompute", "--quiet"
    )
    session.run("pytest", *session.posargs)


@nox.session(python="3.11", venv_backend="uv")
def lowest(session: nox.Session) -> None:
    """The same with the oldest versions that pyproject.toml allows; some laws on bits aside. Words behind -- go to
    pytest.
    """
    session.install("--resolution", "lowest-direct", "-e", f".[{','.join(EXTRAS)}]", *PLUGINS)
    session.run(
        "etendue", "run", "pipelines/paper.toml", "--archive", f"{session.create_tmp()}/paper", "--recompute", "--quiet"
    )
    session.run("pytest", "-m", "not long and not bits", *session.posargs)


@nox.session
def docs(session: nox.Session) -> None:
    """The site, in docs/_build/html; a warning is a fault, such as a link that leads nowhere."""
    session.run("sphinx-build", "-W", "--keep-going", "-b", "html", "docs", "docs/_build/html", *session.posargs)


@nox.session
def links(session: nox.Session) -> None:
    """Links that lead out of the site, sources of sensors among them. Needs the net: not part of CI; without one it
    says so.
    """
    session.run(
        "sphinx-build", "-q", "-b", "linkcheck", "docs", "docs/_build/links", *session.posargs, success_codes=[0, 1]
    )
    session.run("python", "docs/making/links.py", "docs/_build/links/output.json")

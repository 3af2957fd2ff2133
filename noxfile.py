"""The commands of CI as sessions, run in the active environment, or else in that of nox: ``nox -l`` lists them.

``pythons`` and ``lowest`` create their own environments with uv; a Python version that is not installed is an error.
"""

import os
import sys
from pathlib import Path

import nox

nox.options.default_venv_backend = "none"
nox.options.error_on_missing_interpreters = True
nox.options.sessions = ["lint", "types", "imports", "house", "tests"]
if "VIRTUAL_ENV" not in os.environ:  # .venv/bin/nox without an activated environment: use the tools next to nox
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
    """Check style and formatting of all Python files."""
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")


@nox.session
def types(session: nox.Session) -> None:
    """Check the types of the package in strict mode."""
    session.run("mypy")


@nox.session
def imports(session: nox.Session) -> None:
    """Check that imports point one way."""
    session.run("lint-imports")


@nox.session
def house(session: nox.Session) -> None:
    """Check the code metrics: none may exceed its recorded value."""
    session.run("python", "benchmarks/house.py", "--against", "benchmarks/house.json")


@nox.session
def tests(session: nox.Session) -> None:
    """Run the tests, except the slow ones. Arguments after -- go to pytest."""
    session.run("pytest", *session.posargs)


@nox.session
def long(session: nox.Session) -> None:
    """Run the slow tests: kills at random instants, clusters, whole pipelines."""
    session.run("pytest", "-m", "long", *session.posargs)


@nox.session(python=["3.11", "3.12", "3.13"], venv_backend="uv")
def pythons(session: nox.Session) -> None:
    """Run the paper's camera and the tests under each supported Python. Arguments after -- go to pytest."""
    session.install("-e", ".[test]", *PLUGINS)
    session.run(
        "etendue", "run", "pipelines/paper.toml", "--archive", f"{session.create_tmp()}/paper", "--recompute", "--quiet"
    )
    session.run("pytest", *session.posargs)


@nox.session(python="3.11", venv_backend="uv")
def lowest(session: nox.Session) -> None:
    """Run them with the oldest versions that pyproject.toml allows, except some tests on bits. Arguments after -- go to
    pytest.
    """
    session.install("--resolution", "lowest-direct", "-e", f".[{','.join(EXTRAS)}]", *PLUGINS)
    session.run(
        "etendue", "run", "pipelines/paper.toml", "--archive", f"{session.create_tmp()}/paper", "--recompute", "--quiet"
    )
    session.run("pytest", "-m", "not long and not bits", *session.posargs)


@nox.session
def docs(session: nox.Session) -> None:
    """Build the site in docs/_build/html; warnings, such as broken internal links, are errors."""
    session.run("sphinx-build", "-W", "--keep-going", "-b", "html", "docs", "docs/_build/html", *session.posargs)


@nox.session
def links(session: nox.Session) -> None:
    """Check the external links of the site, including sources of sensors. Needs a network, so it is not part of CI;
    without one it says so.
    """
    session.run(
        "sphinx-build", "-q", "-b", "linkcheck", "docs", "docs/_build/links", *session.posargs, success_codes=[0, 1]
    )
    session.run("python", "docs/making/links.py", "docs/_build/links/output.json")

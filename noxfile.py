"""The commands of CI, each under its name, in the environment that is active: ``nox -l`` lists them, ``nox -s tests`` runs one."""

import nox

nox.options.default_venv_backend = "none"
nox.options.sessions = ["lint", "types", "imports", "tests"]


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
def tests(session: nox.Session) -> None:
    """The laws; those that take long aside. Words behind -- go to pytest."""
    session.run("pytest", *session.posargs)


@nox.session
def long(session: nox.Session) -> None:
    """The laws that take long: kills at random instants, clusters, whole pipelines."""
    session.run("pytest", "-m", "long", *session.posargs)


@nox.session
def docs(session: nox.Session) -> None:
    """The site, in docs/_build/html; a warning is a fault, such as a link that leads nowhere."""
    session.run("sphinx-build", "-W", "--keep-going", "-b", "html", "docs", "docs/_build/html", *session.posargs)


@nox.session
def links(session: nox.Session) -> None:
    """Links that lead out of the site, sources of sensors among them. Needs the net: not part of CI; without one it says so."""
    session.run("sphinx-build", "-q", "-b", "linkcheck", "docs", "docs/_build/links", *session.posargs, success_codes=[0, 1])
    session.run("python", "docs/making/links.py", "docs/_build/links/output.json")

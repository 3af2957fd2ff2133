"""Who makes etendue, where it is found and which version it is stand in one place; all else takes them from there."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from importlib import metadata

import pytest
import yaml

from etendue.contract.registry import installed_stages
from etendue.plan.identity.code import libraries_of
from tests.documents.pages import DOCS, ROOT

WRITTEN = [*ROOT.glob("*.md"), *DOCS.glob("*.md"), *(DOCS / "making").glob("*.py"), DOCS / "conf.py"]


@pytest.fixture(scope="module")
def making():
    """``making.project`` and ``making.citation``, which live beside the documents."""
    sys.path.insert(0, str(DOCS))
    try:
        from making import citation, project

        yield project, citation
    finally:
        sys.path.remove(str(DOCS))


@pytest.fixture(scope="module")
def about(making):
    return making[0].project_of(ROOT)


def test_the_citation_is_what_the_project_says(making, about):
    assert (ROOT / "CITATION.cff").read_text() == making[1].citation(about), "python docs/making/citation.py"
    assert yaml.safe_load(making[1].citation(about))["version"] == about.version


def test_what_is_not_filled_in_yet_leads_nowhere_and_is_shown_nowhere(making, about):
    """An address that somebody made up might be somebody's; ``.invalid`` is nobody's, for ever."""
    project, citation = making
    assert project.is_filled("https://imaging.org/etendue") and project.is_filled("ada@imaging.org")
    assert not project.is_filled("https://a.invalid/imaging.org") and not project.is_filled("ada@etendue.invalid")
    assert project.UNFILLED not in citation.citation(about)


def test_what_is_filled_in_stands_in_the_citation(making, about):
    project, citation = making
    says = {
        **about.says,
        "authors": [{"name": "Ada Lovelace", "email": "ada@imaging.org"}, {"name": "Imaging: a group"}],
        "urls": dict.fromkeys(about.says["urls"], "https://imaging.org/etendue"),
    }
    read = yaml.safe_load(citation.citation(project.Project(says, "1.2.3")))
    assert read["authors"] == [{"name": "Ada Lovelace"}, {"name": "Imaging: a group"}]
    assert read["contact"] == [{"name": "Ada Lovelace", "email": "ada@imaging.org"}]
    assert read["repository-code"] == read["url"] == "https://imaging.org/etendue" and read["version"] == "1.2.3"


def test_no_address_or_author_is_repeated(about):
    """Whoever fills them in does so once."""
    emails = (one["email"] for one in about.says["authors"] if "email" in one)
    own = {*about.says["urls"].values(), *emails, *about.authors}
    assert [(path.name, one) for path in WRITTEN for one in own if one in path.read_text()] == []


# -- the version ------------------------------------------------------------------------------------------


def test_the_changelog_begins_with_this_version(about):
    newest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), flags=re.M)[1]
    assert newest == re.sub(r"\.dev\d+$", "", about.version)


def test_a_tag_says_what_the_fallback_says(about):
    """At the commit that is tagged; between two tags the fallback may run ahead."""
    done = subprocess.run(["git", "tag", "--points-at", "HEAD"], cwd=ROOT, capture_output=True, text=True)
    tags = [tag.removeprefix("v") for tag in done.stdout.split() if re.match(r"v?\d", tag)]
    assert not tags or about.version in tags


def test_no_key_names_the_version_of_etendue():
    """Its code counts, file by file: another release of the same code computes nothing again."""
    registry = installed_stages()
    assert [name for name in registry.names() if "etendue" in libraries_of(registry.load(name))] == []


@pytest.mark.long
def test_every_kind_of_checkout_has_a_version_and_none_counts_commits(tmp_path, about):
    """A tag where there is one, else the fallback: without git, without tags, in a shallow clone, in an archive."""
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "env"], check=True)
    python = tmp_path / "env" / "bin" / "python"
    needed = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    subprocess.run([python, "-m", "pip", "install", "-q", *needed], check=True)
    place = tmp_path / "place"
    place.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        (place / name).write_bytes((ROOT / name).read_bytes())

    def git(*words):
        who = ("-c", "user.name=a", "-c", "user.email=a@b.invalid", "-c", "commit.gpgsign=false")
        return subprocess.run(["git", *who, *words], cwd=place, check=True, capture_output=True).stdout

    def version(folder, **more):
        command = [python.with_name("hatchling"), "version"]
        done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True, env=os.environ | more)
        return done.stdout.split()[-1]

    def shallow(name):
        git("clone", "-q", "--depth", "1", place.as_uri(), str(tmp_path / name))
        return tmp_path / name

    assert version(place) == about.version  # no git
    git("init", "-q")
    git("add", "-A")
    git("commit", "-qm", "one")
    git("commit", "-q", "--allow-empty", "-m", "two")
    assert version(place) == version(shallow("untagged")) == about.version
    assert version(place, PATH=str(python.parent)) == about.version  # no program git
    git("tag", "v7.1.0")
    assert version(place) == version(shallow("tagged")) == "7.1.0"
    git("commit", "-q", "--allow-empty", "-m", "three")
    (place / "README.md").write_text("changed")
    assert version(place) == "7.1.0"
    assert version(shallow("behind")) == about.version
    git("tag", "v7.2.0.dev0")
    assert version(place) == "7.2.0.dev0"
    (tmp_path / "archive").mkdir()
    subprocess.run(["tar", "-x", "-C", tmp_path / "archive"], input=git("archive", "HEAD"), check=True)
    assert version(tmp_path / "archive") == about.version


def test_the_version_that_is_installed_is_one(about):
    assert re.fullmatch(r"\d+\.\d+\.\d+(\.dev0|(a|b|rc)\d+)?", metadata.version("etendue"))
    assert re.fullmatch(r"\d+\.\d+\.\d+(\.dev0|(a|b|rc)\d+)?", about.version)

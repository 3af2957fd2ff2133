"""What a code host runs is what anybody runs at home: ``.ci/run``, under the oldest Python that is supported."""

from __future__ import annotations

import re
import tomllib

import pytest
import yaml

from tests.documents.pages import ROOT

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def steps(path):
    """Of all jobs, with the job."""
    jobs = yaml.safe_load(path.read_text())["jobs"].values()
    return [(job, step) for job in jobs for step in job["steps"]]


def test_ci_calls_the_script_and_has_an_end():
    (path,) = (path for path in WORKFLOWS if path.stem == "ci")
    (job,) = (job for job, step in steps(path) if step.get("run") == "bash .ci/run")
    assert (ROOT / ".ci" / "run").is_file() and job["timeout-minutes"] == 60
    given = {step["uses"].partition("@")[0]: step.get("with", {}) for _, step in steps(path) if "uses" in step}
    assert given["actions/checkout"]["fetch-depth"] == 0
    assert f">={given['actions/setup-python']['python-version']}" == PROJECT["requires-python"]
    assert any("chromium" in step.get("run", "") for _, step in steps(path))


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_reads_the_repository_and_no_more(path):
    document = yaml.safe_load(path.read_text())
    assert document["permissions"] == {"contents": "read"}
    assert all(re.search(r"@v\d+|@[0-9a-f]{40}", step["uses"]) for _, step in steps(path) if "uses" in step)
    assert all("timeout-minutes" in job for job, _ in steps(path))


def test_the_commands_that_others_extract_are_marked_in_the_readme():
    """``.ci/run`` takes the test command from behind its marker: without it nothing could be tested."""
    text = (ROOT / "README.md").read_text()
    for marker, what in (("run", "etendue run pipelines/paper.toml"), ("test", ".venv-test/bin/pytest")):
        found = re.findall(rf"^<!-- {marker} -->\n```bash\n(.+)\n```$", text, flags=re.MULTILINE)
        assert len(found) == 1 and found[0].endswith(what)
    assert "/<!-- test -->/" in (ROOT / ".ci" / "run").read_text()

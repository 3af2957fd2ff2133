"""The page is one file: its own script and style alone may run, no text of an archive is markup, and it asks nobody
for anything.
"""

import base64
import hashlib
import re
import socket

import pytest
from click.testing import CliRunner

from etendue.cli import main
from etendue.present.page.html import page
from tests.page.conftest import HOSTILE, embedded_document


@pytest.fixture(scope="module")
def html(archive, tmp_path_factory):
    file = tmp_path_factory.mktemp("report") / "deep" / "report.html"
    result = CliRunner().invoke(main, ["report", str(archive), "-o", str(file)])
    assert result.exit_code == 0, result.output
    return file.read_text()


def digest(text):
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def test_only_its_own_script_and_style_may_run(html):
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', html).group(1)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    script, style = (
        re.findall(r"<script>(.*?)</script>", html, re.DOTALL),
        re.findall(r"<style>(.*?)</style>", html, re.DOTALL),
    )
    assert len(script) == len(style) == 1
    assert rules["script-src"] == f"'{digest(script[0])}'" and rules["style-src"] == f"'{digest(style[0])}'"
    assert rules["default-src"] == rules["connect-src"] == rules["base-uri"] == rules["form-action"] == "'none'"
    assert not re.search(r"\beval\(|new Function|innerHTML|outerHTML|document\.write|insertAdjacentHTML", script[0])


def test_nothing_of_an_archive_is_markup(html):
    document = embedded_document(html)
    assert document["description"] == HOSTILE
    before, _, rest = html.partition('<script type="application/json" id="document">')
    data, _, after = rest.partition("</script>")
    assert "<" not in data and ">" not in data and "&" not in data
    assert "owned" not in before and "owned" not in after


def test_a_hostile_name_is_escaped_in_the_title():
    assert "<title>&lt;/title&gt;&lt;b&gt; · etendue</title>" in page({"name": "</title><b>"})
    assert "<title>small · night · etendue</title>" in page({"name": "small", "archive": "night"})
    assert "<title>small · etendue</title>" in page({"name": "small", "archive": "small"})


def test_it_names_no_address_of_the_network(html):
    addresses = set(
        re.findall(r"(?:https?:)?//[a-z0-9-]+\.[a-z]{2,}[^\s'\"]*", html.replace("http://www.w3.org/2000/svg", ""))
    )
    assert not addresses


def test_a_folder_that_is_no_archive_is_refused_and_nothing_is_written(tmp_path):
    (tmp_path / "empty").mkdir()
    for command in (
        ["report", str(tmp_path / "empty"), "-o", str(tmp_path / "out.html")],
        ["view", str(tmp_path / "empty"), "--no-browser"],
    ):
        result = CliRunner().invoke(main, command)
        assert result.exit_code == 2 and "is not an archive of etendue" in result.output
    assert not (tmp_path / "out.html").exists()


def test_what_cannot_be_written_or_listened_to_is_a_wrong_request(archive, tmp_path):
    result = CliRunner().invoke(main, ["report", str(archive), "-o", str(tmp_path)])
    assert result.exit_code == 2 and "is a folder" in result.output
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        result = CliRunner().invoke(main, ["view", str(archive), "--no-browser", "--port", str(taken.getsockname()[1])])
    assert result.exit_code == 2 and "in use" in result.output

"""The Python on the page about sessions runs as it stands, block after block."""

from __future__ import annotations

from tests.documents.pages import ROOT, blocks


def test_the_page_runs(tmp_path, monkeypatch):
    (tmp_path / "pipelines").symlink_to(ROOT / "pipelines")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    ran = [text for language, text in blocks("sessions.md") if language == "python"]
    for text in ran:
        exec(compile(text, "sessions.md", "exec"), names)
    assert len(ran) >= 3
    assert names["best"] is not None

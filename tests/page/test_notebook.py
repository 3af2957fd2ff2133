"""The page in a notebook gives the same answers as the server, under the number of the question."""

import json

import pytest

from etendue.present.page.live import Live
from etendue.present.page.notebook import answer, view


class Channel:
    def __init__(self):
        self.sent = []

    def send(self, said, buffers=()):
        self.sent.append((said, list(buffers)))


def test_answers_are_the_server_s(archive):
    live, channel = Live(archive), Channel()
    words = {"stage": "encode", "variable": "rgb_display", "at": "f_number:1,integration_time:0"}
    answer(live, channel, {"number": 7, "what": "picture", "words": words})
    _, body, extra = live.answers["picture"](words)
    assert channel.sent == [({"number": 7, "said": extra["X-Picture"]}, [body])]


@pytest.mark.parametrize(
    "asked", [{"number": 1, "what": "journal"}, {"number": 1, "what": "picture", "words": {"stage": "../.."}}]
)
def test_what_is_not_there_is_said_so(archive, asked):
    channel = Channel()
    answer(Live(archive), channel, asked)
    assert [(said["number"], bool(said["why"]), buffers) for said, buffers in channel.sent] == [(1, True, [])]


@pytest.mark.parametrize("asked", [None, "state", {}, {"number": "1", "what": "state"}])
def test_what_is_no_question_is_not_answered(archive, asked):
    channel = Channel()
    answer(Live(archive), channel, asked)
    assert channel.sent == []


def test_the_widget_holds_the_page_and_answers(archive):
    pytest.importorskip("anywidget", reason="anywidget is not installed: pip install etendue[view]")
    widget = view(archive, height=640)
    assert widget.height == 640 and '"through":"frame"' in widget.html and "connect-src 'none'" in widget.html
    sent = []
    widget.send = lambda said, buffers=None: sent.append((said, buffers))
    widget._handle_custom_msg({"number": 3, "what": "state", "words": {}}, [])
    ((said, buffers),) = sent
    assert said["number"] == 3 and json.loads(buffers[0])["finished"] == json.loads(buffers[0])["planned"]

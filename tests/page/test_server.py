"""The live page: on this machine, for whoever knows its address, to look and nothing else; values are the store's."""

import http.client
import json
import socket
import threading
from functools import cache
from urllib.parse import urlencode

import numpy as np
import pytest
import xarray

from etendue.present.page.live import Live
from etendue.present.page.server import ANSWERING, HOST, Server

AT = "f_number:1,integration_time:0"


@pytest.fixture(scope="module")
def server(archive):
    with Server(Live(archive)) as made:
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield made
        finally:
            made.shutdown()
            thread.join()


def asked(server, path, method="GET", **headers):
    connection = http.client.HTTPConnection(HOST, server.server_port, timeout=60)
    try:
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()
    finally:
        connection.close()


def found(server, what, **words):
    status, headers, body = asked(server, f"/{server.token}/{what}?{urlencode(words)}")
    assert status == 200, body
    return headers, body


def test_it_listens_on_this_machine_alone(server):
    assert server.server_address[0] == "127.0.0.1" and server.url.startswith(f"http://127.0.0.1:{server.server_port}/")


def test_without_its_token_there_is_nothing(server):
    wrong = [
        "/",
        f"/{server.token}",
        f"/{server.token[:-1]}/",
        f"/{'x' * len(server.token)}/",
        "//etc/passwd",
        f"/../{server.token}/",
    ]
    assert {asked(server, path)[0] for path in wrong} == {404}


def test_below_its_token_there_are_its_answers_and_no_files(server):
    paths = ["journal.jsonl", "../journal.jsonl", "data.zarr/zarr.json", "%2e%2e/x", "state/..", "__class__"]
    assert {asked(server, f"/{server.token}/{path}")[0] for path in paths} == {404}


def test_another_host_or_site_is_refused(server):
    state = f"/{server.token}/state"
    for host in (
        "evil.example",
        f"evil.example:{server.server_port}",
        "127.0.0.1",
        f"127.0.0.1:{server.server_port}.evil.example",
    ):
        assert asked(server, state, Host=host)[0] == 403
    assert asked(server, state, Host=f"localhost:{server.server_port}")[0] == 200
    assert asked(server, state, **{"Sec-Fetch-Site": "cross-site"})[0] == 403


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "HEAD"])
def test_it_can_be_looked_at_and_nothing_else(server, method):
    status, headers, _ = asked(server, f"/{server.token}/state", method)
    assert status == 405 and headers["Allow"] == "GET"


def test_answers_are_kept_by_nobody_and_framed_by_nobody(server):
    headers, _ = found(server, "")
    assert (
        headers["Cache-Control"] == "no-store"
        and headers["X-Frame-Options"] == "DENY"
        and headers["X-Content-Type-Options"] == "nosniff"
    )


@pytest.mark.parametrize(
    "words",
    [{"at": "f_number:9"}, {"at": "nothing:0"}, {"at": "f_number:-1"}, {"stage": "../x"}, {"variable": "status"}],
)
def test_what_is_not_there_is_said_so(server, words):
    asked_for = {"stage": "encode", "variable": "rgb_display", "at": AT, **words}
    assert asked(server, f"/{server.token}/picture?{urlencode(asked_for)}")[0] == 404


def test_a_number_that_is_none_is_a_bad_question(server):
    words = urlencode({"stage": "encode", "variable": "rgb_display", "at": AT, "stops": "nan"})
    assert asked(server, f"/{server.token}/picture?{words}")[0] == 400


def test_a_picture_is_the_display_s_values(archive, server):
    headers, body = found(server, "picture", stage="encode", variable="rgb_display", at=AT)
    said = json.loads(headers["X-Picture"])
    pixels = np.frombuffer(body, np.uint8).reshape(said["height"], said["width"], 4)
    stored = stored_of(archive, "encode", "rgb_display")
    np.testing.assert_array_equal(pixels[..., :3], np.round(np.clip(np.moveaxis(stored, 0, -1), 0, 1) * 255))


def test_the_probe_gives_every_stage_s_own_value(archive, server):
    _, body = found(server, "probe", at=AT, plane=1, x=-31.0, y=13.0, u=-1, v=-1)
    rows = {(row["stage"], row["variable"]): row for row in json.loads(body)["rows"]}
    assert {"scene", "pixel", "adc", "encode"} <= {stage for stage, _ in rows}
    for (stage, variable), row in rows.items():
        stored = stored_of(archive, stage, variable)
        assert row["values"] == stored[..., row["row"], row["column"]].ravel().tolist()
    pixel, scene = rows["adc", "raw"], rows["scene", "radiance"]
    assert (pixel["column"], pixel["row"]) == (
        round(-31 / 6 + 8.5),
        round(13 / 6 + 5.5),
    )  # 18 x 12 pixels of 6 um about the axis
    assert (scene["column"], scene["row"]) == (round(-31 / 2 + 29.5), round(13 / 2 + 19.5))


def test_a_line_tells_the_filters_apart(archive, server):
    _, body = found(server, "line", stage="adc", variable="raw", at=AT, along="x", at_sample=3)
    line, row = json.loads(body), stored_of(archive, "adc", "raw")[3]
    assert set(line["series"]) == {"G", "B"}
    merged = [next(v for v in values if v is not None) for values in zip(*line["series"].values(), strict=True)]
    assert merged == row.tolist()


def test_a_histogram_counts_every_pixel_that_is_seen(archive, server):
    _, body = found(server, "histogram", stage="adc", variable="raw", at=AT, y0=2, y1=10, x0=0, x1=9)
    region = stored_of(archive, "adc", "raw")[2:10, :9]
    told = json.loads(body)
    assert sum(sum(one["counts"]) for one in told["channels"]) == region.size and told["ceiling"] == 4095
    red = next(one for one in told["channels"] if one["name"] == "R")
    own = region[::2, ::2].astype(float)
    assert (red["mean"], red["deviation"]) == (
        pytest.approx(own.mean(), rel=1e-12),
        pytest.approx(own.std(), rel=1e-12),
    )


def stored_of(archive, stage, variable):
    group = opened(archive)[stage]
    labels = {"f_number": 4.0, "integration_time": 0.002}
    array = group.dataset[variable]
    return array.sel({dim: value for dim, value in labels.items() if dim in array.dims}).to_numpy()


@cache
def opened(archive):
    return xarray.open_datatree(archive / "data.zarr", engine="zarr")


def test_connections_that_ask_nothing_take_no_threads_and_are_closed_in_time(server, monkeypatch):
    before = threading.active_count()
    monkeypatch.setattr("etendue.present.page.server.WAITING", 40)
    held = [socket.create_connection((HOST, server.server_port)) for _ in range(60)]
    try:
        assert asked(server, f"/{server.token}/state")[0] == 200
        assert threading.active_count() <= before + ANSWERING
        held[0].settimeout(5)
        assert held[0].recv(1) == b""  # the oldest of too many
    finally:
        for one in held:
            one.close()


def test_an_archive_that_is_gone_is_said_to_be(server):
    folder = server.live.folder
    server.live._seen = -1e9
    folder.rename(folder.with_name("elsewhere"))
    try:
        status, _, body = asked(server, f"/{server.token}/state")
        assert (status, b"no longer there" in body) == (410, True)
    finally:
        folder.with_name("elsewhere").rename(folder)

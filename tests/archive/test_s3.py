"""Archives at a server that speaks S3, on this machine: the protocol itself, kills, and what goes wrong there.

The server is moto (``pip install 'moto[s3]' flask flask-cors``), in a process of its own.
"""

from __future__ import annotations

import importlib.util
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request

import pytest

from etendue.session import Options, execute
from tests.archive.tiny import store_of
from tests.run.small import environment

WHOLE_CELLS = True  # other processes write them
SERVER = ("moto", "flask", "flask_cors")
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(
        importlib.util.find_spec("obstore") is None or any(importlib.util.find_spec(name) is None for name in SERVER),
        reason="the S3 server is missing: pip install 'etendue[objects]' 'moto[s3]' flask flask-cors",
    ),
]


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def serve(port: int) -> subprocess.Popen[bytes]:
    """A server that answers, on loopback alone."""
    own = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    for _ in range(1200):
        if own.poll() is not None:
            raise AssertionError("the server did not start")
        try:
            urllib.request.urlopen(f"http://127.0.0.1:{port}/moto-api/", timeout=5).read()
            return own
        except OSError:
            time.sleep(0.1)
    own.kill()
    own.wait()
    raise AssertionError("the server does not answer")


@pytest.fixture(scope="module")
def server():
    for _ in range(3):  # another process may have taken the port meanwhile
        port = free_port()
        try:
            own = serve(port)
            break
        except AssertionError:
            continue
    try:
        request = urllib.request.Request(f"http://127.0.0.1:{port}/bucket", method="PUT")
        urllib.request.urlopen(request, timeout=60).read()
        yield f"http://127.0.0.1:{port}"
    finally:
        own.kill()
        own.wait()


@pytest.fixture
def machine(tmp_path, monkeypatch, server):
    """Keys and endpoint as everybody gives them, and a place for working folders."""
    given = {
        "AWS_ENDPOINT_URL": server,
        "AWS_ACCESS_KEY_ID": "a",
        "AWS_SECRET_ACCESS_KEY": "b",
        "AWS_REGION": "us-east-1",
    }
    for name, value in (given | {"ETENDUE_WORK": str(tmp_path / "work"), "NO_PROXY": "127.0.0.1"}).items():
        monkeypatch.setenv(name, value)
    return tmp_path


def command(*words, **more):
    return subprocess.run(
        [sys.executable, "-m", "etendue", *map(str, words)],
        capture_output=True,
        text=True,
        env=environment(**more),
        timeout=300,
    )


def downloaded(url, folder):
    from etendue.archive.remote.objects import Objects

    door = Objects(url)
    for path in door.list():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(door.get(path)[0])
    return folder


def test_a_run_killed_at_s3_is_finished_here_and_elsewhere(machine, place, plan, whole, monkeypatch):
    """kill -9 at instants of a run; a second machine waits for the end of the right of the first, and goes on."""
    file = place / "tiny.toml"
    for number, seconds in enumerate((1.5, 3.0)):
        url = f"s3://bucket/kills/{number}"
        run = subprocess.Popen(
            [sys.executable, "-m", "etendue", "run", str(file), "--archive", url, "--quiet"],
            env=environment(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        time.sleep(seconds)
        run.send_signal(signal.SIGKILL)
        run.wait()
        if number % 2:
            from etendue.archive.remote import lease

            with monkeypatch.context() as patch:
                patch.setenv("ETENDUE_WORK", str(machine / "elsewhere"))
                patch.setattr(lease, "LEASE", 0.0)
                assert not execute(plan, url, Options("serial")).failed
        else:
            done = command("run", file, "--archive", url, "--quiet")
            assert done.returncode == 0, done.stderr
        assert store_of(downloaded(url, machine / str(number))) == store_of(whole)
        checked = command("verify", url)
        assert checked.returncode == 0, checked.stdout


def test_commands_read_it(machine, plan, whole):
    """show, diff, reproduce, export and Python on a URL: as on the folder, with the URL in what they say."""
    import xarray

    import etendue

    url = "s3://bucket/sweeps/tiny"
    execute(plan, url, Options("serial"))
    for words, code in (
        (("show", url), 0),
        (("diff", whole, url), 0),
        (("reproduce", url, "--quiet"), 0),
        (("export", url, "--tiff"), 2),  # the smallest camera has no raw frame
    ):
        done = command(*words)
        assert url in done.stdout + done.stderr
        assert done.returncode == code, (words, done.stdout, done.stderr)
        assert str(machine / "work") not in done.stdout + done.stderr
    for name, archive in (("url", url), ("folder", whole)):
        for words in (
            ("report", archive, "-o", machine / f"report-{name}.html"),
            ("plot", archive, "-o", machine / f"plot-{name}.csv"),
        ):
            done = command(*words)
            assert done.returncode == 0, done.stderr
    csv = [(machine / f"plot-{name}.csv").read_text() for name in ("url", "folder")]
    assert csv[0] == csv[1]
    assert (machine / "report-url.html").stat().st_size > 10_000
    assert not list((machine / "work").glob("reading-*"))
    tree = etendue.open_archive(url)
    xarray.testing.assert_identical(
        tree["pixel/4x4"].to_dataset().compute(),
        xarray.open_datatree(whole / "data.zarr", engine="zarr")["pixel/4x4"].to_dataset().compute(),
    )


def test_what_is_wrong_is_said_in_one_line(machine, place, plan):
    file = place / "tiny.toml"
    for words, said in (
        (("run", file, "--archive", "s3://nowhere/x", "--quiet"), "there is no bucket 'nowhere'"),
        (("show", "s3://bucket/none"), "is not an archive of etendue"),
    ):
        done = command(*words)
        assert done.returncode == 2, (words, done.stderr)
        assert said in done.stderr and done.stderr.count("\n") == 1, done.stderr


def test_a_server_that_goes_away_in_the_middle(machine, place, plan, whole, monkeypatch):
    """Retried for a while, then one line; when it is back the same command goes on."""
    from etendue.archive import mirror
    from etendue.errors import StoreLost

    port = free_port()
    own = serve(port)
    try:
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}")
        urllib.request.urlopen(
            urllib.request.Request(f"http://127.0.0.1:{port}/bucket", method="PUT"), timeout=60
        ).read()
        real = mirror.Mirror._finish

        def gone(self):
            own.kill()
            own.wait()
            real(self)

        with monkeypatch.context() as patch:
            patch.setattr(mirror.Mirror, "_finish", gone)
            with pytest.raises(StoreLost, match=r"cannot be reached or has failed.*run again to continue") as found:
                execute(plan, "s3://bucket/lost", Options("serial"))
        assert "\n" not in str(found.value)
    finally:
        own.kill()
        own.wait()
    own = serve(port)  # which has forgotten everything
    try:
        urllib.request.urlopen(
            urllib.request.Request(f"http://127.0.0.1:{port}/bucket", method="PUT"), timeout=60
        ).read()
        assert execute(plan, "s3://bucket/lost", Options("serial")).computed == len(plan.cells)
        assert store_of(downloaded("s3://bucket/lost", machine / "copy")) == store_of(whole)
    finally:
        own.kill()
        own.wait()

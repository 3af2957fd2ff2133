"""The files of docs/cluster do what docs/cluster.md says: run here, with a queueing system and a Kubernetes that are
simulated.
"""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tests.run.small import text_of

ROOT = Path(__file__).parents[2]
FILES = ROOT / "docs" / "cluster"
BIN = str(Path(sys.executable).parent)


@pytest.fixture
def place(tmp_path):
    """A folder with a small pipeline, and an environment in which the scripts find this Python's commands first."""
    pytest.importorskip("distributed")
    (tmp_path / "small.toml").write_text(text_of(**{"f_number": [2, 4], "integration_time": '["2 ms", "8 ms"]'}))
    return tmp_path


def port() -> str:
    with socket.socket() as door:
        door.bind(("127.0.0.1", 0))
        return str(door.getsockname()[1])


def call(place, *command, **more):
    env = {**os.environ, "PATH": f"{place}{os.pathsep}{BIN}{os.pathsep}{os.environ['PATH']}", "PORT": port(), **more}
    return subprocess.run(command, cwd=place, env=env, capture_output=True, text=True, timeout=300, check=False)


def sound(place, done):
    """The run ended well, and its archive says so to a process that was not part of it."""
    assert done.returncode == 0, done.stderr
    shown = call(place, "etendue", "show", "a", "--json")
    assert '"running": false' in shown.stdout and '"failed"' not in shown.stdout, shown.stderr


@pytest.mark.long
@pytest.mark.parametrize("script", ["local.sh", "tls.sh"])
def test_the_script_starts_a_cluster_runs_a_command_on_it_and_ends_it(place, script):
    if script == "tls.sh":
        pytest.importorskip("cryptography")
        if not shutil.which("openssl"):
            pytest.skip("openssl is not there")
    where = port()
    done = call(
        place, "sh", str(FILES / script), "etendue", "run", "small.toml", "--archive", "a", "--quiet", PORT=where
    )
    sound(place, done)
    with socket.socket() as door:  # nobody listens any more
        assert door.connect_ex(("127.0.0.1", int(where))) != 0


@pytest.mark.long
def test_slurm_runs_workers_as_jobs(place):
    """``sbatch`` keeps the script (whoever gave it deletes it), starts it in the background and says a number,
    ``scancel`` ends it.
    """
    pytest.importorskip("dask_jobqueue")
    (place / "sbatch").write_text(
        '#!/bin/sh\ncp "$1" "job-$$.sh"\nsetsid sh "job-$$.sh" >/dev/null 2>&1 &\necho "Submitted batch job $!"\necho '
        "$! >>submitted\n"
    )
    (place / "scancel").write_text('#!/bin/sh\nfor job; do kill -- -"$job"; done\n')
    for name in ("sbatch", "scancel"):
        (place / name).chmod(0o755)
    done = call(
        place,
        sys.executable,
        str(FILES / "slurm.py"),
        "--jobs",
        "2",
        "--cores",
        "1",
        "--memory",
        "1GB",
        "--host",
        "127.0.0.1",
        "run",
        "small.toml",
        "--archive",
        "a",
        "--quiet",
    )
    try:
        sound(place, done)
        assert len((place / "submitted").read_text().split()) == 2
    finally:
        for job in (place / "submitted").read_text().split():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(int(job), 9)


def documents():
    yaml = pytest.importorskip("yaml")
    return list(yaml.safe_load_all((FILES / "kubernetes.yaml").read_text()))


def containers():
    """The command of each container, by its name."""
    pods = [document["spec"]["template"]["spec"] for document in documents() if "template" in document["spec"]]
    return {container["name"]: container for pod in pods for container in pod["containers"]}


def test_what_kubernetes_is_told_hangs_together():
    kinds = {(document["kind"], document["metadata"]["name"]): document["spec"] for document in documents()}
    service = kinds["Service", "etendue-scheduler"]
    for (kind, name), spec in kinds.items():
        if kind not in ("Deployment", "Job"):
            continue
        labels, pod = spec["template"]["metadata"]["labels"], spec["template"]["spec"]
        assert labels.items() >= kinds["NetworkPolicy", "etendue"]["podSelector"]["matchLabels"].items()
        if kind == "Deployment":
            assert spec["selector"]["matchLabels"].items() <= labels.items()
        assert (labels.items() >= service["selector"].items()) == (name == "etendue-scheduler")
        (volume,) = pod["volumes"]
        assert ("PersistentVolumeClaim", volume["persistentVolumeClaim"]["claimName"]) in kinds
        for container in pod["containers"]:
            assert [mount["name"] for mount in container["volumeMounts"]] == [volume["name"]]
            assert all(isinstance(word, str) for word in container["command"])
            addresses = re.findall(r"tcp://(\S+):(\d+)", " ".join(container["command"]))
            assert addresses == (
                [] if name == "etendue-scheduler" else [("etendue-scheduler", str(service["ports"][0]["port"]))]
            )


@pytest.mark.long
def test_the_containers_of_kubernetes_compute_a_pipeline_together(place):
    """Their commands as processes; the service's name and the volume stand for this machine and a folder of it."""
    where = port()
    texts = {
        name: shlex.join(container["command"])
        .replace("etendue-scheduler:8786", f"127.0.0.1:{where}")
        .replace("8786", where)
        for name, container in containers().items()
    }
    texts = {
        name: text.replace("/archives/paper.toml", "small.toml").replace("/archives/paper", "a")
        for name, text in texts.items()
    }
    env = {**os.environ, "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}
    quiet = {
        "cwd": place,
        "env": env,
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
        "start_new_session": True,
    }
    running = [
        subprocess.Popen(shlex.split(texts[name] + " --host 127.0.0.1"), **quiet)
        for name in ("scheduler", "worker", "worker")
    ]
    try:
        sound(place, call(place, *shlex.split(texts["run"])))
    finally:
        for process in reversed(running):
            os.killpg(process.pid, 15)
        for process in running:
            process.wait(60)

"""Results of a stage in a process that has computed nothing before.

In:  a ``Bench`` and inputs, in the order in which they are to be computed.
Out: digests of the results; None if the stage cannot be sent to another process.

One server process imports the modules that every stage needs and the libraries that its owner has loaded, and forks a
new child for each request. It ends when its owner ends, because the pipe that it reads is then closed. On systems
without fork nothing is compared.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import os
import pickle
import struct
import subprocess
import sys
import threading
from pathlib import Path
from typing import IO

from etendue.testing.bench import Arrays, Bench, digests

_lock = threading.Lock()
_server: list[subprocess.Popen[bytes]] = []
COMMAND = "from etendue.testing.behaviour import pristine; pristine.serve()"
LIBRARIES = (
    "scipy.fft",
    "scipy.interpolate",
    "scipy.linalg",
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.special",
    "xarray",
    "dask.array",
)  # which take longer to import than most stages to run
Answer = list[dict[str, str] | None]


def digests_alone(bench: Bench, inputs: list[Arrays]) -> Answer | None:
    """Return the digests of the results for these inputs, which a fresh process computes in this order."""
    if not hasattr(os, "fork") or bench.kind.__module__ == "__main__":
        return None
    words = (bench.stage, bench.given_grids, bench.scales, bench.coordinates, inputs)
    try:
        loaded = [name for name in LIBRARIES if name in sys.modules]
        question = pickle.dumps((loaded, [*sys.path, *_home(bench.kind.__module__)], pickle.dumps(words)))
    except Exception:  # another law reports stages that cannot be pickled
        return None
    with _lock:
        try:
            answer: Answer | None = pickle.loads(_ask(question))
        except (EOFError, OSError):
            _server.clear()
            return None
    return answer


def _home(module: str) -> list[str]:
    """Return the folder that contains a module's top package. pytest may import a module from a folder that is not on
    sys.path.
    """
    spec = sys.modules[module.partition(".")[0]].__spec__
    places = [] if spec is None else [*(spec.submodule_search_locations or ()), *([spec.origin] if spec.origin else ())]
    return [str(Path(places[0]).parent)] if places else []


def _ask(question: bytes) -> bytes:
    if not _server or _server[0].poll() is not None:
        _server[:] = [
            subprocess.Popen(
                [sys.executable, "-c", COMMAND],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            )
        ]
        atexit.register(_end, _server[0])
    server = _server[0]
    assert server.stdin is not None
    assert server.stdout is not None
    _send(server.stdin, question)
    return _receive(server.stdout)


def _end(server: subprocess.Popen[bytes]) -> None:
    with contextlib.suppress(OSError):
        assert server.stdin is not None
        server.stdin.close()
    server.wait()


def _send(pipe: IO[bytes], data: bytes) -> None:
    pipe.write(struct.pack("<Q", len(data)) + data)
    pipe.flush()


def _receive(pipe: IO[bytes]) -> bytes:
    head = pipe.read(8)
    if len(head) < 8:
        raise EOFError
    return pipe.read(struct.unpack("<Q", head)[0])


def serve() -> None:
    """Answer requests until the pipe is closed, each in a new child process."""
    pipe, back = sys.stdin.buffer, sys.stdout.buffer
    while True:
        try:
            question = _receive(pipe)
        except EOFError:
            return
        for name in pickle.loads(question)[0]:
            with contextlib.suppress(Exception):
                importlib.import_module(name)
        gc.freeze()  # otherwise garbage collection in a child would copy the memory shared with this process
        reading, writing = os.pipe()
        child = os.fork()
        if not child:
            os.close(reading)
            with open(writing, "wb") as out:
                out.write(pickle.dumps(_answer(question)))
            os._exit(0)
        os.close(writing)
        with open(reading, "rb") as from_child:
            answer = from_child.read()
        os.waitpid(child, 0)
        _send(back, answer or pickle.dumps(None))


def _answer(question: bytes) -> Answer | None:
    try:
        _, path, words = pickle.loads(question)
        sys.path[:] = path
        importlib.invalidate_caches()
        stage, grids, scales, coordinates, inputs = pickle.loads(words)
        bench = Bench(stage, grids, scales, coordinates)
        found: Answer = []
        for one in inputs:
            trial = bench.run(one)
            found.append(digests(trial.arrays) if trial.done else None)
        return found
    except BaseException:
        return None

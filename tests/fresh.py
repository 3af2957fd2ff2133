"""Processes without a trace of etendue, such as ``python -m etendue`` begins: forked from one that has loaded its
libraries alone.

What costs most in a process for one command is to load numpy, scipy and the like; here they are loaded once for all
tests of a worker. All of the package and of plugins is imported anew in each process, which ends as any other does.
Tests of what a process imports of libraries, of signals, and of what libraries read in the environment start processes
of their own.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

DRAWING = ("report", "plot", "compare")  # commands that load all of these, which others would pay for when they end
LIBRARIES = "pandas xarray zarr dask.array dask.threaded matplotlib.figure matplotlib.backends.backend_agg"
SERVER = """
import gc, importlib, os, pickle, runpy, shutil, sys, warnings

for name in '''
    numpy numpy.f2py scipy.fft scipy.interpolate scipy.optimize scipy.special scipy.spatial scipy.ndimage click
    pluggy cloudpickle rich.console rich.table rich.markup rich.progress numcodecs PIL.Image PIL.ImageDraw
    PIL.ImageFont PIL.PngImagePlugin PIL.JpegImagePlugin PIL.GifImagePlugin PIL.PpmImagePlugin PIL.BmpImagePlugin
    asyncio concurrent.futures csv email.parser importlib.metadata json multiprocessing sqlite3 tomllib zipfile
'''.split() + sys.argv[1:]:
    importlib.import_module(name)
assert not any(name.partition(".")[0] == "etendue" for name in sys.modules)
warnings.simplefilter("ignore")
gc.freeze()  # a child that looked through what it has from here would copy it
path, requests, answers = list(sys.path), os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
while True:
    try:
        asked = pickle.load(requests)
    except EOFError:
        shutil.rmtree(os.getcwd(), ignore_errors=True)
        os._exit(0)
    child = os.fork()
    if not child:
        break
    pickle.dump(child, answers), answers.flush()
    _, status = os.waitpid(child, 0)
    pickle.dump(os.waitstatus_to_exitcode(status), answers), answers.flush()

requests.close(), answers.close()
for number, name in ((0, os.devnull), (1, asked["stdout"]), (2, asked["stderr"])):
    opened = os.open(name, os.O_WRONLY if number else os.O_RDONLY)
    os.dup2(opened, number)
    os.close(opened)
os.environ.clear()
os.environ.update(asked["env"])
os.chdir(asked["cwd"])
own = [os.path.abspath(one) for one in os.environ.get("PYTHONPATH", "").split(os.pathsep) if one]
sys.path[:] = [asked["cwd"], *own, *(one for one in path if one)]
sys.path_importer_cache.clear()
warnings.resetwarnings()
for place in (os.path.join(one, "sitecustomize.py") for one in own):
    if os.path.isfile(place):
        runpy.run_path(place)
sys.argv = ["etendue", *asked["words"]]
if asked["code"] is None:
    runpy.run_module("etendue", run_name="__main__", alter_sys=True)
else:
    exec(compile(asked["code"], "<string>", "exec"), {"__name__": "__main__"})
"""


class _Server:
    """A process that forks, and ends with this one."""

    def __init__(self, libraries: list[str]) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="etendue-fresh-"))  # which it removes itself
        self.process = subprocess.Popen(
            [sys.executable, "-c", SERVER, *libraries], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=self.folder
        )

    def run(self, **asked: Any) -> tuple[int, str, str]:
        said = {name: self.folder / name for name in ("stdout", "stderr")}
        for path in said.values():
            path.write_bytes(b"")
        child = None
        try:
            pickle.dump({**asked, **{name: str(path) for name, path in said.items()}}, self.process.stdin)
            self.process.stdin.flush()
            child = pickle.load(self.process.stdout)
            code = pickle.load(self.process.stdout)
        except BaseException:  # a test that took too long: nothing is left of it
            if child is not None:
                os.kill(child, signal.SIGKILL)
            self.process.kill()
            _server.cache_clear()
            raise
        return code, *(path.read_text(encoding="utf-8") for path in said.values())


@cache
def _server(pid: int, draws: bool) -> _Server:
    return _Server(LIBRARIES.split() if draws else [])


def process(
    *words: Any, cwd: Path | str | None = None, env: dict[str, str] | None = None, code: str | None = None
) -> subprocess.CompletedProcess[str]:
    """What ``python -m etendue`` with these words says, or ``python -c`` with some code."""
    given = {
        "words": list(map(str, words)),
        "cwd": os.path.abspath(cwd or os.getcwd()),
        "env": dict(env or os.environ),
        "code": code,
    }
    if not hasattr(os, "fork"):
        asked = [sys.executable, *(("-m", "etendue") if code is None else ("-c", code)), *given["words"]]
        return subprocess.run(asked, cwd=cwd, env=env, capture_output=True, text=True, check=False)
    done, out, err = _server(os.getpid(), bool(words) and words[0] in DRAWING).run(**given)
    return subprocess.CompletedProcess(given["words"], done, out, err)

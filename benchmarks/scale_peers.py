"""The graph of ``scale.toml`` in other tools: pipefunc and ``dask.delayed``, and a plain loop, us a cell.

    python benchmarks/scale_peers.py [--cells 1000 10000] [--tools loop delayed pipefunc "pipefunc, files"]

Needs numpy, and of dask and pipefunc what is asked for (in an environment of their own: ``pip install pipefunc dask``);
etendue is not imported. Three steps by f-number, six by f-number and time, each a copy of 16 x 16 numbers with a
factor, so that what is measured is the tool. CPU time of the process; nothing is checked, keyed or kept but with
"files" (pipefunc's ``file_array``).
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np

BEHIND = ("exposure", "shot_noise", "full_well", "read_noise", "adc", "linearise")
FRONT = ("irradiance", "pixel", "mosaic")
LIGHT = np.ones((16, 16), np.float32)


def loop(f_numbers: np.ndarray, times: np.ndarray) -> None:
    kept = {}
    for f in f_numbers:
        light = LIGHT
        for name in FRONT:
            light = light * np.float32(1 / f)
            kept[name, f] = light
        for t in times:
            array = light
            for name in BEHIND:
                array = array * np.float32(t)
                kept[name, f, t] = array


def delayed(f_numbers: np.ndarray, times: np.ndarray) -> None:
    import dask

    scaled = dask.delayed(lambda array, factor: array * np.float32(factor), pure=False)
    made = []
    for f in f_numbers:
        light: Any = LIGHT
        for _ in FRONT:
            light = scaled(light, 1 / f)
        for t in times:
            array = light
            for _ in BEHIND:
                array = scaled(array, t)
                made.append(array)
    dask.compute(*made, scheduler="threads")


def pipeline() -> Any:
    from pipefunc import PipeFunc, Pipeline

    functions = []
    before, spec = "light", ""
    for name in FRONT:
        source = f"def {name}_of({before}, f): return {before} * np.float32(1 / f)"
        scope: dict[str, Any] = {"np": np}
        exec(source, scope)  # one function a step, whose arguments name what it reads
        reads = f"{before}[i], f[i]" if spec else "f[i]"
        functions.append(PipeFunc(scope[f"{name}_of"], name, mapspec=f"{reads} -> {name}[i]"))
        before, spec = name, "i"
    for name in BEHIND:
        scope = {"np": np}
        exec(f"def {name}_of({before}, t): return {before} * np.float32(t)", scope)
        reads = f"{before}[i], t[j]" if before == "mosaic" else f"{before}[i, j], t[j]"
        functions.append(PipeFunc(scope[f"{name}_of"], name, mapspec=f"{reads} -> {name}[i, j]"))
        before = name
    return Pipeline(functions)


def piped(storage: str) -> Callable[[np.ndarray, np.ndarray], None]:
    def run(f_numbers: np.ndarray, times: np.ndarray) -> None:
        inputs = {"light": LIGHT, "f": f_numbers, "t": times}
        with tempfile.TemporaryDirectory() as folder:
            where = {"run_folder": folder} if storage == "file_array" else {}
            pipeline().map(inputs, parallel=False, storage=storage, show_progress=False, **where)

    return run


TOOLS: dict[str, Callable[[np.ndarray, np.ndarray], None]] = {
    "loop": loop,
    "delayed": delayed,
    "pipefunc": piped("dict"),
    "pipefunc, files": piped("file_array"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, nargs="+", default=[1000, 10_000])
    parser.add_argument("--tools", nargs="+", default=list(TOOLS), choices=TOOLS)
    args = parser.parse_args()
    print(f"{'tool':16} {'cells':>8} {'us a cell':>10} {'peak MB':>8}")
    for tool in args.tools:
        TOOLS[tool](np.linspace(1.4, 22, 2), np.linspace(1e-3, 2e-2, 2))  # imports
        for cells in args.cells:
            times = np.linspace(1e-3, 2e-2, max(2, round((cells - 30) / 60)))
            began = time.process_time()
            TOOLS[tool](np.linspace(1.4, 22, 10), times)
            spent = time.process_time() - began
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
            print(
                f"{tool:16} {30 + 60 * len(times):8d} {1e6 * spent / (30 + 60 * len(times)):10.1f} {peak:8.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()

"""What is imported for a run: nothing that none of its stages needs. Each set of pipelines runs in a process of its
own.
"""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

PIPELINES = Path(__file__).parent.parent / "pipelines"
NEEDS_A_PLUGIN = {"real_lens": "etendue_lens_optiland"}
NOT_NEEDED = ("colour", "pandas", "matplotlib", "xarray", "distributed")

RUN = f"""
import sys, tempfile
from pathlib import Path
from etendue.plan.planner import make_plan
from etendue.contract.registry import installed_stages
from etendue.session import Options, execute, load

def first(axis):  # one value of each axis: every stage runs, and the sweep is short
    return axis[:1] if isinstance(axis, list) else [axis["from"]] if "from" in axis else axis["values"][:1]

for file in map(Path, sys.argv[1:]):
    pipeline = load(file)
    one = {{f"sweep.{{key}}": first(axis) for key, axis in pipeline.sweep.items()}}
    plan = make_plan(load(file, one), installed_stages())
    with tempfile.TemporaryDirectory() as folder:
        outcome = execute(plan, Path(folder) / "kept", Options("threads", 1))
        assert not outcome.failed and (Path(folder) / "kept" / "contact_sheet.png").is_file(), file
    print(file.stem, *(name for name in {NOT_NEEDED} if name in sys.modules))
"""


def imported(names):
    files = [str(PIPELINES / f"{name}.toml") for name in names]
    done = subprocess.run([sys.executable, "-c", RUN, *files], capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split("\n")[:-1]


@pytest.mark.long
def test_a_run_imports_neither_the_library_of_spectra_nor_tables_nor_plots():
    names = ("smallest", "sensors", "colour")
    assert imported(names) == list(names)


@pytest.mark.long
def test_no_shipped_pipeline_imports_them():
    names = [p.stem for p in sorted(PIPELINES.glob("*.toml"))]
    names = [n for n in names if n not in NEEDS_A_PLUGIN or importlib.util.find_spec(NEEDS_A_PLUGIN[n])]
    assert imported(names) == names

"""What is public can be sent to another process: by pickle, by cloudpickle from a script or notebook, on Dask's
workers.
"""

import copy
import pickle
import subprocess
import sys

import cloudpickle
import numpy as np
import pytest

import etendue
from etendue import stages as s

BEGINNING = """
import sys
import etendue
from etendue import stages as s

def camera(f_number):
    scene = s.uniform(white_luminance="100 cd m-2", width="8 um", height="8 um", bin_width="100 nm")
    return etendue.Pipeline(scene, s.irradiance(), s.falloff(), name="grey").camera(f_number=f_number)

def light(f_number):
    return float(etendue.simulate(camera(f_number), scheduler="serial")["falloff/irradiance"].mean())
"""
BY_PICKLE = (
    BEGINNING
    + """
import cloudpickle, pickle, subprocess
call = "import pickle, sys; print(repr(pickle.load(sys.stdin.buffer)(4)))"
there = subprocess.run([sys.executable, "-c", call], input=cloudpickle.dumps(light), capture_output=True, check=True)
assert float(there.stdout) == light(4) > 0, there
"""
)
ON_DASK = (
    BEGINNING
    + """
import dask, dask.bag
if __name__ == "__main__":
    numbers = (2, 4)
    expected = [light(n) for n in numbers]
    assert expected[0] > expected[1] > 0
    with dask.config.set(scheduler="processes", num_workers=2):
        assert dask.bag.from_sequence(numbers, npartitions=2).map(light).compute() == expected
        assert list(dask.compute(*(dask.delayed(light)(n) for n in numbers))) == expected
        (made,) = dask.compute(dask.delayed(camera)(2))
        assert made == camera(2)
"""
)
ON_A_CLUSTER = (
    BEGINNING
    + """
from distributed import Client, LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        assert client.gather(client.map(light, (2, 4))) == [light(2), light(4)]
        outcome = client.submit(lambda n: camera(n).run(progress=False), 4).result()
        assert float(outcome.tree["falloff/irradiance"].mean()) == light(4) and not outcome.failed
"""
)


def run_as_a_script(tmp_path, text):
    (tmp_path / "script.py").write_text(text)
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.fixture(scope="module")
def public(tmp_path_factory):
    scene = s.uniform(white_luminance="100 cd m-2", width="8 um", height="8 um", bin_width="100 nm")
    pipeline = etendue.Pipeline(scene, s.irradiance(), s.falloff(), name="grey").sweep(f_number=[2, 4])
    outcome = pipeline.run(tmp_path_factory.mktemp("sent") / "archive", progress=False)
    things = {
        "etendue": etendue,
        "stages": s,
        "a stage": s.falloff,
        "a placed stage": scene,
        "span": etendue.span(1, 2, 3),
        "pipeline": pipeline,
        "plan": pipeline.plan(),
        "read": pipeline.written(),
        "outcome": outcome,
        "outcome in memory": pipeline.run(progress=False),
        "archive": etendue.Archive(outcome.archive),
        "tree": outcome.tree,
        **{name: getattr(etendue, name) for name in etendue.__all__},
    }
    assert set(etendue.__all__) <= {*things}
    return things


@pytest.mark.parametrize("by", [pickle, cloudpickle], ids=lambda module: module.__name__)
def test_public_objects_go_to_another_process_and_come_back(public, by):
    for name, one in public.items():
        again = pickle.loads(by.dumps(one))
        assert type(again) is type(one), name
        if name not in ("archive", "tree") and "outcome" not in name:
            assert again == one or repr(again) == repr(one), name
    for name in ("outcome", "outcome in memory"):
        mine, theirs = (
            found.tree["falloff/irradiance"].values for found in (public[name], pickle.loads(by.dumps(public[name])))
        )
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("how", [copy.copy, copy.deepcopy])
def test_public_objects_can_be_copied(public, how):
    for name, one in public.items():
        assert type(how(one)) is type(one), name
    assert how(etendue) is etendue and how(s.falloff) is s.falloff and how(s) is s


def test_a_function_of_a_script_that_uses_the_package_runs_in_another_process(tmp_path):
    run_as_a_script(tmp_path, BY_PICKLE)


@pytest.mark.long
def test_dask_runs_functions_of_a_script_in_processes_of_its_own(tmp_path):
    run_as_a_script(tmp_path, ON_DASK)


@pytest.mark.long
def test_a_cluster_runs_functions_of_a_script(tmp_path):
    pytest.importorskip("distributed")
    run_as_a_script(tmp_path, ON_A_CLUSTER)

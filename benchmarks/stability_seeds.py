"""The statistical laws of ``etendue stability`` with other seeds: an honest stage is accused by none of them.

    python benchmarks/stability_seeds.py                # 50 seeds, every stage that draws
    python benchmarks/stability_seeds.py 200 shot_noise # as many seeds, these stages
    python benchmarks/stability_seeds.py 8+50           # 50 seeds from number 8 on

In:  seeds 1, 2, ...; every case of a stage on which the command tests a law that draws. The command itself takes 0.
Out: a line for each accusation, and how near each law came to one: the largest error over its bound; exit code 1 where
     there was an accusation.
"""

from __future__ import annotations

import sys
import time
from collections import Counter

from etendue.contract.capabilities import is_random
from etendue.contract.registry import installed_stages
from etendue.testing import StageConformance
from etendue.testing.bench import Bench
from etendue.testing.cases import ORDINARY, Case, cases
from etendue.testing.seeds import seeded
from etendue_lab.stability import stages

WORDS = (stages.DRAWS, "mean", "variance")
LAWS = {law: word for law, word in stages.LAWS.items() if word in WORDS}


def drawing(names: list[str]) -> list[tuple[str, Case]]:
    """Return every case of the stages that draw, but for those that are too large or refused."""
    registry = installed_stages()
    kinds = {name: registry.load(name) for name in names or registry.names()}
    every = [(name, case) for name, kind in kinds.items() if is_random(kind) for case in cases(kind)]
    return [(name, case) for name, case in every if computes(name, case)]


def computes(name: str, case: Case) -> bool:
    if case.stage is None or not stages.largest_allowed(case.stage):
        return False
    row = stages.computed(name, Bench(case.stage), case)
    return row.ok is True and not row.why


def main(words: list[str]) -> int:
    numbers = [word for word in words if word[0].isdigit()]
    first, _, count = (numbers or ["50"])[0].rpartition("+")
    seeds = range(int(first or 1), int(first or 1) + int(count))
    every = drawing([word for word in words if word not in numbers])
    print(f"{len(every)} cases of {len({name for name, _ in every})} stages that draw, {len(seeds)} seeds", flush=True)
    tests, accused, nearest = Counter[str](), 0, dict.fromkeys(WORDS, (0.0, ""))
    began = time.process_time()
    for seed in seeds:
        with seeded(seed):
            for name, case in every:
                one = type("Conformance", (StageConformance,), {"stage": case.stage})()
                for law, word in LAWS.items():
                    if case.where != ORDINARY and not stages.wanted(word, case):
                        continue
                    for row in stages.held(name, word, case, getattr(one, law), always=True):
                        tests[word] += 1
                        nearest[word] = max(nearest[word], (row.nearness, f"{name}, {case.name}, seed {seed}"))
                        if row.ok is False:
                            accused += 1
                            print(f"ACCUSED, seed {seed}: {name}, {word}, {case.name}: {row.why}", flush=True)
    for word, (near, where) in nearest.items():
        print(f"{word}: {tests[word]} calls; nearest to its bound {near:.3g} of it ({where})")
    print(f"{sum(tests.values())} calls, {accused} accusations, {time.process_time() - began:.0f} CPU s")
    return int(accused > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Record the references to which ``etendue stability`` holds the built-in stages.

    python benchmarks/stage_references.py            # what differs from the stored ones
    python benchmarks/stage_references.py --write    # store what the stages give now

In:  every stage of this distribution, at every case of its declaration.
Out: src/etendue_lab/data/stage_references.json. Record only after laws, closed forms and tests have held, and say in
     the commit which stages changed, and why.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from etendue.contract.registry import installed_stages
from etendue.testing.cases import cases
from etendue_lab.stability import references
from etendue_lab.stability.stages import largest_allowed

FILE = Path(__file__).parents[1] / "src" / "etendue_lab" / "data" / references.FILE
OWN = ("etendue_camera", "etendue_lab", "etendue")


def recorded() -> dict[str, dict[str, references.Numbers]]:
    found: dict[str, dict[str, references.Numbers]] = {}
    registry = installed_stages()
    for name in registry.names():
        kind = registry.load(name)
        if kind.__module__.partition(".")[0] not in OWN:
            continue
        for case in cases(kind):
            if case.stage is None or not largest_allowed(case.stage):
                continue
            if numbers := references.numbers_of(case):
                found.setdefault(name, {})[case.name] = numbers
    return found


def text_of(found: dict[str, dict[str, references.Numbers]], bounds: dict[str, float]) -> str:
    """One line for each case, so that a change shows which."""
    stages = []
    for name, several in found.items():
        lines = ",\n".join(f"   {json.dumps(case)}: {json.dumps(numbers)}" for case, numbers in several.items())
        stages.append(f"  {json.dumps(name)}: {{\n{lines}\n  }}")
    return f'{{\n "bounds": {json.dumps(bounds)},\n "stages": {{\n' + ",\n".join(stages) + "\n }\n}\n"


def main(words: list[str]) -> int:
    found = recorded()
    written = json.loads(FILE.read_text(encoding="utf-8"))
    before, bounds = written["stages"], written["bounds"]
    changed = sorted(
        f"{name}, {case}"
        for name in {**found, **before}
        for case in {**found.get(name, {}), **before.get(name, {})}
        if any(
            references.apart(
                found.get(name, {}).get(case, {}).get(what), before.get(name, {}).get(case, {}).get(what), what
            )
            > bounds.get(name, references.BOUND)
            for what in {**found.get(name, {}).get(case, {}), **before.get(name, {}).get(case, {})}
        )
    )
    print("\n".join(changed[:40]))
    print(f"{sum(map(len, found.values()))} cases of {len(found)} stages; {len(changed)} differ from the stored ones")
    if "--write" in words:
        FILE.write_text(text_of(found, bounds), encoding="utf-8")
    return int(bool(changed) and "--write" not in words)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Describe an archive to other programs: a Provenance Run Crate (RO-Crate 1.1) and, if authors are named,
``CITATION.cff``.

In:  a plan, the records of all runs, the copies in ``inputs/``.
Out: ``ro-crate-metadata.json``: the pipeline of every run as a workflow, and every run as an action with its inputs and
     results; for the last run also every stage with its distribution, version and code digest, its inputs, and the
     place of its results.

No user, host or path of the machine is recorded; only persons named in the pipeline file are listed.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from etendue.archive.records import disk
from etendue.archive.records.indented import indented
from etendue.archive.records.manifest import DATA, Manifest
from etendue.archive.records.rerun import Recorded, every_record
from etendue.pipeline.about import About
from etendue.plan.identity.keys import version_of
from etendue.plan.model import Node, Plan
from etendue.types.documents import Document, DocumentView

NAME, CITATION = "ro-crate-metadata.json", "CITATION.cff"
PROFILES = (
    ("https://w3id.org/ro/wfrun/process/0.5", "Process Run Crate", "0.5"),
    ("https://w3id.org/ro/wfrun/workflow/0.5", "Workflow Run Crate", "0.5"),
    ("https://w3id.org/ro/wfrun/provenance/0.5", "Provenance Run Crate", "0.5"),
    ("https://w3id.org/workflowhub/workflow-ro-crate/1.0", "Workflow RO-Crate", "1.0"),
)
ENGINE, LANGUAGE, UNSTATED = "#etendue", "#pipeline-file", "#license-not-stated"
Entity = Document


def write_crate(folder: Path, plan: Plan, known: Manifest | None, fresh: bool, durable: bool = False) -> None:
    """Write both files if their content has changed; ``fresh``: the newest run has just ended."""
    files = {NAME: indented(crate_of(folder, plan, fresh), 1)}
    about = plan.pipeline.about
    if about.authors:
        files[CITATION] = _citation(about, plan, _date(list(every_record(folder)))).encode()
    elif known is not None and CITATION in known.files:
        disk.remove(folder, CITATION)
    disk.put(folder, files.items(), durable)


def crate_of(folder: Path, plan: Plan, fresh: bool = False) -> Entity:
    """Return the expected content of an archive's crate; the times at which earlier runs ended are taken from the
    existing crate. ``fresh``: the newest run has just ended, so the present time is taken as its end.
    """
    runs, ended = list(every_record(folder)), _ended(folder)
    if fresh and runs:
        ended[_action(runs[0])] = time.strftime("%Y-%m-%dT%H:%M:%S+00:00", time.gmtime())
    return {
        "@context": ["https://w3id.org/ro/crate/1.1/context", "https://w3id.org/ro/terms/workflow-run/context"],
        "@graph": list(_graph(folder, plan, runs, ended)),
    }


def _date(runs: list[Recorded]) -> str:
    return str(runs[0].record["began"])[:10] if runs else time.strftime("%Y-%m-%d", time.gmtime())


def _ended(folder: Path) -> dict[str, str]:
    """Return the end times of earlier runs from the existing crate."""
    found = (disk.read_document(folder / NAME) or {}).get("@graph")
    entities = [one for one in found if isinstance(one, dict)] if isinstance(found, list) else []
    return {
        str(one.get("@id")): str(one["endTime"])
        for one in entities
        if one.get("@type") == "CreateAction" and "endTime" in one
    }


def _action(run: Recorded) -> str:
    return f"#run-{run.path.stem}"


def _workflow(run: Recorded) -> str:
    return f"runs/{run.path.stem}.toml"


def _ids(names: Iterable[str]) -> Document | list[Document]:
    """Return references; a single reference is not put into a list, as RO-Crate recommends."""
    found = [{"@id": name} for name in names]
    return found[0] if len(found) == 1 else found


def _graph(folder: Path, plan: Plan, runs: list[Recorded], ended: Mapping[str, str]) -> Iterator[Entity]:
    about, pipeline = plan.pipeline.about, plan.pipeline
    inputs = list(_inputs(folder))
    stages = [node for node in plan.nodes if any((node.name, v) in plan.kept for v in node.writes)]
    workflows = [_workflow(run) for run in runs]
    beside = list(_beside(folder, about))
    yield {
        "@id": NAME,
        "@type": "CreativeWork",
        "about": {"@id": "./"},
        "conformsTo": _ids(["https://w3id.org/ro/crate/1.1", "https://w3id.org/workflowhub/workflow-ro-crate/1.0"]),
    }
    records = [f"runs/{run.path.name}" for run in runs]
    yield {
        "@id": "./",
        "@type": "Dataset",
        "conformsTo": _ids(uri for uri, _, _ in PROFILES),
        "name": about.title or pipeline.name,
        "description": pipeline.description
        or f"Simulation '{pipeline.name}': every variable of every stage, with its provenance",
        "datePublished": _date(runs),
        "license": {"@id": _license(about)},
        **({"author": _ids(_persons(about))} if about.authors else {}),
        **({"mainEntity": {"@id": workflows[0]}} if workflows else {}),
        "hasPart": _ids([*workflows, *records, f"{DATA}/", *(e["@id"] for e in inputs), *(e["@id"] for e in beside)]),
        "mentions": _ids([*(_action(run) for run in runs), *(f"#made-{node.name}" for node in stages)]),
    }
    yield from (
        {"@id": uri, "@type": "CreativeWork", "name": name, "version": version} for uri, name, version in PROFILES
    )
    yield from _people(about)
    yield {
        "@id": ENGINE,
        "@type": "SoftwareApplication",
        "name": "etendue",
        "version": version_of("etendue"),
        "description": "a graph of stages on labelled arrays, planned, swept and archived",
    }
    yield {
        "@id": LANGUAGE,
        "@type": "ComputerLanguage",
        "name": "etendue pipeline file",
        "description": "TOML: shared, stages, sweep",
        "url": {"@id": "https://toml.io/"},
        "identifier": {"@id": "https://toml.io/"},
    }
    yield {"@id": "https://toml.io/", "@type": "WebSite", "name": "TOML"}
    for number, run in enumerate(runs):
        yield from _run(run, inputs, plan, stages if number == 0 else [], ended, about)
    yield {
        "@id": f"{DATA}/",
        "@type": "Dataset",
        "name": "all variables of all stages",
        "description": "one Zarr v3 store; open it with xarray.open_datatree",
        "encodingFormat": "application/vnd+zarr",
        "hasPart": _ids(f"{DATA}/{node.name}/" for node in stages),
    }
    yield from (_result(node, plan) for node in stages)
    yield from inputs
    yield from beside


def _run(
    run: Recorded, inputs: list[Entity], plan: Plan, stages: list[Node], ended: Mapping[str, str], about: About
) -> Iterator[Entity]:
    """Yield a run: its pipeline as a workflow, its record, and the run as an action; for the last run also every stage
    as a tool, a step and an action.
    """
    name, own = _workflow(run), {f"inputs/{one}{end}" for one in run.inputs for end in ("", "/", ".json")}
    used = [e["@id"] for e in inputs if e["@id"] in own]
    steps = {
        "hasPart": _ids(f"#stage-{node.name}" for node in stages),
        "step": _ids(f"#step-{node.name}" for node in stages),
    }
    yield {
        "@id": name,
        "@type": ["File", "SoftwareSourceCode", *(["ComputationalWorkflow", "HowTo"] if stages else [])],
        "name": f"pipeline {run.record['pipeline']}, as it was run",
        "encodingFormat": "application/toml",
        "programmingLanguage": {"@id": LANGUAGE},
        "contentSize": str(len(run.text.encode())),
        **(steps if stages else {}),
        "license": {"@id": _license(about)},
    }
    yield {
        "@id": f"runs/{run.path.name}",
        "@type": "File",
        "name": f"record of run {run.path.stem}",
        "encodingFormat": "application/json",
        "description": "parameters, digests of code, versions, platform",
        "about": {"@id": _action(run)},
    }
    yield {
        "@id": _action(run),
        "@type": "CreateAction",
        "name": f"run {run.path.stem} of {run.record['pipeline']}",
        "description": "etendue run: its instrument is the request, its record the details",
        "instrument": {"@id": name},
        "object": _ids(used),
        "result": {"@id": f"{DATA}/"},
        "startTime": str(run.record["began"]).replace("Z", "+00:00"),  # as the profile requires
        **(
            {"endTime": ended[_action(run)], "actionStatus": "http://schema.org/CompletedActionStatus"}
            if _action(run) in ended
            else {}
        ),
        **({"agent": _ids(_persons(about))} if about.authors else {}),
    }
    if not stages:
        return
    yield {
        "@id": "#engine-run",
        "@type": "OrganizeAction",
        "name": f"etendue computed run {run.path.stem}",
        "instrument": {"@id": ENGINE},
        "object": _ids(f"#control-{node.name}" for node in stages),
        "result": {"@id": _action(run)},
        **({"agent": _ids(_persons(about))} if about.authors else {}),
    }
    for node in stages:
        yield from _stage(node, stages, used, run.record["nodes"].get(node.name, {}), about)


def _stage(node: Node, stages: list[Node], used: list[str], record: DocumentView, about: About) -> Iterator[Entity]:
    one = node.alternatives[0]
    names = " or ".join(dict.fromkeys(a.use for a in node.alternatives))
    kept = {own.name for own in stages}
    sources = [f"{DATA}/{source}/" for source in record.get("inputs", ()) if source in kept]
    yield {
        "@id": f"#stage-{node.name}",
        "@type": "SoftwareApplication",
        "name": names,
        "softwareVersion": f"{one.distribution} {one.version}",
        "description": _words(one.kind) or names,
        "identifier": f"blake2b:{one.digest}",
    }
    yield {
        "@id": f"#step-{node.name}",
        "@type": "HowToStep",
        "position": str(node.number),
        "workExample": {"@id": f"#stage-{node.name}"},
    }
    yield {
        "@id": f"#made-{node.name}",
        "@type": "CreateAction",
        "name": f"cells of {node.name}",
        "description": f"every cell of {node.name} that the archive holds",
        "instrument": {"@id": f"#stage-{node.name}"},
        "object": _ids(sources or used),
        "result": {"@id": f"{DATA}/{node.name}/"},
        **({"agent": _ids(_persons(about))} if about.authors else {}),
    }
    yield {
        "@id": f"#control-{node.name}",
        "@type": "ControlAction",
        "name": f"orchestrate {node.name}",
        "instrument": {"@id": f"#step-{node.name}"},
        "object": {"@id": f"#made-{node.name}"},
    }


def _words(kind: type) -> str:
    """Return the first paragraph of the docstring of a stage."""
    return " ".join((kind.__doc__ or "").strip().split("\n\n")[0].split())


def _result(node: Node, plan: Plan) -> Entity:
    kept = [f"{v} [{node.writes[v].unit}]" for v in node.writes if (node.name, v) in plan.kept]
    return {
        "@id": f"{DATA}/{node.name}/",
        "@type": "Dataset",
        "name": f"results of {node.name}",
        "description": ", ".join(kept),
    }


def _inputs(folder: Path) -> Iterator[Entity]:
    """Yield every copy of a file that a pipeline names; for a file too large to copy, its description."""
    place = folder / "inputs"
    for path in sorted(place.iterdir()) if place.is_dir() else ():
        if path.name.startswith("."):
            continue
        if path.is_dir():
            yield {"@id": f"inputs/{path.name}/", "@type": "Dataset", "name": "a scene", "sha256": path.name[:64]}
        elif path.suffix == ".json" and not re.fullmatch("[0-9a-f]{64}", path.stem):
            said = {"name": "description of a large input", "encodingFormat": "application/json"}
            yield {"@id": f"inputs/{path.name}", "@type": "File", **said}
        else:
            size = str(path.stat().st_size)
            yield {
                "@id": f"inputs/{path.name}",
                "@type": "File",
                "name": "an input",
                "contentSize": size,
                "sha256": path.name[:64],
            }


def _beside(folder: Path, about: About) -> Iterator[Entity]:
    yield {
        "@id": "journal.jsonl",
        "@type": "File",
        "encodingFormat": "application/jsonl",
        "name": "the finished cells, with digests",
    }
    yield {
        "@id": "manifest.json",
        "@type": "File",
        "encodingFormat": "application/json",
        "name": "digests of the metadata",
    }
    if (folder / "contact_sheet.png").is_file():
        yield {
            "@id": "contact_sheet.png",
            "@type": "File",
            "encodingFormat": "image/png",
            "name": "a picture of every stage",
        }
    if about.authors:
        yield {
            "@id": CITATION,
            "@type": "File",
            "encodingFormat": "application/yaml",
            "name": "citation of the archive",
        }


def _license(about: About) -> str:
    if not about.license:
        return UNSTATED
    return about.license if about.license.startswith("http") else f"https://spdx.org/licenses/{about.license}"


def _persons(about: About) -> list[str]:
    return [
        f"https://orcid.org/{one.orcid}" if one.orcid else f"#author-{number}"
        for number, one in enumerate(about.authors, 1)
    ]


def _people(about: About) -> Iterator[Entity]:
    """Yield the licence and the persons."""
    said = about.license or "not stated"
    why = "whose terms apply" if about.license else "reuse is not licensed; set [about] license in the pipeline file"
    yield {"@id": _license(about), "@type": "CreativeWork", "name": said, "description": f"licence: {said}, {why}"}
    places = list(dict.fromkeys(one.affiliation for one in about.authors if one.affiliation))
    for name, one in zip(_persons(about), about.authors, strict=True):
        where = {"affiliation": {"@id": f"#affiliation-{places.index(one.affiliation) + 1}"}} if one.affiliation else {}
        yield {"@id": name, "@type": "Person", "name": one.name, **where}
    yield from (
        {"@id": f"#affiliation-{n}", "@type": "Organization", "name": place} for n, place in enumerate(places, 1)
    )


def _citation(about: About, plan: Plan, date: str) -> str:
    """Return a Citation File Format 1.2.0 document. Texts are written as JSON strings, which are valid YAML."""
    lines = [
        "cff-version: 1.2.0",
        'message: "If you use these results, please cite them as below."',
        "type: dataset",
        f"title: {json.dumps(about.title or plan.pipeline.name)}",
        "authors:",
    ]
    for one in about.authors:
        family, comma, given = (part.strip() for part in one.name.partition(","))
        own = {"family-names": family, "given-names": given} if comma and given else {"name": one.name}
        own |= {"orcid": f"https://orcid.org/{one.orcid}"} if one.orcid else {}
        own |= {"affiliation": one.affiliation} if one.affiliation and "name" not in own else {}
        lines += [f"  {'-' if not n else ' '} {key}: {json.dumps(value)}" for n, (key, value) in enumerate(own.items())]
    if about.license:
        lines.append(f"{'license-url' if about.license.startswith('http') else 'license'}: {json.dumps(about.license)}")
    return "\n".join([*lines, f'date-released: "{date}"', ""])

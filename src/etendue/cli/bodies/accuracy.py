"""``accuracy``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from etendue.accuracy.study import accuracy as measure
from etendue.cli import options
from etendue.cli.saying import say, show
from etendue.present.terminal.accuracy import document, files_of, print_accuracy
from etendue.present.terminal.progress import trying
from etendue.result_files import check_folder, finite, write_whole


def accuracy(
    given: options.Given,
    as_json: bool,
    knobs: tuple[str, ...],
    verify: tuple[str, ...],
    output: Path | None,
    by: str,
    **effort: int,
) -> None:
    pipeline = given.pipeline()
    elsewhere = replace(given, settings=(*given.settings, *verify)).pipeline() if verify else None
    asked = options.knob_settings(knobs)
    folder = output or Path(f"{pipeline.name}-accuracy")
    check_folder(folder)
    with trying(silent=as_json) as told:
        there = dict(word.split("=", 1) for word in verify)
        found = measure(
            pipeline, options.installed(), asked, **effort, told=told, elsewhere=elsewhere, verify=there, by=by
        )
    made = finite(document(found))
    files = write_whole(folder, files_of(made))
    if as_json:
        say({**made, "files": [str(path) for path in files]})
    else:
        show(print_accuracy, made, files)

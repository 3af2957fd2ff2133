"""The command line. Bodies import what they need when they run, so that ``--help`` costs nothing."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import click

from etendue import interrupts, streams

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}


class _Command(click.Command):
    """A command whose stdout is its results alone: what plugins print while it runs goes to stderr."""

    def invoke(self, ctx: click.Context) -> Any:
        with streams.plugins_on_stderr():
            return super().invoke(ctx)


class _Main(click.Group):
    """Turns errors raised on purpose into one clear message and the right exit code."""

    command_class = _Command

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        ctx.obj = "--json" in args
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        from etendue.errors import EtendueError, RequestError, machine_text
        from etendue.telling import plain, printable, said, where

        as_json = bool(ctx.obj)
        try:
            return super().invoke(ctx)
        except RequestError as error:
            if as_json:
                faults = [{"file": error.file, "line": f.line, "place": f.place, "message": f.message} for f in error.faults]
                _say({"faults": faults})
            else:
                click.echo(printable(str(error)), err=True)
            ctx.exit(2)
        except EtendueError as error:
            if as_json and error.exit_code == 2:
                _say({"faults": [{"file": "", "line": None, "place": "", "message": str(error)}]})
            else:
                click.echo(printable(str(error)), err=True)
            ctx.exit(error.exit_code)
        except BrokenPipeError:  # whoever read the output has gone
            os._exit(141)
        except OSError as error:
            click.echo(printable(machine_text(error)), err=True)
            ctx.exit(5)
        except MemoryError as error:
            click.echo(f"the machine is short of memory ({plain(str(error)) or 'nothing more is known'}); the archive is intact", err=True)
            ctx.exit(5)
        except KeyboardInterrupt as error:
            click.echo(interrupts.INTACT, err=True)
            ctx.exit(getattr(error, "exit_code", 130))
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except Exception as error:
            if os.environ.get("ETENDUE_TRACEBACK"):
                raise
            click.echo(
                f"etendue itself broke off: {where(error)}{said(error)}; please report it, with what ETENDUE_TRACEBACK=1 shows", err=True
            )
            ctx.exit(1)


@click.group(cls=_Main, context_settings=CONTEXT)
@click.version_option(package_name="etendue")
def main() -> None:
    """A digital camera, from scene light to display colour, as a graph of replaceable stages.

    \b
    etendue run pipelines/smallest.toml     run it, archive it, show it
    etendue plan pipelines/sweep.toml       what would run, before it does
    etendue stages                          what is installed
    etendue quantities                      what stages share: f_number, pixel_pitch, ...
    etendue show smallest                   what is in an archive
    etendue export smallest --dng           raw files that other converters open
    etendue compare FILE --axis demosaic.use   alternatives ranked, quality against run time
    etendue quality FILE                    every camera of a sweep against the ideal one
    etendue noise FILE                      noise behind every stage, predicted and found
    etendue sensors                         sensors whose parameters are published
    """


def _number(text: str) -> Any:
    """A value of the command line: number, true/false, list, or text (units allowed)."""
    from decimal import Decimal, InvalidOperation

    stripped = text.strip()
    if stripped in ("true", "false"):
        return stripped == "true"
    if stripped.startswith("[") or stripped.startswith("{"):
        import tomllib

        try:
            return tomllib.loads(f"v = {stripped}", parse_float=Decimal)["v"]
        except (ValueError, RecursionError):
            return stripped
    try:
        value = Decimal(stripped)
    except InvalidOperation:
        return stripped
    whole = stripped.lstrip("+-").isdigit()
    return int(value) if whole else value


def _overrides(settings: tuple[str, ...], sweeps: tuple[str, ...], want: tuple[str, ...], tolerance: str | None) -> dict[str, Any]:
    from etendue.errors import Fault, RequestError

    found: dict[str, Any] = {}
    faults = []
    for option, texts in (("--set", settings), ("--sweep", sweeps)):
        for text in texts:
            key, equals, value = text.partition("=")
            if not equals or not key.strip():
                faults.append(Fault(f"{option} {text}", "expected name=value"))
                continue
            if option == "--set":
                found[key.strip()] = _number(value)
            else:
                written = value.strip().startswith(("[", "{"))  # as it would stand in the file
                found[f"sweep.{key.strip()}"] = _number(value) if written else [_number(v) for v in value.split(",")]
    if faults:
        raise RequestError(faults)
    if want:
        found["wanted"] = [v for text in want for v in text.split(",")]
    if tolerance is not None:
        found["tolerance"] = _number(tolerance)
    return found


def _pipeline_options(function: Any) -> Any:
    repeat = "; may be repeated."
    for option in reversed(
        (
            click.argument("file", type=click.Path(path_type=Path)),
            click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="camera.f_number=4, sharpen.strength=0.3" + repeat),
            click.option("--sweep", "sweeps", multiple=True, metavar="AXIS=V,V,..", help="f_number=1.4,2,2.8 or demosaic.use=a,b" + repeat),
            click.option("--want", multiple=True, metavar="VARIABLE", help="Compute this, or stage.variable, and nothing else" + repeat),
            click.option("--tolerance", metavar="T", help="What may be left out or approximated, of full scale."),
            click.option("--nothing-left-out", is_flag=True, help="Compute also what the scene does not need."),
            click.option("--json", "as_json", is_flag=True, help="JSON on stdout."),
        )
    ):
        function = option(function)
    return function


def _say(document: Any) -> None:
    """JSON on stdout. What is not known is null, what has no end is the text "inf": JSON has neither NaN nor infinity."""
    from etendue.studies.files import finite

    with streams.results():
        click.echo(json.dumps(_printable(finite(document)), allow_nan=False))


def _show(draw: Any, *what: Any) -> None:
    """Something for people on stdout."""
    with streams.results():
        draw(*what)


def _printable(value: Any) -> Any:
    """A document without control characters: who shows a text of it may be a terminal."""
    from etendue.telling import printable

    if isinstance(value, str):
        return printable(value)
    if isinstance(value, dict):
        return {_printable(key): _printable(own) for key, own in value.items()}
    return [_printable(own) for own in value] if isinstance(value, list | tuple) else value


def _plan(file: Path, settings: Any, sweeps: Any, want: Any, tolerance: Any, nothing_left_out: bool, quiet: bool = False) -> Any:
    from dataclasses import replace

    from etendue.plan.planner import make_plan
    from etendue.registry import installed_stages
    from etendue.spec.pipeline import read_pipeline

    pipeline = read_pipeline(file, _overrides(settings, sweeps, want, tolerance))
    if want and pipeline.keep is not None and pipeline.wanted is not None:  # what is asked for now is kept, whatever the file keeps
        pipeline = replace(pipeline, keep=(*pipeline.keep, *pipeline.wanted))
    if quiet or not sys.stderr.isatty():
        return make_plan(pipeline, installed_stages(), not nothing_left_out)
    from etendue.report.terminal import planning

    with planning() as told:
        return make_plan(pipeline, installed_stages(), not nothing_left_out, told)


@main.command()
@_pipeline_options
def plan(file: Path, settings: Any, sweeps: Any, want: Any, tolerance: Any, nothing_left_out: bool, as_json: bool) -> None:
    """What would run: stages, cells, bytes, time, what is left out and why."""
    from etendue.plan.planner import summary

    made = _plan(file, settings, sweeps, want, tolerance, nothing_left_out, as_json)
    document = summary(made)
    if as_json:
        _say(document)
        return
    from etendue.report.terminal import print_plan

    _show(print_plan, document)


@main.command()
@_pipeline_options
@click.option("--archive", type=click.Path(path_type=Path), metavar="DIR", help="Where results are kept; default ./<name of the pipeline>.")
@click.option("--scheduler", default="threads", show_default=True, metavar="S", help="serial, threads, processes or tcp://host:port.")
@click.option("--workers", type=click.IntRange(1), metavar="N", help="Threads or processes; default one per core.")
@click.option("--durable", is_flag=True, help="Survive a power cut: fsync every chunk and journal line.")
@click.option("--recompute", is_flag=True, help="Compute again what is already finished.")
@click.option("--accept-platform", is_flag=True, help="Go on with cells computed on another platform.")
@click.option(
    "--cell-timeout",
    type=click.FloatRange(0, min_open=True),
    metavar="SECONDS",
    help="A cell that takes longer is stopped and counts as failed. With processes or tcp:// only: a thread cannot be stopped.",
)
@click.option("--prune", is_flag=True, help="Remove finished results of an archive that this run does not keep.")
@click.option("--quiet", is_flag=True, help="No progress.")
def run(
    file: Path, settings: Any, sweeps: Any, want: Any, tolerance: Any, nothing_left_out: bool, as_json: bool, archive: Path | None,
    scheduler: str, workers: int | None, durable: bool, recompute: bool, accept_platform: bool, prune: bool,
    cell_timeout: float | None, quiet: bool,
) -> None:  # fmt: skip
    """Run a pipeline: compute what is not there yet, keep it, show it.

    On an archive that exists this resumes. A cell whose stage breaks off, kills its worker process or takes longer than
    --cell-timeout is recorded as failed, the rest goes on. Exit codes: 0 done, 2 the request is wrong, 3 some cells failed,
    4 the archive is in use, 5 the machine is short or the cluster is gone, 130 or 143 interrupted (the archive is intact).
    """
    interrupts.say(interrupts.INTACT)
    here = Path.cwd()  # a plugin may change it
    made = _plan(file, settings, sweeps, want, tolerance, nothing_left_out, quiet or as_json)
    from etendue.report.terminal import TerminalProgress, outcome_document, print_outcome
    from etendue.session import Options, check_scheduler, check_timeout, execute

    options = Options(check_scheduler(scheduler), workers or 0, durable, recompute, accept_platform, prune=prune, cell_timeout=cell_timeout)
    check_timeout(options)
    folder = here / (archive or made.pipeline.name)
    if not as_json:
        from etendue.telling import printable

        for text in made.warnings:
            click.echo(f"note: {printable(text)}", err=True)
    outcome = execute(made, folder, options, None if quiet else TerminalProgress(made))
    if as_json:
        _say(outcome_document(outcome))
    else:
        _show(print_outcome, outcome)
    sys.exit(3 if outcome.failed else 0)


@main.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--axis", required=True, metavar="AXIS[=V,V,..]", help="demosaic.use, demosaic.use=a,b or sharpen.strength=0,0.1,0.2.")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="camera.f_number=4, sharpen.strength=0.3; may be repeated.")
@click.option(
    "--repeat", default=5, show_default=True, type=click.IntRange(1), metavar="N", help="Time each alternative so often; the best counts."
)
@click.option("--noise-free", is_flag=True, help="Expected values: no noise, no rounding.")
@click.option("--no-mtf50", is_flag=True, help="Leave the run in front of an edge out.")
@click.option("--scheduler", default="threads", show_default=True, metavar="S", help="serial, threads, processes or tcp://host:port.")
@click.option("--workers", type=click.IntRange(1), metavar="N", help="Threads or processes; default one per core.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), metavar="FOLDER", help="Table, plot and crops; default ./<name>-compare-<axis>."
)
@click.option("--json", "as_json", is_flag=True, help="JSON on stdout.")
def compare(
    file: Path, axis: str, settings: Any, repeat: int, noise_free: bool, no_mtf50: bool, scheduler: str, workers: int | None,
    output: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Rank alternatives: quality against run time, plugins included.

    --axis demosaic.use takes every installed stage that writes what the stage `demosaic` of the file writes and reads no more
    than it does, and does not say that it has another role; demosaic.use=a,b takes these, and '{ use = "mine",
    iterations = 5 }' one with its parameters. Any stage and any parameter may be the axis. Light, mosaic and noise are computed
    once, the same for all that stand behind them.

    The reference is what the same pixels would give without noise and mosaic, at every pixel, through the same later stages. PSNR
    is measured on linear values where the axis has its effect: at the stage's own picture, or at rgb_camera for what stands before
    it; "encoded", CIEDE2000, zipper and false colour on the finished picture. A stage that reads and writes rgb_camera alone
    (sharpening, denoising) is left out of the reference: it is held against the picture that did not need it. Any other axis in
    front of the pixels or behind the demosaicer (f_number, display.display) reaches the reference too: then each value has one of
    its own, and the rank goes by PSNR of the encoded picture. A border of 10 pixels is not counted. MTF50 comes from a second,
    noise-free run of the same camera in front of a slanted edge. Time is that of the stage alone on one thread.

    Exit codes: 0 done, 2 the request is wrong, 3 an alternative broke off, or one that was named is refused, or all but one are.
    """
    from etendue.report.terminal import TerminalProgress
    from etendue.session import Options, check_scheduler
    from etendue.spec.pipeline import read_pipeline
    from etendue.studies.axis import parse_axis
    from etendue.studies.compare import compare as measure
    from etendue.studies.files import check_folder
    from etendue.studies.ranking import document, print_comparison, write_files

    pipeline = read_pipeline(file, _overrides(settings, (), (), None))
    options = Options(check_scheduler(scheduler), workers or 0)
    progress = None if as_json else TerminalProgress
    asked = parse_axis(axis, _number)
    folder = output or Path(f"{pipeline.name}-compare-{asked.key.removesuffix('.use').replace('.', '_')}")
    found = measure(
        pipeline, asked, repeat, noise_free, options, progress, not no_mtf50, lambda: check_folder(folder)
    )  # fmt: skip
    files = write_files(found, folder)
    if as_json:
        _say({**document(found), "files": [str(path) for path in files]})
    else:
        _show(print_comparison, found, files)
    sys.exit(3 if found.failed or found.lacking else 0)


@main.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="camera.f_number=4, sharpen.strength=0.3; may be repeated.")
@click.option("--sweep", "sweeps", multiple=True, metavar="AXIS=V,V,..", help="f_number=1.4,2,2.8 or demosaic.use=a,b; may be repeated.")
@click.option("--tolerance", metavar="T", help="What may be left out or approximated, of full scale.")
@click.option("--nothing-left-out", is_flag=True, help="Compute also what the scene does not need.")
@click.option("--samples-per-degree", default=34.0, show_default=True, metavar="S", help="Pixels in a degree of view: 100 dpi at 50 cm.")
@click.option("--without", multiple=True, metavar="STAGE", help="Leave this too out of the ideal camera: diffusion; may be repeated.")
@click.option("--keep", multiple=True, metavar="STAGE", help="Keep this in the ideal camera, such as distortion; may be repeated.")
@click.option(
    "--pictures",
    default=12,
    show_default=True,
    type=click.IntRange(0),
    metavar="N",
    help="Pictures with -o at most, spread over the sweep.",
)
@click.option("--scheduler", default="threads", show_default=True, metavar="S", help="serial, threads, processes or tcp://host:port.")
@click.option("--workers", type=click.IntRange(1), metavar="N", help="Threads or processes; default one per core.")
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FOLDER", help="Table as CSV and JSON, pictures side by side.")
@click.option("--json", "as_json", is_flag=True, help="JSON on stdout.")
def quality(
    file: Path, settings: Any, sweeps: Any, tolerance: Any, nothing_left_out: bool, as_json: bool, samples_per_degree: float,
    without: tuple[str, ...], keep: tuple[str, ...], pictures: int, scheduler: str, workers: int | None, output: Path | None,
) -> None:  # fmt: skip
    """How far a camera is from the ideal one: the same pipeline with a perfect lens, without noise and mosaic.

    For every cell of the sweep: PSNR of camera primaries and of the encoded picture, SSIM of its luma, CIEDE2000 and S-CIELAB of
    the displayed light, SNR, visible noise in a uniform region, dynamic range. Blur, aberrations, distortion and glare are left
    out of the ideal camera, and so is sharpening; its pixels, its light and its colours are those of the camera.

    Exit codes: 0 done, 2 the request is wrong, 3 some cells failed.
    """
    from etendue.registry import installed_stages
    from etendue.report.quality import print_quality
    from etendue.report.terminal import TerminalProgress
    from etendue.session import Options, check_scheduler
    from etendue.spec.pipeline import read_pipeline
    from etendue.studies.quality import pictures_of, write
    from etendue.studies.quality import quality as measure

    pipeline = read_pipeline(file, _overrides(settings, sweeps, (), tolerance))
    options = Options(check_scheduler(scheduler), workers or 0)
    show = pictures_of(pipeline.name) if output else None
    progress = None if as_json else TerminalProgress
    found = measure(
        pipeline, installed_stages(), samples_per_degree, without, keep, not nothing_left_out, options, progress, show, output, pictures
    )
    if output:
        write(found, output)
    if as_json:
        _say(found.document())
    else:
        _show(print_quality, found.document())
    sys.exit(3 if found.failed else 0)


@main.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="camera.iso=800, demosaic.use=demosaic_bilinear; repeatable.")
@click.option("--reflectance", default=0.18, show_default=True, metavar="R", help="Of the grey card.")
@click.option("--frames", default=4, show_default=True, metavar="N", help="Frames of noise, each with fixed patterns of its own.")
@click.option("--json", "as_json", is_flag=True, help="JSON on stdout.")
def noise(file: Path, settings: tuple[str, ...], reflectance: float, frames: int, as_json: bool) -> None:
    """Noise behind every stage of a camera in front of a grey card: predicted, and found in frames of noise.

    Predicted from shot noise, read noise, fixed patterns and rounding, and from what the stages behind the mosaic answer to one
    pixel; stages that adapt to their picture adapt to noise, and differ from the prediction. Correlations between channels and
    between neighbours say how coarse and how coloured the noise looks.
    """
    from etendue.registry import installed_stages
    from etendue.report.noise import print_noise
    from etendue.report.terminal import TerminalProgress
    from etendue.spec.pipeline import read_pipeline
    from etendue.studies.noise import noise as measure

    pipeline = read_pipeline(file, _overrides(settings, (), (), None))
    found = measure(pipeline, installed_stages(), reflectance, frames, None, None if as_json else TerminalProgress)
    if as_json:
        _say(found.document())
    else:
        _show(print_noise, found.document())


@main.command()
@click.argument("name", required=False)
@click.option("--json", "as_json", is_flag=True, help="JSON on stdout.")
def stages(name: str | None, as_json: bool) -> None:
    """What is installed, from which distribution, what it reads and writes, its parameters."""
    from etendue.errors import RequestError, nearest
    from etendue.registry import installed_stages
    from etendue.report.catalogue import print_stage, print_stages, stage_document
    from etendue.telling import printable

    registry = installed_stages()
    if name is not None and name not in registry:
        raise RequestError(f"there is no stage {name!r}{nearest(name, registry.names())}{registry.found.missed('stages', name)}")
    documents = [stage_document(registry, one) for one in ([name] if name else registry.names())]
    if as_json:
        _say(documents)
    elif name:
        _show(print_stage, documents[0])
    else:
        _show(print_stages, documents)
    for text in () if name else registry.found.notes():
        click.echo(f"note: {printable(text)}", err=True)


@main.command()
@click.argument("name", required=False)
@click.option("--json", "as_json", is_flag=True, help="JSON on stdout.")
def quantities(name: str | None, as_json: bool) -> None:
    """The camera quantities that stages share: meaning, unit, range, default, and which stages take one."""
    from etendue import discovery
    from etendue.errors import RequestError, nearest
    from etendue.registry import installed_stages
    from etendue.report.catalogue import print_quantities, print_quantity, quantity_document
    from etendue.spec import camera

    if name is not None and name not in camera.names():
        missed = discovery.installed().missed("quantities", name)
        raise RequestError(f"there is no camera quantity {name!r}{nearest(name, camera.names())}{missed}")
    registry = installed_stages() if name else None
    documents = [quantity_document(one, registry) for one in ([name] if name else camera.names())]
    if as_json:
        _say(documents)
    elif name:
        _show(print_quantity, documents[0])
    else:
        _show(print_quantities, documents)


@main.command()
@click.argument("folder", type=click.Path(path_type=Path), metavar="DIR")
@click.option("--json", "as_json", is_flag=True, help="JSON on stdout.")
def show(folder: Path, as_json: bool) -> None:
    """What is in an archive: stages, variables, cells; how far a running or broken sweep is."""
    from etendue.archive.describe import describe_archive
    from etendue.report.terminal import print_archive

    document = describe_archive(folder)
    if as_json:
        _say(document)
    else:
        _show(print_archive, document)


@main.command()
@click.argument("folder", type=click.Path(path_type=Path), metavar="ARCHIVE")
@click.option("--dng", is_flag=True, help="Raw frames as Digital Negatives.")
@click.option("--tiff", is_flag=True, help="16-bit TIFF: of the raw digital numbers, or of --variable.")
@click.option(
    "--variable", "variables", multiple=True, metavar="NAME", help="What the TIFF files show, such as rgb_display; may be repeated."
)
@click.option("--at", multiple=True, metavar="AXIS=VALUE", help="f_number=2.8; may be repeated. An axis not named: all its values.")
@click.option("--stage", default="", metavar="NAME", help="Take it from this stage; default the last one that wrote it.")
@click.option(
    "--output", type=click.Path(path_type=Path), metavar="PATH", help="A folder, or the file for one picture; default ./ARCHIVE-export."
)
@click.option("--all", "everything", is_flag=True, help="Also more than 64 files.")
@click.option("--force", is_flag=True, help="Write over files that exist.")
@click.option("--json", "as_json", is_flag=True, help="JSON on stdout.")
def export(
    folder: Path, dng: bool, tiff: bool, variables: tuple[str, ...], at: tuple[str, ...], stage: str, output: Path | None,
    everything: bool, force: bool, as_json: bool,
) -> None:  # fmt: skip
    """Pictures of an archive as files for other programs: DNG raw files, 16-bit TIFF.

    Exit codes: 0 all written, 2 the request is wrong, 3 some cells have no picture, 4 a run is writing to the archive.
    """
    from etendue.export.command import Request
    from etendue.export.command import export as write

    done = write(Request(folder, dng, tiff, variables, at, stage, output, everything, force))
    if as_json:
        _say({"files": [str(path) for path in done.files], "skipped": [{"at": where, "why": why} for where, why in done.skipped]})
    else:
        with streams.results():
            for path in done.files[:10]:
                click.echo(str(path))
            if len(done.files) > 10:
                click.echo(f"... {len(done.files)} files in {done.folder}")
        for text in done.notes:
            click.echo(f"note: {text}", err=True)
        for where, why in done.skipped:
            click.echo(f"{where}: no picture, the cell is {why}", err=True)
    sys.exit(3 if done.skipped else 0)


@main.command()
@click.argument("name", required=False)
@click.option("--json", "as_json", is_flag=True, help="JSON on stdout.")
def sensors(name: str | None, as_json: bool) -> None:
    """Sensors that a pipeline may name: [camera] sensor = "NAME". With a name: each value and where it comes from."""
    from etendue.report.sensors import print_sensor, print_sensors, sensor_document
    from etendue.spec.presets import preset_names

    documents = [sensor_document(one) for one in ([name] if name else preset_names())]
    if as_json:
        _say(documents)
    elif name:
        _show(print_sensor, documents[0])
    else:
        _show(print_sensors, documents)

"""The program: its commands together, and what becomes of their errors."""

from __future__ import annotations

import os
from typing import Any, NoReturn

import click

from etendue import interrupts
from etendue.cli import (
    beginnings,
    catalogue,
    compacting,
    comparisons,
    exports,
    imports,
    information,
    measuring,
    pages,
    photographs,
    plots,
    runs,
    stability,
    trust,
)
from etendue.cli.saying import say
from etendue.interrupts import end_now

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}


class _Main(click.Group):
    """Turns errors raised on purpose into one clear message and the right exit code."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        ctx.obj = "--json" in args
        try:
            return super().parse_args(ctx, args)  # prints --help and --version
        except BrokenPipeError:
            end_now(141)
        except OSError as error:
            return self._refused(ctx, error)

    def invoke(self, ctx: click.Context) -> Any:
        from etendue.errors import EtendueError, RequestError
        from etendue.telling import plain, refusal, said, where

        as_json = bool(ctx.obj)
        try:
            return super().invoke(ctx)
        except RequestError as error:
            if as_json:
                faults = [{"file": error.file, "line": f.line, "place": f.place, "message": f.message} for f in error.faults]
                say({"faults": faults})
            else:
                click.echo(refusal(str(error)), err=True)
            ctx.exit(2)
        except EtendueError as error:
            if as_json and error.exit_code == 2:
                say({"faults": [{"file": "", "line": None, "place": "", "message": str(error)}]})
            else:
                click.echo(refusal(str(error)), err=True)
            ctx.exit(error.exit_code)
        except BrokenPipeError:  # whoever read the output has gone
            end_now(141)
        except OSError as error:
            self._refused(ctx, error)
        except MemoryError as error:
            click.echo(f"the machine is short of memory ({plain(str(error)) or 'nothing more is known'}); the archive is intact", err=True)
            ctx.exit(5)
        except KeyboardInterrupt as error:
            click.echo(interrupts.line(), err=True)
            ctx.exit(getattr(error, "exit_code", 130))
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except Exception as error:
            if os.environ.get("ETENDUE_TRACEBACK"):
                raise
            text = f"etendue itself broke off: {where(error)}{said(error)}; please report it, with what ETENDUE_TRACEBACK=1 shows"
            click.echo(refusal(text), err=True)
            ctx.exit(1)

    def _refused(self, ctx: click.Context, error: OSError) -> NoReturn:
        from etendue.errors import machine_text
        from etendue.telling import refusal

        click.echo(refusal(machine_text(error)), err=True)
        ctx.exit(5)


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
    etendue rerun smallest                  run it again into itself, from the archive alone
    etendue verify smallest                 every byte as it was written? --repair mends it
    etendue reproduce smallest              compute it again and compare, cell by cell
    etendue diff smallest other             which cells of two archives differ, by how much, since what
    etendue report smallest                 one HTML page to read and send on
    etendue view smallest                   every pixel of every stage, live, in a browser
    etendue plot smallest                   maps, curves, fronts, pictures of it; --list says which
    etendue export smallest --dng           raw files that other converters open
    etendue compact OLD NEW                 an archive written anew, its axes sorted
    etendue compare FILE --axis demosaic.use   alternatives ranked, quality against run time
    etendue quality FILE                    every camera of a sweep against the ideal one
    etendue noise FILE                      noise behind every stage, predicted and found
    etendue emva FILE                       a sensor measured after EMVA 1288, beside what it should be
    etendue measure PICTURE                 a photograph of your own: MTF, noise, ColorChecker
    etendue information FILE                bits a pixel of fine detail, and where they are lost
    etendue losses FILE                     which stage is owed the lost contrast, SNR and colour
    etendue accuracy FILE                   error against run time, of every knob and of combinations
    etendue stability                       every stage where numbers are hard
    etendue sensors                         sensors whose parameters are published
    etendue new NAME                        a commented pipeline to begin with
    etendue new-plugin NAME --role ROLE     a stage of your own, in a distribution that installs
    etendue import CUBE                     a spectral cube of another program as a scene
    etendue schema                          the form of pipeline files, for editors
    """


for _command in (
    *(runs.plan, runs.run, runs.rerun, runs.archive),
    *(catalogue.stages, catalogue.quantities, catalogue.sensors, catalogue.schema),
    *(comparisons.compare, comparisons.quality, comparisons.noise, measuring.emva, comparisons.accuracy),
    photographs.measure,
    *(information.information, information.losses),
    *(stability.stability, pages.report, pages.view, exports.export, plots.plot, compacting.compact),
    *(beginnings.new, beginnings.new_plugin, imports.take),
    *(trust.verify, trust.reproduce, trust.diff),
):
    main.add_command(_command)

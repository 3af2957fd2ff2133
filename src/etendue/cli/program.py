"""The program: collect the commands and handle their errors."""

from __future__ import annotations

import os
from typing import NoReturn

import click

from etendue import interrupts
from etendue.cli import commands
from etendue.cli.saying import say
from etendue.errors import EtendueError, RequestError, machine_text, nearest
from etendue.interrupts import end_now
from etendue.telling import plain, refusal, said, where

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}


class _Main(click.Group):
    """Convert intended errors into one clear message and the matching exit code."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        ctx.obj = "--json" in args
        try:
            return super().parse_args(ctx, args)  # prints --help and --version
        except BrokenPipeError:
            end_now(141)
        except OSError as error:
            return self._refused(ctx, error)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(commands.offered())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command."""
        # own commands are not looked up among plugins
        found = commands.OWN.get(cmd_name) or commands.offered().get(cmd_name)
        return None if found is None else commands.loaded(cmd_name, found)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write one line per command from the command table; no command is imported for it."""
        for title, rows in commands.listed():
            with formatter.section(title):
                formatter.write_dl(rows, col_max=44)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = str(args[0]) if args else ""
        if name and not name.startswith("-") and name not in commands.OWN and name not in commands.offered():
            ctx.fail(f"No such command {name!r}{nearest(name, commands.offered())}{commands.missed(name)}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> object:
        as_json = bool(ctx.obj)
        try:
            return super().invoke(ctx)
        except RequestError as error:
            if as_json:
                faults = [
                    {"file": error.file, "line": f.line, "place": f.place, "message": f.message} for f in error.faults
                ]
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
        except BrokenPipeError:  # the reader of the output is gone
            end_now(141)
        except OSError as error:
            self._refused(ctx, error)
        except MemoryError as error:
            click.echo(
                f"out of memory ({plain(str(error)) or 'no details'}); the archive is intact",
                err=True,
            )
            ctx.exit(5)
        except KeyboardInterrupt as error:
            click.echo(interrupts.line(), err=True)
            ctx.exit(getattr(error, "exit_code", 130))
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except Exception as error:
            if os.environ.get("ETENDUE_TRACEBACK"):
                raise
            if interrupts.noted():  # an interrupted library may raise anything; that is no internal error
                interrupts.leave()
            text = (
                f"internal error in etendue: {where(error)}{said(error)}; please report it with the output of "
                f"ETENDUE_TRACEBACK=1"
            )
            click.echo(refusal(text), err=True)
            ctx.exit(1)

    def _refused(self, ctx: click.Context, error: OSError) -> NoReturn:
        click.echo(refusal(machine_text(error)), err=True)
        ctx.exit(5)


@click.group(cls=_Main, context_settings=CONTEXT)
@click.version_option(package_name="etendue")
def main() -> None:
    """Simulate pipelines of replaceable stages on labelled arrays: plan, sweep with Dask, archive in Zarr, plot,
    reproduce.
    """

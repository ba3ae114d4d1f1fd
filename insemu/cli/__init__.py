"""The command line: one module per command, heavy imports inside each, so that ``insemu --help`` answers at once.

Exit codes: 0 done, 1 a check failed (or nobody reads the output), 2 bad input (one readable message, nothing half-written), 130 interrupted.
"""

from __future__ import annotations

import io
import sys
from importlib import import_module
from typing import Any

import typer
import typer.core

from insemu.cli.options import spread
from insemu.errors import InputError

#: Commands in the order of ``insemu --help``; each is the function ``command`` of the module of its name.
COMMANDS = (
    "init open solve export run merge sweep require compare reproduce regress referee designs sensor characterise fit "
    "fit-runs fit-covariate fit-regressors select array watch emulate vehicle compare-drives errors dead-reckon gap gap-check transfer serve schema"
).split()

app = typer.Typer(
    name="insemu",
    help="Choose and trust the noise models of INS/GNSS filters: characterise, fit, emulate, filter, evaluate, close the gap.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # a unit in brackets is no markup
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        from insemu import __version__
        from insemu.compiled import described

        typer.echo(f"insemu {__version__}\nkernels: {described()}\nnumba {version('numba')}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version and exit."
    ),
) -> None:
    pass


class _Command(typer.core.TyperCommand):
    """A command that refuses an empty text, such as a variable of the shell that is not set, where a value is needed."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        rest = super().parse_args(ctx, args)
        for parameter in self.params:
            name, option = parameter.name or "", parameter.opts[0]
            argument = not option.startswith("-")
            source = ctx.get_parameter_source(name)
            if (argument or parameter.required) and source and source.name == "COMMANDLINE":
                given = ctx.params[name]
                if "" in (given if isinstance(given, list | tuple) else [given]):
                    raise InputError("found an empty text", where=name.upper() if argument else option)
        return rest


for _name in COMMANDS:
    _command = import_module(f"insemu.cli.{_name.replace('-', '_')}").command
    _whole = " ".join(_command.__doc__.partition("\n\n")[0].split())  # typer would cut it
    app.command(_name, short_help=_whole, cls=_Command)(spread(_command))


def main(argv: list[str] | None = None, commands: typer.Typer = app) -> None:
    """Run the command line, or commands of another program; the entry point of the ``insemu`` script."""
    from insemu.blas import one_thread_by_default
    from insemu.progress import listeners

    listeners[:] = [lambda text: typer.echo(f"{text}.", err=True)]
    one_thread_by_default()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a console that has not all characters shows a question mark
            stream.reconfigure(errors="replace")
    try:
        commands(args=argv, standalone_mode=True)
    except InputError as error:
        typer.echo(f"insemu: error: {error}", err=True)
        sys.exit(2)
    except OSError as error:
        typer.echo(f"insemu: error: {error.filename or ''}: {(error.strerror or str(error)).lower()}", err=True)
        sys.exit(2)

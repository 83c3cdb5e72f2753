"""What the commands share: loading on demand, options, ways to print and to read arguments."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from sunspin.errors import InputError, sentence

COMMANDS = {
    "reproduce": "sunspin.cli.study:reproduce",
    "worth": "sunspin.cli.study:worth",
    "init": "sunspin.cli.files:init",
    "check": "sunspin.cli.files:check",
    "decode": "sunspin.cli.files:decode",
    "sun": "sunspin.cli.measured:sun",
    "rates": "sunspin.cli.rates:rates",
    "simulate": "sunspin.cli.motion:simulate",
    "scan": "sunspin.cli.motion:scan",
    "outcomes": "sunspin.cli.outcomes:outcomes",
    "export": "sunspin.cli.export:export",
    "compare": "sunspin.cli.export:compare",
}
"""Command -> where it is; a command's module is imported only when the command is used or its help line shown."""

SUMMARIES = {
    "reproduce": "The whole Philae study: figures, tables, report.",
    "worth": "How far the study's answer can be trusted: its method on many twins.",
    "init": "Write a vehicle file and telemetry to start from.",
    "check": "What is wrong with my files, in plain words.",
    "decode": "Raw beacons of skCUBE into a table.",
    "sun": "Directions to the Sun from panel powers or currents.",
    "rates": "Body rates and attitude of each pass, all motions that fit.",
    "simulate": "One trajectory of a vehicle with its wheels.",
    "scan": "Which initial rates fit the Sun's measured heights, and the lines they lie on.",
    "outcomes": "What a motion leads to: collision, first contact, antenna, wheel strategies.",
    "export": "Attitude and rates as CCSDS AEM, SPICE CK, NetCDF or Parquet.",
    "compare": "Rates against somebody's SPICE attitude kernels.",
}


class ReaderGone(Exception):
    """Whoever read our output has stopped."""


class Group(click.Group):
    """A group whose commands are imported on demand, so that --help stays fast."""

    def invoke(self, ctx: click.Context) -> Any:
        """As click does, but an interruption and a closed pipe reach :func:`sunspin.cli.main` without click's own ending."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            raise click.Abort(str(stop)) from None
        except BrokenPipeError:
            raise ReaderGone from None

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module, name = COMMANDS[cmd_name].split(":")
        return getattr(import_module(module), name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, SUMMARIES[name]) for name in COMMANDS])


def output_options(default: str | None = None, out: bool = True) -> Callable:
    """--json, --quiet and, where a command writes results, --out."""

    def decorate(command: Callable) -> Callable:
        command = click.option("--quiet", is_flag=True, help="Print nothing but errors.")(command)
        command = click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")(command)
        if not out:
            return command
        return click.option(
            "--out", type=click.Path(path_type=Path), default=default, show_default=default is not None,
            help="Results folder; made if needed.",
        )(command)  # fmt: skip

    return decorate


def data_option(command: Callable) -> Callable:
    return click.option(
        "--data", envvar="SUNSPIN_DATA", type=click.Path(path_type=Path),
        help="Folder in which TELEMETRY is looked for too (or set SUNSPIN_DATA).",
    )(command)  # fmt: skip


def run_options(command: Callable) -> Callable:
    """--seed, --workers."""
    command = click.option("--workers", type=click.IntRange(1, 4096), help="Threads; default one per core.")(command)
    return click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of all random choices.")(
        command
    )


def find_telemetry(path: str, data: Path | None) -> Path:
    """The telemetry file as given, or under the data folder."""
    given = Path(path)
    if data is not None and not given.is_absolute():
        try:
            if not given.exists() and (data / given).exists():
                return data / given
        except (OSError, ValueError):
            return given
    return given


def numbers(text: str | None, name: str, count: int | None = None) -> list[float]:
    """Comma-separated numbers of an option."""
    try:
        values = [float(part) for part in text.split(",")] if text else []
    except ValueError:
        values = None
    if values is None or (count is not None and len(values) != count):
        wanted = f"{count} numbers" if count else "numbers"
        raise InputError(sentence(f"{name} takes {wanted} separated by commas", got=text, do=f"for example {name} 0.1,0,-0.2"))
    return values


def report(summary: dict[str, Any], lines: list[str], as_json: bool, quiet: bool) -> None:
    """Print the summary as JSON, or the lines for a person."""
    if as_json:
        from sunspin.tell.results import plain

        click.echo(json.dumps(plain(summary), indent=1, ensure_ascii=False, allow_nan=False))
    elif not quiet:
        for line in lines:
            click.echo(line)


def on_terminal(quiet: bool) -> bool:
    """Whether to show a progress bar."""
    return not quiet and os.isatty(2)

"""What the commands share: loading on demand, options, ways to print and to read arguments."""

from __future__ import annotations

import json
import os
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from sunspin.base.errors import InputError, printable, sentence
from sunspin.cli import gone
from sunspin.cli.values import sensible, strict

if TYPE_CHECKING:
    import xarray as xr

    from sunspin.vehicle import Vehicle


PIECE = 1_000_000
"""Bytes of standard input that are taken at once."""


class Listed(NamedTuple):
    """A command: the module that has it, the heading of --help under which it stands, its line there."""

    module: str
    section: str
    summary: str


YOURS, MOTIONS, PHILAE, OTHERS = "Your satellite", "Motions", "Philae", "Data of others"

COMMANDS = {
    "init": Listed("init", YOURS, "Write a vehicle file and telemetry to start from."),
    "check": Listed("check", YOURS, "What is wrong with my files, in plain words."),
    "sun": Listed("sun", YOURS, "Directions to the Sun from panel powers or currents."),
    "calibrate-sensors": Listed(
        "calibrate", YOURS, "Gains, zeros, scales and soft iron from the telemetry itself."
    ),
    "rates": Listed("rates", YOURS, "Body rates and attitude of each pass, all motions that fit."),
    "posterior": Listed(
        "posterior", YOURS, "Every motion that the readings allow, with its probability."
    ),
    "report": Listed("report", YOURS, "A results folder as one page to look into."),
    "export": Listed(
        "export", YOURS, "Attitude and rates as CCSDS AEM, SPICE CK, NetCDF or Parquet."
    ),
    "compare": Listed(
        "compare", YOURS, "What moved between two results; or rates against SPICE kernels."
    ),
    "simulate": Listed("simulate", MOTIONS, "One trajectory of a vehicle with its wheels."),
    "scan": Listed("scan", MOTIONS, "Which initial rates fit, and the lines they lie on."),
    "outcomes": Listed(
        "outcomes", MOTIONS, "What a motion leads to: collision, landing, wheel strategies."
    ),
    "compile": Listed(
        "compile", MOTIONS, "Compile what scans run now, so that the first need not wait."
    ),
    "reproduce": Listed("reproduce", PHILAE, "The whole Philae study: figures, tables, report."),
    "decode": Listed("decode", OTHERS, "Raw beacons of skCUBE into a table."),
}
"""In the order of --help. A command's module is imported only when the command is used or its help line shown."""


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
        found = vars(import_module(f"sunspin.cli.{COMMANDS[cmd_name].module}")).values()
        command = next(
            one for one in found if isinstance(one, click.Command) and one.name == cmd_name
        )
        for parameter in command.params:
            parameter.callback = parameter.callback or sensible
            parameter.type = strict(parameter.type)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for title in dict.fromkeys(one.section for one in COMMANDS.values()):
            with formatter.section(title):
                formatter.write_dl(
                    [(name, one.summary) for name, one in COMMANDS.items() if one.section == title]
                )

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """As click does, but a misspelt command is answered with the likely ones."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            if args[0] in gone.COMMANDS:
                raise click.UsageError(gone.COMMANDS[args[0]], ctx) from None
            near = get_close_matches(args[0], COMMANDS, n=3, cutoff=0.5)
            if near and "Did you mean" not in error.message:
                said = f"{error.message.rstrip('.')} (did you mean {' or '.join(near)}?)"
                raise click.UsageError(said, ctx) from None
            raise


def output_options(default: str | None = None, out: bool = True) -> Callable:
    """--json, --quiet and, where a command writes results, --out."""

    def decorate(command: Callable) -> Callable:
        command = click.option("--quiet", is_flag=True, help="Print nothing but errors.")(command)
        command = click.option(
            "--json", "as_json", is_flag=True, help="Print the summary as JSON."
        )(command)
        if not out:
            return command
        return click.option(
            "--out",
            type=click.Path(path_type=Path),
            default=default,
            show_default=default is not None,
            help="Results folder; made if needed.",
        )(command)

    return decorate


def data_option(command: Callable) -> Callable:
    return click.option(
        "--data",
        envvar="SUNSPIN_DATA",
        type=click.Path(path_type=Path),
        help="Folder in which TELEMETRY is looked for too (or set SUNSPIN_DATA); TELEMETRY may be - for standard input.",
    )(command)


def wheel_mode_option(
    about: str = "coast: motor off, friction slows the wheel; hold: the motor keeps its speed; brake: with the "
    "vehicle's brake torque.",
) -> Callable:
    modes = click.Choice(["coast", "hold", "brake"])
    return click.option("--wheel-mode", type=modes, default="coast", show_default=True, help=about)


def factor_option(command: Callable) -> Callable:
    least = click.FloatRange(1, min_open=True)
    return click.option(
        "--factor", type=least, default=1.1, show_default=True, help="Near-minimum factor."
    )(command)


def store_option(
    about: str = "Folder that keeps what is computed: after a crash, a power cut or Ctrl-C the same command goes on "
    "where it stopped. Other inputs need another folder.",
) -> Callable:
    return click.option("--store", type=click.Path(path_type=Path), help=about)


def run_options(command: Callable) -> Callable:
    """--seed, --workers."""
    command = click.option(
        "--workers", type=click.IntRange(1, 4096), help="Threads; default one per core."
    )(command)
    return click.option(
        "--seed",
        type=click.IntRange(0),
        default=0,
        show_default=True,
        help="Seed of all random choices.",
    )(command)


def find_telemetry(path: str | None, data: Path | None, vehicle: str = "") -> Path:
    """The telemetry file as given, or under the data folder; the name of a built-in case stands for its own telemetry, and `-` for
    what is piped in.

    Without a path it is that of the case whose name `vehicle` is.
    """
    if path is None:
        from sunspin.telemetry.case import case_telemetry

        if (own := case_telemetry(vehicle)) is None:
            raise InputError(
                sentence("TELEMETRY is missing", do="only a built-in case comes with its own")
            )
        return own
    if path == "-":
        return _from_standard_input()
    given = Path(path)
    if given.name == path and not given.suffix and not given.exists():
        from sunspin.telemetry.case import case_telemetry

        given = case_telemetry(path) or given
    if data is not None and not given.is_absolute():
        try:
            if not given.exists() and (data / given).exists():
                return data / given
        except (OSError, ValueError):
            return given
    return given


def _from_standard_input() -> Path:
    """What is piped in, as a file for as long as the command runs: readers take files, whose size they know before they begin."""
    from sunspin.base.tables import MAX_FILE_BYTES

    if sys.stdin is None or sys.stdin.isatty():
        raise InputError(
            sentence("nothing is piped into standard input", do="pipe telemetry in, or name a file")
        )
    folder = click.get_current_context().with_resource(TemporaryDirectory(prefix="sunspin-"))
    path, size = Path(folder) / "standard-input", 0
    with open(path, "wb") as file:
        while size <= MAX_FILE_BYTES and (part := sys.stdin.buffer.read(PIECE)):
            size += file.write(part)
    return path


def read_both(vehicle: Any, telemetry: str, data: Path | None) -> tuple[Vehicle, xr.Dataset]:
    """The vehicle of a name or file, and telemetry read with its columns."""
    from sunspin.telemetry.reader import read_telemetry
    from sunspin.vehicle import load_vehicle

    craft = load_vehicle(vehicle)
    return craft, read_telemetry(find_telemetry(telemetry, data), craft)


def report(summary: dict[str, Any], lines: list[str], as_json: bool, quiet: bool) -> None:
    """Print the summary as JSON, or the lines for a person."""
    if as_json:
        from sunspin.output.folder import plain

        text = json.dumps(plain(summary), indent=1, ensure_ascii=False, allow_nan=False)
        click.echo(
            text.encode("utf-8", "backslashreplace").decode("utf-8")
        )  # half characters of file names become escapes
    elif not quiet:
        for line in lines:
            click.echo(
                line
                if line.isprintable()
                else line[: len(line) - len(line.lstrip(" "))] + printable(line)
            )


def claim(out: Path | None, command: str) -> None:
    """Refuse a results folder before the work, not after it."""
    if out is not None:
        from sunspin.output.folder import results_folder

        results_folder(out, command)


def deliver(
    result: Any,
    out: Path | None,
    as_json: bool,
    quiet: bool,
    vehicle: Any,
    telemetry: Any = None,
    also: Mapping[str, Any] | None = None,
    lines: Sequence[str] = (),
    main: str = "",
) -> None:
    """Save a result where a folder is given, and print what it says of itself; `also` and `lines`: more of it; `main`: its file."""
    import_module("sunspin.output.result")
    summary = result.sunspin.summary()
    told = [*summary.lines, *lines, *summary.notes]
    if out is not None:
        command = shlex.join(["sunspin", *sys.argv[1:]])
        folder = result.sunspin.save(
            out, vehicle=vehicle, telemetry=telemetry, command=command, also=also, lines=lines
        )
        told += [f"Results: {folder / main}", f"A page to look into it: sunspin report {folder}"]
    report({**summary, **(also or {})}, told, as_json, quiet)


def announced(command: str, quiet: bool) -> Callable[[str], None] | None:
    """What says a line on standard error when work begins; None if `quiet`, or where a terminal shows a progress line."""
    if quiet or os.isatty(2):
        return None

    def say(line: str) -> None:
        with suppress(OSError):  # a log that cannot be written stops no work
            print(f"sunspin: {command}: {printable(line)}", file=sys.stderr, flush=True)

    return say


def on_terminal(quiet: bool) -> bool:
    """Whether to show a progress bar."""
    return not quiet and os.isatty(2)

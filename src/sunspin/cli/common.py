"""What the commands share: import on demand, common options, output, and reading of vehicle and telemetry."""

from __future__ import annotations

import json
import os
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial, wraps
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click

from sunspin.base.errors import InputError, printable
from sunspin.base.extras import install_command, missing_packages
from sunspin.cli.values import Parsed, parse_numbers

if TYPE_CHECKING:
    import xarray as xr

    from sunspin.environment.ephemeris import OrbitFile
    from sunspin.vehicle import Vehicle


HELPER = "sunspin.helper"
"""Key in the context of a command under which its process for figures is kept."""

PIECE = 1_000_000
"""Bytes of standard input that are read at once."""

YOURS, MOTIONS, PHILAE, OTHERS = "Your satellite", "Motions", "Philae", "Data of others"
"""Headings of the commands in --help, in their order."""

COMMANDS = {
    "init": (YOURS, "Create an example vehicle file and telemetry file."),
    "check": (YOURS, "Check a vehicle file and telemetry for errors."),
    "sun": (YOURS, "Compute the Sun direction of each sample from panel power or current."),
    "calibrate-sensors": (YOURS, "Calibrate panels, Sun sensors, magnetometer and gyro in flight."),
    "rates": (YOURS, "Estimate body rates and attitude of each pass."),
    "posterior": (YOURS, "Sample the full posterior of one stretch of free motion."),
    "explain": (YOURS, "Explain a verdict or a warning."),
    "report": (YOURS, "Make an HTML report from a results folder."),
    "export": (YOURS, "Export attitude and rates (CCSDS AEM, SPICE CK, NetCDF, Parquet)."),
    "pointing": (YOURS, "Compute angles of body axes to Sun, nadir, ram and ground stations."),
    "history": (YOURS, "Collect the passes of many results: trend and jumps of the speed."),
    "plan": (YOURS, "Find out before launch which beacon decides which rates."),
    "compare": (YOURS, "Compare two results, or rates with a SPICE kernel."),
    "simulate": (MOTIONS, "Propagate one motion."),
    "scan": (MOTIONS, "Scan a grid of initial body rates against the Sun directions."),
    "outcomes": (MOTIONS, "Simulate collision and landing outcomes (Monte Carlo)."),
    "reproduce": (PHILAE, "Reproduce the Philae study (figures, tables, report)."),
    "decode": (OTHERS, "Decode raw frames to CSV: skCUBE, or any decoder of satnogs-decoders."),
}
"""Command -> heading and line in --help, in the order of --help. The module of the command has its name."""


class Group(click.Group):
    """A group whose commands are imported on demand, so that --help stays fast."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; interruptions and closed pipes reach :func:`sunspin.cli.main` and not click's handlers."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            raise click.Abort(str(stop)) from None
        except BrokenPipeError:
            # main flushes stdout, which raises the error again there
            raise click.exceptions.Exit(0) from None

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands in the order of --help."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the module of a command and return the command, or None if there is none of this name."""
        if cmd_name not in COMMANDS:
            return None
        module = import_module(f"sunspin.cli.{cmd_name.replace('-', '_')}")
        commands = (value for value in vars(module).values() if isinstance(value, click.Command))
        return next(command for command in commands if command.name == cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands under their headings."""
        for heading in (YOURS, MOTIONS, PHILAE, OTHERS):
            with formatter.section(heading):
                lines = [(name, line) for name, (own, line) in COMMANDS.items() if own == heading]
                formatter.write_dl(lines)

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Find the command of an argument; the error for a misspelt one names similar commands."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            near = get_close_matches(args[0], COMMANDS, n=3, cutoff=0.5)
            if not near or "Did you mean" in error.message:
                raise
            message = f"{error.message.rstrip('.')} (did you mean {' or '.join(near)}?)"
            raise click.UsageError(message, ctx) from None


@dataclass(frozen=True)
class Output:
    """The options --out, --json and --quiet of a command: where its result is written and how it is printed."""

    command: str
    folder: Path | None
    as_json: bool
    quiet: bool

    @property
    def progress(self) -> bool:
        """Return whether to show a progress bar: not with --quiet, and only if stderr (file descriptor 2) is a terminal."""
        return not self.quiet and os.isatty(2)

    def announce(self, line: str) -> None:
        """Print a line of progress on standard error, unless --quiet is given."""
        if not self.quiet:
            with suppress(OSError):  # a log that cannot be written does not stop the work
                # word by word: blanks that align the columns of a table stay
                rows = (" ".join(map(printable, row.split(" "))) for row in line.split("\n"))
                text = "\n".join(rows)
                print(f"sunspin: {self.command}: {text}", file=sys.stderr, flush=True)

    def claim(self) -> None:
        """Create the results folder, or refuse it, before the work begins."""
        if self.folder is not None:
            from sunspin.output.folder import results_folder

            results_folder(self.folder, self.command)

    def draw_in_background(self, kinds: str, workers: int | None = None) -> None:
        """Start the process that draws the figures of results of these `kinds`, a module of :mod:`sunspin.output.kinds`.

        For a command with a results folder and more than one worker. It is a copy of this process, so a command calls it before
        its other imports: while this process imports what computes, that one imports what draws.
        """
        from sunspin.compute.helper import helper_process
        from sunspin.compute.pool import worker_count
        from sunspin.output.result import prepare_to_draw

        if self.folder is not None and not missing_packages("pictures"):
            context = click.get_current_context()
            helper = helper_process(worker_count(workers), partial(prepare_to_draw, kinds))
            context.meta[HELPER] = context.with_resource(helper)

    def report(self, summary: dict[str, Any], lines: Sequence[str]) -> None:
        """Print the summary as JSON with --json, else the lines unless --quiet is given.

        Adds where the verdicts and warnings in the lines are explained.
        """
        from sunspin.output.verdicts import PAGE, find_labels

        if labels := find_labels(self.command, lines):
            summary = {**summary, "explained": [f"{PAGE}#{label}" for label in labels]}
            lines = [*lines, f"For what this means: sunspin explain {' '.join(labels)}"]
        if self.as_json:
            from sunspin.output.folder import to_plain_data

            text = json.dumps(to_plain_data(summary), indent=1, ensure_ascii=False, allow_nan=False)
            # lone surrogates, from file names that are no UTF-8, become escapes
            click.echo(text.encode("utf-8", "backslashreplace").decode("utf-8"))
        elif not self.quiet:
            for line in lines:
                indent = line[: len(line) - len(line.lstrip(" "))]  # which `printable` would remove
                click.echo(line if line.isprintable() else indent + printable(line))

    def deliver(
        self,
        result: Any,
        vehicle: Any = None,
        telemetry: Any = None,
        also: Mapping[str, Any] | None = None,
        lines: Sequence[str] = (),
        main: str = "",
    ) -> None:
        """Save a result if there is a results folder, and print its summary.

        `vehicle` and `telemetry` are the inputs, which are saved with the result. `also`: further entries of the summary; `lines`:
        further lines; `main`: the file of the folder that is named in the output.
        """
        import_module("sunspin.output.result")  # registers the accessor `.sunspin` of xarray
        summary = result.sunspin.summary()
        lines_shown = [*summary.lines, *lines, *summary.notes]
        if self.folder is not None:
            command = shlex.join(["sunspin", *sys.argv[1:]])
            inputs = {"vehicle": vehicle, "telemetry": telemetry, "command": command}
            helper = click.get_current_context().meta.get(HELPER)
            folder = result.sunspin.save(
                self.folder, **inputs, also=also, lines=lines, helper=helper
            )
            lines_shown.append(f"Results: {folder / main}")
            if missing_packages("pictures"):
                how = install_command("pictures")
                lines_shown.append(f"No figures. For figures and the HTML page: {how}")
            else:
                lines_shown.append(f"View as HTML: sunspin report {folder}")
        self.report({**summary, **(also or {})}, lines_shown)


PATH = click.Path(path_type=Path)
POSITIVE = click.FloatRange(0, min_open=True)

SHARED: dict[str, dict[str, Any]] = {
    "--from begin": {"help": "Start: UTC such as 2017-06-28T19:18, or seconds from the epoch."},
    "--to end": {"help": "End, in the same form."},
    "--period periods": {
        "multiple": True,
        "metavar": "S+-SIGMA@TIME",
        "help": "Observed rotation period (s), from radio fading or a light curve, for example 13.0+-0.5@15:50. It may be that of "
        "the precession, the spin or the sum of both rates: all are tried. Used to weight the solutions. Repeatable. For "
        "`rates` also a column, such as a light curve: its period is searched.",
    },
    "--tle --omm --ephemeris elements": {
        "type": PATH,
        "help": "Orbit file: TLE, OMM, OEM, SPK, or CSV with time_utc, x_km, y_km, z_km. The three names mean the same: the format "
        "is detected. Default: [orbit] of the vehicle file.",
    },
    "--norad satellite": {
        "metavar": "NUMBER",
        "help": "Catalogue number (or name) of the satellite, for an orbit file with several.",
    },
    "--tle-shift-sigma shift_sigma": {
        "type": POSITIVE,
        "help": "1-sigma along-track uncertainty of the orbit in s. Default: from the age of the elements.",
    },
    "--wheel-speed": {
        "type": Parsed(parse_numbers, "RAD/S,..."),
        "help": "Wheel speeds (rad/s) at the start. Default: wheel.speed_rad_s of the vehicle file.",
    },
    "--wheel-mode": {
        "type": click.Choice(["coast", "hold", "brake"]),
        "default": "coast",
        "help": "Wheel control: coast (motor off), hold (constant speed) or brake.",
    },
    "--factor": {
        "type": click.FloatRange(1, min_open=True),
        "default": 1.1,
        "help": "Select the rates of a scan whose metric is below this times the smallest (near-minimum set).",
    },
    "--store": {
        "type": PATH,
        "help": "Checkpoint folder: rerun the same command to resume after an interruption. Use a new folder if inputs change.",
    },
    "--scheduler executor": {
        "metavar": "ADDRESS",
        "help": "Dask cluster: tcp://host:8786, or `local` for --workers processes on this machine. "
        'Needs pip install "sunspin[cluster]".',
    },
    "--data": {
        "envvar": "SUNSPIN_DATA",
        "type": PATH,
        "help": "Folder searched for TELEMETRY if it is not found as given (or set SUNSPIN_DATA). TELEMETRY `-` is standard input.",
    },
    "--seed": {"type": click.IntRange(0), "default": 0, "help": "Random seed."},
    "--workers": {
        "type": click.IntRange(1, 4096),
        "help": "Number of parallel workers. Default: one per core. Results do not depend on it.",
    },
    "--out": {"type": PATH, "help": "Results folder; created if needed."},
    "--json as_json": {"is_flag": True, "help": "Print the summary as JSON."},
    "--quiet": {"is_flag": True, "help": "Print errors only."},
}
"""Options with the same meaning in all commands: names, last that of the parameter if it differs -> arguments of `click.option`."""


def shared(*names: str, out: bool | str = True) -> Callable:
    """Return a decorator that adds the options of `SHARED` with these names, and --out, --json and --quiet.

    The command receives the last three as one parameter `output` of the class `Output`. With --data, it receives TELEMETRY as the
    path of a file that exists, if there is one. With --tle there is --norad too, and the command receives both as one `OrbitFile`.

    `out`: default of --out; True for --out without a default, False for a command without --out.
    """
    # first name of an option -> all its names, arguments of `click.option`
    declared = {key.split()[0]: (key.split(), arguments) for key, arguments in SHARED.items()}

    def decorate(function: Callable) -> Callable:
        """Return `function` with these options; it receives their values as the docstring of `shared` says."""

        @wraps(function)
        def command(as_json: bool, quiet: bool, out: Path | None = None, **given: Any) -> None:
            """Replace the values of --data, --tle and the output options by what the function receives, and call it."""
            name = click.get_current_context().command.name or ""
            if "--data" in names:
                telemetry, data = given["telemetry"], given.pop("data")
                given["telemetry"] = telemetry and find_telemetry(telemetry, data)
            if "--tle" in names:
                given["elements"] = _orbit_file(given["elements"], given.pop("satellite"))
            function(output=Output(name, out, as_json, quiet), **given)

        decorated: Callable = command
        satellite = ["--norad"] if "--tle" in names else []
        # reversed: click lists the option that was added last first
        for name in reversed(
            (*names, *satellite, *(["--out"] if out else []), "--json", "--quiet")
        ):
            option_names, arguments = declared[name]
            # `out` is the default of --out if it is a text
            has_default = name == "--out" and out is not True
            default: dict[str, Any] = {"default": out} if has_default else {}
            decorated = click.option(*option_names, **arguments, **default)(decorated)
        return decorated

    return decorate


def _orbit_file(path: Path | None, satellite: str | None) -> OrbitFile | None:
    """Return the file of --tle with the satellite of --norad, None without a file; raise `InputError` for --norad alone."""
    if path is None:
        if satellite is not None:
            what, do = "--norad selects a satellite of an orbit file", "give --tle FILE too"
            raise InputError(what, do=do)
        return None
    from sunspin.environment.ephemeris import OrbitFile

    return OrbitFile(path, satellite or "")


def find_telemetry(path: str, data: Path | None) -> Path:
    """Return the path of the telemetry file that an argument names.

    The argument is a path, a path in the folder `data`, the name of a built-in case, or `-` for standard input. Standard input is
    copied into a file that exists while the command runs, because readers need its size.
    """
    if path == "-":
        from sunspin.base.tables import MAX_FILE_BYTES

        if sys.stdin is None or sys.stdin.isatty():
            what, do = "nothing is piped into standard input", "pipe telemetry in, or name a file"
            raise InputError(what, do=do)
        folder = click.get_current_context().with_resource(TemporaryDirectory(prefix="sunspin-"))
        piped, size = Path(folder) / "standard-input", 0
        # reading stops just above the largest size, and then the reader of the file refuses it
        with open(piped, "wb") as file:
            while size <= MAX_FILE_BYTES and (piece := sys.stdin.buffer.read(PIECE)):
                size += file.write(piece)
        return piped
    given = Path(path)
    # a bare name without a suffix may be that of a built-in case
    if given.name == path and not given.suffix and not given.exists():
        from sunspin.cases import case_telemetry_path

        given = case_telemetry_path(path) or given
    with suppress(OSError, ValueError):  # of a text that is no path; the reader reports it
        if data is not None and not given.exists() and (data / given).exists():
            return data / given
    return given


def read_inputs(vehicle: Any, telemetry: Path) -> tuple[Vehicle, xr.Dataset]:
    """Load a vehicle and read telemetry with its columns, and return both."""
    from sunspin.telemetry.reader import read_telemetry
    from sunspin.vehicle import load_vehicle

    craft = load_vehicle(vehicle)
    return craft, read_telemetry(telemetry, craft)

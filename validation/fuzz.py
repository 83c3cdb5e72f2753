"""Hostile vehicle files, telemetry and options through the command line: the only answers allowed are a result or one sentence.

Options are taken from the commands themselves, so that a new one is tried automatically. Work that takes long for good input (a
scan, the Monte Carlo, the whole study) is ended at its beginning: the question is whether it would begin.
"""

from __future__ import annotations

import argparse
import os
import shutil
import time
from pathlib import Path
from typing import Any
from unittest import mock

import click
import numpy as np

from sunspin.estimate import carry
from validation import hostile, pool
from validation.border import Accepted, judge, sunspin
from validation.pool import Suite, Verdict

SMALL_ROWS = 64
"""Largest number of rows of a scan or Monte Carlo that is run."""

SEARCH_S = 2.5
"""CPU time of a case after which a search of rates is ended, as fast rates and sparse samples may take longer."""

KINDS = {"vehicle": 0.4, "telemetry": 0.25, "options": 0.35}
"""Share of the cases whose vehicle, telemetry or options are hostile."""

# a command that is listed twice is drawn twice as often
ON_VEHICLES = (
    "check",
    "check",
    "sun",
    "simulate",
    "simulate",
    "scan",
    "outcomes",
    "rates",
    "posterior",
)
ON_TABLES = ("check", "check", "sun", "sun", "scan", "rates", "posterior")
"""Commands that are tried with a hostile vehicle file, and with a hostile telemetry file."""


class Fuzz(Suite):
    """Hostile vehicles, telemetry and options."""

    def prepare(self) -> None:
        """Make the stock of good files, and shorten work that would take long."""
        os.environ.pop("SUNSPIN_DATA", None)
        self.stock = self.home / "stock"
        make_stock(self.stock)
        for change in shorten_work():
            self.stack.enter_context(change)
        for name in ("carry_bodies", "_constant_rate_step"):
            limited = self._limit_search(getattr(carry, name))
            self.stack.enter_context(mock.patch.object(carry, name, limited))
        self.commands = command_table()

    def _limit_search(self, function: Any) -> Any:
        """Return the function, wrapped so that it ends the case once `SEARCH_S` of CPU time are used."""

        def limited(*arguments: Any) -> Any:
            """Call the function while CPU time is left."""
            if time.process_time() - self.begun > SEARCH_S:
                raise Accepted
            return function(*arguments)

        return limited

    def arguments(self, index: int) -> list[str]:
        """Return the arguments of this case, and make its files in the current folder."""
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(index,)))
        kind = self.only or str(rng.choice(list(KINDS), p=list(KINDS.values())))
        if kind == "options":
            return self.with_options(rng)
        choices = ON_VEHICLES if kind == "vehicle" else ON_TABLES
        command = choices[int(rng.integers(len(choices)))]
        arguments = base_arguments(command)
        if kind == "vehicle":
            Path("bad.toml").write_bytes(hostile.vehicle(rng))
            return [("bad.toml" if word == "vehicle.toml" else word) for word in arguments]
        Path("bad.csv").write_bytes(hostile.table(Path("telemetry.csv").read_bytes(), rng))
        return [("bad.csv" if word == "telemetry.csv" else word) for word in arguments]

    def with_options(self, rng: np.random.Generator) -> list[str]:
        """Return the arguments of a random command, with one to three hostile options or replaced arguments.

        One case in twenty has a hostile word in addition, anywhere.
        """
        names = sorted(self.commands)
        command = names[int(rng.integers(len(names)))]
        arguments = base_arguments(command)
        parameters = self.commands[command].params
        for _ in range(int(rng.integers(1, 4))):
            parameter = parameters[int(rng.integers(len(parameters)))]
            value = hostile_value(parameter, rng)
            if isinstance(parameter, click.Argument):
                # positions of arguments: all words but the command and the options
                places = [k for k, word in enumerate(arguments) if k and not word.startswith("--")]
                if places:
                    arguments[places[int(rng.integers(len(places)))]] = value
            elif parameter.is_flag:
                arguments.append(parameter.opts[0])
            else:
                arguments.append(f"{parameter.opts[0]}={value}")
        if rng.random() < 0.05:
            arguments.insert(
                int(rng.integers(len(arguments) + 1)),
                hostile.TEXTS[int(rng.integers(len(hostile.TEXTS)))],
            )
        return arguments

    def __call__(self, index: int) -> Verdict:
        folder = self.home / "case"
        shutil.copytree(self.stock, folder, symlinks=True)
        os.mkfifo(folder / "pipe")
        os.chdir(folder)
        try:
            arguments = self.last = self.arguments(index)
            self.begun = time.process_time()
            result = self.result = sunspin(*arguments)
            verdict = judge(result)
            if verdict.bad:
                verdict = verdict._replace(
                    shown=f"{[word[:80] for word in arguments]}\n{verdict.shown}"
                )
            return verdict
        finally:
            os.chdir(self.home)
            shutil.rmtree(folder, ignore_errors=True)


def make_stock(folder: Path) -> None:
    """Make good files to start from: start files with few samples, results of two commands, a zip, and paths that are no files."""
    import zipfile

    for arguments in (
        ("init", str(folder)),
        (
            "simulate",
            "philae",
            "--omega-deg-s=6,0,0",
            "--sun=0,0.6,0.8",
            "--duration=20",
            "--out",
            str(folder / "results"),
        ),
    ):
        result = sunspin(*arguments)
        if result.code != 0:
            raise RuntimeError(f"the stock could not be made: {result}")
    telemetry = folder / "telemetry.csv"
    first_lines = telemetry.read_text("utf-8").splitlines(keepends=True)[:7]
    telemetry.write_text("".join(first_lines), "utf-8")
    (folder / "folder").mkdir()
    (folder / "empty").write_bytes(b"")
    (folder / "loop").symlink_to("loop")
    (folder / "nowhere").symlink_to("missing/there")
    with zipfile.ZipFile(folder / "frames.zip", "w") as archive:
        archive.writestr("1500000000_OM3KAA_1", b"\xc0\x00" + bytes(16) + b"\x02" + bytes(80))


def shorten_work() -> list[Any]:
    """Return patches that end long work at its beginning; small ensembles run."""
    from sunspin.compute.rows import ensemble

    def run_if_small(function: Any, **options: Any) -> Any:
        """Run a small ensemble."""
        if function.n_rows > SMALL_ROWS or options.get("scheduler") is not None:
            raise Accepted
        return ensemble(function, **options)

    def raise_accepted(*_: Any, **__: Any) -> Any:
        """End the case in place of long work."""
        raise Accepted

    return [
        mock.patch("sunspin.estimate.scan.volume.ensemble", run_if_small),
        mock.patch("sunspin.landing.outcomes.ensemble", run_if_small),
        mock.patch("sunspin.estimate.posterior.search_under", raise_accepted),
        mock.patch("sunspin.philae.reproduction.compute", raise_accepted),
    ]


def command_table() -> dict[str, click.Command]:
    """Return every command by its name."""
    from sunspin.cli import cli

    context = click.Context(cli)
    return {name: cli.get_command(context, name) for name in cli.list_commands(context)}


def base_arguments(command: str) -> list[str]:
    """Return arguments with which a command works on the stock."""
    grid = ["--omega-x-deg-s=0:1.2:1.2", "--omega-y-deg-s=-1.8:-1.8:60", "--omega-z-deg-s=3:3:60"]
    start = ["--omega-deg-s=6,0,0", "--sun=0,0.6,0.8"]
    known = {
        "check": ["vehicle.toml", "telemetry.csv"],
        "sun": ["vehicle.toml", "telemetry.csv"],
        "rates": ["vehicle.toml", "telemetry.csv", "--acceleration-noise=1e-4"],
        "posterior": ["vehicle.toml", "telemetry.csv", "--prior=max_rate_rad_s=0.05"],
        "report": ["results"],
        "simulate": ["vehicle.toml", *start, "--duration=100"],
        "scan": ["vehicle.toml", "telemetry.csv", "--to=160", "--lines=0", *grid],
        "outcomes": ["vehicle.toml", "--runs=8", *start, "--after=60", "--collision-speed=0"],
        "init": ["new"],
        "decode": ["frames.zip", "--out=decoded"],
        "export": ["results", "--epoch=2026-01-01T00:00:00Z", "--out=exported"],
        "compare": ["results", "empty", "--frame=X", "--epoch=2026-01-01T00:00:00Z"],
    }
    return [command, *known.get(command, [])]


PATHS = (
    "folder",
    "empty",
    "loop",
    "nowhere",
    "missing",
    "vehicle.toml",
    "telemetry.csv",
    "results",
    "frames.zip",
    ".",
    "",
    "pipe",
    "results/trajectory.nc",
    "/dev/null",
    "/dev/zero",
    "/proc/self/mem",
    "x" * 300,
    "y/" * 2500,
    "caf\udce9",
    "\u202egpj.x",
    "file:///etc/passwd",
    "philae",
)


def hostile_value(parameter: click.Parameter, rng: np.random.Generator) -> str:
    """Return a value for an option or argument, usually of its own kind."""
    kind = parameter.type
    if rng.random() < 0.1:
        values: Any = hostile.TEXTS + hostile.OPTION_NUMBERS + PATHS
    elif isinstance(kind, click.Choice):
        values = (*kind.choices, *kind.choices, "", "nonsense", str(kind.choices[0]).upper())
    elif isinstance(kind, click.Path) or isinstance(parameter, click.Argument):
        values = PATHS
    elif "FLOAT" in kind.name.upper() or "INTEGER" in kind.name.upper():
        values = hostile.OPTION_NUMBERS
    else:
        values = hostile.TEXTS
    # addresses of no cluster, and numbers that start few processes
    if parameter.name == "executor":
        values = ("", "nonsense", "tcp://", "tcp://127.0.0.1:1", "http://x", "\n", "tcp://[::1")
    if parameter.name == "workers":
        values = ("1", "2", "0", "-1", "nan", "4097", "1e3", "")
    return str(values[int(rng.integers(len(values)))])


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this campaign."""
    pool.options(parser)
    parser.add_argument("--only", choices=list(KINDS))


def main(given: argparse.Namespace) -> int:
    """Print the campaign's figures; return 1 if it has findings."""
    return pool.main(Fuzz, given)

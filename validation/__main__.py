"""``python -m validation``: one campaign, its figures, and exit code 1 if it found anything."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType

CAMPAIGNS = {
    "fuzz": "hostile vehicle files, telemetry and options through the command line",
    "corrupt": "binary files damaged and opened: NetCDF, Parquet, stores of rows, SPICE kernels, zip",
    "kill": "runs killed at random moments and resumed, compared with undisturbed ones",
    "witnesses": "closed forms, published values and other software beside ours, digits matched",
    "real": "rates of real satellites against a sensor not used, where the data are; writes build/real-data.md",
    "scoreboard": "what must not get worse: outcomes of cases of every kind, beside an earlier state's",
    "size": "lines by folder, functions, names: how large the package is",
}


def main(arguments: Sequence[str] | None = None) -> int:
    told = "Campaigns that judge sunspin, most by trying to break it; results: docs/accuracy.md."
    parser = argparse.ArgumentParser(prog="python -m validation", description=told)
    commands = parser.add_subparsers(dest="campaign", required=True)
    for name, told in CAMPAIGNS.items():
        campaign(name).options(commands.add_parser(name, help=told, description=told))
    options = parser.parse_args(arguments)
    return campaign(options.campaign).main(options)


def campaign(name: str) -> ModuleType:
    """The module with `options`, which adds those of the command line, and `main`, which gives the exit code."""
    return import_module(f"validation.{name}")


if __name__ == "__main__":
    sys.exit(main())

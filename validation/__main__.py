"""Run one campaign with ``python -m validation``: print its figures and return exit code 1 if it has findings."""

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
    """Run the campaign that is named on the command line and return its exit code."""
    about = "Campaigns that judge sunspin, most by trying to break it; results: docs/accuracy.md."
    parser = argparse.ArgumentParser(prog="python -m validation", description=about)
    commands = parser.add_subparsers(dest="campaign", required=True)
    for name, about in CAMPAIGNS.items():
        campaign(name).options(commands.add_parser(name, help=about, description=about))
    options = parser.parse_args(arguments)
    return campaign(options.campaign).main(options)


def campaign(name: str) -> ModuleType:
    """Import the module of a campaign. Its `options` adds those of the command line, its `main` returns the exit code."""
    return import_module(f"validation.{name}")


if __name__ == "__main__":
    sys.exit(main())

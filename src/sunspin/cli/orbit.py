"""The options on orbits, of the commands that take elements."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click


def orbit_options(command: Callable) -> Callable:
    """--tle, --omm and --ephemeris, which are one, and --tle-shift-sigma."""
    command = click.option(
        "--tle-shift-sigma",
        "shift_sigma",
        type=click.FloatRange(0, min_open=True),
        help="One sigma of the place along the track, s; default: by the elements' age.",
    )(command)
    return click.option(
        "--tle",
        "--omm",
        "--ephemeris",
        "elements",
        type=click.Path(path_type=Path),
        help="The orbit of the satellite: elements as TLE or OMM, or positions as OEM, CSV or SPK; default: the vehicle file's.",
    )(command)

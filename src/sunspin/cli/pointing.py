"""`sunspin pointing`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sunspin.cli.changes import Command
from sunspin.cli.common import PATH, POSITIVE, Output, shared
from sunspin.cli.values import Parsed, parse_numbers


def parse_axis(text: str, name: str) -> Any:
    """Return a body axis: a name such as "+z", or a vector (3) from three numbers."""
    return parse_numbers(text, name, 3) if "," in text else text


def parse_station(text: str, name: str) -> tuple[str, float, float, float]:
    """Return a ground station from NAME=LATITUDE,LONGITUDE,ALTITUDE (deg, deg, m); without a name it is called station."""
    called, equals, place = text.rpartition("=")
    expected = "latitude and longitude in deg and altitude in m, such as graz=47.07,15.49,490"
    latitude, longitude, altitude = parse_numbers(place, name, 3, expected)
    return called if equals else "station", latitude, longitude, altitude


@click.command(cls=Command)
@click.argument("folder", metavar="RESULT", type=PATH)
@click.option(
    "--axis",
    "axes",
    multiple=True,
    default=("+z",),
    type=Parsed(parse_axis, "AXIS"),
    help="Body axis: +x, -x, +y, -y, +z, -z, or a vector such as 0,0.6,0.8. Repeatable.",
)
@click.option(
    "--station",
    "stations",
    multiple=True,
    type=Parsed(parse_station, "[NAME=]LAT,LON,ALT"),
    help="Ground station: geodetic latitude and longitude (deg, north and east positive) and altitude (m). Repeatable.",
)
@click.option(
    "--step",
    type=POSITIVE,
    help="Interval of the angles in s, along the estimated motion. Default: at the samples.",
)
@shared()
def pointing(
    folder: Path, axes: tuple, stations: tuple, step: float | None, output: Output
) -> None:
    """Compute the angles of body axes to the Sun, nadir, ram (orbital velocity) and ground stations.

    RESULT is a folder that `rates --out` wrote. If it was estimated with an orbit and a magnetometer, all angles are known; else
    the rotation about the Sun direction is free, and only the angle to the Sun is given. Each angle has an error of one sigma.
    Passes that are not decided have no angles. With --out, writes pointing.csv (a row for each sample and axis), pointing.nc and a
    figure.

    \b
    Examples (the second for rates that were estimated with an orbit and a magnetometer):
      sunspin rates vehicle.toml telemetry.csv --out rates
      sunspin pointing rates --axis +z --axis -x --step 5
      sunspin pointing rates --axis +z --station graz=47.07,15.49,490 --out pointing
    """
    from sunspin.output.pointing import pointing as angles

    output.claim()
    output.deliver(angles(folder, axes, stations, step_s=step), main="pointing.csv")

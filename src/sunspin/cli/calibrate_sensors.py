"""`sunspin calibrate-sensors`."""

from __future__ import annotations

import os
from dataclasses import replace

import click

from sunspin.base.errors import OutputError
from sunspin.cli.changes import Command
from sunspin.cli.common import PATH, read_inputs, shared

COPY = "calibrated.toml"
"""Name of the calibrated vehicle file in a results folder."""


@click.command("calibrate-sensors", cls=Command)
@click.argument("vehicle")
@click.argument("telemetry")
@click.option(
    "--out",
    "target",
    type=PATH,
    help="Calibrated copy of the vehicle file (FILE.toml), or a results folder for it. Neither may exist.",
)
@shared("--data", "--tle", "--tle-shift-sigma", out=False)
def calibrate_sensors(vehicle, telemetry, target, elements, shift_sigma, output) -> None:
    """Calibrate panels, Sun sensors, magnetometer and gyro with the telemetry, and write a copy of the vehicle file.

    Panel gains: in sunlight the Sun is equally bright whichever panels are lit. In an orbit the field strength and its angle to the
    Sun are known. They determine bias, soft-iron matrix and scale of the magnetometer, and bias and scale of each Sun sensor. A
    gyro is compared with the rates of passes that are decided without it. Every estimate has a sigma. Values that the data do not
    determine stay as they are. The copy keeps your comments and gives the source of each new value.

    \b
    Example:
      sunspin calibrate-sensors vehicle.toml telemetry.csv --out calibrated.toml
    """
    from sunspin.estimate.calibrate import calibrate_sensors as calibrate
    from sunspin.estimate.calibrate import new_values
    from sunspin.estimate.orbit.judged import orbit_of
    from sunspin.output.folder import write_whole
    from sunspin.vehicle.file import parse_vehicle, read_vehicle_text
    from sunspin.vehicle.rewrite import rewrite_values

    craft, samples = read_inputs(vehicle, telemetry)
    orbit = orbit_of(craft, samples, elements, shift_sigma)
    # --out is the copy itself or a results folder, which gets the copy and all results
    copy, folder = None, None
    if target is not None and target.suffix == ".toml":
        copy = target
    elif target is not None:
        copy, folder = target / COPY, target
    if copy is not None and os.path.lexists(copy):
        raise OutputError("this file is there already", do="choose another --out", where=str(copy))
    output = replace(output, folder=folder)
    output.claim()
    result = calibrate(craft, samples, orbit, progress=output.progress)
    lines = []
    if copy is not None:
        text = rewrite_values(read_vehicle_text(vehicle), new_values(result))
        parse_vehicle(text, str(copy))  # raises an error if the copy could not be read again
        write_whole(copy, text)
        lines = [f"Calibrated copy: {copy}"]
    output.deliver(result, vehicle, samples, lines=lines, main=COPY)

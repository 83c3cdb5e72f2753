"""`sunspin calibrate-sensors`."""

from __future__ import annotations

import os
from pathlib import Path

import click

from sunspin.base.errors import OutputError, sentence
from sunspin.cli.common import claim, data_option, deliver, on_terminal, output_options, read_both
from sunspin.cli.orbit import orbit_options

COPY = "calibrated.toml"
"""The vehicle's copy in a results folder."""


@click.command("calibrate-sensors")
@click.argument("vehicle")
@click.argument("telemetry")
@output_options(out=False)
@data_option
@orbit_options
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="The calibrated copy of the vehicle file (FILE.toml), or a results "
    "folder for it; neither may have one yet.",
)
def calibrate_sensors(vehicle, telemetry, as_json, quiet, data, elements, shift_sigma, out) -> None:
    """Calibrate panels, Sun sensors, magnetometer and gyro by the telemetry itself, and write a copy of the vehicle file.

    Gains of panels come from how bright samples in full Sun are. With orbital elements the strength of the field and its angle to
    the Sun are known, whatever the attitude: they determine zero, matrix and scale of the magnetometer, and bias and scale of each
    Sun sensor. A gyro is compared with the rates of passes that are decided without it. Every number has a sigma; what the file
    does not determine stays as it is. In the copy each new value says where it comes from, and your comments stay.

    \b
    Example:
      sunspin calibrate-sensors vehicle.toml telemetry.csv --out calibrated.toml
    """
    from sunspin.estimate.calibrate.sensors import calibrate_sensors as run
    from sunspin.estimate.calibrate.sensors import new_values
    from sunspin.estimate.orbit.judged import orbit_of
    from sunspin.output.folder import write_whole
    from sunspin.vehicle.file import parse_vehicle, vehicle_text
    from sunspin.vehicle.rewrite import rewritten

    craft, samples = read_both(vehicle, telemetry, data)
    orbit = orbit_of(craft, samples, elements, shift_sigma)
    copy = None if out is None else out if out.suffix == ".toml" else out / COPY
    if copy is not None and os.path.lexists(copy):
        raise OutputError(
            sentence("this file is there already", do="choose another --out", where=str(copy))
        )
    folder = out if copy != out else None
    claim(folder, "calibrate-sensors")
    result = run(craft, samples, orbit, progress=on_terminal(quiet))
    lines = []
    if copy is not None:
        text = rewritten(vehicle_text(vehicle), new_values(result))
        parse_vehicle(text, str(copy))  # what is written can be read
        write_whole(copy, lambda part: part.write_text(text, "utf-8"))
        lines = [f"Calibrated copy: {copy}"]
    deliver(result, folder, as_json, quiet, vehicle, samples, lines=lines, main=COPY)

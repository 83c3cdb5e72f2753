"""`sunspin rates`."""

from __future__ import annotations

import math

import click

from sunspin.cli.common import claim, data_option, deliver, find_telemetry, output_options

UNUSED = {"gyro": "gyro_B", "magnetometer": "field_B", "attitude": "attitude_B_from_N", "wheels": "wheel_speed_rad_s"}
"""What `--without` may name, and the variable that it takes away."""


@click.command()
@click.argument("vehicle")
@click.argument("telemetry")
@output_options()
@data_option
@click.option("--source", type=click.Choice(["panels", "sun_sensor"]), help="Where the Sun comes from; default: what is there.")
@click.option("--max-rate", type=click.FloatRange(0, min_open=True), help="No rate is faster, deg/s; default: the vehicle's, "
              "else one and a half turns in the usual interval.")
@click.option("--noise", type=click.FloatRange(0, min_open=True), help="Angular acceleration noise, rad/s^1.5; default: the "
              "vehicle's, else what the data support best.")
@click.option("--gap", type=click.FloatRange(0, min_open=True), help="A longer gap parts two passes, s; default: six intervals.")
@click.option("--without", multiple=True, type=click.Choice(list(UNUSED)), help="Do not use this sensor; repeatable.")
def rates(vehicle, telemetry, out, as_json, quiet, data, source, max_rate, noise, gap, without) -> None:  # fmt: skip
    """Body rates and attitude history of each pass, from the Sun seen now and then.

    All motions that the data cannot tell apart are listed with their weights: whole turns more or less between samples, mirror
    images. With --out, writes rates.csv, rates.nc, rates.png and rates.svg.

    \b
    Example:
      sunspin rates skcube skcube/skcube_adcs.csv --without gyro --data DIR --out skcube-rates
    """
    from sunspin.cli.check_words import doubts
    from sunspin.estimate.rates.estimate import rates as run
    from sunspin.telemetry.reader import read_telemetry
    from sunspin.vehicle import load_vehicle

    craft = load_vehicle(vehicle)
    samples = read_telemetry(find_telemetry(telemetry, data), craft)
    used = samples.drop_vars([UNUSED[name] for name in without if UNUSED[name] in samples])
    claim(out, "rates")
    result = run(
        craft, used, source=source, max_rate_rad_s=None if max_rate is None else math.radians(max_rate),
        acceleration_noise=noise, gap_s=gap,
    )  # fmt: skip
    about, lines = doubts(craft, used, vehicle)
    doubted = {"wrong_units": about["wrong_units"]} if about["wrong_units"] else {}
    deliver(result, out, as_json, quiet, vehicle, samples, also=doubted, lines=[line for line in lines if "WRONG UNIT" in line])

"""`sunspin rates`."""

from __future__ import annotations

import math
import sys
from contextlib import suppress

import click

from sunspin.base.errors import InputError, printable
from sunspin.cli.changes import Command
from sunspin.cli.common import POSITIVE, read_both, shared
from sunspin.cli.values import Parsed, between, effort, period
from sunspin.vehicle.sensors import VARIABLES

UNUSED = VARIABLES | {"wheels": "wheel_speed_rad_s"}
"""What `--without` may name, and the variable that it takes away."""


@click.command(cls=Command)
@click.argument("vehicle")
@click.argument("telemetry")
@click.option(
    "--source",
    type=click.Choice(["panels", "sun_sensor"]),
    help="Source of the Sun direction. Default: whichever the file contains.",
)
@click.option(
    "--max-rate-deg-s",
    "max_rate",
    type=POSITIVE,
    help="Upper limit of the angular speed in deg/s. Default: from the vehicle file, else 1.5 revolutions per sampling "
    "interval.",
)
@click.option(
    "--acceleration-noise",
    type=POSITIVE,
    help="Angular acceleration noise, rad/s^1.5; default: the "
    "vehicle's, else what the data support best.",
)
@click.option(
    "--gap",
    "gap_s",
    type=POSITIVE,
    help="Gap in s that starts a new pass. Default: six sampling intervals.",
)
@click.option(
    "--pass",
    "pass_id",
    type=click.IntRange(0),
    help="Only this pass, numbered from zero as in passes.csv.",
)
@click.option(
    "--no-column-tests",
    is_flag=True,
    help="Where a pass does not fit, do not try other columns, axes and signs of panels and sensors.",
)
@click.option("--no-orbit", is_flag=True, help="Do not use the orbit of the vehicle file.")
@click.option(
    "--effort",
    type=Parsed(effort, "float"),
    default="1.0",
    help="Computing budget; 1: about a minute and a half of one core, and 0.4 of that for other columns; inf: as much as is "
    "needed. Counted in motions, so that every machine gives the same. A search that was cut short says so and is never decided.",
)
@click.option(
    "--without",
    multiple=True,
    type=click.Choice(list(UNUSED)),
    help="Do not use this sensor; repeatable.",
)
@shared("--from", "--to", "--tle", "--tle-shift-sigma", "--period", "--workers", "--data")
def rates(
    vehicle,
    telemetry,
    max_rate,
    begin,
    end,
    no_column_tests,
    elements,
    shift_sigma,
    no_orbit,
    workers,
    periods,
    without,
    output,
    **estimate,
) -> None:
    """Body rates and attitude history of each pass, from the Sun seen now and then.

    All solutions that the data cannot tell apart are listed with their probabilities: whole turns more or less between samples,
    mirror images; of each pass it is said whether one is left, which components the data constrain, and whether it fits. With
    --out, writes passes.csv (a row for each solution of each pass), rates.csv (a row for each sample), rates.nc, rates.png and
    rates.svg.

    With orbital elements (--tle, --omm, or [orbit] in the vehicle file) shadow, Earth's light and magnetic field are known. The
    telemetry first judges the elements, as `sunspin check` does; refused ones are not used, which is said. A magnetometer is
    then calibrated with the whole file and gives directions, samples without a Sun count, and attitudes are those from J2000.
    Elements of a sister satellite, or old ones, need --tle-shift-sigma: how far off along the track they may be, in s.

    \b
    Examples:
      sunspin rates vehicle.toml telemetry.csv --tle my.tle
      sunspin rates skcube skcube/skcube_adcs.csv --without gyro --data DIR --out skcube-rates
    """
    from sunspin.compute.pool import worker_count
    from sunspin.estimate.orbit.judged import elements_of
    from sunspin.estimate.rates.estimate import rates as run
    from sunspin.output.check.orbit import orbit_used
    from sunspin.telemetry.assess import assess

    craft, samples = read_both(vehicle, telemetry)
    file = assess(craft, samples)
    unused = [UNUSED[name] for name in without if UNUSED[name] in samples]
    whole = begin is None and end is None and not unused
    used = file if whole else assess(craft, between(samples, begin, end).drop_vars(unused))
    evidence = [period(text, samples.attrs.get("epoch_utc")) for text in periods]
    output.claim()
    if no_orbit and (elements is not None or shift_sigma is not None):
        what = "--no-orbit says not to use an orbit, and elements or their shift are given"
        raise InputError(what, do="give one")

    def announce(line: str) -> None:
        with suppress(OSError):  # a log that cannot be written stops no work
            print(f"sunspin: rates: {printable(line)}", file=sys.stderr, flush=True)

    # a terminal shows a progress line in the place of these words
    progress = output.progress if output.quiet or output.progress else announce
    if (
        progress is announce
        and not no_orbit
        and elements_of(craft, elements, shift_sigma) is not None
    ):
        announce(f"{samples.sizes['time']} samples; they judge the elements first")
    known = (None, None, {}, []) if no_orbit else orbit_used(file, elements, shift_sigma)
    orbit, calibration, orbit_summary, orbit_lines = known
    result = run(
        craft,
        used,
        max_rate_rad_s=None if max_rate is None else math.radians(max_rate),
        column_tests=not no_column_tests,
        environment=orbit,
        calibration=calibration,
        periods=evidence,
        workers=worker_count(workers),
        **estimate,
        progress=progress,
    )
    # after the search has begun: to import it takes a third of a second
    from sunspin.output.check.samples import doubts

    about, lines = doubts(used, vehicle)
    doubted = {key: about[key] for key in ("wrong_units", "wrong_axes") if about[key]}
    lines = [*(line for line in lines if "WRONG" in line), *orbit_lines]
    output.deliver(result, vehicle, samples, also=doubted | orbit_summary, lines=lines)

"""`sunspin rates`."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sunspin.base.errors import InputError
from sunspin.cli.changes import Command
from sunspin.cli.common import POSITIVE, read_inputs, shared
from sunspin.cli.values import Parsed, parse_effort, parse_period, select_interval
from sunspin.vehicle.sensors import VARIABLES

if TYPE_CHECKING:
    import xarray as xr

    from sunspin.estimate.periods import PeriodSeen
    from sunspin.output.check.orbit import ChosenOrbit
    from sunspin.telemetry.assess import Assessment
    from sunspin.telemetry.periodicity import Stretch
    from sunspin.telemetry.withheld import Withheld
    from sunspin.vehicle import Vehicle

SENSOR_VARIABLES = VARIABLES | {"wheels": "wheel_speed_rad_s"}
"""Sensors that `--without` may name -> the variable of the telemetry that it removes."""


@click.command(cls=Command)
@click.argument("vehicle")
@click.argument("telemetry")
@click.option(
    "--source",
    type=click.Choice(["panels", "sun_sensor"]),
    help="Source of the Sun direction. Default: sun_sensor if the file has one, else panels.",
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
    help="Density of random angular acceleration (rad/s^1.5), for unmodelled torques. Default: from the vehicle file, else "
    "estimated.",
)
@click.option(
    "--gap", "gap_s", type=POSITIVE, help="Gap that starts a pass, s. Default: 6 median intervals."
)
@click.option(
    "--pass", "pass_id", type=click.IntRange(0), help="Only this pass, numbered as in passes.csv."
)
@click.option(
    "--no-column-tests",
    is_flag=True,
    help="Do not test swapped columns or signs on a poor fit, or on one that may hide them.",
)
@click.option(
    "--no-windows", is_flag=True, help="Do not estimate the rate in short windows on a poor fit."
)
@click.option("--no-orbit", is_flag=True, help="Do not use the orbit of the vehicle file.")
@click.option(
    "--effort",
    type=Parsed(parse_effort, "float"),
    default="1.0",
    help="Computing budget of each pass, in fitted motions: 1 is enough for nearly all passes, inf is unlimited. Results do "
    "not depend on the machine's speed. A pass whose search is incomplete is not decided.",
)
@click.option(
    "--without",
    multiple=True,
    type=click.Choice(list(SENSOR_VARIABLES)),
    help="Sensor not used. Repeatable.",
)
@click.option(
    "--compare",
    "compared",
    multiple=True,
    metavar="SENSOR|COLUMNS",
    help="Compare the result with a sensor that is not used: gyro or attitude of the vehicle file, which is then withheld. Or give "
    "columns such as wx,wy,wz:deg/s+-0.05 or q0,q1,q2,q3:first,N_to_B+-1 (scalar first or last; sigma in deg). Once for rates and "
    "once for an attitude.",
)
@shared("--from", "--to", "--tle", "--tle-shift-sigma", "--period", "--workers", "--data")
def rates(
    vehicle,
    telemetry,
    max_rate,
    begin,
    end,
    no_column_tests,
    no_windows,
    elements,
    shift_sigma,
    no_orbit,
    workers,
    periods,
    without,
    compared,
    output,
    **settings,
) -> None:
    """Estimate body rates and attitude of each pass from Sun directions and other sensors.

    All solutions that the data cannot distinguish are listed with their probabilities: aliases with more or fewer whole
    revolutions between samples, and mirror solutions. A pass is decided if one solution remains, the data constrain all rate
    components, it fits, and the search is complete. With --out, writes passes.csv (a row for each solution), rates.csv (a row for
    each sample), rates.nc and figures.

    With an orbit (--tle, --omm, --ephemeris, or [orbit] in the vehicle file) eclipses, Earth albedo and magnetic field are known.
    The elements are first compared with the telemetry, as `sunspin check` does. If they do not fit, they are not used. If they
    fit, the magnetometer is calibrated, samples in eclipse are used too, and attitudes are relative to J2000. Old elements, or
    those of a sister satellite, need --tle-shift-sigma.

    \b
    Examples (the second with the built-in vehicle skcube, and telemetry in the folder DIR):
      sunspin rates vehicle.toml telemetry.csv --tle my.tle
      sunspin rates skcube skcube/skcube_adcs.csv --compare gyro --data DIR --out skcube-rates
    """
    if output.progress:  # on a terminal, before the imports, which take longer than a short pass
        output.announce(f"reading {telemetry.name}")
    output.draw_in_background("rates", workers)
    from sunspin.compute.pool import worker_count
    from sunspin.estimate.columns import undecided
    from sunspin.estimate.orbit.judged import orbit_sources
    from sunspin.estimate.rates import rates as estimate_rates
    from sunspin.estimate.short_windows import passes_for_windows, rates_in_windows
    from sunspin.output.check.orbit import ChosenOrbit, choose_orbit
    from sunspin.telemetry.assess import assess

    craft, samples = read_inputs(vehicle, telemetry)
    withheld = _read_withheld(compared, without, craft, samples, telemetry)
    # neither the orbit nor the rates may depend on a sensor with which they are compared
    declared = [VARIABLES[name] for name in compared if name in VARIABLES]
    samples_used = samples.drop_vars(declared, errors="ignore")
    # The orbit is judged from the whole file, the rates are estimated from the part that is used.
    whole_file = assess(craft, samples_used)
    left_out = [
        SENSOR_VARIABLES[name] for name in without if SENSOR_VARIABLES[name] in samples_used
    ]
    if begin is None and end is None and not left_out:
        used = whole_file
    else:
        used = assess(craft, select_interval(samples_used, begin, end).drop_vars(left_out))
    limit = None if max_rate is None else math.radians(max_rate)
    observed_periods, of_columns = _read_periods(periods, telemetry, used, limit)
    output.claim()
    if no_orbit and (elements is not None or shift_sigma is not None):
        what = "--no-orbit contradicts the elements or their shift that are given"
        raise InputError(what, do="give one")

    # a terminal shows a progress bar instead of lines
    in_lines = not (output.quiet or output.progress)
    progress = output.announce if in_lines else output.progress
    chosen_orbit = ChosenOrbit(None, None, {}, [])
    if not no_orbit:
        if in_lines and orbit_sources(craft, elements, shift_sigma) is not None:
            output.announce(f"{samples.sizes['time']} samples; the elements are checked first")
        chosen_orbit = choose_orbit(whole_file, elements, shift_sigma)
        if chosen_orbit.orbit is None and chosen_orbit.summary and in_lines:
            output.announce("the elements do not fit the telemetry; continuing without the orbit")
    surroundings: dict[str, Any] = {
        "max_rate_rad_s": limit,
        "environment": chosen_orbit.orbit,
        "calibration": chosen_orbit.calibration,
        "workers": worker_count(workers),
    }
    result = estimate_rates(
        craft,
        used,
        column_tests=not no_column_tests,
        periods=observed_periods,
        progress=progress,
        **surroundings,
        **settings,
    )
    if not no_windows and len(passes_for_windows(result)):
        output.announce("no motion fits all passes; the rate is estimated in short windows")
        also_given = {key: settings[key] for key in ("source", "acceleration_noise", "effort")}
        result = rates_in_windows(craft, used.telemetry, result, **surroundings, **also_given)
    if chosen_orbit.field_and_sun_disagree:
        result = undecided(result, "field and Sun disagree")
    # imported late, because the imports take a third of a second, most of it that of the orbit at the samples
    from sunspin.output.compared import compare_with

    if chosen_orbit.orbit is not None:
        from sunspin.output.pointing import with_track

        result = with_track(result, chosen_orbit.orbit)
    for sensor, values in withheld:
        result = compare_with(result, sensor, values)
    lines, also = _describe_inputs(used, vehicle, chosen_orbit, of_columns, result.attrs["source"])
    output.deliver(result, vehicle, samples, also=also, lines=lines)


def _read_withheld(
    compared: tuple[str, ...],
    without: tuple[str, ...],
    craft: Vehicle,
    samples: xr.Dataset,
    telemetry: Path,
) -> list[tuple[Withheld, xr.DataArray]]:
    """Return the sensors that `--compare` names, each with its readings; at most one of rates and one of attitudes."""
    from sunspin.telemetry.withheld import parse_withheld, read_withheld

    withheld = [parse_withheld(text, craft, without) for text in compared]
    if len({sensor.variable for sensor in withheld}) < len(withheld):
        what, do = "--compare is given twice for rates or for an attitude", "give it once for each"
        raise InputError(what, got=" ".join(compared), do=do)
    return [
        (
            sensor,
            samples[sensor.variable]
            if text in VARIABLES and sensor.variable in samples
            else read_withheld(sensor, craft, telemetry),
        )
        for text, sensor in zip(compared, withheld, strict=True)
    ]


def _read_periods(
    texts: tuple[str, ...], telemetry: Path, used: Assessment, max_rate_rad_s: float | None
) -> tuple[list[PeriodSeen], dict[str, list[Stretch]]]:
    """Return all periods that `--period` gives, and what each stretch of each column that it names shows.

    A period in numbers has a time or an error ("48.3+-1@102"); any other text names a column.
    """
    from sunspin.telemetry.column_periods import read_column_periods

    epoch = used.telemetry.attrs.get("epoch_utc")
    in_numbers = [text for text in texts if "@" in text or "+-" in text]
    observed = [parse_period(text, epoch) for text in in_numbers]
    of_columns: dict[str, list[Stretch]] = {}
    if columns := [text for text in texts if text not in in_numbers]:
        time = used.telemetry["time"].values
        kept = float(time.min()), float(time.max())  # rows that came late need not be in order
        of_columns = read_column_periods(telemetry, used.vehicle, columns, max_rate_rad_s, kept)
    stretches = [one for each in of_columns.values() for one in each]
    return observed + [one.found for one in stretches if one.found is not None], of_columns


def _describe_inputs(
    used: Assessment,
    vehicle: str,
    chosen_orbit: ChosenOrbit,
    of_columns: dict[str, list[Stretch]],
    source: str,
) -> tuple[list[str], dict[str, Any]]:
    """Return what is printed of the telemetry, the orbit and the periods, and the same as entries of the summary.

    Of the readings that contradict the vehicle file only wrong units and axes are named, which make the rates wrong. `source`: of
    the directions to the Sun.
    """
    from sunspin.output.check.repeats import describe_repeats
    from sunspin.output.check.samples import describe_mismatches, unknown_gain_lines
    from sunspin.output.text import clock_text
    from sunspin.telemetry.column_periods import describe_periods

    mismatches, repeats = describe_mismatches(used, vehicle), describe_repeats(used)
    keys = [key for key in ("wrong_units", "wrong_axes") if mismatches.summary[key]]
    also = {key: mismatches.summary[key] for key in keys} | repeats.summary | chosen_orbit.summary
    wrong = [line for line in mismatches.lines if "WRONG" in line]
    gains = unknown_gain_lines(used) if used.has_panels and source == "panels" else []
    seen = describe_periods(of_columns, partial(clock_text, used.telemetry))
    return [*wrong, *gains, *repeats.lines, *chosen_orbit.lines, *seen], also

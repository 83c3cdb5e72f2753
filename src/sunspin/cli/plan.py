"""`sunspin plan`."""

from __future__ import annotations

import math

import click

from sunspin.base.errors import InputError, Interrupted
from sunspin.cli.changes import Command
from sunspin.cli.common import POSITIVE, shared
from sunspin.cli.interruption import accept_interruption
from sunspin.cli.values import parse_numbers

ROUNDS_SHOWN = (1, 3, 10, 30, 100, 300, 1000, 3000)
"""Rounds after which the table so far is printed."""


@click.command(cls=Command)
@click.argument("vehicle")
@click.option(
    "--every",
    default="10,30,60",
    show_default=True,
    metavar="S,S,...",
    help="Intervals between samples, s, comma-separated.",
)
@click.option(
    "--samples",
    type=click.IntRange(3, 10_000),
    default=20,
    help="Samples of a pass.",
    show_default=True,
)
@click.option(
    "--max-rate-deg-s",
    "max_rate",
    type=POSITIVE,
    default=5.0,
    show_default=True,
    help="Largest speed, deg/s: speeds are drawn evenly below it, and the search goes up to it.",
)
@click.option(
    "--passes",
    type=click.IntRange(1, 10_000),
    default=9,
    help="Passes of each interval.",
    show_default=True,
)
@click.option(
    "--bits",
    type=click.IntRange(1, 32),
    help="Bits of the converter that reads the panels. Default: readings without steps.",
)
@click.option("--no-orbit", is_flag=True, help="Do not use the orbit of the vehicle file.")
@shared("--tle", "--seed", "--workers")
def plan(
    vehicle,
    every,
    samples,
    max_rate,
    passes,
    bits,
    no_orbit,
    elements,
    seed,
    workers,
    output,
) -> None:
    """Find out before launch which beacon decides which rates: simulated passes, estimated as real ones.

    A pass has the panels of the vehicle file. Their gains have errors of 5 %, and the Earth lights them too. Readings have the
    noise that the file states, or 2 %. The body turns freely about a random axis. The table has three classes of speeds for each
    interval. It counts the decided passes and those that are decided and wrong, and says why most are not decided. A pass takes
    some 5 s of processor time. The result so far is shown during the work. Ctrl-C keeps the complete rounds.

    \b
    Example:
      sunspin plan vehicle.toml --every 10,60 --samples 12 --max-rate-deg-s 3 --passes 1
      sunspin plan vehicle.toml --every 10,30,60 --bits 8 --tle my.tle --passes 30 --out beacons
    """
    from sunspin.compute.pool import worker_count
    from sunspin.estimate.orbit.judged import orbit_sources
    from sunspin.output.kinds.plan import plan_summary
    from sunspin.planning import plan as plan_beacons
    from sunspin.vehicle import load_vehicle

    if no_orbit and elements is not None:
        what = "--no-orbit contradicts the elements that are given"
        raise InputError(what, do="give one")
    craft = load_vehicle(vehicle)
    intervals = parse_numbers(every, "--every", expected="intervals in s, such as 10,30,60")
    output.claim()

    def report(so_far) -> None:
        """Print on standard error how far the work is; after those of `ROUNDS_SHOWN` also the table so far."""
        done = int(so_far["passes"].sum()) // so_far.sizes["every"]
        lines = [f"round {done} of {passes}"]
        if done in ROUNDS_SHOWN and done < passes:
            lines += plan_summary(so_far).lines[1:]
        output.announce("\n".join(lines))

    result = plan_beacons(
        craft,
        intervals,
        samples=samples,
        max_rate_rad_s=math.radians(max_rate),
        passes=passes,
        bits=bits,
        orbit=() if no_orbit else orbit_sources(craft, elements) or (),
        seed=seed,
        workers=worker_count(workers),
        after_round=None if output.quiet else report,
    )
    accept_interruption()
    output.deliver(result, vehicle, main="plan.csv")
    if result.attrs["interrupted"]:
        done = int(result["passes"].sum()) // result.sizes["every"]
        kept = "printed" if output.folder is None else f"kept in {output.folder}"
        raise Interrupted(f"interrupted, {done} of {passes} rounds are complete and {kept}")

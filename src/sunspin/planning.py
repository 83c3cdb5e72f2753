"""What a beacon will tell: passes of a spacecraft are simulated before launch and estimated as real ones. All is synthetic."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, SunspinError
from sunspin.base.provenance import provenance, with_units
from sunspin.compute.pool import process_pool
from sunspin.environment.orbit import Source
from sunspin.estimate.observe import middle_sample
from sunspin.estimate.rates import rates
from sunspin.estimate.synthetic import SimulatedPass, simulate_pass
from sunspin.telemetry.synthetic import TIME_STEP_S, generator
from sunspin.vehicle import Vehicle

SPEED_CLASSES = 3
"""Parts of equal width into which the speeds up to the largest are divided."""

WRONG_SIGMAS, WRONG_RAD_S, WRONG_PART = 5.0, np.radians(0.1), 0.2
"""A decided rate is wrong if a component misses the truth by more than so many sigma, and by more than so much: rad/s, or for slow
bodies this part of the speed."""

LISTED = 1e-3
"""Least probability of a solution that counts as one of the aliases."""


@dataclass(frozen=True)
class PassSetup:
    """How passes are simulated.

    `samples`: samples of a pass; `max_rate_rad_s`: largest speed of a body, and of the search; `bits`: of the converter whose range
    is 1.2 times full Sun, None for one without steps; `orbit`: elements or a table of positions, empty without an orbit.
    """

    vehicle: Vehicle
    samples: int
    max_rate_rad_s: float
    bits: int | None = None
    orbit: tuple[Source, ...] = ()
    seed: int = 0


class PlannedPass(NamedTuple):
    """What became of a simulated pass: its interval (s), the true speed (rad/s), and what `rates` said.

    `sigma`: largest one-sigma error of a component of the rate (rad/s), NaN without a result; `aliases`: number of other solutions;
    `why`: why it is not decided, empty if it is.
    """

    every_s: float
    speed: float
    decided: bool
    wrong: bool
    sigma: float
    aliases: int
    why: str


def plan(
    vehicle: Vehicle,
    every_s: Sequence[float],
    *,
    samples: int = 20,
    max_rate_rad_s: float,
    passes: int = 9,
    bits: int | None = None,
    orbit: tuple[Source, ...] = (),
    seed: int = 0,
    workers: int = 1,
    after_round: Callable[[xr.Dataset], None] | None = None,
) -> xr.Dataset:
    """Simulate passes for each interval between samples and estimate their rates: which beacon decides which rates?

    The panels alone are simulated, with noise, errors of the gains, the light of the Earth and steps of the converter. The bodies
    turn without torques, their wheels at the nominal speed. The first round has one pass for each interval, the next another one.

    Parameters
    ----------
    every_s : sequence of float
        Intervals between samples, s.
    samples : int
        Samples of a pass.
    max_rate_rad_s : float
        Largest speed of the body, rad/s: the speeds of the passes lie evenly below it, and the search goes up to it.
    passes : int
        Passes of each interval.
    bits : int, optional
        Bits of the converter of the readings; without them readings have no steps.
    orbit : tuple of element sets or tables of positions, optional
        As `sunspin.environment.ephemeris.read_orbit` returns them. Eclipses and the light of the Earth are then those of the orbit.
    seed : int
        The same seed gives the same passes.
    workers : int
        Processes that estimate passes side by side. The result does not depend on it.
    after_round : function, optional
        Called with the result so far after each round.

    Returns
    -------
    xarray.Dataset
        On `pass`: what became of each pass. On `every` and `speed_class`: passes, shares, errors, and the commonest reason.
        attrs: `interrupted` is 1 if Ctrl-C or an error ended the work; then the complete rounds count.

    Raises
    ------
    InputError
        Intervals, samples, passes or bits that make no sense.
    """
    known = _with_gains_known(vehicle)
    setup = PassSetup(known, samples, max_rate_rad_s, bits, tuple(orbit), seed)
    intervals = _checked(setup, every_s, passes)
    vehicle.require_panels()
    tasks = [(round_, k) for round_ in range(passes) for k in range(len(intervals))]
    rows: list[PlannedPass] = []
    judge = partial(_judge, setup, intervals)
    try:
        with process_pool(min(workers, len(tasks))) as pool:
            for row in (map if pool is None else pool.map)(judge, tasks):
                rows.append(row)
                if after_round is not None and len(rows) % len(intervals) == 0:
                    after_round(_collect(setup, intervals, rows))
    except (
        KeyboardInterrupt,
        SunspinError,
    ):  # of an error too the complete rounds are worth something
        rows = rows[: len(rows) // len(intervals) * len(intervals)]
        if not rows:
            raise
    return _collect(setup, intervals, rows, interrupted=len(rows) < len(tasks))


def _with_gains_known(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle with its relative gains taken as known: a single simulated pass need not show every panel."""
    gains = {f"panel.{panel.name}.relative_gain" for panel in vehicle.panels}
    facts = {key: fact for key, fact in vehicle.facts.items() if key not in gains}
    return replace(vehicle, facts=facts)


def _checked(setup: PassSetup, every_s: Sequence[float], passes: int) -> list[float]:
    """Return the intervals (s), each once and in order; raise `InputError` if an argument of `plan` makes no sense."""
    intervals = sorted(set(map(float, every_s)))
    if not intervals or not all(10 * TIME_STEP_S <= each < 86400 for each in intervals):
        raise InputError(
            f"intervals must lie between {10 * TIME_STEP_S:g} s and a day", got=list(every_s)
        )
    if setup.samples < 3:
        raise InputError("a pass needs at least three samples", got=setup.samples)
    if passes < 1:
        raise InputError("each interval needs at least one pass", got=passes)
    if not 0 < setup.max_rate_rad_s < np.inf:
        raise InputError("the largest rate must be positive", got=setup.max_rate_rad_s)
    if setup.bits is not None and not 1 <= setup.bits <= 32:
        raise InputError("a converter has 1 to 32 bits", got=setup.bits)
    return intervals


def _judge(setup: PassSetup, intervals: Sequence[float], task: tuple[int, int]) -> PlannedPass:
    """Simulate one pass, estimate its rates, and return what became of it. `task`: its round, and the place of its interval."""
    round_, k = task
    rng = generator(setup.seed, k, round_)
    # the middle class first: a first round says what most passes would
    part = (round_ + SPEED_CLASSES // 2) % SPEED_CLASSES
    speed = (part + rng.uniform()) / SPEED_CLASSES * setup.max_rate_rad_s
    try:
        simulated = simulate_pass(
            setup.vehicle,
            np.arange(setup.samples) * intervals[k],
            speed,
            rng,
            bits=setup.bits,
            orbit=setup.orbit,
        )
        result = rates(
            setup.vehicle,
            simulated.telemetry,
            max_rate_rad_s=setup.max_rate_rad_s,
            environment=simulated.environment,
            # a simulated file has the columns of its vehicle
            column_tests=False,
        )
    except SunspinError as error:
        return PlannedPass(intervals[k], speed, False, False, np.nan, 0, str(error).splitlines()[0])
    return _row_of(result, simulated, intervals[k], speed)


def _row_of(
    result: xr.Dataset, simulated: SimulatedPass, every_s: float, speed: float
) -> PlannedPass:
    """Return what became of a pass of true rates, at the sample nearest to its middle.

    `rates` may part it, at an eclipse or as it is too long: then the part with the most samples counts.
    """
    parts = result["pass_of"].values
    longest = int(np.bincount(parts).argmax())
    first, t = result.isel(pass_id=longest), result["time"].values[parts == longest]
    middle = t[middle_sample(t)]
    truth = simulated.omega_B[np.argmin(np.abs(simulated.telemetry["time"].values - middle))]
    omega, sigma = (
        np.array([float(first[f"{name}_{axis}"].values[0]) for axis in "xyz"])
        for name in ("omega", "sigma")
    )
    miss = np.abs(omega - truth)
    least = min(WRONG_RAD_S, WRONG_PART * float(np.linalg.norm(truth)))
    decided = bool(first["decided"].values)
    wrong = decided and bool(((miss > WRONG_SIGMAS * sigma) & (miss > least)).any())
    aliases = int((np.nan_to_num(first["probability"].values) > LISTED).sum()) - 1
    why = "" if decided else str(first["why_not_decided"].values)
    return PlannedPass(every_s, speed, decided, wrong, float(sigma.max()), aliases, why)


def _collect(
    setup: PassSetup,
    intervals: Sequence[float],
    rows: Sequence[PlannedPass],
    interrupted: bool = False,
) -> xr.Dataset:
    """Return the Dataset of `plan` from the rows of its passes."""
    shape = (len(intervals), SPEED_CLASSES)
    table = {
        name: np.zeros(shape, dtype=np.int64) for name in ("passes", "decided", "decided_wrong")
    }
    sigma, aliases = np.full(shape, np.nan), np.full(shape, np.nan)
    reason = np.full(shape, "", dtype=object)
    width = setup.max_rate_rad_s / SPEED_CLASSES
    for k, every in enumerate(intervals):
        for part in range(SPEED_CLASSES):
            here = [
                row
                for row in rows
                if row.every_s == every and min(int(row.speed / width), SPEED_CLASSES - 1) == part
            ]
            if not here:
                continue
            table["passes"][k, part] = len(here)
            table["decided"][k, part] = sum(row.decided for row in here)
            table["decided_wrong"][k, part] = sum(row.wrong for row in here)
            right = [row.sigma for row in here if row.decided and not row.wrong]
            sigma[k, part] = np.median(right) if right else np.nan
            aliases[k, part] = np.mean([row.aliases for row in here])
            open_still = Counter(row.why for row in here if not row.decided)
            reason[k, part] = open_still.most_common(1)[0][0] if open_still else ""
    of_pass: dict[str, Any] = {
        f"pass_{name}": ("pass", np.array([getattr(row, name) for row in rows]))
        for name in PlannedPass._fields
    }
    cell = ("every", "speed_class")
    return with_units(
        xr.Dataset(
            {name: (cell, values) for name, values in table.items()}
            | {
                "rate_sigma": (cell, sigma),
                "aliases": (cell, aliases),
                "why_not_decided": (cell, reason.astype(np.str_)),
                "class_high": ("speed_class", width * np.arange(1, SPEED_CLASSES + 1)),
            }
            | of_pass,
            coords={"every": intervals},
            attrs=provenance(
                "plan",
                vehicle=setup.vehicle.name,
                samples=setup.samples,
                max_rate_rad_s=setup.max_rate_rad_s,
                bits=0 if setup.bits is None else setup.bits,
                in_orbit=int(bool(setup.orbit)),
                seed=setup.seed,
                interrupted=int(interrupted),
                synthetic=1,
            ),
        )
    )

"""Wheel strategies compared run by run, the best delay of switching off, and the stop of a wheel at rest on the ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.dynamics.batch import OUTCOME_TEXT, Outcome
from sunspin.dynamics.friction import spin_down_time
from sunspin.landing.outcomes import default_scenario, outcomes
from sunspin.landing.scenario import Scenario, delayed_switch_off, parse_strategy
from sunspin.landing.tally import Estimate, estimate, per_run, tally
from sunspin.vehicle import Vehicle

STRATEGIES = ("off", "held", "delay:1200", "delay:3000", "brake", "after_rest")
"""Strategies that are compared by default."""

DELAYS_S = (0.0, 300.0, 600.0, 1200.0, 1800.0, 2400.0, 3000.0, 3600.0, 4500.0, 5400.0, 6300.0)
"""Delays (s after the touchdown) that are compared by default, if the flight is longer."""

LEVELS = (0.05, 0.5, 0.95)
"""Quantiles over runs."""

BOOTSTRAP = 400
"""Number of resamplings of the runs for the spread of the best delay."""


def compare(
    vehicle: Vehicle,
    candidates: Any,
    strategies: Sequence[Any] = STRATEGIES,
    n: int = 20_000,
    seed: int = 0,
    scenario: Scenario | None = None,
    **options: Any,
) -> tuple[xr.Dataset, dict[str, xr.Dataset]]:
    """Compute the outcomes of several strategies on the same draws, and their differences from the first.

    Parameters
    ----------
    candidates, n, seed, scenario
        As for :func:`sunspin.landing.outcomes.outcomes`.
    strategies : sequence
        Names, schedules or `Strategy` objects.
    options
        Other options of `outcomes`; each schedule has its own folder in `store`.

    Returns
    -------
    xarray.Dataset
        `value` and `error` over (strategy, quantity), quantities as in :func:`sunspin.landing.tally.per_run`; `quantile` over
        runs at `LEVELS`; `gain` and `gain_error`: mean difference from the first strategy, run by run, so that the variation
        common to both cancels.
    dict
        Name of each strategy -> its runs.
    """
    store = options.pop("store", None)
    runs: dict[str, xr.Dataset] = {}  # by the name of the strategy
    runs_of_schedule: dict[str, xr.Dataset] = {}  # two strategies may differ on the ground only
    for strategy in [parse_strategy(vehicle, each) for each in strategies]:
        name, schedule = strategy.name, repr(strategy.schedule)
        if schedule not in runs_of_schedule:
            folder = None if store is None else Path(store) / name.replace(":", "-")
            runs_of_schedule[schedule] = outcomes(
                vehicle,
                candidates,
                strategy,
                n,
                seed,
                scenario=scenario,
                store=folder,
                **options,
            )
        runs[name] = runs_of_schedule[schedule].assign_attrs(strategy=name)
        outcome = runs[name]["outcome"].values
        if np.all(outcome != 0):
            why = "; ".join(OUTCOME_TEXT[Outcome(code)] for code in np.unique(outcome))
            raise InputError(f"no run of the strategy {name!r} could be computed", got=why)
    values = [per_run(of_strategy) for of_strategy in runs.values()]
    tallies = [tally(of_strategy) for of_strategy in runs.values()]
    # the quantities that are known for the first strategy
    quantities, unknown = list(tallies[0]), Estimate(np.nan, np.nan)
    # (strategy, quantity, 2): value and error
    means = np.array([[each.get(name, unknown) for name in quantities] for each in tallies])
    gains = np.array(
        [[estimate(each[name] - values[0][name]) for name in quantities] for each in values]
    )
    quantiles = np.full((len(runs), len(quantities), len(LEVELS)), np.nan)
    for i, each in enumerate(values):
        for j, name in enumerate(quantities):
            if np.isfinite(each[name]).any():
                quantiles[i, j] = np.quantile(each[name][np.isfinite(each[name])], LEVELS)
    dims = ("strategy", "quantity")
    table = xr.Dataset(
        {
            "value": (dims, means[..., 0]),
            "error": (dims, means[..., 1]),
            "quantile": ((*dims, "level"), quantiles),
            "gain": (dims, gains[..., 0]),
            "gain_error": (dims, gains[..., 1]),
        },
        coords={"strategy": list(runs), "quantity": quantities, "level": list(LEVELS)},
        attrs=next(iter(runs.values())).attrs
        | {"kind": "strategies", "strategy": "compared", "runs": n},
    )
    return table, runs


def comparison_tree(
    table: xr.Dataset,
    runs: Mapping[str, xr.Dataset],
    collision: xr.Dataset | None = None,
) -> xr.DataTree:
    """Return both results of :func:`compare` as one tree: `strategies`, and `runs` with a node for each strategy.

    `collision` (optional) becomes a node of its own: runs weighted by the known speeds of the collision.
    """
    nodes = {"strategies": table} | {f"runs/{name}": run for name, run in runs.items()}
    nodes |= {} if collision is None else {"collision": collision}
    return xr.DataTree.from_dict(
        {"/": xr.Dataset(attrs=table.attrs | {"kind": "landing"}), **nodes}
    )


def best_delay(
    vehicle: Vehicle,
    candidates: Any,
    delays_s: Sequence[float] | None = None,
    metric: str = "touch_leg",
    n: int = 10_000,
    seed: int = 0,
    scenario: Scenario | None = None,
    **options: Any,
) -> xr.Dataset:
    """Find the delay of switching off the wheels (s after the touchdown) with the largest mean of `metric`, and its uncertainty.

    `metric`: a quantity of :func:`sunspin.landing.tally.per_run`. `delays_s`: by default :data:`DELAYS_S`, or as many even ones if
    the landing comes before the last of these. All delays are computed on the same draws. The uncertainty is that of the draws, not
    of the models (vertical, terrain, hull). The largest of many noisy means is biased upward; use `as_good` instead of `value`.

    Returns
    -------
    xarray.Dataset
        The table of :func:`compare` with a strategy for each delay, `delay_s (strategy)`; `behind` and `behind_error (strategy)`:
        mean of `metric` less that at the best delay, and its standard error; `as_good (strategy)`: not behind by more than two
        errors. `attrs`: `metric`, `best_s`, and `spread_s`, 16 and 84 % quantiles of the best delay over resampled runs.

    Raises
    ------
    InputError
        The vehicle has no wheel, or no run determines `metric` at all delays.
    """
    if not vehicle.wheels:
        raise InputError(f"vehicle {vehicle.name!r} has no wheel to switch off")
    scenario = scenario or default_scenario(vehicle)
    if delays_s is None:
        # even delays if the usual ones do not all fit before the landing
        even = np.linspace(0.0, scenario.landing_s, len(DELAYS_S), endpoint=False).round(1).tolist()
        delays_s = DELAYS_S if scenario.landing_s > DELAYS_S[-1] else even
    table, runs = compare(
        vehicle, candidates, [delayed_switch_off(t) for t in delays_s], n, seed, scenario, **options
    )
    of_delays = [per_run(of_delay) for of_delay in runs.values()]

    def known_values(quantity: str) -> np.ndarray:
        """Return the values (delay, run) of a quantity, of the runs in which it is known at all delays."""
        values = np.array([each.get(quantity, np.full(n, np.nan)) for each in of_delays])
        return values[:, np.isfinite(values).all(axis=0)]

    values = known_values(metric)
    if not values.size:
        what = "these runs do not tell the quantity to be made largest"
        known = [name for name in table["quantity"].values if known_values(name).size]
        raise InputError(what, got=metric, do=f"known: {', '.join(known)}")
    best = int(np.argmax(values.mean(axis=1)))
    behind, error = np.array([estimate(row - values[best]) for row in values]).T
    delays = np.array(delays_s, dtype=np.float64)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(n, len(delays))))
    # bootstrap: the best delay of runs that are drawn again with replacement
    n_known = values.shape[1]
    resampled_best = [
        delays[np.argmax(values[:, rng.integers(n_known, size=n_known)].mean(axis=1))]
        for _ in range(BOOTSTRAP)
    ]
    low, high = np.quantile(resampled_best, [0.16, 0.84], method="nearest")
    return (
        table.assign(
            behind=("strategy", behind),
            behind_error=("strategy", error),
            as_good=("strategy", behind >= -2 * error),
        )
        .assign_coords(delay_s=("strategy", delays, {"units": "s"}))
        .assign_attrs(metric=metric, best_s=float(delays[best]), spread_s=[float(low), float(high)])
    )


def wheel_stop_at_rest(vehicle: Vehicle, gravity_m_s2: float) -> list[dict[str, Any]]:
    """Return the friction at the feet that holds the body at rest while a wheel stops (paper, section 4).

    Returns
    -------
    list of dict
        One for each wheel and way to stop it ("off", or "brake" if there is one). Torque (N m) of the law mu0 + mu1 W (eq. 5), with
        the brake if it is used; angular momentum (N m s) that passes to the ground; force at each foot (N), torque / (number of
        feet * mean |l|) as in the paper; weight per foot (N); the necessary coefficient of friction; time to stop (s).
    """
    if not vehicle.legs:
        raise InputError(f"vehicle {vehicle.name!r} has no legs to stand on")
    feet = len(vehicle.legs)
    lever = float(np.mean([np.linalg.norm(leg.tip_B_m) for leg in vehicle.legs]))
    weight = vehicle.require_mass() * gravity_m_s2 / feet  # N, of each foot
    lines = []
    for wheel in vehicle.wheels:
        speed, inertia, brake = abs(wheel.speed_rad_s), wheel.inertia_kg_m2, wheel.brake_torque_N_m
        friction = wheel.friction.coulomb_N_m + wheel.friction.viscous_N_m_s * speed
        # way -> torque (N m) and time to stop (s); the time with the brake neglects friction
        ways = {"off": (friction, spin_down_time(wheel.friction, inertia, wheel.speed_rad_s))}
        if brake is not None:
            ways["brake"] = (friction + brake, inertia * speed / brake)
        for way, (torque, time) in ways.items():
            force = torque / (feet * lever)
            line = {
                "wheel": wheel.name,
                "way": way,
                "torque_N_m": torque,
                "momentum_N_m_s": inertia * speed,
                "foot_force_N": force,
                "weight_per_foot_N": weight,
                "friction_coefficient": force / weight,
                "stop_s": float(time),
            }
            lines.append(line)
    return lines

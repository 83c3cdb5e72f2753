"""What the wheel should have done: strategies compared run by run, the best delay, and whether it may stop on the ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.dynamics.ensemble import OUTCOME_TEXT, Outcome
from sunspin.dynamics.friction import spin_down_time
from sunspin.landing.outcomes import outcomes, own_scenario
from sunspin.landing.scenario import Scenario, delayed, strategy_of
from sunspin.landing.tally import Estimate, estimate, per_run, tally
from sunspin.vehicle import Vehicle

STRATEGIES = ("off", "held", "delay:1200", "delay:3000", "brake", "after_rest")
DELAYS_S = (0.0, 300.0, 600.0, 1200.0, 1800.0, 2400.0, 3000.0, 3600.0, 4500.0, 5400.0, 6300.0)
LEVELS = (0.05, 0.5, 0.95)
TABLE = (
    "touch_leg",
    "touch_panel",
    "touch_body",
    "rest_leg",
    "rest_panel",
    "leg_tip_speed",
    "contact_speed",
    "antenna_share",
    "antenna_at_contact",
    "antenna_at_rest",
    "rz_time_below_0",
    "rz_time_below_-0.5",
    "rz_ever_below_-0.5",
    "rate_before",
    "rate_after",
)
"""Quantities of a printed comparison."""

BOOTSTRAP = 400
"""Resamplings of the runs for the spread of the best delay."""


def compare(
    vehicle: Vehicle,
    candidates: Any,
    strategies: Sequence[Any] = STRATEGIES,
    n: int = 20_000,
    seed: int = 0,
    scenario: Scenario | None = None,
    **options: Any,
) -> tuple[xr.Dataset, dict[str, xr.Dataset]]:
    """Strategies on the same draws.

    Parameters
    ----------
    options
        Of :func:`sunspin.landing.outcomes.outcomes`; a `store` gets a folder in it for each strategy.

    Returns
    -------
    xarray.Dataset
        `value` and `error` over (strategy, quantity), quantities as in :func:`sunspin.landing.tally.per_run`; `quantile` over
        runs at `LEVELS`; `gain` and `gain_error`: difference from the first strategy, run by run, so that what both share cancels.
    dict
        The runs of each strategy by its name.
    """
    runs, store = {}, options.pop("store", None)
    for strategy in strategies:
        name = strategy_of(vehicle, strategy).name
        own = None if store is None else Path(store) / name.replace(":", "-")
        runs[name] = outcomes(
            vehicle, candidates, strategy, n, seed, scenario=scenario, store=own, **options
        )
        if (runs[name]["outcome"].values != 0).all():
            why = "; ".join(
                OUTCOME_TEXT[Outcome(code)] for code in np.unique(runs[name]["outcome"].values)
            )
            raise InputError(f"no run of the strategy {name!r} could be computed", got=why)
    names = list(runs)
    tallies = {name: tally(found) for name, found in runs.items()}
    quantities = list(tallies[names[0]])
    first, each = per_run(runs[names[0]]), {name: per_run(found) for name, found in runs.items()}
    none = Estimate(np.nan, np.nan)
    means = [[tallies[name].get(q, none) for q in quantities] for name in names]
    spread = [[_quantiles(each[name].get(q)) for q in quantities] for name in names]
    gains = [[estimate(each[name][q] - first[q]) for q in quantities] for name in names]
    dims = ("strategy", "quantity")
    table = xr.Dataset(
        {
            "value": (dims, [[x.value for x in row] for row in means]),
            "error": (dims, [[x.error for x in row] for row in means]),
            "quantile": ((*dims, "level"), spread),
            "gain": (dims, [[x.value for x in row] for row in gains]),
            "gain_error": (dims, [[x.error for x in row] for row in gains]),
        },
        coords={"strategy": names, "quantity": quantities, "level": list(LEVELS)},
        attrs=runs[names[0]].attrs | {"kind": "strategies", "strategy": "compared", "runs": n},
    )
    return table, runs


def compared(
    table: xr.Dataset,
    runs: Mapping[str, xr.Dataset],
    collision: xr.Dataset | None = None,
) -> xr.DataTree:
    """Both results of :func:`compare` as one tree: `strategies`, and `runs` with a node for each strategy.

    With `collision`, runs weighted by what is known of the blow.
    """
    nodes = {"strategies": table} | {f"runs/{name}": found for name, found in runs.items()}
    nodes |= {} if collision is None else {"collision": collision}
    return xr.DataTree.from_dict(
        {"/": xr.Dataset(attrs=table.attrs | {"kind": "landing"}), **nodes}
    )


def _quantiles(values: np.ndarray | None) -> np.ndarray:
    known = np.zeros(0) if values is None else values[np.isfinite(values)]
    return np.quantile(known, LEVELS) if known.size else np.full(len(LEVELS), np.nan)


def records(table: xr.Dataset) -> list[dict[str, Any]]:
    """The comparison as lines for a printed table: one per quantity, with (value, error) for each strategy by its name."""
    known = [name for name in TABLE if name in table["quantity"].values]
    return [
        {"quantity": name}
        | {
            str(s): Estimate(
                *(table[part].sel(strategy=s, quantity=name).item() for part in ("value", "error"))
            )
            for s in table["strategy"].values
        }
        for name in known
    ]


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
    """The delay (s after touchdown) that makes `metric` largest, and how sure that is; unless given, of eleven before the landing.

    All delays are tried on the same draws; the uncertainty is that of the Monte Carlo runs and their scenario, not of the
    models (vertical, terrain, hull). The largest of many noisy means is biased upward: look at `as_good`, not at `value`.

    Returns
    -------
    xarray.Dataset
        The table of :func:`compare` with a strategy for each delay, `delay_s (strategy)`; `behind`, `behind_error (strategy)`:
        difference of `metric` to the best, run by run; `as_good (strategy)`: not behind by more than two errors. `attrs`:
        `metric`, `best_s`, and `spread_s`, the central 68 % of the best delay over resampled runs.
    """
    if not vehicle.wheels:
        raise InputError(f"vehicle {vehicle.name!r} has no wheel to switch off")
    scenario = scenario or own_scenario(vehicle)
    if delays_s is None:
        end = scenario.landing_s
        delays_s = (
            DELAYS_S
            if end > DELAYS_S[-1]
            else np.linspace(0.0, end, len(DELAYS_S), endpoint=False).round(1).tolist()
        )
    table, runs = compare(
        vehicle, candidates, [delayed(t) for t in delays_s], n, seed, scenario, **options
    )
    each = [per_run(found).get(metric) for found in runs.values()]
    if each[0] is None or not np.isfinite(each[0]).any():
        known = ", ".join(table["quantity"].values)
        raise InputError(
            "these runs do not tell the quantity to be made largest",
            got=metric,
            do=f"known: {known}",
        )
    values = np.array(each)
    values = values[:, np.isfinite(values).all(axis=0)]
    best = int(np.argmax(values.mean(axis=1)))
    pairs = [estimate(row - values[best]) for row in values]
    behind, error = np.array([p.value for p in pairs]), np.array([p.error for p in pairs])
    delays = np.array(delays_s, dtype=np.float64)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(n, len(delays))))
    size = values.shape[1]
    winners = [
        delays[np.argmax(values[:, rng.integers(size, size=size)].mean(axis=1))]
        for _ in range(BOOTSTRAP)
    ]
    low, high = np.quantile(winners, [0.16, 0.84], method="nearest")
    by = "strategy"
    return (
        table.assign(
            behind=(by, behind), behind_error=(by, error), as_good=(by, behind >= -2 * error)
        )
        .assign_coords(delay_s=(by, delays, {"units": "s"}))
        .assign_attrs(
            metric=metric,
            best_s=float(delays[best]),
            spread_s=[float(low), float(high)],
        )
    )


def settling(vehicle: Vehicle, gravity_m_s2: float) -> list[dict[str, Any]]:
    """Section 4's argument on switching a wheel off at rest: can the feet's friction hold the body against it?

    Returns
    -------
    list of dict, one per wheel and way to stop it
        Torque (N m) of the law mu0 + mu1 W (eq. 5), with the brake where there is one; angular momentum (N m s) that it
        passes to the ground; force at each foot (N), torque / (number of feet * mean |l|) as in the paper; weight per foot
        (N); the coefficient of friction that is needed; time to stop (s).
    """
    if not vehicle.legs:
        raise InputError(f"vehicle {vehicle.name!r} has no legs to stand on")
    feet = len(vehicle.legs)
    lever = float(np.mean([np.linalg.norm(leg.tip_B_m) for leg in vehicle.legs]))
    weight = vehicle.require_mass() * gravity_m_s2 / feet
    found = []
    for wheel in vehicle.wheels:
        friction = wheel.friction.coulomb_N_m + wheel.friction.viscous_N_m_s * abs(
            wheel.speed_rad_s
        )
        momentum = wheel.inertia_kg_m2 * abs(wheel.speed_rad_s)
        ways = {
            "off": (
                friction,
                spin_down_time(wheel.friction, wheel.inertia_kg_m2, wheel.speed_rad_s),
            )
        }
        if wheel.brake_torque_N_m is not None:
            ways["brake"] = (friction + wheel.brake_torque_N_m, momentum / wheel.brake_torque_N_m)
        for way, (torque, time) in ways.items():
            force = torque / (feet * lever)
            found.append(
                {
                    "wheel": wheel.name,
                    "way": way,
                    "torque_N_m": torque,
                    "momentum_N_m_s": momentum,
                    "foot_force_N": force,
                    "weight_per_foot_N": weight,
                    "friction_coefficient": force / weight,
                    "stop_s": float(time),
                }
            )
    return found

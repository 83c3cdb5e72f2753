"""Philae's motion to look at: whole candidate motions from touchdown to touchdown, and the angular speed with its spread.

Nothing here is compared with the paper; the report draws it. A candidate after the collision is one of many: which leg hit, and
in which direction, is drawn once (`twin_philae.collision`) and the same for all, so that their difference is the motion's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.dynamics import gyrostat
from sunspin.dynamics.ensemble import Rows, run_rows
from sunspin.dynamics.propagate import propagate
from sunspin.dynamics.wheel_modes import mode_before
from sunspin.environment.frames import BODY_AT_START
from sunspin.landing.outcomes import outcomes
from sunspin.landing.scenario import case_scenario
from sunspin.philae import rebound as rb
from sunspin.philae.candidates import Chain
from sunspin.philae.descent import Descent
from sunspin.philae.level_set import LevelSet
from sunspin.philae.row import Row
from sunspin.philae.twin_philae import State, collision
from sunspin.telemetry.case import Case
from sunspin.telemetry.synthetic import generator
from sunspin.vehicle.response.panels import panel_power

STEP_S = 1.0
"""Between instants of a candidate: at the fastest, half a radian."""

DESCENT_STEP_S = 20.0
DIRECTION_ERROR = 1e-4
SPREAD_MOTIONS = 150
"""Motions drawn from the confidence region, beside those of least and most speed and momentum, which are its edges."""

SPREAD_STEP_S = 30.0
COLLISIONS = 2000
AFTER_LEVELS = (0.025, 0.5, 0.975)
"""Quantiles over simulated collisions; before the collision a set is shown from its slowest to its fastest motion."""


@dataclass(frozen=True)
class Motions:
    """`candidates`: name -> Dataset as of `propagate`, with panel signals; `speed`: see :func:`speeds`."""

    candidates: dict[str, xr.Dataset]
    speed: xr.Dataset


def compute(case: Case, done: dict[str, Any], seed: int = 0, workers: int | None = None) -> Motions:
    """From the results of the parts before: `level_set`, `candidates`, and where there is one `descent`."""
    scan: LevelSet = done["level_set"]
    chain: Chain = done["candidates"]
    descent: Descent | None = done.get("descent")
    blows = {"Truth": rb.twin_file(case).get("seed", seed)} if scan.truth else {}
    found = {
        name: landing(chain.rebound, start, about, blows.get(name, seed))
        for name, (start, about) in chosen(chain, scan).items()
    }
    if descent is not None:
        found["Descent"] = descent_motion(case, descent)
    return Motions(found, speeds(chain, descent, seed, workers))


def rows(_: Motions) -> list[Row]:
    """No published figure belongs to this part."""
    return []


def chosen(chain: Chain, scan: LevelSet) -> dict[str, tuple[Rows, str]]:
    """Name -> (one state at the candidates' instant, why this one)."""
    rebound, found = chain.rebound, {}
    if scan.truth:
        start = replace(rebound.states(scan.truth["omega_B"]), sun_B=scan.truth["sun_B"][None])
        found["Truth"] = (start, "the motion from which the synthetic telemetry was made")
    best = int(np.argmin(scan.scan.emd))
    found["Best fit"] = (
        scan.scan.table.rows.start.take(np.array([best])),
        f"the grid point whose heights of the Sun fit this telemetry best (EMD {scan.scan.smallest:.4f})",
    )
    speed = chain.chosen.speed_touchdown
    for name, at in (
        ("Slowest", np.argmin(speed)),
        ("Middle", np.argsort(speed)[len(speed) // 2]),
        ("Fastest", np.argmax(speed)),
    ):
        found[f"{name} candidate"] = (
            chain.chosen.states.take(np.array([at])),
            f"{name.lower()} of {chain.chosen.about}: {speed[at]:.3f} rad/s just after the touchdown",
        )
    return found


def _run(case: Case, start: Rows, t: Any) -> xr.Dataset:
    mode = mode_before(start.wheel_speed_rad_s) if t[-1] < t[0] else "coast"
    return propagate(
        case.vehicle,
        start.omega_B[0],
        start.sun_B[0],
        start.wheel_speed_rad_s[0],
        t,
        wheel_mode=mode,
        rtol=1e-9,
    )


def instant_s(rebound: rb.Rebound) -> float:
    """The candidates' instant, s from the epoch of the case."""
    return rebound.case.require_timeline().event("collision").t_s - rebound.window_s


def landing(rebound: rb.Rebound, start: Rows, about: str, seed: int) -> xr.Dataset:
    """One motion from the first touchdown over the collision to the second, time in s from the case's epoch."""
    case = rebound.case
    first, blow_s = instant_s(rebound), case.require_timeline().event("collision").t_s
    end = case.require_timeline().event("second_touchdown").t_s
    back = np.arange(0.0, -rebound.lead_s - 1e-6, -STEP_S)
    forth = np.arange(0.0, blow_s - first + 1e-6, STEP_S)
    state = State(first, start.omega_B[0], start.sun_B[0], start.wheel_speed_rad_s[0])
    _, after, blow = collision(case, state, generator(seed, 3))
    beyond = np.arange(0.0, end - blow_s + 1e-6, STEP_S)
    before = [_run(case, start, back).isel(time=slice(None, 0, -1)), _run(case, start, forth)]
    last = propagate(
        case.vehicle, after.omega_B, after.sun_B, after.wheel_speed_rad_s, beyond, rtol=1e-9
    )
    turned = Rotation.from_quat(last["B_from_N"].values) * Rotation.from_quat(
        before[1]["B_from_N"].values[-1]
    )
    last["B_from_N"] = (last["B_from_N"].dims, turned.as_quat(), last["B_from_N"].attrs)
    pieces = [*before[:1], before[1].isel(time=slice(None, -1)), last]
    shifts = (first, first, blow_s)
    moved = [
        p.drop_dims("event").assign_coords(time=p["time"] + s)
        for p, s in zip(pieces, shifts, strict=True)
    ]
    whole = xr.concat(
        moved, "time", data_vars="minimal", coords="minimal", compat="override", join="override"
    )
    events = before[1]
    at = [*(events["event_time_s"].values + first), blow_s]
    what = [
        f"{w} {e}"
        for w, e in zip(events["event_wheel"].values, events["event_what"].values, strict=True)
    ]
    told = f"{about}; after the collision one of many possible motions (leg {blow['collision_leg']} hits, drawn with seed {seed})"
    return _with_panels(case, whole, told, at, [*what, "collision"])


def descent_motion(case: Case, descent: Descent) -> xr.Dataset:
    """The plain spin about z that fits the descent, time in s from the case's epoch; the turn about z at its start is free."""
    start, end = descent_span(case, descent)
    t = np.arange(0.0, end - start, DESCENT_STEP_S)
    rate = np.polynomial.polynomial.polyval(t, descent.fit.coefficients)
    angle = np.polynomial.polynomial.polyval(
        t, np.polynomial.polynomial.polyint(descent.fit.coefficients)
    )
    axis = np.array([0.0, 0.0, 1.0])
    omega = rate[:, None] * axis
    speed = np.tile(rb.nominal_speed(case.vehicle), (t.size, 1))
    body = ("time", "axis")
    data = xr.Dataset(
        {
            "omega_B": (body, omega, {"units": "rad s-1"}),
            "sun_B": (body, descent.fit.directions(t), {"units": "1"}),
            "wheel_speed_rad_s": (("time", "wheel"), speed, {"units": "rad s-1"}),
            "momentum_B": (
                body,
                gyrostat.total_momentum(case.vehicle, omega, speed),
                {"units": "N m s"},
            ),
            "B_from_N": (
                ("time", "quaternion"),
                Rotation.from_rotvec(-angle[:, None] * axis).as_quat(),
                {"units": "1"},
            ),
        },
        coords={"time": ("time", t + start, {"units": "s"}), "axis": ["x", "y", "z"]},
        attrs={"frame_N": BODY_AT_START},
    )
    return _with_panels(
        case,
        data,
        "the spin about z that fits the directions of the descent, wheel held by its motor",
        [],
        [],
    )


def _spread(case: Case, states: Rows, seed: int) -> Rows:
    """Some of the states (n), and those of least and most angular speed and momentum."""
    momentum = gyrostat.total_momentum(case.vehicle, states.omega_B, states.wheel_speed_rad_s)
    sizes = np.linalg.norm(states.omega_B, axis=1), np.linalg.norm(momentum, axis=1)
    edges = [f(size) for size in sizes for f in (np.argmin, np.argmax)]
    pick = generator(seed, 4).choice(len(states), min(SPREAD_MOTIONS, len(states)), replace=False)
    return states.take(np.unique([*edges, *pick]))


def descent_span(case: Case, descent: Descent) -> tuple[float, float]:
    """Begin of the fit and first touchdown, s from the case's epoch."""
    end = case.require_timeline().event("first_touchdown").t_s
    to_case = end - rb.case_seconds(case, descent.sun, "first_touchdown")
    return float(case.telemetry["time"].values[descent.number[0] - 1]) + to_case, end


def _with_panels(
    case: Case, run: xr.Dataset, about: str, event_s: list[float], events: list[str]
) -> xr.Dataset:
    power = panel_power(case.vehicle, run["sun_B"].values)
    run["panel_signal"] = (
        ("time", "panel"),
        power,
        {"units": case.vehicle.gain_unit or "1", "long_name": "modelled signal"},
    )
    run["event_time_s"] = ("event", np.array(event_s, dtype=np.float64), {"units": "s"})
    run["event_what"] = ("event", np.array(events, dtype=np.str_))
    run = run.assign_coords(panel=np.array(case.vehicle.panel_names, dtype=np.str_))
    run.attrs = {
        "vehicle": case.vehicle.name,
        "about": about,
        "epoch_utc": case.require_timeline().epoch_utc,
    }
    return run


def speeds(
    chain: Chain, descent: Descent | None, seed: int, workers: int | None = None
) -> xr.Dataset:
    """Angular speed against time for sets of motions: slowest, median and fastest of each set; and after the collision.

    Sets: "candidates", those from which everything follows; "recipe", the paper's own set of this telemetry. Each motion of a set
    counts as much as another. After the collision: `AFTER_LEVELS` over simulated collisions of the set.
    """
    case, rebound, timeline = chain.case, chain.rebound, chain.case.require_timeline()
    sets = {"candidates": chain.chosen, "recipe": chain.recipe}
    first, blow = instant_s(rebound), timeline.event("collision").t_s
    t = np.append(np.arange(0.0, blow - first, SPREAD_STEP_S), blow - first)
    scenario = case_scenario(case, rebound)
    before, after, count = [], [], []
    for candidates in sets.values():
        states = _spread(case, candidates.states, seed)
        run = np.linalg.norm(
            run_rows(case.vehicle, states, t[1:], direction_error=DIRECTION_ERROR).omega_B, axis=2
        )
        run = np.concatenate([np.linalg.norm(states.omega_B, axis=1)[:, None], run], axis=1)
        before.append(np.quantile(run, [0.0, 0.5, 1.0], axis=0))
        hit = outcomes(
            case.vehicle,
            candidates.dataset(),
            "off",
            COLLISIONS,
            seed,
            scenario=scenario,
            workers=workers,
        )
        after.append(
            np.nanquantile(np.linalg.norm(hit["omega_after_B"].values, axis=1), AFTER_LEVELS)
        )
        count.append(len(states))
    names = list(sets)
    data = xr.Dataset(
        {
            "speed": (("set", "level", "time"), np.array(before), {"units": "rad s-1"}),
            "speed_after_collision": (("set", "level"), np.array(after), {"units": "rad s-1"}),
            "motions": ("set", count, {"units": "1"}),
        },
        coords={
            "set": names,
            "level": ["low", "middle", "high"],
            "time": ("time", t + first, {"units": "s"}),
        },
        attrs={
            "epoch_utc": timeline.epoch_utc,
            "seed": seed,
            "collisions": COLLISIONS,
            "chain": chain.name,
            "about_candidates": chain.chosen.about,
            "about_recipe": chain.recipe.about,
        },
    )
    if descent is None:
        return data
    begin, end = descent_span(case, descent)
    when = np.linspace(0.0, end - begin, 100)
    rate = np.abs(np.polynomial.polynomial.polyval(when, descent.fit.coefficients))
    return data.assign(descent_speed=("descent_time", rate, {"units": "rad s-1"})).assign_coords(
        descent_time=("descent_time", when + begin, {"units": "s"})
    )

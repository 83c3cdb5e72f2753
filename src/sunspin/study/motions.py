"""Philae's motion to look at: whole candidate motions from touchdown to touchdown, and the angular speed with its spread.

Nothing here is compared with the paper; the report draws it. A candidate after the collision is one of many: which leg hit, and
in which direction, is drawn once (`twin_philae.collision`) and the same for all, so that their difference is the motion's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.cases import Case
from sunspin.infer.lines import point_at
from sunspin.infer.scan import below
from sunspin.measure.panels import panel_power
from sunspin.motion import gyrostat
from sunspin.motion.propagate import propagate
from sunspin.study import rebound as rb
from sunspin.study.descent import Descent
from sunspin.study.level_set import LevelSet
from sunspin.study.outcomes import outcomes
from sunspin.study.row import Row
from sunspin.study.scenario import case_scenario
from sunspin.study.twin_data import generator
from sunspin.study.twin_philae import State, collision
from sunspin.study.worth import CONFIDENCE, Worth

STEP_S = 1.0
"""Between instants of a candidate: at the fastest, half a radian."""

DESCENT_STEP_S = 20.0
LINE_POINTS = 26
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
    """From the results of the parts before: `level_set`, and where there are any `descent` and `worth`."""
    scan: LevelSet = done["level_set"]
    descent: Descent | None = done.get("descent")
    worth: Worth | None = done["worth"][1] if "worth" in done else None
    starts = chosen(case, scan)
    blows = {"Truth": rb.twin_file(case).get("seed", seed)} if scan.truth else {}
    found = {name: landing(case, start, about, blows.get(name, seed)) for name, (start, about) in starts.items()}
    if descent is not None:
        found["Descent"] = descent_motion(case, descent)
    return Motions(found, speeds(case, scan, descent, worth, seed, workers))


def rows(_: Motions) -> list[Row]:
    """No published figure belongs to this part."""
    return []


def chosen(case: Case, scan: LevelSet) -> dict[str, tuple[np.ndarray, str]]:
    """Name -> (rate in rad/s at the first sample, why this one)."""
    period = case.published["romap_period_before"].value
    found = {}
    best = np.unravel_index(int(np.nanargmin(scan.twin.emd.values)), scan.twin.emd.shape)
    if scan.truth:
        found["Truth"] = (scan.truth["omega_B"], "the motion from which the synthetic telemetry was made")
    axes = [scan.twin.emd[dim].values for dim in scan.twin.emd.dims]
    found["Best fit"] = (
        np.array([axis[i] for axis, i in zip(axes, best, strict=True)]),
        f"the grid point whose heights of the Sun fit this telemetry best (EMD {float(scan.twin.emd.min()):.4f})",
    )
    omega_z = np.linspace(*rb.LINE_RANGE, LINE_POINTS)
    for k, (point, direction) in enumerate(rb.published_lines(case)):
        starts = point_at(point, direction, 2, omega_z)
        speed = [np.linalg.norm(_run(case, start, [0.0, rb.window_s(case)])["omega_B"].values[-1]) for start in starts]
        at = int(np.argmin(np.abs(np.array(speed) - 2 * np.pi / period)))
        found[f"Line L{k + 1}"] = (
            starts[at],
            f"the point of the paper's line L{k + 1} that comes nearest to one turn in {period:g} s at the collision, as the "
            f"magnetometer saw (here {2 * np.pi / speed[at]:.1f} s)",
        )
    return found


def _run(case: Case, start: np.ndarray, t: Any) -> xr.Dataset:
    return propagate(case.vehicle, start, rb.first_sun(case), rb.nominal_speed(case.vehicle), t, rtol=1e-9)


def landing(case: Case, start: np.ndarray, about: str, seed: int) -> xr.Dataset:
    """One motion from the first touchdown over the collision to the second, time in s from the case's epoch."""
    timeline = case.require_timeline()
    seconds = {name: timeline.event(name).t_s for name in ("first_sample_after_touchdown", "collision", "second_touchdown")}
    first, blow_s, end = seconds.values()
    back = np.arange(0.0, -rb.after_touchdown_s(case) - 1e-6, -STEP_S)
    forth = np.arange(0.0, blow_s - first + 1e-6, STEP_S)
    state = State(first, start, rb.first_sun(case), np.array(rb.nominal_speed(case.vehicle)))
    _, after, blow = collision(case, state, generator(seed, 3))
    beyond = np.arange(0.0, end - blow_s + 1e-6, STEP_S)
    before = [_run(case, start, back).isel(time=slice(None, 0, -1)), _run(case, start, forth)]
    last = propagate(case.vehicle, after.omega_B, after.sun_B, after.wheel_speed_rad_s, beyond, rtol=1e-9)
    turned = Rotation.from_quat(last["B_from_N"].values) * Rotation.from_quat(before[1]["B_from_N"].values[-1])
    last["B_from_N"] = (last["B_from_N"].dims, turned.as_quat(), last["B_from_N"].attrs)
    pieces = [*before[:1], before[1].isel(time=slice(None, -1)), last]
    shifts = (first, first, blow_s)
    moved = [p.drop_dims("event").assign_coords(time=p["time"] + s) for p, s in zip(pieces, shifts, strict=True)]
    whole = xr.concat(moved, "time", data_vars="minimal", coords="minimal", compat="override", join="override")
    events = before[1]
    at = [*(events["event_time_s"].values + first), blow_s]
    what = [f"{w} {e}" for w, e in zip(events["event_wheel"].values, events["event_what"].values, strict=True)]
    told = f"{about}; after the collision one of many possible motions (leg {blow['collision_leg']} hits, drawn with seed {seed})"
    return _with_panels(case, whole, told, at, [*what, "collision"])


def descent_motion(case: Case, descent: Descent) -> xr.Dataset:
    """The plain spin about z that fits the descent, time in s from the case's epoch; the turn about z at its start is free."""
    start, end = descent_span(case, descent)
    t = np.arange(0.0, end - start, DESCENT_STEP_S)
    rate = np.polynomial.polynomial.polyval(t, descent.fit.coefficients)
    angle = np.polynomial.polynomial.polyval(t, np.polynomial.polynomial.polyint(descent.fit.coefficients))
    axis = np.array([0.0, 0.0, 1.0])
    omega = rate[:, None] * axis
    speed = np.tile(rb.nominal_speed(case.vehicle), (t.size, 1))
    body = ("time", "axis")
    data = xr.Dataset(
        {
            "omega_B": (body, omega, {"units": "rad/s"}),
            "sun_B": (body, descent.fit.directions(t), {"units": "1"}),
            "wheel_speed_rad_s": (("time", "wheel"), speed, {"units": "rad/s"}),
            "momentum_B": (body, gyrostat.total_momentum(case.vehicle, omega, speed), {"units": "N m s"}),
            "B_from_N": (("time", "quaternion"), Rotation.from_rotvec(-angle[:, None] * axis).as_quat(), {"units": "1"}),
        },
        coords={"time": ("time", t + start, {"units": "s"}), "axis": ["x", "y", "z"]},
    )
    return _with_panels(case, data, "the spin about z that fits the directions of the descent, wheel held by its motor", [], [])


def _spread(case: Case, points: np.ndarray, seed: int) -> np.ndarray:
    """Some of the points (n, 3), and those of least and most angular speed and momentum."""
    momentum = gyrostat.total_momentum(case.vehicle, points, np.tile(rb.nominal_speed(case.vehicle), (len(points), 1)))
    sizes = np.linalg.norm(points, axis=1), np.linalg.norm(momentum, axis=1)
    edges = [f(size) for size in sizes for f in (np.argmin, np.argmax)]
    pick = generator(seed, 4).choice(len(points), min(SPREAD_MOTIONS, len(points)), replace=False)
    return points[np.unique([*edges, *pick])]


def descent_span(case: Case, descent: Descent) -> tuple[float, float]:
    """Begin of the fit and first touchdown, s from the case's epoch."""
    end = case.require_timeline().event("first_touchdown").t_s
    to_case = end - rb.case_seconds(case, descent.sun, "first_touchdown")
    return float(case.telemetry["time"].values[descent.number[0] - 1]) + to_case, end


def _with_panels(case: Case, run: xr.Dataset, about: str, event_s: list[float], events: list[str]) -> xr.Dataset:
    power = panel_power(case.vehicle, run["sun_B"].values)
    run["panel_signal"] = (("time", "panel"), power, {"units": case.vehicle.gain_unit or "1", "long_name": "modelled signal"})
    run["event_time_s"] = ("event", np.array(event_s, dtype=np.float64), {"units": "s"})
    run["event_what"] = ("event", np.array(events, dtype=np.str_))
    run = run.assign_coords(panel=np.array(case.vehicle.panel_names, dtype=np.str_))
    run.attrs = {"vehicle": case.vehicle.name, "about": about, "epoch_utc": case.require_timeline().epoch_utc}
    return run


def speeds(
    case: Case, scan: LevelSet, descent: Descent | None, worth: Worth | None, seed: int, workers: int | None = None
) -> xr.Dataset:
    """Angular speed against time for sets of motions: slowest, median and fastest of each set; and after the collision.

    Sets: "lines", evenly along the paper's lines over the compared range; "region", drawn evenly from the level set that holds the
    truth with the confidence that `worth` calibrated (absent without it). Each motion of a set counts as much as another: none is
    preferred by the data. After the collision: `AFTER_LEVELS` over simulated collisions of the set.
    """
    omega_z = np.linspace(*rb.LINE_RANGE, LINE_POINTS)
    sets = {"lines": np.concatenate([point_at(point, along, 2, omega_z) for point, along in rb.published_lines(case)])}
    if worth is not None:
        factor = worth.twins["lines"].threshold(CONFIDENCE, True)[0]
        points = below(scan.twin.emd, factor * float(scan.twin.emd.min()))
        sets["region"] = _spread(case, points, seed)
    timeline = case.require_timeline()
    first, blow = (timeline.event(name).t_s for name in ("first_sample_after_touchdown", "collision"))
    t = np.append(np.arange(0.0, blow - first, SPREAD_STEP_S), blow - first)
    scenario = case_scenario(case)
    before, after = [], []
    for starts in sets.values():
        run = np.array([np.linalg.norm(_run(case, start, t)["omega_B"].values, axis=1) for start in starts])
        before.append(np.quantile(run, [0.0, 0.5, 1.0], axis=0))
        hit = outcomes(case.vehicle, starts, "off", COLLISIONS, seed, scenario=scenario, workers=workers)["omega_after_B"].values
        after.append(np.nanquantile(np.linalg.norm(hit, axis=1), AFTER_LEVELS))
    names = list(sets)
    data = xr.Dataset(
        {
            "speed": (("set", "level", "time"), np.array(before), {"units": "rad/s"}),
            "speed_after_collision": (("set", "level"), np.array(after), {"units": "rad/s"}),
            "motions": ("set", [len(s) for s in sets.values()], {"units": "1"}),
        },
        coords={"set": names, "level": ["low", "middle", "high"], "time": ("time", t + first, {"units": "s"})},
        attrs={"epoch_utc": timeline.epoch_utc, "confidence": CONFIDENCE, "seed": seed, "collisions": COLLISIONS},
    )
    if descent is None:
        return data
    begin, end = descent_span(case, descent)
    when = np.linspace(0.0, end - begin, 100)
    rate = np.abs(np.polynomial.polynomial.polyval(when, descent.fit.coefficients))
    return data.assign(descent_speed=("descent_time", rate, {"units": "rad/s"})).assign_coords(
        descent_time=("descent_time", when + begin, {"units": "s"})
    )

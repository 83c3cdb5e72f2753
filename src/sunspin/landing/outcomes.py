"""What a motion means for the vehicle: collision, tumbling after it, what touches the ground first, does the antenna serve.

Each run draws a candidate motion and everything that is not known (which leg hits, from where, the local vertical, where
the orbiter is), see :mod:`sunspin.landing.scenario`; the runs go through the ensemble kernel (paper, sections 3.3 and 4).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.cases import case_names, load_case
from sunspin.compute.rows import ensemble
from sunspin.dynamics import ensemble as k
from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.impact import impact
from sunspin.dynamics.propagate import wheel_speeds
from sunspin.dynamics.wheel_modes import command_at, mode_before
from sunspin.landing import scenario as sc
from sunspin.landing.contact import Shape, first_contact, rest_facet, shape_of
from sunspin.landing.flight import angle_about, carry, fly, sun_height_shares
from sunspin.landing.outcome_data import BINS, VARIABLES, dataset, dim_of
from sunspin.solve.rotations import rotate_by_smallest
from sunspin.vehicle import Antenna, Vehicle

CHUNK = 2048
"""Runs per call: the tracks of one chunk take some 100 MB."""

FLIGHT_SAMPLES = 48
"""Instants after the collision at which the antenna is looked at."""

APPROACH_STEP_S = 0.4
"""Time between samples of the last metres: 0.1 to 0.2 rad at the rates of a rebound."""

MAX_APPROACH_SAMPLES = 400

APPROACH_TURN_RAD = 0.25
"""Runs that turn further than this from one sample to the next are run again with twice, four times ... as many. At 3 rad/s and
samples 1.2 rad apart a tenth of the runs touched with the wrong point."""


Draws = dict[str, np.ndarray]
"""Of each of `scenario.DRAWS` a uniform number for each run."""


def candidates_of(vehicle: Vehicle, given: Any, scenario: sc.Scenario) -> tuple[k.Rows, np.ndarray]:
    """Possible motions (m) at one instant and their probabilities (m), from rates (m, 3) rad/s, or from a Dataset with `omega_B`
    and, if it has them, `sun_B`, `wheel_speed_rad_s` and `log_weight`; the scenario's Sun and wheel speeds where it has not.
    """
    held = given if isinstance(given, xr.Dataset) else {"omega_B": given}
    try:
        omega = np.atleast_2d(np.asarray(held["omega_B"], dtype=np.float64))
    except (KeyError, TypeError, ValueError):
        omega = np.zeros(0)
    if omega.shape[1:] != (3,) or len(omega) == 0 or not np.all(np.isfinite(omega)):
        what = "candidates must be rates (m, 3) in rad/s, finite"
        raise InputError(what, got=f"shape {omega.shape}")
    m = len(omega)
    own = wheel_speeds(vehicle, list(scenario.wheel_speed_rad_s) or None)
    default = {
        "sun_B": np.tile(scenario.sun_B, (m, 1)),
        "wheel_speed_rad_s": np.tile(own, (m, 1)),
        "log_weight": np.zeros(m),
    }
    sun, speeds, weight = (
        np.asarray(held[name] if name in held else values, dtype=np.float64)
        for name, values in default.items()
    )
    shapes, wanted = (sun.shape, speeds.shape, weight.shape), ((m, 3), (m, len(own)), (m,))
    if shapes != wanted or not np.any(np.isfinite(weight)):
        what = f"sun_B, wheel_speed_rad_s and log_weight of the candidates must be {wanted}"
        raise InputError(what, got=shapes)
    likely = np.nan_to_num(np.exp(weight - np.nanmax(weight)))
    states = k.Rows(omega, sun / np.linalg.norm(sun, axis=1, keepdims=True), speeds)
    return states, likely / likely.sum()


def collide(
    vehicle: Vehicle, scenario: sc.Scenario, draw: Draws, before: k.Rows, mode: Any
) -> tuple[np.ndarray, xr.Dataset]:
    """Numbers (n) of the legs that hit, drawn at random, and the :func:`sunspin.impact` of each on a motion (paper, eqs. 8-11)."""
    leg = (draw["leg"] * len(vehicle.legs)).astype(int)
    axis = np.tile(scenario.collision_axis_B, (len(leg), 1))
    return leg, impact(
        vehicle,
        before.omega_B,
        before.wheel_speed_rad_s,
        scenario.collision_speed_m_s * sc.about(axis, draw["polar"], draw["azimuth"]),
        leg,
        mode,
        restitution=scenario.restitution,
        damper=scenario.damper,
    )


@dataclass(frozen=True)
class OutcomeRows:
    """Run -> what becomes of it; the row function of :func:`outcomes`."""

    vehicle: Vehicle
    scenario: sc.Scenario
    strategy: sc.Strategy
    candidates: k.Rows
    probability: np.ndarray
    n_rows: int
    seed: int
    shape: Shape | None = field(init=False, repr=False)
    verticals: np.ndarray = field(init=False, repr=False)

    outputs = {
        name: (dtype, {"rz": (BINS,), "axis": (3,), None: ()}[dim_of(name)])
        for name, (dtype, _, _) in VARIABLES.items()
    }

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", shape_of(self.vehicle))
        object.__setattr__(self, "verticals", sc.verticals(self.vehicle, self.scenario.vertical)[0])

    @property
    def collides(self) -> bool:
        speed, mass = self.scenario.collision_speed_m_s, self.vehicle.mass_kg
        return speed is not None and bool(self.vehicle.legs) and mass is not None

    @property
    def lands(self) -> bool:
        """Whether there is a shape to touch the ground with, and the flight is long enough for its last metres."""
        return self.shape is not None and self.approach_s < self.scenario.after_s

    @property
    def approach_s(self) -> float:
        """From where the flattest landing's farthest point could touch to where its centre would, in s."""
        reach = 0.0 if self.shape is None else self.shape.reach_m
        return 1.02 * reach / (sc.STEEPEST_SINE * self.scenario.landing_speed_m_s) + 1.0

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        s, draw = self.scenario, sc.draws(self.seed, index)
        out = {
            name: np.full((len(index), *shape), _nothing(dtype), dtype)
            for name, (dtype, shape) in self.outputs.items()
        }
        number = np.searchsorted(np.cumsum(self.probability), draw["candidate"], side="right")
        out["candidate"][:] = np.minimum(number, len(self.candidates) - 1)
        drawn, run_of = np.unique(out["candidate"], return_inverse=True)
        touchdown, before, bad = self._to_collision(self.candidates.take(drawn))
        touchdown, before, bad = touchdown.take(run_of), before.take(run_of), bad[run_of]
        after, impulse_B = before, None
        if self.collides:
            mode = command_at(self.strategy.schedule, s.collision_s)
            out["leg"][:], hit = collide(self.vehicle, s, draw, before, mode)
            impulse_B = hit["impulse_B"].values
            after = k.Rows(hit["omega_B"].values, before.sun_B, hit["wheel_speed_rad_s"].values)
            size = np.linalg.norm(impulse_B, axis=1)
            out["velocity_change"][:] = size / self.vehicle.require_mass()
            out["speed_after"][:] = np.linalg.norm(hit["velocity_B"].values, axis=1)
            out["omega_before_B"][:], out["omega_after_B"][:] = before.omega_B, after.omega_B
        momenta = [
            g.total_momentum(self.vehicle, x.omega_B, x.wheel_speed_rad_s)
            for x in (touchdown, before, after)
        ]
        out["momentum_before"][:] = np.linalg.norm(momenta[1], axis=1)
        out["momentum_after"][:] = np.linalg.norm(momenta[2], axis=1)
        up = self.verticals[(draw["vertical"] * len(self.verticals)).astype(int)]
        if isinstance(s.orbiter, str):
            polar = draw["orbiter_polar"]
            cosine = polar if s.orbiter == "above_horizon" else 2 * polar - 1
            orbiter = sc.about(up, cosine, draw["orbiter_azimuth"])
        else:
            orbiter = np.tile(np.array(s.orbiter, float) / np.linalg.norm(s.orbiter), (len(up), 1))
        ends = (momenta[0], touchdown.sun_B), (momenta[1], before.sun_B)
        fixed = carry(np.stack([up, orbiter]), *ends)
        if impulse_B is not None:
            out["change_to_sun"][:], out["change_about_sun"][:] = angle_about(
                impulse_B, before.sun_B, fixed[0]
            )
        bad = self._after(after, momenta[2], fixed, draw, out, bad)
        for name, values in out.items():
            if name != "candidate":
                values[bad != 0] = _nothing(values.dtype)
        out["outcome"][:] = bad
        return out

    def _to_collision(self, start: k.Rows) -> tuple[k.Rows, k.Rows, np.ndarray]:
        """States at the touchdown and just before the collision of candidates (n), each run once however often it is drawn;
        the outcome (n). Those that fail go on from a finite state, and are blanked at the end."""
        s, states, bad = self.scenario, [start], np.zeros(len(start), dtype=np.int64)
        back = ((-np.inf, mode_before(start.wheel_speed_rad_s)),)
        for schedule, begin, end in (
            (back, s.lead_s, 0.0),
            (self.strategy.schedule, 0.0, s.collision_s),
        ):
            if begin == end:
                states.append(states[-1])
                continue
            track = fly(self.vehicle, states[-1], schedule, begin, np.array([end]))
            bad = np.where(bad == 0, track.outcome, bad)
            use, at = (bad == 0)[:, None], track.at(0)
            states.append(
                k.Rows(
                    np.where(use, at.omega_B, start.omega_B),
                    np.where(use, at.sun_B, start.sun_B),
                    np.where(use, at.wheel_speed_rad_s, start.wheel_speed_rad_s),
                )
            )
        return states[1], states[2], bad

    def _after(
        self,
        start: k.Rows,
        momentum: np.ndarray,
        fixed: np.ndarray,
        draw: Draws,
        out: dict[str, np.ndarray],
        bad: np.ndarray,
    ) -> np.ndarray:
        """From the collision to the landing: r_z, antenna, first contact, rest. `fixed` (2, n, 3): vertical and orbiter."""
        s, schedule = self.scenario, self.strategy.schedule
        out["rz_share"][:], outcome = sun_height_shares(
            self.vehicle, start, schedule, s.collision_s, s.landing_s, BINS
        )
        bad = np.where(bad == 0, outcome, bad)
        flight = s.collision_s + s.after_s * (np.arange(FLIGHT_SAMPLES) + 0.5) / FLIGHT_SAMPLES
        approach = self._approach_times() if self.lands else flight[-1:]
        times = np.unique(np.concatenate([flight, approach]))
        track = fly(self.vehicle, start, schedule, s.collision_s, times)
        bad = np.where(bad == 0, track.outcome, bad)
        seen = carry(fixed, (momentum, start.sun_B), (track.momentum_B, track.sun_B))
        known = (bad == 0) & np.isfinite(seen).all(axis=(0, 2, 3))
        if self.vehicle.antenna is not None:
            served = _served(self.vehicle.antenna, seen[1][:, np.isin(times, flight)])
            out["antenna_share"][:] = np.where(known, served.mean(axis=1), np.nan)
        if not self.lands:
            return bad
        last = np.isin(times, approach)
        omega_B, step_s = track.omega_B[:, last], approach[1] - approach[0]
        turned = np.linalg.norm(omega_B[known], axis=2).max(axis=1) * step_s
        finer = np.zeros(len(bad), dtype=int)
        finer[known] = np.ceil(np.log2(np.maximum(turned / APPROACH_TURN_RAD, 1.0)))
        usual = np.flatnonzero(known & (finer == 0))
        self._land(usual, approach, seen[:, usual][:, :, last], omega_B[usual], draw, out)
        for level in np.unique(finer[finer > 0]).tolist():
            close, size = np.flatnonzero(finer == level), max(CHUNK >> level, 1)
            times = self._approach_times(level)
            for at in range(0, len(close), size):  # no more memory than a chunk of usual samples
                rows = close[at : at + size]
                some = start.take(rows)
                track = fly(self.vehicle, some, schedule, s.collision_s, times)
                bad[rows] = np.where(bad[rows] == 0, track.outcome, bad[rows])
                ends = (momentum[rows], some.sun_B), (track.momentum_B, track.sun_B)
                self._land(rows, times, carry(fixed[:, rows], *ends), track.omega_B, draw, out)
        return bad

    def _approach_times(self, finer: int = 0) -> np.ndarray:
        """The last instants, 2^finer times as close as usual."""
        usual = min(int(np.ceil(self.approach_s / APPROACH_STEP_S)), MAX_APPROACH_SAMPLES)
        count = usual * 2**finer
        return self.scenario.landing_s - self.approach_s * np.arange(count, -1, -1) / count

    def _land(
        self,
        rows: np.ndarray,
        t: np.ndarray,
        seen: np.ndarray,
        omega: np.ndarray,
        draw: Draws,
        out: dict[str, np.ndarray],
    ) -> None:
        """First contact and rest of the runs `rows` (n); `seen` (2, n, n_t, 3): vertical and orbiter, `omega` (n, n_t, 3)."""
        shape, antenna, legs = self.shape, self.vehicle.antenna, self.vehicle.legs
        if not len(rows) or shape is None:
            return
        (up, orbiter), sine, speed = seen, sc.STEEPEST_SINE, self.scenario.landing_speed_m_s
        # cosine law: what a plane of any direction shows
        normal = np.sqrt(sine**2 + (1 - sine**2) * draw["incidence"][rows])
        contact = first_contact(shape, t, up, omega, speed * normal)
        velocity = speed * sc.about(-contact.up_B, normal, draw["heading"][rows])
        point = shape.points_B_m[contact.point]
        over_ground = velocity + np.cross(contact.omega_B, point)
        out["contact_point"][rows] = contact.point
        out["contact_speed"][rows] = np.linalg.norm(over_ground, axis=1)
        out["up_z"][rows] = contact.up_B[:, 2]
        if legs:
            tips = np.array([leg.tip_B_m for leg in legs])
            at_tips = velocity[:, None] + np.cross(contact.omega_B[:, None], tips)
            out["leg_tip_speed"][rows] = np.linalg.norm(at_tips, axis=2).max(axis=1)
            rate = np.linalg.norm(contact.omega_B, axis=1)
            out["leg_tip_bound"][rows] = speed + rate * np.linalg.norm(tips, axis=1).max()
        # the orbiter at the contact, between samples along the chord
        i, after = np.arange(len(rows)), np.clip(np.searchsorted(t, contact.t_s), 1, len(t) - 1)
        part = ((contact.t_s - t[after - 1]) / (t[after] - t[after - 1]))[:, None]
        towards = (1 - part) * orbiter[i, after - 1] + part * orbiter[i, after]
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        if antenna is not None:
            out["antenna_at_contact"][rows] = _served(antenna, towards)
        if shape.outward_B is not None and shape.complete:
            facet = rest_facet(shape, contact.up_B)
            out["rest_facet"][rows] = facet
            if antenna is not None:
                down = -shape.outward_B[facet]
                resting = rotate_by_smallest(contact.up_B, down, towards)
                out["antenna_at_rest"][rows] = _served(antenna, resting)


def _served(antenna: Antenna, orbiter_B: np.ndarray) -> np.ndarray:
    """Whether the antenna serves directions (..., 3)."""
    return orbiter_B @ antenna.axis_B >= np.cos(antenna.opening_rad / 2)


def _nothing(dtype: Any) -> float:
    """What stands where nothing is told: NaN, or -1 in whole numbers."""
    return np.nan if np.dtype(dtype).kind == "f" else -1


def outcomes(
    vehicle: Vehicle,
    candidates: Any,
    strategy: Any = "off",
    n: int = 100_000,
    seed: int = 0,
    *,
    scenario: sc.Scenario | None = None,
    workers: int | None = None,
    store: str | Path | None = None,
    executor: Any = None,
    progress: bool = False,
    chunk: int = CHUNK,
) -> xr.Dataset:
    """What becomes of candidate motions: Monte Carlo over everything that is not known (paper, sections 3.3 and 4).

    Parameters
    ----------
    vehicle : Vehicle
        With inertia. Mass and legs are needed for the collision, a hull for what touches first, an antenna for its view;
        what is missing is said in `attrs["not_told"]`, one sentence each, and the rest is given.
    candidates : (m, 3) rad/s, or Dataset
        Body rates from which each run draws one, all equally likely; or a Dataset with `omega_B` (m, axis) and, if it has
        them, `sun_B`, `wheel_speed_rad_s`, `log_weight`.
    strategy : str, schedule or Strategy
        "off" at the touchdown, "held", "brake", "after_rest", "delay:SECONDS", or [(s after the touchdown, command), ...].
    n : int
        Number of runs.
    seed : int
        Run i draws from SeedSequence(seed, spawn_key=(i,)): runs of two strategies with one seed share what is drawn.
    scenario : Scenario, optional
        Times, speeds, distributions; default: that of the built-in case of the vehicle's name.
    workers, store, executor, progress, chunk
        As in :func:`sunspin.compute.rows.ensemble`.

    Returns
    -------
    xarray.Dataset
        Over `run`: `rz_share (run, rz)`, share of the time from collision to landing in each bin of r_z; `contact_point`,
        number of the point (coordinates `point`) that touches first, turning and descending; `leg_tip_speed`, the largest
        speed over ground of an end of a leg then (m/s); antenna and rest; rates (rad/s, B) before and after the collision. -1
        and NaN: not told. `outcome` 0: computed as asked.
        :func:`sunspin.landing.tally.tally` turns it into probabilities with their standard errors.
    """
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
        raise InputError("n must be a positive whole number of runs", got=n)
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError("seed must be zero or a positive whole number", got=seed)
    vehicle.require_inertia()
    scenario = scenario or own_scenario(vehicle)
    rows = OutcomeRows(
        vehicle,
        scenario,
        sc.strategy_of(vehicle, strategy),
        *candidates_of(vehicle, candidates, scenario),
        int(n),
        int(seed),
    )
    values = ensemble(
        rows,
        workers=workers,
        chunk=chunk,
        store=store,
        scheduler=executor,
        progress=progress,
        label="runs",
    )
    return dataset(rows, values)


def own_scenario(vehicle: Vehicle) -> sc.Scenario:
    if vehicle.name in case_names():
        return sc.case_scenario(replace(load_case(vehicle.name), vehicle=vehicle))
    raise InputError(
        f"nothing is known of what happens to {vehicle.name!r}",
        do="give scenario=Scenario(...) with times and speeds",
    )

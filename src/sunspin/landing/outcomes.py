"""What a motion means for the vehicle: collision, tumbling after it, what touches the ground first, does the antenna serve.

Each run draws a candidate motion and everything that is not known (which leg hits, from where, the local vertical, where
the orbiter is), see :mod:`sunspin.landing.scenario`; the runs go through the ensemble kernel (paper, sections 3.3 and 4).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.compute.rows import ensemble
from sunspin.dynamics import ensemble as k
from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.impact import impact
from sunspin.dynamics.propagate import wheel_speeds
from sunspin.dynamics.wheel_modes import command_at, mode_before
from sunspin.landing import scenario as sc
from sunspin.landing.contact import Shape, first_contact, rest_facet, shape_of, support
from sunspin.landing.flight import angle_about, carry, fly, sun_height_shares
from sunspin.landing.outcome_data import dataset
from sunspin.solve.rotations import smallest_turn
from sunspin.telemetry.case import case_names, load_case
from sunspin.vehicle import Antenna, Vehicle

BINS = 80
"""Bins of r_z over [-1, 1]; the paper's bounds -0.5 and -0.2 lie between bins."""

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


@dataclass(frozen=True)
class Candidates:
    """Possible motions at one instant: rates (m, 3) rad/s, Sun (m, 3), wheel speeds (m, n_wheel), how likely (m, sum 1)."""

    omega_B: np.ndarray
    sun_B: np.ndarray
    wheel_speed_rad_s: np.ndarray
    probability: np.ndarray

    def pick(self, uniform: np.ndarray) -> np.ndarray:
        """Numbers of the candidates that uniform numbers in [0, 1) fall on."""
        return np.minimum(
            np.searchsorted(np.cumsum(self.probability), uniform, side="right"),
            len(self.omega_B) - 1,
        )

    def rows(self, index: np.ndarray) -> k.Rows:
        return k.Rows(self.omega_B[index], self.sun_B[index], self.wheel_speed_rad_s[index])


def candidates_of(vehicle: Vehicle, given: Any, scenario: sc.Scenario) -> Candidates:
    """Candidates from rates (m, 3) rad/s, or from a Dataset with `omega_B` and, if it has them, `sun_B`,
    `wheel_speed_rad_s` and `log_weight`; the scenario's Sun and wheel speeds where they are not given.
    """
    held = given if isinstance(given, xr.Dataset) else {"omega_B": given}
    try:
        omega = np.atleast_2d(np.asarray(held["omega_B"], dtype=np.float64))
    except (KeyError, TypeError, ValueError):
        omega = np.zeros(0)
    if (
        omega.ndim != 2
        or omega.shape[1:] != (3,)
        or len(omega) == 0
        or not np.all(np.isfinite(omega))
    ):
        raise InputError(
            "candidates must be rates (m, 3) in rad/s, finite", got=f"shape {omega.shape}"
        )
    m, n_wheel = len(omega), len(vehicle.wheels)
    own = wheel_speeds(vehicle, list(scenario.wheel_speed_rad_s) or None)
    sun = np.asarray(
        held["sun_B"] if "sun_B" in held else np.tile(scenario.sun_B, (m, 1)), dtype=np.float64
    )
    speeds = np.asarray(
        held["wheel_speed_rad_s"] if "wheel_speed_rad_s" in held else np.tile(own, (m, 1)),
        dtype=np.float64,
    )
    weight = np.asarray(
        held["log_weight"] if "log_weight" in held else np.zeros(m), dtype=np.float64
    )
    if (
        sun.shape != (m, 3)
        or speeds.shape != (m, n_wheel)
        or weight.shape != (m,)
        or not np.any(np.isfinite(weight))
    ):
        shapes = f"{sun.shape}, {speeds.shape}, {weight.shape}"
        wanted = f"({m}, 3), ({m}, {n_wheel}), ({m},)"
        raise InputError(
            f"sun_B, wheel_speed_rad_s and log_weight of the candidates must be {wanted}",
            got=shapes,
        )
    likely = np.nan_to_num(np.exp(weight - np.nanmax(weight)))
    return Candidates(
        omega, sun / np.linalg.norm(sun, axis=1, keepdims=True), speeds, likely / likely.sum()
    )


@dataclass(frozen=True)
class OutcomeRows:
    """Run -> what becomes of it; the row function of :func:`outcomes`."""

    vehicle: Vehicle
    scenario: sc.Scenario
    strategy: sc.Strategy
    candidates: Candidates
    n: int
    seed: int
    shape: Shape | None = field(init=False, repr=False)
    verticals: np.ndarray = field(init=False, repr=False)

    outputs = {
        "outcome": ("int8", ()),
        "candidate": ("int32", ()),
        "leg": ("int8", ()),
        "rz_share": ("float32", (BINS,)),
        "omega_before_B": ("float64", (3,)),
        "omega_after_B": ("float64", (3,)),
        "momentum_before": ("float64", ()),
        "momentum_after": ("float64", ()),
        "velocity_change": ("float64", ()),
        "speed_after": ("float64", ()),
        "change_to_sun": ("float64", ()),
        "change_about_sun": ("float64", ()),
        "contact_point": ("int16", ()),
        "lowest_point": ("int16", ()),
        "contact_speed": ("float64", ()),
        "leg_tip_speed": ("float64", ()),
        "leg_tip_bound": ("float64", ()),
        "up_z": ("float64", ()),
        "antenna_share": ("float32", ()),
        "antenna_at_contact": ("int8", ()),
        "antenna_at_rest": ("int8", ()),
        "rest_facet": ("int16", ()),
    }

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", shape_of(self.vehicle))
        object.__setattr__(self, "verticals", sc.verticals(self.vehicle, self.scenario.vertical)[0])

    @property
    def n_rows(self) -> int:
        return self.n

    @property
    def collides(self) -> bool:
        return (
            self.scenario.collision_speed_m_s is not None
            and bool(self.vehicle.legs)
            and self.vehicle.mass_kg is not None
        )

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
        draw = sc.draws(self.seed, index)
        out = {
            name: np.full((len(index), *shape), _nothing(dtype), dtype)
            for name, (dtype, shape) in self.outputs.items()
        }
        out["candidate"][:] = self.candidates.pick(draw["candidate"])
        drawn, run_of = np.unique(out["candidate"], return_inverse=True)
        (touchdown, before), bad = self._to_collision(self.candidates.rows(drawn))
        touchdown, before, bad = touchdown.take(run_of), before.take(run_of), bad[run_of]
        after, impulse_B = self._collide(before, draw, out) if self.collides else (before, None)
        if self.collides:
            out["omega_before_B"][:], out["omega_after_B"][:] = before.omega_B, after.omega_B
        momenta = [
            g.total_momentum(self.vehicle, x.omega_B, x.wheel_speed_rad_s)
            for x in (touchdown, before, after)
        ]
        for name, momentum in zip(("momentum_before", "momentum_after"), momenta[1:], strict=True):
            out[name][:] = np.linalg.norm(momentum, axis=1)
        up = self.verticals[(draw["vertical"] * len(self.verticals)).astype(int)]
        orbiter = self._orbiter(up, draw)
        ends = (momenta[0], touchdown.sun_B), (momenta[1], before.sun_B)
        fixed = carry(np.stack([up, orbiter]), *ends)
        if impulse_B is not None:
            out["change_to_sun"][:], out["change_about_sun"][:] = angle_about(
                impulse_B, before.sun_B, fixed[0]
            )
        bad = self._after(after, momenta[2], fixed, draw, out, bad)
        return _without(out, bad)

    def _to_collision(self, start: k.Rows) -> tuple[tuple[k.Rows, k.Rows], np.ndarray]:
        """States at the touchdown and just before the collision of candidates (n), each run once however often it is drawn;
        the outcome (n)."""
        s = self.scenario
        flown = ((-np.inf, mode_before(start.wheel_speed_rad_s)),)
        back = fly(self.vehicle, start, flown, s.lead_s, np.array([0.0])) if s.lead_s > 0 else None
        bad = np.zeros(len(start), dtype=np.int64) if back is None else back.outcome
        touchdown = start if back is None else _healthy(back.at(0), start, bad)
        if s.collision_s == 0:
            return (touchdown, touchdown), bad
        track = fly(self.vehicle, touchdown, self.strategy.schedule, 0.0, np.array([s.collision_s]))
        bad = np.where(bad == 0, track.outcome, bad)
        return (touchdown, _healthy(track.at(0), start, bad)), bad

    def _collide(
        self, before: k.Rows, draw: dict[str, np.ndarray], out: dict[str, np.ndarray]
    ) -> tuple[k.Rows, np.ndarray]:
        """The state after the impact of a leg drawn at random (paper, eqs. 8-11: it sticks), and the impulse (n, 3) N s."""
        s = self.scenario
        leg = (draw["leg"] * len(self.vehicle.legs)).astype(int)
        axis = np.tile(s.collision_axis_B, (len(leg), 1))
        velocity = s.collision_speed_m_s * sc.about(axis, draw["polar"], draw["azimuth"])
        mode = command_at(self.strategy.schedule, s.collision_s)
        hit = impact(
            self.vehicle,
            before.omega_B,
            before.wheel_speed_rad_s,
            velocity,
            leg,
            mode,
            restitution=s.restitution,
            damper=s.damper,
        )
        out["leg"][:] = leg
        out["velocity_change"][:] = (
            np.linalg.norm(hit["impulse_B"].values, axis=1) / self.vehicle.require_mass()
        )
        out["speed_after"][:] = np.linalg.norm(hit["velocity_B"].values, axis=1)
        return k.Rows(hit["omega_B"].values, before.sun_B, hit["wheel_speed_rad_s"].values), hit[
            "impulse_B"
        ].values

    def _orbiter(self, up: np.ndarray, draw: dict[str, np.ndarray]) -> np.ndarray:
        wanted = self.scenario.orbiter
        if not isinstance(wanted, str):
            return np.tile(np.array(wanted, float) / np.linalg.norm(wanted), (len(up), 1))
        cosine = (
            draw["orbiter_polar"] if wanted == "above_horizon" else 2 * draw["orbiter_polar"] - 1
        )
        return sc.about(up, cosine, draw["orbiter_azimuth"])

    def _after(
        self,
        start: k.Rows,
        momentum: np.ndarray,
        fixed: np.ndarray,
        draw: dict[str, np.ndarray],
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
        ends = (momentum, start.sun_B), (track.momentum_B, track.sun_B)
        up, orbiter = carry(fixed, *ends)
        known = (
            (bad == 0) & np.isfinite(up).all(axis=(1, 2)) & np.isfinite(orbiter).all(axis=(1, 2))
        )
        if self.vehicle.antenna is not None:
            served = _served(self.vehicle.antenna, orbiter[:, np.isin(times, flight)])
            out["antenna_share"][:] = np.where(known, served.mean(axis=1), np.nan)
        if not self.lands:
            return bad
        last = np.isin(times, approach)
        turned = np.linalg.norm(track.omega_B[:, last], axis=2).max(axis=1) * (
            times[last][1] - times[last][0]
        )
        finer = np.zeros(len(bad), dtype=int)
        finer[known] = np.ceil(np.log2(np.maximum(turned[known] / APPROACH_TURN_RAD, 1.0)))
        pieces = up[:, last], orbiter[:, last], track.omega_B[:, last]
        self._land_some(np.flatnonzero(known & (finer == 0)), approach, pieces, draw, out)
        for rows, level in _slices(finer):
            t = self._approach_times(level)
            some = k.Rows(start.omega_B[rows], start.sun_B[rows], start.wheel_speed_rad_s[rows])
            track = fly(self.vehicle, some, schedule, s.collision_s, t)
            again = carry(
                fixed[:, rows], (momentum[rows], some.sun_B), (track.momentum_B, track.sun_B)
            )
            bad[rows] = np.where(bad[rows] == 0, track.outcome, bad[rows])
            self._land_some(rows, t, (*again, track.omega_B), draw, out, np.arange(len(rows)))
        return bad

    def _land_some(
        self,
        rows: np.ndarray,
        t: np.ndarray,
        pieces: tuple[np.ndarray, np.ndarray, np.ndarray],
        draw: dict[str, np.ndarray],
        out: dict[str, np.ndarray],
        at: np.ndarray | None = None,
    ) -> None:
        """First contact and rest of some runs; `pieces`: vertical, orbiter, rate (n, n_t, 3), of which these are at `at`."""
        if not len(rows):
            return
        part = {name: values[rows] for name, values in out.items()}
        up, orbiter, omega = (x[rows if at is None else at] for x in pieces)
        self._land(t, up, orbiter, omega, {name: value[rows] for name, value in draw.items()}, part)
        for name, values in part.items():
            out[name][rows] = values

    def _approach_times(self, finer: int = 0) -> np.ndarray:
        """The last instants, 2^finer times as close as usual."""
        count = (
            min(int(np.ceil(self.approach_s / APPROACH_STEP_S)), MAX_APPROACH_SAMPLES) * 2**finer
        )
        return self.scenario.landing_s - self.approach_s * np.arange(count, -1, -1) / count

    def _land(
        self,
        t: np.ndarray,
        up: np.ndarray,
        orbiter: np.ndarray,
        omega: np.ndarray,
        draw: dict[str, np.ndarray],
        out: dict[str, np.ndarray],
    ) -> None:
        sine, shape, antenna = sc.STEEPEST_SINE, self.shape, self.vehicle.antenna
        assert shape is not None  # `lands`
        normal = np.sqrt(
            sine**2 + (1 - sine**2) * draw["incidence"]
        )  # cosine law: what a plane of any direction shows
        speed = self.scenario.landing_speed_m_s
        contact = first_contact(shape, t, up, omega, speed * normal)
        velocity = speed * sc.about(-contact.up_B, normal, draw["heading"])
        out["contact_point"][:] = contact.point
        out["lowest_point"][:] = support(shape.points_B_m, -up[:, -1])[1]
        point = shape.points_B_m[contact.point]
        out["contact_speed"][:] = np.linalg.norm(
            velocity + np.cross(contact.omega_B, point), axis=1
        )
        out["up_z"][:] = contact.up_B[:, 2]
        if self.vehicle.legs:
            tips = np.array([leg.tip_B_m for leg in self.vehicle.legs])
            at_tips = velocity[:, None] + np.cross(contact.omega_B[:, None], tips)
            out["leg_tip_speed"][:] = np.linalg.norm(at_tips, axis=2).max(axis=1)
            rate, length = (
                np.linalg.norm(contact.omega_B, axis=1),
                np.linalg.norm(tips, axis=1).max(),
            )
            out["leg_tip_bound"][:] = speed + rate * length
        seen = _at(t, orbiter, contact.t_s)
        if antenna is not None:
            out["antenna_at_contact"][:] = _served(antenna, seen)
        if shape.outward_B is not None and shape.complete:
            facet = rest_facet(shape, contact.up_B)
            out["rest_facet"][:] = facet
            if antenna is not None:
                out["antenna_at_rest"][:] = _served(
                    antenna, smallest_turn(contact.up_B, -shape.outward_B[facet], seen)
                )


def _served(antenna: Antenna, orbiter_B: np.ndarray) -> np.ndarray:
    """Whether the antenna serves directions (..., 3)."""
    return orbiter_B @ antenna.axis_B >= np.cos(antenna.opening_rad / 2)


def _slices(finer: np.ndarray) -> Iterator[tuple[np.ndarray, int]]:
    """Runs that need closer samples, and how much closer, in pieces that take no more memory than a chunk of usual ones."""
    for level in np.unique(finer[finer > 0]):
        rows = np.flatnonzero(finer == level)
        size = max(CHUNK >> int(level), 1)
        yield from ((rows[i : i + size], int(level)) for i in range(0, len(rows), size))


def _nothing(dtype: str) -> float:
    """What stands where nothing is told: NaN, or -1 in whole numbers."""
    return np.nan if dtype.startswith("float") else -1


def _healthy(rows: k.Rows, instead: k.Rows, bad: np.ndarray) -> k.Rows:
    """Rows to go on with: failed ones restart from a finite state, and are blanked at the end."""
    use = (bad != 0)[:, None]
    omega, sun = (
        np.where(use, instead.omega_B, rows.omega_B),
        np.where(use, instead.sun_B, rows.sun_B),
    )
    return k.Rows(omega, sun, np.where(use, instead.wheel_speed_rad_s, rows.wheel_speed_rad_s))


def _without(out: dict[str, np.ndarray], bad: np.ndarray) -> dict[str, np.ndarray]:
    for name, values in out.items():
        if name != "candidate":
            values[bad != 0] = _nothing(str(values.dtype))
    out["outcome"][:] = bad
    return out


def _at(t: np.ndarray, values: np.ndarray, when: np.ndarray) -> np.ndarray:
    """Directions (n, 3) at times `when` (n) from samples (n, n_t, 3), interpolated along the chord."""
    rows, after = np.arange(len(when)), np.clip(np.searchsorted(t, when), 1, len(t) - 1)
    part = ((when - t[after - 1]) / (t[after] - t[after - 1]))[:, None]
    between = (1 - part) * values[rows, after - 1] + part * values[rows, after]
    return between / np.linalg.norm(between, axis=1, keepdims=True)


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
    scheduler: Any = None,
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
    workers, store, scheduler, progress, chunk
        As in :func:`sunspin.compute.rows.ensemble`.

    Returns
    -------
    xarray.Dataset
        Over `run`: `rz_share (run, rz)`, share of the time from collision to landing in each bin of r_z; `contact_point`,
        number of the point (coordinates `point`) that touches first, turning and descending; `lowest_point`, the lowest
        one at a fixed time; `leg_tip_speed`, the largest speed over ground of an end of a leg then (m/s); antenna and rest;
        rates (rad/s, B) before and after the collision. -1 and NaN: not told. `outcome` 0: computed as asked.
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
        candidates_of(vehicle, candidates, scenario),
        int(n),
        int(seed),
    )
    options: dict[str, Any] = {
        "workers": workers,
        "store": store,
        "scheduler": scheduler,
        "progress": progress,
        "chunk": chunk,
    }
    return dataset(rows, ensemble(rows, label="runs", **options))


def own_scenario(vehicle: Vehicle) -> sc.Scenario:
    if vehicle.name in case_names():
        return sc.case_scenario(replace(load_case(vehicle.name), vehicle=vehicle))
    raise InputError(
        f"nothing is known of what happens to {vehicle.name!r}",
        do="give scenario=Scenario(...) with times and speeds",
    )

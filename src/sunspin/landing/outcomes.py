"""Outcomes of candidate motions for a lander: collision, tumbling after it, first contact with the ground, antenna visibility.

Each run draws a candidate motion and all unknown quantities: the leg that hits, the direction of the impact, the local vertical and
the direction to the orbiter (:mod:`sunspin.landing.scenario`). The ensemble kernel propagates the runs (paper, sections 3.3 and 4).
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
from sunspin.dynamics.batch import Rows
from sunspin.dynamics.gyrostat import total_momentum
from sunspin.dynamics.impact import impact
from sunspin.dynamics.propagate import wheel_speeds
from sunspin.dynamics.wheel_modes import command_at, mode_before
from sunspin.landing.contact import Shape, build_shape, first_contact, rest_facet
from sunspin.landing.flight import angle_about, fly, rz_time_shares, transfer_directions
from sunspin.landing.outcome_data import BINS, VARIABLES, extra_dimension, outcome_dataset
from sunspin.landing.scenario import (
    FLATTEST_SINE,
    Scenario,
    Strategy,
    case_scenario,
    directions_at_angle,
    draw_uniform,
    parse_strategy,
    possible_verticals,
)
from sunspin.solve.rotations import rotate_by_smallest
from sunspin.vehicle import Antenna, Vehicle

CHUNK = 2048
"""Runs per call: the tracks of one chunk take some 100 MB."""

FLIGHT_SAMPLES = 48
"""Number of instants after the collision at which the antenna is tested."""

APPROACH_STEP_S = 0.4
"""Time between samples of the last metres: the vehicle rotates by 0.1 to 0.2 rad at the rates of a rebound."""

MAX_APPROACH_SAMPLES = 400
"""Largest number of samples of the last metres, unless a run rotates fast."""

APPROACH_TURN_RAD = 0.25
"""Runs that rotate by more than this from one sample to the next are repeated with twice, four times ... as many samples. At 3
rad/s and samples 1.2 rad apart, a tenth of the runs touched with the wrong point."""

STAGES = ("collision", "flight", "landing")
"""Last stage of a simulation, each with those before it. The collision gives rates, momenta and speeds; the flight after it the
distribution of r_z; the landing the antenna's visibility, first contact and rest. Flight and landing take about as long each."""

Draws = dict[str, np.ndarray]
"""Name of `scenario.DRAWS` -> uniform random numbers (n), one for each run."""


def read_candidates(vehicle: Vehicle, given: Any, scenario: Scenario) -> tuple[Rows, np.ndarray]:
    """Return possible motions (m) at one instant, and their probabilities (m).

    Parameters
    ----------
    given : (m, 3) rad/s, or Dataset
        Body rates, all equally probable; or a Dataset with `omega_B` and optionally `sun_B`, `wheel_speed_rad_s` and `log_weight`.
        Sun and wheel speeds are those of the scenario if they are not given.

    Raises
    ------
    InputError
        An array has the wrong shape, or a rate is not finite.
    """
    fields = given if isinstance(given, xr.Dataset) else {"omega_B": given}
    try:
        omega = np.atleast_2d(np.asarray(fields["omega_B"], dtype=np.float64))
    except (KeyError, TypeError, ValueError):
        omega = np.zeros(0)  # refused below
    if omega.shape[1:] != (3,) or len(omega) == 0 or not np.all(np.isfinite(omega)):
        what = "candidates must be rates (m, 3) in rad/s, finite"
        raise InputError(what, got=f"shape {omega.shape}")
    m = len(omega)
    nominal = wheel_speeds(vehicle, list(scenario.wheel_speed_rad_s) or None)
    default = {
        "sun_B": np.tile(scenario.sun_B, (m, 1)),
        "wheel_speed_rad_s": np.tile(nominal, (m, 1)),
        "log_weight": np.zeros(m),
    }
    sun, speeds, log_weight = (
        np.asarray(fields[name] if name in fields else values, dtype=np.float64)
        for name, values in default.items()
    )
    shapes = sun.shape, speeds.shape, log_weight.shape
    expected = (m, 3), (m, len(nominal)), (m,)
    if shapes != expected or not np.any(np.isfinite(log_weight)):
        what = f"sun_B, wheel_speed_rad_s and log_weight of the candidates must be {expected}"
        raise InputError(what, got=shapes)
    # relative to the largest, so that exp does not overflow; a weight of NaN is a probability of zero
    probability = np.nan_to_num(np.exp(log_weight - np.nanmax(log_weight)))
    states = Rows(omega, sun / np.linalg.norm(sun, axis=1, keepdims=True), speeds)
    return states, probability / probability.sum()


def collide(
    vehicle: Vehicle, scenario: Scenario, draw: Draws, before: Rows, mode: Any
) -> tuple[np.ndarray, xr.Dataset]:
    """Return the leg that hits in each run (n), drawn at random, and the :func:`sunspin.impact` of it (paper, eqs. 8 to 11).

    `before` are the states (n) just before the collision, `mode` is the command of the wheels. The velocity (body axes) is of the
    scenario's speed, in a direction that `draw` takes from the hemisphere around `collision_axis_B`.
    """
    leg = (draw["leg"] * len(vehicle.legs)).astype(int)
    axis = np.tile(scenario.collision_axis_B, (len(leg), 1))
    return leg, impact(
        vehicle,
        before.omega_B,
        before.wheel_speed_rad_s,
        scenario.collision_speed_m_s * directions_at_angle(axis, draw["polar"], draw["azimuth"]),
        leg,
        mode,
        restitution=scenario.restitution,
        damper=scenario.damper,
    )


@dataclass(frozen=True)
class OutcomeRows:
    """Callable that computes the outcome of runs by their numbers, for :func:`sunspin.compute.rows.ensemble`.

    `candidates` (m) are motions with their `probability` (m). `until` is the last stage (`STAGES`); values of later ones are
    missing. `verticals` (m_up, 3) are the equally probable directions up.
    """

    vehicle: Vehicle
    scenario: Scenario
    strategy: Strategy
    candidates: Rows
    probability: np.ndarray
    n_rows: int
    seed: int
    until: str = "landing"
    shape: Shape | None = field(init=False, repr=False)
    verticals: np.ndarray = field(init=False, repr=False)

    outputs = {
        name: (dtype, {"rz": (BINS,), "axis": (3,), None: ()}[extra_dimension(name)])
        for name, (dtype, _, _) in VARIABLES.items()
    }

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", build_shape(self.vehicle))
        up_B, _ = possible_verticals(self.vehicle, self.scenario.vertical)
        object.__setattr__(self, "verticals", up_B)

    @property
    def collides(self) -> bool:
        """True if the scenario has a collision and the vehicle file has what it needs: legs and mass."""
        speed, mass = self.scenario.collision_speed_m_s, self.vehicle.mass_kg
        return speed is not None and bool(self.vehicle.legs) and mass is not None

    @property
    def lands(self) -> bool:
        """True if the vehicle has a shape, and the flight is longer than its last metres."""
        return self.shape is not None and self.approach_s < self.scenario.after_s

    @property
    def approach_s(self) -> float:
        """Duration (s) of the last metres, in which a point may touch the ground before the centre of mass would.

        It is that of the flattest landing (`FLATTEST_SINE`) and of the point farthest from the centre of mass, with a margin of
        2 % and 1 s.
        """
        reach = 0.0 if self.shape is None else self.shape.reach_m
        return 1.02 * reach / (FLATTEST_SINE * self.scenario.landing_speed_m_s) + 1.0

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        """Return name of `VARIABLES` -> values (n, ...) of the runs with the numbers `index` (n).

        Runs that could not be computed have only `candidate` and `outcome`; the other values are missing.
        """
        scenario, draw = self.scenario, draw_uniform(self.seed, index)
        out = {
            name: np.full((len(index), *shape), _missing_value(dtype), dtype)
            for name, (dtype, shape) in self.outputs.items()
        }

        # a candidate is propagated to the collision once, however many runs draw it
        number = np.searchsorted(np.cumsum(self.probability), draw["candidate"], side="right")
        out["candidate"][:] = np.minimum(number, len(self.candidates) - 1)
        drawn, inverse = np.unique(out["candidate"], return_inverse=True)
        touchdown, before, failed = self._propagate_to_collision(self.candidates.take(drawn))
        touchdown, before, failed = touchdown.take(inverse), before.take(inverse), failed[inverse]

        after, impulse_B = before, None
        if self.collides:
            mode = command_at(self.strategy.schedule, scenario.collision_s)
            out["leg"][:], hit = collide(self.vehicle, scenario, draw, before, mode)
            impulse_B = hit["impulse_B"].values
            after = Rows(hit["omega_B"].values, before.sun_B, hit["wheel_speed_rad_s"].values)
            impulse = np.linalg.norm(impulse_B, axis=1)
            out["velocity_change"][:] = impulse / self.vehicle.require_mass()
            out["speed_after"][:] = np.linalg.norm(hit["velocity_B"].values, axis=1)
            out["omega_before_B"][:], out["omega_after_B"][:] = before.omega_B, after.omega_B
        momentum_touchdown, momentum_before, momentum_after = (
            total_momentum(self.vehicle, state.omega_B, state.wheel_speed_rad_s)
            for state in (touchdown, before, after)
        )
        out["momentum_before"][:] = np.linalg.norm(momentum_before, axis=1)
        out["momentum_after"][:] = np.linalg.norm(momentum_after, axis=1)

        # vertical and orbiter are drawn at the touchdown, and then needed in body axes at the collision
        up = self.verticals[(draw["vertical"] * len(self.verticals)).astype(int)]
        if isinstance(scenario.orbiter, str):
            # uniform over a sphere: the cosine to the vertical is uniform in [0, 1] or [-1, 1]
            polar = draw["orbiter_polar"]
            cosine = polar if scenario.orbiter == "above_horizon" else 2 * polar - 1
            orbiter = directions_at_angle(up, cosine, draw["orbiter_azimuth"])
        else:
            given = np.array(scenario.orbiter, dtype=float)
            orbiter = np.tile(given / np.linalg.norm(scenario.orbiter), (len(up), 1))
        up_and_orbiter = transfer_directions(
            np.stack([up, orbiter]),
            (momentum_touchdown, touchdown.sun_B),
            (momentum_before, before.sun_B),
        )
        if impulse_B is not None:
            out["change_to_sun"][:], out["change_about_sun"][:] = angle_about(
                impulse_B, before.sun_B, up_and_orbiter[0]
            )

        if self.until != "collision":
            failed = self._propagate_to_landing(
                after, momentum_after, up_and_orbiter, draw, out, failed
            )
        for name, values in out.items():
            if name != "candidate":
                values[failed != 0] = _missing_value(values.dtype)
        out["outcome"][:] = failed
        return out

    def _propagate_to_collision(self, start: Rows) -> tuple[Rows, Rows, np.ndarray]:
        """Return the states of candidates (n) at the touchdown and just before the collision, and the outcome (n).

        `start` has their states at the instant of the candidates. Candidates that fail continue from there, with finite numbers;
        their runs are marked as missing at the end.
        """
        lead_s, collision_s = self.scenario.lead_s, self.scenario.collision_s
        states, failed = [start], np.zeros(len(start), dtype=np.int64)
        # back to the touchdown, then forward to the collision
        back = ((-np.inf, mode_before(start.wheel_speed_rad_s)),)
        for schedule, begin, end in (
            (back, lead_s, 0.0),
            (self.strategy.schedule, 0.0, collision_s),
        ):
            if begin == end:
                states.append(states[-1])
                continue
            track = fly(self.vehicle, states[-1], schedule, begin, np.array([end]))
            failed = np.where(failed == 0, track.outcome, failed)
            computed, at_end = (failed == 0)[:, None], track.at(0)
            states.append(
                Rows(
                    np.where(computed, at_end.omega_B, start.omega_B),
                    np.where(computed, at_end.sun_B, start.sun_B),
                    np.where(computed, at_end.wheel_speed_rad_s, start.wheel_speed_rad_s),
                )
            )
        _, touchdown, before_collision = states
        return touchdown, before_collision, failed

    def _propagate_to_landing(
        self,
        start: Rows,
        momentum: np.ndarray,
        up_and_orbiter: np.ndarray,
        draw: Draws,
        out: dict[str, np.ndarray],
        failed: np.ndarray,
    ) -> np.ndarray:
        """Write r_z, antenna, first contact and rest into `out`, and return the outcome (n).

        Parameters
        ----------
        start : Rows
            States (n) just after the collision; `momentum` (n, 3) is their total angular momentum.
        up_and_orbiter : (2, n, 3)
            Vertical and direction to the orbiter, which are fixed in space; body axes at the collision.
        failed : (n)
            Outcome so far: not 0 for runs that could not be computed.
        """
        scenario, schedule = self.scenario, self.strategy.schedule
        out["rz_share"][:], outcome = rz_time_shares(
            self.vehicle, start, schedule, scenario.collision_s, scenario.landing_s, BINS
        )
        failed = np.where(failed == 0, outcome, failed)
        if self.until == "flight":
            return failed
        # middles of equal intervals of the flight, and the samples of the last metres
        flight = (
            scenario.collision_s
            + scenario.after_s * (np.arange(FLIGHT_SAMPLES) + 0.5) / FLIGHT_SAMPLES
        )
        approach = self._approach_times() if self.lands else flight[-1:]
        times = np.unique(np.concatenate([flight, approach]))
        track = fly(self.vehicle, start, schedule, scenario.collision_s, times)
        failed = np.where(failed == 0, track.outcome, failed)
        # vertical and orbiter in body axes (2, n, n_t, 3); NaN if momentum and Sun are parallel
        directions = transfer_directions(
            up_and_orbiter, (momentum, start.sun_B), (track.momentum_B, track.sun_B)
        )
        known = (failed == 0) & np.isfinite(directions).all(axis=(0, 2, 3))
        if self.vehicle.antenna is not None:
            in_cone = _is_in_cone(self.vehicle.antenna, directions[1][:, np.isin(times, flight)])
            out["antenna_share"][:] = np.where(known, in_cone.mean(axis=1), np.nan)
        if not self.lands:
            return failed
        in_approach = np.isin(times, approach)
        omega_B, step_s = track.omega_B[:, in_approach], approach[1] - approach[0]
        angle = np.linalg.norm(omega_B[known], axis=2).max(axis=1) * step_s
        # runs that rotate too far between samples are repeated with 2^level times as many samples
        levels = np.zeros(len(failed), dtype=int)
        levels[known] = np.ceil(np.log2(np.maximum(angle / APPROACH_TURN_RAD, 1.0)))
        usual = np.flatnonzero(known & (levels == 0))
        usual_directions = directions[:, usual][:, :, in_approach]
        self._write_contact(usual, approach, usual_directions, omega_B[usual], draw, out)
        for level in np.unique(levels[levels > 0]).tolist():
            fast = np.flatnonzero(levels == level)
            # fewer runs at a time, so that more samples need no more memory than a chunk of usual ones
            size = max(CHUNK >> level, 1)
            times = self._approach_times(level)
            for first in range(0, len(fast), size):
                rows = fast[first : first + size]
                states = start.take(rows)
                track = fly(self.vehicle, states, schedule, scenario.collision_s, times)
                failed[rows] = np.where(failed[rows] == 0, track.outcome, failed[rows])
                directions = transfer_directions(
                    up_and_orbiter[:, rows],
                    (momentum[rows], states.sun_B),
                    (track.momentum_B, track.sun_B),
                )
                self._write_contact(rows, times, directions, track.omega_B, draw, out)
        return failed

    def _approach_times(self, level: int = 0) -> np.ndarray:
        """Return the instants (s from the touchdown) of the last metres, up to the landing, 2^level times as close as usual."""
        usual = min(int(np.ceil(self.approach_s / APPROACH_STEP_S)), MAX_APPROACH_SAMPLES)
        intervals = usual * 2**level
        return self.scenario.landing_s - self.approach_s * np.arange(intervals, -1, -1) / intervals

    def _write_contact(
        self,
        rows: np.ndarray,
        t_s: np.ndarray,
        directions: np.ndarray,
        omega_B: np.ndarray,
        draw: Draws,
        out: dict[str, np.ndarray],
    ) -> None:
        """Write first contact and rest of some runs into `out`; nothing without runs or without a shape.

        Parameters
        ----------
        rows : (n)
            Numbers of the runs in `draw` and `out`.
        t_s : (n_t), s, instants of the last metres
        directions : (2, n, n_t, 3)
            Vertical and direction to the orbiter, body axes.
        omega_B : (n, n_t, 3), rad/s
        """
        shape, antenna, legs = self.shape, self.vehicle.antenna, self.vehicle.legs
        if not len(rows) or shape is None:
            return
        (up, orbiter), speed = directions, self.scenario.landing_speed_m_s
        # Cosine law: a plane of any direction is hit in proportion to the area that it shows. So the square of `sine`, which is
        # normal speed over speed, is uniform; flatter landings than the flattest are left out.
        sine = np.sqrt(FLATTEST_SINE**2 + (1 - FLATTEST_SINE**2) * draw["incidence"][rows])
        contact = first_contact(shape, t_s, up, omega_B, speed * sine)
        velocity = speed * directions_at_angle(-contact.up_B, sine, draw["heading"][rows])
        point = shape.points_B_m[contact.point]
        over_ground = velocity + np.cross(contact.omega_B, point)
        out["contact_point"][rows] = contact.point
        out["contact_speed"][rows] = np.linalg.norm(over_ground, axis=1)
        out["up_z"][rows] = contact.up_B[:, 2]
        if legs:
            tips = np.array([leg.tip_B_m for leg in legs])
            at_tips = velocity[:, None] + np.cross(contact.omega_B[:, None], tips)
            out["leg_tip_speed"][rows] = np.linalg.norm(at_tips, axis=2).max(axis=1)
            rate = np.linalg.norm(contact.omega_B, axis=1)  # the bound is v + |l| |omega| (paper)
            out["leg_tip_bound"][rows] = speed + rate * np.linalg.norm(tips, axis=1).max()
        # direction to the orbiter at the contact, interpolated linearly between samples
        i = np.arange(len(rows))
        after = np.clip(np.searchsorted(t_s, contact.t_s), 1, len(t_s) - 1)
        share = ((contact.t_s - t_s[after - 1]) / (t_s[after] - t_s[after - 1]))[:, None]
        orbiter_at_contact = (1 - share) * orbiter[i, after - 1] + share * orbiter[i, after]
        orbiter_at_contact /= np.linalg.norm(orbiter_at_contact, axis=1, keepdims=True)
        if antenna is not None:
            out["antenna_at_contact"][rows] = _is_in_cone(antenna, orbiter_at_contact)
        if shape.outward_B is not None and shape.complete:
            facet = rest_facet(shape, contact.up_B)
            out["rest_facet"][rows] = facet
            if antenna is not None:
                # the vertical, which was up_B at the contact, is opposite to the facet's outward normal at rest
                up_at_rest = -shape.outward_B[facet]
                orbiter_at_rest = rotate_by_smallest(contact.up_B, up_at_rest, orbiter_at_contact)
                out["antenna_at_rest"][rows] = _is_in_cone(antenna, orbiter_at_rest)


def _is_in_cone(antenna: Antenna, orbiter_B: np.ndarray) -> np.ndarray:
    """Return whether directions (..., 3) to the orbiter are in the cone of the antenna."""
    return orbiter_B @ antenna.axis_B >= np.cos(antenna.opening_rad / 2)


def _missing_value(dtype: Any) -> float:
    """Return the value that marks a missing result: NaN, or -1 for whole numbers."""
    return np.nan if np.dtype(dtype).kind == "f" else -1


def outcomes(
    vehicle: Vehicle,
    candidates: Any,
    strategy: Any = "off",
    n: int = 100_000,
    seed: int = 0,
    *,
    scenario: Scenario | None = None,
    until: str = "landing",
    workers: int | None = None,
    store: str | Path | None = None,
    executor: Any = None,
    progress: bool = False,
    chunk: int = CHUNK,
) -> xr.Dataset:
    """Compute the outcomes of candidate motions by Monte Carlo over all unknown quantities (paper, sections 3.3 and 4).

    Parameters
    ----------
    vehicle : Vehicle
        With inertia. Mass and legs are needed for the collision, a hull for the first contact, an antenna for its visibility. If
        something is missing, the other results are computed, and `attrs["not_told"]` has a sentence on each missing one.
    candidates : (m, 3) rad/s, or Dataset
        Body rates from which each run draws one, all equally probable; or a Dataset with `omega_B` (m, axis) and optionally
        `sun_B`, `wheel_speed_rad_s`, `log_weight`.
    strategy : str, schedule or Strategy
        "off" at the touchdown, "held", "brake", "after_rest", "delay:SECONDS", or [(s after the touchdown, command), ...].
    n : int
        Number of runs.
    seed : int
        Run i draws from SeedSequence(seed, spawn_key=(i,)), so that runs of two strategies with the same seed share their draws.
    scenario : Scenario, optional
        Times, speeds, distributions; default: that of the built-in case of the vehicle's name.
    until : "collision", "flight" or "landing"
        Last stage that is simulated (`STAGES`); values of later stages are missing. An earlier end takes less time.
    workers, store, executor, progress, chunk
        As in :func:`sunspin.compute.rows.ensemble`.

    Returns
    -------
    xarray.Dataset
        Over `run`: `rz_share (run, rz)`, share of the time from collision to landing in each bin of r_z; `contact_point`,
        number of the point (coordinates `point`) that touches first; `leg_tip_speed`, the largest speed over ground of an end of a
        leg at that instant (m/s); antenna and rest; rates (rad/s, B) before and after the collision. -1 and NaN mean that a value
        is not known. `outcome` is 0 if the run was computed.
        :func:`sunspin.landing.tally.tally` turns it into probabilities with their standard errors.
    """
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
        raise InputError("n must be a positive whole number of runs", got=n)
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError("seed must be zero or a positive whole number", got=seed)
    if until not in STAGES:
        raise InputError(f"until must be one of {', '.join(STAGES)}", got=until)
    vehicle.require_inertia()
    scenario = scenario or default_scenario(vehicle)
    rows = OutcomeRows(
        vehicle,
        scenario,
        parse_strategy(vehicle, strategy),
        *read_candidates(vehicle, candidates, scenario),
        int(n),
        int(seed),
        until,
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
    return outcome_dataset(rows, values)


def default_scenario(vehicle: Vehicle) -> Scenario:
    """Return the scenario of the built-in case with the name of the vehicle; raise an `InputError` if there is none."""
    if vehicle.name in case_names():
        return case_scenario(replace(load_case(vehicle.name), vehicle=vehicle))
    raise InputError(
        f"nothing is known of what happens to {vehicle.name!r}",
        do="give scenario=Scenario(...) with times and speeds",
    )

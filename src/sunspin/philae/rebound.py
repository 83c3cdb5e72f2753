"""Philae between the first touchdown and the collision (paper, sections 2.3 and 3.2).

Holds the paper's scan grid and its four lines, and the samples that a telemetry file has in this interval. It also makes the
initial states of the candidate motions and propagates them back to the touchdown.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, MotionError, TelemetryError
from sunspin.base.untrusted import read_toml
from sunspin.cases import Case
from sunspin.compute.identity import to_json
from sunspin.dynamics import batch, gyrostat
from sunspin.dynamics.batch import Rows
from sunspin.dynamics.propagate import propagate
from sunspin.dynamics.wheel_modes import mode_before
from sunspin.estimate.scan.directions import (
    DirectionSet,
    reconstructible_mask,
    target_weights,
)
from sunspin.estimate.scan.lines import Line, point_at
from sunspin.landing.scenario import Scenario, case_scenario, paper_scenario
from sunspin.telemetry.sun import is_reconstructed
from sunspin.vehicle import Vehicle
from sunspin.vehicle.timeline import utc_seconds

RATE_DIRECTION_ERROR = 1e-9
"""Direction error (rad) at the end of a run of which the rates are wanted: their relative error is about as large."""

LINE_RANGE = (-0.2, 0.3)
"""Range of omega_z (rad/s) over which fitted and published lines are compared."""


@dataclass(frozen=True)
class Options:
    """Options of a run of the study.

    Attributes
    ----------
    source : source of the candidates: "scan", "posterior", "published", or the path of a table with columns omega_x, omega_y,
        omega_z (rad/s)
    simulations : number of simulated rebounds of a calibration. None: the shipped calibration if it fits the data, else as many as
        its default. Zero: none.
    seed : seed of all random choices
    coarser : use every n-th grid point of the scan and of the maps; 1 is the paper's grid
    workers, progress : threads, progress bars
    """

    source: str = "scan"
    simulations: int | None = None
    seed: int = 0
    coarser: int = 1
    workers: int | None = None
    progress: bool = False


def first_sun(case: Case) -> np.ndarray:
    """Return the published first Sun direction (3) after the touchdown, in body axes. It is not exactly of length 1."""
    return np.array(case.published["first_sun"].value)


def nominal_wheel_speeds(vehicle: Vehicle) -> list[float]:
    """Return the wheel speeds in rad/s before the wheels are switched off."""
    return [wheel.speed_rad_s for wheel in vehicle.wheels]


def published_window_s(case: Case) -> float:
    """Return the duration of the paper's simulations in s."""
    return 60.0 * float(case.published["scan_duration"].value)


def first_sample_lead_s(case: Case) -> float:
    """Return the time in s from the first touchdown to the first sample after it."""
    if case.assumptions.study.lead_s is not None:
        return case.assumptions.study.lead_s
    return case.require_timeline().seconds("first_touchdown", "first_sample_after_touchdown")


def event_seconds(case: Case, data: xr.Dataset, event: str) -> float:
    """Return the time of an event in s from the epoch of a Dataset. A refined time takes precedence over that of Table 1."""
    moment = case.require_timeline().event(event)
    return utc_seconds(moment.refined_utc or moment.utc, data.attrs["epoch_utc"])


def scan_limits(case: Case) -> np.ndarray:
    """Return the limits (3, 2) of the scanned initial rates in rad/s."""
    return np.array([case.published[f"scan_omega_{axis}"].value for axis in "xyz"])


def scan_grid(case: Case, coarser: int = 1) -> dict[str, np.ndarray]:
    """Return the axes of the paper's grid of initial rates (rad/s) by name, or every `coarser`-th point of them."""
    step = case.published["scan_step"].value
    return {
        f"omega_{axis}": np.linspace(low, high, round((high - low) / step) + 1)[::coarser]
        for axis, (low, high) in zip("xyz", scan_limits(case), strict=True)
    }


def line_in_scan_range(case: Case, line: Line, n: int = 2) -> np.ndarray:
    """Return n evenly spaced points (n, 3) of a line between the two faces of the scan range that it meets; rad/s.

    For a line that misses the scan range all of them are one point of the line.
    """
    point, direction = line
    # for each pair of faces, the two positions along the line at which it crosses them; a line parallel to a pair meets neither
    crosses_pair = np.abs(direction) > 1e-12
    distance = scan_limits(case) - point[:, None]
    positions = np.sort(distance[crosses_pair] / direction[crosses_pair, None], axis=1)
    # inside the scan range the line is behind the first face of every pair and before the second
    begin, end = positions[:, 0].max(), positions[:, 1].min()
    return point + np.linspace(begin, max(begin, end), n)[:, None] * direction


def direction_mask(case: Case) -> DirectionSet | None:
    """Return the mask of simulated directions that enter an EMD, as the study assumes; None if all directions do."""
    if case.assumptions.study.mask == "reconstructible":
        return reconstructible_mask(case.vehicle)
    return None


def published_lines(case: Case) -> list[Line]:
    """Return the paper's lines L1 to L4 as (point in rad/s, unit direction)."""
    lines = [case.published[f"line_L{k}"].value for k in (1, 2, 3, 4)]
    return [(np.array(point), np.array(along) / np.linalg.norm(along)) for point, along in lines]


def points_on_lines(lines: Sequence[Line], omega_z: Any) -> np.ndarray:
    """Return the points (n_lines, n, 3) in rad/s of the lines at the given omega_z (n)."""
    return np.array([point_at(point, along, 2, omega_z) for point, along in lines])


def distances_from_lines(case: Case, omega_B: np.ndarray) -> np.ndarray:
    """Return the distances (n_lines, ...) in rad/s of rates (..., 3) from the published lines."""
    # the directions are unit vectors, so each cross product is as long as the distance from the line
    offsets = [np.cross(omega_B - point, along) for point, along in published_lines(case)]
    return np.linalg.norm(offsets, axis=-1)


def published_candidates(case: Case) -> np.ndarray:
    """Return rates (204, 3) in rad/s on the four published lines, every 0.01 rad/s of omega_z over `LINE_RANGE`."""
    return points_on_lines(published_lines(case), np.linspace(*LINE_RANGE, 51)).reshape(-1, 3)


def start_states(
    case: Case, omega_B: np.ndarray, sun_B: np.ndarray, wheel_speed_rad_s: Any = None
) -> Rows:
    """Return the states of motions with rates (..., 3) in rad/s and one common Sun direction (3).

    Wheel speeds are in rad/s; default: nominal.
    """
    omega = np.asarray(omega_B, dtype=np.float64).reshape(-1, 3)
    speeds = nominal_wheel_speeds(case.vehicle) if wheel_speed_rad_s is None else wheel_speed_rad_s
    n = len(omega)
    return Rows(omega, np.tile(sun_B, (n, 1)), np.tile(np.asarray(speeds, np.float64), (n, 1)))


def motion_and_panel_parameters(vehicle: Vehicle) -> list[Any]:
    """Return the parameters of a vehicle on which free motion and panel readings depend: inertia, wheels and panels.

    Mass and contact points are left out, as neither enters a scan. The result is plain data for a hash or a comparison.
    """
    wheels = [
        (wheel.axis_B, wheel.inertia_kg_m2, wheel.speed_rad_s, wheel.friction)
        for wheel in vehicle.wheels
    ]
    # fields that are None are left out, so that stored hashes of vehicles without a stated noise stay valid
    panels, channels = (
        [{key: value for key, value in vars(part).items() if value is not None} for part in parts]
        for parts in (vehicle.panels, vehicle.channels)
    )
    readings = panels, vehicle.panel_response, vehicle.sun_rules, channels
    return to_json([vehicle.inertia_kg_m2, wheels, *readings])


def momentum_angles(vehicle: Vehicle, states: Rows) -> MomentumAngles:
    """Return for each state (n) the angles theta (from z) and alpha (from the Sun) of the angular momentum H, and |H|.

    The angle alpha is constant in free flight. The angle theta is constant for a body that is symmetric about z, and varies by some
    degrees for Philae.
    """
    momentum = gyrostat.total_momentum(vehicle, states.omega_B, states.wheel_speed_rad_s)
    theta = np.arctan2(np.hypot(momentum[:, 0], momentum[:, 1]), momentum[:, 2])
    # components of H across and along the Sun direction: their ratio is exact for small angles too
    across = np.linalg.norm(np.cross(momentum, states.sun_B), axis=1)
    along = np.einsum("ni,ni->n", momentum, states.sun_B)
    alpha = np.arctan2(across, along)
    return MomentumAngles(theta, alpha, np.linalg.norm(momentum, axis=1))


class MomentumAngles(NamedTuple):
    """Angular momentum H of n states.

    `theta_rad` (n): angle from the body's z axis; `alpha_rad` (n): angle from the Sun; `size` (n): |H| in N m s.
    """

    theta_rad: np.ndarray
    alpha_rad: np.ndarray
    size: np.ndarray


@dataclass(frozen=True)
class Rebound:
    """The telemetry between the first touchdown and the collision, and the initial state of its candidate motions.

    The "candidates' instant" is the time at which the candidate motions begin.

    Attributes
    ----------
    samples : Dataset of `sun_directions`, time in s from its first sample
    first : index of the sample at the candidates' instant
    sun_B : (3,) Sun direction at that instant: the published one if the file contains it, else the first one of the file
    covariance : (3, 3) covariance of that direction from the noise
    lead_s : time from the touchdown to that instant, s
    window_s : time from that instant to the collision, s
    """

    case: Case
    samples: xr.Dataset
    first: int
    sun_B: np.ndarray
    covariance: np.ndarray
    lead_s: float
    window_s: float

    @property
    def t_s(self) -> np.ndarray:
        """Times (n) of the samples in s from the candidates' instant."""
        return self.samples["time"].values - self.samples["time"].values[self.first]

    @property
    def span_s(self) -> tuple[float, float]:
        """Times in s since the epoch of the samples of a posterior: from the candidates' instant to the last one."""
        times = self.samples["utc_s"].values
        return float(times[self.first]), float(times[-1])

    @property
    def reconstructed(self) -> np.ndarray:
        """Boolean mask (n) of the samples that give a direction."""
        return is_reconstructed(self.samples["status"])

    @property
    def z(self) -> np.ndarray:
        """Components r_z (m) of the samples that give a direction."""
        return self.samples["sun_B"].values[self.reconstructed, 2]

    @property
    def weights(self) -> np.ndarray | None:
        """Weights of `z` in its distribution; None for equal weights."""
        rule = self.case.assumptions.study.target_weights
        return target_weights(rule, self.t_s[self.reconstructed])

    def starts_from(self, sun_B: np.ndarray, window_s: float) -> bool:
        """Return whether the motions begin from this direction (3) and last this long, to a second."""
        return np.array_equal(self.sun_B, sun_B) and abs(self.window_s - window_s) < 1.0

    def states(self, omega_B: np.ndarray) -> Rows:
        """Return the initial states of motions with rates (n, 3) in rad/s at the candidates' instant."""
        return start_states(self.case, omega_B, self.sun_B)

    def scenarios(self) -> tuple[Scenario, Scenario]:
        """Return two scenarios of collision and landing from the candidates' instant.

        The first is that of section 3.3 of the paper. The second has the times of the case's timeline and the speeds of the kernel.
        """
        start: dict[str, Any] = {"sun_B": tuple(self.sun_B), "before_s": self.window_s}
        real = replace(case_scenario(self.case), lead_s=self.lead_s, **start)
        return replace(paper_scenario(self.case), **start), real


def select_rebound(case: Case, sun: xr.Dataset) -> xr.Dataset:
    """Return the samples of `sun` between first touchdown and collision, time in s from the first of them.

    The time since the epoch of `sun` stays as coordinate `utc_s`. Raises `TelemetryError` if there is no sample.
    """
    start, end = (event_seconds(case, sun, name) for name in ("first_touchdown", "collision"))
    time = sun["time"].values
    samples = sun.isel(time=np.flatnonzero((time >= start) & (time < end)))
    if samples.sizes["time"] == 0:
        raise TelemetryError(
            "there is no sample between first touchdown and collision",
            do="check the times of the telemetry",
        )
    time = samples["time"].values
    utc = ("time", time, {"units": "s", "long_name": "time since the epoch"})
    return samples.assign_coords(utc_s=utc, time=samples["time"] - time[0])


def make_rebound(case: Case, sun: xr.Dataset) -> Rebound:
    """Return the first rebound in the Sun directions `sun` of the whole landing (of `sun_directions`).

    The paper states the first direction after the touchdown. If a sample of the file gives this direction within its error, the
    candidates begin with it at the first sample of the rebound, whichever sample it was. So no result from r_z depends on the order
    of the samples. Any other lander begins at the first direction of its file.

    Raises
    ------
    TelemetryError
        No sample of the rebound gives a direction.
    """
    samples = select_rebound(case, sun)
    reconstructed = is_reconstructed(samples["status"])
    if not reconstructed.any():
        raise TelemetryError(
            "no sample between first touchdown and collision gives a direction of the Sun",
            got=f"{len(reconstructed)} samples there",
            do="check the columns of the telemetry",
        )
    directions, stated = samples["sun_B"].values, first_sun(case)
    # distance of each direction from the published one, in its own sigma
    distance = np.linalg.norm(directions - stated / np.linalg.norm(stated), axis=1)
    distance = np.where(reconstructed, distance / samples["sigma_rad"].values, np.inf)
    nearest, earliest = int(np.nanargmin(distance)), int(np.flatnonzero(reconstructed)[0])
    if distance[nearest] < 4.0:  # within four sigma the file contains the published direction
        first, sun_B, covariance_of = 0, stated, nearest
    else:
        first, sun_B, covariance_of = earliest, directions[earliest], earliest
    instant_s = float(samples["utc_s"].values[first])
    lead_s = case.assumptions.study.lead_s
    if lead_s is None:
        lead_s = instant_s - event_seconds(case, sun, "first_touchdown")
    return Rebound(
        case,
        samples,
        first,
        sun_B,
        covariance=samples["sun_cov_B"].values[covariance_of],
        lead_s=lead_s,
        window_s=event_seconds(case, sun, "collision") - instant_s,
    )


def end_rates(
    vehicle: Vehicle,
    states: Rows,
    duration_s: float,
    direction_error: float = RATE_DIRECTION_ERROR,
    wheel_mode: str = "coast",
) -> np.ndarray:
    """Return body rates (n, 3) in rad/s `duration_s` after the states (n), or before them if it is negative.

    `direction_error` is the allowed error (rad) of the Sun direction at the end.

    Raises
    ------
    MotionError
        A motion cannot be computed, such as one back through the time in which friction holds a wheel.
    """
    if len(states) == 0:
        return np.zeros((0, 3))
    run = batch.run(vehicle, states, float(duration_s), command=wheel_mode, error=direction_error)
    if np.any(run.outcome != batch.Outcome.FINE):
        what = batch.OUTCOME_TEXT[batch.Outcome(int(run.outcome.max()))]
        raise MotionError("a motion could not be followed", got=what)
    return run.omega_B[:, -1]


def propagate_back(
    case: Case, states: Rows, lead_s: float, direction_error: float = RATE_DIRECTION_ERROR
) -> np.ndarray:
    """Return body rates (n, 3) in rad/s at the touchdown, `lead_s` before the states (n).

    A wheel that is at rest in the state is assumed to have been at rest before.
    """
    mode = mode_before(states.wheel_speed_rad_s)
    return end_rates(case.vehicle, states, -lead_s, direction_error, mode)


def rates_at_touchdown(
    case: Case, starts: np.ndarray, wheel_speed_rad_s: float, lead_s: float | None = None
) -> np.ndarray:
    """Return body rates (n, 3) in rad/s at the first touchdown of motions with rates `starts` (n, 3) at the first sample.

    `wheel_speed_rad_s` is the speed of the wheels at the first sample, `lead_s` the time between touchdown and first sample.
    """
    speeds = np.full(len(case.vehicle.wheels), wheel_speed_rad_s)
    states = start_states(case, starts, first_sun(case), speeds)
    return propagate_back(case, states, first_sample_lead_s(case) if lead_s is None else lead_s)


def wheel_speed_at_first_sample(case: Case, lead_s: float | None = None) -> float:
    """Return the wheel speed (rad/s) at the first sample of a wheel that was nominal at touchdown and coasted, body at rest.

    `lead_s` is the time between touchdown and first sample; default: that of the case.
    """
    lead_s = first_sample_lead_s(case) if lead_s is None else lead_s
    speed = nominal_wheel_speeds(case.vehicle)
    motion = propagate(case.vehicle, [0, 0, 0], first_sun(case), speed, [0.0, lead_s])
    return float(motion["wheel_speed_rad_s"].values[-1, 0])


def smallest_touchdown_speed(
    case: Case, wheel_speed_rad_s: float, lead_s: float | None = None
) -> float:
    """Return the smallest angular speed (rad/s) at touchdown over 101 points of each published line.

    The points are given at the first sample, omega_z over `LINE_RANGE`.
    """
    starts = points_on_lines(published_lines(case), np.linspace(*LINE_RANGE, 101))
    rates = rates_at_touchdown(case, starts, wheel_speed_rad_s, lead_s)
    return float(np.linalg.norm(rates, axis=1).min())


def read_truth(case: Case) -> dict[str, Any]:
    """Return the true parameters of the case's own synthetic telemetry; empty if the telemetry is any other file.

    The telemetry in use is recognised by the hash of the case's own file.
    """
    own_file, truth_file = case.folder / "telemetry.csv", case.folder / "twin_truth.toml"
    if not (own_file.is_file() and truth_file.is_file()):
        return {}
    if hashlib.sha256(own_file.read_bytes()).hexdigest() != case.telemetry.attrs.get("sha256"):
        return {}
    return read_toml(truth_file.read_text("utf-8"), str(truth_file), InputError)


def with_telemetry(case: Case, telemetry: xr.Dataset) -> Case:
    """Return a copy of the case with other telemetry."""
    copy = replace(case)
    # stored where the cached property keeps its value, so that it does not read the case's file
    copy.__dict__["telemetry"] = telemetry
    return copy

"""Philae between the first touchdown and the collision: the paper's grid and lines, the samples that a file has there, where its
motions begin, and runs back to the touchdown (paper, sections 2.3 and 3.2)."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, TelemetryError
from sunspin.base.untrusted import read_toml
from sunspin.cases import Case
from sunspin.compute.identity import plain
from sunspin.dynamics import gyrostat
from sunspin.dynamics.ensemble import Mask, Rows
from sunspin.dynamics.propagate import propagate
from sunspin.dynamics.wheel_modes import mode_before
from sunspin.estimate.scan.end_rates import RATE_DIRECTION_ERROR, end_rates
from sunspin.estimate.scan.lines import Line, point_at
from sunspin.estimate.scan.mask import reconstructible_mask
from sunspin.estimate.scan.window import target_weights
from sunspin.landing.scenario import Scenario, case_scenario, paper_scenario
from sunspin.telemetry.sun import is_reconstructed
from sunspin.vehicle import Vehicle
from sunspin.vehicle.timeline import utc_seconds

LINE_RANGE = (-0.2, 0.3)
"""omega_z (rad/s) over which fitted and published lines are compared."""


@dataclass(frozen=True)
class Options:
    """How the study is run.

    Attributes
    ----------
    source : where candidates come from: "scan", "posterior", "published", or the path of a table with columns omega_x, omega_y,
        omega_z (rad/s)
    twins : synthetic rebounds of a calibration; None: as many as it needs, where the shipped one does not fit; zero: none
    seed : of all random choices
    coarser : use every so many-th grid point of the scan and of the maps; 1 is the paper's grid
    workers, progress : threads, progress bars
    """

    source: str = "scan"
    twins: int | None = None
    seed: int = 0
    coarser: int = 1
    workers: int | None = None
    progress: bool = False


def first_sun(case: Case) -> np.ndarray:
    """The first direction (3) of the Sun after the touchdown, as published."""
    return np.array(case.published["first_sun"].value)


def nominal_wheel_speeds(vehicle: Vehicle) -> list[float]:
    """Speeds of the wheels in rad/s before they are switched off."""
    return [wheel.speed_rad_s for wheel in vehicle.wheels]


def published_window_s(case: Case) -> float:
    """Length of the paper's runs in s."""
    return 60.0 * float(case.published["scan_duration"].value)


def first_sample_lead_s(case: Case) -> float:
    """Time in s from the first touchdown to the first sample after it."""
    if case.assumptions.study.lead_s is not None:
        return case.assumptions.study.lead_s
    return case.require_timeline().seconds("first_touchdown", "first_sample_after_touchdown")


def event_seconds(case: Case, data: xr.Dataset, event: str) -> float:
    """An event's time in s from the epoch of a Dataset."""
    moment = case.require_timeline().event(event)
    return utc_seconds(moment.refined_utc or moment.utc, data.attrs["epoch_utc"])


def scan_limits(case: Case) -> np.ndarray:
    """Ends (3, 2) of the scanned range of initial rates in rad/s."""
    return np.array([case.published[f"scan_omega_{axis}"].value for axis in "xyz"])


def scan_grid(case: Case, coarser: int = 1) -> dict[str, np.ndarray]:
    """The paper's grid of initial rates, or every `coarser`-th point of it."""
    step = case.published["scan_step"].value
    return {
        f"omega_{axis}": np.linspace(low, high, round((high - low) / step) + 1)[::coarser]
        for axis, (low, high) in zip("xyz", scan_limits(case), strict=True)
    }


def line_in_scan_range(case: Case, line: Line, n: int = 2) -> np.ndarray:
    """Points (n, 3) evenly along a line from one end of the scanned range to the other."""
    point, direction = line
    along = np.abs(direction) > 1e-12  # a line parallel to a pair of faces meets neither
    ends = np.sort((scan_limits(case) - point[:, None])[along] / direction[along, None], axis=1)
    begin, end = ends[:, 0].max(), ends[:, 1].min()
    return point + np.linspace(begin, max(begin, end), n)[:, None] * direction


def direction_mask(case: Case) -> Mask | None:
    """The simulated directions that count, as the study assumes; None: all."""
    everywhere = case.assumptions.study.mask != "reconstructible"
    return None if everywhere else reconstructible_mask(case.vehicle)


def published_lines(case: Case) -> list[Line]:
    """The paper's L1..L4 as (point, unit direction)."""
    lines = [case.published[f"line_L{k}"].value for k in (1, 2, 3, 4)]
    return [(np.array(point), np.array(along) / np.linalg.norm(along)) for point, along in lines]


def points_on_lines(lines: Sequence[Line], omega_z: Any) -> np.ndarray:
    """The points (n_lines, n, 3) of lines at these omega_z (n); rad/s."""
    return np.array([point_at(point, along, 2, omega_z) for point, along in lines])


def published_candidates(case: Case) -> np.ndarray:
    """Rates (n, 3) in rad/s along the paper's lines, 0.01 rad/s apart in omega_z over the range in which they are compared."""
    return points_on_lines(published_lines(case), np.linspace(*LINE_RANGE, 51)).reshape(-1, 3)


def start_states(
    case: Case, omega_B: np.ndarray, sun_B: np.ndarray, wheel_speed_rad_s: Any = None
) -> Rows:
    """States of motions with these rates (..., 3) in rad/s and one direction of the Sun (3); wheels nominal by default."""
    omega = np.asarray(omega_B, dtype=np.float64).reshape(-1, 3)
    speeds = nominal_wheel_speeds(case.vehicle) if wheel_speed_rad_s is None else wheel_speed_rad_s
    n = len(omega)
    return Rows(omega, np.tile(sun_B, (n, 1)), np.tile(np.asarray(speeds, np.float64), (n, 1)))


def motion_and_panel_parameters(vehicle: Vehicle) -> list[Any]:
    """What free motion and panels depend on: body, wheels, panels; not the mass, nor what can touch the ground."""
    wheels = [
        (wheel.axis_B, wheel.inertia_kg_m2, wheel.speed_rad_s, wheel.friction)
        for wheel in vehicle.wheels
    ]
    # a noise only where one is stated: what is stored of vehicles without keeps its key
    panels, channels = (
        [{key: x for key, x in vars(each).items() if x is not None} for each in several]
        for several in (vehicle.panels, vehicle.channels)
    )
    light = panels, vehicle.panel_response, vehicle.sun_rules, channels
    return plain([vehicle.inertia_kg_m2, wheels, *light])


def momentum_angles(vehicle: Vehicle, rows: Rows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles (n) in rad between the momentum H and the body's z axis (theta), and between H and the Sun (alpha); |H| (n), N m s.

    alpha never changes in free flight; theta is constant for a body symmetric about z, and wanders by some degrees for Philae.
    """
    momentum = gyrostat.total_momentum(vehicle, rows.omega_B, rows.wheel_speed_rad_s)
    across = np.linalg.norm(np.cross(momentum, rows.sun_B), axis=1)
    along = np.einsum("ni,ni->n", momentum, rows.sun_B)
    theta = np.arctan2(np.hypot(momentum[:, 0], momentum[:, 1]), momentum[:, 2])
    return theta, np.arctan2(across, along), np.linalg.norm(momentum, axis=1)


@dataclass(frozen=True)
class Rebound:
    """The telemetry between the first touchdown and the collision, and where its motions begin.

    Attributes
    ----------
    samples : Dataset of `sun_directions`, time in s from its first sample
    first : number of the sample at whose instant the candidates stand
    sun_B : (3,) direction of the Sun then: the published one where the file holds it, else the first that the file gives
    covariance : (3, 3) of that direction from the noise
    lead_s : s from the touchdown to that instant
    window_s : s from that instant to the collision
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
    def reconstructed(self) -> np.ndarray:
        """Which samples (n) give a direction."""
        return is_reconstructed(self.samples["status"])

    @property
    def z(self) -> np.ndarray:
        """The z components that the samples give."""
        return self.samples["sun_B"].values[self.reconstructed, 2]

    @property
    def weights(self) -> np.ndarray | None:
        """Weights of `z` in their distribution; None where each counts the same."""
        rule = self.case.assumptions.study.target_weights
        return target_weights(rule, self.t_s[self.reconstructed])

    def begins_as(self, sun_B: np.ndarray, window_s: float) -> bool:
        """Whether motions begin from this direction (3) and last as long."""
        return np.array_equal(self.sun_B, sun_B) and abs(self.window_s - window_s) < 1.0

    def states(self, omega_B: np.ndarray) -> Rows:
        """Initial states of motions with these rates (n, 3) in rad/s at the candidates' instant."""
        return start_states(self.case, omega_B, self.sun_B)

    def scenarios(self) -> tuple[Scenario, Scenario]:
        """What follows in section 3.3 of the paper, and by the case's timeline and kernel, from the candidates' instant."""
        here: dict[str, Any] = {"sun_B": tuple(self.sun_B), "before_s": self.window_s}
        real = replace(case_scenario(self.case), lead_s=self.lead_s, **here)
        return replace(paper_scenario(self.case), **here), real


def select_rebound(case: Case, sun: xr.Dataset) -> xr.Dataset:
    """The Sun samples between first touchdown and collision, time counted from the first of them."""
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
    """The first rebound in the Sun directions of the whole landing (`sun_directions`).

    The paper states the first direction after the touchdown. Where the file holds it, within its error, the candidates stand at
    the first sample with that direction, whichever sample gave it: so nothing that follows from r_z uses the order of the samples.
    Another lander begins at the first direction that its file gives.
    """
    samples = select_rebound(case, sun)
    reconstructed = is_reconstructed(samples["status"])
    if not reconstructed.any():
        raise TelemetryError(
            "no sample between first touchdown and collision gives a direction of the Sun",
            got=f"{len(reconstructed)} samples there",
            do="check the columns of the telemetry",
        )
    own, stated = samples["sun_B"].values, first_sun(case)
    apart = np.linalg.norm(own - stated / np.linalg.norm(stated), axis=1)
    apart = np.where(reconstructed, apart / samples["sigma_rad"].values, np.inf)
    nearest, earliest = int(np.nanargmin(apart)), int(np.flatnonzero(reconstructed)[0])
    published = bool(apart[nearest] < 4.0)  # sigma
    first, which = (0, nearest) if published else (earliest, earliest)
    instant = float(samples["utc_s"].values[first])
    lead = case.assumptions.study.lead_s
    return Rebound(
        case,
        samples,
        first,
        stated if published else own[first],
        samples["sun_cov_B"].values[which],
        instant - event_seconds(case, sun, "first_touchdown") if lead is None else lead,
        event_seconds(case, sun, "collision") - instant,
    )


def propagate_back(
    case: Case, states: Rows, lead_s: float, direction_error: float = RATE_DIRECTION_ERROR
) -> np.ndarray:
    """Body rates (n, 3) `lead_s` before the states (n), back to the touchdown; a wheel at rest is taken to have stood still."""
    mode = mode_before(states.wheel_speed_rad_s)
    return end_rates(case.vehicle, states, -lead_s, direction_error, mode)


def rates_at_touchdown(
    case: Case, starts: np.ndarray, wheel_speed_rad_s: float, lead_s: float | None = None
) -> np.ndarray:
    """Body rates (n, 3) at the first touchdown of motions with rates `starts` (n, 3) at the first sample, `lead_s` after it."""
    speeds = np.full(len(case.vehicle.wheels), wheel_speed_rad_s)
    states = start_states(case, starts, first_sun(case), speeds)
    return propagate_back(case, states, first_sample_lead_s(case) if lead_s is None else lead_s)


def wheel_speed_at_first_sample(case: Case, lead_s: float | None = None) -> float:
    """Wheel speed at the first sample if it was nominal at touchdown and coasted since, the body nearly at rest."""
    lead = first_sample_lead_s(case) if lead_s is None else lead_s
    speed = nominal_wheel_speeds(case.vehicle)
    run = propagate(case.vehicle, [0, 0, 0], first_sun(case), speed, [0.0, lead])
    return float(run["wheel_speed_rad_s"].values[-1, 0])


def smallest_touchdown_speed(
    case: Case, wheel_speed_rad_s: float, lead_s: float | None = None
) -> float:
    """Smallest angular speed (rad/s) at touchdown over the published lines, omega_z at the first sample in the compared range."""
    starts = points_on_lines(published_lines(case), np.linspace(*LINE_RANGE, 101))
    rates = rates_at_touchdown(case, starts, wheel_speed_rad_s, lead_s)
    return float(np.linalg.norm(rates, axis=1).min())


def read_truth(case: Case) -> dict[str, Any]:
    """What made the telemetry, where it is the case's own twin; else nothing."""
    own, truth = case.folder / "telemetry.csv", case.folder / "twin_truth.toml"
    given = case.telemetry.attrs.get("sha256")
    if not (own.is_file() and truth.is_file()):
        return {}
    if hashlib.sha256(own.read_bytes()).hexdigest() != given:
        return {}
    return read_toml(truth.read_text("utf-8"), str(truth), InputError)


def with_telemetry(case: Case, telemetry: xr.Dataset) -> Case:
    """The case with other telemetry in the place of its own."""
    copy = replace(case)
    copy.__dict__["telemetry"] = telemetry
    return copy

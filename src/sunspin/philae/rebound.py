"""Philae between the first touchdown and the collision: targets of the scan, candidate lines, the way back to touchdown."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, TelemetryError
from sunspin.base.untrusted import read_toml
from sunspin.compute.identity import plain
from sunspin.dynamics import gyrostat
from sunspin.dynamics.ensemble import Mask, Rows
from sunspin.dynamics.propagate import propagate
from sunspin.dynamics.wheel_modes import mode_before
from sunspin.estimate.scan import window
from sunspin.estimate.scan.end_rates import RATE_DIRECTION_ERROR, end_rates
from sunspin.estimate.scan.lines import Line, fit_lines, line_deviation, match_lines, point_at
from sunspin.estimate.scan.mask import allows, reconstructible_mask
from sunspin.estimate.scan.metrics import emd
from sunspin.estimate.scan.rows import ScanRows, Start
from sunspin.estimate.scan.volume import near_minimum
from sunspin.telemetry.case import Case
from sunspin.telemetry.sun import is_reconstructed
from sunspin.vehicle import Vehicle
from sunspin.vehicle.timeline import utc_seconds

LINE_RANGE = (-0.2, 0.3)
"""omega_z (rad/s) over which fitted and published lines are compared."""

LINE_POINTS = 51
"""Candidates on each of the published lines: 0.01 rad/s apart in omega_z."""

POOL_RANGE = (-0.15, 0.3)
"""omega_z (rad/s) of the points of the published lines whose r_z make up their common distribution."""

THRESHOLDS = (1.1, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
"""Near-minimum factors of the table that shows what the choice does."""

POOL_POINTS = 16
POOL_STEP_S = 0.5

LINES_FACTOR = 4.0
"""Near-minimum factor against the lines' common distribution: so clean a target has so small a minimum that 1.1 times it
leaves a handful of points. EMD at points of the lines themselves is up to several times the minimum."""


def target_weights(case: Case, t_s: np.ndarray) -> np.ndarray | None:
    """What directions at these times (n, s) count in the target, as the study assumes: None (all the same), or half their gaps."""
    return window.target_weights(case.assumptions.study.target_weights, t_s)


def counted(case: Case) -> Mask | None:
    """The simulated directions that count, as the study assumes; None: all."""
    return (
        reconstructible_mask(case.vehicle)
        if case.assumptions.study.mask == "reconstructible"
        else None
    )


def moves_and_sees_alike(vehicle: Vehicle, other: Vehicle) -> bool:
    """Whether what is concluded from the panels on the free motion of one vehicle holds for the other."""
    return moving_and_seeing(vehicle) == moving_and_seeing(other)


def moving_and_seeing(vehicle: Vehicle) -> list[Any]:
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
    return plain(
        [
            vehicle.inertia_kg_m2,
            wheels,
            panels,
            vehicle.panel_response,
            vehicle.sun_rules,
            channels,
        ]
    )


def published_lines(case: Case) -> list[tuple[np.ndarray, np.ndarray]]:
    """The paper's L1..L4 as (point, unit direction)."""
    lines = []
    for name in ("line_L1", "line_L2", "line_L3", "line_L4"):
        point, direction = (np.array(part) for part in case.published[name].value)
        lines.append((point, direction / np.linalg.norm(direction)))
    return lines


def published_candidates(case: Case) -> np.ndarray:
    """Rates (n, 3) in rad/s along the paper's lines, in equal steps of omega_z over the range in which they are compared."""
    omega_z = np.linspace(*LINE_RANGE, LINE_POINTS)
    return np.concatenate(
        [point_at(point, direction, 2, omega_z) for point, direction in published_lines(case)]
    )


def window_s(case: Case) -> float:
    """Length of the scan's window in s."""
    return 60.0 * float(case.published["scan_duration"].value)


def first_sun(case: Case) -> np.ndarray:
    return np.array(case.published["first_sun"].value)


def grid(case: Case, coarser: int = 1) -> dict[str, np.ndarray]:
    """The paper's grid of initial rates, or every `coarser`-th point of it."""
    step, axes = case.published["scan_step"].value, {}
    for name in ("omega_x", "omega_y", "omega_z"):
        low, high = case.published[f"scan_{name}"].value
        axes[name] = np.linspace(low, high, round((high - low) / step) + 1)[::coarser]
    return axes


def grid_size(case: Case) -> int:
    """Number of motions that the paper scanned."""
    return int(np.prod([len(axis) for axis in grid(case).values()]))


def pooled_z(case: Case) -> list[np.ndarray]:
    """For each published line, the reconstructible r_z of motions begun at points along it."""
    pooled = []
    for point, direction in published_lines(case):
        starts = point_at(point, direction, 2, np.linspace(*POOL_RANGE, POOL_POINTS))
        pooled.append(np.concatenate([seen_z(case, omega) for omega in starts]))
    return pooled


def seen_z(case: Case, omega_B: np.ndarray) -> np.ndarray:
    """The reconstructible r_z of one motion over the window, at equal steps of time."""
    t = np.arange(0.0, window_s(case) + POOL_STEP_S / 2, POOL_STEP_S)
    run = propagate(
        case.vehicle, omega_B, first_sun(case), nominal_speed(case.vehicle), t, rtol=1e-9
    )
    track = run["sun_B"].values
    mask = counted(case)
    return track[slice(None) if mask is None else allows(mask, track), 2]


def nominal_speed(vehicle: Vehicle) -> list[float]:
    return [wheel.speed_rad_s for wheel in vehicle.wheels]


def pooled_spread(pooled: list[np.ndarray]) -> list[float]:
    """EMD of each line's distribution to the common one."""
    everything = np.concatenate(pooled)
    return [emd(z, everything) for z in pooled]


def rebound_samples(case: Case, sun: xr.Dataset) -> xr.Dataset:
    """The Sun samples between first touchdown and collision, time counted from the first of them."""
    start, end = (case_seconds(case, sun, name) for name in ("first_touchdown", "collision"))
    time = sun["time"].values
    part = sun.isel(time=np.flatnonzero((time >= start) & (time < end)))
    if part.sizes["time"] == 0:
        raise TelemetryError(
            "there is no sample between first touchdown and collision",
            do="check the times of the telemetry",
        )
    part = part.assign_coords(
        utc_s=("time", part["time"].values, {"units": "s", "long_name": "time since the epoch"})
    )
    return part.assign_coords(time=part["time"] - part["time"].values[0])


SAME_SIGMAS = 4.0
"""A direction this near (its own sigma) to the published first one is that direction."""


@dataclass(frozen=True)
class Rebound:
    """The telemetry between the first touchdown and the collision, and where its motions begin.

    Attributes
    ----------
    samples : Dataset of `sun_directions`, time in s from its first sample
    first : number of the sample at whose instant the candidates stand
    sun_B : (3,) direction of the Sun then: the published one where the file holds it, else the first that the file gives
    published_start : whether it is the published one
    covariance : (3, 3) of that direction from the noise
    lead_s : s from the touchdown to that instant
    window_s : s from that instant to the collision
    """

    case: Case
    samples: xr.Dataset
    first: int
    sun_B: np.ndarray
    covariance: np.ndarray
    published_start: bool
    lead_s: float
    window_s: float

    @property
    def told(self) -> np.ndarray:
        """Which samples (n) give a direction."""
        return is_reconstructed(self.samples["status"])

    @property
    def z(self) -> np.ndarray:
        """The z components that the samples give."""
        return self.samples["sun_B"].values[self.told, 2]

    @property
    def weights(self) -> np.ndarray | None:
        """Weights of `z` in their distribution; None where each counts the same."""
        return target_weights(self.case, self.t_s[self.told])

    @property
    def t_s(self) -> np.ndarray:
        """Times (n) of the samples in s from the candidates' instant."""
        return self.samples["time"].values - self.samples["time"].values[self.first]

    @property
    def as_published(self) -> bool:
        """Whether motions begin where the paper's do: same direction, same window."""
        return self.published_start and abs(self.window_s - window_s(self.case)) < 1.0

    def states(self, omega_B: np.ndarray) -> Rows:
        """Initial states of motions with these rates (n, 3) in rad/s at the candidates' instant."""
        omega = np.asarray(omega_B, dtype=np.float64).reshape(-1, 3)
        speeds = np.array(nominal_speed(self.case.vehicle))
        return Rows(omega, np.tile(self.sun_B, (len(omega), 1)), np.tile(speeds, (len(omega), 1)))


def momentum_angles(vehicle: Vehicle, rows: Rows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles (n) in rad between the momentum H and the body's z axis (theta), and between H and the Sun (alpha); |H| (n), N m s.

    alpha never changes in free flight; theta is constant for a body symmetric about z, and wanders by some degrees for Philae.
    """
    momentum = gyrostat.total_momentum(vehicle, rows.omega_B, rows.wheel_speed_rad_s)
    across = np.linalg.norm(np.cross(momentum, rows.sun_B), axis=1)
    along = np.einsum("ni,ni->n", momentum, rows.sun_B)
    theta = np.arctan2(np.hypot(momentum[:, 0], momentum[:, 1]), momentum[:, 2])
    return theta, np.arctan2(across, along), np.linalg.norm(momentum, axis=1)


def rebound_of(case: Case, sun: xr.Dataset) -> Rebound:
    """The first rebound in the Sun directions of the whole landing (`sun_directions`).

    The paper states the first direction after the touchdown. Where the file holds it, within its error, the candidates stand at
    the first sample with that direction, whichever sample gave it: so nothing that follows from the heights of the Sun uses the
    order of the samples. Another lander begins at the first direction that its file gives.
    """
    samples = rebound_samples(case, sun)
    told = is_reconstructed(samples["status"])
    if not told.any():
        raise TelemetryError(
            "no sample between first touchdown and collision gives a direction of the Sun",
            got=f"{len(told)} samples there",
            do="check the columns of the telemetry",
        )
    own = samples["sun_B"].values
    apart = (
        np.linalg.norm(own - first_sun(case) / np.linalg.norm(first_sun(case)), axis=1)
        / samples["sigma_rad"].values
    )
    nearest = int(np.nanargmin(np.where(told, apart, np.inf)))
    published = bool(apart[nearest] < SAME_SIGMAS)
    first = 0 if published else int(np.flatnonzero(told)[0])
    shift = utc_seconds(case.require_timeline().epoch_utc, sun.attrs["epoch_utc"])
    touchdown, collision = (
        case.require_timeline().event(name).t_s + shift for name in ("first_touchdown", "collision")
    )
    instant = float(samples["utc_s"].values[first])
    direction, which = (first_sun(case), nearest) if published else (own[first], first)
    covariance = samples["sun_cov_B"].values[which]
    assumed = case.assumptions.study.lead_s
    lead = instant - touchdown if assumed is None else assumed
    return Rebound(
        case, samples, first, direction, covariance, published, lead, collision - instant
    )


def case_seconds(case: Case, data: xr.Dataset, event: str) -> float:
    """An event's time in s from the epoch of a Dataset."""
    moment = case.require_timeline().event(event)
    return utc_seconds(moment.refined_utc or moment.utc, data.attrs["epoch_utc"])


@dataclass(frozen=True)
class Families:
    """A scan's near-minimum set and the lines through it, `partner[k]` being the line for published line k."""

    emd: xr.DataArray
    factor: float
    points: np.ndarray
    lines: xr.Dataset | None
    partner: list[int]
    deviation: list[dict[str, float]]


def families(case: Case, volume: xr.DataArray, factor: float, seed: int) -> Families:
    """Near-minimum set of a scan, four lines through it, and their distance from the published ones."""
    points = near_minimum(volume, factor)
    reference = published_lines(case)
    try:
        lines = fit_lines(points, len(reference), seed=seed)
    except InputError:  # a ragged level set may have fewer points than four lines need
        return Families(volume, factor, points, None, [], [])
    options: dict[str, Any] = {"low": LINE_RANGE[0], "high": LINE_RANGE[1]}
    partner = match_lines(lines, reference, **options)
    fitted = list(zip(lines["point"].values, lines["direction"].values, strict=True))
    deviation = [
        line_deviation(fitted[i], other, **options)
        for i, other in zip(partner, reference, strict=True)
    ]
    return Families(volume, factor, points, lines, partner, deviation)


def by_threshold(case: Case, volume: xr.DataArray, seed: int) -> list[dict[str, Any]]:
    """How the near-minimum set and its lines change with the factor: points, mean distance of each line (rad/s)."""
    table = []
    for factor in THRESHOLDS:
        family = families(case, volume, factor, seed)
        table.append(
            {
                "factor": factor,
                "points": len(family.points),
                "mean_distance": [d["mean"] for d in family.deviation],
            }
        )
    return table


def after_touchdown_s(case: Case) -> float:
    """Time in s from the first touchdown to the first sample after it."""
    if case.assumptions.study.lead_s is not None:
        return case.assumptions.study.lead_s
    return case.require_timeline().seconds("first_touchdown", "first_sample_after_touchdown")


def at_touchdown(
    case: Case, starts: np.ndarray, wheel_speed_rad_s: float, lead_s: float | None = None
) -> np.ndarray:
    """Body rates (n, 3) at the first touchdown of motions with rates `starts` (n, 3) at the first sample, `lead_s` after it."""
    states = Rows(
        np.asarray(starts, dtype=np.float64).reshape(-1, 3),
        np.tile(first_sun(case), (len(starts), 1)),
        np.full((len(starts), len(case.vehicle.wheels)), float(wheel_speed_rad_s)),
    )
    return run_back(case, states, after_touchdown_s(case) if lead_s is None else lead_s)


def run_back(
    case: Case, states: Rows, lead_s: float, direction_error: float = RATE_DIRECTION_ERROR
) -> np.ndarray:
    """Body rates (n, 3) `lead_s` before the states (n), back to the touchdown; a wheel at rest is taken to have stood still."""
    return end_rates(
        case.vehicle, states, -lead_s, direction_error, mode_before(states.wheel_speed_rad_s)
    )


def speeds_back(
    case: Case, start: Start, lead_s: float, direction_error: float = RATE_DIRECTION_ERROR
) -> ScanRows:
    """Row of a grid -> angular speed (rad/s) `lead_s` before, as by `run_back`."""
    mode = mode_before(start.wheel_speed_rad_s)
    return ScanRows(
        case.vehicle, start, -lead_s, "speed", wheel_mode=mode, direction_error=direction_error
    )


def speed_at_first_sample(case: Case, lead_s: float | None = None) -> float:
    """Wheel speed at the first sample if it was nominal at touchdown and coasted since, the body nearly at rest."""
    lead = after_touchdown_s(case) if lead_s is None else lead_s
    run = propagate(
        case.vehicle, [0, 0, 0], first_sun(case), nominal_speed(case.vehicle), [0.0, lead]
    )
    return float(run["wheel_speed_rad_s"].values[-1, 0])


def smallest_on_lines(
    case: Case, lines: Sequence[Line], wheel_speed_rad_s: float, lead_s: float | None = None
) -> float:
    """Smallest angular speed (rad/s) at touchdown over the lines, omega_z at the first sample in the compared range."""
    omega_z = np.linspace(LINE_RANGE[0], LINE_RANGE[1], 101)
    starts = np.concatenate([point_at(point, direction, 2, omega_z) for point, direction in lines])
    return float(
        np.linalg.norm(at_touchdown(case, starts, wheel_speed_rad_s, lead_s), axis=1).min()
    )


def twin_file(case: Case) -> dict[str, Any]:
    """What made the telemetry, where it is the case's own twin; else nothing."""
    own, truth = case.folder / "telemetry.csv", case.folder / "twin_truth.toml"
    if not (own.is_file() and truth.is_file()):
        return {}
    if hashlib.sha256(own.read_bytes()).hexdigest() != case.telemetry.attrs.get("sha256"):
        return {}
    return read_toml(truth.read_text("utf-8"), str(truth), InputError)


def twin_truth(case: Case) -> np.ndarray | None:
    """The true rate (3) in rad/s at the first sample after touchdown, where the telemetry is the case's own twin."""
    known = twin_file(case)
    return np.array(known["omega_B"]) if known else None


def with_telemetry(case: Case, telemetry: xr.Dataset) -> Case:
    """The case with other telemetry in the place of its own."""
    copy = replace(case)
    copy.__dict__["telemetry"] = telemetry
    return copy

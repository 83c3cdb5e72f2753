"""Candidate motions of the landing, from which the touchdown, the collision and the rest are computed.

`--candidates` selects their source: the 90 % confidence set of the scan of the telemetry (default), the posterior of its readings,
the published lines (for any telemetry), or a file. Two sets serve for comparison. The whole scan range stands for what was possible
before the data. The paper's near-minimum set holds the motions below 1.1 times the smallest EMD.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, TelemetryError
from sunspin.base.tables import read_table
from sunspin.cases import Case, case_names, load_case
from sunspin.dynamics.batch import EMD_ERROR, Rows, sun_heights
from sunspin.estimate.scan.near_minimum import stored_near_minimum, stored_vehicle
from sunspin.landing.outcomes import BINS
from sunspin.philae.data_check import DataCheck
from sunspin.philae.metrics import TelemetryScan
from sunspin.philae.rebound import (
    Options,
    Rebound,
    end_rates,
    momentum_angles,
    motion_and_panel_parameters,
    propagate_back,
    published_candidates,
)
from sunspin.philae.threshold import CONFIDENCE, ThresholdCalibration, get_calibration
from sunspin.telemetry.synthetic import generator
from sunspin.vehicle import Vehicle

DRAWS, ELEVATION_DRAWS, POSTERIOR_DRAWS = 10_000, 2_000, 4_000
"""Largest number of candidates that are propagated to the collision, and of those whose range of the Sun's elevation is computed;
number of draws from a posterior."""

DIRECTION_ERROR = 1e-4
"""Largest error (rad) of directions at touchdown and collision; angular speeds then err by 1e-6 rad/s at most."""


@dataclass(frozen=True)
class Candidates:
    """Motions given by their states at the candidates' instant (:class:`sunspin.philae.rebound.Rebound`).

    Attributes
    ----------
    source : "scan", "posterior", "published" or the file's name
    about : description in words
    states : `Rows` of all motions (n)
    speed_touchdown : (n) angular speed in rad/s just after the first touchdown
    theta, alpha : (n) angles in rad from the angular momentum H to the body's z axis and to the Sun
    speed_collision : (n_draws) angular speed in rad/s just before the collision, of motions drawn evenly
    sun_elevation : (n_draws, 2) smallest and largest elevation of the Sun over the x-y plane until the collision, rad, of motions
        drawn evenly
    angle_cell_rad : angle by which H rotates within a grid cell, at the median size of H
    cell_rad_s : half the diagonal of a cell of the scan grid, as each motion stands for all others in its cell; 0 without a grid
    from_posterior : whether they are draws of a posterior. Intervals are then from 5 to 95 %, else from the least to the largest.
    """

    source: str
    about: str
    states: Rows
    speed_touchdown: np.ndarray
    theta: np.ndarray
    alpha: np.ndarray
    speed_collision: np.ndarray
    sun_elevation: np.ndarray
    angle_cell_rad: float
    cell_rad_s: float = 0.0
    from_posterior: bool = False

    def __len__(self) -> int:
        return len(self.states)

    @property
    def angles(self) -> np.ndarray:
        """Smaller and the larger of theta and alpha (2, n), rad: the EMD of r_z does not tell which is which."""
        return np.sort([self.theta, self.alpha], axis=0)

    def range(self, values: np.ndarray) -> tuple[float, float]:
        """Return the least and the largest of `values` (n) over the candidates; for a posterior the 5 and 95 % quantiles."""
        tail = (1 - CONFIDENCE) / 2 if self.from_posterior else 0.0
        low, high = np.quantile(values, [tail, 1 - tail])
        return float(low), float(high)

    def speed_range(self) -> tuple[float, float]:
        """Return the least and largest angular speed (rad/s) just after the touchdown, widened by half a grid cell."""
        low, high = self.range(self.speed_touchdown)
        return max(low - self.cell_rad_s, 0.0), high + self.cell_rad_s

    def angle_range(self, which: int) -> tuple[float, float]:
        """Return the range (rad) of the smaller (`which` 0) or larger (1) of both angles, widened by the angle of a grid cell."""
        low, high = self.range(self.angles[which])
        return max(low - self.angle_cell_rad, 0.0), min(high + self.angle_cell_rad, np.pi)

    def dataset(self) -> xr.Dataset:
        """Return the candidates as :func:`sunspin.landing.outcomes.outcomes` accepts them, all equally likely."""
        return states_dataset(self.states, self.about, self.source)


def states_dataset(states: Rows, about: str, source: str) -> xr.Dataset:
    """Return states as :func:`sunspin.landing.outcomes.outcomes` accepts them, all equally likely, with their description."""
    body, speed = ("candidate", "axis"), states.wheel_speed_rad_s
    return xr.Dataset(
        {
            "omega_B": (body, states.omega_B, {"units": "rad s-1"}),
            "sun_B": (body, states.sun_B, {"units": "1"}),
            "wheel_speed_rad_s": (("candidate", "wheel"), speed, {"units": "rad s-1"}),
        },
        coords={"axis": ["x", "y", "z"]},
        attrs={"about": about, "chain": source},
    )


def touchdown_speeds(rebound: Rebound, states: Rows) -> np.ndarray:
    """Return the angular speeds (n) in rad/s of motions just after the first touchdown."""
    omega_touchdown_B = propagate_back(rebound.case, states, rebound.lead_s, DIRECTION_ERROR)
    return np.linalg.norm(omega_touchdown_B, axis=1)


def make_candidates(
    rebound: Rebound, states: Rows, seed: int, speed: np.ndarray | None = None, **labels: Any
) -> Candidates:
    """Return candidates with their angles and their speeds at touchdown and collision.

    `speed` (n) holds the result of :func:`touchdown_speeds`, if it is known. `labels` are the fields `source`, `about`,
    `cell_rad_s` and `from_posterior` of `Candidates`. At most `DRAWS` motions, drawn evenly, are propagated to the collision; the
    range of the Sun's elevation is computed for the first `ELEVATION_DRAWS` of them.
    """
    vehicle, draws = rebound.case.vehicle, states
    speed = touchdown_speeds(rebound, states) if speed is None else speed
    if len(states) > DRAWS:
        draws = states.take(generator(seed, 10).choice(len(states), DRAWS, replace=False))
    omega_collision_B = end_rates(vehicle, draws, rebound.window_s, DIRECTION_ERROR)
    elevation_draws = draws.take(np.arange(min(ELEVATION_DRAWS, len(draws))))
    ensemble = sun_heights(
        vehicle, elevation_draws, rebound.window_s, emd_error=EMD_ERROR, bins=BINS
    )
    # smallest and largest r_z: outer edges of the first and the last bin that a motion visits
    visited, edges = ensemble.seconds > 0, np.linspace(-1, 1, BINS + 1)
    low_z = edges[np.argmax(visited, axis=1)]
    high_z = edges[BINS - np.argmax(visited[:, ::-1], axis=1)]
    theta, alpha, momentum = momentum_angles(vehicle, states)
    # H changes within a cell by at most the largest moment of inertia times the change of the rate
    largest_moment = float(np.linalg.eigvalsh(vehicle.require_inertia())[-1])
    momentum_change = largest_moment * labels.get("cell_rad_s", 0.0)  # N m s
    # the floor avoids a division by zero if most candidates have no angular momentum
    relative_change = momentum_change / max(float(np.median(momentum)), 1e-12)
    return Candidates(
        states=states,
        speed_touchdown=speed,
        theta=theta,
        alpha=alpha,
        speed_collision=np.linalg.norm(omega_collision_B, axis=1),
        sun_elevation=np.arcsin(np.stack([low_z, high_z], axis=1)),
        angle_cell_rad=float(np.arctan(relative_change)),
        **labels,
    )


@dataclass(frozen=True)
class CandidateSets:
    """Chosen candidates of this telemetry, with the two sets for comparison and the calibration of the threshold.

    `scan_range` holds the whole scan range (for the source "posterior" draws of its rate prior), `near_minimum` the paper's
    near-minimum set. `calibration` is None unless the source is "scan". `share` is the part of the scan range in the chosen set
    (NaN unless it comes from the scan). `posterior` is that of the readings, None for other sources.
    """

    case: Case
    rebound: Rebound
    chosen: Candidates
    scan_range: Candidates
    near_minimum: Candidates
    calibration: ThresholdCalibration | None
    share: float
    posterior: xr.DataTree | None = None

    @property
    def verdict(self) -> str:
        """Verdict of the posterior in words; empty for other sources."""
        return "" if self.posterior is None else str(self.posterior.attrs["verdict"])

    @property
    def source(self) -> str:
        """Source of the chosen candidates."""
        return self.chosen.source


def compute(scan: TelemetryScan, check: DataCheck, options: Options) -> CandidateSets:
    """Return the candidates of this telemetry from the source in `options`, with the sets for comparison.

    The published lines are taken for any telemetry; every other source needs readings that are consistent with sunlight.

    Raises
    ------
    TelemetryError
        The readings are not consistent with sunlight, no threshold is calibrated for the data, or no motion fits them.
    """
    rebound, case, source = scan.rebound, scan.rebound.case, options.source
    if source != "published" and check.reasons:
        raise TelemetryError(
            "nothing can be concluded from these readings",
            got="; ".join(check.reasons),
            do="check the panels' columns, gains and units",
        )
    calibration = get_calibration(rebound, scan.table, options) if source == "scan" else None
    if calibration is not None and calibration.unusual(scan.smallest):
        usual = calibration.emd_min
        raise TelemetryError(
            "no motion of the model fits the distribution of r_z",
            got=f"a smallest EMD of {scan.smallest:.4f}, where {len(usual)} synthetic rebounds like these data have "
            f"{usual.min():.4f} to {usual.max():.4f}",
            do="check the vehicle, the wheel's command and the panels' gains",
        )
    start = scan.table.rows.start
    # grid step along each axis; 0 for an axis of one point
    steps = [np.diff(axis[:2]).sum() for axis in (start.omega_x, start.omega_y, start.omega_z)]
    half_diagonal = float(np.linalg.norm(steps)) / 2

    # motions whose propagation failed have an infinite EMD and belong to no set
    computed = np.flatnonzero(np.isfinite(scan.emd))
    # the speeds of all motions are computed once for the sets of the scan; with a posterior only the near-minimum set is needed
    speeds = None if source == "posterior" else touchdown_speeds(rebound, start.take(computed))

    def select_below(limit: float, source: str, about: str) -> Candidates:
        """Return the motions of the scan with an EMD below `limit`."""
        inside = scan.emd[computed] < limit
        return make_candidates(
            rebound,
            start.take(computed[inside]),
            options.seed,
            None if speeds is None else speeds[inside],
            source=source,
            about=about,
            cell_rad_s=half_diagonal,
        )

    factor, share = case.assumptions.study.near_minimum_factor, float("nan")
    about = f"the paper's recipe on this telemetry: EMD below {factor:g} times the smallest"
    near_minimum = select_below(factor * scan.smallest, "scan", about)
    if source == "posterior":
        posterior = sample_posterior(case.vehicle, case.telemetry, rebound.span_s, options)
        chosen, prior = (
            make_candidates(
                rebound, states, options.seed, source=source, about=about, from_posterior=True
            )
            for states, about in (
                draws_of_posterior(posterior),
                _draw_from_prior(rebound, posterior, options.seed),
            )
        )
        return CandidateSets(
            case, rebound, chosen, prior, near_minimum, None, share, posterior=posterior
        )
    about = "the whole scanned box: what was possible before the data"
    scan_range = select_below(np.inf, source, about)
    if calibration is not None:
        factor = calibration.factor().value
        limit = factor * scan.smallest
        share = float(np.mean(scan.emd < limit))
        about = (
            f"the {calibration.confidence:.0%} set of the scan: EMD below {factor:.3g} times the smallest, {share:.0%} of the "
            "scanned box"
        )
        chosen = select_below(limit, source, about)
    elif source == "published":
        states = rebound.states(published_candidates(case))
        about = "the lines that the paper publishes, for any telemetry"
        chosen = make_candidates(rebound, states, options.seed, source=source, about=about)
    else:
        path = Path(source)
        states, about = rebound.states(read_rates(path)), f"the motions of {path.name}"
        chosen = make_candidates(rebound, states, options.seed, source=path.name, about=about)
    return CandidateSets(case, rebound, chosen, scan_range, near_minimum, calibration, share)


def sample_posterior(
    vehicle: Vehicle, telemetry: xr.Dataset, span_s: tuple[float, float], options: Options
) -> xr.DataTree:
    """Return the posterior of the readings in `Rebound.span_s`; raise `TelemetryError` if no motion explains them."""
    from sunspin.estimate.posterior import posterior

    begin_s, end_s = span_s
    tree = posterior(
        vehicle,
        telemetry,
        seed=options.seed,
        begin_s=begin_s,
        end_s=end_s,
        draws=POSTERIOR_DRAWS,
        workers=options.workers,
        progress=options.progress,
    )
    if tree.attrs["verdict_word"] == "not explained":
        what = "no motion explains the readings of the rebound"
        raise TelemetryError(what, got=str(tree.attrs["verdict"]))
    return tree


def draws_of_posterior(posterior: xr.DataTree) -> tuple[Rows, str]:
    """Return the states of the posterior's draws, with directions and wheel speeds of their own, and their description."""
    draws = posterior["posterior"].to_dataset()
    omega, sun, speeds = (
        draws[name].values.reshape(-1, draws[name].shape[-1])
        for name in ("omega_B", "sun_B", "wheel_speed_rad_s")
    )
    states = Rows(omega, sun / np.linalg.norm(sun, axis=1, keepdims=True), speeds)
    word = posterior.attrs["verdict_word"]
    return states, f"{len(states)} draws of the posterior of the readings ({word})"


def _draw_from_prior(rebound: Rebound, posterior: xr.DataTree, seed: int) -> tuple[Rows, str]:
    """Draw states from the posterior's prior of the rates, which begin like those of the scan; return also their description."""
    # the rate prior is uniform for |omega| < max_rate, so |omega| is distributed as max_rate times a cube root
    max_rate, rng = float(posterior.attrs["max_rate_rad_s"]), generator(seed, 11)
    direction = rng.standard_normal((DRAWS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    states = rebound.states(direction * max_rate * np.cbrt(rng.random(DRAWS))[:, None])
    return states, f"even in the ball of {max_rate:g} rad/s of the posterior's prior"


def read_rates(path: Path) -> np.ndarray:
    """Read rates (n, 3) in rad/s from a table with columns omega_x, omega_y, omega_z: CSV, Parquet or NetCDF-4.

    Raises `InputError` if there is no such file, or if a column is missing, empty or not finite.
    """
    if not path.is_file():
        raise InputError(
            "--candidates takes scan, posterior, published or a file, and there is no such file",
            got=str(path),
            do="give a table with columns omega_x, omega_y, omega_z in rad/s",
        )
    table, columns = read_table(path), ("omega_x", "omega_y", "omega_z")
    omega = table.numbers(columns) if table.has(columns) else np.zeros((0, 3))
    if not len(omega) or not np.all(np.isfinite(omega)):
        what = "candidates need columns omega_x, omega_y, omega_z with finite rates in rad/s"
        raise InputError(what, got=f"columns {', '.join(table.header)}", where=str(path))
    return omega


def select_start_rates(
    craft: Vehicle, omega: list[list[float]], scan: Path | None, factor: float
) -> tuple[np.ndarray, str]:
    """Return candidate rates (m, 3) in rad/s for `sunspin outcomes`, and a description of their source.

    They are `omega` (rad/s) if any are given, else the near-minimum set of the stored `scan` (EMD below `factor` times the
    smallest), else the published lines of the case. Those lines hold for the body of the case and are refused for any other. A scan
    of another body is accepted, and the description says so.
    """
    if scan is not None and omega:
        raise InputError("candidates come from --scan or from --omega-deg-s", do="give one of them")
    if omega:
        return np.array(omega), "as given"
    if scan is not None:
        scanned, about = stored_vehicle(scan), f"the near-minimum set of {scan.name}"
        if scanned != craft.result_attributes:
            bodies = f"{_describe_body(scanned)}, here {_describe_body(craft.result_attributes)}"
            about += f"; of another body than this run's: {bodies}"
        return stored_near_minimum(scan, factor), about
    case = load_case(craft.name) if craft.name in case_names() else None
    if case is None or "line_L1" not in case.published:
        do = "give --omega-deg-s x,y,z or --scan scan.nc"
        raise InputError("no candidate motions are given", do=do)
    if motion_and_panel_parameters(craft) != motion_and_panel_parameters(case.vehicle):
        raise InputError(
            "the published lines hold for another body, wheel or panels than these",
            got=_describe_body(craft.result_attributes),
            do="scan these with the same --set and give --scan scan.nc, or give --omega-deg-s",
        )
    return published_candidates(case), "the lines that the paper prints"


def _describe_body(attributes: dict[str, str]) -> str:
    """Return the vehicle's name and its changes in one line, from the attributes of a result."""
    changes = attributes.get("changes", "as in its file").splitlines()
    return ", ".join([attributes.get("vehicle", "a vehicle without a name"), *changes])

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
from sunspin.dynamics.ensemble import EMD_ERROR, Rows, run_rows
from sunspin.estimate.scan.chosen import stored_near_minimum, stored_vehicle
from sunspin.estimate.scan.end_rates import end_rates
from sunspin.landing.outcomes import BINS
from sunspin.philae.data_check import DataCheck
from sunspin.philae.metrics import TelemetryScan
from sunspin.philae.rebound import (
    Options,
    Rebound,
    momentum_angles,
    motion_and_panel_parameters,
    propagate_back,
    published_candidates,
)
from sunspin.philae.threshold import CONFIDENCE, Calibration, get_calibration
from sunspin.telemetry.synthetic import generator
from sunspin.vehicle import Vehicle

DRAWS, ELEVATION_DRAWS, POSTERIOR_DRAWS = 10_000, 2_000, 4_000
"""Numbers of candidates drawn evenly from a set: for runs to the collision, for ranges of the Sun's elevation, from a posterior."""

DIRECTION_ERROR = 1e-5
"""Largest error (rad) of directions at touchdown and collision; angular speeds then err far less than the grid's step."""


@dataclass(frozen=True)
class Candidates:
    """Motions given by their states at the candidates' instant (:class:`sunspin.philae.rebound.Rebound`).

    Attributes
    ----------
    chain : source: "scan", "posterior", "published" or the file's name
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

    chain: str
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
        """Return the range (rad) of the smaller (`which` 0) or larger (1) angle, widened by the angle of a grid cell."""
        low, high = self.range(self.angles[which])
        return max(low - self.angle_cell_rad, 0.0), min(high + self.angle_cell_rad, np.pi)

    def dataset(self) -> xr.Dataset:
        """Return the candidates as :func:`sunspin.landing.outcomes.outcomes` accepts them, all equally likely."""
        body, speed = ("candidate", "axis"), self.states.wheel_speed_rad_s
        return xr.Dataset(
            {
                "omega_B": (body, self.states.omega_B, {"units": "rad s-1"}),
                "sun_B": (body, self.states.sun_B, {"units": "1"}),
                "wheel_speed_rad_s": (("candidate", "wheel"), speed, {"units": "rad s-1"}),
            },
            coords={"axis": ["x", "y", "z"]},
            attrs={"about": self.about, "chain": self.chain},
        )


def touchdown_speeds(rebound: Rebound, states: Rows) -> np.ndarray:
    """Return the angular speeds (n) in rad/s of motions just after the first touchdown."""
    back = propagate_back(rebound.case, states, rebound.lead_s, DIRECTION_ERROR)
    return np.linalg.norm(back, axis=1)


def make_candidates(
    rebound: Rebound, states: Rows, seed: int, speed: np.ndarray | None = None, **labels: Any
) -> Candidates:
    """Return candidates with their angles and their speeds at touchdown and collision.

    `speed` (n) holds the result of :func:`touchdown_speeds`, if it is known. `labels` are the fields `chain`, `about`, `cell_rad_s`
    and `from_posterior` of `Candidates`. Runs to the collision are made for motions drawn evenly.
    """
    vehicle, draws = rebound.case.vehicle, states
    speed = touchdown_speeds(rebound, states) if speed is None else speed
    if len(states) > DRAWS:
        draws = states.take(generator(seed, 10).choice(len(states), DRAWS, replace=False))
    at_collision = end_rates(vehicle, draws, rebound.window_s, DIRECTION_ERROR)
    few = draws.take(np.arange(min(ELEVATION_DRAWS, len(draws))))
    run = run_rows(vehicle, few, rebound.window_s, emd_error=EMD_ERROR, bins=BINS)
    # r_z between the outer edges of the first and the last bin that a motion visits
    visited, edges = run.hist > 0, np.linspace(-1, 1, BINS + 1)
    low, high = edges[np.argmax(visited, axis=1)], edges[BINS - np.argmax(visited[:, ::-1], axis=1)]
    theta, alpha, momentum = momentum_angles(vehicle, states)
    # H changes within a cell by at most the largest moment of inertia times the change of the rate
    largest = float(np.linalg.eigvalsh(vehicle.require_inertia())[-1])
    relative = largest * labels.get("cell_rad_s", 0.0) / max(float(np.median(momentum)), 1e-12)
    return Candidates(
        states=states,
        speed_touchdown=speed,
        theta=theta,
        alpha=alpha,
        speed_collision=np.linalg.norm(at_collision, axis=1),
        sun_elevation=np.arcsin(np.stack([low, high], axis=1)),
        angle_cell_rad=float(np.arctan(relative)),
        **labels,
    )


@dataclass(frozen=True)
class Chain:
    """Chosen candidates of this telemetry, with the two sets for comparison and the calibration of the threshold.

    `scan_range` holds the whole scan range, `near_minimum` the paper's near-minimum set. `share` is the part of the scan range in
    the chosen set (NaN unless it comes from the scan). `verdict` is that of the posterior, else "".
    """

    case: Case
    rebound: Rebound
    chosen: Candidates
    scan_range: Candidates
    near_minimum: Candidates
    calibration: Calibration | None
    share: float
    verdict: str = ""

    @property
    def name(self) -> str:
        """Source of the chosen candidates."""
        return self.chosen.chain


def compute(scan: TelemetryScan, check: DataCheck, options: Options) -> Chain:
    """Return the candidates of this telemetry from the source in `options`.

    Raises
    ------
    TelemetryError
        The readings are not consistent with sunlight, no threshold is calibrated for the data, or no motion fits them.
    """
    rebound, case, least, source = scan.rebound, scan.rebound.case, scan.smallest, options.source
    if source != "published" and check.reasons:
        raise TelemetryError(
            "nothing can be concluded from these readings",
            got="; ".join(check.reasons),
            do="check the panels' columns, gains and units",
        )
    calibrated = get_calibration(rebound, scan.table, options) if source == "scan" else None
    if calibrated is not None and calibrated.unusual(least):
        usual = calibrated.emd_min
        raise TelemetryError(
            "no motion of the model fits the distribution of r_z",
            got=f"a smallest EMD of {least:.4f}, where {len(usual)} synthetic rebounds like these data have "
            f"{usual.min():.4f} to {usual.max():.4f}",
            do="check the vehicle, the wheel's command and the panels' gains",
        )
    start = scan.table.rows.start
    steps = [np.diff(axis[:2]).sum() for axis in (start.omega_x, start.omega_y, start.omega_z)]
    cell = float(np.linalg.norm(steps)) / 2

    # motions whose propagation failed have an infinite EMD and belong to no set
    computed = np.flatnonzero(np.isfinite(scan.emd))
    emd = scan.emd[computed]
    speed = None if source == "posterior" else touchdown_speeds(rebound, start.take(computed))

    def select_below(level: float, chain: str, about: str) -> Candidates:
        """Return the motions of the scan with an EMD below `level`."""
        inside, labels = emd < level, {"chain": chain, "about": about, "cell_rad_s": cell}
        speeds = None if speed is None else speed[inside]
        states = start.take(computed[inside])
        return make_candidates(rebound, states, options.seed, speeds, **labels)

    factor, share = case.assumptions.study.near_minimum_factor, float("nan")
    about = f"the paper's recipe on this telemetry: EMD below {factor:g} times the smallest"
    near_minimum = select_below(factor * least, "scan", about)
    if source == "posterior":
        chosen, prior, verdict = _from_posterior(rebound, options)
        return Chain(case, rebound, chosen, prior, near_minimum, None, share, verdict)
    about = "the whole scanned box: what was possible before the data"
    scan_range = select_below(np.inf, source, about)
    if calibrated is not None:
        level = calibrated.factor()[0]
        share = float(np.mean(scan.emd < level * least))
        about = (
            f"the {calibrated.confidence:.0%} set of the scan: EMD below {level:.3g} times the smallest, {share:.0%} of the "
            "scanned box"
        )
        chosen = select_below(level * least, source, about)
    else:
        omega, chain = published_candidates(case), source
        about = "the lines that the paper publishes, for any telemetry"
        if source != "published":
            omega, chain = read_rates(Path(source)), Path(source).name
            about = f"the motions of {chain}"
        states = rebound.states(omega)
        chosen = make_candidates(rebound, states, options.seed, chain=chain, about=about)
    return Chain(case, rebound, chosen, scan_range, near_minimum, calibrated, share)


def _from_posterior(rebound: Rebound, options: Options) -> tuple[Candidates, Candidates, str]:
    """Return draws of the posterior of the rebound's readings, draws of its rate prior, and its verdict."""
    from sunspin.estimate.posterior.estimate import posterior

    times, seed = rebound.samples["utc_s"].values, options.seed
    tree = posterior(
        rebound.case.vehicle,
        rebound.case.telemetry,
        seed=seed,
        begin_s=float(times[rebound.first]),
        end_s=float(times[-1]),
        draws=POSTERIOR_DRAWS,
        workers=options.workers,
        progress=options.progress,
    )
    word, verdict = tree.attrs["verdict_word"], str(tree.attrs["verdict"])
    if word == "not explained":
        raise TelemetryError("no motion explains the readings of the rebound", got=verdict)
    draws = tree["posterior"].to_dataset()
    omega, sun, speeds = (
        draws[name].values.reshape(-1, draws[name].shape[-1])
        for name in ("omega_B", "sun_B", "wheel_speed_rad_s")
    )
    states = Rows(omega, sun / np.linalg.norm(sun, axis=1, keepdims=True), speeds)
    # the rate prior is uniform for |omega| < radius
    radius, rng = float(tree.attrs["max_rate_rad_s"]), generator(seed, 11)
    direction = rng.standard_normal((DRAWS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    ball = rebound.states(direction * radius * np.cbrt(rng.random(DRAWS))[:, None])
    chosen, prior = (
        make_candidates(rebound, motions, seed, chain="posterior", about=about, from_posterior=True)
        for motions, about in (
            (states, f"{len(states)} draws of the posterior of the readings ({word})"),
            (ball, f"even in the ball of {radius:g} rad/s of the posterior's prior"),
        )
    )
    return chosen, prior, verdict


def read_rates(path: Path) -> np.ndarray:
    """Read rates (n, 3) in rad/s from a table with columns omega_x, omega_y, omega_z: CSV, Parquet or NetCDF-4."""
    if not path.is_file():
        raise InputError(
            "--candidates takes scan, posterior, published or a file, and there is no such file",
            got=str(path),
            do="give a table with columns omega_x, omega_y, omega_z in rad/s",
        )
    table, names = read_table(path), ("omega_x", "omega_y", "omega_z")
    omega = table.numbers(names) if table.has(names) else np.zeros((0, 3))
    if not len(omega) or not np.all(np.isfinite(omega)):
        what = "candidates need columns omega_x, omega_y, omega_z with finite rates in rad/s"
        raise InputError(what, got=f"columns {', '.join(table.header)}", where=str(path))
    return omega


def select_start_rates(
    craft: Vehicle, omega: list[list[float]], scan: Path | None, factor: float
) -> tuple[np.ndarray, str]:
    """Return candidate rates (m, 3) in rad/s for `sunspin outcomes`, and a description of their source.

    They are `omega` if any are given, else the near-minimum set of a stored scan, else the published lines of the case. Those lines
    hold for the body of the case and are refused for any other.
    """

    def describe_body(attributes: dict[str, str]) -> str:
        """Return the vehicle's name and its changes in one line."""
        changes = attributes.get("changes", "as in its file").splitlines()
        return ", ".join([attributes.get("vehicle", "a vehicle without a name"), *changes])

    if scan is not None and omega:
        raise InputError("candidates come from --scan or from --omega-deg-s", do="give one of them")
    if omega:
        return np.array(omega), "as given"
    if scan is not None:
        scanned, about = stored_vehicle(scan), f"the near-minimum set of {scan.name}"
        if scanned != craft.result_attributes:
            bodies = f"{describe_body(scanned)}, here {describe_body(craft.result_attributes)}"
            about += f"; of another body than this run's: {bodies}"
        return stored_near_minimum(scan, factor), about
    case = load_case(craft.name) if craft.name in case_names() else None
    if case is None or "line_L1" not in case.published:
        do = "give --omega-deg-s x,y,z or --scan scan.nc"
        raise InputError("no candidate motions are given", do=do)
    if motion_and_panel_parameters(craft) != motion_and_panel_parameters(case.vehicle):
        raise InputError(
            "the published lines hold for another body, wheel or panels than these",
            got=describe_body(craft.result_attributes),
            do="scan these with the same --set and give --scan scan.nc, or give --omega-deg-s",
        )
    return published_candidates(case), "the lines that the paper prints"

"""The motions that stand for the landing: from which the touchdown, the collision and what follows are computed.

`--candidates` says where they come from: the 90 % set of the scan against the telemetry (the default), the posterior of its
readings, the lines that the paper publishes (for any telemetry), or a file. With them stand the whole scanned range, which is
what was possible before the data, and the paper's own set, below 1.1 times the smallest EMD.
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
from sunspin.dynamics import ensemble as k
from sunspin.dynamics.ensemble import Rows
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
from sunspin.philae.threshold import CONFIDENCE, Calibration, calibration
from sunspin.telemetry.synthetic import generator
from sunspin.vehicle import Vehicle

DRAWS, HEIGHT_DRAWS, POSTERIOR_DRAWS = 10_000, 2_000, 4_000
"""Motions drawn evenly from a set where each costs a run to the collision, or the heights of its Sun; draws of a posterior."""

DIRECTION_ERROR = 1e-5
"""Error (rad) of directions at the touchdown and at the collision: angular speeds then err by far less than the grid's step."""


@dataclass(frozen=True)
class Candidates:
    """Motions at the instant of the first direction after the touchdown.

    Attributes
    ----------
    chain : "scan", "posterior", "published" or the file's name
    about : in words, what they are
    states : `Rows` of all of them (n)
    speed_touchdown : (n) rad/s just after the first touchdown
    theta, alpha : (n) rad, angles of the momentum H from the body's z axis and from the Sun at their instant
    speed_collision : (n_draws) rad/s just before the collision, of motions drawn evenly
    height : (n_draws, 2) rad, smallest and largest height of the Sun up to the collision, of motions drawn evenly
    cell_rad_s : half the diagonal of the scanned grid's cell: each motion stands for all as near as this; 0 without a grid
    angle_cell : rad by which the momentum turns within that cell, at the median size of the momentum
    probable : whether they are draws of a probability: intervals are then its 5 to 95 %, else the least and largest
    """

    chain: str
    about: str
    states: Rows
    speed_touchdown: np.ndarray
    theta: np.ndarray
    alpha: np.ndarray
    speed_collision: np.ndarray
    height: np.ndarray
    angle_cell: float
    cell_rad_s: float = 0.0
    probable: bool = False

    def __len__(self) -> int:
        return len(self.states)

    @property
    def angles(self) -> np.ndarray:
        """The smaller and the larger of theta and alpha (2, n), rad: EMD of r_z does not tell the two apart."""
        return np.sort([self.theta, self.alpha], axis=0)

    def range(self, values: np.ndarray) -> tuple[float, float]:
        """Least and largest of values over the candidates; 5 and 95 % where they are draws of a probability."""
        tail = (1 - CONFIDENCE) / 2 if self.probable else 0.0
        low, high = np.quantile(values, [tail, 1 - tail])
        return float(low), float(high)

    def speed_range(self) -> tuple[float, float]:
        """Least and largest angular speed (rad/s) just after the touchdown, over the cells of the grid."""
        low, high = self.range(self.speed_touchdown)
        return max(low - self.cell_rad_s, 0.0), high + self.cell_rad_s

    def angle_range(self, which: int) -> tuple[float, float]:
        """Least and largest of the smaller (0) or the larger (1) angle, rad, over the cells of the grid."""
        low, high = self.range(self.angles[which])
        return max(low - self.angle_cell, 0.0), min(high + self.angle_cell, np.pi)

    def dataset(self) -> xr.Dataset:
        """As `outcomes` takes candidates: all equally likely."""
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


def speed_at_touchdown(rebound: Rebound, states: Rows) -> np.ndarray:
    """Angular speed (n) in rad/s of motions just after the first touchdown."""
    back = propagate_back(rebound.case, states, rebound.lead_s, DIRECTION_ERROR)
    return np.linalg.norm(back, axis=1)


def describe(
    rebound: Rebound, states: Rows, seed: int, speed: np.ndarray | None = None, **labels: Any
) -> Candidates:
    """Candidates with what is asked of them; runs to the collision are made for even draws only.

    `speed` (n): of :func:`speed_at_touchdown`, if known; `labels`: `chain`, `about`, `cell_rad_s`, `probable` of `Candidates`.
    """
    vehicle, draws = rebound.case.vehicle, states
    speed = speed_at_touchdown(rebound, states) if speed is None else speed
    if len(states) > DRAWS:
        draws = states.take(generator(seed, 10).choice(len(states), DRAWS, replace=False))
    at_collision = end_rates(vehicle, draws, rebound.window_s, DIRECTION_ERROR)
    few = draws.take(np.arange(min(HEIGHT_DRAWS, len(draws))))
    run = k.run_rows(vehicle, few, rebound.window_s, emd_error=k.EMD_ERROR, bins=BINS)
    seen, edges = run.hist > 0, np.linspace(-1, 1, BINS + 1)
    low, high = edges[np.argmax(seen, axis=1)], edges[BINS - np.argmax(seen[:, ::-1], axis=1)]
    theta, alpha, momentum = momentum_angles(vehicle, states)
    largest = float(np.linalg.eigvalsh(vehicle.require_inertia())[-1])
    turn = largest * labels.get("cell_rad_s", 0.0) / max(float(np.median(momentum)), 1e-12)
    return Candidates(
        states=states,
        speed_touchdown=speed,
        theta=theta,
        alpha=alpha,
        speed_collision=np.linalg.norm(at_collision, axis=1),
        height=np.arcsin(np.stack([low, high], axis=1)),
        angle_cell=float(np.arctan(turn)),
        **labels,
    )


@dataclass(frozen=True)
class Chain:
    """The chosen candidates, the scanned range as a set, the paper's own set of this telemetry; how the threshold was calibrated.

    `share`: part of the scanned range that the chosen set holds (NaN for other chains). `verdict`: of the posterior, else "".
    """

    case: Case
    rebound: Rebound
    chosen: Candidates
    box: Candidates
    recipe: Candidates
    calibration: Calibration | None
    share: float
    verdict: str = ""

    @property
    def name(self) -> str:
        return self.chosen.chain


def compute(scan: TelemetryScan, carries: DataCheck, options: Options) -> Chain:
    """The candidates of this telemetry, from the source asked for.

    Raises
    ------
    TelemetryError
        Readings from which nothing can be concluded; data for which no threshold was calibrated; a model that does not fit.
    """
    rebound, case, least, source = scan.rebound, scan.rebound.case, scan.smallest, options.source
    if source != "published" and carries.reasons:
        raise TelemetryError(
            "nothing can be concluded from these readings",
            got="; ".join(carries.reasons),
            do="check the panels' columns, gains and units",
        )
    calibrated = calibration(rebound, scan.table, options) if source == "scan" else None
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

    fine = np.flatnonzero(np.isfinite(scan.emd))
    emd = scan.emd[fine]
    speed = None if source == "posterior" else speed_at_touchdown(rebound, start.take(fine))

    def below(level: float, chain: str, about: str) -> Candidates:
        inside, labels = emd < level, {"chain": chain, "about": about, "cell_rad_s": cell}
        known = None if speed is None else speed[inside]
        return describe(rebound, start.take(fine[inside]), options.seed, known, **labels)

    factor, share = case.assumptions.study.near_minimum_factor, float("nan")
    about = f"the paper's recipe on this telemetry: EMD below {factor:g} times the smallest"
    recipe = below(factor * least, "scan", about)
    if source == "posterior":
        chosen, box, verdict = _from_posterior(rebound, options)
        return Chain(case, rebound, chosen, box, recipe, None, share, verdict)
    box = below(np.inf, source, "the whole scanned box: what was possible before the data")
    if calibrated is not None:
        level = calibrated.factor()[0]
        share = float(np.mean(scan.emd < level * least))
        about = (
            f"the {calibrated.confidence:.0%} set of the scan: EMD below {level:.3g} times the smallest, {share:.0%} of the "
            "scanned box"
        )
        chosen = below(level * least, source, about)
    else:
        omega, chain = published_candidates(case), source
        about = "the lines that the paper publishes, for any telemetry"
        if source != "published":
            omega, chain = rates_of(Path(source)), Path(source).name
            about = f"the motions of {chain}"
        states = rebound.states(omega)
        chosen = describe(rebound, states, options.seed, chain=chain, about=about)
    return Chain(case, rebound, chosen, box, recipe, calibrated, share)


def _from_posterior(rebound: Rebound, options: Options) -> tuple[Candidates, Candidates, str]:
    """Draws of the posterior of the rebound's readings; motions drawn evenly from the ball of its prior; its verdict."""
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
    drawn = tree["posterior"].to_dataset()
    omega, sun, speeds = (
        drawn[name].values.reshape(-1, drawn[name].shape[-1])
        for name in ("omega_B", "sun_B", "wheel_speed_rad_s")
    )
    states = Rows(omega, sun / np.linalg.norm(sun, axis=1, keepdims=True), speeds)
    radius, rng = float(tree.attrs["max_rate_rad_s"]), generator(seed, 11)
    direction = rng.standard_normal((DRAWS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    ball = rebound.states(direction * radius * np.cbrt(rng.random(DRAWS))[:, None])
    chosen, before = (
        describe(rebound, motions, seed, chain="posterior", about=about, probable=True)
        for motions, about in (
            (states, f"{len(states)} draws of the posterior of the readings ({word})"),
            (ball, f"even in the ball of {radius:g} rad/s of the posterior's prior"),
        )
    )
    return chosen, before, verdict


def rates_of(path: Path) -> np.ndarray:
    """Rates (n, 3) in rad/s from a table with columns omega_x, omega_y, omega_z: CSV, Parquet or NetCDF-4."""
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


def starts(
    craft: Vehicle, omega: list[list[float]], scan: Path | None, factor: float
) -> tuple[np.ndarray, str]:
    """Candidate rates (m, 3) in rad/s of `sunspin outcomes`, and in words where they come from and whose they are.

    They are `omega` where any are given, else the near-minimum set of a stored scan, else the case's published lines, which
    hold for the case's own body: for another they are refused.
    """

    def body(said: dict[str, str]) -> str:
        changes = said.get("changes", "as in its file").splitlines()
        return ", ".join([said.get("vehicle", "a vehicle without a name"), *changes])

    if scan is not None and omega:
        raise InputError("candidates come from --scan or from --omega-deg-s", do="give one of them")
    if omega:
        return np.array(omega), "as given"
    if scan is not None:
        of, mine, about = stored_vehicle(scan), craft.said, f"the near-minimum set of {scan.name}"
        if of != mine:
            about += f"; of another body than this run's: {body(of)}, here {body(mine)}"
        return stored_near_minimum(scan, factor), about
    case = load_case(craft.name) if craft.name in case_names() else None
    if case is None or "line_L1" not in case.published:
        do = "give --omega-deg-s x,y,z or --scan scan.nc"
        raise InputError("no candidate motions are given", do=do)
    if motion_and_panel_parameters(craft) != motion_and_panel_parameters(case.vehicle):
        raise InputError(
            "the published lines hold for another body, wheel or panels than these",
            got=body(craft.said),
            do="scan these with the same --set and give --scan scan.nc, or give --omega-deg-s",
        )
    return published_candidates(case), "the lines that the paper prints"

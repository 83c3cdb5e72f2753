"""The motions that stand for the landing: from which the touchdown, the collision and what follows are computed.

`--candidates` says where they come from: the 90 % set of the scan against the telemetry (the default), the posterior of its
readings, the lines that the paper prints (whatever the telemetry says), or a file. Beside them stand the whole scanned box, which
is what was possible before the data, and the paper's own set, below 1.1 times the smallest EMD.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, TelemetryError
from sunspin.base.tables import read_table
from sunspin.compute.rows import ensemble
from sunspin.dynamics import ensemble as k
from sunspin.dynamics.ensemble import Rows
from sunspin.estimate.scan.end_rates import end_rates
from sunspin.estimate.scan.table import Table
from sunspin.landing.outcomes import BINS
from sunspin.landing.tally import Estimate, estimate
from sunspin.philae import rebound as rb
from sunspin.philae.carries import Carries
from sunspin.philae.threshold import CONFIDENCE, Calibration, calibration
from sunspin.telemetry.case import Case
from sunspin.telemetry.synthetic import generator

CHAINS = ("scan", "posterior", "published")
"""Sources of candidates; anything else names a file."""

DRAWS = 10_000
"""Motions drawn evenly from a set where each costs a run to the collision."""

DIRECTION_ERROR = 1e-5
"""Error (rad) of directions at the touchdown and at the collision: angular speeds then err by far less than the grid's step."""

HEIGHT_DRAWS = 2_000

POSTERIOR_DRAWS = 4_000
TAIL = (1 - CONFIDENCE) / 2


@dataclass(frozen=True)
class Candidates:
    """Motions at the instant of the first direction after the touchdown.

    Attributes
    ----------
    name : "set", "box" or "recipe"
    chain : "scan", "posterior", "published" or the file's name
    about : in words, what they are
    states : `Rows` of all of them (n)
    speed_touchdown : (n) rad/s just after the first touchdown
    theta, alpha : (n) rad, angles of the momentum H from the body's z axis and from the Sun at their instant
    speed_collision : (n_draws) rad/s just before the collision, of motions drawn evenly
    height : (n_draws, 2) rad, smallest and largest height of the Sun up to the collision, of motions drawn evenly
    probable : whether they are draws of a probability: intervals are then its 5 to 95 %, else the least and largest
    cell_rad_s : half the diagonal of the scanned grid's cell: each motion stands for all as near as this; 0 without a grid
    angle_cell : rad by which the momentum turns within that cell, at the median size of the momentum
    """

    name: str
    chain: str
    about: str
    states: Rows
    speed_touchdown: np.ndarray
    theta: np.ndarray
    alpha: np.ndarray
    speed_collision: np.ndarray
    height: np.ndarray
    probable: bool
    cell_rad_s: float
    angle_cell: float

    def __len__(self) -> int:
        return len(self.states)

    def range(self, values: np.ndarray) -> tuple[float, float]:
        """Least and largest of values over the candidates; 5 and 95 % where they are draws of a probability."""
        if self.probable:
            low, high = np.quantile(values, [TAIL, 1 - TAIL])
            return float(low), float(high)
        return float(values.min()), float(values.max())

    def speed_range(self) -> tuple[float, float]:
        """Least and largest angular speed (rad/s) just after the touchdown, over the cells of the grid."""
        low, high = self.range(self.speed_touchdown)
        return max(low - self.cell_rad_s, 0.0), high + self.cell_rad_s

    def angle_range(self, values: np.ndarray) -> tuple[float, float]:
        """Least and largest of angles (n), rad, over the cells of the grid; `values` is one of the properties below."""
        if self.probable:
            return self.range(values)
        return max(float((values - self.angle_cell).min()), 0.0), min(
            float((values + self.angle_cell).max()), np.pi
        )

    @property
    def smaller_angle(self) -> np.ndarray:
        """The smaller of theta and alpha (n), rad: EMD of r_z does not tell the two apart."""
        return np.minimum(self.theta, self.alpha)

    @property
    def larger_angle(self) -> np.ndarray:
        """The larger of theta and alpha (n), rad."""
        return np.maximum(self.theta, self.alpha)

    def mean_height(self) -> tuple[Estimate, Estimate]:
        """Means of the smallest and the largest height of the Sun (deg)."""
        low, high = np.degrees(self.height).T
        return estimate(low), estimate(high)

    def dataset(self) -> xr.Dataset:
        """As `outcomes` takes candidates: all equally likely."""
        body = ("candidate", "axis")
        return xr.Dataset(
            {
                "omega_B": (body, self.states.omega_B, {"units": "rad s-1"}),
                "sun_B": (body, self.states.sun_B, {"units": "1"}),
                "wheel_speed_rad_s": (
                    ("candidate", "wheel"),
                    self.states.wheel_speed_rad_s,
                    {"units": "rad s-1"},
                ),
            },
            coords={"axis": ["x", "y", "z"]},
            attrs={"about": self.about, "chain": self.chain},
        )


@dataclass(frozen=True)
class Chain:
    """The chosen candidates, the box they come from, the paper's own set of this telemetry; how the threshold was calibrated.

    `share`: part of the scanned box that the chosen set holds (NaN for other chains). `verdict`: of the posterior, else "".
    """

    case: Case
    rebound: rb.Rebound
    chosen: Candidates
    box: Candidates
    recipe: Candidates
    calibration: Calibration | None
    share: float
    emd_min: float
    verdict: str = ""

    @property
    def name(self) -> str:
        return self.chosen.chain


def described(
    rebound: rb.Rebound,
    name: str,
    chain: str,
    about: str,
    states: Rows,
    seed: int,
    probable: bool = False,
) -> Candidates:
    """Candidates that stand for themselves alone, with what is asked of them."""
    speed = np.linalg.norm(
        rb.run_back(rebound.case, states, rebound.lead_s, DIRECTION_ERROR), axis=1
    )
    return _with_runs(rebound, name, chain, about, states, speed, seed, probable)


def _with_runs(
    rebound: rb.Rebound,
    name: str,
    chain: str,
    about: str,
    states: Rows,
    speed: np.ndarray,
    seed: int,
    probable: bool = False,
    cell_rad_s: float = 0.0,
) -> Candidates:
    """The same with the speeds at the touchdown known; runs to the collision are made for even draws only."""
    vehicle = rebound.case.vehicle
    draws = (
        states
        if len(states) <= DRAWS
        else states.take(generator(seed, 10).choice(len(states), DRAWS, replace=False))
    )
    speed_collision = np.linalg.norm(
        end_rates(vehicle, draws, rebound.window_s, DIRECTION_ERROR), axis=1
    )
    height = _heights(rebound, draws.take(np.arange(min(HEIGHT_DRAWS, len(draws)))))
    theta, alpha, momentum = rb.momentum_angles(vehicle, states)
    turn = (
        float(np.linalg.eigvalsh(vehicle.require_inertia())[-1])
        * cell_rad_s
        / max(float(np.median(momentum)), 1e-12)
    )
    return Candidates(
        name,
        chain,
        about,
        states,
        speed,
        theta,
        alpha,
        speed_collision,
        height,
        probable,
        cell_rad_s,
        float(np.arctan(turn)),
    )


def _heights(rebound: rb.Rebound, states: Rows) -> np.ndarray:
    """Smallest and largest height (n, 2) of the Sun over the xy plane up to the collision, rad, to a bin of r_z."""
    vehicle, window_s = rebound.case.vehicle, rebound.window_s
    run = k.run_rows(vehicle, states, window_s, emd_error=k.EMD_ERROR, bins=BINS)
    edges = np.linspace(-1, 1, BINS + 1)
    seen = run.hist > 0
    low, high = edges[np.argmax(seen, axis=1)], edges[BINS - np.argmax(seen[:, ::-1], axis=1)]
    return np.arcsin(np.stack([low, high], axis=1))


@dataclass(frozen=True)
class Scanned:
    """The scan against the telemetry: its table, EMD (n) of every motion (infinite where it failed), the rebound it is of."""

    rebound: rb.Rebound
    table: Table
    emd: np.ndarray

    @property
    def smallest(self) -> float:
        return float(self.emd.min())


def scanned(rebound: rb.Rebound, table: Table, emd: np.ndarray) -> Scanned:
    """Of every motion of a table its EMD, of any shape, to the z components of the rebound's directions."""
    return Scanned(rebound, table, np.where(table.outcome == k.Outcome.FINE, emd.ravel(), np.inf))


def compute(
    scan: Scanned,
    carries: Carries,
    source: str = "scan",
    twins: int | None = None,
    seed: int = 0,
    *,
    workers: int | None = None,
    progress: bool = False,
) -> Chain:
    """The candidates of this telemetry, from the source asked for.

    Parameters
    ----------
    source : "scan", "posterior", "published", or the path of a table with columns omega_x, omega_y, omega_z (rad/s)
    twins : int, optional
        Synthetic rebounds of a calibration made now; zero: none, see `threshold.calibration`.

    Raises
    ------
    TelemetryError
        Readings from which nothing can be concluded; data for which no threshold was calibrated; a model that does not fit.
    """
    rebound, case = scan.rebound, scan.rebound.case
    if source != "published" and carries.reasons:
        raise TelemetryError(
            "nothing can be concluded from these readings",
            got="; ".join(carries.reasons),
            do="check the panels' columns, gains and units",
        )
    found = (
        calibration(case, rebound, scan.table, twins, seed, workers=workers, progress=progress)
        if source == "scan"
        else None
    )
    if source == "scan":
        _refuse_unfit(scan, found)
    start = scan.table.rows.start
    steps = [np.diff(axis[:2]).sum() for axis in (start.omega_x, start.omega_y, start.omega_z)]
    cell = float(np.linalg.norm(steps)) / 2
    speeds = ensemble(
        rb.speeds_back(case, start, rebound.lead_s, DIRECTION_ERROR), workers=workers
    )["speed"]

    def of(name: str, chain: str, about: str, chosen: np.ndarray) -> Candidates:
        index = np.flatnonzero(chosen & np.isfinite(scan.emd))
        return _with_runs(
            rebound, name, chain, about, start.take(index), speeds[index], seed, cell_rad_s=cell
        )

    box = of(
        "box",
        source,
        "the whole scanned box: what was possible before the data",
        np.ones(len(speeds), dtype=bool),
    )
    factor = case.assumptions.study.near_minimum_factor
    recipe = of(
        "recipe",
        "scan",
        f"the paper's recipe on this telemetry: EMD below {factor:g} times the smallest",
        scan.emd < factor * scan.smallest,
    )
    share, verdict = float("nan"), ""
    if source == "scan":
        assert found is not None
        level = found.factor()[0]
        inside = scan.emd < level * scan.smallest
        held = f"{inside.mean():.0%} of the scanned box"
        about = f"the {case.assumptions.study.confidence:.0%} set of the scan: EMD below {level:.3g} times the smallest, {held}"
        chosen, share = of("set", source, about, inside), float(inside.mean())
    elif source == "posterior":
        chosen, box, verdict = _from_posterior(rebound, seed, workers, progress)
    elif source == "published":
        about = "the lines that the paper prints, whatever this telemetry says"
        chosen = described(
            rebound, "set", source, about, rebound.states(rb.published_candidates(case)), seed
        )
    else:
        states, about = (
            rebound.states(_from_file(Path(source))),
            f"the motions of {Path(source).name}",
        )
        chosen = described(rebound, "set", Path(source).name, about, states, seed)
    return Chain(case, rebound, chosen, box, recipe, found, share, scan.smallest, verdict)


def _refuse_unfit(scan: Scanned, found: Calibration | None) -> None:
    if found is None:
        raise TelemetryError(
            "the threshold of the set is not calibrated for these data",
            do="run without --calibrate 0: it takes a minute",
        )
    if found.unusual(scan.smallest):
        raise TelemetryError(
            "no motion of the model fits the heights of the Sun",
            got=f"a smallest EMD of {scan.smallest:.4f}, where {found.n} synthetic rebounds like these data have "
            f"{found.emd_min.min():.4f} to {found.emd_min.max():.4f}",
            do="check the vehicle, the wheel's command and the panels' gains",
        )


def _from_posterior(
    rebound: rb.Rebound, seed: int, workers: int | None, progress: bool
) -> tuple[Candidates, Candidates, str]:
    """Draws of the posterior of the rebound's readings; motions drawn evenly from the ball of its prior; its verdict."""
    from sunspin.estimate.posterior.estimate import posterior

    case, times = rebound.case, rebound.samples["utc_s"].values
    tree = posterior(
        case.vehicle,
        case.telemetry,
        seed=seed,
        begin_s=float(times[rebound.first]),
        end_s=float(times[-1]),
        draws=POSTERIOR_DRAWS,
        workers=workers,
        progress=progress,
    )
    if tree.attrs["verdict_word"] == "not explained":
        raise TelemetryError(
            "no motion explains the readings of the rebound", got=tree.attrs["verdict"]
        )
    drawn = tree["posterior"].to_dataset()
    omega, sun, speeds = (
        drawn[name].values.reshape(-1, drawn[name].shape[-1])
        for name in ("omega_B", "sun_B", "wheel_speed_rad_s")
    )
    states = Rows(omega, sun / np.linalg.norm(sun, axis=1, keepdims=True), speeds)
    about = f"{len(states)} draws of the posterior of the readings ({tree.attrs['verdict_word']})"
    radius = float(tree.attrs["max_rate_rad_s"])
    rng = generator(seed, 11)
    direction = rng.standard_normal((DRAWS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    ball = rebound.states(direction * radius * np.cbrt(rng.random(DRAWS))[:, None])
    before = described(
        rebound,
        "box",
        "posterior",
        f"even in the ball of {radius:g} rad/s of the posterior's prior",
        ball,
        seed,
        True,
    )
    return (
        described(rebound, "set", "posterior", about, states, seed, True),
        before,
        str(tree.attrs["verdict"]),
    )


def _from_file(path: Path) -> np.ndarray:
    """Rates (n, 3) in rad/s from a table with columns omega_x, omega_y, omega_z: CSV, Parquet or NetCDF-4."""
    if not path.is_file():
        raise InputError(
            "--candidates takes scan, posterior, published or a file, and there is no such file",
            got=str(path),
            do="give a table with columns omega_x, omega_y, omega_z in rad/s",
        )
    table = read_table(path)
    names = ("omega_x", "omega_y", "omega_z")
    if missing := [name for name in names if name not in table.header]:
        what = "candidates need columns omega_x, omega_y, omega_z, rad/s"
        got = f"no {', '.join(missing)}"
        raise InputError(what, got=got, where=str(path))
    omega = table.numbers(names)
    if not len(omega) or not np.all(np.isfinite(omega)):
        raise InputError(
            "candidates must be finite rates, one row each",
            got=f"{len(omega)} rows",
            where=str(path),
        )
    return omega

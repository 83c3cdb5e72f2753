"""The paper's whole method on one twin after another: a truth, its samples, the scan, the set, its lines, the lower bound.

A twin here is the first rebound alone. Its truth is drawn on the published lines or anywhere in the scanned box; the direction
shown at the first sample is the published one, without noise as in the scan; sample times, noise and what the panels allow to
reconstruct are those of the synthetic telemetry (:mod:`sunspin.philae.twin_philae`), and so is how far the panels stand off. The
motions of the grid are run once for all twins (:mod:`sunspin.estimate.scan.table`).
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

import numpy as np

from sunspin.base.errors import InputError, sentence
from sunspin.compute.identity import code, fingerprint, plain
from sunspin.compute.rows import ensemble
from sunspin.dynamics import ensemble as k
from sunspin.dynamics.propagate import propagate
from sunspin.estimate.scan.lines import distances, fit_lines, line_deviation, match_lines, point_at
from sunspin.estimate.scan.rows import distances_to, histograms, target_segments
from sunspin.estimate.scan.table import Table, make_table
from sunspin.philae import rebound as rb
from sunspin.philae.twin_philae import (
    CELL_W,
    MAX_DRAWS,
    drawn_panels,
    keep_direction,
    rebound_times,
)
from sunspin.telemetry.case import Case, load_case
from sunspin.telemetry.sun import is_reconstructed, sun_directions
from sunspin.telemetry.synthetic import noisy_power
from sunspin.vehicle.changes import Change

PRIORS = ("lines", "grid")
"""Where truths are drawn: omega_z even over `rebound.LINE_RANGE` on one of the published lines, or even over the scanned box."""

LEAST_TOLD = 8
"""Twins with fewer directions than this are drawn again: nobody would have fitted them."""

LEVELS = np.round(np.arange(0.005, 0.1505, 0.001), 3)
"""Thresholds on EMD at which the size of the level set and its smallest speed are kept."""

FACTORS = np.round(np.geomspace(1.05, 12.0, 80), 4)
"""The same as multiples of the smallest EMD."""

LINE_STEPS = 51
"""Points of a fitted line that are run back."""


@dataclass(frozen=True)
class Ground:
    """What all twins share: the table of the grid, angular speed (n) in rad/s at the touchdown of each of its motions."""

    table: Table
    touchdown_speed: np.ndarray
    points: np.ndarray


_GROUNDS: dict[str, Ground] = {}
_LOCK = threading.Lock()


@dataclass(frozen=True)
class TwinRows:
    """Row -> one twin, its scan and what the method makes of it.

    Attributes
    ----------
    case_name : str
    prior : "lines" or "grid"
    n : number of twins
    seed : int; twin i draws from SeedSequence(seed, spawn_key=(i,))
    coarser : every n-th point of the paper's grid
    factor : near-minimum factor of the method
    changes : of the case's vehicle and assumptions
    """

    case_name: str
    prior: str
    n: int
    seed: int
    coarser: int = 1
    factor: float = 1.1
    changes: tuple[Change, ...] = ()

    outputs = {
        "truth_omega_B": ("float64", (3,)),
        "truth_touchdown_speed": ("float64", ()),
        "n_told": ("int16", ()),
        "emd_min": ("float64", ()),
        "emd_truth": ("float64", ()),
        "points": ("int32", ()),
        "truth_to_set": ("float64", ()),
        "truth_to_line": ("float64", ()),
        "line_angle": ("float64", (4,)),
        "line_distance": ("float64", (4,)),
        "bound_set": ("float64", ()),
        "bound_lines": ("float64", ()),
        "level_count": ("int32", (LEVELS.size,)),
        "level_speed": ("float64", (LEVELS.size,)),
        "factor_count": ("int32", (FACTORS.size,)),
        "factor_speed": ("float64", (FACTORS.size,)),
    }

    def __post_init__(self) -> None:
        if self.prior not in PRIORS:
            raise InputError(sentence(f"prior must be one of {', '.join(PRIORS)}", got=self.prior))
        if not self.factor > 1:
            raise InputError(
                sentence("the factor of the near-minimum set must exceed 1", got=self.factor)
            )
        for name, value, least in (
            ("n", self.n, 1),
            ("seed", self.seed, 0),
            ("coarser", self.coarser, 1),
        ):
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise InputError(
                    sentence(f"{name} must be a whole number of at least {least}", got=value)
                )

    @property
    def n_rows(self) -> int:
        return self.n

    @property
    def case(self) -> Case:
        return load_case(self.case_name, self.changes)

    def identity(self) -> dict[str, Any]:
        case = self.case
        used = (
            "first_sun",
            "scan_step",
            "scan_omega_x",
            "scan_omega_y",
            "scan_omega_z",
            "scan_duration",
        )
        return {
            **code(),
            "study": "the method on twins",
            **plain(self),
            "vehicle": plain(case.vehicle),
            "published": {key: plain(case.published[key].value) for key in used},
            "lines": plain(rb.published_lines(case)),
            "levels": plain(LEVELS),
            "factors": plain(FACTORS),
        }

    def ground(self, workers: int | None = 1, progress: bool = False) -> Ground:
        """The shared part, made once in a process."""
        case = self.case
        key = fingerprint(
            {
                **code(),
                "case": self.case_name,
                "coarser": self.coarser,
                "vehicle": plain(case.vehicle),
                "assumptions": plain(case.assumptions),
            }
        )
        with _LOCK:
            if key not in _GROUNDS:
                _GROUNDS.clear()  # one at a time: the paper's grid takes 0.4 GB
                _GROUNDS[key] = _make_ground(case, self.coarser, workers, progress)
            return _GROUNDS[key]

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        case, ground = self.case, self.ground()
        found = [
            _one(
                case,
                ground,
                self,
                np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(int(i),))),
            )
            for i in index
        ]
        return {
            name: np.array([row[name] for row in found], dtype=dtype).reshape(len(index), *shape)
            for name, (dtype, shape) in self.outputs.items()
        }


def _make_ground(case: Case, coarser: int, workers: int | None, progress: bool) -> Ground:
    axes, speeds = rb.grid(case, coarser), rb.nominal_speed(case.vehicle)
    table = make_table(
        case.vehicle,
        rb.first_sun(case),
        axes,
        speeds,
        rb.window_s(case),
        workers=workers,
        progress=progress,
        mask=None if rb.counted(case) is None else "reconstructible",
    )
    speed = ensemble(
        rb.speeds_back(case, table.rows.start, rb.after_touchdown_s(case)), workers=workers
    )["speed"]
    points = np.stack(np.meshgrid(*axes.values(), indexing="ij"), axis=-1).reshape(-1, 3)
    return Ground(table, speed, points)


def _one(case: Case, ground: Ground, setup: TwinRows, rng: np.random.Generator) -> dict[str, Any]:
    truth, z = draw_twin(case, setup.prior, rng)
    emd = np.where(ground.table.outcome == k.Outcome.FINE, ground.table.distances(z), np.inf)
    smallest = float(emd.min())
    near = emd < setup.factor * smallest
    points = ground.points[near]
    at_touchdown = np.linalg.norm(
        rb.run_back(case, _states(case, truth[None]), rb.after_touchdown_s(case))
    )
    order = np.argsort(emd, kind="stable")[
        : max(int((emd < max(LEVELS[-1], FACTORS[-1] * smallest)).sum()), 1)
    ]
    slowest = np.minimum.accumulate(ground.touchdown_speed[order])
    counts = [
        np.searchsorted(emd[order], levels, side="left") for levels in (LEVELS, FACTORS * smallest)
    ]
    speeds = [np.where(count > 0, slowest[np.maximum(count, 1) - 1], np.nan) for count in counts]
    return {
        "truth_omega_B": truth,
        "truth_touchdown_speed": at_touchdown,
        "n_told": z.size,
        "emd_min": smallest,
        "emd_truth": truth_distance(case, truth, z),
        "points": int(near.sum()),
        "truth_to_set": np.linalg.norm(points - truth, axis=1).min(),
        "bound_set": ground.touchdown_speed[near].min(),
        "level_count": counts[0],
        "level_speed": speeds[0],
        "factor_count": counts[1],
        "factor_speed": speeds[1],
        **_lines(case, points, truth),
    }


def draw_twin(case: Case, prior: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A true rate (3) in rad/s at the first sample, and the z components (n_told) that its samples tell."""
    for _ in range(MAX_DRAWS):
        truth = _draw_truth(case, prior, rng)
        z = samples_z(case, truth, rng)
        if z.size >= LEAST_TOLD:
            return truth, z
    raise InputError(
        sentence(f"no twin with {LEAST_TOLD} directions in {MAX_DRAWS} draws", got=prior)
    )


def _draw_truth(case: Case, prior: str, rng: np.random.Generator) -> np.ndarray:
    if prior == "grid":
        return np.array(
            [rng.uniform(*case.published[f"scan_omega_{axis}"].value) for axis in "xyz"]
        )
    lines = rb.published_lines(case)
    point, direction = lines[int(rng.integers(len(lines)))]
    return point_at(point, direction, 2, np.array([rng.uniform(*rb.LINE_RANGE)]))[0]


def samples_z(case: Case, truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The measured z components of a rebound with this rate at the first sample: times, noise and panels as the landing's twin."""
    vehicle = case.vehicle
    t = rebound_times(case, rng)
    tilt, first = drawn_panels(vehicle, rb.first_sun(case), rng)
    run = propagate(vehicle, truth, first, rb.nominal_speed(vehicle), t - t[0], rtol=1e-9)
    true = run["sun_B"].values
    exact = CELL_W * vehicle.response_in().power(true, tilt=tilt)
    power = noisy_power(vehicle, exact, vehicle.telemetry.noise or 0.0, rng)
    power[0] = keep_direction(vehicle, true[0], exact[0], power[0])
    sun = sun_directions(vehicle, power)
    return sun["sun_B"].values[is_reconstructed(sun["status"]), 2]


def truth_distance(case: Case, truth: np.ndarray, z: np.ndarray) -> float:
    """EMD between the z components of a twin and the distribution of its own true motion, by the scan's arithmetic."""
    hist, _ = histograms(
        case.vehicle, _states(case, truth[None]), rb.window_s(case), rb.counted(case)
    )
    return float(distances_to(hist, target_segments(z))[0][0])


def _states(case: Case, omega_B: np.ndarray) -> k.Rows:
    n = len(omega_B)
    return k.Rows(
        np.asarray(omega_B, dtype=np.float64),
        np.tile(rb.first_sun(case), (n, 1)),
        np.tile(np.asarray(rb.nominal_speed(case.vehicle), dtype=np.float64), (n, 1)),
    )


def _lines(case: Case, points: np.ndarray, truth: np.ndarray) -> dict[str, Any]:
    """The lines fitted to the near-minimum set: angle and mean distance from their published partners, smallest speed."""
    reference = rb.published_lines(case)
    none = {
        "truth_to_line": np.nan,
        "line_angle": np.full(4, np.nan),
        "line_distance": np.full(4, np.nan),
        "bound_lines": np.nan,
    }
    if len(points) < 2 * len(reference):
        return none
    lines = fit_lines(points, len(reference), seed=0)
    fitted = list(zip(lines["point"].values, lines["direction"].values, strict=True))
    options: dict[str, Any] = {"low": rb.LINE_RANGE[0], "high": rb.LINE_RANGE[1]}
    apart = [
        line_deviation(fitted[i], other, **options)
        for i, other in zip(match_lines(lines, reference, **options), reference, strict=True)
    ]
    box = np.array([case.published[f"scan_omega_{axis}"].value for axis in "xyz"])
    starts = np.concatenate([_inside(point, direction, box) for point, direction in fitted])
    speeds = np.linalg.norm(
        rb.run_back(case, _states(case, starts), rb.after_touchdown_s(case)), axis=1
    )
    to_line = distances(
        truth[None], np.array([p for p, _ in fitted]), np.array([d for _, d in fitted])
    )
    return {
        "truth_to_line": to_line.min(),
        "line_angle": np.array([one["angle_rad"] for one in apart]),
        "line_distance": np.array([one["mean"] for one in apart]),
        "bound_lines": speeds.min() if speeds.size else np.nan,
    }


def _inside(point: np.ndarray, direction: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Points (n, 3) of a line within the scanned box."""
    reach = float(np.linalg.norm(box[:, 1] - box[:, 0]) + np.linalg.norm(point - box.mean(axis=1)))
    along = point + np.linspace(-reach, reach, 4001)[:, None] * direction
    inside = along[np.all((along >= box[:, 0]) & (along <= box[:, 1]), axis=1)]
    return (
        inside[np.linspace(0, len(inside) - 1, LINE_STEPS).round().astype(int)]
        if len(inside)
        else inside
    )

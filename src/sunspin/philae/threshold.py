"""The threshold that makes the level set of a scan a confidence set, calibrated for the data at hand.

The paper's factor of 1.1 on the smallest EMD was chosen, not derived. Here the method is repeated on synthetic rebounds that are
like the file's: true rates drawn evenly from the scanned range, the file's sample times, noise, brightness and first direction
(with its error), panels off by the sigmas that the vehicle's file gives them, and about as many directions. The factor below which
the truth lies in nine of ten of them makes the set of the file's own scan a 90 % confidence set. It holds for these data only; a
shipped result is used only where its key, the hash of all that it depends on, is that of the data.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import binom
from tqdm import tqdm

from sunspin.base import atomic_write
from sunspin.base.errors import InputError, TelemetryError
from sunspin.cases import Case
from sunspin.compute.identity import fingerprint, plain
from sunspin.compute.pool import worker_count
from sunspin.dynamics import ensemble as k
from sunspin.estimate.scan.rows import BINS, distances_to, target_segments
from sunspin.estimate.scan.table import Table
from sunspin.estimate.scan.window import target_weights
from sunspin.philae.rebound import (
    Options,
    Rebound,
    direction_mask,
    motion_and_panel_parameters,
    scan_limits,
)
from sunspin.philae.telemetry import drawn_panels
from sunspin.telemetry.sun import SunStatus, is_reconstructed, signals, sun_directions
from sunspin.vehicle.response.panels import brightness, stated_sigma

CONFIDENCE = 0.9
"""Probability that a calibrated set holds the truth, where nobody asks for another."""

SHIPPED = "threshold.json"
"""The calibration of the case's own telemetry, which comes with the case."""

TWINS = 60
"""Synthetic rebounds of a calibration that a run makes itself, which give the 90 % level to some 5 %."""

ALIKE = 0.2
"""A synthetic rebound is like the file if its number of directions is within this part of the file's (two at least)."""

BLOCK, MAX_BLOCKS = 256, 20
"""Truths drawn at once, and how many times at most until enough rebounds are like the file."""


@dataclass(frozen=True)
class Calibration:
    """Synthetic rebounds like the data: `ratio` (n), EMD of the truth over the smallest; `emd_min` (n); how they were made.

    `directions` (n): how many each gave. `source`: in words, for whom it was made. `confidence`: of the set that is asked for.
    """

    key: str
    seed: int
    ratio: np.ndarray
    emd_min: np.ndarray
    directions: np.ndarray
    source: str
    confidence: float = CONFIDENCE

    def factor(self) -> tuple[float, float, float]:
        """Factor on the smallest EMD whose set holds a further truth with this probability, and its 95 % interval."""
        return holding(self.ratio, self.confidence)

    def unusual(self, emd_min: float) -> bool:
        """Whether so large a smallest EMD speaks against the model, or against the readings.

        That is 3.5 sigma of the logarithm above those of the synthetic rebounds: about one right file in 4,000 is accused.
        """
        log = np.log(self.emd_min)
        return bool(np.log(emd_min) > log.mean() + 3.5 * log.std(ddof=1))

    def __str__(self) -> str:
        value, low, high = self.factor()
        return (
            f"{value:.2f} times the smallest EMD (95 % interval of the calibration: {low:.2f} to {high:.2f}), from "
            f"{len(self.ratio)} synthetic rebounds of known truth like these data, {self.source}; "
            f"{int(self.directions.min())} to {int(self.directions.max())} directions each"
        )


def check_confidence(n: int, confidence: float) -> int:
    """Which of n ordered twins, from 0, sets the threshold of this confidence; refuses what n twins cannot tell."""
    if not 0 < confidence < 1:
        raise InputError("a confidence must lie between 0 and 1", got=confidence)
    at = ceil(confidence * (n + 1)) - 1
    if at >= n:
        got = f"{n} twins, {confidence:g}"
        raise InputError("too few twins for this confidence", got=got, do="ask for more twins")
    return at


def holding(values: np.ndarray, confidence: float) -> tuple[float, float, float]:
    """Threshold below which a further one of the `values` (n) lies with this probability, and its 95 % interval.

    The order statistic ceil(c (n + 1)), which holds it with probability c or a little more for any distribution; the interval is
    that of the quantile (binomial order statistics).
    """
    n, ordered = len(values), np.sort(values)
    at = check_confidence(n, confidence)
    low, high = binom.ppf([0.025, 0.975], n, confidence).astype(int)
    return float(ordered[at]), float(ordered[max(low - 1, 0)]), float(ordered[min(high, n - 1)])


def key_of(rebound: Rebound, table: Table) -> str:
    """The hash of all that a calibration depends on: body, wheels and panels with their sigmas, times of the samples that can be
    read, how many gave directions, noise, brightness, first direction, scan.
    """
    sun, start, vehicle = rebound.samples.attrs, table.rows.start, rebound.case.vehicle
    weights = rebound.case.assumptions.study.target_weights
    axes = start.omega_x, start.omega_y, start.omega_z
    return fingerprint(
        {
            "study": "threshold of a level set, truths even in the scanned box",
            "vehicle": motion_and_panel_parameters(vehicle),
            "panel_sigmas": plain(stated_sigma(vehicle)),
            "times": np.round(rebound.t_s[_readable(rebound)], 3).tolist(),
            "directions": rebound.z.size,
            "noise": float(sun["noise"]),
            "lit_threshold": float(sun["lit_threshold"]),
            "scale": scale(rebound),
            "sun_B": np.round(rebound.sun_B, 4).tolist(),
            "window_s": round(rebound.window_s, 3),
            "lead_s": round(rebound.lead_s, 3),
            "target_weights": None if rebound.weights is None else weights,
            "axes": [np.round(axis, 6).tolist() for axis in axes],
            "mask": plain(direction_mask(rebound.case)),
            "bins": BINS,
            "emd_error": k.EMD_ERROR,
            "alike": ALIKE,
        }
    )


def _readable(rebound: Rebound) -> np.ndarray:
    """Numbers of the samples that can be read."""
    return np.flatnonzero(rebound.samples["status"].values != SunStatus.MISSING)


def scale(rebound: Rebound) -> float:
    """Brightness of the file's Sun: what the readings are over the model, in the median, to three digits."""
    data, samples = rebound.case.telemetry, rebound.samples
    power = signals(data)[np.searchsorted(data["time"].values, samples["utc_s"].values)]
    usable = (samples["status"].values == SunStatus.OK) & np.all(np.isfinite(power), axis=1)
    usable = usable if usable.any() else rebound.reconstructed
    return float(f"{np.median(brightness(rebound.case.vehicle, power[usable])):.3g}")


class Alike(NamedTuple):
    """A synthetic rebound: its true rate (3) in rad/s, measured directions (n, 3), their weights (n) or None."""

    omega_B: np.ndarray
    seen_B: np.ndarray
    weights: np.ndarray | None


def alike_rebounds(rebound: Rebound, twins: int, seed: int) -> list[Alike]:
    """Synthetic rebounds like the data; others if too few are like them."""
    wanted, apart = rebound.z.size, max(2.0, ALIKE * rebound.z.size)
    drawn: list[Alike] = []
    for block in range(MAX_BLOCKS):
        drawn += drawn_rebounds(rebound, np.arange(block * BLOCK, (block + 1) * BLOCK), seed)
        alike = [each for each in drawn if abs(len(each.seen_B) - wanted) <= apart]
        if len(alike) >= twins:
            return alike[:twins]
    return sorted(drawn, key=lambda each: max(abs(len(each.seen_B) - wanted), apart))[:twins]


def drawn_rebounds(rebound: Rebound, index: np.ndarray, seed: int) -> Iterator[Alike]:
    """The synthetic rebounds `index` that can be followed: each draws from its own generators."""
    case, vehicle = rebound.case, rebound.case.vehicle
    motion, panels = (
        [
            np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(i), *stream)))
            for i in index
        ]
        for stream in ((), (1,))
    )
    truth = np.array([rng.uniform(*scan_limits(case).T) for rng in motion])
    shown = np.array([rng.multivariate_normal(rebound.sun_B, rebound.covariance) for rng in motion])
    shown /= np.linalg.norm(shown, axis=1, keepdims=True)
    # turns of the panels (None where the vehicle's file has no sigma of them) and the true direction behind the one that they show
    turned = [drawn_panels(vehicle, sun, rng) for sun, rng in zip(shown, panels, strict=True)]
    turns = [turn for turn, _ in turned if turn is not None]
    states = replace(rebound.states(truth), sun_B=np.array([sun for _, sun in turned]))
    readable = _readable(rebound)
    later = readable[readable > rebound.first]
    run = k.run_rows(vehicle, states, rebound.t_s[later], direction_error=1e-4)  # 1 % of the noise
    tilt = np.array(turns)[:, None] if turns else None
    exact = scale(rebound) * vehicle.response_in().power(run.sun_B, tilt=tilt)
    sigma, threshold = (rebound.samples[name].values for name in ("noise", "lit_threshold"))
    noise = sigma * np.array([rng.standard_normal(exact.shape[1:]) for rng in motion])
    power = np.where(exact > 0, np.maximum(exact + noise, 0.0), 0.0).reshape(-1, exact.shape[-1])
    sun = sun_directions(vehicle, power, noise=sigma, lit_threshold=threshold)
    seen = is_reconstructed(sun["status"]).reshape(exact.shape[:2])
    directions = sun["sun_B"].values.reshape(*exact.shape[:2], 3)
    first = rebound.sun_B[None] / np.linalg.norm(rebound.sun_B)
    for i in np.flatnonzero(run.outcome == k.Outcome.FINE):
        times = rebound.t_s[np.concatenate([[rebound.first], later[seen[i]]])]
        weights = target_weights(case.assumptions.study.target_weights, times)
        yield Alike(truth[i], np.concatenate([first, directions[i, seen[i]]]), weights)


def reached(case: Case, states: k.Rows, window_s: float, targets: list[tuple]) -> np.ndarray:
    """EMD (n) of each motion's r_z, from the measured first direction, to its own target; 1 where it is never seen.

    A target is z components (n) and their weights (n), None where each counts the same.
    """
    mask = direction_mask(case)
    run = k.run_rows(case.vehicle, states, window_s, emd_error=k.EMD_ERROR, mask=mask, bins=BINS)
    pairs = zip(run.hist, targets, strict=True)
    return np.array([distances_to(row[None], target_segments(*target))[0] for row, target in pairs])


def calibrate(rebound: Rebound, table: Table, options: Options) -> Calibration:
    """Repeat the method on `options.twins` synthetic rebounds like the data; `table` of the scan from the same first direction."""
    rebounds = alike_rebounds(rebound, options.twins or TWINS, options.seed)
    targets = [(each.seen_B[:, 2], each.weights) for each in rebounds]
    fine, threads = table.outcome == k.Outcome.FINE, worker_count(options.workers)
    hidden = None if options.progress else True  # None: shown on a terminal only
    shown = tqdm(targets, "calibration of the threshold", leave=False, disable=hidden)
    smallest = np.array([table.distances(*target, threads)[fine].min() for target in shown])
    states = rebound.states(np.array([each.omega_B for each in rebounds]))
    return Calibration(
        key_of(rebound, table),
        options.seed,
        reached(rebound.case, states, rebound.window_s, targets) / smallest,
        smallest,
        np.array([len(each.seen_B) for each in rebounds]),
        "made for these data",
    )


def calibration(rebound: Rebound, table: Table, options: Options) -> Calibration:
    """The calibration that fits these data: the shipped one if its key is theirs, else one made now.

    Twins that are asked for are made even where the shipped calibration fits; `TelemetryError` where none fits and none are.
    """
    path = rebound.case.folder / SHIPPED
    confidence = rebound.case.assumptions.study.confidence
    if not options.twins and path.is_file():
        shipped = read(path)
        if shipped.key == key_of(rebound, table):
            return replace(shipped, confidence=confidence)
    if options.twins == 0:
        raise TelemetryError(
            "the threshold of the set is not calibrated for these data",
            do="run without --calibrate 0: it takes a minute",
        )
    return replace(calibrate(rebound, table, options), confidence=confidence)


def read(path: Path) -> Calibration:
    """What `write` wrote; `InputError` where it is something else."""
    try:
        data = json.loads(path.read_text("utf-8"))
        ratio, emd_min, directions = np.array(
            [data[name] for name in ("ratio", "emd_min", "directions")], dtype=np.float64
        )
        if not np.all(np.isfinite([ratio, emd_min, directions])):
            raise ValueError("lists of finite numbers are needed")
        key, seed = str(data["key"]), int(data["seed"])
    except (ValueError, KeyError, TypeError) as error:
        what = f"this is no calibration of a threshold ({error})"
        raise InputError(what, where=str(path)) from None
    return Calibration(key, seed, ratio, emd_min, directions, "shipped with the case")


def write(calibration: Calibration, path: Path) -> None:
    """Write a calibration that ships with a case, of 400 twins: plain data, six digits."""
    data = {
        "what": "the scan repeated on synthetic rebounds of known truth like the case's telemetry (sunspin.philae.threshold)",
        "synthetic": True,
        "key": calibration.key,
        "seed": calibration.seed,
    }
    for name in ("ratio", "emd_min", "directions"):
        data[name] = [float(f"{x:.6g}") for x in getattr(calibration, name)]
    text = json.dumps(data) + "\n"
    atomic_write.write_whole(path, lambda part: part.write_text(text, "utf-8"))

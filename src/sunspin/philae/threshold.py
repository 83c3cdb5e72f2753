"""Calibrated threshold that makes the level set of a scan a confidence set.

The paper's factor of 1.1 on the smallest EMD was chosen, not derived. Here the method is repeated on simulated rebounds similar to
the telemetry. Their true rates are drawn evenly from the scan range. They have the file's sample times, noise, brightness, first
direction (with its error) and about as many directions, and panels misaligned by the vehicle file's sigmas. The factor below which
the truth lies in nine of ten of them makes the set of the file's own scan a 90 % confidence set.

The factor holds for these data only. A shipped calibration is used only if its key fits the data. The key is the hash of everything
that the calibration depends on.
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
from sunspin.compute.identity import fingerprint, to_json
from sunspin.compute.pool import worker_count
from sunspin.dynamics.batch import EMD_ERROR, Outcome, Rows, run, sun_heights
from sunspin.estimate.scan.directions import target_weights
from sunspin.estimate.scan.histogram import BINS, distances_to_target, target_segments
from sunspin.estimate.scan.volume import Histograms
from sunspin.philae.rebound import (
    Options,
    Rebound,
    direction_mask,
    motion_and_panel_parameters,
    scan_limits,
)
from sunspin.philae.simulation import draw_misaligned_panels
from sunspin.telemetry.signals import signals
from sunspin.telemetry.sun import SunStatus, is_reconstructed, sun_directions
from sunspin.vehicle.response.panels import brightness, misalignment_sigma

CONFIDENCE = 0.9
"""Default probability that a calibrated set contains the truth."""

SHIPPED = "threshold.json"
"""File with the calibration of the case's own telemetry, in the folder of the case."""

SIMULATIONS = 60
"""Number of simulated rebounds of a calibration within a run; they give the 90 % level to some 5 %."""

SIMILAR = 0.2
"""Largest relative difference between the numbers of directions of a similar rebound and of the file (two directions at least)."""

BLOCK, MAX_BLOCKS = 256, 20
"""Number of truths drawn at once, and largest number of such blocks until enough rebounds are similar."""


@dataclass(frozen=True)
class ThresholdCalibration:
    """Results of simulated rebounds similar to the data.

    `key`: hash of everything the calibration depends on. `ratio` (n): EMD of the truth over the smallest EMD. `emd_min` (n):
    smallest EMD. `directions` (n): number of directions. `source`: origin in words. `confidence`: that of the set.
    """

    key: str
    seed: int
    ratio: np.ndarray
    emd_min: np.ndarray
    directions: np.ndarray
    source: str
    confidence: float = CONFIDENCE

    def factor(self) -> Threshold:
        """Return the factor on the smallest EMD whose set contains a further truth with this confidence, and its 95 % interval."""
        return quantile_threshold(self.ratio, self.confidence)

    def unusual(self, emd_min: float) -> bool:
        """Return whether the smallest EMD of the telemetry is so large that model or readings must be wrong.

        The limit is 3.5 sigma of the logarithm above those of the simulated rebounds; one correct file in 4,000 exceeds it.
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


def threshold_index(n: int, confidence: float) -> int:
    """Return the index, among the sorted values of n simulations, of the value that is the threshold of this confidence.

    It is the smallest one below which a further value lies with at least this probability: ceil(confidence (n + 1)), counted from
    1. Raises `InputError` if n simulations are too few for the confidence, or if it does not lie between 0 and 1.
    """
    if not 0 < confidence < 1:
        raise InputError("a confidence must lie between 0 and 1", got=confidence)
    index = ceil(confidence * (n + 1)) - 1
    if index >= n:
        raise InputError(
            "too few simulations for this confidence",
            got=f"{n} simulations, {confidence:g}",
            do="ask for more simulations",
        )
    return index


class Threshold(NamedTuple):
    """Threshold of a confidence level and its 95 % interval."""

    value: float
    low: float
    high: float


def quantile_threshold(values: np.ndarray, confidence: float) -> Threshold:
    """Return the threshold below which a further one of the `values` (n) lies with probability `confidence`.

    It is the order statistic ceil(c (n + 1)), which has this probability or a little more for any distribution. Its interval is
    that of the quantile, from binomial order statistics.
    """
    n, ordered = len(values), np.sort(values)
    index = threshold_index(n, confidence)
    # numbers of values below the true quantile, with probability 2.5 and 97.5 %
    fewest, most = binom.ppf([0.025, 0.975], n, confidence).astype(int)
    low, high = ordered[max(fewest - 1, 0)], ordered[min(most, n - 1)]
    return Threshold(float(ordered[index]), float(low), float(high))


def calibration_key(rebound: Rebound, table: Histograms) -> str:
    """Return the hash of everything that a calibration depends on.

    That is: inertia, wheels and panels with their sigmas, times of the readable samples, number of directions, noise, brightness,
    first direction, scan.
    """
    sun, start, vehicle = rebound.samples.attrs, table.rows.start, rebound.case.vehicle
    weights = rebound.case.assumptions.study.target_weights
    axes = start.omega_x, start.omega_y, start.omega_z
    return fingerprint(
        {
            "study": "threshold of a level set, truths even in the scanned box",
            "vehicle": motion_and_panel_parameters(vehicle),
            "panel_sigmas": to_json(misalignment_sigma(vehicle)),
            "times": np.round(rebound.t_s[_readable(rebound)], 3).tolist(),
            "directions": rebound.z.size,
            "noise": float(sun["noise"]),
            "lit_threshold": float(sun["lit_threshold"]),
            "scale": brightness_scale(rebound),
            "sun_B": np.round(rebound.sun_B, 4).tolist(),
            "window_s": round(rebound.window_s, 3),
            "lead_s": round(rebound.lead_s, 3),
            "target_weights": None if rebound.weights is None else weights,
            "axes": [np.round(axis, 6).tolist() for axis in axes],
            "mask": to_json(direction_mask(rebound.case)),
            "bins": BINS,
            "emd_error": EMD_ERROR,
            "alike": SIMILAR,
        }
    )


def _readable(rebound: Rebound) -> np.ndarray:
    """Return the indices of the samples with readings, whether they give a direction or not."""
    return np.flatnonzero(rebound.samples["status"].values != SunStatus.MISSING)


def brightness_scale(rebound: Rebound) -> float:
    """Return the brightness of the file's Sun: median ratio of the readings to the model, to three digits.

    It is that of the samples with a checked direction and all readings; if there is none, of all that give a direction.
    """
    data, samples = rebound.case.telemetry, rebound.samples
    power = signals(data)[np.searchsorted(data["time"].values, samples["utc_s"].values)]
    usable = (samples["status"].values == SunStatus.OK) & np.all(np.isfinite(power), axis=1)
    if not usable.any():
        usable = rebound.reconstructed
    return float(f"{np.median(brightness(rebound.case.vehicle, power[usable])):.3g}")


class SyntheticRebound(NamedTuple):
    """Simulated rebound: its true rate (3) in rad/s, measured directions (n, 3), their weights (n) or None."""

    omega_B: np.ndarray
    seen_B: np.ndarray
    weights: np.ndarray | None


def simulate_similar_rebounds(rebound: Rebound, count: int, seed: int) -> list[SyntheticRebound]:
    """Return `count` simulated rebounds with about as many directions as the data.

    At most `MAX_BLOCKS` blocks are drawn. If too few of these rebounds are similar, those nearest in number are added.
    """
    tolerance = max(2.0, SIMILAR * rebound.z.size)

    def difference(simulated: SyntheticRebound) -> int:
        """Return the difference between its number of directions and that of the data."""
        return abs(len(simulated.seen_B) - rebound.z.size)

    drawn: list[SyntheticRebound] = []
    for block in range(MAX_BLOCKS):
        drawn += simulate_rebounds(rebound, np.arange(block * BLOCK, (block + 1) * BLOCK), seed)
        similar = [simulated for simulated in drawn if difference(simulated) <= tolerance]
        if len(similar) >= count:
            return similar[:count]
    # the similar ones first, in the order of drawing, then the others by the difference in number
    return sorted(drawn, key=lambda simulated: max(difference(simulated), tolerance))[:count]


def simulate_rebounds(rebound: Rebound, index: np.ndarray, seed: int) -> Iterator[SyntheticRebound]:
    """Yield the simulated rebounds number `index` whose propagation succeeds.

    Each has random generators of its own, so that a rebound does not depend on the others. Its first direction is that of the data;
    the true one differs by a draw of the noise and by the misalignment of the panels.
    """
    case, vehicle = rebound.case, rebound.case.vehicle
    # for each rebound one generator of rates and noise, and one of the panels
    motion_rngs, panel_rngs = (
        [
            np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(i), *stream)))
            for i in index
        ]
        for stream in ((), (1,))
    )
    true_omega_B = np.array([rng.uniform(*scan_limits(case).T) for rng in motion_rngs])
    noiseless_B = np.array(
        [rng.multivariate_normal(rebound.sun_B, rebound.covariance) for rng in motion_rngs]
    )
    noiseless_B /= np.linalg.norm(noiseless_B, axis=1, keepdims=True)
    # rotations of the panels (None without sigmas in the vehicle file), and the true direction that they show as the noiseless one
    misaligned = [
        draw_misaligned_panels(vehicle, sun, rng)
        for sun, rng in zip(noiseless_B, panel_rngs, strict=True)
    ]
    rotations = [rotation for rotation, _ in misaligned if rotation is not None]
    states = replace(rebound.states(true_omega_B), sun_B=np.array([sun for _, sun in misaligned]))
    readable = _readable(rebound)
    later = readable[readable > rebound.first]
    # error of directions: 1 % of the noise
    ensemble = run(vehicle, states, rebound.t_s[later], error=1e-4)
    tilt = np.array(rotations)[:, None] if rotations else None
    # powers (rebound, sample, panel) without and with noise; dark panels read zero, lit ones not less
    exact = brightness_scale(rebound) * vehicle.response_in().power(ensemble.sun_B, tilt=tilt)
    sigma, threshold = (rebound.samples[name].values for name in ("noise", "lit_threshold"))
    noise = sigma * np.array([rng.standard_normal(exact.shape[1:]) for rng in motion_rngs])
    power = np.where(exact > 0, np.maximum(exact + noise, 0.0), 0.0)
    # the estimator takes all samples of all rebounds at once
    samples = power.reshape(-1, power.shape[-1])
    sun = sun_directions(vehicle, samples, noise=sigma, lit_threshold=threshold)
    seen = is_reconstructed(sun["status"]).reshape(exact.shape[:2])
    directions = sun["sun_B"].values.reshape(*exact.shape[:2], 3)
    first = rebound.sun_B[None] / np.linalg.norm(rebound.sun_B)
    for i in np.flatnonzero(ensemble.outcome == Outcome.FINE):
        seen_B = np.concatenate([first, directions[i, seen[i]]])
        times = rebound.t_s[np.concatenate([[rebound.first], later[seen[i]]])]
        weights = target_weights(case.assumptions.study.target_weights, times)
        yield SyntheticRebound(true_omega_B[i], seen_B, weights)


def emd_of_truths(case: Case, states: Rows, window_s: float, targets: list[tuple]) -> np.ndarray:
    """Return the EMD (n) of each simulated rebound at its true rate: between the r_z of that motion and the measured directions.

    `states` have the true rates, and the first direction that the method would take. The measured directions of a rebound, its
    target, are r_z (n_direction) with weights (n_direction), None for equal weights. The EMD is 1 if no direction of the motion is
    in view, as `distances_to_target` returns it.
    """
    mask = direction_mask(case)
    ensemble = sun_heights(
        case.vehicle, states, window_s, counted=mask, emd_error=EMD_ERROR, bins=BINS
    )
    return np.array(
        [
            distances_to_target(histogram[None], target_segments(*target))[0]
            for histogram, target in zip(ensemble.seconds, targets, strict=True)
        ]
    )


def calibrate(rebound: Rebound, table: Histograms, options: Options) -> ThresholdCalibration:
    """Repeat the method on `options.simulations` simulated rebounds similar to the data (default: `SIMULATIONS`).

    `table` is that of the scan from the same first direction.
    """
    rebounds = simulate_similar_rebounds(rebound, options.simulations or SIMULATIONS, options.seed)
    targets = [(simulated.seen_B[:, 2], simulated.weights) for simulated in rebounds]
    propagated, threads = table.outcome == Outcome.FINE, worker_count(options.workers)
    bar_disabled = None if options.progress else True  # None: a bar is shown on a terminal only
    bar = tqdm(targets, "calibration of the threshold", leave=False, disable=bar_disabled)
    smallest = np.array([table.distances(*target, threads)[propagated].min() for target in bar])
    true_states = rebound.states(np.array([simulated.omega_B for simulated in rebounds]))
    return ThresholdCalibration(
        calibration_key(rebound, table),
        options.seed,
        ratio=emd_of_truths(rebound.case, true_states, rebound.window_s, targets) / smallest,
        emd_min=smallest,
        directions=np.array([len(simulated.seen_B) for simulated in rebounds]),
        source="made for these data",
    )


def get_calibration(rebound: Rebound, table: Histograms, options: Options) -> ThresholdCalibration:
    """Return the calibration that fits these data: the shipped one if its key is theirs, else a new one.

    If `options.simulations` is a positive number, a new one is made in any case. Raises `TelemetryError` if it is zero and the
    shipped calibration does not fit.
    """
    path = rebound.case.folder / SHIPPED
    confidence = rebound.case.assumptions.study.confidence
    if not options.simulations and path.is_file():
        shipped = read_calibration(path)
        if shipped.key == calibration_key(rebound, table):
            return replace(shipped, confidence=confidence)
    if options.simulations == 0:
        raise TelemetryError(
            "the threshold of the set is not calibrated for these data",
            do="run without --calibrate 0: it takes a minute",
        )
    return replace(calibrate(rebound, table, options), confidence=confidence)


def read_calibration(path: Path) -> ThresholdCalibration:
    """Read a calibration written by `write_calibration`; raise `InputError` for any other file."""
    try:
        data = json.loads(path.read_text("utf-8"))
        # lists of different lengths make no array and raise a ValueError
        ratio, emd_min, directions = np.array(
            [data[name] for name in ("ratio", "emd_min", "directions")], dtype=np.float64
        )
        if not np.all(np.isfinite([ratio, emd_min, directions])):
            raise ValueError("lists of finite numbers are needed")
        key, seed = str(data["key"]), int(data["seed"])
    except (ValueError, KeyError, TypeError) as error:
        what = f"this is no calibration of a threshold ({error})"
        raise InputError(what, where=str(path)) from None
    return ThresholdCalibration(key, seed, ratio, emd_min, directions, "shipped with the case")


def write_calibration(calibration: ThresholdCalibration, path: Path) -> None:
    """Write a calibration to ship with a case, of 400 simulations: plain data, six digits."""
    data = {
        "what": "the scan repeated on synthetic rebounds of known truth like the case's telemetry (sunspin.philae.threshold)",
        "synthetic": True,
        "key": calibration.key,
        "seed": calibration.seed,
    }
    for name in ("ratio", "emd_min", "directions"):
        data[name] = [float(f"{x:.6g}") for x in getattr(calibration, name)]
    text = json.dumps(data) + "\n"
    atomic_write.write_atomically(path, lambda part: part.write_text(text, "utf-8"))

"""What the posterior compares motions with: readings of a window of telemetry, and other things that were observed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.estimate.terms.reading import Reading
from sunspin.estimate.terms.readings import READINGS
from sunspin.telemetry.assess import Assessment, assess
from sunspin.telemetry.signals import signals
from sunspin.vehicle import Vehicle

FREE_PHASE = "first_rebound"
"""The phase that is taken where a file has several and none is named: of Philae's, the one without a blow and with its wheel."""

MAX_SAMPLES = 600
"""Samples beyond this are thinned evenly: the motion is overdetermined long before, and time is spent on what is not."""

BEYOND_LARGEST = 1.5
"""A reading that has nothing to do with the Sun is anything up to this many times the largest."""

NAMED = 12
"""Phases that are named where none of them was asked for."""


def group(tree: xr.DataTree, name: str) -> xr.Dataset:
    """The variables of one group of a posterior."""
    return tree.children[name].dataset


@dataclass(frozen=True)
class Readings:
    """Readings of K samples of P panels, or of the inputs that panels share.

    `t_s` (K): s after the reference, increasing; `value` (K, P); `used` (K, P): it counts; `lit` (K, P): above the threshold;
    `sigma` (P): one sigma stated; `threshold`; `largest`: reading; `others`: further observations, times after the reference too.
    `throttled`: all readings of a sample are lowered by one factor that nobody knows. `noise_from`: where `sigma` comes from.
    """

    t_s: np.ndarray
    value: np.ndarray
    used: np.ndarray
    lit: np.ndarray
    sigma: np.ndarray
    threshold: float
    largest: float
    others: tuple[Reading, ...] = ()
    throttled: bool = False
    noise_from: str = "given"

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def outlier_density(self) -> float:
        """Of a reading that has nothing to do with the Sun."""
        return 1.0 / (BEYOND_LARGEST * self.largest)

    @property
    def reach_s(self) -> float:
        """The longest time from the reference to a sample."""
        return max(float(np.abs(self.t_s).max()), 1e-6)

    @property
    def weight(self) -> np.ndarray:
        """How much readings (..., K, P) count for the factor of their sample: by their noise, the quietest 1."""
        return self.used * (np.min(self.sigma) / self.sigma) ** 2

    def factor(self, power: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """The factor (..., K, 1) on expected readings (..., K, P) that fits a throttled sample best; else 1."""
        if not self.throttled:
            return np.ones((*power.shape[:-1], 1))
        size = np.sum(weight * power**2, axis=-1, keepdims=True)
        along = np.sum(weight * np.maximum(self.value, 0.0) * power, axis=-1, keepdims=True)
        return np.divide(along, size, out=np.ones_like(size), where=size > 0)

    @property
    def factors(self) -> np.ndarray:
        """Which samples (..., K) have a factor that their readings determine, and so one reading fewer for all else."""
        return np.logical_and(self.throttled, self.lit.any(axis=-1))

    def since(self, sample: int) -> Readings:
        """The same with a sample as the reference."""
        shift = self.t_s[sample]
        others = tuple(replace(o, t_s=o.t_s - shift) for o in self.others)
        return replace(self, t_s=self.t_s - shift, others=others)

    def take(self, index: np.ndarray) -> Readings:
        """Some of the samples, and what else was observed in the time that they span."""
        t = self.t_s[index]
        others = tuple(o for o in self.others if t.min() <= o.t_s <= t.max())
        return replace(
            self,
            t_s=t,
            value=self.value[index],
            used=self.used[index],
            lit=self.lit[index],
            others=others,
        )

    def near(self, half_s: float) -> Readings:
        """The samples within a time of the reference."""
        return self.take(np.flatnonzero(np.abs(self.t_s) <= half_s))

    def without(self, others: bool = False) -> Readings:
        """The same without the other observations."""
        return self if others else replace(self, others=())


def readings(
    vehicle: Vehicle,
    telemetry: xr.Dataset | Assessment,
    begin_s: float | None = None,
    end_s: float | None = None,
    phase: str | None = None,
    observations: Sequence[Mapping[str, Any]] = (),
) -> tuple[Readings, float, list[str]]:
    """The readings in the window, the time (s from the epoch) of the first sample, and remarks on what was done.

    Raises
    ------
    InputError
        Fewer than three samples with a lit panel, an unknown phase or observation, powers of other panels than the vehicle's.
    """
    vehicle.require_panels()
    assessment = assess(vehicle, telemetry)
    telemetry = assessment.telemetry
    value = np.asarray(signals(telemetry), dtype=np.float64)
    if value.ndim != 2 or value.shape[1] != len(vehicle.inputs):
        raise InputError(
            "the telemetry's panels are not the vehicle's", got=f"{value.shape[-1]} columns"
        )
    times = np.asarray(telemetry["time"], dtype=np.float64)
    keep, remarks = _window(telemetry, times, begin_s, end_s, phase)
    measured = assessment.quality["measured"].values
    index = np.flatnonzero(keep & np.isfinite(times) & measured.any(axis=1))
    remarks += _left_out(assessment.quality, np.isfinite(value), keep)
    remarks += [assessment.repeats.doubt] if assessment.repeats.unsure[index].any() else []
    if len(index) > MAX_SAMPLES:
        remarks.append(f"{len(index)} samples were thinned to {MAX_SAMPLES}")
        index = index[np.unique(np.linspace(0, len(index) - 1, MAX_SAMPLES).round().astype(int))]
    threshold = float(vehicle.telemetry.lit_threshold or 0.0)
    value, used = np.where(measured, value, 0.0)[index], measured[index]
    lit = used & (value > threshold)
    if np.count_nonzero(lit.any(axis=1)) < 3:
        raise InputError(
            "a motion needs three samples with a lit panel",
            got=f"{np.count_nonzero(lit.any(axis=1))} in the window",
            do="widen the window; `sunspin check` says what is wrong with samples",
        )
    largest = float(value[used].max())
    sigma, noise_from = assessment.noise
    start = float(times[index[0]])
    others = tuple(_observation(o, start, float(times[index[-1]])) for o in observations)
    made = Readings(
        times[index] - start,
        value,
        used,
        lit,
        sigma,
        threshold,
        largest,
        others,
        vehicle.throttled,
        noise_from,
    )
    return made, start, remarks


def _left_out(quality: xr.Dataset, number: np.ndarray, keep: np.ndarray) -> list[str]:
    """Return remarks on samples `keep` (n) and readings (n, n_panel), all of them `number`, that are left out, with the reasons."""
    measured, why = quality["measured"].values, quality["why"].values
    whole = keep & ~measured.any(axis=1)
    part = keep & ~whole & (number & ~measured & ~quality["missed"].values).any(axis=1)
    reasons = Counter(str(text) for text in why[whole | part] if not text.startswith("used"))
    return [
        f"left out in {count} sample{'s' * (count > 1)}: {text.partition(': ')[2]}"
        for text, count in reasons.most_common()
    ]


def _window(
    telemetry: xr.Dataset,
    times: np.ndarray,
    begin_s: float | None,
    end_s: float | None,
    phase: str | None,
) -> tuple[np.ndarray, list[str]]:
    keep = np.ones(len(times), dtype=bool)
    remarks = []
    phases = (
        np.asarray(telemetry["phase"]).astype(str)
        if "phase" in telemetry.coords
        else np.array([], dtype=str)
    )
    names = list(dict.fromkeys(phases.tolist()))
    if phase is None and begin_s is None and end_s is None and len(names) > 1:
        if FREE_PHASE not in names:
            raise InputError(
                "the telemetry has several phases, which are not one motion",
                got=", ".join(names),
                do="name one, or give begin and end",
            )
        phase = FREE_PHASE
        remarks.append(f"of the phases in the file only {phase} was used")
    if phase is not None:
        if phase not in names:
            there = f"it has {', '.join(names[:NAMED])}" if names else "it names none"
            raise InputError("the telemetry has no such phase", got=phase, do=there)
        keep &= phases == phase
    keep &= (times >= (-np.inf if begin_s is None else begin_s)) & (
        times <= (np.inf if end_s is None else end_s)
    )
    return keep, remarks


def _observation(given: Mapping[str, Any], start: float, end: float) -> Reading:
    kind = READINGS.get(str(given.get("kind")))
    if kind is None or set(kind.keys) != set(given):
        more = "a field also angle_rad, the Sun's from it"
        raise InputError(
            f"an observation has kind ({', '.join(READINGS)}), t_s, value and sigma, {more}",
            got=str(dict(given)),
        )
    value, t = kind.checked(given), float(given["t_s"])
    if not start <= t <= end:
        raise InputError(
            "an observation lies outside the window",
            got=f"t_s {t:g}",
            do=f"from {start:g} to {end:g}",
        )
    return kind.of(given, value, t - start)

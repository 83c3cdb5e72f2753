"""What a telemetry file can carry: whether one Sun explains its readings, and whether the order of its samples holds a motion.

Three looks, each with what the paper has on it. Readings: the misfit Delta and lit patterns that geometry forbids. The descent:
E of its best spin against the best spins of the same directions in random order. The rebound: its EMD does not use the order of
the samples at all, so no order of them can raise or lower it; only the posterior uses it.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.cases import Case
from sunspin.estimate.spin import fit_spin
from sunspin.philae.descent import Descent
from sunspin.philae.rebound import event_seconds, select_rebound
from sunspin.philae.row import Row, row
from sunspin.philae.sun_directions import whole_panels
from sunspin.telemetry.sun import SunStatus, is_reconstructed
from sunspin.telemetry.synthetic import drawn_tilts, generator
from sunspin.vehicle.response.panels import patterns_of_turned, stated_sigma

LEAST_DIRECTIONS = 8
"""Nobody would fit a rebound with fewer."""

MOST_IMPOSSIBLE = 0.02
"""Share of samples before the second touchdown whose lit pattern no Sun makes: the paper has none of them."""

SHUFFLES = 20
"""Random orders of the descent's directions that are fitted."""

ORDERED = 0.5
"""The descent's E must be below this part of the smallest among the shuffled ones: right files reach a twentieth."""


class DataCheck(NamedTuple):
    """What the file was seen to carry.

    `delta`: mean Delta of the `directions` outside the shadowed phases. `impossible` of the `early` samples, those before the
    second touchdown, have a lit pattern forbidden to panels as drawn; `unexplained` of them also to panels that stand off as the
    vehicle file's sigmas say. `descent_E`: E of the descent's best spin; `shuffled_E`: of the best spins of `SHUFFLES` orders of
    its directions; None and empty where the descent could not be fitted. `neighbours_rad`: mean angle between successive
    directions of the rebound; `chance`: share of random orders in which it is as small or smaller; NaN with fewer than three
    directions. `reasons`: why nothing can be concluded from the readings; empty where one Sun explains them.
    """

    case: Case
    delta: float
    directions: int
    impossible: int
    unexplained: int
    early: int
    descent_E: float | None
    shuffled_E: np.ndarray
    neighbours_rad: float
    chance: float
    reasons: tuple[str, ...]

    @property
    def one_sun(self) -> bool:
        """Whether the readings are those of the stated panels under one Sun."""
        return not self.reasons

    @property
    def descent_order(self) -> bool:
        """Whether the order of the descent's samples holds a spin."""
        return self.descent_E is not None and bool(self.descent_E < ORDERED * self.shuffled_E.min())

    @property
    def first_line(self) -> str:
        """The first line of a study: what the file can carry."""
        mean = f"mean Delta {self.delta:.4f} over" if self.directions else "no Delta, from"
        readings = (
            f"{mean} {self.directions} directions (paper {self.case.published['delta_mean'].value}), {self.impossible} of "
            f"{self.early} samples before the second touchdown with an impossible illumination pattern (paper: none)"
        )
        text = f"Panel data consistent with sunlight: {readings}."
        if not self.one_sun:
            text = f"PANEL DATA NOT CONSISTENT WITH SUNLIGHT: {readings}; no conclusions are drawn."
        text += " Descent: no spin could be fitted." * (self.descent_E is None)
        if (E := self.descent_E) is not None:
            best, orders = self.shuffled_E.min(), f"of {len(self.shuffled_E)} random orders"
            text += (
                f" Descent: a steady spin fits the time order, E {E:.5f}, the best {orders} {best:.3f}."
                if self.descent_order
                else f" DESCENT: NO SPIN DETECTED, E {E:.4f}, the best {orders} {best:.4f}."
            )
        return f"{text} Rebound: the EMD compares distributions of r_z and ignores the order; only --candidates posterior uses it."


def compute(case: Case, sun: xr.Dataset, descent: Descent | None, seed: int = 0) -> DataCheck:
    """Look at the Sun directions of the whole landing (`sun_directions`) and at the descent's fit, if there is one."""
    vehicle, status, limit = case.vehicle, sun["status"].values, case.published["delta_max"].value
    kept = is_reconstructed(status) & whole_panels(case, sun)
    delta = float(sun["delta"].values[kept].mean()) if kept.any() else float("nan")
    end = event_seconds(case, sun, "second_touchdown")
    early = (sun["time"].values < end) & (status != SunStatus.MISSING)
    forbidden = sun.isel(time=early & (status == SunStatus.IMPOSSIBLE))
    unexplained = np.ones(forbidden.sizes["time"], dtype=bool)
    # one turn of all panels forbids and allows nothing: it is a turn of the Sun
    tilt_rad, _ = stated_sigma(vehicle)
    if unexplained.size and tilt_rad.any():
        draws, names = generator(0, 10), np.array(vehicle.input_names)
        tilts = np.array([drawn_tilts(vehicle, tilt_rad, draws) for _ in range(100)])
        shown = patterns_of_turned(vehicle, tilts)
        patterns = [frozenset(names[lit].tolist()) for lit in forbidden["lit"].values]
        unexplained = np.array([pattern not in shown for pattern in patterns])
        unexplained |= forbidden["delta"].values > limit

    rng, descent_E, shuffled_E = generator(seed, 9), None, []
    if descent is not None:
        t, n = descent.sun["time"].values, descent.sun["sun_B"].values
        descent_E, known = descent.fit.E, np.flatnonzero(np.isfinite(n[:, 0]))
        for _ in range(SHUFFLES):
            mixed = n.copy()
            mixed[known] = n[rng.permutation(known)]
            # E is then good to 1e-5 of itself, in half the time that 1e-12 takes or less
            shuffled_E.append(fit_spin(t, mixed, tolerance=1e-6).E)

    rebound = select_rebound(case, sun)
    n = rebound["sun_B"].values[is_reconstructed(rebound["status"])]
    near = chance = float("nan")
    if len(n) >= 3:
        orders = [np.arange(len(n)), *(rng.permutation(len(n)) for _ in range(200))]
        cosine = [np.einsum("ni,ni->n", n[order[1:]], n[order[:-1]]) for order in orders]
        angle = np.arccos(np.clip(cosine, -1, 1)).mean(axis=1)
        near, chance = float(angle[0]), float(np.mean(angle[1:] <= angle[0]))

    reasons, samples, missed = [], int(early.sum()), int(unexplained.sum())
    if delta > limit:
        largest = f"{limit}, the paper's largest of a single sample"
        reasons.append(f"the mean Delta of {delta:.3f} exceeds {largest}")
    if missed > MOST_IMPOSSIBLE * samples:
        text = f"{missed} of {samples} samples before the second touchdown have a lit pattern that no Sun makes"
        reasons.append(text)
    if len(n) < LEAST_DIRECTIONS:
        text = f"only {len(n)} samples between first touchdown and collision give a direction"
        reasons.append(text)
    readings = delta, int(kept.sum()), unexplained.size, missed
    order = descent_E, np.array(shuffled_E), near, chance
    return DataCheck(case, *readings, samples, *order, tuple(reasons))


def rows(c: DataCheck) -> list[Row]:
    """What the file carries, as rows: none is a test of the method, so none agrees or differs."""
    row_of, paper = partial(row, c.case, check=c), c.case.published
    share, most = c.impossible / max(c.early, 1), MOST_IMPOSSIBLE
    holds = c.unexplained <= most * c.early
    result = [row_of("carries_patterns", share, tolerance=most, holds=holds)]
    mean, holds = paper["delta_mean"].value, bool(c.delta <= paper["delta_max"].value)
    result.append(row_of("carries_delta", c.delta, published=mean, holds=holds))
    if c.descent_E is not None:
        E: dict[str, Any] = {
            "orders": c.shuffled_E.size,
            "least": c.shuffled_E.min(),
            "most": c.shuffled_E.max(),
        }
        E |= {"tolerance": ORDERED, "holds": c.descent_order}
        result.append(row_of("carries_descent_order", c.descent_E / float(E["least"]), **E))
    angle = np.degrees(c.neighbours_rad)
    return [*result, row_of("carries_rebound_order", c.chance, neighbours=angle)]

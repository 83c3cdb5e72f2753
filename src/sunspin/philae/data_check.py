"""Data check before the study: are the readings consistent with sunlight, and does the order of the samples contain a rotation?

Three checks are made, each next to what the paper states. Readings: the misfit Delta, and lit patterns that the geometry forbids.
Descent: E of its best spin, compared with the best spins of the same directions in random order. Rebound: the EMD of r_z does not
depend on the order of the samples, so it cannot be checked; only the posterior uses the order.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.cases import Case
from sunspin.philae.descent import Descent
from sunspin.philae.rebound import event_seconds, select_rebound
from sunspin.philae.row import Row, make_row
from sunspin.philae.spin import fit_spin
from sunspin.philae.sun_directions import unshadowed_samples
from sunspin.telemetry.sun import SunStatus, is_reconstructed
from sunspin.telemetry.synthetic import draw_tilts, generator
from sunspin.vehicle.response.panels import misalignment_sigma, patterns_of_misaligned

LEAST_DIRECTIONS = 8
"""Least number of directions of the rebound from which anything is concluded."""

MOST_IMPOSSIBLE = 0.02
"""Largest share of impossible lit patterns among the samples before the second touchdown. The paper has no such sample."""

SHUFFLES = 20
"""Number of random orders of the descent's directions that are fitted."""

ORDERED = 0.5
"""Largest ratio of the descent's E to the smallest E of the random orders for a detected spin. For correct files it is 0.05."""


class DataCheck(NamedTuple):
    """Result of the data check.

    `delta` is the mean Delta of the `directions` outside the shadowed phases. Of the `early` samples (before the second touchdown)
    `impossible` have a lit pattern that panels as drawn cannot show, and `unexplained` one that misaligned panels cannot show
    either.

    `descent_E` is E of the descent's best spin, `shuffled_E` that of the best spins of `SHUFFLES` random orders. They are None and
    empty if the descent could not be fitted. `neighbour_angle_rad` is the mean angle between successive directions of the rebound.
    `order_p_value` is the share of random orders in which that angle is as small or smaller. Both are NaN with fewer than three
    directions.

    `reasons` says why nothing can be concluded from the readings; empty if they are consistent with sunlight.
    """

    case: Case
    delta: float
    directions: int
    impossible: int
    unexplained: int
    early: int
    descent_E: float | None
    shuffled_E: np.ndarray
    neighbour_angle_rad: float
    order_p_value: float
    reasons: tuple[str, ...]

    @property
    def consistent_with_sun(self) -> bool:
        """True if one Sun on the stated panels explains the readings."""
        return not self.reasons

    @property
    def descent_has_spin(self) -> bool:
        """True if the order of the descent's samples contains a spin."""
        return self.descent_E is not None and bool(self.descent_E < ORDERED * self.shuffled_E.min())

    @property
    def first_line(self) -> str:
        """First line of a study: the result of the data check in words."""
        mean = f"mean Delta {self.delta:.4f} over" if self.directions else "no Delta, from"
        readings = (
            f"{mean} {self.directions} directions (paper {self.case.published['delta_mean'].value}), {self.impossible} of "
            f"{self.early} samples before the second touchdown with an impossible illumination pattern (paper: none)"
        )
        text = f"Panel data consistent with sunlight: {readings}."
        if not self.consistent_with_sun:
            text = f"PANEL DATA NOT CONSISTENT WITH SUNLIGHT: {readings}; no conclusions are drawn."
        text += " Descent: no spin could be fitted." * (self.descent_E is None)
        if (E := self.descent_E) is not None:
            best, orders = self.shuffled_E.min(), f"of {len(self.shuffled_E)} random orders"
            text += (
                f" Descent: a steady spin fits the time order, E {E:.5f}, the best {orders} {best:.3f}."
                if self.descent_has_spin
                else f" DESCENT: NO SPIN DETECTED, E {E:.4f}, the best {orders} {best:.4f}."
            )
        return f"{text} Rebound: the EMD compares distributions of r_z and ignores the order; only the posterior uses it."


def compute(case: Case, sun: xr.Dataset, descent: Descent | None, seed: int = 0) -> DataCheck:
    """Check the Sun directions of the whole landing (of `sun_directions`) and the fit of the descent, if there is one.

    `seed` is that of the random orders of the samples.
    """
    vehicle, status = case.vehicle, sun["status"].values
    delta_limit = case.published["delta_max"].value
    kept = is_reconstructed(status) & unshadowed_samples(case, sun)
    delta = float(sun["delta"].values[kept].mean()) if kept.any() else float("nan")
    end = event_seconds(case, sun, "second_touchdown")
    early = (sun["time"].values < end) & (status != SunStatus.MISSING)
    forbidden = sun.isel(time=early & (status == SunStatus.IMPOSSIBLE))
    unexplained = np.ones(forbidden.sizes["time"], dtype=bool)
    # which of the forbidden patterns could panels show that are misaligned as the vehicle file's sigmas say? A common rotation of
    # all panels is left out: it is equivalent to a rotation of the Sun, and neither forbids nor allows a pattern
    tilt_rad, _ = misalignment_sigma(vehicle)
    if unexplained.size and tilt_rad.any():
        rng, names = generator(0, 10), np.array(vehicle.input_names)
        tilts = np.array([draw_tilts(vehicle, tilt_rad, rng) for _ in range(100)])
        observable = patterns_of_misaligned(vehicle, tilts)
        patterns = [frozenset(names[lit].tolist()) for lit in forbidden["lit"].values]
        unexplained = np.array([pattern not in observable for pattern in patterns])
        # misalignment explains a pattern, but not a misfit larger than any in the paper
        unexplained |= forbidden["delta"].values > delta_limit

    rng, descent_E, shuffled_E = generator(seed, 9), None, []
    if descent is not None:
        t, sun_B = descent.sun["time"].values, descent.sun["sun_B"].values
        descent_E, measured = descent.fit.E, np.flatnonzero(np.isfinite(sun_B[:, 0]))
        for _ in range(SHUFFLES):
            # samples without a direction keep their place
            shuffled = sun_B.copy()
            shuffled[measured] = sun_B[rng.permutation(measured)]
            # this tolerance gives E to 1e-5 of itself, in half the time of 1e-12 or less
            shuffled_E.append(fit_spin(t, shuffled, tolerance=1e-6).E)

    rebound = select_rebound(case, sun)
    sun_B = rebound["sun_B"].values[is_reconstructed(rebound["status"])]
    neighbour_angle = order_p_value = float("nan")
    if len(sun_B) >= 3:
        # the measured order first, then random ones
        orders = [np.arange(len(sun_B)), *(rng.permutation(len(sun_B)) for _ in range(200))]
        cosine = [np.einsum("ni,ni->n", sun_B[order[1:]], sun_B[order[:-1]]) for order in orders]
        mean_angle = np.arccos(np.clip(cosine, -1, 1)).mean(axis=1)
        neighbour_angle = float(mean_angle[0])
        order_p_value = float(np.mean(mean_angle[1:] <= mean_angle[0]))

    reasons, samples, n_unexplained = [], int(early.sum()), int(unexplained.sum())
    if delta > delta_limit:
        largest = f"{delta_limit}, the paper's largest of a single sample"
        reasons.append(f"the mean Delta of {delta:.3f} exceeds {largest}")
    if n_unexplained > MOST_IMPOSSIBLE * samples:
        text = f"{n_unexplained} of {samples} samples before the second touchdown have a lit pattern that no Sun makes"
        reasons.append(text)
    if len(sun_B) < LEAST_DIRECTIONS:
        text = f"only {len(sun_B)} samples between first touchdown and collision give a direction"
        reasons.append(text)
    return DataCheck(
        case,
        delta=delta,
        directions=int(kept.sum()),
        impossible=unexplained.size,
        unexplained=n_unexplained,
        early=samples,
        descent_E=descent_E,
        shuffled_E=np.array(shuffled_E),
        neighbour_angle_rad=neighbour_angle,
        order_p_value=order_p_value,
        reasons=tuple(reasons),
    )


def rows(check: DataCheck) -> list[Row]:
    """Return the data check as rows. None is a test of the method, so none agrees or differs."""
    paper = check.case.published
    notes = {
        "carries_patterns": f"{check.impossible} of {check.early}, {check.unexplained} of them beyond the stated misalignment of "
        f"the panels; limit {MOST_IMPOSSIBLE:.0%}",
        "carries_delta": f"{check.directions} directions; limit {paper['delta_max'].value}, the paper's largest of a single sample",
        "carries_rebound_order": f"{np.degrees(check.neighbour_angle_rad):.0f} degrees on average between successive directions, "
        "which need not be near; EMD does not use their order",
    }
    row_of = partial(make_row, check.case, notes=notes)
    good_delta = bool(check.delta <= paper["delta_max"].value)
    result = [
        row_of(
            "carries_patterns",
            check.impossible / max(check.early, 1),
            tolerance=MOST_IMPOSSIBLE,
            holds=check.unexplained <= MOST_IMPOSSIBLE * check.early,
        ),
        row_of("carries_delta", check.delta, published=paper["delta_mean"].value, holds=good_delta),
    ]
    if check.descent_E is not None:
        least = float(check.shuffled_E.min())
        most = check.shuffled_E.max()
        orders = f"{check.shuffled_E.size} random orders {least:.4f} to {most:.4f}"
        given: dict[str, Any] = {"tolerance": ORDERED, "holds": check.descent_has_spin}
        given["note"] = f"E {check.descent_E:.5f}; {orders}; criterion: below {ORDERED:g}"
        result.append(row_of("carries_descent_order", check.descent_E / least, **given))
    return [*result, row_of("carries_rebound_order", check.order_p_value)]

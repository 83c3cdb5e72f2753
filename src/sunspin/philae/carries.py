"""What a telemetry file can carry: whether one Sun explains its readings, and whether the order of its samples holds a motion.

Three looks, each with what the paper has beside it. Readings: the misfit Delta and lit patterns that geometry forbids. The descent:
E of its best spin against the best spins of the same directions in random order. The rebound: its EMD does not use the order of
the samples at all, so no order of them can raise or lower it; only the posterior uses it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from sunspin.estimate.spin import fit_spin
from sunspin.philae import rebound as rb
from sunspin.philae.descent import Descent
from sunspin.philae.row import Row, row
from sunspin.telemetry.case import Case
from sunspin.telemetry.sun import SunStatus, is_reconstructed
from sunspin.telemetry.synthetic import drawn_tilts, generator
from sunspin.vehicle.response.panels import patterns_of_turned, stated_sigma
from sunspin.vehicle.timeline import utc_seconds

SHADOWED_PHASES = ("deployment", "settling", "rest")
"""Phases in which parts of the lander or the ground shadow the panels: the paper leaves them out of its statistics of Delta."""

LEAST_DIRECTIONS = 8
"""Nobody would fit a rebound with fewer."""

MOST_IMPOSSIBLE = 0.02
"""Share of samples before the second touchdown whose lit pattern no Sun makes: the paper has none of them."""

TURNS = 100
"""Draws of panels that stand off as the vehicle file's sigmas say: a pattern that none of them shows, no Sun makes on such."""

SHUFFLES, SHUFFLED_TOLERANCE = 20, 1e-6
"""Orders tried, each fitted to this: E is then good to 1e-5 of itself, in half the time that 1e-12 takes or less."""

NEIGHBOUR_SHUFFLES = 200
ORDERED = 0.5
"""The descent's E must be below this part of the smallest among the shuffled ones: right files reach a twentieth."""


@dataclass(frozen=True)
class Carries:
    """What the file was found to carry.

    Attributes
    ----------
    delta : mean Delta of the directions outside `SHADOWED_PHASES`; `directions`, how many there are
    impossible, early : samples before the second touchdown with a lit pattern forbidden to panels as drawn, and all of them
    unexplained : of the former, those that panels which stand off as the vehicle file's sigmas say do not show either
    told : directions between first touchdown and collision
    descent_E, shuffled_E : E of the descent's best spin, and of the best spins of `SHUFFLES` orders of its directions; None and
        empty where the descent could not be fitted
    neighbours_rad, chance : mean angle between successive directions of the rebound, and the share of random orders in which it
        is as small or smaller; NaN with fewer than three directions
    reasons : why nothing can be concluded from the readings; empty where one Sun explains them
    """

    case: Case
    synthetic: bool
    delta: float
    directions: int
    impossible: int
    unexplained: int
    early: int
    told: int
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
        return self.descent_E is not None and self.descent_E < ORDERED * float(
            self.shuffled_E.min()
        )

    @property
    def first_line(self) -> str:
        """The first line of a study: what the file can carry."""
        return " ".join((self._readings(), self._descent(), self._rebound()))

    def _readings(self) -> str:
        published = self.case.published
        mean = f"mean Delta {self.delta:.4f} over" if self.directions else "no Delta, from"
        found = (
            f"{mean} {self.directions} directions (paper {published['delta_mean'].value}), "
            f"{self.impossible} of {self.early} samples before the second touchdown with a lit pattern that no Sun makes "
            "(paper: none)"
        )
        if self.one_sun:
            return f"The readings are those of one Sun on these panels: {found}."
        return f"THE READINGS ARE NOT THOSE OF ONE SUN ON THESE PANELS: {found}; nothing is concluded from them."

    def _descent(self) -> str:
        if self.descent_E is None:
            return "The descent: no spin could be fitted."
        best = float(self.shuffled_E.min())
        if self.descent_order:
            return (
                f"The descent's order of samples holds a spin: E {self.descent_E:.5f}, the best of {len(self.shuffled_E)} random "
                f"orders {best:.3f}."
            )
        return (
            f"THE DESCENT'S ORDER OF SAMPLES HOLDS NO SPIN: E {self.descent_E:.4f}, the best of {len(self.shuffled_E)} random "
            f"orders {best:.4f}."
        )

    def _rebound(self) -> str:
        return (
            "The rebound: its EMD uses the heights of the Sun and not their order, so what follows from the scan holds for any "
            "order of these samples; only --candidates posterior uses the order."
        )


def whole_panels(case: Case, data: xr.Dataset) -> np.ndarray:
    """Which samples (n) lie outside the phases in which something shadows the panels, by the case's timeline."""
    timeline = case.require_timeline()
    shift = utc_seconds(timeline.epoch_utc, data.attrs["epoch_utc"])
    time, whole = data["time"].values - shift, np.ones(data.sizes["time"], dtype=bool)
    for phase in timeline.phases:
        if phase.name in SHADOWED_PHASES:
            whole &= ~((time >= phase.begin_s) & (time < phase.end_s))
    return whole


def compute(case: Case, sun: xr.Dataset, descent: Descent | None, seed: int = 0) -> Carries:
    """Look at the Sun directions of the whole landing (`sun_directions`) and at the descent's fit, if there is one."""
    status = sun["status"].values
    kept = is_reconstructed(status) & whole_panels(case, sun)
    early = (sun["time"].values < rb.case_seconds(case, sun, "second_touchdown")) & (
        status != SunStatus.MISSING
    )
    forbidden = sun.isel(time=early & (status == SunStatus.IMPOSSIBLE))
    samples = rb.rebound_samples(case, sun)
    told = is_reconstructed(samples["status"])
    delta = float(sun["delta"].values[kept].mean()) if kept.any() else float("nan")
    rng = generator(seed, 9)
    limit = case.published["delta_max"].value
    unexplained = int(
        np.count_nonzero(
            (forbidden["delta"].values > limit) | ~_turned_show(case, forbidden["lit"].values)
        )
    )
    error, shuffled = (None, np.zeros(0)) if descent is None else _descent_order(descent, rng)
    near, chance = _neighbours(samples["sun_B"].values[told], rng)
    reasons = []
    if delta > limit:
        reasons.append(
            f"the mean Delta of {delta:.3f} exceeds {limit}, the paper's largest of a single sample"
        )
    if unexplained > MOST_IMPOSSIBLE * int(early.sum()):
        reasons.append(
            f"{unexplained} of {int(early.sum())} samples before the second touchdown have a lit pattern that no "
            "Sun makes"
        )
    if told.sum() < LEAST_DIRECTIONS:
        reasons.append(
            f"only {int(told.sum())} samples between first touchdown and collision give a direction"
        )
    return Carries(
        case,
        bool(sun.attrs.get("synthetic")),
        delta,
        int(kept.sum()),
        forbidden.sizes["time"],
        unexplained,
        int(early.sum()),
        int(told.sum()),
        error,
        shuffled,
        near,
        chance,
        tuple(reasons),
    )


def _turned_show(case: Case, lit: np.ndarray) -> np.ndarray:
    """Which of the sets of lit panels (n, n_panel) some Sun makes on panels turned as far as the vehicle file's sigmas let them be.

    One turn of all panels forbids and allows nothing: it is a turn of the Sun.
    """
    own, _ = stated_sigma(case.vehicle)
    if not len(lit) or not own.any():
        return np.zeros(len(lit), dtype=bool)
    rng, names = generator(0, 10), np.array(case.vehicle.input_names)
    shown = patterns_of_turned(
        case.vehicle, np.array([drawn_tilts(case.vehicle, own, rng) for _ in range(TURNS)])
    )
    return np.array([frozenset(names[row].tolist()) in shown for row in lit])


def _descent_order(descent: Descent, rng: np.random.Generator) -> tuple[float, np.ndarray]:
    t, n = descent.sun["time"].values, descent.sun["sun_B"].values
    known, shuffled = np.flatnonzero(np.isfinite(n[:, 0])), []
    for _ in range(SHUFFLES):
        mixed = n.copy()
        mixed[known] = n[rng.permutation(known)]
        shuffled.append(fit_spin(t, mixed, tolerance=SHUFFLED_TOLERANCE).E)
    return descent.fit.E, np.array(shuffled)


def _neighbours(directions: np.ndarray, rng: np.random.Generator) -> tuple[float, float]:
    if len(directions) < 3:
        return float("nan"), float("nan")

    def mean_angle(order: np.ndarray) -> float:
        cosine = np.einsum("ni,ni->n", directions[order[1:]], directions[order[:-1]])
        return float(np.arccos(np.clip(cosine, -1, 1)).mean())

    own = mean_angle(np.arange(len(directions)))
    others = np.array(
        [mean_angle(rng.permutation(len(directions))) for _ in range(NEIGHBOUR_SHUFFLES)]
    )
    return own, float(np.mean(others <= own))


def rows(r: Carries) -> list[Row]:
    """What the file carries, as rows: none is a test of the method, so none agrees or differs."""
    case, whose = r.case, "synthetic telemetry" if r.synthetic else "this telemetry"
    misfit, largest = case.published["delta_mean"].value, case.published["delta_max"].value
    found = [
        row(
            case,
            "carries_patterns",
            r.impossible / max(r.early, 1),
            tolerance=MOST_IMPOSSIBLE,
            holds=r.unexplained <= MOST_IMPOSSIBLE * r.early,
            whose=whose,
            impossible=r.impossible,
            early=r.early,
            unexplained=r.unexplained,
        ),
        row(
            case,
            "carries_delta",
            r.delta,
            published=misfit,
            holds=bool(r.delta <= largest),
            whose=whose,
            directions=r.directions,
        ),
    ]
    if r.descent_E is not None:
        least, most = r.shuffled_E.min(), r.shuffled_E.max()
        found.append(
            row(
                case,
                "carries_descent_order",
                r.descent_E / float(least),
                tolerance=ORDERED,
                holds=r.descent_order,
                whose=whose,
                best=r.descent_E,
                orders=len(r.shuffled_E),
                least=least,
                most=most,
            )
        )
    return [
        *found,
        row(
            case,
            "carries_rebound_order",
            r.chance,
            whose=whose,
            neighbours=np.degrees(r.neighbours_rad),
        ),
    ]

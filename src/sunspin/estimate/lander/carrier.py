"""The search for motions of a lander: trial motions are fitted to a window of samples, compared, and carried to a wider window."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from sunspin.compute.pool import worker_count
from sunspin.estimate.lander.allowed import shortfall
from sunspin.estimate.lander.families import (
    distinct_fits,
    one_each_box,
    one_each_ridge,
    with_neighbours,
)
from sunspin.estimate.lander.fit import (
    FINAL_ERROR,
    FitProblem,
    fit_finally,
    fit_window,
    in_pieces,
)
from sunspin.estimate.lander.grid import Reference, cell_count
from sunspin.estimate.lander.model import ALL_SIZES, LanderModel, Sizes
from sunspin.estimate.lander.motions import LanderMotions, ModelFit
from sunspin.estimate.lander.rate_grid import TRIAL_ERROR
from sunspin.estimate.search import grown
from sunspin.estimate.settings import PosteriorSettings
from sunspin.estimate.terms.powers import TILT

MORE = "more trial solutions than the search can follow"

RUNS_AT_ONCE = 8192
"""Motions that are run together to compare them with one sample."""

FIT_S, START_S = 0.005, 1e-5
"""Seconds of one core for the fit of a motion to five samples and the stages after it, and for the starts in a cell of the grid of
rates with one direction. Measured on Philae."""

LONG_S = 60.0
"""A stage that takes longer than this is announced before it begins."""


class Stage(NamedTuple):
    """A window of a search: its number of `samples`, of motions `fitted` to it, and of those `kept`."""

    samples: int
    fitted: int
    kept: int


class Shooting:
    """Steps of a search for motions that are given by one state at the reference (:class:`sunspin.estimate.search.Carrier`).

    `notes`: remarks on the search for the verdict; `complete`: every motion that may fit was followed.
    """

    def __init__(
        self,
        model: LanderModel,
        reference: Reference,
        s: PosteriorSettings,
        workers: int | None = None,
        torque_size: int | None = None,
    ) -> None:
        """Begin a search under a model that counts time from `reference`.

        The inertia has its stated sigma. Under a larger one a few samples would fit bodies far from it, and the true motion would
        count as a copy of theirs. `torque_size`: index of the sigma of a constant torque, if one acts.
        """
        self.model, self.reference = model, reference
        self.sizes: Sizes = {"inertia": 0}
        if torque_size is not None:
            self.sizes = {"inertia": 0, "steady_torque": torque_size}
        self.s, self.growth, self.workers = s.shooting, s.search.growth, worker_count(workers)
        self.settings = s
        self.t_s = model.obs.t_s
        self.notes: list[str] = list(reference.notes)
        self.complete = not reference.notes
        self.fitted = 0  # motions times samples
        self.trace: list[Stage] = []
        self._last_fitted = 0

    def of(self, model: LanderModel) -> Shooting:
        """Return the same for a model of the same readings under a constant torque."""
        return Shooting(model, self.reference, self.settings, self.workers, self.s.searched_under)

    def _note(self, text: str, complete: bool) -> None:
        """Add a remark for the verdict, unless it has been added before."""
        self.complete &= complete
        if text not in self.notes:
            self.notes.append(text)

    # ---- the search --------------------------------------------------------------------------------------------------------

    def fit(self, motions: LanderMotions, window: slice) -> LanderMotions:
        """Return motions fitted to the samples of a window, on several levels: a factor on the noise and steps under it.

        Fits that are far too bad after the first level end there. In windows larger than the first one in which body and wheel are
        free, the distinct motions are fitted again with new derivatives. A further sample moves a motion far along its ridge, and
        with old derivatives the noise would explain the misfit. The second fit takes as long as the first.
        """
        s = self.s
        problem, held = self._problem(window)
        levels = s.levels if len(motions.neighbours_s) else s.first_levels
        limit = self.cost_limit(window)
        # under the wider noise of the first level only motions that do not fit cost more than this
        hopeless = limit + _explained(problem.model) * (np.log(levels[0][0]) + s.not_yet)
        fit = partial(fit_window, hopeless=hopeless, held=held)
        fitted = self._fitted(problem, motions, fit, levels)
        if not held and window.stop - window.start > s.held:
            fitted = self._fitted(problem, self.kept(fitted, window), fit_window, s.again)
        self._last_fitted = len(motions)
        return fitted

    def note_window(self, window: slice, kept: LanderMotions) -> None:
        """Add a window to the trace: how many motions were fitted to it, and are kept."""
        self.trace.append(Stage(window.stop - window.start, self._last_fitted, len(kept)))

    def _fitted(
        self,
        problem: FitProblem,
        motions: LanderMotions,
        fit: Callable[..., LanderMotions],
        levels: Sequence[tuple[float, int]],
    ) -> LanderMotions:
        """Return motions fitted by a function of a problem, motions and levels."""
        self.fitted += len(motions) * len(problem.model.obs)
        if not len(motions.neighbours_s):
            motions = replace(motions, neighbours_s=np.zeros(len(motions)))
        fit_part = partial(fit, problem, levels=levels)
        return in_pieces(fit_part, motions, problem.rows_at_once, self.workers)

    def _problem(self, window: slice) -> tuple[FitProblem, bool]:
        """Return the fit to a window, and whether body and wheel are held at their centres.

        Tilts of single panels count as noise, as they would be as many unknowns as readings. The common rotation of all panels is
        free: as noise it would let through many more motions.
        """
        held = window.stop - window.start < self.s.held
        model = self.model.seeing(window)
        terms = (model.panels.with_tilts_as_noise(), *model.given)
        model = replace(model, obs=replace(model.obs, terms=terms))
        free = np.ones(len(model.unknowns), dtype=bool)
        free[model.indices(TILT)] = False
        free[: len(model.of_motion)] = not held
        return FitProblem(model, free, sizes=self.sizes), held

    def kept(self, motions: LanderMotions, window: slice) -> LanderMotions:
        """Return motions without copies and without those that the readings rule out, best first."""
        s = self.s
        # within the limit by noise, and not far less probable than the best; if there are none, a few of the best
        limit, best = self.cost_limit(window), float(np.min(motions.cost, initial=np.inf))
        possible = motions.cost <= min(limit, best + s.drop + s.slack)
        size = f"({window.stop - window.start} samples)"
        if not possible.any():
            order = np.argsort(motions.cost, kind="stable")[: s.kept_anyway]
            possible = np.zeros(len(motions), dtype=bool)
            possible[order[np.isfinite(motions.cost[order])]] = True
            self._note(f"no motion is within the noise {size}", complete=True)
        # copies are near in rate and direction up to the end of the next window or, with body and wheel free, on one ridge
        wider = grown(self.t_s, window, self.growth)
        reach_s = float(np.abs(self.t_s[wider]).max())
        motions = one_each_box(motions.take(possible), reach_s, s)
        motions = self._at_most(motions, s.most_boxes, size)
        if window.stop - window.start < s.held:
            return motions
        return self._at_most(one_each_ridge(motions, s), s.most, size)

    def _at_most(self, motions: LanderMotions, most: int, where: str) -> LanderMotions:
        """Return at most so many motions (best first), evenly spaced in the order of cost, so that a line keeps its ends."""
        if len(motions) <= most:
            return motions
        self._note(f"{MORE} {where}", complete=False)
        even = np.linspace(0, len(motions) - 1, most).round().astype(int)
        return motions.take(np.unique(even))

    def widened(self, motions: LanderMotions, window: slice, wider: slice) -> LanderMotions:
        """Return motions for a wider window: also those next to them along ridges, without those that the next samples rule out.

        The comparison with a sample takes one run of a motion, a fit forty. If it rules all motions out, none is dropped: a spoilt
        sample must not end the search.
        """
        s, reach_s = self.s, float(np.abs(self.t_s[wider]).max())
        if window.stop - window.start > s.grid_samples or len(motions) <= s.few_starts:
            motions = with_neighbours(motions, reach_s, self.model.max_rate, s)
        else:
            # the next fit computes curvatures again; only neighbours need those of this window
            motions = replace(motions, curvature=motions.curvature[:0])
        allowed = np.ones(len(motions), dtype=bool)
        for sample in (window.start - 1, window.stop):
            if wider.start <= sample < wider.stop:
                allowed[allowed] = self._allowed(motions.take(allowed), sample)
        if allowed.any():
            motions = motions.take(allowed)
        # A window may take a third of the work that is left, in motions times samples, so that something is left for later windows.
        samples = wider.stop - wider.start
        work = max(s.most_search - self.fitted, s.least_work) // 3
        most = min(s.most_work, work) // samples
        self._announce(len(motions), most, samples)
        return self._at_most(motions, most, f"({samples} samples)")

    def _allowed(self, motions: LanderMotions, sample: int) -> np.ndarray:
        """Return which motions (K) a sample allows.

        It allows a motion if a direction within `look_rad` of the predicted Sun explains its panels, up to the square of sigmas
        that the grid allows too. The motion must also be slow enough at the first sample (:attr:`Reference.fastest`).
        """
        grid, motions = self.settings.grid, motions.bare
        model = self.model.seeing(slice(sample, sample + 1))
        panels = replace(model, obs=replace(model.obs, terms=(model.panels,)))
        allowed = np.zeros(len(motions), dtype=bool)
        for start in range(0, len(motions), RUNS_AT_ONCE):
            rows = slice(start, start + RUNS_AT_ONCE)
            sun = panels.carried(motions.take(rows), TRIAL_ERROR).sun_B
            squares = shortfall(panels.panels, np.nan_to_num(sun), self.s.look_rad, grid).sum(
                axis=1
            )
            allowed[rows] = (squares <= grid.limit) & np.isfinite(sun).all(axis=(1, 2))
        slow = self.model.first_speed(motions.take(allowed), TRIAL_ERROR) <= self.reference.fastest
        allowed[allowed] = slow
        return allowed

    def _announce(self, going: int, most: int, samples: int) -> None:
        """Warn before a fit that takes long or leaves motions out, with a smaller rate limit that would avoid it."""
        took = FIT_S * min(going, most) * samples / self.s.held
        takes = f"takes about {took / 60:.1f} min"
        if going > most:
            smaller = self.reference.prior_max_rate * (most / going) ** (1 / 3)
            _warn(
                f"{going} motions may fit {samples} samples; {most} of them are followed, which {takes}, and the search will not "
                f"be complete; with --prior max_rate_rad_s={smaller:.2g} about all of them would be followed"
            )
        elif samples == self.s.held and took > LONG_S:
            _warn(
                f"{going} motions may fit {samples} samples; following them {takes}, and in proportion to the cube of --prior "
                "max_rate_rad_s less"
            )

    def announce_starts(self) -> None:
        """Warn before a search for starts that takes long, with a rate limit that would make it short."""
        reference = self.reference
        took = START_S * cell_count(reference.limit, reference.edge) * len(reference.suns)
        if took > LONG_S:
            smaller = min(reference.prior_max_rate, reference.limit) * (LONG_S / took) ** (1 / 3)
            _warn(
                f"looking for starts takes about {took / 60:.1f} min; with --prior max_rate_rad_s={smaller:.2g} about one"
            )

    def joined(self, motions: list[LanderMotions]) -> LanderMotions:
        """Return the motions of several searches."""
        return LanderMotions.joined(motions)

    def cost_limit(self, window: slice) -> float:
        """Return the cost that a true motion does not exceed in a window.

        It is half a unit for each reading plus a margin: for noise larger than stated, for three sigmas of chance, and for
        outliers. These are independent, so that their squares add.
        """
        s, model = self.s, self.model.seeing(window)
        count = _explained(model)
        sigma = sum(model.unknowns[i].sigma for i in model.indices("noise"))
        noisy = min(s.noise_sigmas * sigma, s.noise_most)
        # (3 sigmas)^2 of half a chi-square of `count` numbers are 9 count / 2
        chance = float(np.sqrt((noisy * count) ** 2 + 4.5 * count + s.slack**2))
        held = window.stop - window.start < s.held
        return 0.5 * count + chance + (s.slack_held if held else 0.0)

    # ---- all samples -------------------------------------------------------------------------------------------------------

    def fit_all_samples(self, motions: LanderMotions) -> ModelFit:
        """Return motions and their symmetric solutions fitted to all samples with all unknowns free, without copies.

        Each fit begins with the stated sigma of the inertia and again with the larger one; under a constant torque with several of
        its sizes, as the prior of a small size would keep the torque small.
        """
        fit = self._fit_all_samples(motions)
        images = self.model.panels.response.symmetries
        if len(images) == 1:
            return fit
        # The search may miss symmetric solutions, which no reading distinguishes. A mirror reverses rates, which are axial vectors.
        omega, sun = fit.motions.omega, fit.motions.sun
        imaged = [
            replace(fit.motions, omega=np.linalg.det(image) * (omega @ image.T), sun=sun @ image.T)
            for image in images
        ]
        return self._fit_all_samples(LanderMotions.joined(imaged))

    def _fit_all_samples(self, motions: LanderMotions) -> ModelFit:
        """Return motions fitted to all samples."""
        free = np.ones(len(self.model.unknowns), dtype=bool)
        begins: list[Sizes] = [{"inertia": 0}, {"inertia": 1}]
        if torque := self.model.indices("steady_torque"):
            count = len(self.model.unknowns[torque[0]].shares)
            begins = [{"inertia": 0, "steady_torque": i} for i in self.s.torque_levels if i < count]
        elif not self.model.indices("inertia"):
            begins = [ALL_SIZES]
        parts = []
        for sizes in begins:
            problem = FitProblem(self.model, free, FINAL_ERROR, sizes)
            fit_part = partial(fit_finally, problem, levels=self.s.last_levels)
            fitted = in_pieces(fit_part, motions, problem.rows_at_once, self.workers)
            if sizes:
                # now under the prior with all sizes
                problem = replace(problem, sizes=ALL_SIZES)
                fit_part = partial(fit_finally, problem, levels=((1.0, 4),))
                fitted = in_pieces(fit_part, fitted, problem.rows_at_once, self.workers)
            parts.append(fitted)
        fitted = LanderMotions.joined(parts)
        evidence = log_evidence(self.model, fitted.cost, fitted.curvature)
        fit = distinct_fits(ModelFit(self.model, fitted, evidence), self.s)
        if len(fit) > self.s.most_fitted:
            self._note(f"more than {self.s.most_fitted} solutions", complete=True)
            fit = fit.take(slice(self.s.most_fitted))
        # each start was fitted from each size
        fitted = replace(fit.motions, starts=-(-fit.motions.starts // len(begins)))
        return replace(fit, motions=fitted, complete=self.complete, notes=tuple(self.notes))


def log_evidence(model: LanderModel, cost: np.ndarray, curvature: np.ndarray) -> np.ndarray:
    """Return the log evidence (K) of motions with costs (K) and curvatures (K, D, D) by Laplace's method.

    It is relative to readings just as predicted under the stated noise, so that models of the same readings compare.
    """
    least = 1e-9 * np.eye(curvature.shape[-1])
    prior = np.log(4 / 3 * np.pi * model.max_rate**3) + np.log(4 * np.pi) + model.log_possible
    # of (2 pi)^(D / 2) the unknowns' priors take (2 pi)^(m / 2)
    volume = 2.5 * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(curvature + least)[1]
    return -cost + volume - prior


def _warn(text: str) -> None:
    """Write a line on the log of the package."""
    logging.getLogger("sunspin").warning("sunspin: %s", text)


def _explained(model: LanderModel) -> float:
    """Return how many numbers a motion must explain: lit readings and other observations."""
    return model.panels.explained + sum(term.explained for term in model.given)

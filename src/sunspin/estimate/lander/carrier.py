"""The search for motions of a lander: trial motions are fitted to a window of samples, compared, and carried to a wider window."""

from __future__ import annotations

import logging
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
from sunspin.estimate.lander.fit import FINAL_ERROR, FitProblem, fit_finally, fit_window, in_pieces
from sunspin.estimate.lander.grid import Reference, cell_count
from sunspin.estimate.lander.model import ALL_SIZES, LanderModel, Sizes
from sunspin.estimate.lander.motions import Doubt, LanderMotions, ModelFit
from sunspin.estimate.lander.rate_grid import TRIAL_ERROR
from sunspin.estimate.search import grown
from sunspin.estimate.settings import PosteriorSettings
from sunspin.estimate.terms.panels import images
from sunspin.estimate.terms.powers import TILT

RUNS_AT_ONCE = 8192
"""Motions that are run together to compare them with one sample, as memory allows."""

FIT_S, START_S = 0.005, 1e-5
"""Seconds of one core for the fit of a motion to five samples and the stages after it, and for the starts in a cell of the grid of
rates with one direction. Measured on Philae."""

WORK_S = 4e-4
"""Seconds of one core for a search, for each motion and sample that it fits to windows. Measured on landers with a wheel."""

NONE_FITS = "no motion is within the noise"
"""Begin of the doubt about the first window that no motion fits."""

LONG_S = 60.0
"""A stage that takes longer than this is announced before it begins."""


class Stage(NamedTuple):
    """Numbers of one window of a search: its `samples`, the motions `fitted` to them, and those of them that were `kept`."""

    samples: int
    fitted: int
    kept: int


class Shooting:
    """Steps of a search for motions that are given by one state at the reference (:class:`sunspin.estimate.search.Carrier`).

    Samples are at the times `t_s` (n) from the reference; a window is a slice of them. `doubts`: on the search so far; `work`:
    motions times samples that were fitted to windows (the fits to all samples are not counted); `stages`: windows;
    `starts`: windows with the motions at which the search begins there, once they are computed; `explained`: the largest window
    that some motion fits.
    """

    def __init__(
        self,
        model: LanderModel,
        reference: Reference,
        settings: PosteriorSettings,
        workers: int | None = None,
        torque_size: int | None = None,
    ) -> None:
        """Begin a search under a model that counts time from `reference`.

        The inertia has its stated sigma. Under a larger one a few samples would fit bodies far from it, and the true motion would
        count as a copy of theirs. `torque_size`: index of the sigma of a constant torque, if one acts.
        """
        self.model, self.reference, self.t_s = model, reference, model.obs.t_s
        self.sizes: Sizes = {"inertia": 0}
        if torque_size is not None:
            self.sizes = {"inertia": 0, "steady_torque": torque_size}
        self.settings, self.s = settings, settings.shooting
        self.workers = worker_count(workers)
        self.doubts = reference.doubts
        self.work = 0
        self.stages: list[Stage] = []
        self.starts: list[tuple[slice, LanderMotions]] = []
        self.explained = reference.window
        self._fitted_to_window = 0

    @property
    def explains_all(self) -> bool:
        """Return whether some motion fits all samples, once they were searched."""
        return self.explained == slice(0, len(self.t_s))

    def under(self, model: LanderModel) -> Shooting:
        """Return a new search of the same readings under a model with a constant torque."""
        size = self.s.searched_under
        under_torque = Shooting(model, self.reference, self.settings, self.workers, size)
        under_torque.starts = self.starts
        return under_torque

    def _doubt(self, text: str, *, left_out: bool) -> None:
        """Add a doubt, unless it is there; `left_out`: the search has left out motions that may fit."""
        if (doubt := Doubt(text, left_out)) not in self.doubts:
            self.doubts.append(doubt)

    def fit(self, motions: LanderMotions, window: slice) -> LanderMotions:
        """Return motions fitted to the samples of a window, under several levels in turn: factors on the noise with their steps.

        Motions that fit far too badly after the first level are not fitted under the others. In windows larger than the first one
        in which body and wheel are free, the distinct motions are fitted twice, as a new sample moves a motion far along its ridge.
        A fit computes derivatives only once, where it begins, and they do not hold so far away. The second fit takes as long as the
        first.
        """
        s = self.s
        problem, held = self._problem(window)
        # the search begins with the window about the reference
        levels = s.first_levels if window == self.reference.window else s.levels
        # Only motions that do not fit cost more than this. Noise wider by a factor adds the log of it to the cost of each number.
        excess = np.log(levels[0][0]) + s.not_yet  # of each number
        hopeless = self.cost_limit(window) + _explained(problem.model) * excess
        fit = partial(fit_window, problem, levels=levels, hopeless=hopeless, held=held)
        fitted = self._fitted(problem, motions, fit)
        if not held and window.stop - window.start > s.held:
            again = partial(fit_window, problem, levels=s.again)
            fitted = self._fitted(problem, self.kept(fitted, window), again)
        self._fitted_to_window = len(motions)
        return fitted

    def note_window(self, window: slice, kept: LanderMotions) -> None:
        """Add a window to `stages`, and call the `watch` of the settings; `kept`: what is left of the motions fitted to it last."""
        samples = window.stop - window.start
        self.stages.append(Stage(samples, self._fitted_to_window, len(kept)))
        if np.min(kept.cost, initial=np.inf) <= self.cost_limit(window):
            self.explained = window
        if self.settings.search.watch is not None:
            self.settings.search.watch(window, kept)

    def _fitted(self, problem: FitProblem, motions: LanderMotions, fit: partial) -> LanderMotions:
        """Return the result of the function `fit` of motions, which solves `problem`, computed by all workers."""
        self.work += len(motions) * len(problem.model.obs)
        if not len(motions.neighbours_s):
            motions = replace(motions, neighbours_s=np.zeros(len(motions)))
        return in_pieces(fit, motions, problem.rows_at_once, self.workers)

    def _problem(self, window: slice) -> tuple[FitProblem, bool]:
        """Return the least-squares problem of a window, and whether it holds inertia, friction and wheel at their centres.

        It does if the window has too few samples to determine them. Tilts of single panels are not fitted but count as noise: they
        would be as many unknowns as readings. The common tilt of all panels is fitted: as noise it would let many motions pass.
        """
        held = window.stop - window.start < self.s.held
        model = self.model.at_samples(window)
        terms = (model.panels.with_tilts_as_noise(), *model.given)
        model = replace(model, obs=replace(model.obs, terms=terms))
        free = np.ones(len(model.unknowns), dtype=bool)
        free[model.indices(TILT)] = False
        free[: len(model.of_motion)] = not held  # the unknowns of the motion come first
        return FitProblem(model, free, sizes=self.sizes), held

    def kept(self, motions: LanderMotions, window: slice) -> LanderMotions:
        """Return fitted motions without copies and without those that the readings of the window rule out, best first."""
        s = self.s
        # within the limit by noise, and not far less probable than the best; if there are none, a few of the best
        limit, best = self.cost_limit(window), float(np.min(motions.cost, initial=np.inf))
        possible = motions.cost <= min(limit, best + s.drop + s.slack)
        size = f"({window.stop - window.start} samples)"
        if not possible.any():
            order = np.argsort(motions.cost, kind="stable")[: s.kept_anyway]
            possible = np.zeros(len(motions), dtype=bool)
            possible[order[np.isfinite(motions.cost[order])]] = True
            # that wider windows fit no motion either adds nothing
            if not any(NONE_FITS in doubt.text for doubt in self.doubts):
                count = window.stop - window.start
                self._doubt(f"{NONE_FITS} of {count} samples", left_out=False)
        # copies are near in rate and direction up to the end of the next window or, with body and wheel free, on one ridge
        wider = grown(self.t_s, window, self.settings.search.growth)
        reach_s = float(np.abs(self.t_s[wider]).max())
        motions = one_each_box(motions.take(possible), reach_s, s)
        motions = self._at_most(motions, s.most_boxes, size)
        if window.stop - window.start < s.held:
            return motions
        return self._at_most(one_each_ridge(motions, s), s.most, size)

    def _at_most(self, motions: LanderMotions, most: int, where: str) -> LanderMotions:
        """Return at most `most` motions, evenly spaced in the order of cost, so that of solutions along a line the ends are kept.

        `motions`: best first; `where`: the window in words, for the remark that motions were left out.
        """
        if len(motions) <= most:
            return motions
        self._doubt(f"more trial solutions than the search can follow {where}", left_out=True)
        even = np.linspace(0, len(motions) - 1, most).round().astype(int)
        return motions.take(np.unique(even))

    def widened(self, motions: LanderMotions, window: slice, wider: slice) -> LanderMotions:
        """Return the motions to be fitted to a wider window: those of a window, and neighbours of these.

        Those that the samples next to the window rule out are dropped: the comparison with a sample takes one run of a motion, a
        fit forty. If it rules all motions out, none is dropped, as a bad sample must not end the search.
        """
        s, reach_s = self.s, float(np.abs(self.t_s[wider]).max())
        is_grid = window.stop - window.start <= s.grid_samples
        if not is_grid or len(motions) <= s.few_starts:
            motions = with_neighbours(motions, reach_s, self.model.max_rate, s)
        else:
            # The many starts of the grid are dense enough without neighbours. Curvatures are dropped: only neighbours need them.
            motions = replace(motions, curvature=motions.curvature[:0])
        allowed = np.ones(len(motions), dtype=bool)
        for sample in (window.start - 1, window.stop):
            if wider.start <= sample < wider.stop:
                allowed[allowed] = self._allowed(motions.take(allowed), sample)
        if allowed.any():
            motions = motions.take(allowed)
        # A window may take a third of the work that is left, in motions times samples, so that something is left for later windows.
        samples = wider.stop - wider.start
        third = max(s.most_search - self.work, s.least_work) // 3
        most = min(s.most_work, third) // samples
        self._announce(len(motions), most, samples)
        return self._at_most(motions, most, f"({samples} samples)")

    def _allowed(self, motions: LanderMotions, sample: int) -> np.ndarray:
        """Return which motions (K) the panel readings of a sample allow, and the largest rate at the first sample too.

        The readings allow a motion if they fit some direction to the Sun within `look_rad` of the predicted one. A direction fits
        if its sum of squared residuals is at most `limit` of the grid settings, as for the starts on the grid. At the first sample
        the rate may be :attr:`Reference.fastest` at most. A motion that cannot be computed is not allowed.
        """
        grid, look_rad, motions = self.settings.grid, self.s.look_rad, motions.bare
        at_sample = self.model.at_samples(slice(sample, sample + 1))
        of_panels = replace(at_sample, obs=replace(at_sample.obs, terms=(at_sample.panels,)))
        allowed = np.zeros(len(motions), dtype=bool)
        for start in range(0, len(motions), RUNS_AT_ONCE):
            rows = slice(start, start + RUNS_AT_ONCE)
            sun = of_panels.sun_states(motions.take(rows), TRIAL_ERROR).sun_B
            # of the best direction, or less; a Sun that is not a number is ruled out below
            squares = shortfall(at_sample.panels, np.nan_to_num(sun), look_rad, grid).sum(axis=1)
            allowed[rows] = (squares <= grid.limit) & np.isfinite(sun).all(axis=(1, 2))
        slow = self.model.first_speed(motions.take(allowed), TRIAL_ERROR) <= self.reference.fastest
        allowed[allowed] = slow
        return allowed

    def _announce(self, count: int, most: int, samples: int) -> None:
        """Warn before a fit of `most` of `count` motions that takes long or leaves some out; a smaller rate limit would avoid it.

        The count grows with the cube of the limit, as the volume of the ball of rates does.
        """
        duration_s = FIT_S * min(count, most) * samples / self.s.held
        takes = f"takes about {duration_s / 60:.1f} min"
        if count > most:
            smaller = self.reference.prior_max_rate * (most / count) ** (1 / 3)
            _warn(
                f"{count} motions may fit {samples} samples; {most} of them are followed, which {takes}, and the search will not "
                f"be complete; with --prior max_rate_rad_s={smaller:.2g} about all of them would be followed"
            )
        elif samples == self.s.held and duration_s > LONG_S:
            _warn(
                f"{count} motions may fit {samples} samples; following them {takes}, and in proportion to the cube of --prior "
                "max_rate_rad_s less"
            )

    def announce_starts(self) -> None:
        """Warn before a search for starts that takes long, with a rate limit that would make it short."""
        reference = self.reference
        cells = cell_count(reference.limit, reference.edge)
        duration_s = START_S * cells * len(reference.suns)
        if duration_s > LONG_S:
            smaller = min(reference.prior_max_rate, reference.limit) * (LONG_S / duration_s) ** (
                1 / 3
            )
            _warn(
                f"looking for starts takes about {duration_s / 60:.1f} min; with --prior max_rate_rad_s={smaller:.2g} about one"
            )

    def announce_torques(self, count: int) -> None:
        """Warn before searches under `count` constant torques that take long; each takes about as long as this search did."""
        duration_s = WORK_S * self.work * count
        if duration_s > LONG_S:
            _warn(
                f"no motion fits without a torque; searching under constant torques takes about {duration_s / 60:.1f} min "
                "(--prior steady_torque=0 leaves it out)"
            )

    def joined(self, motions: list[LanderMotions]) -> LanderMotions:
        """Return the motions of several searches together."""
        return LanderMotions.joined(motions)

    def cost_limit(self, window: slice) -> float:
        """Return the cost that a true motion does not exceed in a window.

        It is half a unit for each reading plus a margin: for noise larger than stated, for three sigmas of chance, and for
        outliers. These are independent, so that their squares add.
        """
        s, model = self.s, self.model.at_samples(window)
        count = _explained(model)
        # a larger logarithm of the noise adds as much for each reading
        sigma = sum(model.unknowns[i].sigma for i in model.indices("noise"))
        log_noise = min(s.noise_sigmas * sigma, s.noise_most)
        # (3 sigmas)^2 of half a chi-square of `count` numbers are 9 count / 2
        margin = float(np.sqrt((log_noise * count) ** 2 + 4.5 * count + s.slack**2))
        held = window.stop - window.start < s.held
        return 0.5 * count + margin + (s.slack_held if held else 0.0)

    def fit_all_samples(self, motions: LanderMotions) -> ModelFit:
        """Return motions and their symmetric solutions fitted to all samples with all unknowns free, without copies."""
        fit = self._fit_without_symmetry(motions)
        # rotations and mirrors (3, 3) of the panels, the identity first
        panels = self.model.panels
        symmetries = images(panels.response, np.any(panels.used, axis=0))
        if len(symmetries) == 1:
            return fit
        # The search may miss symmetric solutions, which no reading distinguishes. A mirror reverses rates, which are axial vectors.
        motions, symmetric = fit.motions, []
        for matrix in symmetries:
            omega = np.linalg.det(matrix) * (motions.omega @ matrix.T)
            symmetric.append(replace(motions, omega=omega, sun=motions.sun @ matrix.T))
        return self._fit_without_symmetry(LanderMotions.joined(symmetric))

    def _fit_without_symmetry(self, motions: LanderMotions) -> ModelFit:
        """Return motions fitted to all samples, without copies and without far less probable ones, by falling evidence.

        Each is first fitted under the stated sigma of the inertia and again under the larger one; under a constant torque under
        several sizes of it, as the prior of a small size would keep the torque small. Then it is fitted under the whole prior.
        """
        free = np.ones(len(self.model.unknowns), dtype=bool)
        begins: list[Sizes] = [{"inertia": 0}, {"inertia": 1}]
        if torque := self.model.indices("steady_torque"):
            count = len(self.model.unknowns[torque[0]].shares)
            levels = [level for level in self.s.torque_levels if level < count]
            begins = [{"inertia": 0, "steady_torque": level} for level in levels]
        elif not self.model.indices("inertia"):
            begins = [ALL_SIZES]
        parts = []
        for sizes in begins:
            problem = FitProblem(self.model, free, FINAL_ERROR, sizes)
            fit = partial(fit_finally, problem, levels=self.s.last_levels)
            fitted = in_pieces(fit, motions, problem.rows_at_once, self.workers)
            if sizes:
                fit = partial(fit_finally, replace(problem, sizes=ALL_SIZES), levels=((1.0, 4),))
                fitted = in_pieces(fit, fitted, problem.rows_at_once, self.workers)
            parts.append(fitted)
        fitted = LanderMotions.joined(parts)
        evidence = log_evidence(self.model, fitted.cost, fitted.curvature)
        distinct = distinct_fits(ModelFit(self.model, fitted, evidence), self.s)
        most = self.s.most_fitted
        if len(distinct) > most:
            self._doubt(f"more than {most} solutions", left_out=False)
            distinct = distinct.take(slice(most))
        # each start was fitted once for each of `begins`
        motions = distinct.motions
        motions = replace(motions, starts=-(-motions.starts // len(begins)))
        return replace(distinct, motions=motions, doubts=tuple(self.doubts))


def log_evidence(model: LanderModel, cost: np.ndarray, curvature: np.ndarray) -> np.ndarray:
    """Return the log evidence (K) of motions with costs (K) and curvatures (K, D, D) by Laplace's method.

    It is relative to readings just as predicted under the stated noise, so that models of the same readings compare.
    """
    # for directions that neither readings nor priors determine
    floor = 1e-9 * np.eye(curvature.shape[-1])
    # log of the inverse prior density of rate and direction, and log of the part of the unknowns' prior whose bodies can exist
    prior = np.log(4 / 3 * np.pi * model.max_rate**3) + np.log(4 * np.pi) + model.log_possible
    # Log of the integral of exp(-x C x / 2) over D = 5 + m coordinates x, times the norm of the prior of the m unknowns.
    # That norm cancels (2 pi)^(m / 2) of the factor (2 pi)^(D / 2).
    volume = 2.5 * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(curvature + floor)[1]
    return -cost + volume - prior


def _warn(text: str) -> None:
    """Write a line on the log of the package."""
    logging.getLogger("sunspin").warning("sunspin: %s", text)


def _explained(model: LanderModel) -> float:
    """Return how many numbers a motion must explain: lit readings and other observations."""
    return model.panels.explained + sum(term.explained for term in model.given)

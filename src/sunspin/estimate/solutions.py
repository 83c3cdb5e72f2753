"""The solutions of one pass: motions summed over models and strengths of torques, carried to all samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from sunspin.estimate.carry import RATE
from sunspin.estimate.chain import Fit, variance_of
from sunspin.estimate.copies import Outline
from sunspin.estimate.dense import filled, residuals_by_sensor
from sunspin.estimate.evidence import PassFits
from sunspin.estimate.model import AS_STATED, Model, Observations, Track
from sunspin.estimate.settings import SearchSettings, SolutionSettings
from sunspin.estimate.terms.panels import Panels
from sunspin.solve.rotations import rotation_between

ESTIMATED = ("steady_torque", "gyro_zero", "gyro_scale", "rate_size_scale", "clock", "panel_zero")
"""Kinds of unknowns that are reported as they are."""

MEAN_COUNTS = 0.05
"""Members of a solution with less than this share do not count in the sigma of its mean rate."""


@dataclass(frozen=True)
class Solutions:
    """K solutions of one pass at all its samples (n), the most probable first; of the unknowns only the errors of the inertia.

    `probability` (K); `mean` and `mean_sigma` (K, 3) in rad/s: of the rate averaged over the pass. `residual`: by sensor (K, n), in
    sigmas. `model`: the most probable model and its probability. `noise` (K): strength of unknown torques, rad/s^1.5. `estimates`:
    for each solution name -> unit, value, sigma. `cost_limit`: beyond it no motion fits. `without_periods` (K): the probability
    before periods that were seen are counted in.
    """

    obs: Observations
    track: Track
    probability: np.ndarray
    mean: np.ndarray
    mean_sigma: np.ndarray
    residual: dict[str, np.ndarray]
    model: tuple[str, float]
    noise: np.ndarray
    estimates: tuple[dict[str, tuple[str, float, float]], ...]
    cost_limit: float
    without_periods: np.ndarray | None = None

    @staticmethod
    def joined(every: Sequence[Solutions]) -> Solutions:
        """Return all solutions of several objects of one pass; what they share is that of the first."""
        parts = {
            name: np.concatenate([getattr(of_some, name) for of_some in every])
            for name in ("probability", "mean", "mean_sigma", "noise")
        }
        residual = {
            name: np.concatenate([of_some.residual[name] for of_some in every])
            for name in every[0].residual
        }
        estimates = tuple(row for of_some in every for row in of_some.estimates)
        track = Track.joined([of_some.track for of_some in every])
        return replace(every[0], track=track, residual=residual, estimates=estimates, **parts)

    def take(self, which: np.ndarray) -> Solutions:
        """Return some of the solutions, by index."""
        return replace(
            self,
            track=self.track.take(which),
            probability=self.probability[which],
            mean=self.mean[which],
            mean_sigma=self.mean_sigma[which],
            residual={name: part[which] for name, part in self.residual.items()},
            noise=self.noise[which],
            without_periods=None if self.without_periods is None else self.without_periods[which],
            estimates=tuple(self.estimates[k] for k in which),
        )

    def listed(self, s: SolutionSettings, images: int = 1) -> Solutions:
        """Return the solutions that are reported, the most probable first: `s.most` at most, unless two motions have more images.

        Those below the probability `s.least` are left out. `images`: how many motions the panels cannot distinguish from one.
        """
        order = np.argsort(-self.probability, kind="stable")[: max(s.most, 2 * images)]
        count = int(np.count_nonzero(self.probability[order] > s.least))
        return self.take(order[: max(1, count)])


Member = tuple[Fit, float]
"""A motion as a fit of it alone (K = 1), and its part of the probability of the pass."""


def solutions(
    fits: PassFits,
    whole: Observations,
    kept: np.ndarray,
    s: SolutionSettings,
    search_settings: SearchSettings,
) -> Solutions:
    """Return the solutions of a pass: groups of motions that are alike under several models and strengths of torques.

    A solution is the most probable motion of its group. By how much the others differ from it counts in its covariance. `whole`:
    all samples of the pass; `kept` (n): places among them of those to which `fits` were made.
    """
    members = _members(fits, s)
    groups = _grouped(members, fits.nominal.obs.t_s, s, search_settings)
    # the probability of each model, all motions counted; an alternative is named only if the nominal one has hardly any
    shares: dict[str, float] = {AS_STATED: 0.0}
    for fitted, weight in members:
        what = fitted.model.what
        shares[what] = shares.get(what, 0.0) + weight
    named = AS_STATED if shares[AS_STATED] > s.named else max(shares, key=lambda what: shares[what])
    solved = Solutions.joined([_solution(group, whole, kept) for group in groups])
    return replace(solved, model=(named, shares[named]), cost_limit=fits.nominal.obs.cost_limit)


def _members(fits: PassFits, s: SolutionSettings) -> list[Member]:
    """Return the motions of all fits with weights that add to one, the heaviest first, without those that hardly count.

    The weight of each is the larger one under two priors of the rate. Under the first every rate up to the largest is equally
    likely, so most are near the largest; under the second every power of ten of the speed is. Aliases fit alike, and which of them
    is more probable must not depend on the prior.
    """
    log = [fitted.log_evidence + fits.log_rung[fits.rung(fitted)] for fitted in fits.fits]
    log_any_speed = [
        part + _gain_of_any_speed(fitted, s) for part, fitted in zip(log, fits.fits, strict=True)
    ]
    under_priors = np.concatenate(log), np.concatenate(log_any_speed)
    weights = np.max([np.exp(part - logsumexp(part)) for part in under_priors], axis=0)
    weights = weights / weights.sum()
    motions = [fitted.take(slice(k, k + 1)) for fitted in fits.fits for k in range(len(fitted))]
    order = np.argsort(-weights, kind="stable")
    order = order[weights[order] > s.counted * weights.max()]
    total = weights[order].sum()
    return [(motions[i], float(weights[i] / total)) for i in order]


def _gain_of_any_speed(fitted: Fit, s: SolutionSettings) -> np.ndarray:
    """Return what motions (K) gain in log evidence if it is not known to a power of ten how fast the body turns.

    It is the mean of the evidence under priors of the rate at the first sample that are narrower by the factors `s.slower`. A fit
    that ended on a slope has no covariance, and gains nothing.
    """
    sigma = fitted.model.rate_sigma
    # In sigmas of the prior a narrower one adds 1 / share^2 - 1 to the precision P, which makes P' of it, and P m to P' m' of the
    # mean m; the log evidence changes as in `evidence.over_shares`.
    covariance = np.nan_to_num(fitted.motions.covariance[:, 0, RATE, RATE]) / sigma**2
    sound = np.linalg.eigvalsh(covariance)[:, 0] > 0
    covariance = np.where(sound[:, None, None], covariance, np.eye(3))
    rate = fitted.motions.omega[:, 0] / sigma
    precision = np.linalg.inv(covariance)
    slope = (precision @ rate[..., None])[..., 0]
    before = np.linalg.slogdet(precision)[1] - np.einsum("ki,ki->k", slope, rate)
    gains = []
    for share in s.slower:
        matrix = precision + (1 / share**2 - 1) * np.eye(3)
        mean = np.linalg.solve(matrix, slope[..., None])[..., 0]
        after = np.linalg.slogdet(matrix)[1] - np.einsum("ki,ki->k", slope, mean)
        gains.append(sound * ((before - after) / 2 - 3 * np.log(share)))
    return logsumexp(gains, axis=0) - np.log(len(gains))


def _grouped(
    members: list[Member], t_s: np.ndarray, s: SolutionSettings, search_settings: SearchSettings
) -> list[list[Member]]:
    """Return the members of each solution, the heaviest first; solutions by their weight."""
    groups: list[tuple[Outline, list[Member]]] = []
    for fitted, weight in members:
        outline = Outline.of(fitted.motions, t_s)
        for head, group in groups:
            # Motions of one fit are no copies of each other, so they stay two solutions unless they are nearer to each other than
            # motions of different models need be.
            same_fit = any(fitted.model is other.model for other, _ in group)
            apart = search_settings.copies_rad if same_fit else s.bent_rad
            if outline.same(0, head, apart, s.bent_rad, search_settings.copies_sigmas)[0]:
                group.append((fitted, weight))
                break
        else:
            groups.append((outline, [(fitted, weight)]))
    lists = [group for _, group in groups]
    return sorted(lists, key=lambda group: -sum(weight for _, weight in group))


def _solution(group: list[Member], whole: Observations, kept: np.ndarray) -> Solutions:
    """Return the solution (K = 1) of a group of motions, the most probable one first, at all samples `whole` of a pass.

    `kept`: which of the samples were fitted.
    """
    fits, weights = zip(*group, strict=True)
    head, model, weight = fits[0], fits[0].model, np.array(weights)
    shares = weight / weight.sum()

    # At the kept samples, sums over the motions of the group, weighted by `shares`:
    # `covariance` of the mixture about the first motion, widened by the differences `offs` (each (1, n, 6)) of turn and rate;
    # `square` (n - 1), the squared strength of the torques in each interval;
    # `hidden`, the variance (rad/s)^2 of a rate that oscillates between the samples (`swings.py`), which no sample shows.
    dt = np.diff(model.obs.t_s)
    offs, covariance, square, hidden = [], 0.0, 0.0, 0.0
    for fitted, share in zip(fits, shares, strict=True):
        motion, noise = fitted.motions, fitted.model.noise
        turn = rotation_between(head.motions.attitude, motion.attitude)
        off = np.concatenate([turn, motion.omega - head.motions.omega], axis=-1)
        offs.append(off)
        own = motion.covariance + off[..., :, None] * off[..., None, :]
        covariance = covariance + share * own
        square = square + share * noise.in_intervals(dt) ** 2
        hidden += share * noise.hidden_variance(dt)
    motion = replace(head.motions, covariance=np.asarray(covariance))
    # `mean_map` gives the mean rate over the pass from errors of turn and rate at the kept samples
    track, mean_map = filled(model, motion, whole.t_s, whole.momentum, np.sqrt(square))
    residual = residuals_by_sensor(whole, model, track, kept)
    # Axes of N that follow a magnetic field turn in space, at up to `axes_rad_s` about an unknown axis. A third of its square is
    # the variance of each component, also of the mean rate. An oscillation hardly changes the mean: its variance is divided by n.
    axes = max(term.axes_rad_s for term in whole.terms) ** 2 / 3
    track.covariance[..., RATE, RATE] += (hidden + axes) * np.eye(3)

    # The variance of the mean rate: again that of the mixture about the first motion, without members of small share.
    counted = np.flatnonzero((shares >= MEAN_COUNTS) | (np.arange(len(group)) == 0))
    variance = 0.0
    for k in counted:
        off = np.einsum("knij,knj->ki", mean_map, offs[k])  # of the mean rate
        variance = variance + shares[k] * (variance_of(fits[k], mean_map) + off**2)
    return Solutions(
        obs=whole,
        track=replace(track, u=motion.u[:, model.inertia_slice]),
        probability=weight.sum(keepdims=True),
        mean=track.omega.mean(axis=1),
        mean_sigma=np.sqrt(variance / shares[counted].sum() + axes + hidden / len(model.obs)),
        residual=residual,
        model=(model.what, 1.0),  # `solutions` replaces it, and the limit
        noise=np.sqrt(np.median(square, keepdims=True)),
        estimates=(estimates(head),),
        cost_limit=np.inf,
    )


def estimates(fitted: Fit) -> dict[str, tuple[str, float, float]]:
    """Return what was estimated with the motion of a fit (K = 1): name -> unit, value, one sigma.

    Gains are factors on those of the vehicle file, moments of inertia in units of the mean one; the Earth's light is the mean over
    the pass in axes of N.
    """
    model: Model = fitted.model
    u, covariance = fitted.motions.u[0], fitted.u_covariance[0]
    # of each number: unit, value a before the data, and its derivative g (m) by the unknowns, so that it is a + g . u
    rows: dict[str, tuple[str, float, np.ndarray]] = {}
    every = np.eye(len(u))  # row i: the derivative of unknown i itself
    body = model.body
    for i, j in [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)] if len(body.errors) else ():
        change = body.errors[:, i, j] @ every[model.inertia_slice]
        rows[f"inertia_{'xyz'[i]}{'xyz'[j]}"] = "1", body.inertia[i, j], change
    for k, unknown in enumerate(model.unknowns):
        if unknown.kind in ESTIMATED:
            rows[unknown.name] = unknown.unit, unknown.centre, unknown.sigma * every[k]
    for term, own in model.terms_with_slices:
        if isinstance(term, Panels) and len(term.gain_errors):
            errors = every[own][term.gain_slice]
            for k, name in enumerate(term.names):
                rows[f"gain_{name}"] = "1", term.gain[k], term.gain_errors[:, k] @ errors
        if isinstance(term, Panels) and term.earth is not None:
            earth, light = term.earth, every[own][term.earth_slice]
            centre = np.zeros(3) if earth.known_N is None else earth.known_N.mean(axis=0)
            change = earth.light_N.mean(axis=0).T @ light[earth.light_slice]
            for k, axis in enumerate("xyz"):
                rows[f"earth_light_{axis}"] = "full Sun", float(centre[k]), change[k]
    return {
        name: (
            unit,
            float(centre + change @ u),
            float(np.sqrt(max(change @ covariance @ change, 0))),
        )
        for name, (unit, centre, change) in rows.items()
    }

"""The solutions of one pass: motions summed over models and strengths of torques, and propagated to all samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri, logsumexp

from sunspin.estimate.carry import RATE
from sunspin.estimate.chain import Fit, variance_of
from sunspin.estimate.copies import Outline
from sunspin.estimate.dense import propagate_to_all, residuals_by_sensor
from sunspin.estimate.evidence import PassFits
from sunspin.estimate.model import AS_STATED, Model, Observations, Track
from sunspin.estimate.settings import SearchSettings, SolutionSettings
from sunspin.estimate.terms.field import FieldChange
from sunspin.estimate.terms.panels import Panels
from sunspin.solve.rotations import rotation_between

ESTIMATED = ("steady_torque", "gyro_zero", "gyro_scale", "rate_size_scale", "clock", "panel_zero")
"""Kinds of unknowns that are reported as they are."""

ARRAYS = ("probability", "mean", "mean_sigma", "noise")
"""Fields of `Solutions` with a row for each solution."""

LEAST_SHARE = 0.05
"""Motions with less than this share of a solution's probability do not count in the sigma of its mean rate."""

DENIED = 1e-5
"""Least probability of errors of a magnetometer's axes and scales as large as the fitted ones. 55 passes of spinners whose file is
right have 0.16 and more; of one that was read along other axes three passes had 5e-7 and less, and were decided."""


@dataclass(frozen=True)
class Solutions:
    """K solutions of one pass at all its samples (n); of the unknowns only the errors of the inertia. `listed` sorts them.

    `probability` (K); `mean` and `mean_sigma` (K, 3) in rad/s: of the rate averaged over the pass. `residual`: by sensor (K, n), in
    sigmas. `model`: name and probability of the nominal model, or of the most probable one if that is improbable. `noise` (K):
    strength of unknown torques, rad/s^1.5. For each solution, `estimates`: name -> unit, value, sigma; and `denied`: the sensors
    whose axes it denies. `cost_limit`: beyond it no motion fits. `without_periods` (K): the probability without observed periods of
    the rotation.
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
    denied: tuple[tuple[str, ...], ...]
    cost_limit: float
    without_periods: np.ndarray | None = None

    @staticmethod
    def joined(parts: Sequence[Solutions]) -> Solutions:
        """Return the solutions of all parts of one pass in one, not sorted by probability. `obs`, `model` and `cost_limit` are
        those of the first part. No part has `without_periods`."""
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in ARRAYS}
        residual = {
            sensor: np.concatenate([part.residual[sensor] for part in parts])
            for sensor in parts[0].residual
        }
        estimates = tuple(estimate for part in parts for estimate in part.estimates)
        denied = tuple(sensors for part in parts for sensors in part.denied)
        track = Track.joined([part.track for part in parts])
        listed = {"residual": residual, "estimates": estimates, "denied": denied}
        return replace(parts[0], track=track, **listed, **arrays)

    def take(self, which: np.ndarray) -> Solutions:
        """Return some of the solutions, by index."""
        return replace(
            self,
            track=self.track.take(which),
            residual={sensor: sigmas[which] for sensor, sigmas in self.residual.items()},
            without_periods=None if self.without_periods is None else self.without_periods[which],
            estimates=tuple(self.estimates[k] for k in which),
            denied=tuple(self.denied[k] for k in which),
            **{name: getattr(self, name)[which] for name in ARRAYS},
        )

    def listed(self, s: SolutionSettings, images: int = 1) -> Solutions:
        """Return the solutions that are reported, the most probable first.

        They are `s.most` at most, or all symmetric solutions of two motions if those are more. Solutions of less than the
        probability `s.least` are left out. `images`: number of symmetric solutions of a motion, itself included.
        """
        order = np.argsort(-self.probability, kind="stable")[: max(s.most, 2 * images)]
        count = int(np.count_nonzero(self.probability[order] > s.least))
        return self.take(order[: max(1, count)])


WeightedMotion = tuple[Fit, float]
"""A motion as a fit of it alone (K = 1), and its share of the probability of the pass."""


def solutions(
    fits: PassFits,
    whole: Observations,
    kept: np.ndarray,
    s: SolutionSettings,
    search_settings: SearchSettings,
) -> Solutions:
    """Return the solutions of a pass: groups of motions that are alike under several models and strengths of torques.

    The rates of a solution are those of the most probable motion of its group. Its covariance also counts by how much the others
    differ from it. `whole`: all samples of the pass; `kept` (n): indices among them of those to which `fits` were made.
    """
    motions = _weighted_motions(fits, s)
    groups = _groups(motions, s, search_settings)
    # the probability of each model, all motions counted; an alternative is named only if the nominal one has hardly any
    of_model: dict[str, float] = {AS_STATED: 0.0}
    for fitted, weight in motions:
        what = fitted.model.what
        of_model[what] = of_model.get(what, 0.0) + weight
    most_probable = max(of_model, key=lambda what: of_model[what])
    named = AS_STATED if of_model[AS_STATED] > s.named else most_probable
    solved = Solutions.joined([_solution(group, whole, kept) for group in groups])
    limit = fits.nominal.obs.cost_limit
    return replace(solved, model=(named, of_model[named]), cost_limit=limit)


def _weighted_motions(fits: PassFits, s: SolutionSettings) -> list[WeightedMotion]:
    """Return the motions of all fits with their probabilities, the most probable first, without those that hardly count.

    A motion's probability is in proportion to its evidence times the prior of its strength of torques (rung). It is computed under
    two priors of the rate. The first is normal with the sigma `Model.rate_sigma`: slow rates are rare. The second is the mean of
    normal ones with sigmas from that down (`s.slower`): slow rates are about as likely as fast ones. Aliases fit equally well, so
    one prior alone would choose between them. Therefore the larger of the two probabilities counts, and these are normalised
    again. Motions with less than `s.counted` times the largest are left out.
    """
    # for each fit the log (K) of evidence times prior of the rung: under the first prior of the rate, then under the second
    log = [fitted.log_evidence + fits.log_rung[fits.rung(fitted)] for fitted in fits.fits]
    log_any_speed = [
        part + _gain_of_any_speed(fitted, s) for part, fitted in zip(log, fits.fits, strict=True)
    ]
    # the motions of all fits in one row, under each of the two priors
    under_priors = np.concatenate(log), np.concatenate(log_any_speed)
    weights = np.max([np.exp(each - logsumexp(each)) for each in under_priors], axis=0)
    weights = weights / weights.sum()
    motions = [fitted.take(slice(k, k + 1)) for fitted in fits.fits for k in range(len(fitted))]
    order = np.argsort(-weights, kind="stable")
    order = order[weights[order] > s.counted * weights.max()]
    total = weights[order].sum()
    return [(motions[i], float(weights[i] / total)) for i in order]


def _gain_of_any_speed(fitted: Fit, s: SolutionSettings) -> np.ndarray:
    """Return by how much the log evidence of motions (K) changes if not even the order of magnitude of their rate is known.

    The prior of the rate at the first sample is then the mean of normal priors whose sigmas are narrower by the factors `s.slower`.
    A fit that did not end in a minimum has no covariance: its evidence stays as it is.
    """
    sigma = fitted.model.rate_sigma
    # In sigmas of the prior, a narrower one adds 1 / share^2 - 1 to the precision P of the rate, of the mean m: P' = P + that, P'
    # m' = P m. The log evidence changes by (m' P' m' - m P m + log det P - log det P') / 2 - 3 log share.
    covariance = np.nan_to_num(fitted.motions.covariance[:, 0, RATE, RATE]) / sigma**2
    valid = np.linalg.eigvalsh(covariance)[:, 0] > 0
    covariance = np.where(valid[:, None, None], covariance, np.eye(3))
    rate = fitted.motions.omega[:, 0] / sigma  # m
    precision = np.linalg.inv(covariance)  # P
    slope = (precision @ rate[..., None])[..., 0]  # P m
    before = np.linalg.slogdet(precision)[1] - np.einsum("ki,ki->k", slope, rate)
    gains = []
    for share in s.slower:
        matrix = precision + (1 / share**2 - 1) * np.eye(3)  # P'
        mean = np.linalg.solve(matrix, slope[..., None])[..., 0]  # m'
        after = np.linalg.slogdet(matrix)[1] - np.einsum("ki,ki->k", slope, mean)
        gains.append(valid * ((before - after) / 2 - 3 * np.log(share)))
    return logsumexp(gains, axis=0) - np.log(len(gains))


def _groups(
    motions: list[WeightedMotion], s: SolutionSettings, search_settings: SearchSettings
) -> list[list[WeightedMotion]]:
    """Return the motions of each solution, the most probable first; solutions by falling probability.

    `motions`: the most probable first. Each joins the first group whose most probable motion, the head, it resembles.
    """
    groups: list[tuple[Outline, list[WeightedMotion]]] = []
    for fitted, weight in motions:
        outline = Outline.of(fitted.motions, fitted.model.obs.t_s)
        for head, group in groups:
            # Two motions of one fit were not taken for copies there. So they stay two solutions unless they are nearer to each
            # other than motions of different models need be.
            same_fit = any(fitted.model is member.model for member, _ in group)
            apart = search_settings.copies_rad if same_fit else s.bent_rad
            if outline.same(0, head, apart, s.bent_rad, search_settings.copies_sigmas)[0]:
                group.append((fitted, weight))
                break
        else:
            groups.append((outline, [(fitted, weight)]))
    return sorted((group for _, group in groups), key=lambda g: -sum(weight for _, weight in g))


def _solution(group: list[WeightedMotion], whole: Observations, kept: np.ndarray) -> Solutions:
    """Return the solution (K = 1) of a group of motions, the most probable one first, at all samples `whole` of a pass.

    `kept`: indices of the samples that were fitted.
    """
    fits, weights = zip(*group, strict=True)
    head, model, weight = fits[0], fits[0].model, np.array(weights)
    shares = weight / weight.sum()

    # At the kept samples, sums over the motions of the group, weighted by `shares`:
    # `covariance` of the mixture about the first motion, from which each differs by `offs` (each (1, n, 6)) in turn and rate;
    # `noise_square` (n - 1), the squared strength of the torques in each interval;
    # `hidden`, the variance (rad/s)^2 of a rate that oscillates between the samples (`swings.py`), which no sample shows.
    dt = np.diff(model.obs.t_s)
    offs, covariance, noise_square, hidden = [], 0.0, 0.0, 0.0
    for fitted, share in zip(fits, shares, strict=True):
        motion, noise = fitted.motions, fitted.model.noise
        turn = rotation_between(head.motions.attitude, motion.attitude)
        off = np.concatenate([turn, motion.omega - head.motions.omega], axis=-1)
        offs.append(off)
        about_head = motion.covariance + off[..., :, None] * off[..., None, :]
        covariance = covariance + share * about_head
        noise_square = noise_square + share * noise.in_intervals(dt) ** 2
        hidden += share * noise.hidden_variance(dt)
    motion = replace(head.motions, covariance=np.asarray(covariance))
    # `mean_by_kept` (1, n, 3, 6): derivative of the mean rate over the pass by turn and rate at the kept samples
    track, mean_by_kept = propagate_to_all(
        model, motion, whole.t_s, whole.momentum, np.sqrt(noise_square)
    )
    residual = residuals_by_sensor(whole, model, track, kept)
    # Axes of N that follow a magnetic field turn in space, at up to `axes_rad_s` about an unknown axis. A third of its square is
    # the variance of each component, also of the mean rate. An oscillation hardly changes the mean: its variance is divided by n.
    axes = max(term.axes_rad_s for term in whole.terms) ** 2 / 3
    track.covariance[..., RATE, RATE] += (hidden + axes) * np.eye(3)

    # the variance of the mean rate: again that of the mixture about the first motion, without motions of small share
    counted = np.flatnonzero((shares >= LEAST_SHARE) | (np.arange(len(group)) == 0))
    variance = 0.0
    for k in counted:
        # by how much its mean rate differs from that of the first
        mean_off = np.einsum("knij,knj->ki", mean_by_kept, offs[k])
        variance = variance + shares[k] * (variance_of(fits[k], mean_by_kept) + mean_off**2)
    return Solutions(
        obs=whole,
        track=replace(track, u=motion.u[:, model.inertia_slice]),
        probability=weight.sum(keepdims=True),
        mean=track.omega.mean(axis=1),
        mean_sigma=np.sqrt(variance / shares[counted].sum() + axes + hidden / len(model.obs)),
        residual=residual,
        model=(model.what, 1.0),  # `solutions` replaces it, and the limit
        noise=np.sqrt(np.median(noise_square, keepdims=True)),
        estimates=(estimates(head),),
        denied=(denied_sensors(head),),
        cost_limit=np.inf,
    )


def estimates(fitted: Fit) -> dict[str, tuple[str, float, float]]:
    """Return the numbers that were estimated with the motion of a fit (K = 1): name -> unit, value, one sigma.

    Gains are factors on those of the file, moments of inertia in units of the mean one, the Earth's light a mean in axes of N.
    """
    model: Model = fitted.model
    u, covariance = fitted.motions.u[0], fitted.u_covariance[0]
    # of each number: unit, prior value a, and derivative g (m) by the unknowns u; its estimate is a + g . u
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
            # a gain is the stated one plus its sigmas (e) times e errors, which panels may share
            by_error = every[own][term.gain_slice]
            for k, name in enumerate(term.names):
                rows[f"gain_{name}"] = "1", term.gain[k], term.gain_errors[:, k] @ by_error
        if isinstance(term, Panels) and term.earth is not None:
            earth, light = term.earth, every[own][term.earth_slice]
            centre = np.zeros(3) if earth.known_N is None else earth.known_N.mean(axis=0)
            # one sigma of each unknown changes the light vector by a row of `light_N`, here its mean over the samples
            change = earth.light_N.mean(axis=0).T @ light[earth.light_slice]
            for k, axis in enumerate("xyz"):
                rows[f"earth_light_{axis}"] = "full Sun", float(centre[k]), change[k]
    return {
        name: (unit, float(a + g @ u), float(np.sqrt(max(g @ covariance @ g, 0))))
        for name, (unit, a, g) in rows.items()
    }


def denied_sensors(fitted: Fit) -> tuple[str, ...]:
    """Return the sensors whose axes and scales a fit (K = 1) needs farther from those of the file than errors of them may be.

    That is asked of a magnetometer without an orbit alone. With a matrix of errors many sigmas from zero its readings may fit a
    wrong motion.
    """
    unknowns = zip(fitted.model.unknowns, fitted.motions.u[0], strict=True)
    errors = np.array([value for unknown, value in unknowns if unknown.kind == "field_matrix"])
    is_denied = len(errors) and errors @ errors > chdtri(len(errors), DENIED)
    return (FieldChange.label,) if is_denied else ()

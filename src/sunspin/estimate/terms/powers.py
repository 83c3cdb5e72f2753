"""Term of all readings of a lander's panels, unlit ones too, with one brightness for all samples (docs/posterior.md, "Likelihood").

A lit reading is the panel's power, brightness times gain times cosine of the incidence, with Gaussian noise. The likelihood of a
dark reading, one below the lit threshold, is the probability that noise keeps the power below the threshold, relative to that of a
panel that faces away. Any reading may be an outlier with a small probability: a shadow, a spike.

All readings of a sample are taken at its time plus an unknown time error (`time_s`: one sigma). A fit uses the best error for each
motion. The density is integrated over the error, since a panel that becomes lit within the error may leave two good values.

If a full battery limits the power, all readings of a sample have one unknown factor ("throttled"). A fit uses the best factor for
each motion (variable projection, Kaufman 1975, BIT 15, 49). The density is integrated over it, which leaves one power of the noise.

Fits minimise :meth:`PanelPowers.residuals`, in which a dark reading is an upper bound. The weights of draws use
:meth:`PanelPowers.log_density`. Shapes: K motions, n samples, p inputs, m unknowns u in sigmas of their priors. A turn is a small
rotation of the body, as a rotation vector in body axes B (rad).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.special import log_ndtr

from sunspin.estimate.model import States, Unknown
from sunspin.estimate.settings import OUTLIER, OUTLIER_DARK, OUTLIER_LARGEST
from sunspin.estimate.terms.term import Law, Residual, Term, gaussian
from sunspin.solve.rotations import components_after_rotation, cross, tangent_basis
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.flat import PanelResponse

LOG_2PI = float(np.log(2 * np.pi))

TILT, COMMON_TILT = "tilt", "tilt_common"
"""Kinds of unknowns: rotations of one panel about two axes across its normal, and one rotation of all panels."""

HALF_WEIGHT, ROUNDS = 5.0, 3
"""Residual, in sigmas, at which a reading has half its weight in the factor of a throttled sample; and number of times that factor
and weights are computed again."""

MEAN_SQUARE_SINE = 2 / 3
"""Mean square of the sine of the angle between a panel's normal and the Sun, over all Sun directions in front of the panel."""

TIME_STEPS, LARGEST_TIME_SIGMAS = 3, 4.0
"""Gauss-Newton steps to the best time error of a sample, and the limit of that error in sigmas."""

SPACING_IN_PEAK_SIGMAS, FEWEST_POINTS_PER_SIGMA = 1.5, 4.0
"""For the integral of the density over time errors: largest spacing of the time errors in sigmas of the narrowest possible peak
(the integral of a normal law is then exact to 1e-3), and smallest number of time errors for each sigma."""

LARGEST_LOG_NOISE, NOISE_STEPS = 5.0, 8
"""Upper limit of the log noise in sigmas of its prior, and number of Newton steps to the best one."""


@dataclass(frozen=True)
class SunStates(States):
    """K motions of a lander at n samples: rates `omega` (K, n, 3) and directions to the Sun `sun` (K, n, 3) in body axes.

    There is no attitude, as no sensor of a lander shows the rotation about the Sun direction.
    """

    sun: np.ndarray

    @classmethod
    def of(cls, sun: np.ndarray, omega: np.ndarray) -> SunStates:
        """Return states with directions `sun` (K, n, 3) and rates `omega` (K, n, 3), without attitudes."""
        return cls(np.zeros((0, 0, 3, 3)), omega, sun)

    @property
    def sun_B(self) -> np.ndarray:
        """Return the directions to the Sun (K, n, 3)."""
        return self.sun


@dataclass(frozen=True)
class PanelPowers(Term):
    """Readings of a lander's panels at n samples, and what is known of the panels before the fit.

    Attributes
    ----------
    power : (n, p), or (K, n, p) if each motion has readings of its own
    used, sigma : (n, p) readings that count; (p) stated noise of a reading of each input
    threshold : (p) or one for all, reading above which a panel counts as lit
    largest : largest reading
    response : converts directions to signals of panels of gain one
    brightness : first guess of the reading of a panel of gain one at normal incidence
    throttled : all readings of a sample are reduced by one unknown factor
    own : (m) unknowns: log brightness ("scale", centred on the first guess), log of noise over stated noise, log gains, tilts
    turns : (m, n_panel, 3), rotation (rad, B) of each panel by one sigma of each unknown; None without tilts
    time_s : s, sigma of the time error of each sample
    """

    name: ClassVar[str] = "panels"
    label: ClassVar[str] = "Sun"
    of_sun: ClassVar[bool] = True
    per_sample: ClassVar[tuple[str, ...]] = ("power", "used")

    power: np.ndarray
    used: np.ndarray
    sigma: np.ndarray
    threshold: np.ndarray | float
    largest: float
    response: PanelResponse
    brightness: float
    throttled: bool = False
    own: tuple[Unknown, ...] = ()
    turns: np.ndarray | None = None
    time_s: float = 0.0

    def present(self) -> np.ndarray:
        """Return which samples (n) have a reading that counts, lit or dark."""
        return np.any(self.used, axis=1)

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the unknowns: brightness, noise, gains and tilts."""
        return self.own

    @cached_property
    def lit(self) -> np.ndarray:
        """Return which readings (n, p) count and are above the threshold."""
        return self.used & (self.power > self.threshold)

    @property
    def explained(self) -> float:
        """Return the number of lit readings: those that a motion must explain."""
        return float(self.lit.sum())

    @cached_property
    def has_factor(self) -> np.ndarray:
        """Return which samples (n) have an unknown factor. It is determined by the lit readings and uses one degree of freedom."""
        return np.logical_and(self.throttled, self.lit.any(axis=-1))

    def indices(self, kind: str) -> list[int]:
        """Return the indices of the unknowns of a kind."""
        return [i for i, unknown in enumerate(self.own) if unknown.kind == kind]

    def gain(self, u: np.ndarray) -> np.ndarray:
        """Return the factors (K, p) on the gains of the response: the brightness times the gain error of each input."""
        log = np.zeros((len(u), len(self.sigma)))
        for i, unknown in enumerate(self.own):
            if unknown.kind == "scale":
                log += (unknown.centre + unknown.sigma * u[:, i])[:, None]
            elif unknown.kind == "gain":
                log[:, unknown.index] += unknown.sigma * u[:, i]
        return np.exp(log)

    def tilt(self, u: np.ndarray) -> np.ndarray | None:
        """Return the rotations (K, 1, n_panel, 3) of the panels (rad, B); None if no tilts are unknown."""
        return None if self.turns is None else np.tensordot(u, self.turns, axes=1)[:, None]

    def log_noise(self, u: np.ndarray) -> np.ndarray:
        """Return the log (K) of the noise over the stated noise; zero if the noise is not unknown."""
        indices = self.indices("noise")
        return self.own[indices[0]].sigma * u[:, indices[0]] if indices else np.zeros(len(u))

    # ---- for fits ----------------------------------------------------------------------------------------------------------

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield predicted less read powers (K, n, p) in stated sigmas.

        With time errors, each sample is predicted at its best time error, and a second residual has these errors (K, n, 1) in
        sigmas of their prior.
        """
        late_s = self.best_times(states, u)[0]
        sun = sun_later(states, late_s)
        power, by_turn, by_u = self._throttle(*self._powers_with_slopes(sun, u))
        value, by_power = self._differences(power)
        by_turn, by_u, law = by_turn * by_power, by_u * by_power, self.law(u)
        if not self.time_s:
            yield Residual(value, by_turn=by_turn, by_u=by_u, law=law)
            return

        # The time error t of a sample, in sigmas, is no unknown of the fit but always the best one for the motion. With b = d value
        # / dt and the weights w of the sample's readings, sum(w b value) + t = 0 at the best t. If motion or unknowns change the
        # values by dv, t changes by dt = -sum(w b dv) / (1 + sum(w b b)), and the values by dv + b dt. Second derivatives are
        # neglected (Kaufman). Here `by_time` (K, n, p) is b, as the body turns by omega time_s t, and `size` is the denominator.
        by_time = self.time_s * np.sum(by_turn * states.omega[..., None, :], axis=-1)
        weighted = law(value)[1] * by_time
        size = 1.0 + np.sum(weighted * by_time, axis=-1)[..., None, None]
        # dt / d turn (K, n, 1, 3) and dt / du (K, n, 1, m)
        time_by_turn = -(weighted[..., None, :] @ by_turn / size)
        time_by_u = -(weighted[..., None, :] @ by_u / size)
        by_turn = by_turn + by_time[..., None] * time_by_turn
        by_u = by_u + by_time[..., None] * time_by_u
        # the readings were taken `late` after the state, so a change of the rate rotates the body by `late` times the change
        late = late_s[..., None, None]
        yield Residual(value, by_turn=by_turn, by_rate=late * by_turn, by_u=by_u, law=law)
        error, by_rate = late_s[..., None] / self.time_s, late * time_by_turn
        yield Residual(error, by_turn=time_by_turn, by_rate=by_rate, by_u=time_by_u, law=gaussian)

    def _powers_with_slopes(
        self, sun: np.ndarray, u: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the powers (K, n, p) for directions to the Sun `sun` (K, n, 3), before throttling, and their derivatives.

        These are by a turn of the body (K, n, p, 3), and by one sigma of each unknown (K, n, p, m), zero for the noise.
        """
        slopes = self.response.slopes(sun, gain=self.gain(u)[:, None], tilt=self.tilt(u))
        by_u = np.zeros((*slopes.power.shape, len(self.own)))
        for i, unknown in enumerate(self.own):
            # brightness ("scale") and gains are logarithms: their derivatives are in proportion to the power
            if unknown.kind == "scale":
                by_u[..., i] = unknown.sigma * slopes.power
            elif unknown.kind == "gain":
                by_u[..., unknown.index, i] = unknown.sigma * slopes.power[..., unknown.index]
            elif unknown.kind in (TILT, COMMON_TILT):
                assert self.turns is not None and slopes.to_tilt is not None
                by_u[..., i] = np.einsum("knpi,pi->knp", slopes.to_tilt, self.turns[i])
        # a turn t of the body moves the Sun by sun x t in body axes, and so changes the power by t . (slope x sun)
        return slopes.power, cross(slopes.to_sun, sun[..., None, :]), by_u

    def _differences(self, power: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return predicted less read powers (K, n, p) in stated sigmas, and the derivatives (K, n, p, 1) by the predicted `power`.

        A dark reading is an upper bound: its difference is what the predicted power has above the threshold, or zero. Differences
        and derivatives of readings that do not count are zero.
        """
        difference = np.where(self.lit, power - self.power, np.maximum(power - self.threshold, 0.0))
        varies = self.used & (self.lit | (power > self.threshold))
        by_power = varies[..., None] / self.sigma[:, None]
        return np.where(self.used, difference, 0.0) / self.sigma, by_power

    def best_times(self, states: States, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the best time error (K, n), s, of each sample, positive if taken late, and the curvature (K, n), 1/s2, there.

        The curvature is that of the cost of the readings, without the prior. Gauss-Newton steps are taken twice, each time from no
        error: once outliers count less from the first step on; once all readings have full weight in the first step, as a wrong
        time also makes readings look like outliers. The better result is returned.
        """
        no_error = np.zeros(states.sun_B.shape[:-1])
        if not self.time_s:
            return no_error, no_error
        law, limit = self.law(u), LARGEST_TIME_SIGMAS * self.time_s
        gain, tilt = self.gain(u)[:, None], self.tilt(u)

        def differences_at(late_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Return differences (K, n, p) of samples taken `late_s` (K, n) late, and their derivatives (K, n, p) by that, 1/s."""
            sun = sun_later(states, late_s)
            slopes = self.response.slopes(sun, gain=gain, tilt=tilt)
            value, by_power = self._differences(slopes.power)
            sun_rate = cross(sun, states.omega)[..., None, :]
            return value, np.sum(slopes.to_sun * sun_rate, axis=-1) * by_power[..., 0]

        best, curvature, least = no_error, no_error, np.full(no_error.shape, np.inf)
        for full_weights in (False, True):
            late_s = no_error
            for step in range(TIME_STEPS):
                value, by_time = differences_at(late_s)
                weight = np.ones_like(value) if full_weights and step == 0 else law(value)[1]
                # the minimum of the linearised cost, with the prior of the error
                information = np.sum(weight * by_time**2, axis=-1)
                weighted_target = information * late_s - np.sum(weight * by_time * value, axis=-1)
                late_s = np.clip(weighted_target / (information + self.time_s**-2), -limit, limit)
            value, by_time = differences_at(late_s)
            cost, weight = law(value)
            information = np.sum(weight * by_time**2, axis=-1)
            # The two results are compared by the integral over the error (Laplace's method), as the density prefers narrow peaks.
            cost = cost + 0.5 * (late_s / self.time_s) ** 2
            cost += 0.5 * np.log1p(self.time_s**2 * information)
            better = cost < least
            best = np.where(better, late_s, best)
            curvature = np.where(better, information, curvature)
            least = np.minimum(cost, least)
        return best, curvature

    def freedom_of_times(self, states: States, u: np.ndarray) -> np.ndarray:
        """Return the degrees of freedom (K) that the time errors use: up to one for each sample."""
        # information of the readings relative to that of the prior
        information = self.time_s**2 * self.best_times(states, u)[1]
        return np.sum(information / (1.0 + information), axis=1)

    def _throttle(
        self, light: np.ndarray, by_turn: np.ndarray, by_u: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return powers (K, n, p) and their derivatives, multiplied by the factors of throttled samples that fit best.

        `light` (K, n, p): powers without the factors; `by_turn` (K, n, p, 3) and `by_u` (K, n, p, m): their derivatives.
        """
        if not self.throttled:
            return light, by_turn, by_u
        factor, weight = self.best_factor(light)
        square = np.sum(weight * light**2, axis=-1)[..., None, None]
        weighted = (weight * light)[..., None]

        def with_factor(slope: np.ndarray) -> np.ndarray:
            """Return Kaufman's derivative: that of the light without its part along the light, which the factor compensates."""
            product = np.sum(weighted * slope, axis=-2, keepdims=True)
            along = np.divide(product, square, out=np.zeros_like(product), where=square > 0)
            return factor[..., None] * (slope - light[..., None] * along)

        return factor * light, with_factor(by_turn), with_factor(by_u)

    def best_factor(self, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the factors (K, n, 1) of samples with which powers `light` (K, n, p) fit best, and weights (K, n, p) of readings.

        The factor is that of weighted least squares, sum(w y p) / sum(w p^2) with powers p and readings y, of which negative ones
        count as zero. The weights w are first those of the noise alone. Then they are made smaller far from the prediction, as for
        outliers, :data:`ROUNDS` times. If no reading of a sample determines its factor, the factor is one.
        """
        read = np.maximum(self.power, 0.0)
        by_noise = self.used * (np.min(self.sigma) / self.sigma) ** 2
        weight = np.broadcast_to(by_noise, light.shape)
        factor = np.ones((*light.shape[:-1], 1))
        for round_number in range(ROUNDS + 1):
            if round_number:
                residual = (self.power - factor * light) / (HALF_WEIGHT * self.sigma)
                weight = by_noise / (1.0 + residual**2)
            square = np.sum(weight * light**2, axis=-1, keepdims=True)
            product = np.sum(weight * read * light, axis=-1, keepdims=True)
            factor = np.divide(product, square, out=np.ones_like(square), where=square > 0)
        return factor, weight

    def law(self, u: np.ndarray, noise_factor: float = 1.0) -> Law:
        """Return the function from differences (K, n, p), in stated sigmas, to costs (K, n) of samples and weights (K, n, p).

        The noise is `noise_factor` times that of the unknowns u (K, m). Two per cent of readings are outliers: a difference d costs
        -log(0.98 N(d) + 0.02 density of outliers), and its weight is the probability that it is no outlier, over the variance.
        Costs are relative to readings exactly as predicted under the stated noise. Dark readings are treated as Gaussian too.
        """
        log_noise = (self.log_noise(u) + np.log(noise_factor))[:, None, None]
        noise = np.exp(log_noise)
        # log density of a reading as predicted under the stated noise: without, and with outliers
        as_stated = np.log1p(-OUTLIER) - np.where(self.lit, np.log(self.sigma) + LOG_2PI / 2, 0.0)
        largest = np.logaddexp(as_stated, self._log_outlier_density)

        def weigh(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Return costs (K, n) of samples and weights (K, n, p) of readings."""
            good = as_stated - np.where(self.lit, log_noise, 0.0) - 0.5 * (value / noise) ** 2
            total = np.logaddexp(good, self._log_outlier_density)
            cost = np.where(self.used, largest - total, 0.0).sum(axis=-1)
            weight = np.where(self.used, np.exp(good - total) / noise**2, 0.0)
            # the integral over the factor of a throttled sample leaves one power of the noise
            return cost - self.has_factor * log_noise[..., 0], weight

        return weigh

    @cached_property
    def _log_outlier_density(self) -> np.ndarray:
        """Return the log (n, p) of the density of each reading as an outlier, times the prior probability that it is one.

        An outlier is dark with the probability `OUTLIER_DARK`, otherwise uniform up to `OUTLIER_LARGEST` times the largest reading.
        """
        density = (1 - OUTLIER_DARK) / (OUTLIER_LARGEST * self.largest)
        return np.log(OUTLIER * np.where(self.lit, density, OUTLIER_DARK))

    def best_noise(
        self, value: np.ndarray, u: np.ndarray, fitted_freedom: np.ndarray, least: float
    ) -> np.ndarray:
        """Return the unknowns u (K, m) with the noise that fits the differences `value` (K, n, p) best.

        It is computed by Newton steps in the log noise, whose lower limit is `least` in sigmas of its prior. `fitted_freedom` (K):
        degrees of freedom that the fit has used.
        """
        indices = self.indices("noise")
        if not indices:
            return u
        index, sigma, u = indices[0], self.own[indices[0]].sigma, u.copy()
        used = fitted_freedom + self.has_factor.sum()
        for _ in range(NOISE_STEPS):
            # Without the prior, the best noise makes the weighted squares of lit readings equal to their degrees of freedom: the
            # expected number of those that are no outliers, less what was fitted.
            weight = np.where(self.lit, self.law(u)(value)[1], 0.0)
            squares = np.sum(weight * value**2, axis=(1, 2))
            good = np.sum(weight, axis=(1, 2)) * np.exp(2 * self.log_noise(u))
            freedom = np.maximum(good - used, 0.0)
            # Newton's step with the prior; the curvature has a lower limit, as the squares may be small
            slope = sigma * (freedom - squares) + u[:, index]
            curvature = 2 * sigma**2 * np.maximum(squares, 0.3 * freedom) + 1
            step = np.clip(slope / curvature, -1, 1)
            u[:, index] = np.clip(u[:, index] - step, least, LARGEST_LOG_NOISE)
        return u

    def noise_curvature(self, value: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the second derivative (K) of the cost of differences (K, n, p) by one sigma of the log noise."""
        weight = np.where(self.lit, self.law(u)(value)[1], 0.0)
        sigma = self.own[self.indices("noise")[0]].sigma
        return 2 * sigma**2 * np.sum(weight * value**2, axis=(1, 2))

    def log_density(self, states: States, u: np.ndarray) -> np.ndarray:
        """Return the log density (K) of all readings, dark ones by the probability that noise keeps them below the threshold.

        That probability is relative to the one without any power, so that panels which face away contribute nothing.
        """
        if self.time_s:
            return self._densities_over_times(states, u).sum(axis=1)
        no_error = np.zeros(states.sun_B.shape[:-1])
        of_samples = self._sample_densities(self.predicted(states, u, no_error), u)
        return of_samples.sum(axis=1) + self.has_factor.sum(axis=-1) * self.log_noise(u)

    def _densities_over_times(self, states: States, u: np.ndarray) -> np.ndarray:
        """Return the log density (K, n) of the readings of each sample, integrated over its time error.

        Laplace's method about the best error is wrong if a panel becomes lit within the error: then the density has two peaks, and
        which one is higher changes with the motion. With it 100 draws had an effective sample size of 2 to 5.
        """
        facing_power = self.response.power(self.response.facing_B).diagonal()
        full_power = self.gain(u) * facing_power
        # upper limit (K) of the change of all readings together, in sigmas of the noise, per s
        steepest = np.linalg.norm(full_power / self.sigma, axis=1)
        steepest *= np.linalg.norm(states.omega, axis=-1).max(axis=1) * np.exp(-self.log_noise(u))
        # points for each sigma of the time error, so that the narrowest peak (prior times readings) is resolved
        points_per_sigma = np.hypot(1.0, self.time_s * steepest) / SPACING_IN_PEAK_SIGMAS
        # The number of points is the smallest one, doubled some times: most motions share their points, and no result depends on
        # which motions are computed together.
        doublings = np.ceil(
            np.log2(np.maximum(points_per_sigma / FEWEST_POINTS_PER_SIGMA, 1.0))
        ).astype(int)
        total = np.empty(states.sun_B.shape[:-1])
        for doubling in np.unique(doublings):
            rows = doublings == doubling
            panels = replace(self, power=self.power[rows]) if self.power.ndim == 3 else self
            motions = SunStates.of(states.sun_B[rows], states.omega[rows])
            count = int(2 * LARGEST_TIME_SIGMAS * FEWEST_POINTS_PER_SIGMA) << doubling
            # time errors in sigmas
            errors, step = np.linspace(
                -LARGEST_TIME_SIGMAS, LARGEST_TIME_SIGMAS, count + 1, retstep=True
            )
            log_sum = np.full(motions.sun_B.shape[:-1], -np.inf)
            for error in errors:
                late_s = np.full(log_sum.shape, error * self.time_s)
                power = panels.predicted(motions, u[rows], late_s)
                log_density = panels._sample_densities(power, u[rows])
                log_sum = np.logaddexp(log_sum, log_density - 0.5 * error**2)
            total[rows] = log_sum + np.log(step) - 0.5 * LOG_2PI
        return total

    def _sample_densities(self, power: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the log density (K, n) of the readings of each sample for predicted powers (K, n, p)."""
        return np.where(self.used, self._log_densities(power, u), 0.0).sum(axis=-1)

    def _log_densities(self, power: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the log density (K, n, p) of each reading, as an outlier or not, for predicted powers (K, n, p)."""
        sigma = self.sigma * np.exp(self.log_noise(u))[:, None, None]
        lit = -0.5 * ((self.power - power) / sigma) ** 2 - np.log(sigma) - LOG_2PI / 2
        dark = log_ndtr((self.threshold - power) / sigma) - log_ndtr(self.threshold / sigma)
        good = np.where(self.lit, lit, dark) + np.log1p(-OUTLIER)
        return np.logaddexp(good, self._log_outlier_density)

    def predicted(self, states: States, u: np.ndarray, late_s: np.ndarray) -> np.ndarray:
        """Return the predicted powers (K, n, p) `late_s` (K, n) after the samples, with the best factors of throttled samples."""
        sun = sun_later(states, late_s)
        power = self.response.power(sun, gain=self.gain(u)[:, None], tilt=self.tilt(u))
        return self.best_factor(power)[0] * power if self.throttled else power

    # ---- for checks of the draws -------------------------------------------------------------------------------------------

    def outlier_probability(self, states: States, u: np.ndarray) -> np.ndarray:
        """Return the probability (n, p) that each reading is an outlier, as a mean over the motions; zero for those not used."""
        power = self.predicted(states, u, self.best_times(states, u)[0])
        probability = np.exp(self._log_outlier_density - self._log_densities(power, u))
        return np.where(self.used, np.minimum(probability.mean(axis=0), 1.0), 0.0)

    def replicated(self, states: States, u: np.ndarray, rng: np.random.Generator) -> PanelPowers:
        """Return the panels with readings (K, n, p) simulated for each motion: with noise, time errors and outliers."""
        late_s = self.time_s * rng.standard_normal(states.sun_B.shape[:-1])
        power = self.predicted(states, u, late_s)
        noise = self.sigma * np.exp(self.log_noise(u))[:, None, None]
        value = np.where(power > 0, power + noise * rng.standard_normal(power.shape), 0.0)
        is_dark = rng.random(power.shape) < OUTLIER_DARK
        lit_outlier = rng.random(power.shape) * OUTLIER_LARGEST * self.largest
        is_outlier = rng.random(power.shape) < OUTLIER
        value = np.where(is_outlier, np.where(is_dark, 0.0, lit_outlier), value)
        return replace(self, power=value)

    # ---- for the search ----------------------------------------------------------------------------------------------------

    def with_tilts_as_noise(self) -> PanelPowers:
        """Return the readings with a larger noise in place of the tilts of single panels, for a search that does not fit tilts.

        The added noise is the same for all inputs: the root mean square over panels and over Sun directions in front of them.
        """
        tilts = self.indices(TILT)
        if not tilts:
            return self
        assert self.turns is not None
        across = cross(self.turns[tilts], self.response.normals_B)
        # only one of the two rotations of a panel changes its angle to the Sun, so half of the sum of both squares counts
        square = (across**2).sum(axis=(0, 2)) / 2
        size = np.sqrt(np.mean(square * self.response.gains**2) * MEAN_SQUARE_SINE)
        return replace(self, sigma=np.hypot(self.sigma, size * self.brightness))


def sun_later(states: States, late_s: np.ndarray) -> np.ndarray:
    """Return the directions to the Sun (K, n, 3) in body axes at `late_s` (K, n) after the samples, for constant rates."""
    if not late_s.any():
        return states.sun_B
    return components_after_rotation(states.sun_B, states.omega * late_s[..., None])


def tilt_unknowns(vehicle: Vehicle, own_rad: np.ndarray, common_rad: float) -> tuple[Unknown, ...]:
    """Return the tilts of panels as unknowns: two rotations of each panel, and three of all panels together.

    `own_rad` (n_panel): sigma of each of the two of a panel; `common_rad`: sigma about each body axis. Tilts with a sigma of zero
    are left out. A tilt changes the readings of a panel in all samples; as noise it would count as independent errors.
    """
    single = (
        Unknown(f"tilt_{panel.name}_{side + 1}_rad", TILT, "rad", 0.0, float(sigma), 2 * j + side)
        for j, (panel, sigma) in enumerate(zip(vehicle.panels, own_rad, strict=True))
        for side in range(2)
    )
    common = (
        Unknown(f"tilt_all_{axis}_rad", COMMON_TILT, "rad", 0.0, common_rad, i)
        for i, axis in enumerate("xyz")
    )
    return tuple(tilt for tilt in (*single, *common) if tilt.sigma > 0)


def panel_turns(vehicle: Vehicle, unknowns: tuple[Unknown, ...]) -> np.ndarray | None:
    """Return the rotations (m, n_panel, 3) of the panels (rad, B) by one sigma of each unknown; None if no unknown is a tilt."""
    turns = np.zeros((len(unknowns), len(vehicle.panels), 3))
    across = np.stack(tangent_basis(vehicle.panel_normals_B), axis=1)
    for i, unknown in enumerate(unknowns):
        if unknown.kind == TILT:
            panel, side = divmod(unknown.index, 2)
            turns[i, panel] = unknown.sigma * across[panel, side]
        elif unknown.kind == COMMON_TILT:
            turns[i, :, unknown.index] = unknown.sigma
    return turns if turns.any() else None

"""Term of the powers or currents of solar panels.

The reading of panel p at a sample is predicted as

    factor * scale * (gain_p * (sun_up * sunlight_p + earthlight_p) + zero_p)

The vehicle's response gives sunlight_p and earthlight_p for a direction to the light. Gains are unknowns of a pass. Earth's light
and zeros are unknowns too, if there is such light (:mod:`.earth_light`). The factor, near one, is the common effect of distance to
the Sun, temperature and battery on all readings of a sample. It is no unknown of the fit: each motion gets the factor that fits
best (variable projection, Kaufman 1975, BIT 15, 49). Its prior, (factor - 1) / scale_sigma, is one more residual. So one formula
serves for a factor that is known, roughly known or free.

Shapes: K motions, n samples, p panels (inputs), e gain errors, m unknowns u in sigmas of their priors. A turn is a small rotation
of the body, as a rotation vector in body axes B (rad). N is fixed in space, with z towards the Sun. Attitudes are matrices
B_from_N.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from sunspin.environment import Surroundings
from sunspin.estimate.model import States, Unknown
from sunspin.estimate.settings import INERTIA_SIGMAS
from sunspin.estimate.terms.earth_light import EarthLight, with_pair_differences
from sunspin.estimate.terms.term import Residual, Term, facing
from sunspin.solve.rotations import components_after_rotation, cross_matrix
from sunspin.telemetry.assess import Assessment
from sunspin.telemetry.gains import FAINT
from sunspin.telemetry.quality import LIMITED_SCALE
from sunspin.telemetry.signals import signals
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.flat import PanelResponse
from sunspin.vehicle.response.planes import sphere
from sunspin.vehicle.sensors import VARIABLES

QUADRATURE = np.polynomial.legendre.leggauss(3)
"""Nodes in [-1, 1] and weights (sum 2) of the Gauss quadrature for the mean of a reading over time."""

LEAST_SUN_FRACTION, SHADOW_ZERO_SHARE = 0.01, 0.03
"""Visible part of the Sun's disc below which a sample is in the shadow; and sigma of the zeros of converters, which panels read in
the shadow in addition to their noise, as a share of full Sun."""

DEFAULT_EARTH_SHARE = 0.09
"""Earth's light on a panel that faces the Earth, as a share of full Sun, if the file does not show its size. So it
is if an orbit gives its direction, but there are too few readings; or if a magnetometer is read, and no panel is opposite to a lit
one, and so in the Earth's light alone: a spinner with one panel was decided 9 sigma off without it. It corresponds to
:data:`sunspin.telemetry.quality.ALBEDO_DEFAULT` on panels in the dark."""

TINY, N_SUN_DIRECTIONS = 1e-6, 500
"""Limit below which a singular value of the panel normals, or a relative change of a reading, counts as zero; and number of Sun
directions for which that change is computed."""

TILT_SIGMA_RAD, TILT_SHARES = 0.1, (1.0, 0.4, 0.16)
"""Sigma (rad) of the angle between a panel and its stated direction in the alternative model of misaligned panels; and its equally
likely values as factors of it: 5.7, 2.3 and 0.9 degrees."""

FULL_SUN_QUANTILE, SCALE_TOLERANCE = 0.95, 0.1
"""Quantile of the brightness of the samples that should be full Sun if the Sun comes near the plane of the panels; and difference
from full Sun from which another full scale is tried."""


class ReadingTimes(NamedTuple):
    """Times of panel readings: `offset_s` (p) after the time of the row. A reading is the mean over `averaged_s` about that."""

    offset_s: np.ndarray
    averaged_s: float = 0.0

    @classmethod
    def of(cls, vehicle: Vehicle) -> ReadingTimes:
        """Return the times that the vehicle file states."""
        form = vehicle.telemetry
        offsets = np.array([form.offset_s.get(name, 0.0) for name in vehicle.input_names])
        return cls(offsets, form.averaged_s)

    def shifts(self) -> Iterator[tuple[float, np.ndarray]]:
        """Yield instants, s after the time of the row, each with its weights (p) in the readings, which add up to one."""
        instant = np.zeros(1), 2 * np.ones(1)
        for offset in np.unique(self.offset_s):
            for node, weight in zip(*(QUADRATURE if self.averaged_s else instant), strict=True):
                shift = float(offset + node * self.averaged_s / 2)
                yield shift, weight / 2 * (self.offset_s == offset)


@dataclass(frozen=True)
class Panels(Term):
    """Readings of panels at n samples, and what is known of the panels and their light before the fit.

    Attributes
    ----------
    power, sigma : (n, p), readings and the sigmas that count now, infinite where nothing was read
    response : converts directions to signals of panels of gain one
    gain, gain_errors : (p) and (e, p), factors on the gains of `response`, and one sigma of each independent error of them
    scale, scale_sigma : (n), reading of a panel of gain one in full Sun, and the sigma of the factor on it (see module)
    names, ever_shown : (p), and whether a panel counts in any sample of the file
    instants : times of the readings relative to their row
    sigma_light_noise, sigma_light_modelled : (n, p), values of `sigma` with the Earth's light as noise, and with a model of it
    earth_share : Earth's light on a panel that faces the Earth, as a share of full Sun
    earth : model of that light for one pass, None if it is noise
    known_N : (n, 3), Earth's light that an orbit predicts, in parts of full Sun, None without an orbit
    sun_up, dark_sigma : (n) 1 in the Sun and 0 in the Earth's shadow; (n, p) sigmas of readings in the shadow
    tilt_sigma : rad, sigma of the angle between each panel and its stated direction about each of two axes; 0: as stated
    """

    name: ClassVar[str] = "panels"
    label: ClassVar[str] = "Sun"
    of_sun: ClassVar[bool] = True
    per_sample: ClassVar[tuple[str, ...]] = tuple(
        "power sigma sigma_light_noise sigma_light_modelled dark_sigma scale scale_sigma sun_up known_N".split()
    )

    power: np.ndarray
    sigma: np.ndarray
    response: PanelResponse
    gain: np.ndarray
    gain_errors: np.ndarray
    scale: np.ndarray
    scale_sigma: np.ndarray
    names: tuple[str, ...]
    instants: ReadingTimes
    ever_shown: np.ndarray
    sigma_light_noise: np.ndarray
    sigma_light_modelled: np.ndarray
    dark_sigma: np.ndarray
    sun_up: np.ndarray
    earth_share: float = 0.0
    known_N: np.ndarray | None = None
    earth: EarthLight | None = None
    tilt_sigma: float = 0.0

    @classmethod
    def read(cls, assessment: Assessment) -> tuple[Self, np.ndarray]:
        """Return the panels of telemetry, and for each sample (n) in words whether it is used, or why it was dropped."""
        vehicle, quality = assessment.vehicle, assessment.quality
        # The errors of the gains are correlated. The rows of the transposed Cholesky factor of their covariance are independent.
        gain_errors = np.linalg.cholesky(quality["gain_cov"].values).T / vehicle.input_gains
        shown = quality["reading"].values & ~quality["dead"].values
        zeros = SHADOW_ZERO_SHARE * quality.attrs["full_sun"] * quality["gain"].values
        dark = np.hypot(quality["noise"].values, zeros)
        # who reads a magnetometer is near the Earth; with panels alone the light would be taken for that of the Sun
        unseen = (
            quality.attrs["albedo_samples"] == 0
            and VARIABLES["magnetometer"] in assessment.telemetry
        )
        panels = cls(
            power=signals(assessment.telemetry),
            # with the Earth's light as noise, until `of_pass` models it; without the errors of the gains
            sigma=quality["sigma_beside_gains"].values,
            response=vehicle.response_in(),
            gain=quality["gain"].values / vehicle.input_gains,
            gain_errors=gain_errors,
            scale=quality["scale"].values,
            scale_sigma=quality["scale_sigma"].values,
            names=vehicle.input_names,
            instants=ReadingTimes.of(vehicle),
            ever_shown=shown.any(axis=0),
            sigma_light_noise=quality["sigma_beside_gains"].values,
            sigma_light_modelled=quality["sigma_beside_earth"].values,
            dark_sigma=np.where(shown, dark, np.inf),
            sun_up=np.ones(len(shown)),
            earth_share=DEFAULT_EARTH_SHARE if unseen else quality.attrs["earth_light"],
        )
        return panels, quality["why"].values.astype(object)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Return the names of the panels that count in no sample: dead, or never in the Sun; empty if that is all of them."""
        silent = np.flatnonzero(~self.ever_shown)
        return tuple(self.names[k] for k in silent) if len(silent) < len(self.names) else ()

    def placed(self, surroundings: Surroundings) -> Self:
        """Return the panels in the surroundings that an orbit gives: with the Earth's shadow and the Earth's light.

        In the shadow all panels are predicted dark, so that these samples do not show the direction of the Sun. At the edge of the
        shadow, where the along-track error of the orbit leaves open whether the Sun is up, the brightness is free.
        """
        placed = self
        if surroundings.albedo_light_N is not None:
            # a share of zero: the file does not determine how much light there is
            share = self.earth_share or DEFAULT_EARTH_SHARE
            placed = replace(self, known_N=surroundings.albedo_light_N, earth_share=share)
        lit, lit_sigma = surroundings.lit, surroundings.lit_sigma
        if lit is None or lit_sigma is None:
            return placed
        dark = lit + lit_sigma < LEAST_SUN_FRACTION
        # At the edge the sample counts as in the Sun. Its factor is as free as that of a sample whose power is limited.
        at_edge = ~dark & (lit - lit_sigma < 1 - LEAST_SUN_FRACTION)
        free = np.maximum(self.scale_sigma, LIMITED_SCALE)
        return replace(
            placed,
            sun_up=np.where(dark, 0.0, 1.0),
            scale_sigma=np.where(at_edge, free, self.scale_sigma),
            **{
                name: np.where(dark[:, None], self.dark_sigma, getattr(self, name))
                for name in ("sigma", "sigma_light_noise", "sigma_light_modelled")
            },
        )

    def of_pass(self, t_s: np.ndarray) -> Self:
        """Return the panels of a pass, with the Earth's light as an unknown of the pass, unless it is faint."""
        if self.earth_share <= FAINT:
            return self
        earth = EarthLight.prior(t_s, self.earth_share, self.full_sun, self.known_N)
        return replace(self, sigma=self.sigma_light_modelled, earth=earth)

    def take(self, samples: Any) -> Self:
        """Return the panels at some samples, by index or slice."""
        earth = None if self.earth is None else self.earth.take(samples)
        return replace(super().take(samples), earth=earth)

    def present(self) -> np.ndarray:
        """Return which samples (n) have a reading that counts, and the Sun up."""
        return np.any(np.isfinite(self.sigma), axis=1) & (self.sun_up > 0)

    def freedom(self) -> np.ndarray:
        """Return the degrees of freedom of each sample (n): the number of panels that were read."""
        return np.isfinite(self.sigma).sum(axis=1)

    @property
    def full_sun(self) -> np.ndarray:
        """Return the reading of each panel (p) that faces the Sun, at a scale of one."""
        return self.gain * self.response.power(self.response.facing_B).diagonal()

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the unknowns in their order: errors of the gains, Earth's light, tilts. Gain i is error i, not panel i."""
        sizes = np.linalg.norm(self.gain_errors, axis=1)
        gains = tuple(
            Unknown(f"gain_{i}", "gain", "1", 0.0, float(size), i, INERTIA_SIGMAS)
            for i, size in enumerate(sizes)
        )
        earth = () if self.earth is None else self.earth.unknowns(self.names)
        # last, so that a fit may begin with the values of a model without tilts
        tilts = tuple(
            Unknown(
                f"tilt_{name}_{axis}", "tilt", "rad", 0.0, self.tilt_sigma, i, shares=TILT_SHARES
            )
            for i, (name, axis) in enumerate(product(self.names, (0, 1)))
        )
        return (*gains, *earth, *(tilts if self.tilt_sigma else ()))

    @property
    def gain_slice(self) -> slice:
        """Return the slice of the errors of the gains among the unknowns."""
        return slice(0, len(self.gain_errors))

    @property
    def earth_slice(self) -> slice:
        """Return the slice of the Earth's light among the unknowns: behind the gains, before two tilts of each panel."""
        return slice(len(self.gain_errors), -2 * len(self.names) if self.tilt_sigma else None)

    def tilt_axes(self) -> np.ndarray:
        """Return the axes of the tilts of each panel: two unit vectors (p, 2, 3) across its normal."""
        attitude = facing(self.response.facing_B)
        # the first two columns are across the third, the normal
        return np.swapaxes(attitude[..., :2], -1, -2)

    def first_guess(self, states: States, about_sun: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return attitudes (K, n, 3, 3) and unknowns (K, m) from which a fit of the motions `states` of a search begins.

        A search does not know the Earth's light, so its direction to the Sun is that of the vector sum of sunlight and Earth's
        light. Several values of the Earth's light are tried for each motion, each with the attitudes that it corrects; the one of
        lowest cost is returned (`EarthLight.first_guess`). All other unknowns are zero. `about_sun`: as in `Term.first_guess`.
        """
        attitude, u = super().first_guess(states, about_sun)
        if self.earth is None:
            return attitude, u
        earth_slice = self.earth_slice

        def cost(u_earth: np.ndarray, trial_attitude: np.ndarray) -> np.ndarray:
            """Return the cost (K) of Earth's light `u_earth` (K, b + p; see `EarthLight`) at attitudes (K, n, 3, 3)."""
            trial_u = u.copy()
            trial_u[:, earth_slice] = u_earth
            (residual,) = self.residuals(States(trial_attitude, states.omega), trial_u)
            # `law` returns cost and weight of each sample
            return residual.law(residual.value)[0].sum(axis=1)

        attitude, u[:, earth_slice] = self.earth.first_guess(attitude, cost, about_sun=about_sun)
        return attitude, u

    def for_search(self) -> list[Self]:
        """Return the panels without unknowns; the errors of the gains are added to the sigmas of the readings.

        With Earth's light, readings of opposite panels are replaced by their difference (`with_pair_differences`), and the factor
        of a sample may be off by the share of that light. Panels in one plane are returned a second time with another full scale,
        if their brightest samples contradict the stated one.
        """
        # relative sigma of the gain of each panel (p)
        gain_sigma = np.linalg.norm(self.gain_errors, axis=0) / np.maximum(self.gain, 1e-300)
        power, sigma, scale_sigma = self.power, self.sigma_light_noise, self.scale_sigma
        if self.earth is not None:
            power, sigma = with_pair_differences(
                self.response.facing_B, self.full_sun, power, self.sigma_light_modelled, sigma
            )
            scale_sigma = np.hypot(scale_sigma, self.earth_share)
        sigma = np.hypot(sigma, np.nan_to_num(power) * gain_sigma)
        without_unknowns = replace(self, gain_errors=self.gain_errors[:0], earth=None)
        for_search = replace(without_unknowns, power=power, sigma=sigma, scale_sigma=scale_sigma)
        if self.blind_axis() is None:
            return [for_search]
        # The root of the sum of squares of panels on four sides is full Sun only if the Sun is in their plane. If the brightest
        # samples do not reach it, either the Sun never came into the plane, or the full scale is wrong: both are searched.
        share = np.nan_to_num(self.power) / self.full_sun / self.scale[:, None]
        share = np.where(np.isfinite(self.sigma), share, 0.0)
        brightest = float(np.quantile(np.linalg.norm(share, axis=1), FULL_SUN_QUANTILE))
        if abs(brightest - 1) < SCALE_TOLERANCE:
            return [for_search]
        return [for_search, replace(for_search, gain=self.gain * brightest)]

    def with_fixed_unknowns(self, u: np.ndarray) -> Self:
        """Return the panels without unknowns: with the gains of u (m), in sigmas, and the Earth's light treated as in a search."""
        gain = self.gain + u[self.gain_slice] @ self.gain_errors
        known = replace(self, gain=gain, gain_errors=self.gain_errors[:0])
        return known if self.earth is None else known.for_search()[0]

    def loosened(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        """Return the panels with larger sigmas, for a motion whose attitude is off by `drift_rad` (n).

        A reading then changes by at most full Sun per radian, as it follows the cosine of the angle to the Sun.
        """
        change = drift_rad[:, None] * self.full_sun * self.scale[:, None]
        return replace(
            self,
            sigma=np.hypot(self.sigma, change),
            sigma_light_noise=np.hypot(self.sigma_light_noise, change),
            sigma_light_modelled=np.hypot(self.sigma_light_modelled, change),
        )

    def with_errors_of(self, fitted: Self) -> Self:
        """Return the panels with the tilts as unknowns if they are so in a fitted model."""
        return replace(self, tilt_sigma=fitted.tilt_sigma)

    def log_errors(self) -> float:
        """Return twice the log of the sigmas, averaged over the panels of a sample and summed over the samples."""
        counted = np.isfinite(self.sigma)
        log = np.log(np.where(counted, self.sigma, 1.0)).sum(axis=1)
        return float(2 * (log / np.maximum(counted.sum(axis=1), 1)).sum())

    def blind_axis(self) -> np.ndarray | None:
        """Return the normal (3) of the plane in which all panels with readings look, or None (the function :func:`blind_axis`)."""
        return blind_axis(self.response, np.any(np.isfinite(self.sigma), axis=0))

    def images(self) -> np.ndarray:
        """Return the mirrors and rotations (j, 3, 3) of the body that hardly change the readings, the identity first."""
        return images(self.response, np.any(np.isfinite(self.sigma), axis=0))

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield predicted less read powers and, last, the factor's distance from its prior (K, n, p + 1), in sigmas.

        The factor of each sample is the one that fits best (variable projection, see the module).
        """
        if not np.isfinite(self.sigma).any():
            return
        predicted, slopes = self._predicted(states, u)
        # All that follows is in sigmas: difference = factor * shape - target. Row p + 1 is the prior of the factor, with 1 /
        # scale_sigma as shape and target. The sum of squares is least at factor = shape . target / shape . shape. No factor is
        # negative.
        inverse = np.where(np.isfinite(self.sigma), 1 / self.sigma, 0.0)
        size = inverse * self.scale[:, None]
        prior = np.broadcast_to((1 / self.scale_sigma)[:, None], (*predicted.shape[:2], 1))
        shape = np.concatenate([predicted * size, prior], axis=-1)
        target = np.concatenate([np.nan_to_num(self.power) * inverse, prior[0]], axis=-1)
        square = np.einsum("knp,knp->kn", shape, shape)[..., None]
        factor = np.maximum(np.einsum("knp,np->kn", shape, target)[..., None] / square, 0.0)

        # Kaufman's slope: the change of the shape without its part along the shape, which the factor compensates. The row of the
        # prior does not change with motion or unknowns.
        unchanged = np.zeros((*slopes.shape[:2], 1, slopes.shape[-1]))
        slopes = np.concatenate([size[..., None] * slopes, unchanged], axis=-2) * factor[..., None]
        along = np.einsum("knp,knpi->kni", shape, slopes) / square
        slopes = slopes - shape[..., None] * along[..., None, :]
        by_u = slopes[..., 3:] if u.size else None
        yield Residual(factor * shape - target, by_turn=slopes[..., :3], by_u=by_u)

    def _predicted(self, states: States, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the readings (K, n, p) at a factor and a scale of one, and their derivatives (K, n, p, 3 + m).

        The derivatives are by a turn of the body, then by the unknowns u (K, m).
        """
        gain = (self.gain + u[:, self.gain_slice] @ self.gain_errors)[:, None]
        sunlight, sunlight_by_turn = self._sunlight(states, gain)
        by_tilt = []
        if self.tilt_sigma:
            # A panel that is rotated alone reads as if the body were rotated so. Index a: the two axes of the tilts of a panel.
            panel = np.arange(len(self.names))
            slope = np.einsum(
                "knpi,pai->knpa", sunlight_by_turn, self.tilt_sigma * self.tilt_axes()
            )
            slope = slope * self.sun_up[:, None, None]
            tilts = u[:, -2 * len(panel) :].reshape(len(u), len(panel), 2)
            sunlight = sunlight + np.einsum("knpa,kpa->knp", slope, tilts)
            # derivatives of each panel by the tilts of each panel: only those by its own are not zero
            by_tilt_of = np.zeros((*slope.shape[:3], len(panel), 2))
            by_tilt_of[:, :, panel, panel] = slope
            by_tilt = [by_tilt_of.reshape(*slope.shape[:3], -1)]
        predicted = sunlight * self.sun_up[:, None]
        by_turn = sunlight_by_turn * self.sun_up[:, None, None]
        by_earth, zero = [], 0.0
        if self.earth is not None:
            u_earth = u[:, self.earth_slice]
            earthlight, slopes = self.earth.on_panels(self.response, gain, states.attitude, u_earth)
            predicted, by_turn = predicted + earthlight, by_turn + slopes[..., :3]
            by_earth, zero = [slopes[..., 3:]], self.earth.zero(u_earth)
        # Light is proportional to the gain, a zero is not: it is added after the derivative by the gain.
        by_gain = (predicted / np.where(gain == 0, 1e-300, gain))[..., None] * self.gain_errors.T
        slopes = np.concatenate([by_turn, by_gain, *by_earth, *by_tilt], axis=-1)
        return predicted + zero, slopes

    def _sunlight(self, states: States, gain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the readings (K, n, p) of full Sun at the instants of the readings, and their derivatives (K, n, p, 3) by a turn.

        `gain` (K, 1, p), or (K, n, p) if it changes. The Sun is moved from the time of the row to that of the reading at a constant
        rate. The derivative by the rate is neglected.
        """
        light, by_turn = 0.0, 0.0
        # a turn t of the body moves the Sun in body axes by sun x t
        row_sun_by_turn = cross_matrix(states.sun_B)
        for shift, weight in self.instants.shifts():
            sun, sun_by_turn = states.sun_B, row_sun_by_turn
            if shift:
                # the Sun and its derivatives, column by column, rotate in body axes until the reading
                sun = components_after_rotation(sun, shift * states.omega)
                columns = np.swapaxes(row_sun_by_turn, -1, -2)
                columns = components_after_rotation(columns, shift * states.omega[..., None, :])
                sun_by_turn = np.swapaxes(columns, -1, -2)
            power, by_sun, _ = self.response.slopes(sun, gain=gain)
            light = light + weight * power
            by_turn = by_turn + weight[:, None] * (by_sun @ sun_by_turn)
        return np.asarray(light), np.asarray(by_turn)


def blind_axis(response: PanelResponse, was_read: np.ndarray) -> np.ndarray | None:
    """Return the normal (3) of a plane of which the readings do not show on which side the Sun is, or None.

    That is the plane of the normals of all panels with readings (`was_read` (p)). None: these do not lie in one plane, or a reading
    changes if the Sun is mirrored in the plane.
    """
    singular_values, axes = np.linalg.svd(response.facing_B[was_read])[1:]
    # one value: the normals span a line; three: they span space
    if np.count_nonzero(singular_values > TINY) != 2:
        return None
    across = axes[2]
    # the response need not be that of flat panels, so the mirrored Sun is tried
    sun_B = sphere(N_SUN_DIRECTIONS)
    mirrored = sun_B - 2 * (sun_B @ across)[:, None] * across
    change = response.power(mirrored) - response.power(sun_B)
    unchanged = np.abs(change[:, was_read]).max() < TINY * response.largest_power
    return across if unchanged else None


def images(response: PanelResponse, was_read: np.ndarray) -> np.ndarray:
    """Return the mirrors and rotations (j, 3, 3) of the body that hardly change the readings, the identity first.

    `was_read` (p): panels with readings.
    """
    symmetries, axis = response.symmetries, blind_axis(response, was_read)
    if axis is None:
        return symmetries
    mirrored = symmetries @ (np.eye(3) - 2 * np.outer(axis, axis))
    new = [image for image in mirrored if np.abs(symmetries - image).max(axis=(1, 2)).min() > TINY]
    return np.concatenate([symmetries, np.reshape(new, (-1, 3, 3))])

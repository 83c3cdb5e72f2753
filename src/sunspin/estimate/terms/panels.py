"""Powers or currents of solar panels. By what law they see light only the vehicle's response knows.

The reading of panel p at a sample is predicted as

    factor * scale * (gain_p * (sun_up * sunlight_p + earthlight_p) + zero_p)

Gains are unknowns of a pass; Earth's light and zeros are too, if there is such light (:mod:`.earth_light`). The factor, near one,
is what distance to the Sun, temperature and battery do to all readings of a sample alike. It is no unknown of the fit: for each
motion it is put at its best (variable projection, Kaufman 1975, BIT 15, 49). Its prior, (factor - 1) / scale_sigma, is one more
residual, so that a factor known, half known and free are one formula.
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

AVERAGED = np.polynomial.legendre.leggauss(3)
"""Instants, from -1 to 1, and weights for a mean over time: exact to fifth powers."""

LEAST_LIT, DARK = 0.01, 0.03
"""Part of the Sun's disc below which it is down; and what panels read in the shadow in addition to their noise, as a share of full
Sun: zeros of converters."""

UNKNOWN_SHARE = 0.09
"""Light on a panel that looks at the Earth, in full Suns, if an orbit says where it comes from and the file does not say how much
it is: what :data:`sunspin.telemetry.quality.ALBEDO_DEFAULT` of panels that face away from the Sun means."""

FLAT, LOOKS = 1e-6, 500
"""Normals out of one plane by less than the first may see no difference between a Sun on either side of it; directions in which
that is tried."""

TILT, TILT_SHARES = 0.1, (1.0, 0.4, 0.16)
"""Sigma (rad) of the angle between a panel and its stated direction if the readings deny that direction, and other sizes of it, as
factors: 5.7, 2.3 and 0.9 degrees."""

BRIGHTEST, OTHER_SCALE = 0.95, 0.1
"""Quantile of brightness that is full Sun if the Sun comes near the plane of the panels; how far from it another full scale is
tried."""


class ReadingTimes(NamedTuple):
    """When panels are read: `offset_s` (n_input) after the time of their row, as a mean over `averaged_s` about that instant."""

    offset_s: np.ndarray
    averaged_s: float = 0.0

    @classmethod
    def of(cls, vehicle: Vehicle) -> ReadingTimes:
        """Return those of the vehicle file."""
        form = vehicle.telemetry
        offsets = np.array([form.offset_s.get(name, 0.0) for name in vehicle.input_names])
        return cls(offsets, form.averaged_s)

    def shifts(self) -> Iterator[tuple[float, np.ndarray]]:
        """Yield each instant, s after the time of the row, with the weights (n_input) that it has in the readings."""
        at_once = np.zeros(1), 2 * np.ones(1)
        for offset in np.unique(self.offset_s):
            for node, weight in zip(*(AVERAGED if self.averaged_s else at_once), strict=True):
                shift = float(offset + node * self.averaged_s / 2)
                yield shift, weight / 2 * (self.offset_s == offset)


@dataclass(frozen=True)
class Panels(Term):
    """Readings `power` (n, p) with the `sigma` (n, p) that counts, infinite where nothing was read.

    `gain` (p): factors on the gains of the `response`; `gain_errors` (e, p): one sigma of each independent error of them.
    `scale` (n) with `scale_sigma` (n), relative: the factor of all readings of a sample. `names` (p); `ever_shown` (p): whether a
    panel counts in any sample of the file.

    `earth_share`: the Earth's light on sides that look at the Earth, as a share of full Sun; `earth`: its model for one pass, None
    if there is none. `sigma_light_noise` (n, p): sigmas with that light as noise, which count without a model;
    `sigma_light_modelled` (n, p): those that count with it. `known_N` (n, 3): the light that an orbit predicts, None without one.

    `sun_up` (n): 1 in the Sun, 0 in the Earth's shadow; `dark_sigma` (n, p): sigmas of readings in the shadow. `tilt_sigma` (rad):
    of the angle between each panel and its stated direction, about each of two axes; zero if they are as stated.
    """

    name: ClassVar[str] = "panels"
    label: ClassVar[str] = "Sun"
    of_sun: ClassVar[bool] = True
    per_sample: ClassVar[tuple[str, ...]] = (
        "power",
        "sigma",
        "sigma_light_noise",
        "sigma_light_modelled",
        "dark_sigma",
        "scale",
        "scale_sigma",
        "sun_up",
        "known_N",
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
        """Return the panels of telemetry, and what became of each sample (n), in words: used, or why it was dropped."""
        vehicle, quality = assessment.vehicle, assessment.quality
        # errors of the gains are correlated: rows of the transposed Cholesky factor of their covariance are independent ones
        errors = np.linalg.cholesky(quality["gain_cov"].values).T / vehicle.input_gains
        shown = quality["reading"].values & ~quality["dead"].values
        zeros = DARK * quality.attrs["full_sun"] * quality["gain"].values
        dark = np.hypot(quality["noise"].values, zeros)
        panels = cls(
            power=signals(assessment.telemetry),
            sigma=quality["sigma_beside_gains"].values,  # until `of_pass` models the Earth's light
            response=vehicle.response_in(),
            gain=quality["gain"].values / vehicle.input_gains,
            gain_errors=errors,
            scale=quality["scale"].values,
            scale_sigma=quality["scale_sigma"].values,
            names=vehicle.input_names,
            instants=ReadingTimes.of(vehicle),
            ever_shown=shown.any(axis=0),
            sigma_light_noise=quality["sigma_beside_gains"].values,
            sigma_light_modelled=quality["sigma_beside_earth"].values,
            dark_sigma=np.where(shown, dark, np.inf),
            sun_up=np.ones(len(shown)),
            earth_share=quality.attrs["earth_light"],
        )
        return panels, quality["why"].values.astype(object)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Panels that count in no sample: dead, or never in the Sun; none if all are so."""
        silent = np.flatnonzero(~self.ever_shown)
        return tuple(self.names[k] for k in silent) if len(silent) < len(self.names) else ()

    def placed(self, surroundings: Surroundings) -> Self:
        """Return the panels with what an orbit says of their surroundings: whether the Sun is up, and the Earth's light.

        In the shadow panels must be dark, and say no more. Where the along-track offset of the orbit leaves open whether the Sun is
        up, the brightness of the sample is free.
        """
        placed = self
        if surroundings.albedo_light_N is not None:
            # without opposite panels the file does not say how much light there is
            share = self.earth_share or UNKNOWN_SHARE
            placed = replace(self, known_N=surroundings.albedo_light_N, earth_share=share)
        lit, lit_sigma = surroundings.lit, surroundings.lit_sigma
        if lit is None or lit_sigma is None:
            return placed
        dark = lit + lit_sigma < LEAST_LIT
        # neither surely in the shadow nor surely in the Sun: taken as in the Sun, with a brightness as free as that of a sample of
        # limited power
        at_edge = ~dark & (lit - lit_sigma < 1 - LEAST_LIT)
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
        """Return the panels with the Earth's light as an unknown, unless it is faint."""
        if self.earth_share <= FAINT:
            return self
        earth = EarthLight.prior(t_s, self.earth_share, self.full_sun, self.known_N)
        return replace(self, sigma=self.sigma_light_modelled, earth=earth)

    def take(self, samples: Any) -> Self:
        """Return the panels at some samples."""
        earth = None if self.earth is None else self.earth.take(samples)
        return replace(super().take(samples), earth=earth)

    def present(self) -> np.ndarray:
        """Return which samples (n) have a reading that counts, and the Sun up."""
        return np.any(np.isfinite(self.sigma), axis=1) & (self.sun_up > 0)

    def freedom(self) -> np.ndarray:
        """Return how many panels of each sample (n) were read."""
        return np.isfinite(self.sigma).sum(axis=1)

    @property
    def full_sun(self) -> np.ndarray:
        """Return what each panel (p) reads if it faces the Sun at scale one, in the unit of the readings."""
        return self.gain * self.response.power(self.response.facing_B).diagonal()

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the independent errors of the gains, the Earth's light and the tilts. Gain i is error i, not panel i."""
        sizes = np.linalg.norm(self.gain_errors, axis=1)
        gains = tuple(
            Unknown(f"gain_{i}", "gain", "1", 0.0, float(size), i, INERTIA_SIGMAS)
            for i, size in enumerate(sizes)
        )
        earth = () if self.earth is None else self.earth.unknowns(self.names)
        # last, so that a fit may begin with the unknowns of panels without tilts
        tilts = tuple(
            Unknown(
                f"tilt_{name}_{axis}", "tilt", "rad", 0.0, self.tilt_sigma, i, shares=TILT_SHARES
            )
            for i, (name, axis) in enumerate(product(self.names, (0, 1)))
        )
        return (*gains, *earth, *(tilts if self.tilt_sigma else ()))

    @property
    def gain_slice(self) -> slice:
        """Return where the errors of the gains stand among the unknowns."""
        return slice(0, len(self.gain_errors))

    @property
    def earth_slice(self) -> slice:
        """Return where the unknowns of the Earth's light stand: behind the gains."""
        return slice(len(self.gain_errors), -2 * len(self.names) if self.tilt_sigma else None)

    def tilt_axes(self) -> np.ndarray:
        """Return two unit vectors (p, 2, 3) across the direction in which each panel looks, about which it may be turned."""
        attitude = facing(self.response.facing_B)
        return np.swapaxes(attitude[..., :2], -1, -2)

    def begin(self, states: States, about_sun: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return attitudes (K, n, 3, 3) and unknowns (K, m) from which a fit begins: the Earth's light is separated from the Sun's.

        A search takes both lights together for the Sun. Of some first guesses of the Earth's light (`EarthLight.begin`) the one
        that fits best counts. `about_sun` as in `Term.begin`.
        """
        attitude, u = super().begin(states, about_sun)
        if self.earth is None:
            return attitude, u
        earth_slice = self.earth_slice

        def cost(u_earth: np.ndarray, turned: np.ndarray) -> np.ndarray:
            """Return the cost (K) of unknowns of the light (K, b + p) at attitudes (K, n, 3, 3)."""
            trial = u.copy()
            trial[:, earth_slice] = u_earth
            (residual,) = self.residuals(States(turned, states.omega), trial)
            return residual.law(residual.value)[0].sum(axis=1)

        attitude, u[:, earth_slice] = self.earth.begin(attitude, cost, about_sun)
        return attitude, u

    def for_search(self) -> list[Self]:
        """Return the panels without unknowns: the errors of the gains are added to the sigmas of the readings.

        Under the Earth's light only the differences of opposite panels count, which that light leaves as they are, and the factor
        of a sample may be off by its share. Panels in one plane are returned twice if they may have another full scale.
        """
        gain_sigma = np.linalg.norm(self.gain_errors, axis=0) / np.maximum(self.gain, 1e-300)
        power, sigma, scale_sigma = self.power, self.sigma_light_noise, self.scale_sigma
        if self.earth is not None:
            modelled = self.power, self.sigma_light_modelled
            power, sigma = with_pair_differences(
                self.response.facing_B, self.full_sun, modelled, self.sigma_light_noise
            )
            scale_sigma = np.hypot(scale_sigma, self.earth_share)
        sigma = np.hypot(sigma, np.nan_to_num(power) * gain_sigma)
        loose = replace(
            self,
            power=power,
            sigma=sigma,
            scale_sigma=scale_sigma,
            gain_errors=self.gain_errors[:0],
            earth=None,
        )
        if self.blind_axis() is None:
            return [loose]
        # Panels around four sides read full Sun, in the root of the sum of squares, only if the Sun comes into their plane. If the
        # brightest samples do not, either it never came there, or the full scale is wrong: both are searched.
        share = np.nan_to_num(self.power) / self.full_sun / self.scale[:, None]
        share = np.where(np.isfinite(self.sigma), share, 0.0)
        brightest = float(np.quantile(np.linalg.norm(share, axis=1), BRIGHTEST))
        if abs(brightest - 1) < OTHER_SCALE:
            return [loose]
        return [loose, replace(loose, gain=self.gain * brightest)]

    def held(self, u: np.ndarray) -> Self:
        """Return the panels without unknowns: gains that are off by u (m) sigmas, and the Earth's light as in a search."""
        gain = self.gain + u[self.gain_slice] @ self.gain_errors
        known = replace(self, gain=gain, gain_errors=self.gain_errors[:0])
        return known if self.earth is None else known.for_search()[0]

    def loosened(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        """Return the panels with their errors enlarged by the most that a start that is off by drifts (n), rad, changes a reading.

        That is full Sun for each radian, as the cosine of the angle to the Sun changes.
        """
        drift = drift_rad[:, None] * self.full_sun * self.scale[:, None]
        return replace(
            self,
            sigma=np.hypot(self.sigma, drift),
            sigma_light_noise=np.hypot(self.sigma_light_noise, drift),
            sigma_light_modelled=np.hypot(self.sigma_light_modelled, drift),
        )

    def with_errors_of(self, fitted: Self) -> Self:
        """Return the panels with the tilts that they have in a fitted model."""
        return replace(self, tilt_sigma=fitted.tilt_sigma)

    def log_errors(self) -> float:
        """Return twice the sum over the samples of the mean log of the errors of their readings."""
        counted = np.isfinite(self.sigma)
        log = np.log(np.where(counted, self.sigma, 1.0)).sum(axis=1)
        return float(2 * (log / np.maximum(counted.sum(axis=1), 1)).sum())

    def blind_axis(self) -> np.ndarray | None:
        """Return the normal (3) of the plane in which all panels with readings look, if no reading tells on which side the Sun is.

        None if they do not look in one plane, or if a mirror image of the Sun in that plane changes a reading.
        """
        was_read = np.isfinite(self.sigma).any(axis=0)
        size, axes = np.linalg.svd(self.response.facing_B[was_read])[1:]
        if np.count_nonzero(size > FLAT) != 2:  # the normals span a line, or space
            return None
        across = axes[2]
        # panels need not be flat: try whether a Sun mirrored in the plane changes a reading
        around = sphere(LOOKS)
        mirrored = around - 2 * (around @ across)[:, None] * across
        change = self.response.power(mirrored) - self.response.power(around)
        alike = np.abs(change[:, was_read]).max() < FLAT * self.response.largest_power
        return across if alike else None

    def images(self) -> np.ndarray:
        """Return mirrors and rotations (m, 3, 3) of the body that change no reading, or little, the identity first."""
        images, axis = self.response.symmetries, self.blind_axis()
        if axis is None:
            return images
        mirrored = images @ (np.eye(3) - 2 * np.outer(axis, axis))
        new = [image for image in mirrored if np.abs(images - image).max(axis=(1, 2)).min() > FLAT]
        return np.concatenate([images, np.reshape(new, (-1, 3, 3))])

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield predicted less read powers (K, n, p) and, last, the factor's distance from its prior; all in sigmas."""
        if not np.isfinite(self.sigma).any():
            return
        # `predicted`: what a factor and a scale of one would read (K, n, p); its slopes (..., 3 + m) by a turn and by the unknowns
        gain = (self.gain + u[:, self.gain_slice] @ self.gain_errors)[:, None]
        sunlight, sunlight_by_turn = self._sunlight(states, gain)
        by_tilt = []
        if self.tilt_sigma:
            # a panel that is turned alone reads what it would read if the body were turned so
            panel = np.arange(len(self.names))
            slope = np.einsum(
                "knpi,pai->knpa", sunlight_by_turn, self.tilt_sigma * self.tilt_axes()
            )
            slope = slope * self.sun_up[:, None, None]
            tilts = u[:, -2 * len(panel) :].reshape(len(u), len(panel), 2)
            sunlight = sunlight + np.einsum("knpa,kpa->knp", slope, tilts)
            own = np.zeros((*slope.shape[:3], len(panel), 2))
            own[:, :, panel, panel] = slope
            by_tilt = [own.reshape(*slope.shape[:3], -1)]
        predicted = sunlight * self.sun_up[:, None]
        by_turn = sunlight_by_turn * self.sun_up[:, None, None]
        by_earth, zero = [], 0.0
        if self.earth is not None:
            u_earth = u[:, self.earth_slice]
            earthlight, slopes = self.earth.on_panels(self.response, gain, states.attitude, u_earth)
            predicted, by_turn = predicted + earthlight, by_turn + slopes[..., :3]
            by_earth, zero = [slopes[..., 3:]], self.earth.zero(u_earth)
        # light is proportional to the gain, a zero is not
        by_gain = (predicted / np.where(gain == 0, 1e-300, gain))[..., None] * self.gain_errors.T
        predicted = predicted + zero
        slopes = np.concatenate([by_turn, by_gain, *by_earth, *by_tilt], axis=-1)

        # All that follows is in sigmas, with the prior of the factor as row p + 1: difference = factor * shape - target. Its square
        # is least at factor = shape . target / shape . shape. No factor is negative.
        inverse = np.where(np.isfinite(self.sigma), 1 / self.sigma, 0.0)
        size = inverse * self.scale[:, None]
        prior = np.broadcast_to((1 / self.scale_sigma)[:, None], (*predicted.shape[:2], 1))
        shape = np.concatenate([predicted * size, prior], axis=-1)
        target = np.concatenate([np.nan_to_num(self.power) * inverse, prior[0]], axis=-1)
        square = np.einsum("knp,knp->kn", shape, shape)[..., None]
        factor = np.maximum(np.einsum("knp,np->kn", shape, target)[..., None] / square, 0.0)

        # Kaufman's slope: the change of the shape without its part along the shape, which the factor takes up
        still = np.zeros((*slopes.shape[:2], 1, slopes.shape[-1]))  # the prior's row does not move
        slopes = np.concatenate([size[..., None] * slopes, still], axis=-2) * factor[..., None]
        along = np.einsum("knp,knpi->kni", shape, slopes) / square
        slopes = slopes - shape[..., None] * along[..., None, :]
        yield Residual(
            factor * shape - target,
            by_turn=slopes[..., :3],
            by_u=slopes[..., 3:] if u.size else None,
        )

    def _sunlight(self, states: States, gain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return readings (K, n, p) of full Sun and their derivative (K, n, p, 3) by a turn, at the instants of the readings.

        The Sun is moved from the time of the row to that of the reading by the rate. That the derivative depends on the rate is
        left out.
        """
        light, by_turn = 0.0, 0.0
        across = cross_matrix(states.sun_B)  # a turn t of the body moves the Sun by sun x t
        for shift, weight in self.instants.shifts():
            sun, moves = states.sun_B, across
            if shift:
                # the Sun, and column by column what moves it, as the body turns until the reading
                sun = components_after_rotation(sun, shift * states.omega)
                columns = np.swapaxes(across, -1, -2)
                moves = components_after_rotation(columns, shift * states.omega[..., None, :])
                moves = np.swapaxes(moves, -1, -2)
            power, by_sun, _ = self.response.slopes(sun, gain=gain)
            light = light + weight * power
            by_turn = by_turn + weight[:, None] * (by_sun @ moves)
        return np.asarray(light), np.asarray(by_turn)

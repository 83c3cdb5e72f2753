"""Solar panels as seen by `rates`: their powers, a factor of each sample's being unknown, gains off, the Earth's light beside.

By what law they see light only the vehicle's response knows (:mod:`sunspin.vehicle.response`).
The factor of a sample (distance, temperature, battery) is put at its best for each hypothesis (variable projection). Gains that the
brightness of all samples determines are considered in the result's error; those that it does not are unknowns of a pass.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple, Self

import numpy as np

from sunspin.environment import Surroundings
from sunspin.estimate.terms import gains
from sunspin.estimate.terms.earth_light import EarthLight, pairs_differing
from sunspin.estimate.terms.term import Residual, Seen, SunTerm, Unknown, normal
from sunspin.solve.rotations import components_after_rotation, cross_matrix
from sunspin.telemetry.assess import Assessment
from sunspin.telemetry.gains import FAINT
from sunspin.telemetry.quality import LIMITED_SCALE
from sunspin.telemetry.signals import signals
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.flat import PanelResponse
from sunspin.vehicle.response.planes import sphere

FLAT, LOOKS = 1e-6, 500
"""Panels that look out of one plane by less than this may see no difference between a Sun on either side of it; and in how many
directions that is tried."""

BRIGHTEST, OTHER_SCALE = 0.95, 0.1
"""Quantile of brightness that is full Sun if the Sun comes near the plane of the panels, and how far from it another is tried."""


LEAST_LIT, DARK = 0.01, 0.03
"""Part of the Sun's disc below which it is down; and what panels read in the shadow beside their noise, as a share of full Sun:
zeros of converters."""

UNTOLD_SHARE = 0.09
"""Earth's light in full Suns on a panel that looks there, if an orbit says where it comes from and the file does not tell how much
it is: what :data:`sunspin.telemetry.quality.ALBEDO_DEFAULT` of panels that face away from the Sun means."""

AVERAGED = np.polynomial.legendre.leggauss(3)
"""Instants, from -1 to 1, and weights for a mean over time: exact to fifth powers."""


class Instants(NamedTuple):
    """When panels are read: `offset_s` (n_input) after their row's time, over `averaged_s` about that instant."""

    offset_s: np.ndarray
    averaged_s: float = 0.0

    @classmethod
    def of(cls, vehicle: Vehicle) -> Instants:
        form = vehicle.telemetry
        return cls(
            np.array([form.offset_s.get(name, 0.0) for name in vehicle.input_names]),
            form.averaged_s,
        )

    def shifts(self) -> Iterator[tuple[float, np.ndarray]]:
        """Each instant, s from the row's time, with the weights (n_panel) that it has in the panels' readings."""
        whole = (np.zeros(1), 2 * np.ones(1))
        for offset in np.unique(self.offset_s):
            for place, weight in zip(*(AVERAGED if self.averaged_s else whole), strict=True):
                yield (
                    float(offset + place * self.averaged_s / 2),
                    weight / 2 * (self.offset_s == offset),
                )


@dataclass(frozen=True)
class Panels(SunTerm):
    """Powers (n, n_panel), or of each hypothesis (K, n, n_panel), with sigmas (n, n_panel), infinite where nothing was read.

    `gain` (n_panel): factors on the gains of the response; `gain_errors`, `gain_unknowns` (m, n_panel): one sigma of their errors
    in common that are considered, and of those that are estimated. `scale` (n), `scale_sigma` (n): the factor of all powers of a
    sample and its relative uncertainty. `earth_share`: how much of full Sun a panel gets that looks at the Earth, where no fit
    estimates it; for those that do, `earth`, and `whole` (power, sigma, scale_sigma): what was read beside it, and how well.
    `lit` (n): the part of the Sun that is up; `earth_N` (n, 3): the Earth's light where an orbit knows it, in full Suns;
    `dark_sigma` (n, n_panel): of readings in the Earth's shadow.
    """

    name: ClassVar[str] = "panels"
    called: ClassVar[str] = "Sun"
    per_sample: ClassVar[tuple[str, ...]] = (
        "power",
        "sigma",
        "scale",
        "scale_sigma",
        "lit",
        "dark_sigma",
    )

    power: np.ndarray
    sigma: np.ndarray
    response: PanelResponse
    gain: np.ndarray
    gain_errors: np.ndarray
    gain_unknowns: np.ndarray
    scale: np.ndarray
    scale_sigma: np.ndarray
    earth_share: float
    whole: tuple[np.ndarray, np.ndarray, np.ndarray]
    names: tuple[str, ...]
    instants: Instants
    lit: np.ndarray
    dark_sigma: np.ndarray
    earth: EarthLight | None = None
    earth_N: np.ndarray | None = None

    @classmethod
    def read(cls, assessment: Assessment) -> tuple[Self, np.ndarray]:
        """Those of telemetry, and a sentence for each sample (n)."""
        vehicle, quality = assessment.vehicle, assessment.quality
        errors = gains.errors(vehicle, quality)
        known = np.isfinite(
            quality.attrs["spread"]
        )  # by the brightness of the samples; else only a motion determines the gains
        power, scale_sigma = signals(assessment.telemetry), quality["scale_sigma"].values
        dark_sigma = np.hypot(
            quality["noise"].values, DARK * quality.attrs["full_sun"] * quality["gain"].values
        )
        shown = quality["reading"].values & ~quality["dead"].values
        made = cls(
            power,
            quality["sigma"].values,
            vehicle.response_in(),
            quality["gain"].values / vehicle.input_gains,
            errors[: len(errors) * known],
            errors[len(errors) * known :],
            quality["scale"].values,
            scale_sigma,
            quality.attrs["earth_light"],
            (power, quality["sigma_beside_earth"].values, scale_sigma),
            vehicle.input_names,
            Instants.of(vehicle),
            np.ones(len(power)),
            np.where(shown, dark_sigma, np.inf),
        )
        return made._differing(), quality["why"].values.astype(object)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Panels (inputs) that count in no sample: dead, or never in the Sun."""
        silent = np.flatnonzero(np.isinf(self.dark_sigma).all(axis=0))
        return tuple(self.names[k] for k in silent) if len(silent) < len(self.names) else ()

    def _differing(self) -> Self:
        """For the search: of two opposite panels only their difference, good to what no beam explains."""
        if self.earth_share <= FAINT:
            return self
        power, sigma = pairs_differing(
            self.response.facing_B, self.full, *self.whole[:2], self.power, self.sigma
        )
        return replace(
            self, power=power, sigma=sigma, scale_sigma=np.hypot(self.scale_sigma, self.earth_share)
        )

    def placed(self, here: Surroundings) -> Self:
        """With the Sun up or down, and the Earth's light where it is known. In the shadow panels must be dark, and say no more;
        where the shift of the orbit leaves open whether the Sun is up, the sample's brightness is free."""
        made = self
        if here.albedo_light_N is not None:
            untold = self.earth_share == 0  # no panel has another opposite to it
            made = replace(
                self,
                earth_N=here.albedo_light_N,
                earth_share=UNTOLD_SHARE if untold else self.earth_share,
            )
        if here.lit is None or here.lit_sigma is None:
            return made
        dark = here.lit + here.lit_sigma < LEAST_LIT
        open_ = ~dark & (here.lit - here.lit_sigma < 1 - LEAST_LIT)
        power, sigma, scale_sigma = self.whole
        free = np.maximum(self.scale_sigma, LIMITED_SCALE), np.maximum(scale_sigma, LIMITED_SCALE)
        return replace(
            made,
            lit=np.where(dark, 0.0, 1.0),
            sigma=np.where(dark[:, None], self.dark_sigma, self.sigma),
            scale_sigma=np.where(open_, free[0], self.scale_sigma),
            whole=(
                power,
                np.where(dark[:, None], self.dark_sigma, sigma),
                np.where(open_, free[1], scale_sigma),
            ),
        )

    def take(self, index: np.ndarray | slice) -> Self:
        power, sigma, scale_sigma = (part[index] for part in self.whole)
        earth = None if self.earth is None else self.earth.take(index)
        known = None if self.earth_N is None else self.earth_N[index]
        return replace(
            super().take(index), whole=(power, sigma, scale_sigma), earth=earth, earth_N=known
        )

    def blind(self, index: int) -> Self:
        sigma, beside = self.sigma.copy(), self.whole[1].copy()
        sigma[index], beside[index] = np.inf, np.inf
        return replace(self, sigma=sigma, whole=(self.whole[0], beside, self.whole[2]))

    def present(self) -> np.ndarray:
        return np.any(np.isfinite(self.sigma), axis=1)

    def informs(self) -> np.ndarray:
        return self.present() & (self.lit > 0)

    @property
    def full(self) -> np.ndarray:
        """What each panel (n_panel) gets of a Sun that it looks at."""
        return self.gain * self.response.power(self.response.facing_B).diagonal()

    def freedom(self) -> np.ndarray:
        return np.isfinite(self.sigma).sum(axis=1)

    def log_size(self) -> float:
        sigma = np.where(np.isfinite(self.sigma), self.sigma, self.full)
        return float(np.log(sigma).sum() + np.log(self.scale_sigma).sum())

    def relative(self) -> np.ndarray:
        """Readings (n, n_panel) as shares of full Sun, zero where they say nothing."""
        return (
            np.where(np.isfinite(self.sigma), np.nan_to_num(self.power) / self.full, 0.0)
            / self.scale[:, None]
        )

    def blind_axis(self) -> np.ndarray | None:
        seeing = np.isfinite(self.sigma).any(axis=0)
        size, axes = np.linalg.svd(self.response.facing_B[seeing])[1:]
        if np.count_nonzero(size > FLAT) != 2:
            return None
        around = sphere(LOOKS)
        mirrored = around - 2 * (around @ axes[2])[:, None] * axes[2]
        change = self.response.power(mirrored) - self.response.power(around)
        return (
            axes[2]
            if np.abs(change[:, seeing]).max() < FLAT * self.response.largest_power
            else None
        )

    def images(self) -> np.ndarray:
        return self.response.symmetries

    def wider(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        return replace(
            self, sigma=np.hypot(self.sigma, drift_rad[:, None] * self.full * self.scale[:, None])
        )

    def coarser(self, factor: float | np.ndarray) -> Self:
        """With sigmas so many times those stated: of all samples, or of each (n, 1)."""
        power, sigma, scale_sigma = self.whole
        return replace(self, sigma=factor * self.sigma, whole=(power, factor * sigma, scale_sigma))

    def forgiving(self) -> Self:
        if not len(self.gain_unknowns):
            return self
        unknown = np.linalg.norm(self.gain_unknowns, axis=0) / np.maximum(self.gain, 1e-300)
        return replace(self, sigma=np.hypot(self.sigma, np.nan_to_num(self.power) * unknown))

    def guesses(self) -> list[Self]:
        """Where panels lie in one plane and their brightest samples do not look like full Sun, also with all gains as these samples
        have them: either the Sun never came near the plane, or the full scale is wrong."""
        loose = self.forgiving()
        if self.blind_axis() is None or not len(self.gain_unknowns):
            return [loose]
        full = float(np.quantile(np.linalg.norm(self.relative(), axis=1), BRIGHTEST))
        return (
            [loose]
            if abs(full - 1) < OTHER_SCALE
            else [loose, replace(loose, gain=self.gain * full)]
        )

    def freed(self, t_s: np.ndarray) -> Self:
        """With the beam, and gains that were taken from brightness under it, as unknowns of the pass; the readings whole, and as
        good as they are beside the beam."""
        if self.earth_share <= FAINT:
            return self
        power, sigma, scale_sigma = self.whole
        free = np.concatenate([self.gain_unknowns, self.gain_errors])
        return replace(
            self,
            power=power,
            sigma=sigma,
            scale_sigma=scale_sigma,
            gain_unknowns=free,
            gain_errors=free[:0],
            earth_share=0.0,
            earth=EarthLight.prior(t_s, self.earth_share, self.full, self.earth_N),
        )

    def unknowns(self) -> tuple[Unknown, ...]:
        return (
            *gains.unknowns(self.gain_unknowns),
            *(() if self.earth is None else self.earth.unknowns(self.names)),
        )

    def begin(self, seen: Seen, turned: bool = False) -> tuple[np.ndarray, np.ndarray]:
        error = np.zeros((len(seen.omega), len(self.unknowns())))
        if self.earth is None:
            return seen.attitude, error
        held = len(self.gain_unknowns)

        def cost(lit: np.ndarray, turned: np.ndarray) -> np.ndarray:
            trial = error.copy()
            trial[:, held:] = lit
            return normal(self, Seen(turned, seen.omega), trial)[2].sum(axis=1)

        attitude, error[:, held:] = self.earth.begin(seen.attitude, cost, turned)
        return attitude, error

    def residuals(self, seen: Seen, error: np.ndarray | None = None) -> Iterator[Residual]:
        """The prior of a sample's factor is one more residual, so a factor known, half known and free are one formula."""
        if not np.isfinite(self.sigma).any():
            return
        inverse = np.where(np.isfinite(self.sigma), 1 / self.sigma, 0.0)
        target = np.nan_to_num(self.power) * inverse
        target = np.concatenate(
            [target, np.broadcast_to((1 / self.scale_sigma)[:, None], (*target.shape[:-1], 1))],
            axis=-1,
        )
        light, change = self._light(seen, error)
        shape = light * inverse * self.scale[:, None]
        shape = np.concatenate(
            [shape, np.broadcast_to((1 / self.scale_sigma)[:, None], (*shape.shape[:2], 1))],
            axis=-1,
        )
        size = (shape**2).sum(axis=-1, keepdims=True)
        best = np.maximum((shape * target).sum(axis=-1, keepdims=True) / size, 0.0)
        change = (inverse * self.scale[:, None])[..., None] * change
        change = (
            np.concatenate([change, np.zeros((*change.shape[:2], 1, change.shape[-1]))], axis=-2)
            * best[..., None]
        )
        unit = shape / np.sqrt(size)
        change = (
            change - unit[..., None] * np.einsum("...m,...mi->...i", unit, change)[..., None, :]
        )
        yield best * shape - target, change

    def _light(self, seen: Seen, error: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Light (K, n, n_panel) on the panels, in the unit of the gains, and its derivative (K, n, n_panel, 3 + u)."""
        free = self.gain_unknowns if error is not None else self.gain_unknowns[:0]
        gain = self.gain if error is None else (self.gain + error[:, : len(free)] @ free)[:, None]
        light, to_turn = self._over_time(seen, gain)
        light, to_turn = light * self.lit[:, None], to_turn * self.lit[:, None, None]
        parts = [to_turn, (light / gain)[..., None] * free.T]
        if self.earth is not None and error is not None:
            lit = error[:, len(free) :]
            more, slope = self.earth.light(self.response, gain, seen.attitude, lit)
            light = light + more + self.earth.zero(lit)
            parts = [
                to_turn + slope[..., :3],
                parts[1] + (more / gain)[..., None] * free.T,
                slope[..., 3:],
            ]  # as its gain
        return light, np.concatenate(parts, axis=-1)

    def _over_time(self, seen: Seen, gain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Light (K, n, n_panel) of the Sun and its derivative (K, n, n_panel, 3) by a turn, at the readings' instants; that it
        changes with the rate too, by which the body turns until then, is left out of the derivative."""
        light, to_turn = 0.0, 0.0
        across = cross_matrix(seen.sun_B)  # a turn moves the Sun by sun x turn
        for shift, weight in self.instants.shifts():
            if not shift:
                sun, moves = seen.sun_B, across
            else:
                sun = components_after_rotation(seen.sun_B, shift * seen.omega)
                moves = components_after_rotation(
                    np.swapaxes(across, -1, -2), shift * seen.omega[..., None, :]
                )
                moves = np.swapaxes(moves, -1, -2)
            part, to_sun, _ = self.response.slopes(sun, gain=gain)
            light, to_turn = light + weight * part, to_turn + weight[:, None] * (to_sun @ moves)
        return np.asarray(light), np.asarray(to_turn)

    def considered(self, seen: Seen) -> list[tuple[Self, float]]:
        """With one sigma more of each error of the gains; and with the Earth's light as each hypothesis sees it, from each end of
        three axes fixed in space: it may come from anywhere, and the mean over the six stands for that over all directions."""
        found = [(replace(self, gain=self.gain + error), 1.0) for error in self.gain_errors]
        for side in np.vstack([np.eye(3), -np.eye(3)]) if self.earth_share > 0 else ():
            light = self.response.power(seen.attitude @ side, gain=self.gain)
            found.append(
                (
                    replace(
                        self, power=self.power + self.earth_share * self.scale[:, None] * light
                    ),
                    1 / np.sqrt(6),
                )
            )
        return found

"""The Earth's light on the panels, an unknown of a pass of :mod:`sunspin.estimate.rates`: a beam fixed in space.

It comes from where the Earth is, from a low orbit a wide disk, up to a third of full Sun on a panel that looks there, and turns
with the orbit. Its three components in N and their drift are estimated with the motion: as noise it would drown what weak light
tells. The law of :func:`sunspin.estimate.rates.light.earth_lit` makes two opposite panels differ by just the component of the beam
along them, so the differences of opposite panels follow one vector, Sun and beam together, that stays in space too: the search uses
those, and needs to know nothing of the beam. What a smooth beam leaves, clouds and coasts, stays noise. What panels read too much
all the time, zeros of converters that nobody subtracts, looks much the same in their brightness: it is estimated beside.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from sunspin.estimate.rates.light import sun_measured
from sunspin.estimate.rates.state import SUN_N, Observations, Track, drifting

TURN_RATE = 1.5e-3
"""rad/s; the beam turns with the orbit, 1.1e-3, and brightens or fades as the ground below does."""

LEAST = 0.03
"""Share of full Sun; less light than this, beside the noise of panels, is not worth six unknowns."""

WIDER = 1.5
"""Prior sigma of the beam, in units of what faces away from the Sun get on average."""

OPPOSITE = -0.99
"""Cosine of the angle between opposite panels, at most."""

ZERO = 0.3
"""Prior sigma of what a panel reads too much all the time, in the same units."""

CORNERS = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T / np.sqrt(3)
FIRST_DIRECTIONS, FIRST_SHARES = np.vstack([np.eye(3), -np.eye(3), CORNERS]), (0.4, 0.8)
"""Where a fit begins: the best of these directions in N, with these parts of the prior's sigma."""


def is_told(o: Observations) -> bool:
    """Whether there is light of the Earth to be estimated."""
    return o.earth_light > LEAST and o.power.size > 0


def differing(o: Observations) -> Observations:
    """For the search: of two opposite panels only their difference, on the brighter one, good to what no beam explains."""
    if not is_told(o):
        return o
    gain = np.linalg.norm(o.rows, axis=1)
    normal = o.rows / gain[:, None]
    share, sigma = o.whole_power / gain, o.whole_sigma / gain
    power, spread = o.power.copy(), o.power_sigma.copy()
    for i, j in np.argwhere(normal @ normal.T < OPPOSITE):
        both = np.isfinite(sigma[:, i]) & np.isfinite(sigma[:, j])
        power[both, i] = gain[i] * np.maximum(share[both, i] - share[both, j], 0.0)
        spread[both, i] = gain[i] * np.hypot(sigma[both, i], sigma[both, j])
    return replace(o, power=power, power_sigma=spread, scale_sigma=np.hypot(o.scale_sigma, o.earth_light))


def with_beam(o: Observations) -> Observations:
    """The same with the beam, and gains that were taken from brightness under it, as unknowns of the pass; the readings whole, and
    as good as they are beside the beam."""
    unknowns = drifting(o.t_s, WIDER * o.earth_light / np.sqrt(3), TURN_RATE)
    rows = np.concatenate([o.row_unknowns.reshape(-1, *o.rows.shape), o.row_errors.reshape(-1, *o.rows.shape)])
    return replace(
        o, earth_unknowns=unknowns, zero_sigma=ZERO * o.earth_light * np.linalg.norm(o.rows, axis=1),
        earth_light=0.0, row_unknowns=rows, row_errors=rows[:0], power=o.whole_power, power_sigma=o.whole_sigma,
        scale_sigma=o.whole_scale_sigma,
    )  # fmt: skip


def begun(o: Observations, track: Track) -> tuple[Track, np.ndarray]:
    """Hypotheses whose z axis is where Sun and beam together were taken for the Sun: with z to the Sun itself, and where a fit of
    the beam begins (K, m), in sigmas."""
    error, cost = np.zeros((len(track.omega), o.light_unknowns)), np.full(len(track.omega), np.inf)
    attitude = track.attitude
    sigma = np.linalg.norm(o.earth_unknowns[0, 0])
    for direction in FIRST_DIRECTIONS:
        for share in FIRST_SHARES:
            beam = share * np.sqrt(3) * direction
            turned = _sun_first(sigma * beam)
            trial = np.zeros_like(error)
            trial[:, :3] = beam @ turned
            new = sun_measured(lit_by(o, trial), replace(track, attitude=track.attitude @ turned))[2].sum(axis=1)
            better = new < cost
            error = np.where(better[:, None], trial, error)
            attitude = np.where(better[:, None, None, None], track.attitude @ turned, attitude)
            cost = np.minimum(new, cost)
    return replace(track, attitude=attitude), error


def _sun_first(beam: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) that takes components in the frame with z to the Sun to those in the frame with z to Sun and beam together,
    in which this is the beam (3)."""
    across = np.array([beam[0], beam[1], 0.0])
    sun = -across + SUN_N * np.sqrt(max(1 - across @ across, 0.0))
    axis = np.cross(SUN_N, sun)  # as long as the sine of the angle between them, which is less than a quarter turn
    return Rotation.from_rotvec(axis * np.arcsin(min(np.linalg.norm(axis), 1.0)) / max(np.linalg.norm(axis), 1e-300)).as_matrix()


def lit_by(o: Observations, error: np.ndarray) -> Observations:
    """The same under a beam, and with zeros, off by `error` (K, m) sigmas."""
    beam, zero = error[:, : o.earth_unknowns.shape[1]], error[:, o.earth_unknowns.shape[1] :]
    return replace(o, beam_N=np.einsum("km,nmj->knj", beam, o.earth_unknowns), zero=(zero * o.zero_sigma)[:, None])

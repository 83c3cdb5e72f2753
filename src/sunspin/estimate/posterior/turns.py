"""Turns of the panels, drawn given the motion.

Readings hardly bend with a panel's turn, so given motion, brightness and noise the turns are all but Gaussian, and no other motion
need be run for them. A proposal is therefore a draw of all other unknowns and, about the turns that fit it best, one of the turns;
both densities enter its weight, so that nothing is neglected. Fifteen unknowns less are left to the mixture, which gets worse with
each.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sunspin.estimate.posterior import tilt
from sunspin.estimate.posterior.likelihood import Likelihood, Prediction
from sunspin.estimate.posterior.model import Model, State

FACTORS = (4.0, 1.0, 1.0)
"""On the noise, in the steps to the turns that fit best: a wide one first, so that no reading is let go for turns not yet found."""


def rest_of(model: Model, kinds: tuple[str, ...] = tilt.KINDS) -> np.ndarray:
    """Places in u of all unknowns but turns of the panels, or those of these kinds."""
    return np.array(
        [i for i, x in enumerate(model.unknowns) if x.kind not in kinds], dtype=np.int64
    )


def without_turns(model: Model, state: State) -> State:
    """States with u (n, k) without the turns."""
    return state if model.turns is None else replace(state, u=state.u[:, rest_of(model)])


def with_turns(model: Model, state: State, turns: np.ndarray) -> State:
    """States without turns as those of the model, with `turns` (n or 1, turns), in prior sigmas."""
    if model.turns is None:
        return state
    u = np.empty((len(state), len(model.unknowns)))
    rest = rest_of(model)
    u[:, rest], u[:, np.setdiff1d(np.arange(u.shape[1]), rest)] = state.u, turns
    return replace(state, u=u)


def drawn_turns(
    likelihood: Likelihood, prediction: Prediction, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns (n, k) with turns drawn given the rest, and the log density (n) with which they were; in the place of its turns `u`
    holds standard normal numbers, of which the draws are made."""
    if likelihood.model.turns is None:
        return u, np.zeros(len(u))
    places = np.setdiff1d(np.arange(u.shape[1]), rest_of(likelihood.model))
    white, found, here = u[:, places], np.array(u), np.zeros((len(u), len(places)))
    curvature = np.tile(np.eye(len(places)), (len(u), 1, 1))
    for factor in FACTORS:
        found[:, places] = here
        pull, told = _told(likelihood, prediction, found, factor, likelihood.model.turns[places])
        curvature = told + np.eye(len(places))  # the prior's
        here = np.linalg.solve(curvature, pull[:, :, None] + told @ here[:, :, None])[:, :, 0]
    root = np.linalg.cholesky(curvature)
    found[:, places] = here + np.linalg.solve(np.swapaxes(root, 1, 2), white[:, :, None])[:, :, 0]
    volume = np.log(np.einsum("nii->ni", root)).sum(axis=1)
    return found, volume - 0.5 * np.sum(white**2 + np.log(2 * np.pi), axis=1)


def _told(
    likelihood: Likelihood, prediction: Prediction, u: np.ndarray, factor: float, turns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What readings under `factor` times the noise say of `turns` (t, P, 3): slope (n, t) of their log-likelihood and curvature
    (n, t, t), by Gauss and Newton."""
    shape, sun = (len(u), *likelihood.data.value.shape), prediction.sun
    raw, extra = likelihood.misfit(prediction, u)
    _, sigma, weight = likelihood.weigh(raw, extra, factor * likelihood.noise(u))
    raw, weight = (x[:, : shape[1] * shape[2]].reshape(shape) for x in (raw, weight / sigma**2))
    weight = np.where(
        (likelihood.data.lit | (raw < 0)) & prediction.fine[:, None, None], weight, 0.0
    )
    slope = np.asarray(
        likelihood.response.slopes(sun, gain=likelihood.gain(u), tilt=likelihood.tilt(u)).to_tilt
    )
    by_panel = np.moveaxis(np.where(weight[..., None] > 0, slope, 0.0), 2, 1)  # (n, P, K, 3)
    weighed = by_panel * np.swapaxes(weight, 1, 2)[..., None]
    pull = np.swapaxes(weighed, 2, 3) @ np.swapaxes(raw, 1, 2)[..., None]
    spread = np.swapaxes(weighed, 2, 3) @ by_panel @ np.moveaxis(turns, 0, 2)
    flat = turns.reshape(len(turns), -1)
    return (flat @ pull.reshape(shape[0], -1, 1))[:, :, 0], flat @ spread.reshape(
        shape[0], -1, len(turns)
    )

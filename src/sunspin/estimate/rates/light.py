"""What Sun sensors and panels read of the Sun, and panels of the Earth, for hypotheses of :mod:`sunspin.estimate.rates`."""

from __future__ import annotations

import numpy as np

from sunspin.estimate.rates.state import Observations, Track
from sunspin.solve.rotations import cross_matrix

STUDENT = 4.0
"""Degrees of freedom of the Student law of measurements: tails that let one bad sample in ten be outvoted."""


def sun_measured(o: Observations, track: Track, unknowns: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal matrices (K, n, 3 + m, 3 + m), gradients (K, n, 3 + m) and costs (K, n) of the Sun at each sample, to a turn and to
    one sigma of each of `unknowns` (m, n_panel, 3), errors of gain times normal, and of the beam's, if there is one."""
    unknowns = np.zeros((0, *o.rows.shape[-2:])) if unknowns is None else unknowns
    k, n, size = *track.omega.shape[:2], 3 + len(unknowns) + (0 if o.beam_N is None else o.light_unknowns)
    matrix, slope, cost = np.zeros((k, n, size, size)), np.zeros((k, n, size)), np.zeros((k, n))
    sun = track.sun_B
    answer = cross_matrix(sun)  # the Sun's direction in the body answers sun x turn
    for value, jacobian in _sun_residuals(o, sun, answer, size - 3, unknowns, track.attitude):
        weight, part = student(value)
        matrix += np.einsum("kn,knmi,knmj->knij", weight, jacobian, jacobian)
        slope += np.einsum("kn,knmi,knm->kni", weight, jacobian, value)
        cost += part
    return matrix, slope, cost


def _sun_residuals(o: Observations, sun: np.ndarray, answer: np.ndarray, others: int, unknowns: np.ndarray, attitude: np.ndarray):
    told = o.told
    if told.any():
        white = np.zeros((len(o), 3, 3))
        white[told] = np.swapaxes(np.linalg.cholesky(np.linalg.inv(o.sun_cov[told])), -1, -2)
        jacobian = white @ answer
        jacobian = np.concatenate([jacobian, np.zeros((*jacobian.shape[:-1], others))], axis=-1)
        yield np.einsum("nij,knj->kni", white, sun - np.where(told[:, None], o.sun_B, 0.0)), jacobian
    if o.power.size and np.isfinite(o.power_sigma).any():
        yield _power_residuals(o, sun, answer, unknowns, attitude)


def _power_residuals(
    o: Observations, sun: np.ndarray, answer: np.ndarray, unknowns: np.ndarray, attitude: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Powers less the model's (K, n, n_panel + 1), in sigma, the scale of each sample being put at its best (variable projection),
    and their Jacobian (K, n, n_panel + 1, 3 + m) to a turn and to the `unknowns`.

    The scale's own prior is one more residual, so a scale known, half known and free are one formula.
    """
    inverse = np.where(np.isfinite(o.power_sigma), 1 / o.power_sigma, 0.0)
    target = np.nan_to_num(o.power) * inverse
    target = np.concatenate([target, np.broadcast_to((1 / o.scale_sigma)[:, None], (*target.shape[:-1], 1))], axis=-1)
    cosine = sun @ np.swapaxes(o.rows, -1, -2)
    to_turn = np.expand_dims(o.rows, -3) @ answer
    change = np.concatenate([to_turn, np.einsum("knj,mpj->knpm", sun, unknowns)], axis=-1)
    light, change = np.maximum(cosine, 0.0), (cosine > 0)[..., None] * change
    if o.beam_N is not None:
        light, change = _with_earth(o, o.beam_N, light, change, unknowns, attitude)
    shape = light * inverse * o.scale[:, None]
    shape = np.concatenate([shape, np.broadcast_to((1 / o.scale_sigma)[:, None], (*shape.shape[:2], 1))], axis=-1)
    size = (shape**2).sum(axis=-1, keepdims=True)
    best = np.maximum((shape * target).sum(axis=-1, keepdims=True) / size, 0.0)
    change = (inverse * o.scale[:, None])[..., None] * change
    change = np.concatenate([change, np.zeros((*change.shape[:2], 1, change.shape[-1]))], axis=-2) * best[..., None]
    unit = shape / np.sqrt(size)
    change = change - unit[..., None] * np.einsum("...m,...mi->...i", unit, change)[..., None, :]
    return best * shape - target, change


def _with_earth(
    o: Observations, beam_N: np.ndarray, light: np.ndarray, change: np.ndarray, unknowns: np.ndarray, attitude: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Light on the panels (K, n, n_panel) with the beam's, and its answer to a turn, to errors of gains, and to the beam's."""
    beam = (attitude @ beam_N[..., None])[..., 0]
    more, to_beam = earth_lit(o.rows, beam)
    gain = np.linalg.norm(o.rows, axis=-1)
    relative = np.einsum("...pj,mpj->...pm", o.rows, unknowns) / gain[..., None] ** 2  # a panel's light is as its gain
    relative = relative if relative.ndim == 2 else relative[:, None]
    change[..., :3] += to_beam @ cross_matrix(beam)
    change[..., 3:] += more[..., None] * relative
    own = np.einsum("knpj,knji,nmi->knpm", to_beam, attitude, o.earth_unknowns)
    zeros = np.broadcast_to(np.diag(o.zero_sigma), (*more.shape, len(o.zero_sigma)))
    return light + more + o.zero, np.concatenate([change, own, zeros], axis=-1)


def earth_lit(rows: np.ndarray, beam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Light (K, n, n_panel) on panels `rows` (n_panel, 3) or (K, n_panel, 3), gain times normal, under the Earth's beam (K, n, 3)
    in B, as long as the light on a panel that looks there; and its derivative (K, n, n_panel, 3).

    The Earth fills a disk of 66 degrees' radius seen from 550 km: on a panel turned away by an angle a its light falls as
    ((1 + cos a) / 2)^2, to 0.05 of what it is at most.
    """
    size = np.maximum(np.linalg.norm(beam, axis=-1), 1e-12)[..., None]
    gain = np.linalg.norm(rows, axis=-1)
    gain = gain if gain.ndim == 1 else gain[:, None]
    both = gain * size + beam @ np.swapaxes(rows, -1, -2)
    part, toward = both / (gain * size), (beam / size)[..., None, :]
    normal = rows if rows.ndim == 2 else rows[:, None]
    slope = part[..., None] / 2 * (gain[..., None] * toward + normal) - (part**2 / 4 * gain)[..., None] * toward
    return part * both / 4, slope


def student(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weight and cost of residual vectors (..., m) under a Student law of `STUDENT` degrees of freedom."""
    square = (value**2).sum(axis=-1)
    return (STUDENT + 2) / (STUDENT + square), (STUDENT + 2) / 2 * np.log1p(square / STUDENT)

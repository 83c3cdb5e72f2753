"""Gains of the panels from their readings: in full Sun all samples have one brightness, whichever panels are lit.

The brightness of a sample is the factor by which its readings exceed the model at the direction that fits them best. Gains that
are wrong make it depend on the direction; those with which it does not are found by reweighted least squares under a prior about
the vehicle file's values. Where the panels do not look all around, a Sun that stands aside looks like a dim one, and nothing is
told.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunspin.telemetry.sun import best_directions
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import panel_power

PRIOR_SIGMA, UNTOLD_SIGMA = 0.1, 0.02
"""Relative uncertainty of a gain whose sigma the vehicle file does not state, as a prior: wide enough for a string of cells that
is dead (with half of it twins with all faults missed by half as much again). And by how much one reading errs beside that where the
scatter of brightness tells nothing: faces of other temperatures, shadows of edges."""

UNKNOWN_SIGMA = 0.2
"""The same of a gain that is left to the motion to tell (:mod:`sunspin.estimate.rates.common_errors`): no brightness refutes a
vehicle file whose full scale is wrong by a third, and a wide prior costs little where 40 samples of a motion tell it to a few
percent."""

FEWEST, MOST = 15, 1500
"""Samples needed; and used, evenly chosen."""

FREEDOM = 4.0
"""Of the Student law of brightness: one sample in ten may be none of the Sun's."""

STEPS, STEP = 6, 1e-4
"""Gauss-Newton steps, and the step of the differences."""


class Gains(NamedTuple):
    """`factor` (n_panel) on the vehicle's gains and its `covariance`; `spread`, the relative scatter of the brightness of
    samples in full Sun (None where nothing is told); `told` in words."""

    factor: np.ndarray
    covariance: np.ndarray
    spread: float | None
    told: str

    @property
    def sigma(self) -> np.ndarray:
        return np.sqrt(np.diag(self.covariance))


def brightness(vehicle: Vehicle, value: np.ndarray) -> np.ndarray:
    """Factor (n) by which readings (n, n_panel) exceed the model at the direction that fits them best."""
    if not len(value):
        return np.zeros(0)
    direction, _ = best_directions(vehicle, value)
    shape = panel_power(vehicle, direction)
    return (value * shape).sum(axis=1) / np.maximum((shape**2).sum(axis=1), 1e-300)


def looks_all_around(vehicle: Vehicle, dead: np.ndarray | None = None) -> bool:
    """Whether three independent panels (that are not dead) are lit wherever the Sun stands."""
    works = np.ones(len(vehicle.inputs), dtype=bool) if dead is None else ~dead
    response = vehicle.response_in()
    sun, lit = response.regions()
    return all(
        row.sum() >= 3 and response.rank(row, at) == 3
        for at, row in zip(sun, lit & works, strict=True)
    )


def with_gains(vehicle: Vehicle, factor: np.ndarray) -> Vehicle:
    """The vehicle with the gains of each input's panels times `factor` (n_input)."""
    of_panel = np.ones(len(vehicle.panels))
    for one, value in zip(vehicle.inputs, factor, strict=True):
        of_panel[list(one.panels)] = value
    return replace(
        vehicle,
        panels=tuple(
            replace(p, gain=p.gain * float(f))
            for p, f in zip(vehicle.panels, of_panel, strict=True)
        ),
    )


def prior_sigmas(vehicle: Vehicle, unstated: float = PRIOR_SIGMA) -> np.ndarray:
    """Relative uncertainty of the gain of each input (of a channel: of its least known panel) as the vehicle file states it, else
    `unstated`."""
    found = np.full(len(vehicle.panels), unstated)
    for k, panel in enumerate(vehicle.panels):
        for key in ("gain_W", "gain_A", "relative_gain"):
            fact = vehicle.facts.get(f"panel.{panel.name}.{key}")
            if (
                fact is not None
                and isinstance(fact.sigma, float)
                and fact.sigma > 0
                and panel.gain > 0
            ):
                found[k] = fact.sigma / panel.gain
    return np.array([found[list(one.panels)].max() for one in vehicle.inputs])


def estimate_gains(vehicle: Vehicle, value: np.ndarray, full: float, dead: np.ndarray) -> Gains:
    """Gains from readings (n, n_panel) in full Sun, `full` being their brightness with the vehicle's own gains."""
    prior = prior_sigmas(vehicle)
    nothing = Gains(
        np.ones(len(prior)), np.diag(prior_sigmas(vehicle, UNTOLD_SIGMA) ** 2), None, ""
    )
    if vehicle.throttled:
        return nothing._replace(
            told="not determined by the data: inputs are throttled, and no sample need be in full Sun"
        )
    if not looks_all_around(vehicle, dead):
        return nothing._replace(
            told="not determined by the data: panels do not look all around, a Sun that stands aside looks dim"
        )
    if len(value) < FEWEST:
        return nothing._replace(
            told=f"not determined by the data: fewer than {FEWEST} samples in full Sun"
        )
    value = value[:: -(-len(value) // MOST)]
    log, covariance, spread = np.zeros(len(prior)), np.diag(prior**2), 0.0
    for _ in range(STEPS):
        away = brightness(with_gains(vehicle, np.exp(log)), value) / full - 1
        moved = [
            brightness(with_gains(vehicle, np.exp(log + STEP * one)), value) / full - 1
            for one in np.eye(len(log))
        ]
        jacobian = (np.stack(moved, axis=1) - away[:, None]) / STEP
        spread = max(1.4826 * float(np.median(np.abs(away))), 1e-3)
        weight = (FREEDOM + 1) / (FREEDOM + (away / spread) ** 2) / spread**2
        covariance = np.linalg.inv(jacobian.T @ (weight[:, None] * jacobian) + np.diag(prior**-2))
        log = np.clip(log - covariance @ (jacobian.T @ (weight * away) + log / prior**2), -1.0, 1.0)
    factor = np.exp(log)
    return Gains(
        factor,
        covariance * np.outer(factor, factor),
        spread,
        f"estimated from {len(value)} samples in full Sun",
    )

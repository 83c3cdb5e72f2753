"""The forward model of a vehicle's panels, and which of them can be lit together, by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sunspin.vehicle.response.planes import sphere

if TYPE_CHECKING:
    from sunspin.vehicle import Vehicle

Pattern = frozenset[str]  # of panel names: the lit ones

OPPOSITE_COSINE = -0.99
"""Cosine of the angle between opposite panels, at most."""

SUN_DIRECTIONS = 4000
"""Directions of the Sun that are tried over panels turned otherwise than drawn, 3 degrees apart."""


def panel_power(vehicle: Vehicle, sun_B: npt.ArrayLike) -> np.ndarray:
    """Signal of each panel by the law that the vehicle's file names, else ``gain * max(0, normal . sun)`` (paper, eq. 1); where
    panels share inputs (channels), the reading of each input (`vehicle.input_names`).

    Parameters
    ----------
    sun_B : (..., 3)
        Direction to the Sun, body axes.

    Returns
    -------
    (..., n_panel), or inputs, in the unit of the gains (`vehicle.gain_unit`), or relative.
    """
    vehicle.require_panels()
    return vehicle.response_in().power(np.asarray(sun_B, dtype=np.float64))


def brightness(
    vehicle: Vehicle, reading: np.ndarray, sun_B: np.ndarray | None = None
) -> np.ndarray:
    """Factor (n) by which readings (n, n_panel) exceed `panel_power` at `sun_B` (n, 3); default: the directions that fit best."""
    light = panel_power(
        vehicle, vehicle.response_in().best_direction(reading)[0] if sun_B is None else sun_B
    )
    return (reading * light).sum(axis=1) / np.maximum((light**2).sum(axis=1), 1e-300)


def opposite_panels(facing_B: np.ndarray) -> np.ndarray:
    """Which of panels (n, n) that look along `facing_B` (n, 3) look opposite ways."""
    return facing_B @ facing_B.T < OPPOSITE_COSINE


def lit_patterns(vehicle: Vehicle) -> tuple[Pattern, ...]:
    """The sets of panels (inputs) that the Sun can light together, for directions on no edge (16 for Philae)."""
    vehicle.require_panels()
    patterns = patterns_by_name(vehicle, vehicle.response_in().regions().lit)
    return tuple(sorted(patterns, key=lambda pattern: (len(pattern), sorted(pattern))))


def observable_patterns(vehicle: Vehicle) -> frozenset[Pattern]:
    """The lit patterns that a measurement can show: those of `lit_patterns`, and those of directions on edges.

    A panel that the Sun grazes may read as dark, so the patterns of arcs and vertices occur in real data.
    """
    vehicle.require_panels()
    response = vehicle.response_in()
    return patterns_by_name(vehicle, np.concatenate([response.regions().lit, response.edges()]))


def patterns_of_misaligned(vehicle: Vehicle, turns_B: np.ndarray) -> frozenset[Pattern]:
    """The lit patterns of the same panels, turned by any of `turns_B` (k, n_panel, 3), rotation vectors in rad in B."""
    response, suns = vehicle.response_in(), sphere(SUN_DIRECTIONS)
    lit = [
        np.unique(
            response.power(suns, tilt=np.broadcast_to(turn, (SUN_DIRECTIONS, *turn.shape))) > 0,
            axis=0,
        )
        for turn in turns_B
    ]
    return patterns_by_name(vehicle, np.unique(np.concatenate(lit), axis=0))


def patterns_by_name(vehicle: Vehicle, lit: np.ndarray) -> frozenset[Pattern]:
    """Sets of lit panels (m, n_panel) by name."""
    names = np.array(vehicle.input_names)
    return frozenset(frozenset(names[row].tolist()) for row in lit)


def misalignment_sigma(vehicle: Vehicle) -> tuple[np.ndarray, float]:
    """How far panels may stand off: sigmas in rad as the vehicle's file has them, 0 where it states none, (n_panel) of each
    normal's direction, to each side, and of the turn of all panels.

    That of `normal_B`, each component's (where these differ, their root mean square), and of the turn of a panel that is tilted.
    """
    own = np.array(
        [_rms_sigma(vehicle, f"panel.{panel.name}.normal_B") for panel in vehicle.panels]
    )
    tilted = vehicle.panel_response.tilted
    if tilted is not None:
        by_tilt = _rms_sigma(vehicle, "panel_response.tilted.turn_B_rad")
        own = np.hypot(own, by_tilt * (np.array(vehicle.panel_names) == tilted.panel))
    return own, _rms_sigma(vehicle, "panel_response.turned_B_rad")


def misalignment_signal_sigma(vehicle: Vehicle) -> np.ndarray:
    """How far full Sun may be off in each reading (n_input), in the unit of the gains, as panels are turned by `stated_sigma`,
    each for itself: a turn of all together is one of the Sun."""
    by_panel = misalignment_sigma(vehicle)[0] * vehicle.panel_gains
    return np.array([np.linalg.norm(by_panel[list(own.panels)]) for own in vehicle.inputs])


def _rms_sigma(vehicle: Vehicle, key: str) -> float:
    fact = vehicle.facts.get(key)
    known = fact is not None and fact.sigma is not None
    return float(np.sqrt(np.mean(np.square(fact.sigma)))) if known else 0.0

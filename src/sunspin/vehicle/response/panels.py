"""Forward model of a vehicle's panels, the patterns of panels that can be lit together, and panel misalignment."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sunspin.vehicle.response.planes import sphere

if TYPE_CHECKING:
    from sunspin.vehicle import Vehicle

Pattern = frozenset[str]
"""Names of the lit panels (inputs)."""

OPPOSITE_COSINE = -0.99
"""Largest cosine of the angle between the normals of opposite panels."""

SUN_DIRECTIONS = 4000
"""Sun directions that are tested for misaligned panels, 3 degrees apart."""


def panel_power(vehicle: Vehicle, sun_B: npt.ArrayLike) -> np.ndarray:
    """Compute the signal of each panel, ``gain * max(0, normal . sun)`` (paper, eq. 1).

    If panels share inputs (channels), the values are the readings of the inputs (`vehicle.input_names`).

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
    """Return the factor (n) between readings (n, n_panel) and :func:`panel_power` at `sun_B` (n, 3), by least squares.

    By default `sun_B` are the directions that fit best. The factor is 0 where no panel is lit.
    """
    if sun_B is None:
        sun_B, _ = vehicle.response_in().best_direction(reading)
    power = panel_power(vehicle, sun_B)
    # 1e-300 replaces a sum of zero
    return (reading * power).sum(axis=1) / np.maximum((power**2).sum(axis=1), 1e-300)


def opposite_panels(facing_B: np.ndarray) -> np.ndarray:
    """Return which pairs (n, n) of panels that face the directions `facing_B` (n, 3) are opposite."""
    return facing_B @ facing_B.T < OPPOSITE_COSINE


def lit_patterns(vehicle: Vehicle) -> tuple[Pattern, ...]:
    """Return the sets of panels (inputs) that the Sun can light together, directions on edges excluded (16 for Philae)."""
    vehicle.require_panels()
    patterns = patterns_by_name(vehicle, vehicle.response_in().regions().lit)
    return tuple(sorted(patterns, key=lambda pattern: (len(pattern), sorted(pattern))))


def observable_patterns(vehicle: Vehicle) -> frozenset[Pattern]:
    """Return the lit patterns that telemetry can show: those of :func:`lit_patterns`, and those of directions on edges.

    A panel at grazing incidence may read as dark, so that the patterns of arcs and vertices occur in real data.
    """
    vehicle.require_panels()
    response = vehicle.response_in()
    return patterns_by_name(vehicle, np.concatenate([response.regions().lit, response.edges()]))


def patterns_of_misaligned(vehicle: Vehicle, turns_B: np.ndarray) -> frozenset[Pattern]:
    """Return the lit patterns of panels rotated by any of k sets of rotation vectors `turns_B` (k, n_panel, 3), rad in B.

    They are those of `SUN_DIRECTIONS` directions over the sphere.
    """
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
    """Return sets of lit panels (m, n_panel) by the names of the inputs."""
    names = np.array(vehicle.input_names)
    return frozenset(frozenset(names[row].tolist()) for row in lit)


def misalignment_sigma(vehicle: Vehicle) -> tuple[np.ndarray, float]:
    """Return standard deviations of panel misalignment (rad) from the vehicle file: of each panel (n_panel), and common to all.

    Each is the angle to one side; 0 if the file states none. That of a panel comes from the sigma of `normal_B` (root mean
    square of its components), and from the sigma of its tilt.
    """
    single = np.array(
        [_rms_sigma(vehicle, f"panel.{panel.name}.normal_B") for panel in vehicle.panels]
    )
    tilted = vehicle.panel_response.tilted
    if tilted is not None:
        by_tilt = _rms_sigma(vehicle, "panel_response.tilted.turn_B_rad")
        single = np.hypot(single, by_tilt * (np.array(vehicle.panel_names) == tilted.panel))
    return single, _rms_sigma(vehicle, "panel_response.turned_B_rad")


def misalignment_signal_sigma(vehicle: Vehicle) -> np.ndarray:
    """Return the error (n_input) of full-Sun readings from the misalignment of single panels, in the unit of the gains.

    A common misalignment is not included: it acts as a rotation of the Sun.
    """
    single, _ = misalignment_sigma(vehicle)
    by_panel = single * vehicle.panel_gains
    # errors of the panels of one input are independent
    return np.array([np.linalg.norm(by_panel[list(each.panels)]) for each in vehicle.inputs])


def _rms_sigma(vehicle: Vehicle, key: str) -> float:
    """Return the root mean square of the sigma of a fact of the vehicle, 0 if it is not stated."""
    fact = vehicle.facts.get(key)
    known = fact is not None and fact.sigma is not None
    return float(np.sqrt(np.mean(np.square(fact.sigma)))) if known else 0.0

"""Panels that are turned from the directions that the vehicle file states."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sunspin import rates
from sunspin.estimate.alternatives import MISALIGNED
from sunspin.estimate.model import States
from sunspin.estimate.observe import observe as observed
from sunspin.estimate.terms.panels import TILT_SIGMA_RAD
from sunspin.solve.rotations import rotate_attitude
from sunspin.telemetry.assess import assess
from validation.passes import FACES, SimulatedPass, observe, spin


def made_pass(seed: int, turns_deg: np.ndarray) -> SimulatedPass:
    """Return a box at 5 deg/s whose panels are turned by so many degrees (6, 3), which its file does not state."""
    rng = np.random.default_rng(seed)
    t_s = np.concatenate([[0.0], np.cumsum(rng.uniform(6.0, 10.0, 34))])
    start = rng.normal(size=3)
    motion = spin(np.radians(5.0) * start / np.linalg.norm(start), t_s)
    turned = Rotation.from_rotvec(np.radians(turns_deg)).apply(FACES)
    true = observe(turned, *motion, t_s, 0.005, rng)
    as_stated = observe(FACES, *motion, t_s, 0.005, rng)
    return true._replace(vehicle=as_stated.vehicle)


def largest_error(result, made: SimulatedPass) -> float:
    """Return the largest error of a component of the rate at any sample, in its sigmas."""
    sigma = np.sqrt(np.diagonal(result["omega_cov_B"].values, axis1=1, axis2=2))
    return float((np.abs(result["omega_B"].values - made.omega) / sigma).max())


@pytest.mark.parametrize("seed", [2, 3])
def test_rates_are_within_their_errors_if_panels_are_turned_by_some_degrees(seed):
    """By 3 degrees about each axis, one sigma: the two passes were decided, with errors of 7 and 6 sigma."""
    turns = np.random.default_rng([seed, 1]).normal(0, 3, (6, 3))
    made = made_pass(seed, turns)
    result = rates(made.vehicle, made.telemetry)
    assert result["decided"].values[0] and largest_error(result, made) < 4
    assert str(result["model"].values[0]).startswith(MISALIGNED)


def test_a_pass_of_right_panels_is_as_stated():
    made = made_pass(0, np.zeros((6, 3)))
    result = rates(made.vehicle, made.telemetry)
    assert result["decided"].values[0] and result["model"].values[0] == "as stated"


def test_panels_that_are_all_turned_alike_read_what_they_read_if_the_body_is_turned():
    """To first order in the angle; each alone reads what its own derivative by that turn says."""
    made = made_pass(0, np.zeros((6, 3)))
    panels = observed(assess(made.vehicle, made.telemetry)).obs.terms[0]
    stated = replace(panels, gain_errors=panels.gain_errors[:0])
    turned = replace(stated, tilt_sigma=TILT_SIGMA_RAD)
    rng = np.random.default_rng(1)
    n = len(made.omega)
    attitude = Rotation.random(n, random_state=2).as_matrix()[None]
    states = States(attitude, np.zeros((1, n, 3)))
    turn = 1e-4 * rng.normal(size=3)
    # the part of the turn across the direction of each panel, in sigmas; about that direction a panel may be turned as it likes
    u = (turned.tilt_axes() @ turn / TILT_SIGMA_RAD).reshape(1, -1)
    (by_panels,) = turned.residuals(states, u)
    moved = States(rotate_attitude(attitude, np.broadcast_to(turn, (1, n, 3))), states.omega)
    (by_body,) = stated.residuals(moved, np.zeros((1, 0)))
    (before,) = stated.residuals(states, np.zeros((1, 0)))
    change = by_body.value - before.value
    assert np.abs(by_panels.value - by_body.value).max() < 0.01 * np.abs(change).max()
    assert len(turned.unknowns()) == 12 and turned.unknowns()[-1].kind == "tilt"
    # by the unknowns the square of the residuals falls as their derivatives say; the factor of each sample is at its best
    assert by_panels.by_u is not None
    slope = np.einsum("knr,knrm->km", by_panels.value, by_panels.by_u)[0] @ u[0]
    fall = (by_panels.value**2 - before.value**2).sum() / 2
    assert abs(slope - fall) < 0.01 * abs(fall)

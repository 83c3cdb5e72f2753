"""Panels unlike their file: turned from the stated directions, or of gains that an operator does not know. All is synthetic."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.estimate.alternatives import MISALIGNED
from sunspin.estimate.model import States
from sunspin.estimate.observe import observe as observed
from sunspin.estimate.terms.panels import TILT_SIGMA_RAD, Panels
from sunspin.solve.rotations import rotate_attitude
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Fact, TelemetryForm
from tests.support.passes import errors_in_sigmas
from tests.support.simulate import CUBE, pulls, telemetry_of, uneven_times
from tests.support.vehicles import unit_vector
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


def test_rates_are_within_their_errors_if_panels_are_turned_by_some_degrees():
    """By 3 degrees about each axis, one sigma: this pass was decided, with an error of 7 sigma."""
    made = made_pass(2, np.random.default_rng([2, 1]).normal(0, 3, (6, 3)))
    result = ss.rates(made.vehicle, made.telemetry)
    assert result["decided"].values[0] and np.abs(errors_in_sigmas(result, made.omega)).max() < 4
    assert str(result["model"].values[0]).startswith(MISALIGNED)


def test_a_pass_of_right_panels_is_as_stated():
    made = made_pass(0, np.zeros((6, 3)))
    result = ss.rates(made.vehicle, made.telemetry)
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


# ---- gains that are not known: placeholders decide nothing, guesses with a sigma give right rates ---------------------------


FIVE = replace(
    CUBE,
    gain_unit=None,
    inertia_kg_m2=None,
    panels=tuple(panel for panel in CUBE.panels if panel.name != "-z"),
    telemetry=TelemetryForm(),
)
WEAK = 0.3
"""Gain of +z, which the vehicle files have like those of the others."""


def with_gains(sigma: float | None):
    """Return the vehicle whose file states a relative gain of one for each panel, with this sigma."""
    facts = {f"panel.{panel.name}.relative_gain": Fact(1.0, sigma) for panel in FIVE.panels}
    return replace(FIVE, facts=facts)


def seen(seed: int, weak: float = WEAK):
    """Return telemetry of the cube without -z, whose +z has a third of the cells, and the true motion."""
    rng = np.random.default_rng(seed)
    t_s = uneven_times(rng, 36, 20.0, 0.1)
    omega = np.radians(rng.uniform(0.7, 2.0)) * unit_vector(rng)
    run = ss.propagate(CUBE, omega, unit_vector(rng), None, t_s, wheel_mode="hold")
    power = ss.panel_power(FIVE, run["sun_B"].values)
    power[:, FIVE.panel_names.index("+z")] *= weak
    power = power + 0.01 * rng.normal(size=power.shape) + 0.01 * rng.uniform(size=power.shape)
    return telemetry_of(FIVE, t_s, np.maximum(power, 0)), run


def test_a_pass_is_not_decided_if_readings_deny_gains_that_are_placeholders():
    data, _ = seen(2)
    result = ss.rates(with_gains(None), data)
    assert not result["decided"].values.any()
    assert "the gain of panel +z is not known" in str(result["why_not_decided"].values[0])
    assert result.attrs["gains_unknown"] == "+z"


def test_gains_are_in_doubt_only_if_all_are_relative_without_a_sigma_and_one_panel_reads_little():
    data, _ = seen(2)
    assert list(assess(with_gains(None), data).doubtful_gains) == list(FIVE.panel_names)
    dead = data.assign(power_W=data["power_W"] * [1, 1, 1, 1, 0])
    assert list(assess(with_gains(None), dead).doubtful_gains) == list(FIVE.panel_names[:4])
    assert not assess(with_gains(0.3), data).doubtful_gains
    assert not assess(FIVE, data).doubtful_gains  # numbers of cells
    equal = data.assign(power_W=data["power_W"] / [1, 1, WEAK, 1, 1])
    assert not assess(with_gains(None), equal).doubtful_gains


def test_a_guess_of_gains_with_a_sigma_gives_the_right_rates_and_the_gain():
    data, run = seen(2)
    result = ss.rates(with_gains(0.3), data)
    assert result["decided"].values.all()
    assert np.abs(pulls(result, run)).max() < 4.5
    at = result["estimate"].values.tolist().index("gain_+z")
    assert result["estimate_value"].values[0, at] == pytest.approx(WEAK, abs=0.04)


def test_the_sigma_of_a_gain_is_no_noise_of_each_reading():
    """All readings of a panel have the error of its gain in common: the fit has it as an unknown."""
    data, _ = seen(2)
    of_direction, of_fit = {}, {}
    for sigma in (0.02, 0.3):
        assessment = assess(with_gains(sigma), data)
        panels = Panels.read(assessment)[0]
        used = assessment.quality["use"].values == 0
        bright = (data["power_W"].values > 0.5) & used[:, None]
        of_direction[sigma] = assessment.quality["sigma"].values[bright]
        of_fit[sigma] = panels.sigma[bright]
    assert panels.gain_errors.max() == pytest.approx(0.3, rel=0.05)
    # the direction of one sample has the error of the gain
    assert of_direction[0.3].min() > 0.14, of_direction
    assert of_fit[0.3].max() < 0.05
    assert np.median(of_fit[0.02]) == pytest.approx(np.median(of_fit[0.3]), rel=0.1)


def test_samples_with_the_sun_on_a_panel_whose_gain_is_a_guess_are_used():
    data, run = seen(2, weak=0.2)
    on_it = run["sun_B"].values[:, 2] > 0.95
    assert on_it.sum() > 3
    use = {sigma: assess(with_gains(sigma), data).quality["use"].values for sigma in (None, 0.3)}
    assert (use[None][on_it] == 2).any() and (use[0.3][on_it] < 2).all()

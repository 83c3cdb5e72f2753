"""Information of readings: against a closed form, and as it must change when something is left out, added or known."""

from __future__ import annotations

import numpy as np
import pytest

from sunspin.estimate.information import Information, exact_readings, rate_volume, speed_sigma
from sunspin.estimate.posterior.model import State, model
from sunspin.vehicle import Panel, TelemetryForm, Vehicle

FACES = {
    "+x": [1, 0, 0],
    "-x": [-1, 0, 0],
    "+y": [0, 1, 0],
    "-y": [0, -1, 0],
    "+z": [0, 0, 1],
    "-z": [0, 0, -1],
}
SUN = np.array([[0.48, 0.60, 0.64]])
NOISE = 0.02


def cube(moments=(0.01, 0.01, 0.01)) -> Vehicle:
    panels = [Panel(name, normal, 1.0) for name, normal in FACES.items()]
    form = TelemetryForm(quantity="current_A", noise=NOISE)
    return Vehicle("cube", inertia_kg_m2=np.diag(moments), panels=panels, telemetry=form)


def told(vehicle: Vehicle, rate, t, priors) -> Information:
    unknown, _ = model(vehicle, {"max_rate_rad_s": 50.0} | priors, 1.0)
    state = State(np.array([rate]), SUN, np.zeros((1, len(unknown.unknowns))))
    return Information(unknown, exact_readings(unknown, state, t, NOISE), state)


@pytest.mark.evidence(
    "posterior", "verified", "the information that readings hold, against a closed form"
)
def test_of_a_body_at_rest_it_is_that_of_the_closed_form():
    """About rest dr = r x omega t - and three lit faces measure r - so that information on omega is sum t^2 [r]^T [r] / sigma^2."""
    t = np.array([0.0, 3.0, 7.0, 8.0])
    found = told(cube(), [1e-9, 0.0, 0.0], t, {"inertia": 0.0, "scale": 0.0, "noise": 0.0})
    x, y, z = SUN[0]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])  # r x omega = cross @ omega
    tangent = np.linalg.svd(SUN)[2][1:]  # the direction may move in these
    total = np.zeros((5, 5))
    for time in t:
        jacobian = np.concatenate([cross * time, tangent.T], axis=1)
        total += 0.98 * jacobian.T @ jacobian / NOISE**2  # nearly all of a good reading's weight
    prior = np.diag([50.0**-2] * 3 + [1.0] * 2)
    expected, got = np.linalg.inv(total + prior)[:3, :3], found.covariance()[:3, :3]
    assert np.allclose(
        tangent @ got @ tangent.T, tangent @ expected @ tangent.T, rtol=0.03, atol=1e-7
    )
    assert SUN[0] @ got @ SUN[0] > 1e5 * np.trace(
        tangent @ got @ tangent.T
    )  # a turn about the Sun is not seen


def test_less_is_never_more():
    t = np.arange(0.0, 200.0, 10.0)
    found = told(cube((0.010, 0.012, 0.008)), [0.05, -0.08, 0.11], t, {})
    everything = found.covariance()
    every = np.arange(len(t))
    for options in (
        {"samples": every[1:]},
        {"samples": every[::2]},
        {"panels": [0, 2, 4]},
        {"noise": 2.0},
    ):
        assert rate_volume(found.covariance(**options)) > rate_volume(everything), options
    known = found.covariance(fixed=("inertia",))
    assert rate_volume(known) < 0.9 * rate_volume(everything)
    assert speed_sigma(known, found.state.omega[0]) <= speed_sigma(everything, found.state.omega[0])
    alone = found.covariance(fixed=("inertia", "scale", "noise"))
    noisier = found.covariance(fixed=("inertia", "scale", "noise"), noise=2.0)
    assert rate_volume(noisier) / rate_volume(alone) == pytest.approx(8, rel=0.01)


def test_the_volume_is_that_of_an_ellipsoid_which_holds_ninety_percent():
    draws = np.random.default_rng(0).standard_normal((200_000, 3)) * [1.0, 2.0, 0.5]
    radius = np.quantile(np.sum((draws / [1.0, 2.0, 0.5]) ** 2, axis=1), 0.9) ** 0.5
    assert rate_volume(np.diag([1.0, 4.0, 0.25])) == pytest.approx(
        4 / 3 * np.pi * radius**3, rel=0.02
    )

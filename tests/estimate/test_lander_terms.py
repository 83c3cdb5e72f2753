"""Readings of a lander as terms: derivatives, the law of outliers, dark readings, noise, throttled samples, given readings."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from sunspin.base.errors import InputError
from sunspin.cases import load_case
from sunspin.estimate.model import Unknown
from sunspin.estimate.settings import OUTLIER
from sunspin.estimate.terms.given import Given
from sunspin.estimate.terms.powers import PanelPowers, SunStates, panel_turns, tilt_unknowns
from sunspin.solve.rotations import components_after_rotation
from tests.support.passes import slope_of
from tests.support.vehicles import units

SIGMA, FULL = 0.02, 2.5
"""Noise of a reading, and brightness: of Philae's panels, in the unit of its gains."""


def lander_readings(rng: np.random.Generator, samples: int = 7) -> tuple[PanelPowers, SunStates]:
    """Return readings of Philae's panels with all kinds of unknowns, and the motions (3) near which they were read."""
    vehicle = load_case("philae").vehicle
    panels = len(vehicle.inputs)
    tilts = tilt_unknowns(vehicle, np.full(panels, 0.02), 0.05)
    own = (
        Unknown("log_scale", "scale", "1", float(np.log(FULL)), 0.3),
        Unknown("log_noise", "noise", "1", 0.0, 0.3),
        *(Unknown(f"log_gain_{j}", "gain", "1", 0.0, 0.1, j) for j in range(panels)),
        *tilts,
    )
    sun, response = units(rng.standard_normal((3, samples, 3))), vehicle.response_in()
    noise = 0.1 * rng.standard_normal((samples, panels))
    power = np.maximum(FULL * response.power(sun[0]) + noise, 0)
    used, of_tilts = rng.random((samples, panels)) > 0.1, panel_turns(vehicle, own)
    numbers = np.full(panels, SIGMA), 0.05, float(power.max())
    term = PanelPowers(power, used, *numbers, response, FULL, own=own, turns=of_tilts)
    return term, SunStates.of(sun, 0.1 * rng.standard_normal(sun.shape))


def only(term, seen, u):
    """Return the one residual of a term."""
    (residual,) = term.residuals(seen, u)
    return residual


def turned(seen: SunStates, step: np.ndarray) -> SunStates:
    """Return motions after a turn (3) of the body at every sample."""
    return SunStates.of(components_after_rotation(seen.sun_B, step), seen.omega)


@pytest.mark.parametrize("throttled", [False, True])
def test_panel_powers_change_as_their_derivatives_say(throttled):
    """Gains enter through their logarithm. Kaufman's slope of throttled samples is exact for readings that agree."""
    rng = np.random.default_rng(0)
    term, seen = lander_readings(rng)
    if throttled:
        seen = SunStates.of(seen.sun_B[:1], seen.omega[:1])
        exact = 0.7 * FULL * term.response.power(seen.sun_B[0])
        term = replace(term, throttled=True, power=exact, threshold=0.0)
    u = np.zeros((len(seen.omega), len(term.own)))
    residual = only(term, seen, u)
    for axis, step in enumerate(1e-6 * np.eye(3)):
        by = slope_of(lambda h: only(term, turned(seen, h), u).value, step, 1e-6)
        off = np.abs(by - residual.by_turn[..., axis])
        assert np.mean(off > 0.01 * np.abs(by).max()) < 0.01
    for i, step in enumerate(1e-4 * np.eye(len(term.own))):
        by = slope_of(lambda h: only(term, seen, u + h).value, step, 1e-4)
        off = np.abs(by - residual.by_u[..., i])
        assert np.mean(off > 0.01 * np.abs(by).max() + 1e-6) < 0.05, term.own[i].name


def test_a_reading_far_off_costs_no_more_than_its_being_an_outlier():
    """The cost grows with the square near the prediction, and ends where the reading may be anything; it then has no weight."""
    term, _ = lander_readings(np.random.default_rng(1))
    law = term.law(np.zeros((1, len(term.own))))
    sample, panel = np.argwhere(term.lit)[0]

    def cost(off: float) -> float:
        value = np.zeros((1, *term.power.shape))
        value[0, sample, panel] = off
        costs, weights = law(value)
        assert off < 50 or weights[0, sample, panel] < 1e-12
        return float(costs.sum())

    assert cost(0.0) == pytest.approx(0.0, abs=1e-12)
    assert cost(1.0) == pytest.approx(0.5, rel=0.02)
    # density at the peak over that of anything up to 1.5 times the largest, half of which is lit
    peak = (1 - OUTLIER) / (SIGMA * np.sqrt(2 * np.pi))
    anything = OUTLIER * 0.5 / (1.5 * term.largest)
    assert cost(100.0) == pytest.approx(np.log((peak + anything) / anything), rel=1e-9)


def test_a_dark_reading_bounds_the_power_from_above():
    """No power costs nothing, less than the threshold either; beyond it the cost is that of the excess."""
    term, seen = lander_readings(np.random.default_rng(2))
    dark = replace(term, power=np.zeros_like(term.power), used=np.ones_like(term.used))
    away = SunStates.of(np.broadcast_to([0.0, 0.0, -1.0], (1, 7, 3)), np.zeros((1, 7, 3)))
    u = np.zeros((1, len(term.own)))
    value = only(dark, away, u).value
    light = FULL * term.response.power(np.array([0.0, 0.0, -1.0]))
    np.testing.assert_allclose(value[0, 0], np.maximum(light - 0.05, 0) / SIGMA)


def test_the_noise_follows_the_scatter_of_lit_readings():
    """400 readings that scatter by twice the stated noise give its double; fitted numbers are taken off their count."""
    rng = np.random.default_rng(3)
    term, _ = lander_readings(rng, samples=80)
    term = replace(term, used=np.ones_like(term.used), power=np.ones_like(term.power))
    value = 2.0 * rng.standard_normal((1, *term.power.shape))
    u = np.zeros((1, len(term.own)))
    wide = replace(term.own[1], sigma=10.0)
    term = replace(term, own=(term.own[0], wide, *term.own[2:]))
    after = term.best_noise(value, u, np.zeros(1), -5.0)
    scatter = np.sqrt(np.mean(value**2))
    assert np.exp(term.log_noise(after))[0] == pytest.approx(scatter, rel=0.02)
    half = term.best_noise(value, u, np.full(1, value.size / 2), -5.0)
    assert np.exp(term.log_noise(half))[0] == pytest.approx(scatter * np.sqrt(2), rel=0.05)


def test_a_factor_on_a_throttled_sample_changes_no_misfit_of_exact_readings():
    rng = np.random.default_rng(4)
    term, seen = lander_readings(rng)
    exact = FULL * term.response.power(seen.sun_B[0])
    factors = np.linspace(0.2, 1.0, len(exact))[:, None]
    term = replace(term, power=factors * exact, used=np.ones_like(term.used), threshold=0.0)
    first, u = SunStates.of(seen.sun_B[:1], seen.omega[:1]), np.zeros((1, len(term.own)))
    assert np.abs(only(replace(term, throttled=True), first, u).value).max() < 1e-9


def test_the_density_of_a_lit_reading_is_one_over_all_readings():
    """What it may read above the threshold, and the probability of a dark reading, are one for a Sun that no panel sees."""
    term, _ = lander_readings(np.random.default_rng(5))
    away = np.array([[[0.0, 0.0, -1.0]]])
    assert term.response.power(away).min() == 0
    panel = int(np.argmin(term.response.power(away)[0, 0]))
    used = np.zeros((1, term.power.shape[1]), dtype=bool)
    used[0, panel] = True
    seen, u = SunStates.of(away, np.zeros((1, 1, 3))), np.zeros((1, len(term.own)))
    largest = term.largest

    def density(read: float) -> float:
        power = np.zeros((1, term.power.shape[1]))
        power[0, panel] = read
        one = replace(term, power=power, used=used, largest=largest)
        return float(np.exp(one.log_density(seen, u)[0]))

    # of the Gaussian the part above the threshold; of the outliers the lit half
    lit = quad(density, 0.05 + 1e-9, 1.5 * largest, limit=400, points=[0.1, 0.2])[0]
    expected = (1 - OUTLIER) * norm.sf(0.05 / SIGMA) + OUTLIER * 0.5 * (1 - 0.05 / (1.5 * largest))
    assert lit == pytest.approx(expected, rel=1e-3)
    # dark: relative to no power, so that a panel turned away says nothing
    assert density(0.0) == pytest.approx(1 - OUTLIER + OUTLIER * 0.5)


GIVEN = [
    {"kind": "rate", "t_s": 3.0, "value": 0.2, "sigma": 0.01},
    {"kind": "gyro", "t_s": 3.0, "value": [0.1, 0.2, -0.1], "sigma": 0.01},
    {"kind": "direction", "t_s": 3.0, "value": [0.0, 0.6, 0.8], "sigma": 0.02},
    {"kind": "field", "t_s": 3.0, "value": [0.0, 3.0, 4.0], "sigma": 0.02, "angle_rad": 1.1},
]


@pytest.mark.parametrize("given", GIVEN)
def test_given_readings_change_as_their_derivatives_say(given):
    rng = np.random.default_rng(6)
    _, seen = lander_readings(rng)
    term, none = Given.of(given, 2, 7), np.zeros((3, 0))
    residual = only(term, seen, none)
    assert not np.delete(residual.value, 2, axis=1).any()
    assert term.present().tolist() == [False, False, True, False, False, False, False]

    def faster(states, h):
        return SunStates.of(states.sun_B, states.omega + h)

    for moved, slopes in ((turned, residual.by_turn), (faster, residual.by_rate)):

        def value(h, moved=moved):
            return only(term, moved(seen, h), none).value

        for axis in np.eye(3):
            by = slope_of(value, 1e-6 * axis, 1e-6)
            expected = np.zeros_like(by) if slopes is None else slopes @ axis
            np.testing.assert_allclose(by, expected, atol=1e-5)


def test_given_readings_agree_with_the_motion_that_they_describe():
    sun = np.array([0.0, 0.6, 0.8])
    omega = np.array([0.1, 0.2, -0.1])
    seen = SunStates.of(np.tile(sun, (1, 7, 1)), np.tile(omega, (1, 7, 1)))
    # a direction may have any length
    values = {
        "rate": np.linalg.norm(omega),
        "gyro": omega,
        "direction": 2 * sun,
        "field": [3, 0, 0],
    }
    for given in GIVEN:
        right = given | {"value": values[given["kind"]]}
        right |= {"angle_rad": np.pi / 2} if given["kind"] == "field" else {}
        assert np.abs(only(Given.of(right, 2, 7), seen, np.zeros((1, 0))).value).max() < 1e-12


@pytest.mark.parametrize(
    "value", [{"kind": "rate", "value": -0.1}, {"kind": "direction", "value": [0, 0, 0]}]
)
def test_a_given_reading_that_nothing_can_show_is_refused(value):
    with pytest.raises(InputError, match="a rate is|a direction is"):
        Given.of(value | {"t_s": 3.0, "sigma": 0.01}, 2, 7)

"""Gains that an operator does not know: placeholders, which decide nothing, and guesses with a sigma, which give right rates."""

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.estimate.terms.panels import Panels
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Fact, TelemetryForm
from tests.support.simulate import CUBE, pulls, telemetry_of, uneven_times
from tests.support.vehicles import unit_vector

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

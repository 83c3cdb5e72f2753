"""The result of `posterior` on a short pass of a box with a wheel: its schema, and that it holds the truth."""

import json
import re

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.estimate.lander import carrier
from sunspin.estimate.lander.grid import grid_starts
from sunspin.estimate.lander.periods import draws_by_periods
from sunspin.estimate.lander.predict import best_motions, predict
from sunspin.estimate.posterior import posterior
from sunspin.output.kinds.posterior import posterior_summary, posterior_tables
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from tests.support.landers import (
    BOX_OMEGA,
    BOX_PRIORS,
    BOX_SUN,
    BOX_T_S,
    FEW,
    box,
    box_telemetry,
    sigmas_off,
)
from tests.support.schemas import schema, stored_schema
from tests.support.simulate import telemetry_of
from tests.support.vehicles import LOWER_CASE_FACES, units


def of_box(telemetry=None, priors=BOX_PRIORS, **options) -> xr.DataTree:
    """Return the posterior of the box with few draws, of its usual telemetry if none is given."""
    telemetry = box_telemetry() if telemetry is None else telemetry
    options = {"workers": 1, "settings": FEW} | options
    return posterior(box(), telemetry, priors, **options)


@pytest.fixture(scope="module")
def result() -> xr.DataTree:
    """Return the posterior of the box, with a period seen from outside."""
    return of_box(periods=[ss.Period(60.0, 2 * np.pi / np.linalg.norm(BOX_OMEGA), 10.0)])


def test_result_of_posterior_has_the_stored_schema(result):
    assert schema(result) == stored_schema("posterior")


def test_draws_hold_the_true_rate_and_the_result_decides(result):
    """Within three sigmas, and the words, the table and the probabilities say the same."""
    solutions = result["solutions"].to_dataset()
    assert sigmas_off(result, BOX_OMEGA)[0] < 3
    assert result.attrs["verdict_word"] == "unique" and result.attrs["verdict"].endswith("decided")
    assert bool(result["passes"]["decided"].values[0])
    assert solutions["probability"].values.sum() == pytest.approx(1.0)
    draws = result["posterior"].to_dataset()
    assert draws["omega_B"].values[0].std(axis=0) == pytest.approx(
        np.sqrt(np.diag(solutions["omega_cov_B"].values[0])), rel=0.1
    )
    # a wheel's speed is known to half a per cent
    assert draws["wheel_speed_rad_s"].values.mean() == pytest.approx(100.0, rel=0.01)


def test_results_do_not_depend_on_the_number_of_workers(result):
    lines: list[str] = []
    again = of_box(workers=2, progress=lines.append)
    assert lines[0].startswith("searching") and "under 1 models" in lines[1]
    for name in ("omega_B", "log_likelihood_sum", "inertia_zz"):
        expected = result["posterior"][name].values
        np.testing.assert_allclose(again["posterior"][name].values, expected, rtol=1e-9)


def test_samples_that_motions_explain_are_named_and_decided_by_themselves():
    """The rate jumps after nine of 13 samples, so that no motion explains all."""
    telemetry = box_telemetry(steps=4, step_rad_s=0.03)
    whole = of_box(telemetry)
    assert whole.attrs["verdict_word"] == "not sure"
    advice = re.search(r"--from (\d+) --to (\d+)", whole.attrs["verdict"])
    assert advice is not None, whole.attrs["verdict"]
    part = of_box(telemetry, begin_s=float(advice[1]), end_s=float(advice[2]))
    assert part.attrs["verdict_word"] == "unique" and sigmas_off(part, BOX_OMEGA)[0] < 3


def wheelless_box(inertia: np.ndarray, noise_W: float, gain_W: float = 7.0) -> Vehicle:
    """Return a box with six panels and without wheels; those across z have a third of the gain."""
    faces = LOWER_CASE_FACES.items()
    panels = [Panel(name, face, 2.3 if "z" in name else gain_W) for name, face in faces]
    form = TelemetryForm(quantity="power_W", noise=noise_W)
    return Vehicle("b", inertia_kg_m2=inertia, panels=panels, gain_unit="W", telemetry=form)


def test_a_bad_reading_in_the_first_window_does_not_rule_out_the_true_motion():
    """The brightest panel of one of its three samples is shaded; the search begins again elsewhere."""
    craft, t_s = wheelless_box(np.diag([0.042, 0.04, 0.009]), 0.14), 30.0 * np.arange(14)
    omega, sun = np.array([0.0066, 0.0689, 0.0531]), units(np.array([-0.688, 0.181, 0.702]))
    power = ss.panel_power(craft, ss.propagate(craft, omega, sun, [], t_s)["sun_B"].values)
    power += 0.14 * np.random.default_rng(0).standard_normal(power.shape)
    power[1, power[1].argmax()] *= 0.3
    telemetry = telemetry_of(craft, t_s, np.maximum(power, 0.0))
    priors = {"max_rate_rad_s": 0.1745, "steady_torque": 0.0}
    tree = posterior(craft, telemetry, priors, workers=1, settings=FEW)
    assert tree.attrs["verdict_word"] == "unique" and sigmas_off(tree, omega)[0] < 3


SLOW = """
0 0 0.656 0.077 2.22 0.132 0.62
48.284 0.032 0.918 0.045 1.996 0 0.449
83.642 0.013 0.796 0 2.173 0.058 0.627
110.832 0 1.102 0 2.083 0 0.532
159.637 0.046 0.983 0 2.085 0.133 0.274
193.79 0.027 1.055 0 1.997 0 0.32
218.454 0 1.132 0 2.006 0 0.36
243.471 0 1.086 0.023 1.851 0.028 0.224
270.29 0.006 1.311 0 1.896 0 0.261
324.963 0 1.289 0.036 1.959 0.09 0.164
352.177 0.061 1.212 0.051 1.992 0.094 0.267
382.31 0.103 1.451 0 1.852 0.042 0.115
"""
"""Times (s) and powers (W) of a 1U at 0.1 deg/s, simulated by a program that shares no code with the package, with 3 % noise."""


@pytest.mark.long
def test_a_slow_body_among_fast_motions_is_kept():
    """A few samples hardly determine the rate about the Sun direction. Only 1.9 deg/s was found, and decided."""
    craft = wheelless_box(np.diag([2.1e-3, 2.2e-3, 1.9e-3]), 0.069, gain_W=2.3)
    read = np.array([row.split() for row in SLOW.strip().splitlines()], dtype=float)
    telemetry = telemetry_of(craft, read[:, 0], read[:, 1:])
    tree = posterior(craft, telemetry, {"max_rate_rad_s": 0.1047}, workers=1)
    speeds = np.linalg.norm(tree["solutions"]["omega_B"].values, axis=1)
    assert tree.attrs["verdict_word"] == "aliases"
    assert tree["solutions"]["probability"].values[speeds < 0.004].sum() > 0.03


def test_a_period_that_no_draw_has_decides_nothing(result):
    """The sum of precession and spin takes 89 s; a period of 20 s is none of the three."""
    shares = draws_by_periods(box(), result, [ss.Period(60.0, 20.0, 0.1)])
    assert shares.attrs["told"] == 0 and shares.attrs["nearest_sigmas"] > 4
    without = shares["solution_probability_before"].values
    np.testing.assert_allclose(shares["solution_probability"].values, without)


def test_readings_that_no_motion_explains_are_not_explained():
    """Four readings of each of two panels are a third of what they should be. Those of one alone a motion leaves out as outliers.

    Moments of inertia then take the larger of their sigmas, and so must the curvature about the motions that fit least badly.
    """
    telemetry = box_telemetry()
    power = telemetry["power_W"].values.copy()
    for panel in (0, 2):
        power[np.flatnonzero(power[:, panel] > 1.0)[:4], panel] *= 0.3
    tree = of_box(telemetry.assign(power_W=(("time", "panel"), power)))
    assert tree.attrs["verdict_word"] == "not explained" and tree.attrs["p_value"] < 0.002
    assert not bool(tree["passes"]["fits"].values[0])
    assert (
        tree.attrs["verdict"].count("no motion is within the noise") == 1
    )  # of the first such window


def test_a_torque_that_the_file_lacks_is_found_and_named(monkeypatch, caplog):
    """It is constant in the body and turns it by four rad in two minutes; draws of the result bring its size.

    The searches under torques are announced, and begin at the starts of a search without, of which there are two: no motion fits.
    """
    inertia, acceleration = box().require_inertia(), 6e-4 * np.array([0.6, -0.5, 0.6])
    searched = []

    def counted(*args):
        searched.append(args)
        return grid_starts(*args)

    monkeypatch.setattr("sunspin.estimate.posterior.grid_starts", counted)
    monkeypatch.setattr(carrier, "LONG_S", 0.0)
    tree = of_box(box_telemetry(inertia @ acceleration), {"max_rate_rad_s": 0.1})
    assert len(searched) == 2 and "searching under constant torques takes about" in caplog.text
    models = json.loads(tree.attrs["hypotheses"])
    assert models["a steady torque in body axes"] > 0.9
    assert "an alternative model fits better: a steady torque in body axes" in tree.attrs["verdict"]
    assert sigmas_off(tree, BOX_OMEGA)[0] < 3.5
    steady = tree["posterior"]["steady_torque"].values[0, :, 0]
    expected = inertia @ acceleration / (np.trace(inertia) / 3)
    assert np.all(np.abs(steady.mean(axis=0) - expected) < 4 * steady.std(axis=0))


@pytest.mark.slow
def test_the_posterior_takes_samples_that_are_off_in_time():
    """Times off by 2 s, a tenth of a radian: taken for exact they look like noise; stated, the truth is within its sigmas."""
    off_s = 2.0 * np.random.default_rng(5).standard_normal(len(BOX_T_S) - 1)
    late = box_telemetry().assign_coords(time=BOX_T_S + np.append(0.0, off_s))
    stated, exact = of_box(late, BOX_PRIORS | {"time_s": 2.0}), of_box(late)
    assert exact.attrs["noise_sigmas"] > 2 > abs(stated.attrs["noise_sigmas"])
    assert stated.attrs["log_evidence"] > exact.attrs["log_evidence"] + 3
    assert stated.attrs["time_sigma_s"] == 2.0
    assert sigmas_off(stated, BOX_OMEGA)[0] < 3.5


def test_output_and_predictions_read_the_result(result):
    """Summary, tables and figures are made from it; draws carried to the end of the pass and back are those of the result."""
    summary = posterior_summary(result)
    assert summary["verdict_word"] == "unique" and len(summary.lines) > 5
    assert [table.name for table in posterior_tables(result)] == ["solutions", "passes"]
    predicted = predict(box(), result, [0.0, 120.0])
    speed = predicted["rate"].mean([d for d in predicted["rate"].dims if d != "predicted_s"])
    run = ss.propagate(box(), BOX_OMEGA, BOX_SUN, [100.0], [0.0, 120.0])
    expected = np.linalg.norm(run["omega_B"].values, axis=1)
    np.testing.assert_allclose(speed.values, expected, rtol=0.05)
    (motion,) = best_motions(box(), result)
    assert motion["time"].values[-1] == pytest.approx(120.0)


def test_a_gyro_reading_of_a_person_narrows_the_rate(result):
    """At the first sample, good to 2e-4 rad/s: a third of the sigma that panels leave."""
    value = (BOX_OMEGA + np.array([1e-4, -2e-4, 1e-4])).tolist()
    tree = of_box(observations=[{"kind": "gyro", "t_s": 0.0, "value": value, "sigma": 2e-4}])
    sigma, before = (
        np.sqrt(np.diag(one["solutions"]["omega_cov_B"].values[0])) for one in (tree, result)
    )
    assert np.all(sigma < 2.1e-4) and np.all(before > 2 * sigma)
    assert tree.attrs["p_value"] > 0.02 and tree.attrs["samples"] == len(BOX_T_S)
    assert str(tree["passes"]["columns_checked"].values[0]) == "as_stated"

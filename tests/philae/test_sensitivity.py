"""Maps of E and growth of errors, compared with single runs and closed forms."""

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.compute.identity import to_json
from sunspin.philae import error_growth as gr
from sunspin.philae import metrics
from sunspin.philae.rebound import Options
from sunspin.vehicle import Friction, Panel, Vehicle, Wheel
from tests.support.philae import CASE, SUN

CORNERS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
FACES = [Panel(str(k), corner, 1.0) for k, corner in enumerate(CORNERS)]
ROUND = Vehicle("round, no wheel", np.diag([2.0, 2.0, 3.0]), panels=FACES)
ON_X = Wheel("w", [1, 0, 0], 0.01, 100.0, Friction(1e-4, 1e-7))
SIDEWAYS = Vehicle("wheel on x", np.diag([3.0, 2.5, 2.0]), panels=FACES, wheels=[ON_X])
CRAFT = [(ROUND, None), (SIDEWAYS, 100.0)]


def own_track(craft, omega, speed, times):
    run = ss.propagate(craft, omega, [0.6, 0.0, 0.8], speed, times)
    return xr.Dataset({"sun_B": (("time", "axis"), run["sun_B"].values)}, coords={"time": times})


@pytest.fixture(scope="module")
def result():
    return metrics.compute_sensitivity(CASE, SUN, Options(coarser=12))


@pytest.mark.parametrize(("craft", "speed"), CRAFT, ids=["no wheel", "wheel on x"])
def test_maps_of_E_agree_with_single_runs(craft, speed):
    times, omega = np.array([0.0, 50.0, 130.0, 210.0]), [0.1, 0.05, -0.08]
    track = own_track(craft, omega, speed, times)
    axes = [np.array([0.09, 0.1]), np.array([0.05, 0.07]), np.array([-0.08])]
    rates = ss.scan(craft, track, [0.6, 0.0, 0.8], *axes, speed)
    second = "mu_0" if craft.wheels else "theta_xy"
    values = {"theta_xx": np.array([2.1, 2.2]), second: np.array([1e-4, 3e-4])}
    motion = gr.ReferenceMotion.of(craft, omega, [0.6, 0.0, 0.8], speed, 210.0)
    parameters = gr.parameter_map(motion, track, values)
    for i in range(2):
        for j in range(2):
            start = [axes[0][i], axes[1][j], -0.08]
            run = ss.propagate(craft, start, [0.6, 0.0, 0.8], speed, times)
            assert rates.values[i, j, 0] == pytest.approx(ss.direction_error(run, track), abs=1e-4)
            other = gr.with_parameter(craft, "theta_xx", values["theta_xx"][i])
            other = gr.with_parameter(other, second, values[second][j])
            run = ss.propagate(other, omega, [0.6, 0.0, 0.8], speed, times)
            expected = ss.direction_error(run, track)
            assert parameters.values[i, j] == pytest.approx(expected, abs=1e-4)
    assert rates.values[1, 0, 0] < 1e-6  # the truth
    assert parameters.values.min() > 1e-6  # not among these


def test_E_of_a_scaled_start_direction_agrees_with_the_formula():
    """The Sun's motion is linear in its start: E by the formula, and by scaling the track."""
    track = np.array([[0.6, 0, 0.8], [0, 1, 0]])
    measured = np.array([[0, 0, 1], [0, 0.8, 0.6]])
    direct = ss.direction_error(0.9646 * track, measured)
    found = gr.error_of_start_length(ss.direction_error(track, measured), 0.9646)
    assert found == pytest.approx(direct, abs=1e-15)
    assert gr.error_of_start_length(0.0, 0.9646) == pytest.approx(0.0177, abs=5e-5)  # the bound


def test_a_varied_parameter_changes_nothing_else_of_the_vehicle():
    craft = CASE.vehicle
    changed = gr.with_parameter(gr.with_parameter(craft, "mu_0", 2e-3), "theta_xy", -0.3)
    assert changed.wheels[0].friction == Friction(2e-3, craft.wheels[0].friction.viscous_N_m_s)
    assert changed.inertia_kg_m2[0, 1] == changed.inertia_kg_m2[1, 0] == -0.3
    assert np.count_nonzero(changed.inertia_kg_m2 != craft.inertia_kg_m2) == 2
    for name in (*gr.INERTIA, *gr.WHEEL_PARAMETERS):
        same = gr.with_parameter(craft, name, gr.nominal_value(craft, name))
        assert to_json(same) == to_json(craft)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: gr.with_parameter(ROUND, "mu_0", 1.0), "mu_0 belongs to a wheel"),
        (lambda: gr.nominal_value(ROUND, "J"), "J belongs to a wheel"),
        (lambda: gr.with_parameter(ROUND, "mass", 1.0), "no parameter of this name"),
        (
            lambda: gr.ReferenceMotion.of(ROUND, [0, 0, 1], [0, 0, 1], None, 0.0),
            "duration_s must be positive",
        ),
    ],
)
def test_bad_input_of_maps_and_error_growth_is_named(call, text):
    with pytest.raises(ss.SunspinError, match=text):
        call()


def test_error_growth_of_a_pure_spin_agrees_with_the_closed_form():
    """A body that spins about its axis of symmetry: the Sun at right angles to it errs by t times the error of the rate."""
    motion = gr.ReferenceMotion.of(ROUND, [0, 0, 0.1], [1, 0, 0], None, 600.0)
    table = gr.growth(motion)
    error = table["error_rad"].sel(input="omega_z").values[1:]
    np.testing.assert_allclose(error, 0.1 * table["time"].values[1:], rtol=1e-5)
    assert float(table["power"].sel(input="omega_z")) == pytest.approx(1.0, abs=1e-4)
    # negative control: it does not enter
    assert float(table["error_rad"].sel(input="theta_zz").max()) < 1e-6
    names = "omega_x omega_y omega_z theta_xx theta_yy theta_zz"
    assert " ".join(table["input"].values) == names


def test_friction_makes_the_error_grow_with_the_square_of_time():
    """Wheel and body on one axis: the body gains mu_0 t / (Theta - J), the angle mu_0 t^2 / (2 (Theta - J))."""
    wheel = Wheel("w", [0, 0, 1], 0.01, 100.0, Friction(1e-4, 0.0))
    craft = Vehicle("one axis", np.diag([2.0, 2.0, 3.0]), panels=FACES, wheels=[wheel])
    table = gr.growth(gr.ReferenceMotion.of(craft, [0, 0, 0], [1, 0, 0], 100.0, 600.0))
    late = table["time"].values[1:]
    angle = 1e-4 * late**2 / (2 * (3.0 - 0.01))
    error = table["error_rad"].sel(input="mu_0").values[1:]
    np.testing.assert_allclose(error, angle, rtol=1e-3, atol=1e-6)
    assert float(table["power"].sel(input="mu_0")) == pytest.approx(2.0, abs=0.01)


def test_the_valley_width_is_inverse_to_the_window_and_agrees_with_the_closed_form():
    """Plain spin, Sun across it: E = (1 - sinc) / 2 of change times window, half its depth at about 1.9 rad."""
    motion = gr.ReferenceMotion.of(ROUND, [0.1, 0, 0], [0, 0.6, 0.8], None, 400.0)
    ball = Vehicle("ball", np.eye(3), panels=FACES)
    state = motion.omega_B, motion.sun_B, motion.wheel_speed_rad_s
    motion = gr.ReferenceMotion(ball, *state, 400.0)
    valley = gr.valleys(motion, np.linspace(-0.05, 0.05, 2001), [200.0, 400.0], 2.0)
    x = valley["change"].values[:, None] * np.arange(0.0, 400.1, 2.0)
    expected = (1 - np.cos(x).mean(axis=1)) / 2
    np.testing.assert_allclose(valley.sel(window=400.0).values, expected, atol=1e-3)
    wide, narrow = gr.valley_width(valley)
    assert wide / narrow == pytest.approx(2.0, abs=0.1)


def test_a_change_of_one_percent_moves_E_and_not_EMD(result):
    """Paper, section 2.3; PHYSICS: 180 to 2000 rad per rad/s at 45 min; the printed start allows no E below 0.0177."""
    rows = {row.id: row for row in metrics.sensitivity_rows(result)}
    assert {"E_map_rates", "E_map_parameters"} <= set(rows)
    assert all(rows[name].agrees for name in ("one_percent_E", "one_percent_emd", "phase_growth"))
    assert rows["one_percent_E"].ours > 20 * rows["one_percent_emd"].ours
    last = result.motions["error_rad"].sel(input=list(gr.RATES)).isel(time=-1)
    per_rate = (last / result.motions["angular_speed"]).values
    assert 180 < per_rate.min() < 600 and 1500 < per_rate.max() < 2200
    assert rows["E_study_bound"].ours == pytest.approx(0.0177, abs=5e-5)
    assert rows["valley_width"].ours[-1] < CASE.published["scan_step"].value / 3
    assert min(result.rates.min(), result.parameters.min()) >= rows["E_study_bound"].ours


def test_the_effect_of_one_percent_is_the_larger_of_both_signs():
    motion = gr.ReferenceMotion.of(ROUND, [0.1, 0.02, 0.05], [0.6, 0.0, 0.8], None, 120.0)
    t = np.arange(0.0, 121.0, 20.0)
    both = [
        ss.direction_error(*motion.tracks(t, [("theta_xx", change)])) for change in (0.01, -0.01)
    ]
    assert max(both) > 1.001 * min(both)
    found = gr.one_percent(motion, 20.0)["E"].sel(input="theta_xx").item()
    assert found == pytest.approx(max(both), rel=1e-6)


def test_valleys_are_counted_along_both_axes():
    x, y = np.meshgrid(np.linspace(0, 4 * np.pi, 81), np.linspace(0, 2 * np.pi, 61), indexing="ij")
    assert metrics.count_valleys(np.cos(x) + 0.3 * np.cos(y)) == [2, 1]
    assert metrics.count_valleys(np.cos(x + 0.1 * y)) == [2, 0]
    assert metrics.count_valleys(x + y + 0.001 * np.cos(20 * x)) == [0, 0]

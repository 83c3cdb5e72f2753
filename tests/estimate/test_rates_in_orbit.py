"""Passes in an orbit, spinners, a field alone, sensors that are late, and gravity: whole passes. All telemetry is synthetic."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.environment import circular
from sunspin.environment.ephemeris import OrbitFile
from sunspin.environment.frames import FIELD_Z_LOCAL
from sunspin.environment.orbit import SunAlongZ
from sunspin.estimate.field_led import leading_field
from sunspin.estimate.model import Body, Model, Noise, Track
from sunspin.estimate.observe import FIELD_ONLY, observe, split_passes
from sunspin.estimate.one_pass import drop_faster
from sunspin.estimate.orbit.calibration import calibrate_magnetometer
from sunspin.estimate.rates import along_the_sun, rates
from sunspin.estimate.settings import FIELD_TURN, RATES
from sunspin.estimate.terms.field import FieldChange, KnownField
from sunspin.estimate.terms.panels import Panels
from sunspin.estimate.verdict import COLUMNS_UNCHECKED
from sunspin.output.check.orbit import choose_orbit
from sunspin.output.export import build_attitude
from sunspin.telemetry.assess import assess
from sunspin.telemetry.synthetic import telemetry_dataset
from sunspin.vehicle import Panel, Vehicle
from sunspin.vehicle.sensors import Clock, Disturbance, Magnetometer, Sensors
from tests.support.orbit_cases import one_pass, orbit_of, pass_against_truth, rates_case
from tests.support.passes import printed_rates
from tests.support.simulate import cube_with_late_sensor, cube_with_sensor, pulls, telemetry_of
from tests.support.vehicles import small_cube, units
from validation import spinners


@pytest.fixture(scope="module")
def case():
    """Return vehicle, telemetry, orbit, calibration, truth and begin of a pass of a CubeSat with a dipole under clouds."""
    vehicle, data, elements, truth, about = rates_case(1, 3, patches=1000)
    orbit = replace(orbit_of(elements, data, about), shift_s=about["ahead_s"], shift_sigma_s=2.0)
    calibration = calibrate_magnetometer(orbit, assess(vehicle, data))
    return vehicle, data, orbit, calibration, truth, about["begin_s"][0]


def pull_in_the_middle(result, true_rad_s, t_s):
    """Return the error (3) of the first pass's rate in its sigmas at the middle sample, by true rates (n, 3) at times (n)."""
    used = result["time"].values[result["pass_of"].values == 0]
    at_s = used[np.argmin(np.abs(used - (used[0] + used[-1]) / 2))]
    (rate, *_), (sigma, *_) = printed_rates(result)
    return (rate - true_rad_s[np.abs(np.array(t_s) - at_s).argmin()]) / sigma


def test_a_sample_in_the_shadow_uses_its_field_and_requires_dark_panels(case):
    vehicle, data, orbit, calibration, _, _ = case
    assessment = assess(vehicle, data)
    known = observe(assessment, None, SunAlongZ(orbit), calibration)
    plain = observe(assessment)
    panels, field = known.obs.terms[:2]
    assert isinstance(panels, Panels) and isinstance(field, KnownField)
    dark = np.flatnonzero(panels.sun_up == 0)
    assert len(dark) and set(known.why[dark]) == {FIELD_ONLY + "no panel lit"}
    assert len(known.usable) == len(data["time"]) > len(plain.usable)
    assert np.isfinite(panels.sigma[dark]).all() and not known.obs.sees_sun[dark].any()
    stated = Model(known.obs, Body.of(vehicle), Noise(1e-4), 0.1)
    assert leading_field(stated.seeing(dark[:6])) is not None and leading_field(stated) is None


def test_a_pass_goes_on_while_the_field_is_read_and_panels_look_away(case):
    vehicle, data, *_ = case
    t_s = 5.0 * np.arange(60)
    power = np.zeros((60, len(vehicle.panels)))
    power[:15, 0] = power[-15:, 0] = 1.0  # 150 s without a Sun
    alone = telemetry_of(vehicle, t_s, power)
    turned = Rotation.from_rotvec(0.02 * t_s[:, None] * [[0.0, 0.0, 1.0]])
    field = alone.assign(field_B=(("time", "axis"), 3e4 * turned.apply([0.6, 0.0, 0.8])))
    for data, count in ((alone, 2), (field, 1)):
        assert len(split_passes(observe(assess(vehicle, data)), None, RATES.passes)) == count


def test_a_motion_beyond_the_largest_rate_is_dropped_only_if_a_slower_one_fits(case):
    vehicle, data, *_ = case
    obs = observe(assess(vehicle, data)).obs.take(np.arange(4))
    model = Model(obs, Body.of(vehicle), Noise(1e-4), rate_sigma=0.5)
    omega = np.array([[0.0, 0.0, 0.2], [0.0, 0.0, 1.1]])[:, None] * np.ones((4, 1))
    motions = Track.unfitted(np.tile(np.eye(3), (2, 4, 1, 1)), omega)
    fitting = replace(motions, cost=np.array([1.0, 0.5]))
    assert len(drop_faster(model, fitting, RATES.search)) == 1
    assert len(drop_faster(model, replace(motions, cost=np.array([1e3, 0.5])), RATES.search)) == 2


def test_a_stated_zero_sigma_counts_once_if_the_orbit_calibrates(case):
    """The calibration has the zero's error, in tesla; that of the vehicle file is in the unit of the columns."""
    vehicle, data, orbit, calibration, _, _ = case
    part = replace(vehicle.sensors.magnetometer, zero_sigma=np.full(3, 4.0))
    stated = replace(vehicle, sensors=replace(vehicle.sensors, magnetometer=part))
    found = []
    for craft in (vehicle, stated):
        seen = observe(assess(craft, data), None, SunAlongZ(orbit), calibration)
        (known,) = (term for term in seen.obs.terms if isinstance(term, KnownField))
        found.append([(one.name, one.sigma) for one in known.unknowns()])
        assert sum(isinstance(term, FieldChange) for term in seen.obs.terms) == 0
    assert found[0] == found[1]


@pytest.mark.long
@pytest.mark.evidence("rates", "modelled", "a simulated CubeSat in its orbit, under clouds")
def test_a_pass_in_its_orbit_has_the_true_rate_and_its_attitude_in_J2000(case):
    vehicle, data, orbit, calibration, truth, begin_s = case
    result = rates(vehicle, one_pass(data, begin_s), environment=orbit, calibration=calibration)
    found = pass_against_truth(result, truth, 0)
    assert result.attrs["frame_N"] == "J2000" and result.attrs["field_used"] == 1
    assert found["attitude_deg"] < 6 and max(np.abs(found["pulls"])) < 4 and not found["wrong"]
    assert result["turn_sigma_rad"].values.max() < 0.3
    quaternion, of_pass = result["B_from_N"].values, result["pass_of"].values
    same = np.diff(of_pass) == 0
    assert np.einsum("ni,ni->n", quaternion[1:], quaternion[:-1])[same].min() > 0
    message = build_attitude(result)
    assert message.number == str(orbit.elements[0].number)
    assert message.centre == "EARTH" and message.name != "UNKNOWN"


@pytest.mark.long
@pytest.mark.evidence("rates", "modelled", "the same CubeSat with its magnetometer alone")
def test_a_field_that_an_orbit_knows_leads_the_search_without_a_sun(case):
    vehicle, data, orbit, calibration, truth, begin_s = case
    field = one_pass(data, begin_s).drop_vars(["power_W", "panel"])
    result = rates(vehicle, field, environment=orbit, calibration=calibration)
    found = pass_against_truth(result, truth, 0)
    assert result.attrs["source"] == "field" and found["listed"]
    assert max(np.abs(found["pulls"])) < 5


def rates_along_right_elements(case, folder, **options):
    """Return the truth of a simulated spinner, and the result of `rates` along its orbit, without column tests."""
    truth = spinners.make(case, folder)
    craft = ss.load_vehicle(folder / "vehicle.toml")
    assessment = assess(craft, ss.read_telemetry(folder / "telemetry.csv", craft))
    chosen = choose_orbit(assessment, OrbitFile(folder / "right.tle"), None)
    around = {"environment": chosen.orbit, "calibration": chosen.calibration}
    return truth, rates(craft, assessment, column_tests=False, **around, **options)


@pytest.mark.long
@pytest.mark.evidence("rates", "modelled", "a simulated spinner through an eclipse")
def test_a_slow_rotation_is_found_through_a_long_eclipse(tmp_path):
    """The field turns in space while the Sun is not seen: it was taken for the body, which was decided five sigma off."""
    case = spinners.cases(31, 15)[14]
    truth, result = rates_along_right_elements(case, tmp_path, pass_id=0)
    omega, sigma = printed_rates(result)
    off = omega - np.radians(truth["rates_deg_s"][result.sizes["time"] // 2])
    assert (np.abs(off) < 4 * sigma).all(axis=1).any()
    assert np.nanmin(sigma, axis=0).max() < np.radians(0.02)


@pytest.mark.slow
@pytest.mark.evidence("rates", "modelled", "a simulated slow spinner with a magnetometer")
def test_the_true_motion_is_not_lost_between_the_search_and_the_fit(tmp_path):
    """The fit took half of the field's readings for outliers, and an alias 36 deg/s off was decided."""
    case = spinners.cases(71, 7)[6]
    truth, result = rates_along_right_elements(case, tmp_path)
    assert result["decided"].values.all()
    speed = np.linalg.norm(result["omega_B"].values, axis=1)
    true = np.radians(np.linalg.norm(truth["rates_deg_s"], axis=1))
    assert np.abs(speed - true).max() < 4 * result["speed_sigma"].values.max()


@pytest.mark.slow
@pytest.mark.evidence("rates", "modelled", "a simulated slow spinner with a magnetometer")
def test_a_motion_that_the_search_lost_in_one_pass_is_found_from_the_rotation_in_another(tmp_path):
    """A steady torque made up for it, and the pass was decided 9 sigma off."""
    truth, result = rates_along_right_elements(spinners.cases(111, 11)[10], tmp_path)
    sigma = np.sqrt(np.einsum("nii->ni", result["omega_cov_B"].values))
    off = result["omega_B"].values - np.radians(truth["rates_deg_s"])
    assert result["decided"].values.all() and (np.abs(off) < 4 * sigma).all()


MAGNETOMETER = Magnetometer(("x", "y", "z"), np.zeros(3), 400.0, zero_sigma=np.full(3, 300.0))
SENSORS = Sensors(magnetometer=MAGNETOMETER, disturbance=Disturbance(2e-5, max_rate_rad_s=0.05))
PANEL, INERTIA = Panel("+X", [1, 0, 0], 1.0), np.diag([0.02, 0.028, 0.012])
CUBE = Vehicle("cube", INERTIA, panels=(PANEL,), gain_unit="W", sensors=SENSORS)


def field_alone(seed):
    """Return the magnetometer of a free body in a field that turns by 0.1 deg/s, and its rates."""
    rng = np.random.default_rng(seed)
    t_s = 15.0 * np.arange(24)
    run = ss.propagate(CUBE, np.radians(1.5) * rng.normal(size=3), [0.6, 0.0, 0.8], None, t_s)
    turned = Rotation.from_rotvec(1.7e-3 * t_s[:, None] * units(rng.normal(size=3)))
    field = Rotation.from_quat(run["B_from_N"].values).apply(3e4 * turned.apply([0.2, 0.5, -0.8]))
    read = field + 400 * rng.normal(size=field.shape)
    data = telemetry_of(CUBE, t_s, np.ones((24, 1)), field_B=(("time", "axis"), read))
    return data.drop_vars(["power_W", "panel"]), run["omega_B"].values


@pytest.mark.evidence("rates", "modelled", "a simulated magnetometer alone, without an orbit")
def test_rates_of_a_field_alone_are_right_and_the_sun_is_unknown():
    pulls = []
    for seed in (1, 2):
        data, omega = field_alone(seed)
        result = rates(CUBE, data)
        pulls.append(pull_in_the_middle(result, omega, data["time"].values))
        sigma = printed_rates(result)[1][0]
        assert np.all(sigma > FIELD_TURN / np.sqrt(3)) and result.attrs["frame_N"] == FIELD_Z_LOCAL
        # the axes turn steadily: the mean of the pass is no surer
        assert np.all(result["omega_sigma_all_B"].values > FIELD_TURN / np.sqrt(3))
        assert np.isnan(result["sun_B"].values).all()
        assert np.isfinite(result["field_direction_B"].values).all()
        assert "NO ORBIT" in result.attrs["verdict"] and result.attrs["field_used"] == 1
        # a reversed axis of the sensor would fit with the mirrored motion
        assert result["columns_checked"].values.tolist() == [COLUMNS_UNCHECKED]
    assert np.abs(pulls).max() < 4


def test_a_field_alone_needs_its_noise():
    silent = replace(MAGNETOMETER, noise=None)
    blunt = replace(CUBE, sensors=replace(SENSORS, magnetometer=silent))
    with pytest.raises(InputError, match="needs its `noise` in the vehicle file, or an orbit"):
        rates(blunt, field_alone(1)[0])


@pytest.mark.evidence("rates", "modelled", "simulated sensors that are read late, and prompt ones")
@pytest.mark.parametrize(
    ("kind", "seed", "late_s"),
    [("gyro", 101, 5.0), ("gyro", 101, 0.0), ("attitude", 102, -4.0), ("field", 101, 5.0)],
)
def test_a_stated_time_offset_is_estimated_within_its_sigma(kind, seed, late_s):
    data, run = cube_with_late_sensor(kind, late_s, np.random.default_rng(seed))
    vehicle = cube_with_sensor(kind, Clock(0.0, 5.0))
    result = rates(vehicle, data, max_rate_rad_s=0.15, column_tests=False)
    found, sigma = result.attrs["sensors_late_s"], result.attrs["sensors_late_sigma_s"]
    assert abs(found - late_s) < 3.5 * sigma and sigma < 1.5
    assert "late (vehicle file and data)" in result.attrs["verdict"]
    truth = run["omega_B"].sel(time=result["time"]).values
    assert np.abs(result["omega_mean_B"].values[0, 0] - truth.mean(axis=0)).max() < np.radians(0.1)
    assert result["decided"].values[0]


def test_a_late_gyro_of_which_the_file_says_nothing_does_not_fit():
    data, _ = cube_with_late_sensor("gyro", 5.0, np.random.default_rng(101))
    result = rates(cube_with_sensor("gyro", None), data, max_rate_rad_s=0.15)
    assert not result["decided"].values[0]
    assert np.isnan(result.attrs["sensors_late_s"]) and "late" not in result.attrs["verdict"]


@pytest.mark.long
@pytest.mark.evidence("rates", "modelled", "a simulated spinner with a large unknown zero")
def test_a_spinner_with_a_large_zero_has_the_true_rate(tmp_path):
    body, zero = (5, 2, -6.0, 1, 1.0, ("+X", "-Y")), (0.9, -0.6, 0.4)
    rest = (True, 1.3, True, 0.1, 2.0, 150)
    truth = spinners.make(spinners.Case(*body, spinners.AS_MOUNTED, zero, *rest), tmp_path)
    craft = ss.load_vehicle(tmp_path / "vehicle.toml")
    result = rates(craft, ss.read_telemetry(tmp_path / "telemetry.csv", craft))
    pull = pull_in_the_middle(result, np.radians(truth["rates_deg_s"]), truth["t_s"])
    assert np.abs(pull).max() < 4 and result["fits"].values[0]


ORBIT = circular(1.1e-3, [0.0, 1.0, 0.3], [0.0, 0.0, 1.0])


@pytest.mark.long
@pytest.mark.evidence("rates", "modelled", "a simulated CubeSat that gravity turns")
def test_gravity_determines_the_turn_about_the_sun():
    inertia = np.array([[0.042, 0.0005, 0.0], [0.0005, 0.041, -0.001], [0.0, -0.001, 0.009]])
    cube = replace(small_cube(0.01), inertia_kg_m2=inertia)
    rng, attitude = np.random.default_rng(3), Rotation.random(random_state=4)
    t_s = np.concatenate([[0.0], np.cumsum(60 * rng.uniform(0.7, 1.3, 29))])
    gravity = {"environment": ORBIT, "torques": ("gravity_gradient",)}
    start, sun = np.array([0.004, -0.003, 0.006]), attitude.apply([0, 0, 1])
    run = ss.propagate(cube, start, sun, None, t_s, B_from_N=attitude.as_quat(), **gravity)
    power = ss.panel_power(cube, run["sun_B"].values)
    power = np.maximum(power + 0.01 * rng.normal(size=power.shape), 0)
    data = telemetry_dataset(cube, t_s, power, run["sun_B"].values, "2026-01-01T00:00:00Z", {})
    options = {"acceleration_noise": 1e-7, "max_rate_rad_s": 0.03}
    free = rates(cube, data, environment=ORBIT, **options)
    pulled = rates(cube, data, **gravity, **options)
    true_rate = run["omega_B"].sel(time=free["time"]).values
    off = [np.abs(each["omega_B"].values - true_rate).mean() for each in (free, pulled)]
    assert np.sqrt(np.mean(pulls(pulled, run) ** 2)) < 1.5 and off[1] < off[0] / 2
    found = Rotation.from_quat(pulled["B_from_N"].values)
    true = Rotation.from_quat(run["B_from_N"].values)
    assert np.degrees((found * true.inv()).magnitude()).max() < 20.0


def test_a_torque_without_the_environment_that_it_needs_is_refused():
    data = telemetry_of(CUBE, 10.0 * np.arange(10), np.ones((10, 1)))
    with pytest.raises(ss.MotionError, match="'gravity_gradient' needs an environment"):
        rates(CUBE, data, torques=("gravity_gradient",))


def test_an_environment_whose_sun_is_not_along_z_is_refused():
    def aside(t_s):
        return replace(ORBIT.at(t_s), sun_N=np.tile([1.0, 0.0, 0.0], (np.size(t_s), 1)))

    with pytest.raises(InputError, match="z of its N to the Sun"):
        along_the_sun(SimpleNamespace(frame_N="x", at=aside))


def test_a_field_alone_is_searched_again_if_torques_bend_the_motion():
    """The dipole of this satellite turns it by more than the first search allows; without a second one the rate was 5 sigma off."""
    vehicle, data, elements, truth, about = rates_case(21, 0)
    orbit = replace(orbit_of(elements, data, about), shift_s=about["ahead_s"], shift_sigma_s=2.0)
    calibration = calibrate_magnetometer(orbit, assess(vehicle, data))
    field_alone = one_pass(data, about["begin_s"][0]).drop_vars(["power_W", "panel"])
    result = rates(vehicle, field_alone, environment=orbit, calibration=calibration)
    judged = pass_against_truth(result, truth, 0)
    assert judged["listed"] and not judged["wrong"]

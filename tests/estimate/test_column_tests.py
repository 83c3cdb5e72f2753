"""Columns, axes and signs: which assignments are tried, and when another one is named. All telemetry is simulated."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.estimate import columns
from sunspin.estimate import rates as rates_module
from sunspin.estimate.budget import Budget
from sunspin.estimate.column_tests import (
    BetterChanges,
    ContradictingSensor,
    Estimators,
    SampleCosts,
    denied_by_the_sun,
    what_fits_better,
)
from sunspin.estimate.equivalence import Observed
from sunspin.estimate.gyro_axes import wrong_gyro_axes
from sunspin.estimate.rates import rates
from sunspin.telemetry.assess import assess
from sunspin.telemetry.reader import read_telemetry
from sunspin.vehicle import Panel, TelemetryForm, Vehicle, Wheel, load_vehicle
from sunspin.vehicle.sensors import Attitude, Gyro, Magnetometer, Sensors
from tests.support import simulate
from tests.support.simulate import telemetry_of
from tests.support.vehicles import CUBE_NORMALS, unit_vector, units
from validation import spinners
from validation.passes import make

CUBE = replace(
    simulate.CUBE_WITHOUT_NOISE_STATED,
    inertia_kg_m2=np.diag([0.042, 0.05, 0.03]),
    sensors=Sensors(
        gyro=Gyro(("x", "y", "z"), 1.0, np.zeros(3), 2e-3),
        magnetometer=Magnetometer(("u", "v", "w"), np.zeros(3), 0.02),
        attitude=Attitude(("a", "b", "c", "d"), "last", "N_to_B", 0.01),
    ),
)
T = np.arange(0.0, 300.0, 10.0)
GYRO, FIELD, QUATERNION = "gyro_B", "field_B", "attitude_B_from_N"


def motion(fits: bool = True, off_rad_s: float = 0.0, sigma_rad_s: float = 1e-4) -> xr.Dataset:
    """Return a steady spin in the form of a result of `rates`, its rate off along x, with a sigma of each component."""
    omega = np.tile([0.02 + off_rad_s, -0.03, 0.05], (T.size, 1))
    cov = sigma_rad_s**2 * np.eye(3)
    attitude = Rotation.from_rotvec(-T[:, None] * omega)
    return xr.Dataset(
        {
            "omega_B": (("time", "axis"), omega),
            "omega_cov_B": (("time", "axis", "axis2"), np.tile(cov, (T.size, 1, 1))),
            "B_from_N": (("time", "quaternion"), attitude.as_quat()),
            "sun_B": (("time", "axis"), attitude.apply([0.2, 0.6, 0.77])),
            "pass_of": ("time", np.zeros(T.size, dtype=int)),
            "fits": ("pass_id", [fits]),
            "cost": (("pass_id", "solution"), [[10.0]]),
        },
        {"time": T},
    )


def seen(name: str, wrong=np.copy) -> xr.Dataset:
    """Return panels and one sensor along that motion, the sensor's readings changed by `wrong`."""
    rng, run = np.random.default_rng(1), motion()
    turned = Rotation.from_quat(run["B_from_N"].values)
    read = {
        GYRO: run["omega_B"].values + 2e-3 * rng.normal(size=(T.size, 3)),
        FIELD: turned.apply([0.3, 0.5, -0.8]) + 0.02 * rng.normal(size=(T.size, 3)),
        QUATERNION: (turned * Rotation.from_rotvec([0.3, 0.1, 0.2])).as_quat(),
    }[name]
    axis = "quaternion" if read.shape[1] == 4 else "axis"
    power = np.maximum(run["sun_B"].values @ CUBE_NORMALS.T, 0.0)
    power = power + 0.01 * rng.uniform(size=(T.size, 6))
    return xr.Dataset(
        {"power_W": (("time", "panel"), power), name: (("time", axis), wrong(read))}, {"time": T}
    )


ADVICE = "find out which one is right before you change the file"


def never(*_) -> float:
    raise AssertionError("columns of panels are tried though a sensor explains the misfit")


def alike(*_) -> float:
    """Return the log evidence of any file: a quick search finds no columns better than others."""
    return 0.0


def sought(data: xr.Dataset, vehicle: Vehicle = CUBE, evidence=alike, run=lambda *_: motion()):
    """Return what fits better than the file, if anything does."""
    observed = Observed.of(vehicle, data)
    return what_fits_better(observed, data, Estimators(evidence, run, Budget(np.inf)))


def pair(a: str, b: str) -> str:
    return f"the columns of panels {a} and {b} exchanged"


def names(better: BetterChanges) -> list[str]:
    return [one.change.what for one in better.changes]


AS_THEY_ARE, BACK, SCALAR_FIRST = slice(None), np.array([-1, -1, -1, 1]), [3, 0, 1, 2]
TURNED, SCALAR = "quaternion read the other way round", "quaternion with its scalar at the other"
TABLE = {GYRO: "gyro", QUATERNION: "attitude"}


@pytest.mark.parametrize(
    ("name", "order", "sign", "words", "keys"),
    [
        (GYRO, [1, 0, 2], 1, "gyro read as (+y, +x, +z)", 'columns = ["y", "x", "z"]'),
        (GYRO, AS_THEY_ARE, -1, "gyro read as (-x, -y, -z)", 'columns = ["-x", "-y", "-z"]'),
        (QUATERNION, AS_THEY_ARE, BACK, TURNED, 'rotates = "B_to_N"'),
        (QUATERNION, SCALAR_FIRST, 1, SCALAR, 'scalar = "first"'),
    ],
)
def test_wrong_axes_of_a_sensor_are_named(name, order, sign, words, keys):
    found = sought(seen(name, lambda read: read[:, order] * sign))
    assert isinstance(found, BetterChanges) and found.gain > 10
    text = found.words()
    assert text.startswith(f"the data fit with the {words}") or f"(a) the {words}" in text
    assert found.changes[0].change.do.startswith(f"set {keys} under [{TABLE[name]}]")


@pytest.mark.parametrize("name", [GYRO, FIELD, QUATERNION])
def test_a_right_sensor_is_accused_only_if_the_motion_of_the_others_is_more_certain(name):
    """Not if they agree, though the pass fits only without it: the model may not follow the motion, and the others not show it.

    A rate of the others that is 1 deg/s off excuses the sensor within a sigma of 2 deg/s, and not within one of 0.01. For a gyro it
    is a zero offset, which the file states to 0.1 deg/s.
    """
    gyro = replace(CUBE.sensors.gyro, zero_sigma=np.full(3, np.radians(0.1)))
    vehicle = replace(CUBE, sensors=replace(CUBE.sensors, gyro=gyro))
    assert sought(seen(name), vehicle) is None
    known, unknown = (
        motion(off_rad_s=np.radians(1.0), sigma_rad_s=np.radians(sigma)) for sigma in (0.01, 2.0)
    )
    assert sought(seen(name), vehicle, run=lambda *_: unknown) is None
    assert sought(seen(name), vehicle, run=lambda *_: known) is not None


def with_its_end_backward(read: np.ndarray) -> np.ndarray:
    """Return readings of which the second half come in the opposite order: no axes of a sensor read so."""
    half = len(read) // 2
    return np.concatenate([read[:half], read[:half:-1], read[half : half + 1]])


def with_every_second_halved(read: np.ndarray) -> np.ndarray:
    """Return readings of which every second is half as large: no axes, and no zero offset that drifts evenly, explain them."""
    return read * np.where(np.arange(len(read)) % 2, 0.5, 1.0)[:, None]


@pytest.mark.parametrize(
    ("name", "wrong", "option"),
    [
        (GYRO, with_every_second_halved, "gyro"),
        (FIELD, with_its_end_backward, "magnetometer"),
        (QUATERNION, with_its_end_backward, "attitude"),
    ],
)
def test_a_sensor_that_no_axes_explain_is_named_if_it_contradicts_the_others(name, wrong, option):
    """If the rest fits without it."""
    data = seen(name, wrong)
    found = sought(data, evidence=never)
    assert isinstance(found, ContradictingSensor)
    assert sought(data, evidence=never, run=lambda _, other: motion(name not in other)) == found
    assert sought(data, run=lambda *_: motion(fits=False)) is None
    assert found.words().startswith(f"without the {found.sensor} the other readings fit")
    assert f"`--without {option}`" in found.words()


def allowed_by_the_sun(*offs_rad_s: float, decided: bool = True) -> xr.Dataset:
    """Return a result of the Sun alone with a solution for each of these errors of the rate along x."""
    omega = np.array([[0.02 + off, -0.03, 0.05] for off in offs_rad_s])
    variables = {"decided": ("pass_id", [decided]), "search_complete": ("pass_id", [True])}
    for axis, rate in zip("xyz", omega.T, strict=True):
        variables[f"omega_{axis}"] = ("pass_id", "solution"), rate[None]
        variables[f"sigma_{axis}"] = ("pass_id", "solution"), np.full((1, len(omega)), 1e-4)
    return motion(off_rad_s=offs_rad_s[0]).drop_vars("cost").assign(variables)


@pytest.mark.parametrize(
    ("sun", "accused"),
    [
        (allowed_by_the_sun(0.0), False),
        (allowed_by_the_sun(0.002), True),
        (allowed_by_the_sun(0.002, 0.0, decided=False), False),
        (allowed_by_the_sun(0.002, 0.004, decided=False), True),
    ],
)
def test_a_magnetometer_is_accused_if_the_sun_alone_allows_no_such_motion(sun, accused):
    """Of the motions that the Sun allows one agrees, or none. The readings are those of the first: no axes fit better."""
    data = seen(FIELD)
    estimators = Estimators(never, lambda *_: sun, Budget(np.inf))
    cause = denied_by_the_sun(CUBE, data, motion(), estimators)
    assert cause == (ContradictingSensor("magnetometer") if accused else None)
    # panels in a plane leave mirror images open, of which one may not be found
    flat = replace(CUBE, panels=[CUBE.panels[k] for k in (0, 1, 3, 4)])
    assert denied_by_the_sun(flat, data, motion(), estimators) is None


@pytest.mark.evidence("rates", "modelled", "a magnetometer along other axes")
@pytest.mark.evidence(
    "rates", "modelled", "simulated spinners whose magnetometer is read along other axes"
)
def test_a_magnetometer_along_other_axes_is_named(tmp_path):
    """Its zero and matrix take up the error: the pass was decided more than five sigma off."""
    truth = spinners.make(spinners.cases(31, 3)[2], tmp_path)
    craft = load_vehicle(tmp_path / "vehicle.toml")
    data = read_telemetry(tmp_path / "telemetry.csv", craft)
    result = rates(craft, data.isel(time=data["time"].values < 1672.0))
    assert result["why_not_decided"] == ["POOR FIT (magnetometer); columns, signs or axes"]
    for change in json.loads(result.attrs["columns_changes"]):
        assert change["what"].startswith("the magnetometer read as")
        assert np.allclose(change["omega_deg_s"], truth["rates_deg_s"][80], atol=0.01)


def test_no_pass_is_decided_if_a_sensor_contradicts_the_others(monkeypatch):
    """Two of four passes of a spinner fitted with a magnetometer along other axes, and were decided far from the truth."""
    made = make("right model", 0, 1)
    result = rates(made.vehicle, made.telemetry, max_rate_rad_s=made.max_rate_rad_s)
    assert result["decided"].all()
    monkeypatch.setattr(columns, "what_fits_better", lambda *_: ContradictingSensor("gyro"))
    observed = columns.what_was_observed(made.vehicle, made.telemetry, result.attrs)
    doubt = columns._other_columns(result, observed, made.telemetry, Estimators)
    doubted = doubt.written(result)
    assert not doubted["decided"].any()
    assert "the gyro contradicts the other readings" in str(doubted["why_not_decided"].values[0])
    assert "`--without gyro`" in doubted.attrs["columns_doubt"]


def test_exchanged_panels_and_the_equivalent_sensor_axes_are_both_named():
    """Two opposite panels' columns exchanged show the mirrored motion, in which a right gyro seems to have two signs wrong."""
    told = sought(seen(GYRO, lambda read: read * [1, -1, -1]))
    for words in ('set columns = ["x", "-y", "-z"]', pair("+x", "-x"), "each of 2 changes", ADVICE):
        assert words in told.words()
    # a mirror along x: rates are axial vectors
    rate = np.degrees([one.omega for one in told.changes])
    np.testing.assert_allclose(rate[1], rate[0] * [1, -1, -1], atol=1e-12)
    assert "exchanged" not in sought(seen(GYRO, lambda read: read[:, [1, 0, 2]])).words()


@pytest.mark.long
def test_changed_files_are_estimated_under_the_strength_of_torques_that_is_given(monkeypatch):
    given, stated_noise = [], rates_module.stated_noise

    def recorded(vehicle, strength, dipole_modelled):
        given.append(strength)
        return stated_noise(vehicle, strength, dipole_modelled)

    monkeypatch.setattr(rates_module, "stated_noise", recorded)
    simulated = make("columns exchanged", 0, 0)
    telemetry = simulated.telemetry.isel(time=slice(0, 12))
    rates(simulated.vehicle, telemetry, acceleration_noise=1e-4, effort=0.1)
    assert len(given) > 1 and set(given) == {1e-4}


@pytest.mark.long
@pytest.mark.parametrize("number", [0, 2])
def test_exchanged_panels_that_nearly_mirror_the_motion_are_named_and_not_a_right_gyro(number):
    """The panels alone fit either way: an exchange of columns mirrors nearly all readings, and the inertia has errors."""
    simulated = make("columns exchanged", 111, number)
    told = rates(simulated.vehicle, simulated.telemetry, max_rate_rad_s=simulated.max_rate_rad_s)
    named = [change["what"] for change in json.loads(told.attrs["columns_changes"])]
    assert named == [pair(*simulated.exchanged)]


def test_a_reversed_field_axis_its_opposite_and_the_equivalent_exchange_are_named():
    """Without elements a field and its opposite look the same. A gyro that agrees with the magnetometer excludes all three."""
    found = sought(seen(FIELD, lambda read: read * [1, -1, 1]))
    field, exchange, opposite = names(found)
    assert exchange == pair("+y", "-y") and found.gain > 10
    for what, one in zip((field, opposite), found.changes[::2], strict=True):
        assert what.startswith("the magnetometer read as (")
        assert "under [magnetometer]" in one.change.do
    agreed = seen(GYRO, lambda read: read * [1, -1, -1]).assign(field_B=seen(FIELD)[FIELD])
    assert "exchanged" not in sought(agreed).words()


def exchanged_columns(a: int, b: int) -> xr.Dataset:
    """Return telemetry of panels alone whose columns a and b are exchanged."""
    data = seen(GYRO).drop_vars(GYRO)
    power = data["power_W"].values.copy()
    power[:, [a, b]] = power[:, [b, a]]
    return data.assign(power_W=(("time", "panel"), power))


def test_another_column_assignment_must_be_clearly_better_and_fit():
    data, right = exchanged_columns(1, 5), exchanged_columns(0, 0)["power_W"].values

    def found(gain: float, fits: bool = True):
        return sought(
            data,
            evidence=lambda _, other: gain * np.array_equal(other["power_W"], right),
            run=lambda *_: motion(fits),
        )

    better = found(30.0)
    assert isinstance(better, BetterChanges) and better.gain == 30.0
    assert names(better) == [pair("+y", "-z")]
    assert "CHECK THE COLUMNS" in better.words() and "which one is right" not in better.words()
    assert found(9.0) is None and found(30.0, fits=False) is None
    without = replace(CUBE, panels=())
    assert sought(data.drop_vars("power_W"), without, lambda *_: 30.0) is None


def test_samples_by_themselves_show_some_exchanges_in_any_unit():
    """Opposite panels lit together: no Sun lights them. A mirror image is not seen so."""
    right = exchanged_columns(0, 0)
    assert SampleCosts.of(CUBE, exchanged_columns(1, 5)).contradict_the_columns()
    assert not SampleCosts.of(CUBE, exchanged_columns(1, 4)).contradict_the_columns()
    gains = zip(CUBE.panels, (1.0, 7.0, 2.0, 1.0, 7.0, 2.0), strict=True)
    unequal = replace(CUBE, panels=tuple(replace(panel, gain=gain) for panel, gain in gains))
    # a full battery dims what it reads; panels need not be equal
    for craft, factor in ((CUBE, 1.0), (CUBE, 0.3), (unequal, unequal.panel_gains)):
        changed = right.assign(power_W=factor * right["power_W"])
        assert not SampleCosts.of(craft, changed).contradict_the_columns()
    # in counts of 0 to 190 each sample cost as much as it may, and a right file was said to have two columns exchanged
    relative = replace(CUBE, gain_unit=None, telemetry=TelemetryForm())
    costs = SampleCosts.of(relative, right)
    for unit in (0.05, 190.0):
        others = SampleCosts.of(relative, right.assign(power_W=unit * right["power_W"]))
        np.testing.assert_allclose(others.as_written, costs.as_written, rtol=1e-6)
        np.testing.assert_allclose(others.of_changes, costs.of_changes, rtol=1e-6)


def test_unlit_panels_distinguish_an_exchange_from_its_mirror():
    """The Sun near +y: as written -y is lit between two dark panels, which a mirror would leave dark, and no Sun can do that."""
    sides = [Panel(name, units(np.array([x, -1.0, 0.0])), 1.0) for name, x in (("a", 1), ("b", -1))]
    craft = replace(CUBE, panels=(*CUBE.panels, *sides))
    angle = np.linspace(0.0, 6.0, T.size)
    sun = np.stack([0.4 * np.cos(angle), np.full(T.size, 0.9), 0.4 * np.sin(angle)], axis=1)
    sun = units(sun)
    power = np.maximum(sun @ craft.panel_normals_B.T, 0.0)
    read = power[:, [0, 4, 2, 3, 1, 5, 6, 7]]
    found = sought(
        xr.Dataset({"power_W": (("time", "panel"), read)}, {"time": T}),
        craft,
        lambda _, other: 50.0 * np.array_equal(other["power_W"], power),
        lambda *_: motion().assign(sun_B=(("time", "axis"), sun)),
    )
    assert isinstance(found, BetterChanges) and names(found) == [pair("+y", "-y")]


def test_equivalent_column_changes_are_named_with_their_rates_and_none_is_recommended():
    """Of a sphere +y with -z exchanged is -y with +z, seen in a mirror."""
    found = sought(
        exchanged_columns(1, 5),
        replace(CUBE, inertia_kg_m2=0.04 * np.eye(3)),
        lambda _, other: 50.0 * (other["power_W"].values[0, 5] < 0.02),
    )
    assert isinstance(found, BetterChanges)
    rate = {name: one.omega for name, one in zip(names(found), found.changes, strict=True)}
    assert set(rate) == {pair("+y", "-z"), pair("+z", "-y")}
    x, y, z = rate[pair("+y", "-z")]
    np.testing.assert_allclose(rate[pair("+z", "-y")], [-x, z, y], atol=1e-12)
    assert "cannot tell which is right" in found.words() and "if it is so" not in found.words()


# ---- gyro axes on a body whose wheel rotates the rate between samples -------------------------------------------------------


AXIS = units(np.array([0.2, 0.9, 0.4]))


def odd(i: int, speed_rad_s: float) -> tuple[Vehicle, xr.Dataset]:
    """Twelve panels somehow, a wheel that turns a rate round by 12 rad in an interval of 12 s at 300 rad/s, a gyro."""
    rng = np.random.default_rng(i)
    normals = units(rng.normal(size=(12, 3)))
    panels = [Panel(f"p{k}", n, rng.uniform(0.5, 1.5)) for k, n in enumerate(normals)]
    inertia = np.array([[0.9, 0.05, 0.02], [0.05, 1.2, -0.03], [0.02, -0.03, 1.5]])
    gyro = replace(simulate.GYRO, noise_rad_s=1e-3)
    craft = Vehicle(
        "odd",
        inertia_kg_m2=inertia,
        gain_unit="W",
        panels=panels,
        telemetry=TelemetryForm(noise=0.02),
        wheels=(Wheel("w", AXIS, 0.004, speed_rad_s),),
        sensors=Sensors(gyro=gyro),
    )
    t, omega, sun = np.arange(40) * 12.0, unit_vector(rng), unit_vector(rng)
    run = ss.propagate(craft, np.radians(3.0) * omega, sun, [speed_rad_s], t)
    power = ss.panel_power(craft, run["sun_B"].values) + 0.02 * rng.normal(size=(40, 12))
    rate = run["omega_B"].values
    read = rate * (1 + 0.01 * rng.normal()) + 1e-3 * rng.normal(size=3)
    read = read + 1e-3 * rng.normal(size=rate.shape)
    data = telemetry_of(craft, t, np.maximum(power, 0.0), gyro_B=(("time", "axis"), read))
    return craft, data


@pytest.mark.parametrize(("count", "named"), [(1, 2), pytest.param(6, 12, marks=pytest.mark.slow)])
@pytest.mark.evidence(
    "rates",
    "modelled",
    "a gyro with one axis reversed on a body whose wheel rotates the rate between samples",
)
def test_a_reversed_gyro_axis_is_named_even_if_a_wheel_rotates_the_rate_between_samples(
    count, named
):
    """Three axes of each satellite reversed; the right reading is never accused, and no other is named."""
    told = []
    for i in range(count):
        vehicle, telemetry = odd(i, 300.0 if i % 2 else 100.0)
        assert wrong_gyro_axes(assess(vehicle, telemetry)) is None
        for k in range(3):
            read = telemetry["gyro_B"].values * (1 - 2 * np.eye(3)[k])
            signs = ", ".join(f"{'-' if j == k else '+'}{axis}" for j, axis in enumerate("xyz"))
            misread = telemetry.assign(gyro_B=(("time", "axis"), read))
            found = wrong_gyro_axes(assess(vehicle, misread))
            told.append(None if found is None else f"({signs})" in found)
    assert False not in told and told.count(True) >= named

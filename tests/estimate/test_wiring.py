"""Which column is which: the wirings that are tried, and when another one is named. All telemetry is simulated."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.estimate.wiring import Culprit, better, of_panels, of_sensor
from sunspin.vehicle import Panel, Vehicle
from sunspin.vehicle.sensors import Attitude, Gyro, Magnetometer, Sensors

FACES = np.vstack([np.eye(3), -np.eye(3)])
CUBE = Vehicle(
    "cube", inertia_kg_m2=np.diag([0.042, 0.05, 0.03]), gain_unit="W",
    panels=[Panel(name, normal, 1.0) for name, normal in zip(("+x", "+y", "+z", "-x", "-y", "-z"), FACES, strict=True)],
    sensors=Sensors(
        gyro=Gyro(("x", "y", "z"), 1.0, np.zeros(3), 2e-3), magnetometer=Magnetometer(("u", "v", "w"), np.zeros(3), 0.02),
        attitude=Attitude(("a", "b", "c", "d"), "last", "N_to_B", 0.01),
    ),
)  # fmt: skip
T = np.arange(0.0, 300.0, 10.0)
TURN_RATE = 2.2e-3


def motion(fits: bool = True) -> xr.Dataset:
    """A steady spin, as `rates` returns it."""
    omega = np.tile([0.02, -0.03, 0.05], (T.size, 1))
    attitude = Rotation.from_rotvec(-T[:, None] * omega)
    return xr.Dataset(
        {
            "omega_B": (("time", "axis"), omega),
            "omega_cov_B": (("time", "axis", "axis2"), np.tile(1e-8 * np.eye(3), (T.size, 1, 1))),
            "B_from_N": (("time", "quaternion"), attitude.as_quat()), "pass_of": ("time", np.zeros(T.size, dtype=int)),
            "fits": ("pass_id", [fits]),
        },
        {"time": T},
    )  # fmt: skip


def seen(name: str, wrong) -> xr.Dataset:
    """What a sensor reads along that motion, spoilt by `wrong`."""
    rng, run = np.random.default_rng(1), motion()
    turned = Rotation.from_quat(run["B_from_N"].values)
    read = {
        "gyro_B": run["omega_B"].values + 2e-3 * rng.normal(size=(T.size, 3)),
        "field_B": turned.apply([0.3, 0.5, -0.8]) + 0.02 * rng.normal(size=(T.size, 3)),
        "attitude_B_from_N": (turned * Rotation.from_rotvec([0.3, 0.1, 0.2])).as_quat(),
    }[name]
    axis = "quaternion" if read.shape[1] == 4 else "axis"
    power = rng.uniform(size=(T.size, 6))
    return xr.Dataset({"power_W": (("time", "panel"), power), name: (("time", axis), wrong(read))}, {"time": T})


def never(*_) -> float:
    raise AssertionError("wirings of panels are not asked for where a sensor explains it")


def test_the_wirings_of_six_panels_are_fifteen_exchanges_and_six_reversals():
    data = seen("gyro_B", lambda read: read)
    found = list(of_panels(CUBE, data))
    assert len(found) == 21 and len({one.what for one in found}) == 21
    first, last = found[0], found[-1]
    assert first.what == "the columns of panels +x and +y exchanged"
    np.testing.assert_array_equal(first.telemetry["power_W"].values[:, [1, 0]], data["power_W"].values[:, :2])
    np.testing.assert_array_equal(last.vehicle.panels[5].normal_B, [0, 0, 1])
    assert CUBE.panels[5].normal_B[2] == -1


def test_axes_have_48_wirings_and_a_quaternion_four_the_stated_one_first():
    data = seen("gyro_B", lambda read: read)
    found = list(of_sensor(CUBE, data, "gyro_B"))
    assert len({one.telemetry["gyro_B"].values.tobytes() for one in found}) == 48
    np.testing.assert_array_equal(found[0].telemetry["gyro_B"].values, data["gyro_B"].values)
    data = seen("attitude_B_from_N", lambda read: read)
    found = list(of_sensor(CUBE, data, "attitude_B_from_N"))
    assert len(found) == 4
    np.testing.assert_array_equal(found[0].telemetry["attitude_B_from_N"].values, data["attitude_B_from_N"].values)


@pytest.mark.parametrize(
    ("name", "wrong", "words", "do"),
    [
        ("gyro_B", lambda read: read[:, [1, 0, 2]], "the gyro read as (+y, +x, +z)", 'set columns = ["y", "x", "z"] under [gyro]'),
        ("gyro_B", lambda read: -read, "the gyro read as (-x, -y, -z)", 'set columns = ["-x", "-y", "-z"] under [gyro]'),
        ("field_B", lambda read: read * [1, -1, 1], "the magnetometer read as (", "under [magnetometer]"),
        ("attitude_B_from_N", lambda read: read * [-1, -1, -1, 1], "the quaternion read the other way round",
         'set rotates = "B_to_N" under [attitude]'),
        ("attitude_B_from_N", lambda read: read[:, [1, 2, 3, 0]], "the quaternion with its scalar at the other end",
         'set scalar = "first" under [attitude]'),
    ],
)  # fmt: skip
def test_a_sensor_read_wrongly_is_named(name, wrong, words, do):
    found = better(CUBE, seen(name, wrong), never, lambda *_: motion(), TURN_RATE)
    assert found is not None and found.gain > 10 and found.words.startswith(f"the data fit with {words}"), found
    assert f"CHECK THE WIRING; if it is so, {do}" in found.words or (name == "field_B" and do in found.words)


@pytest.mark.parametrize("name", ["gyro_B", "field_B", "attitude_B_from_N"])
def test_no_other_wiring_of_a_sensor_read_rightly_is_named(name):
    """What is in the way may still be that sensor: its zero, say."""
    found = better(CUBE, seen(name, lambda read: read), never, lambda *_: motion(), TURN_RATE)
    assert isinstance(found, Culprit) and "without the" in found.words and "--without" in found.words


def test_a_gyro_whose_zero_is_off_is_the_culprit_and_where_it_is_not_panels_are_tried():
    data = seen("gyro_B", lambda read: read + np.radians([0.3, -0.3, 0.3]))

    def run(fits_without: bool):
        return lambda _, other: motion(fits=fits_without and "gyro_B" not in other)

    assert better(CUBE, data, never, run(True), TURN_RATE) == Culprit("gyro")
    assert better(CUBE, data, lambda *_: 0.0, run(False), TURN_RATE) is None


def test_exchanged_panels_that_look_like_turned_axes_of_a_sensor_are_named_beside_them():
    """Two opposite panels' columns exchanged show the mirrored motion, in which a sound gyro seems to have two signs wrong."""
    data = seen("gyro_B", lambda read: read * [1, -1, -1])
    told = better(CUBE, data, never, lambda *_: motion(), TURN_RATE)
    assert 'set columns = ["x", "-y", "-z"]' in told.words and "the columns of panels +x and -x are exchanged" in told.words
    told = better(CUBE, seen("field_B", lambda read: read * [1, -1, 1]), never, lambda *_: motion(), TURN_RATE)
    assert "the columns of panels +y and -y are exchanged" in told.words
    agreed = data.assign(field_B=seen("field_B", lambda read: read)["field_B"])  # two sensors that agree are both right
    assert "exchanged" not in better(CUBE, agreed, never, lambda *_: motion(), TURN_RATE).words
    told = better(CUBE, seen("gyro_B", lambda read: read[:, [1, 0, 2]]), never, lambda *_: motion(), TURN_RATE)
    assert "exchanged" not in told.words


def test_panels_and_not_the_quaternion_are_named_where_it_agrees_with_them_mirrored():
    data = seen("attitude_B_from_N", lambda read: read * [1, -1, -1, 1])  # the motion of the panels is that mirrored along x
    found = better(CUBE, data, never, lambda *_: motion(), TURN_RATE)
    assert "the columns of panels +x and -x exchanged" in found.words and found.gain > 10
    power = found.wiring.telemetry["power_W"].values
    np.testing.assert_array_equal(power[:, [3, 0]], data["power_W"].values[:, [0, 3]])


def test_another_wiring_of_panels_must_be_clearly_better_and_fit():
    data = seen("gyro_B", lambda read: read).drop_vars("gyro_B")
    right = next(one for one in of_panels(CUBE, data) if one.what == "the columns of panels +y and -z exchanged")

    def evidence(gain: float):
        return lambda _, other: gain * np.array_equal(other["power_W"], right.telemetry["power_W"])

    found = better(CUBE, data, evidence(30.0), lambda *_: motion(), TURN_RATE)
    assert found is not None and found.wiring.what == right.what and found.gain == 30.0
    assert better(CUBE, data, evidence(9.0), lambda *_: motion(), TURN_RATE) is None
    assert better(CUBE, data, evidence(30.0), lambda *_: motion(fits=False), TURN_RATE) is None
    assert better(replace(CUBE, panels=()), data.drop_vars("power_W"), evidence(30.0), lambda *_: motion(), TURN_RATE) is None

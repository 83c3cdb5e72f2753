"""Columns, axes and signs: which assignments are tried, and when another one is named. All telemetry is simulated."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.estimate.budget import Budget
from sunspin.estimate.column_tests import (
    Better,
    Culprit,
    Trials,
    changes_of_sensor,
    samples_fit_other_columns,
    what_fits_better,
)
from sunspin.estimate.equivalence import Observed, column_changes
from sunspin.vehicle import Panel, Vehicle
from sunspin.vehicle.sensors import Attitude, Gyro, Magnetometer, Sensors

FACES = np.vstack([np.eye(3), -np.eye(3)])
CUBE = Vehicle(
    "cube",
    inertia_kg_m2=np.diag([0.042, 0.05, 0.03]),
    gain_unit="W",
    panels=[
        Panel(name, normal, 1.0)
        for name, normal in zip(("+x", "+y", "+z", "-x", "-y", "-z"), FACES, strict=True)
    ],
    sensors=Sensors(
        gyro=Gyro(("x", "y", "z"), 1.0, np.zeros(3), 2e-3),
        magnetometer=Magnetometer(("u", "v", "w"), np.zeros(3), 0.02),
        attitude=Attitude(("a", "b", "c", "d"), "last", "N_to_B", 0.01),
    ),
)
T = np.arange(0.0, 300.0, 10.0)


def motion(fits: bool = True) -> xr.Dataset:
    """A steady spin, as `rates` returns it."""
    omega = np.tile([0.02, -0.03, 0.05], (T.size, 1))
    attitude = Rotation.from_rotvec(-T[:, None] * omega)
    return xr.Dataset(
        {
            "omega_B": (("time", "axis"), omega),
            "omega_cov_B": (("time", "axis", "axis2"), np.tile(1e-8 * np.eye(3), (T.size, 1, 1))),
            "B_from_N": (("time", "quaternion"), attitude.as_quat()),
            "sun_B": (("time", "axis"), attitude.apply([0.2, 0.6, 0.77])),
            "pass_of": ("time", np.zeros(T.size, dtype=int)),
            "fits": ("pass_id", [fits]),
        },
        {"time": T},
    )


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
    power = np.maximum(run["sun_B"].values @ FACES.T, 0.0) + 0.01 * rng.uniform(size=(T.size, 6))
    return xr.Dataset(
        {"power_W": (("time", "panel"), power), name: (("time", axis), wrong(read))}, {"time": T}
    )


def sought(vehicle: Vehicle, data: xr.Dataset, evidence, run) -> Better | Culprit | None:
    observed = Observed.of(vehicle, data)
    return what_fits_better(observed, data, Trials(evidence, run, Budget(np.inf)))


def never(*_) -> float:
    raise AssertionError("wirings of panels are not asked for where a sensor explains it")


def test_six_panels_have_fifteen_exchanges_and_six_reversals():
    data = seen("gyro_B", lambda read: read)
    found = column_changes(CUBE, data)
    assert len(found) == 21 and len({one.what for one in found}) == 21
    first, last = found[0], found[-1]
    assert first.what == "the columns of panels +x and +y exchanged"
    np.testing.assert_array_equal(
        first.applied(CUBE, data)[1]["power_W"].values[:, [1, 0]], data["power_W"].values[:, :2]
    )
    np.testing.assert_array_equal(last.applied(CUBE, data)[0].panels[5].normal_B, [0, 0, 1])
    assert CUBE.panels[5].normal_B[2] == -1


def test_axes_have_48_assignments_and_a_quaternion_four_the_stated_one_first():
    data = seen("gyro_B", lambda read: read)
    read = [
        one.applied(CUBE, data)[1]["gyro_B"].values for one in changes_of_sensor(CUBE, "gyro_B")
    ]
    assert len({one.tobytes() for one in read}) == 48
    np.testing.assert_array_equal(read[0], data["gyro_B"].values)
    data = seen("attitude_B_from_N", lambda read: read)
    read = [
        one.applied(CUBE, data)[1]["attitude_B_from_N"].values
        for one in changes_of_sensor(CUBE, "attitude_B_from_N")
    ]
    x, y, z, w = data["attitude_B_from_N"].values.T
    for value, right in zip(
        read, ([x, y, z, w], [-x, -y, -z, w], [w, x, y, z], [-w, -x, -y, z]), strict=True
    ):
        np.testing.assert_array_equal(value, np.array(right).T)


@pytest.mark.parametrize(
    ("name", "wrong", "words", "do"),
    [
        (
            "gyro_B",
            lambda read: read[:, [1, 0, 2]],
            "the gyro read as (+y, +x, +z)",
            'set columns = ["y", "x", "z"] under [gyro]',
        ),
        (
            "gyro_B",
            lambda read: -read,
            "the gyro read as (-x, -y, -z)",
            'set columns = ["-x", "-y", "-z"] under [gyro]',
        ),
        (
            "field_B",
            lambda read: read * [1, -1, 1],
            "the magnetometer read as (",
            "under [magnetometer]",
        ),
        (
            "attitude_B_from_N",
            lambda read: read * [-1, -1, -1, 1],
            "the quaternion read the other way round",
            'set rotates = "B_to_N" under [attitude]',
        ),
        (
            "attitude_B_from_N",
            lambda read: read[:, [1, 2, 3, 0]],
            "the quaternion with its scalar at the other end",
            'set scalar = "first" under [attitude]',
        ),
    ],
)
def test_wrong_axes_of_a_sensor_are_named(name, wrong, words, do):
    found = sought(CUBE, seen(name, wrong), never, lambda *_: motion())
    assert isinstance(found, Better) and found.gain > 10
    if (
        name == "field_B"
    ):  # without elements a field and its opposite, and columns that look the same, are named together
        assert [one.change.what[:25] for one in found.named] == [
            words[:25],
            "the columns of panels +y ",
            words[:25],
        ]
        assert all(do in one.change.do for one in found.named[::2])
    else:
        assert (
            found.words().startswith(f"the data fit with {words}")
            or f"(a) {words}" in found.words()
        )
        assert found.named[0].change.do.startswith(do)


@pytest.mark.parametrize("name", ["gyro_B", "field_B", "attitude_B_from_N"])
def test_right_axes_of_a_sensor_are_not_doubted(name):
    """What is in the way may still be that sensor: its zero, say."""
    found = sought(CUBE, seen(name, lambda read: read), never, lambda *_: motion())
    assert (
        isinstance(found, Culprit)
        and "without the" in found.words()
        and "--without" in found.words()
    )


def test_a_gyro_with_a_wrong_zero_is_named_only_if_the_rest_fits_without_it():
    data = seen("gyro_B", lambda read: read + np.radians([0.3, -0.3, 0.3]))

    def run(fits_without: bool):
        return lambda _, other: motion(fits=fits_without and "gyro_B" not in other)

    assert sought(CUBE, data, never, run(True)) == Culprit("gyro")
    assert sought(CUBE, data, lambda *_: 0.0, run(False)) is None


def test_exchanged_panels_and_the_equivalent_sensor_axes_are_both_named():
    """Two opposite panels' columns exchanged show the mirrored motion, in which a sound gyro seems to have two signs wrong."""
    data = seen("gyro_B", lambda read: read * [1, -1, -1])
    told = sought(CUBE, data, never, lambda *_: motion())
    assert (
        'set columns = ["x", "-y", "-z"]' in told.words()
        and "the columns of panels +x and -x exchanged" in told.words()
    )
    assert (
        "each of 2 changes" in told.words()
        and "find out which one is right before you change the file" in told.words()
    )
    rate = np.degrees([one.omega for one in told.named])
    np.testing.assert_allclose(
        rate[1], rate[0] * [1, -1, -1], atol=1e-12
    )  # a mirror along x: rates are axial vectors
    told = sought(CUBE, seen("field_B", lambda read: read * [1, -1, 1]), never, lambda *_: motion())
    assert "the columns of panels +y and -y exchanged" in told.words()
    agreed = data.assign(
        field_B=seen("field_B", lambda read: read)["field_B"]
    )  # two sensors that agree are both right
    assert "exchanged" not in sought(CUBE, agreed, never, lambda *_: motion()).words()
    told = sought(CUBE, seen("gyro_B", lambda read: read[:, [1, 0, 2]]), never, lambda *_: motion())
    assert "exchanged" not in told.words()


def test_exchanged_panels_are_named_if_the_quaternion_agrees_with_their_mirror():
    data = seen(
        "attitude_B_from_N", lambda read: read * [1, -1, -1, 1]
    )  # the motion of the panels is that mirrored along x
    found = sought(CUBE, data, never, lambda *_: motion())
    assert "the columns of panels +x and -x exchanged" in found.words() and found.gain > 10
    power = found.named[0].change.applied(CUBE, data)[1]["power_W"].values
    np.testing.assert_array_equal(power[:, [3, 0]], data["power_W"].values[:, [0, 3]])


def exchanged_columns(a: int, b: int) -> xr.Dataset:
    """Telemetry of panels alone whose columns a and b are exchanged."""
    data = seen("gyro_B", lambda read: read).drop_vars("gyro_B")
    power = data["power_W"].values.copy()
    power[:, [a, b]] = power[:, [b, a]]
    return data.assign(power_W=(("time", "panel"), power))


def test_another_column_assignment_must_be_clearly_better_and_fit():
    data = exchanged_columns(1, 5)
    right = next(
        one
        for one in column_changes(CUBE, data)
        if one.what == "the columns of panels +y and -z exchanged"
    )
    power = right.applied(CUBE, data)[1]["power_W"].values

    def evidence(gain: float):
        return lambda _, other: gain * np.array_equal(other["power_W"], power)

    found = sought(CUBE, data, evidence(30.0), lambda *_: motion())
    assert (
        isinstance(found, Better)
        and [one.change.what for one in found.named] == [right.what]
        and found.gain == 30.0
    )
    assert "CHECK THE COLUMNS" in found.words() and "which one is right" not in found.words()
    assert sought(CUBE, data, evidence(9.0), lambda *_: motion()) is None
    assert sought(CUBE, data, evidence(30.0), lambda *_: motion(fits=False)) is None
    assert (
        sought(
            replace(CUBE, panels=()), data.drop_vars("power_W"), evidence(30.0), lambda *_: motion()
        )
        is None
    )


def test_samples_by_themselves_show_some_exchanges():
    """Opposite panels lit together: no Sun lights them. A mirror image is not seen so."""
    right = exchanged_columns(0, 0)
    assert not samples_fit_other_columns(CUBE, right)
    assert samples_fit_other_columns(
        CUBE, exchanged_columns(1, 5)
    ) and not samples_fit_other_columns(CUBE, exchanged_columns(1, 4))
    assert not samples_fit_other_columns(
        CUBE, right.assign(power_W=0.3 * right["power_W"])
    )  # a full battery dims what it reads
    gains = zip(CUBE.panels, (1.0, 7.0, 2.0, 1.0, 7.0, 2.0), strict=True)
    unequal = replace(CUBE, panels=tuple(replace(panel, gain=gain) for panel, gain in gains))
    assert not samples_fit_other_columns(
        unequal, right.assign(power_W=right["power_W"] * unequal.panel_gains)
    )


def test_unlit_panels_distinguish_an_exchange_from_its_mirror():
    """The Sun near +y: as written -y is lit between two dark panels, which a mirror would leave dark, and no Sun can do that."""
    sides = [
        Panel(name, np.array(n) / np.sqrt(2), 1.0)
        for name, n in (("a", [1.0, -1.0, 0.0]), ("b", [-1.0, -1.0, 0.0]))
    ]
    craft = replace(CUBE, panels=(*CUBE.panels, *sides))
    angle = np.linspace(0.0, 6.0, T.size)
    sun = np.stack([0.4 * np.cos(angle), np.full(T.size, 0.9), 0.4 * np.sin(angle)], axis=1)
    sun /= np.linalg.norm(sun, axis=1, keepdims=True)
    power = np.maximum(sun @ np.array([panel.normal_B for panel in craft.panels]).T, 0.0)
    data = xr.Dataset(
        {"power_W": (("time", "panel"), power[:, [0, 4, 2, 3, 1, 5, 6, 7]])}, {"time": T}
    )

    def evidence(_: Vehicle, other: xr.Dataset) -> float:
        return 50.0 * np.array_equal(other["power_W"], power)

    found = sought(craft, data, evidence, lambda *_: motion().assign(sun_B=(("time", "axis"), sun)))
    assert isinstance(found, Better) and [one.change.what for one in found.named] == [
        "the columns of panels +y and -y exchanged"
    ]


def test_equivalent_column_changes_are_named_with_their_rates_and_none_is_recommended():
    sphere = replace(
        CUBE, inertia_kg_m2=0.04 * np.eye(3)
    )  # here +y with -z exchanged is -y with +z, seen in a mirror
    found = sought(
        sphere,
        exchanged_columns(1, 5),
        lambda vehicle, other: 50.0 * (other["power_W"].values[0, 5] < 0.02),
        lambda *_: motion(),
    )
    assert isinstance(found, Better)
    what = [one.change.what for one in found.named]
    assert set(what) == {
        "the columns of panels +y and -z exchanged",
        "the columns of panels +z and -y exchanged",
    }
    rate = {name: one.omega for name, one in zip(what, found.named, strict=True)}
    x, y, z = rate["the columns of panels +y and -z exchanged"]
    np.testing.assert_allclose(
        rate["the columns of panels +z and -y exchanged"], [-x, z, y], atol=1e-12
    )
    assert "cannot tell which is right" in found.words() and "if it is so" not in found.words()

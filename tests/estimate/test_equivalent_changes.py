"""Changes of columns, signs and axes that no reading distinguishes: rotations and mirrors of the body."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from sunspin.estimate.columns import has_unlisted_motion, unseen_axes
from sunspin.estimate.equivalence import (
    AS_WRITTEN,
    ColumnChange,
    Observed,
    column_changes,
    equivalence,
    equivalent_changes,
    exchange,
    rate_under,
    unseen_changes,
    wheel_changes,
)
from sunspin.vehicle import Channel, Panel, Vehicle, Wheel
from sunspin.vehicle.parts import Fact
from sunspin.vehicle.sensors import Disturbance, Sensors
from tests.support.simulate import GYRO, MAGNETOMETER, QUATERNION
from tests.support.vehicles import CUBE_NORMALS, units

NAMES = ("+x", "+y", "+z", "-x", "-y", "-z")
X, Y, Z = (np.diag(1.0 - 2 * np.eye(3)[k]) for k in range(3))
"""Mirrors along the axes."""


def body(normals=CUBE_NORMALS, names=NAMES, gains=None, **more) -> Vehicle:
    """Return panels in W on a body whose three moments differ by far more than their sigmas."""
    size = np.ones(len(names)) if gains is None else np.array(gains, dtype=float)
    every = zip(names, units(np.array(normals)), size.tolist(), strict=True)
    panels = [Panel(*each) for each in every]
    stated = {"inertia_kg_m2": np.diag([0.04, 0.06, 0.08]), "gain_unit": "W", "panels": panels}
    return Vehicle("body", **stated | more)


def lit(vehicle: Vehicle, **more) -> Observed:
    """All columns in sunlight."""
    return Observed(vehicle, np.ones(len(vehicle.inputs), dtype=bool), span_s=600.0, **more)


def names(found) -> set[str]:
    return {change.what for change, _ in found}


def of_columns(craft: Vehicle):
    """Return all exchanges of two columns and reversals of one panel."""
    empty = np.zeros((2, len(craft.inputs)))
    return column_changes(craft, xr.Dataset({"power_W": (("time", "panel"), empty)}))


def is_alike(craft: Vehicle, *changes: ColumnChange) -> bool:
    """Return whether no reading distinguishes two changes, or a change and the file as it is written."""
    return len(equivalence(lit(craft), *(AS_WRITTEN, *changes)[-2:])) == 1


def pair(a: str, b: str) -> str:
    return f"the columns of panels {a} and {b} exchanged"


def test_two_opposite_columns_exchanged_are_a_mirror_of_the_file_as_it_is_written():
    cube = body()
    for a, b, mirror in ((0, 3, X), (1, 4, Y), (2, 5, Z)):
        (found,) = equivalence(lit(cube), AS_WRITTEN, exchange(cube, a, b))
        np.testing.assert_allclose(found, mirror, atol=1e-12)
        rate = np.array([1.0, 2.0, 3.0])
        np.testing.assert_allclose(rate_under(found, rate), -mirror @ rate, atol=1e-12)
    assert not is_alike(cube, exchange(cube, 0, 1))


def test_exchanges_mapped_by_a_rotation_about_a_cube_corner_are_equivalent():
    """+x to +y to +z to +x: of a body whose moments are alike it leaves nothing to see; moments that differ tell."""
    cube, order = body(), [1, 2, 0, 4, 5, 3]
    corner = ColumnChange("the panels turned about a corner", columns=tuple(np.argsort(order)))
    ball = replace(cube, inertia_kg_m2=0.05 * np.eye(3))
    (found,) = equivalence(lit(ball), AS_WRITTEN, corner)
    assert np.linalg.det(found) == pytest.approx(1.0) and np.trace(found) == pytest.approx(0.0)
    assert is_alike(replace(cube, inertia_kg_m2=None), corner) and not is_alike(cube, corner)


@pytest.mark.parametrize(("axis", "seen"), [("x", {pair("+x", "-x")}), ("z", {pair("+z", "-z")})])
def test_a_mirror_reverses_a_wheel_but_not_one_along_its_normal(axis, seen):
    wheel = Wheel("w", np.eye(3)["xyz".index(axis)], 1e-4, 300.0)
    craft = body(wheels=(wheel,))
    momentum = 0.5 * np.asarray(wheel.axis_B)[None, None] * np.ones((1, 20, 1))
    observed = lit(craft, momenta=momentum)
    assert names(equivalent_changes(observed, AS_WRITTEN, of_columns(craft))) == seen
    (reversed_wheel,) = wheel_changes(craft)
    others = {pair("+x", "-x"), pair("+y", "-y"), pair("+z", "-z")} - seen
    assert names(equivalent_changes(observed, reversed_wheel, of_columns(craft))) == others
    weak = replace(observed, momenta=1e-5 * momentum)  # 0.003 rad in ten minutes: nobody sees it
    assert names(equivalent_changes(weak, AS_WRITTEN, of_columns(craft))) == seen | others


def test_with_wing_panels_an_exchange_of_two_opposite_columns_is_detected():
    wings = [[0.5, 0.15, 0.85], [-0.5, 0.15, 0.85]]
    craft = body(
        [*CUBE_NORMALS[[0, 1, 3, 4, 5]], *wings], ("+x", "+y", "-x", "-y", "-z", "wa", "wb")
    )
    empty = xr.Dataset({"power_W": (("time", "panel"), np.zeros((2, 7)))})
    assert not equivalent_changes(lit(craft), AS_WRITTEN, of_columns(craft))
    ((both, matrix),) = unseen_changes(lit(craft), empty)
    assert both.what == f"{pair('+x', '-x')}, and {pair('wa', 'wb')}"
    np.testing.assert_allclose(matrix, X, atol=1e-12)
    wing = exchange(craft, 5, 6)
    assert names(equivalent_changes(lit(craft), wing, of_columns(craft))) == {
        wing.what,
        pair("+x", "-x"),
    }


def test_gains_distinguish_exchanges_beyond_their_sigmas_and_only_by_ratios_if_the_scale_is_free():
    def facts(sigma: float) -> dict[str, Fact]:
        return {f"panel.{name}.gain_W": Fact(1.0, sigma) for name in NAMES}

    # seven sigmas of the difference, in two columns
    unequal = body(gains=[1, 1, 1, 1.1, 1, 1], facts=facts(0.01))
    assert not is_alike(unequal, exchange(unequal, 0, 3))
    assert is_alike(replace(unequal, facts=facts(0.05)), exchange(unequal, 0, 3))
    # the opposite of each lit panel is brighter
    three = body(gains=[1, 1, 1, 1.2, 1.2, 1.2], facts=facts(0.01))
    observed = Observed(three, np.array([True, True, True, False, False, False]))
    opposite = ColumnChange("all columns exchanged", columns=(3, 4, 5, 0, 1, 2))
    assert not len(equivalence(observed, AS_WRITTEN, opposite))
    relative = replace(observed, vehicle=replace(three, gain_unit=None))
    (found,) = equivalence(relative, AS_WRITTEN, opposite)
    np.testing.assert_allclose(found, -np.eye(3), atol=1e-12)


def test_moments_of_inertia_distinguish_exchanges_beyond_their_sigmas():
    """+x with +y exchanged is -x with -y exchanged seen in a mirror, if the moments about x and y are alike."""
    # a percent apart, as the sigma that is assumed
    near, far = (body(inertia_kg_m2=np.diag([0.06, y, 0.09])) for y in (0.0606, 0.066))
    changes = exchange(near, 0, 1), exchange(near, 3, 4)
    assert is_alike(near, *changes) and not is_alike(far, *changes)
    known = {"body.inertia_kg_m2": Fact(np.zeros((3, 3)).tolist(), 0.003)}
    assert is_alike(replace(far, facts=known), *changes)
    # a mirror reverses the product xy
    product = body(inertia_kg_m2=np.array([[0.04, 0.006, 0], [0.006, 0.06, 0], [0, 0, 0.08]]))
    assert not is_alike(product, exchange(product, 0, 3))
    assert is_alike(product, exchange(product, 2, 5))


def test_columns_that_stay_dark_do_not_distinguish_exchanges():
    craft = body()
    seen = np.array([True, True, True, True, True, False])
    toward_z = np.array([[0.6, 0.0, 0.8], [0.0, 0.6, 0.8], [-0.6, 0.0, 0.8]])
    observed = Observed(craft, seen, sun_B=toward_z)
    upside_down = ColumnChange("panel +z looking the other way", reversed_panels=(2,))
    assert not len(equivalence(observed, AS_WRITTEN, upside_down))  # as -z, which would be lit then
    five = replace(craft, panels=craft.panels[:5])
    observed = Observed(five, seen[:5], sun_B=toward_z)
    (found,) = equivalence(observed, AS_WRITTEN, upside_down)
    np.testing.assert_allclose(found, Z, atol=1e-12)


def test_a_solution_whose_symmetric_one_is_not_listed_is_not_unique():
    """Sides only: the mirror along z changes no reading. With a panel on +z, lit or dark, the readings tell."""
    ring = body(CUBE_NORMALS[[0, 1, 3, 4]], ("+x", "+y", "-x", "-y"))
    found = equivalence(lit(ring), AS_WRITTEN, AS_WRITTEN)
    assert sorted(round(float(np.linalg.det(m))) for m in found) == [-1, 1]
    omega, sigma = np.radians([1.0, -2.0, 3.0]), np.full((2, 3), 1e-3)
    sun = np.array([[0.6, 0.7, 0.4], [-0.7, 0.6, 0.4], [-0.6, -0.7, 0.4], [0.7, -0.6, -0.4]])

    observed = lit(ring, sun_B=units(sun))
    mirrored = rate_under(Z, omega)
    assert has_unlisted_motion(observed, np.array([omega, np.full(3, np.nan)]), sigma, 0.01)
    assert not has_unlisted_motion(observed, np.array([omega, mirrored]), sigma, 0.01)
    top, low = body(CUBE_NORMALS[:5], NAMES[:5]), sun * [1.0, 1.0, 0.25]
    # at most a tenth of full Sun on +z: not lit, and ten sigmas of noise
    for suns, seen in ((sun, True), (low, False)):
        observed = Observed(top, np.array([True, True, seen, True, True]), sun_B=units(suns))
        assert len(equivalence(observed, AS_WRITTEN, AS_WRITTEN)) == (1 if seen else 2)
        assert not has_unlisted_motion(observed, omega[None], sigma[:1], 0.01)


SENSORS = Sensors(gyro=GYRO, magnetometer=MAGNETOMETER, attitude=QUATERNION)


@pytest.mark.parametrize(
    ("sensor", "as_read"),
    [("gyro_B", np.diag([1.0, -1.0, -1.0])), ("field_B", X), ("field_B", -X), ("sun_sensor_B", X)],
)
def test_a_used_sensor_excludes_a_mirror_unless_its_axes_are_mirrored_too(sensor, as_read):
    craft = body(sensors=SENSORS)
    observed, columns = lit(craft, sensors=frozenset({sensor})), exchange(craft, 0, 3)
    assert not len(equivalence(observed, AS_WRITTEN, columns))
    axes = ColumnChange("other axes", axes={sensor: as_read})
    (found,) = equivalence(observed, axes, columns)
    np.testing.assert_allclose(found, X, atol=1e-12)
    both = replace(observed, sensors=frozenset({sensor, "attitude_B_from_N"}))
    assert not len(equivalence(both, axes, columns))


@pytest.mark.parametrize(
    ("faces", "in_orbit", "expected"),
    [
        (["+y"], False, {"-x, +y, +z", "+x, -y, +z", "+x, +y, -z"}),
        (["+y"], True, {"-x, +y, -z", "+z, +y, -x", "-z, +y, +x"}),
        (["+y", "-z"], False, {"-x, +y, +z"}),
        (["+y", "-z"], True, set()),
        (["+x", "+y", "-z"], False, set()),
    ],
)
def test_axes_that_one_sensor_alone_shows_are_named(faces, in_orbit, expected):
    """The field in space has either sign without an orbit, so that a reversed column and the two others look alike."""
    normals = [CUBE_NORMALS[NAMES.index(face)] for face in faces]
    sensors = Sensors(magnetometer=MAGNETOMETER)
    craft = body(normals, faces, inertia_kg_m2=None, sensors=sensors)
    seen = lit(craft, sensors=frozenset({"field_B"}), in_orbit=in_orbit)
    ways = {f"the magnetometer read as ({axes}) of its columns" for axes in expected}
    assert names(unseen_axes(seen)) == ways


def test_elements_exclude_mirrors_once_sun_and_field_are_known_in_space():
    craft = body(sensors=SENSORS)
    field = ColumnChange("other axes", axes={"field_B": X})
    observed = lit(craft, sensors=frozenset({"field_B"}))
    assert len(equivalence(observed, field, exchange(craft, 0, 3))) == 1
    assert not len(equivalence(replace(observed, in_orbit=True), field, exchange(craft, 0, 3)))
    # the Sun alone is one direction
    assert len(equivalence(lit(craft, in_orbit=True), AS_WRITTEN, exchange(craft, 0, 3))) == 1


def test_the_torque_of_a_dipole_has_the_sign_of_the_field():
    """The torque is d x b: only if a change reverses both the dipole d and the field b does it stay as it is."""
    turn = np.diag([-1.0, -1.0, 1.0])
    columns = ColumnChange("four columns exchanged", columns=(3, 4, 2, 0, 1, 5))
    for in_orbit, sign, along_turned, along_kept in (
        (True, 1, 0, 1),
        (False, 1, 0, 1),
        (False, -1, 1, 0),
    ):
        axes = ColumnChange("other axes", axes={"field_B": sign * turn})
        for dipole, count in (([0.1, 0, 0], along_turned), ([0, 0, 0.1], along_kept)):
            sensors = replace(SENSORS, disturbance=Disturbance(dipole=dipole))
            observed = lit(body(sensors=sensors), sensors=frozenset({"field_B"}), in_orbit=in_orbit)
            assert len(equivalence(observed, axes, columns)) == count, (in_orbit, sign, dipole)


@pytest.mark.parametrize(("shared", "count"), [(("x",), 2), (("x", "y", "z"), 8)])
def test_a_file_with_shared_inputs_has_their_symmetric_solutions(shared, count):
    """Opposite panels on one input: the mirrors that the search makes images by are those of the equivalence."""
    channels = tuple(Channel(name, (f"+{name}", f"-{name}"), "sum") for name in shared)
    craft = body(channels=channels)
    found = equivalence(lit(craft), AS_WRITTEN, AS_WRITTEN)
    images = craft.response_in().symmetries
    assert len(found) == len(images) == count
    assert all(np.abs(found - image).max(axis=(1, 2)).min() < 1e-9 for image in images)

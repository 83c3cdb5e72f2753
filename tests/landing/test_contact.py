"""First contact and rest: the support function by brute force, closed forms for rods and boxes, Philae's shape."""

from itertools import product

import numpy as np
import pytest

import sunspin as ss
from sunspin.landing import contact as c
from sunspin.vehicle import HullPart, Leg, Panel, Vehicle
from tests.support.vehicles import directions, units

BOX = np.array(list(product((-1.0, 1.0), (-2.0, 2.0), (-3.0, 3.0))))


def box(shift=(0.0, 0.0, 0.0)) -> c.Shape:
    return c.build_shape(Vehicle("box", hull=[HullPart("box", BOX + shift)]))


def test_the_support_function_of_a_box_is_the_sum_of_its_half_sides():
    d = directions(100, 1)
    np.testing.assert_allclose(c.support(BOX, d)[0], np.abs(d) @ [1, 2, 3], rtol=1e-14)


def test_philae_rests_on_three_legs_and_panels_share_corners():
    shape = c.build_shape(ss.load_vehicle("philae"))
    assert (shape.kind == 0).sum() == 3 and shape.complete
    lid = shape.panels[:, 5]
    assert lid.sum() == 6 and np.all(shape.panels[lid].sum(axis=1) >= 2)
    standing = c.rest_facet(shape, np.array([[0.0, 0.0, 1.0]]))
    assert shape.facet_kind[standing[0]] == 0
    upside_down = c.rest_facet(shape, np.array([[0.0, 0.0, -1.0]]))
    assert shape.facet_kind[upside_down[0]] == 1
    assert c.is_leg_lowest(shape, np.array([0.0, 0.0, 1.0]))
    assert not c.is_leg_lowest(shape, np.array([0.0, 0.0, -1.0]))


def test_a_hull_corner_at_a_leg_tip_counts_as_leg_and_others_as_body():
    panels, parts = [Panel("top", [0, 0, 1], 1.0)], [HullPart("lid", BOX[1:3], "top")]
    parts.append(HullPart("b", BOX))
    vehicle = Vehicle("v", panels=panels, legs=[Leg("a", BOX[0])], hull=parts)
    shape = c.build_shape(vehicle)
    assert len(shape.points_B_m) == 8
    assert sorted(shape.kind) == [0, 1, 1, 2, 2, 2, 2, 2]


def test_a_centred_box_rests_on_the_face_below_its_centre_of_mass():
    shape = box()
    assert len(shape.outward_B) == 6 and sorted(shape.distances_m) == [1, 1, 2, 2, 3, 3]
    up = directions(300, 2)
    facet = c.rest_facet(shape, up)
    # the face that the ray from the centre leaves through
    expected = np.argmax(np.abs(up) / [1, 2, 3], axis=1)
    np.testing.assert_array_equal(np.argmax(np.abs(shape.outward_B[facet]), axis=1), expected)
    assert np.all(np.sum(shape.outward_B[facet] * -up, axis=1) > 0)


def test_a_tower_whose_centre_of_mass_is_outside_its_foot_tips_over():
    """The centre of mass is beyond the edge of the small foot: standing upright is no rest."""
    foot = [[0.5, -1, -3], [1, -1, -3], [0.5, 1, -3], [1, 1, -3]]
    top = [[-2, -1, 1], [1, -1, 1], [-2, 1, 1], [1, 1, 1]]
    shape = c.build_shape(Vehicle("tower", hull=[HullPart("all", [*foot, *top])]))
    facet = c.rest_facet(shape, np.array([[0.0, 0.0, 1.0]]))
    assert shape.outward_B[facet[0]][2] > -0.99
    inside = c.rest_facet(shape, -shape.outward_B[facet])
    np.testing.assert_array_equal(inside, facet)


def test_a_centre_of_mass_outside_the_hull_gives_no_resting_face():
    shape = box(shift=(5.0, 0, 0))
    assert shape.outward_B is None
    with pytest.raises(ss.InputError, match="no facet"):
        c.rest_facet(shape, np.array([[0.0, 0.0, 1.0]]))
    assert c.build_shape(Vehicle("flat", hull=[HullPart("plate", BOX[:4])])).outward_B is None
    assert c.build_shape(Vehicle("nothing")) is None


def spin(rate, t, phase):
    """The ground's normal in a body that turns about x with its rate, starting at `phase` from z."""
    angle = phase[:, None] + rate[:, None] * t
    up = np.stack([np.zeros_like(angle), np.sin(angle), np.cos(angle)], axis=-1)
    return up, np.broadcast_to(np.stack([rate, 0 * rate, 0 * rate], axis=-1)[:, None], up.shape)


def test_without_rotation_the_lowest_point_touches_earlier_by_its_reach_over_the_speed():
    rng, shape, t = np.random.default_rng(3), box(), np.linspace(0, 60, 301)
    up = np.broadcast_to(units(rng.normal(size=(50, 1, 3))), (50, 301, 3))
    found = c.first_contact(shape, t, up, np.zeros_like(up), np.full(50, 0.1))
    reach, index = c.support(shape.points_B_m, -up[:, 0])
    np.testing.assert_array_equal(found.point, index)
    np.testing.assert_allclose(found.t_s, 60 - reach / 0.1, atol=0.2 / c.REFINE + 1e-9)


def test_the_rate_at_contact_is_that_at_the_contact_time():
    """About the ground's normal, growing evenly: at 0.01 rad/s2 the rate is a hundredth of the time."""
    shape, t = box(), np.linspace(0, 60, 7)
    up = np.broadcast_to([0.0, 0.0, 1.0], (1, 7, 3))
    found = c.first_contact(shape, t, up, 0.01 * t[:, None] * up, np.array([0.1]))
    assert found.t_s[0] == pytest.approx(30.0, abs=10 / c.REFINE)  # half a side of 3 m at 0.1 m/s
    np.testing.assert_allclose(found.omega_B[0], [0, 0, 0.01 * found.t_s[0]], atol=1e-12)


@pytest.mark.evidence("outcomes", "verified", "a dense search in time")
def test_the_contact_of_a_rotating_rod_agrees_with_a_dense_search():
    """Height of the centre v (T - t) against L |cos(angle)|, the angle growing at a constant rate."""
    rng, n, t = np.random.default_rng(4), 60, np.linspace(0, 40, 101)
    shape = c.build_shape(Vehicle("rod", hull=[HullPart("rod", [[0, 0, -1.5], [0, 0, 1.5]])]))
    rate = rng.uniform(-0.8, 0.8, n)
    phase = rng.uniform(0, 2 * np.pi, n)
    v = rng.uniform(0.05, 0.2, n)
    up, omega = spin(-rate, t, phase)
    found = c.first_contact(shape, t, up, omega, v)
    dense = np.linspace(0, 40, 40_001)
    reach = 1.5 * np.abs(np.cos(phase[:, None] - rate[:, None] * dense))
    exact = dense[np.argmax(v[:, None] * (40 - dense) <= reach, axis=1)]
    early = exact > 0  # rods that touch within the window
    assert early.sum() > 40
    late = found.t_s[early] - exact[early]
    assert np.all(late > -2e-3) and np.max(late) < 0.4 / c.REFINE + 1e-2


NO_POINTS = "points_B_m of hull part 'a' must be points of three finite numbers"
NO_CONE = "opening_rad must be an angle above 0 and at most 2 pi"
NO_PANEL = "hull part 'a' names a panel that the vehicle does not have"


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda: HullPart("a", [[1, 2]]), NO_POINTS),
        (lambda: ss.Antenna([0, 0, 1], 7.0), NO_CONE),
        (lambda: Vehicle("v", hull=[HullPart("a", BOX, "7")]), NO_PANEL),
        (lambda: Vehicle("v", hull=[HullPart("a", BOX)] * 2), "two hull share the name 'a'"),
    ],
)
def test_bad_hulls_are_refused_by_name(change, text):
    with pytest.raises(ss.VehicleError, match=text.replace("(", r"\(")):
        change()


def test_antenna_and_walls_of_philae_are_those_of_the_paper():
    case = ss.load_case("philae")
    assert np.degrees(case.vehicle.antenna.opening_rad) == pytest.approx(
        case.published["antenna_cone"].value
    )
    for part in case.vehicle.hull:
        if part.panel:
            normal = case.vehicle.panels[case.vehicle.panel_names.index(part.panel)].normal_B
            heights = part.points_B_m @ normal
            # each panel is flat and faces as its normal says
            assert np.ptp(heights) < 2e-3 and np.all(heights > 0)

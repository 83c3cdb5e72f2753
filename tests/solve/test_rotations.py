"""Rotations: each function compared with another."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sunspin.solve.rotations import (
    components_after_rotation,
    cross_matrix,
    matrix_from_quaternion,
    move_on_sphere,
    rotate_attitude,
    rotate_by_smallest,
    rotation_between,
    tangent_basis,
)
from tests.support.vehicles import directions


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-3, 1.0, 3.0, np.pi - 1e-9, np.pi, 5.0])
def test_rotations_agree_with_scipy(size):
    """As matrices where half a turn one way is one the other way, too; what rotates left sees the rest move right."""
    angle, start = size * directions(50, 7), Rotation.random(50, rng=8).as_matrix()
    end = rotate_attitude(start, angle)
    expected = Rotation.from_rotvec(-angle).as_matrix() @ start
    assert end == pytest.approx(expected, abs=5e-15)
    fixed, moved = directions(50, 9), Rotation.from_rotvec(-angle)
    assert components_after_rotation(fixed, angle) == pytest.approx(moved.apply(fixed), abs=5e-15)
    across = np.einsum("nij,nj->ni", cross_matrix(angle), fixed)
    np.testing.assert_allclose(across, np.cross(angle, fixed), atol=1e-15)
    found = rotation_between(start, end)
    assert Rotation.from_rotvec(-found).as_matrix() @ start == pytest.approx(expected, abs=1e-14)
    expected = np.full(50, min(size, 2 * np.pi - size))
    assert np.linalg.norm(found, axis=1) == pytest.approx(expected, abs=1e-14, rel=1e-12)
    rotation = Rotation.from_rotvec(angle)
    found = matrix_from_quaternion(-2 * rotation.as_quat())
    assert found == pytest.approx(rotation.as_matrix(), abs=5e-15)


def test_the_smallest_rotation_between_directions_leaves_their_normal_fixed():
    a, b = directions(20, 3), directions(20, 4)
    across = np.cross(a, b)
    assert rotate_by_smallest(a, b, a) == pytest.approx(b, abs=1e-12)
    assert rotate_by_smallest(a, b, across) == pytest.approx(across, abs=1e-12)


def test_steps_on_the_sphere_have_the_stated_length():
    a, step = directions(20, 5), np.random.default_rng(6).normal(size=(20, 2))
    e1, e2 = tangent_basis(a)
    assert np.einsum("ni,ni->n", np.cross(e1, e2), a) == pytest.approx(np.ones(20))
    angle = np.linalg.norm(step, axis=1)
    assert np.einsum("ni,ni->n", a, move_on_sphere(a, step)) == pytest.approx(np.cos(angle))
    slope = np.einsum("ni,ni->n", move_on_sphere(a, 1e-7 * step) - a, e1) / 1e-7
    assert slope == pytest.approx(step[:, 0], abs=1e-6)

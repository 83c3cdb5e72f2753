"""E and EMD: closed forms, the axioms of a metric, linear programming."""

import numpy as np
import pytest
import xarray as xr
from hypothesis import strategies as st
from scipy.optimize import linprog

import sunspin as ss

samples = st.lists(st.floats(-1, 1), min_size=1, max_size=12)


def test_emd_by_hand():
    assert ss.emd([-1], [1]) == 1.0  # all mass over the whole way
    assert ss.emd([0.2], [0.5]) == pytest.approx(0.15)
    assert ss.emd([0, 1], [0], [3, 1], [1]) == pytest.approx(0.125)


@pytest.mark.evidence("emd", "validated", "the definition as a linear program, SciPy's HiGHS")
@pytest.mark.parametrize("seed", range(4))
def test_emd_is_the_cheapest_transport(seed, reached):
    """The earth mover's own definition, solved as a linear program with weights; the longest way, 2, costs 1."""
    rng = np.random.default_rng(seed)
    (a, wa), (b, wb) = [(rng.uniform(-1, 1, n), rng.uniform(0.1, 1, n)) for n in (6, 9)]
    leaves, arrives = np.kron(np.eye(6), np.ones(9)), np.kron(np.ones(6), np.eye(9))
    cost, mass = np.abs(a[:, None] - b).ravel() / 2, [wa / wa.sum(), wb / wb.sum()]
    plan = linprog(cost, A_eq=np.vstack([leaves, arrives]), b_eq=np.concatenate(mass))
    reached("difference", abs(ss.emd(a, b, wa, wb) - plan.fun), "", 1e-9)
    assert ss.emd(a, b, wa, wb) == pytest.approx(plan.fun, abs=1e-9)


@pytest.mark.evidence(
    "direction_error", "verified", "by hand; the paper's E of 0.0028 is 6.1 degrees"
)
def test_direction_error_by_hand():
    x, y = np.eye(3)[:1], np.eye(3)[1:2]
    assert ss.direction_error(x, x) == 0
    assert ss.direction_error(x, -x) == 1
    assert ss.direction_error(x, y) == 0.5
    angle = np.radians(6.1)
    tilted = np.array([[np.cos(angle), np.sin(angle), 0]])
    assert ss.direction_error(x, tilted) == pytest.approx(0.0028, abs=5e-5)


def test_direction_error_leaves_out_samples_without_a_direction():
    sim = np.tile(np.eye(3)[0], (3, 1))
    meas = np.array([[1, 0, 0], [np.nan] * 3, [0, 1, 0]])
    assert ss.direction_error(sim, meas) == pytest.approx(0.25)


def test_direction_error_of_many_tracks_at_once_and_of_datasets():
    rng = np.random.default_rng(3)
    sim, meas = rng.normal(size=(4, 7, 3)), rng.normal(size=(7, 3))
    sim, meas = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (sim, meas))
    each = ss.direction_error(sim, meas)
    assert each.shape == (4,)
    squared = ((sim - meas) ** 2).sum(axis=-1).mean(axis=-1) / 4  # |r - n|^2 = 2 (1 - r.n)
    np.testing.assert_allclose(each, squared, atol=1e-15)
    wrapped = [xr.Dataset({"sun_B": (("time", "axis"), v)}) for v in (sim[2], meas)]
    assert ss.direction_error(*wrapped) == pytest.approx(each[2], abs=1e-15)
    turned = xr.Dataset({"sun_B": (("axis", "time"), meas.T)})
    assert ss.direction_error(wrapped[0], turned) == pytest.approx(each[2], abs=1e-15)


@pytest.mark.parametrize(
    ("sim", "meas", "said"),
    [
        (np.zeros((2, 3)), np.zeros((3, 3)), "same samples"),
        (np.zeros((2, 3)), np.full((2, 3), np.nan), "no direction"),
        (np.zeros((3, 2)), np.zeros((3, 2)), r"sun_sim must have the shape"),
    ],
)
def test_tracks_that_cannot_be_compared_are_refused(sim, meas, said):
    with pytest.raises(ss.InputError, match=said):
        ss.direction_error(sim, meas)


@pytest.mark.parametrize(
    ("z", "weights", "named"),
    [
        *(([0.1, 0.2], weights, "weights_a") for weights in ([1], [1, -1], [0, 0], [1, np.nan])),
        *((z, None, "z_a") for z in ([], [2.0], [np.nan])),
    ],
)
def test_emd_refuses_bad_samples_and_weights(z, weights, named):
    with pytest.raises(ss.InputError, match=named):
        ss.emd(z, [0.3], weights)

"""A step of a fit that goes along the equations of motion leaves them by what linear theory predicts, however far it goes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from sunspin.estimate.carry import RATE
from sunspin.estimate.chain import bent_step, carried, defects
from sunspin.estimate.evidence import ladder
from sunspin.estimate.model import Body, Model, Noise, Track
from sunspin.estimate.observe import observe
from sunspin.estimate.settings import RATES
from sunspin.estimate.terms.term import facing
from sunspin.telemetry.assess import assess
from tests.support.orbit_cases import SPARSE, one_pass, rates_case
from tests.support.simulate import CUBE, simulated_pass, uneven_times

WEAK = 5e-6
"""rad/s^1.5; the weakest torques of `rates`, under which steps that are straight creep."""


def model_and_motion() -> tuple[Model, Track]:
    """Return a pass of a body without an inertia, and a motion of two thirds of a revolution from sample to sample."""
    rng = np.random.default_rng(3)
    omega = np.array([-0.06, 0.05, 0.1])
    times = uneven_times(rng, 12, 33.0, 0.02)
    data, _ = simulated_pass(CUBE, omega, times, rng, albedo=0.0)
    vehicle = replace(CUBE, inertia_kg_m2=None, facts={})
    model = Model(observe(assess(vehicle, data)).obs, Body.of(vehicle), Noise(WEAK), 0.14)
    middle = len(model.obs) // 2
    start = carried(model, middle, facing(np.array([[0.6, 0.0, 0.8]])), omega[None])
    return model, replace(start, u=np.zeros((1, len(model.unknowns))))


def test_a_step_along_the_equations_leaves_them_by_what_linear_theory_says():
    model, motion = model_and_motion()
    rng = np.random.default_rng(5)
    nodes = 0.05 * rng.normal(size=(1, len(model.obs), 6))
    nodes[..., RATE] *= 0.01
    u = 0.3 * rng.normal(size=motion.u.shape)
    defect = defects(model, motion)
    predicted = defect.value + np.einsum("knij,knj->kni", defect.by_first, nodes[:, :-1])
    predicted += np.einsum("knij,knj->kni", defect.by_second, nodes[:, 1:])
    predicted += np.einsum("knij,kj->kni", defect.by_u, u)
    after = defects(model, bent_step(model, motion, nodes, u)).value
    # in whitened units of weak torques, thousands of sigmas: to a millionth of them
    np.testing.assert_allclose(after, predicted, atol=1e-6 * np.abs(predicted).max())


def test_the_true_motion_of_a_body_without_an_inertia_costs_little_under_weak_torques():
    """A body at 7 deg/s, samples 34 s apart: by straight steps alone its cost is 140, more than that of its slower alias."""
    vehicle, data, _, truth, about = rates_case(11, 9, **SPARSE)
    telemetry = one_pass(data, about["begin_s"][0]).drop_vars("field_B")
    obs = observe(assess(vehicle, telemetry)).obs
    obs = obs.of_pass(np.arange(len(obs)))
    at = truth.sel(time=obs.t_s)
    # attitudes in axes with z to the Sun
    sun_N = at["sun_N"].values[0]
    attitude = Rotation.from_quat(at["B_from_N"].values).as_matrix() @ facing(sun_N)
    begin = Track(attitude[None], at["omega_B"].values[None], np.zeros((1, 0)))
    stated = Model(obs, Body.of(vehicle), Noise(WEAK), 0.14)
    fits = ladder(stated, begin, RATES.ladder, RATES.search, RATES.search.noise)
    cost = {one.model.noise.acceleration: float(one.motions.cost.min()) for one in fits}
    assert cost[WEAK] < obs.cost_limit / 4, cost

"""Rates and posterior of a body under gravity gradient. All telemetry is synthetic."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.dynamics.torques import acting
from sunspin.environment import circular
from sunspin.estimate.posterior.data import readings
from sunspin.estimate.posterior.likelihood import Likelihood, move_on_sphere
from sunspin.estimate.posterior.model import State, model, under
from sunspin.estimate.posterior.predict import drawn_rows
from sunspin.estimate.rates.motion import (
    FREE,
    Body,
    rotate_attitude,
    rotation_between,
    step,
    step_with_answer,
)
from sunspin.vehicle import Panel, TelemetryForm, Vehicle

ORBIT = circular(1.1e-3, [0.0, 1.0, 0.3], [0.0, 0.0, 1.0])
INERTIA = np.array([[0.042, 0.0005, 0.0], [0.0005, 0.041, -0.001], [0.0, -0.001, 0.009]])
RATE, ATTITUDE = np.array([0.004, -0.003, 0.006]), Rotation.random(random_state=4)
TORQUES = ("gravity_gradient",)

CUBE = Vehicle(
    "cube",
    INERTIA,
    telemetry=TelemetryForm(quantity="current_A", noise=0.01),
    panels=[
        Panel(f"{sign}{axis}", x, 1.0)
        for axis, e in zip("xyz", np.eye(3), strict=True)
        for sign, x in (("+", e), ("-", -e))
    ],
)


def tumbling_telemetry() -> tuple[xr.Dataset, xr.Dataset]:
    rng = np.random.default_rng(3)
    t = np.concatenate([[0.0], np.cumsum(60 * rng.uniform(0.7, 1.3, 29))])
    run = ss.propagate(
        CUBE,
        RATE,
        ATTITUDE.apply([0, 0, 1]),
        None,
        t,
        environment=ORBIT,
        torques=TORQUES,
        B_from_N=ATTITUDE.as_quat(),
    )
    power = ss.panel_power(CUBE, run["sun_B"].values)
    power = np.maximum(power + 0.01 * rng.normal(size=power.shape), 0)
    variables = {
        "current_A": (("time", "panel"), power),
        "flag": ("time", np.zeros(len(t), dtype=np.uint8)),
    }
    coords = {"time": t, "panel": list(CUBE.panel_names)}
    return xr.Dataset(variables, coords, {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1}), run


@pytest.mark.long
@pytest.mark.evidence(
    "rates", "modelled", "a simulated tumbling CubeSat; without the torque it must fit worse"
)
def test_gravity_gradient_determines_the_rotation_about_the_sun_direction():
    data, run = tumbling_telemetry()
    found, errors, off_by = {}, {}, {}
    for torques in ((), TORQUES):
        result = ss.rates(
            CUBE,
            data,
            acceleration_noise=1e-7,
            max_rate_rad_s=0.03,
            environment=ORBIT,
            torques=torques,
        )
        off = result["omega_B"].values - run["omega_B"].sel(time=result["time"]).values
        errors[torques] = np.sqrt(
            np.mean(off**2 / np.einsum("nii->ni", result["omega_cov_B"].values))
        )
        off_by[torques] = np.sqrt(np.mean(off**2))
        found[torques] = result
    free, pulled = found.values()
    assert (
        pulled["model"].item() == "as stated" and "torque" in free["model"].item()
    )  # without it, one is found to be missing
    assert errors[TORQUES] < 1.5 and off_by[TORQUES] < off_by[()] / 2
    attitude, truth = (Rotation.from_quat(x["B_from_N"].values) for x in (pulled, run))
    assert (
        np.degrees((attitude * truth.inv()).magnitude()).max() < 20.0
    )  # nothing but the torque says how the body stands about it


def test_derivatives_of_a_step_under_torques_agree_with_differences():
    body, rng = Body.of(CUBE, acting=acting(TORQUES, ORBIT)), np.random.default_rng(1)
    omega, attitude = rng.normal(size=(3, 3)) * 2e-3, Rotation.random(3, random_state=2).as_matrix()
    dt = np.array([300.0, 200.0, 100.0])
    made, rate, answer = step_with_answer(body, omega, dt, body.seen(FREE, attitude, 50.0))
    for k in range(3):
        small = 1e-4 * np.eye(3)[k]
        other = rotate_attitude(attitude, small)
        ended, rates = step(body, omega, dt, body.seen(FREE, other, 50.0))
        np.testing.assert_allclose(
            rotation_between(made @ attitude, ended @ other) / 1e-4, answer[..., :3, k], atol=2e-4
        )
        np.testing.assert_allclose((rates - rate) / 1e-4, answer[..., 3:, k], atol=2e-6)
    assert (
        np.abs(answer[:, 3:, :3]).max() > 1e-4
    )  # the control: without torques the rate does not know the attitude


@dataclass(frozen=True)
class Aslant:
    """An environment whose Sun is not along z of N."""

    frame_N: str = "aslant"

    def at(self, t_s):
        return replace(ORBIT.at(t_s), sun_N=np.tile([0.0, 0.6, 0.8], (np.size(t_s), 1)))


def test_rates_refuses_torques_without_their_environment_and_a_sun_elsewhere():
    data, _ = tumbling_telemetry()
    with pytest.raises(
        ss.InputError, match="rates needs an environment with z of its N to the Sun"
    ):
        ss.rates(CUBE, data, environment=Aslant(), torques=TORQUES)
    with pytest.raises(ss.MotionError, match="'gravity_gradient' needs an environment"):
        ss.rates(CUBE, data, torques=TORQUES)


def likelihood() -> Likelihood:
    data, start_s, _ = readings(
        CUBE, tumbling_telemetry()[0].assign_coords(time=lambda x: x["time"] + 200.0)
    )
    unknown = under(
        model(CUBE, {"inertia": 0.0, "max_rate_rad_s": 0.02}, 1.0)[0],
        acting(TORQUES, ORBIT, start_s),
    )
    return Likelihood(unknown, data, 1e-9)


def test_the_posterior_motion_under_torques_agrees_with_the_reference_and_its_differences():
    own = likelihood()
    u = np.zeros((1, len(own.model.unknowns)))
    u[:, own.model.where("turn")] = 0.3
    state = State(RATE[None], ATTITUDE.apply([[0.0, 0.0, 1.0]]), u)
    t = own.data.t_s
    start = own.model.rows(state).B_from_N[0]
    run = ss.propagate(
        CUBE,
        RATE,
        state.sun[0],
        None,
        t + 200.0,
        environment=ORBIT,
        torques=TORQUES,
        B_from_N=start,
    )
    np.testing.assert_allclose(own.predict(state).sun[0], run["sun_B"].values, atol=1e-8)
    jacobian = own.linearised(state)[3]

    def raw(other: State) -> np.ndarray:
        return own.misfit(own.predict(other), other.u)[0]

    place = own.model.where("turn")[0]
    for column, size, there in (
        (0, 1e-6, lambda x: State(state.omega + [x, 0, 0], state.sun, u)),
        (3, 1e-4, lambda x: State(RATE[None], move_on_sphere(state.sun, np.array([[x, 0]])), u)),
        (
            5 + place,
            1e-3,
            lambda x: State(RATE[None], state.sun, u + x * np.eye(u.shape[1])[place]),
        ),
    ):
        expected = (raw(there(size)) - raw(there(-size))) / (2 * size)
        assert np.abs(jacobian[0, :, column] - expected).max() < 0.03 * np.abs(expected).max()
    assert np.abs(jacobian[0, :, 5 + place]).max() > 0.01  # the readings know of the turn


def test_draws_under_torques_are_not_propagated_without_them():
    tree = xr.DataTree(xr.Dataset(attrs={"torques": json.dumps(TORQUES)}))
    with pytest.raises(
        ss.InputError, match="draws of a posterior under torques cannot be carried on yet"
    ):
        drawn_rows(CUBE, tree)

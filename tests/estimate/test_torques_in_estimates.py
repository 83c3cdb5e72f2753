"""The posterior of a body under gravity gradient. All telemetry is synthetic."""

import json

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

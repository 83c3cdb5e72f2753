"""What each observation tells of the rates, and what it is worth to know the inertia: Laplace's method at a posterior's best draw.

    python -m sunspin.philae.contributions POSTERIOR.nc --vehicle philae

Every line is the change of the logarithm of the volume that holds 90 % of the rates, and of the sigma of the angular speed,
when a sample, a panel or an unknown is taken away, or something is added.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, sentence
from sunspin.base.netcdf import read_groups
from sunspin.compute.campaign import command
from sunspin.estimate.information import Information, rate_volume, speed_sigma
from sunspin.estimate.posterior.brightness import brightness
from sunspin.estimate.posterior.data import readings
from sunspin.estimate.posterior.model import State, model
from sunspin.estimate.terms.angular_speed import AngularSpeed
from sunspin.estimate.terms.gyro import GyroReading
from sunspin.estimate.terms.reading import Reading
from sunspin.telemetry.case import load_case
from sunspin.telemetry.reader import read_telemetry
from sunspin.vehicle import Vehicle, load_vehicle

FIXED = {
    "inertia known": ("inertia",),
    "friction known": ("coulomb", "viscous"),
    "wheel speed known": ("wheel_speed", "wheel_inertia"),
    "brightness known": ("scale",),
    "inertia, friction and wheel known": (
        "inertia",
        "coulomb",
        "viscous",
        "wheel_speed",
        "wheel_inertia",
    ),
}
"""Unknowns that are taken as known, by kind."""


@dataclass(frozen=True)
class Line:
    """What was changed, the volume that holds 90 % of the rates ((rad/s)^3), and the sigma of the angular speed (rad/s)."""

    what: str
    volume: float
    speed_sigma: float


def best_state(vehicle: Vehicle, telemetry: xr.Dataset, tree: Any) -> tuple[Any, Any, State]:
    """Model, readings and the most probable draw of a posterior (one row), at the first sample."""
    data, start, _ = readings(vehicle, telemetry, *window(tree))
    if abs(start - float(tree.attrs["t_first_s"])) > 1e-3 or len(data) != int(
        tree.attrs["samples"]
    ):
        raise InputError(
            sentence(
                "the telemetry is not that of the posterior",
                got=f"{len(data)} samples from {start:g} s",
            )
        )
    mode = json.loads(tree.attrs.get("wheel_mode", '"coast"'))
    unknown, _ = model(
        vehicle, json.loads(tree.attrs["priors_given"]), brightness(vehicle, data), mode
    )
    found = tree["posterior"]
    values = np.stack(
        [
            found["wheel_speed_rad_s"].values[0][:, x.index]
            if x.kind == "wheel_speed"
            else found[x.name].values[0]
            for x in unknown.unknowns
        ],
        axis=1,
    )
    centre, sigma = (
        np.array([getattr(x, key) for x in unknown.unknowns]) for key in ("centre", "sigma")
    )
    draws = State(found["omega_B"].values[0], found["sun_B"].values[0], (values - centre) / sigma)
    best = int(np.argmax(found["log_likelihood_sum"].values[0] + unknown.log_prior(draws)))
    return unknown, data, draws.take([best])


NEEDED = {"t_first_s", "t_last_s", "samples", "priors_given"}
"""Attributes of a posterior without which it cannot be taken apart."""


def read_posterior(path: Path) -> xr.DataTree:
    """The posterior in a file of `sunspin posterior`; InputError where it is none."""
    tree = xr.DataTree.from_dict(read_groups(path, path.name, InputError))
    missing = sorted(NEEDED - set(tree.attrs)) + sorted({"posterior"} - set(tree.children))
    if missing:
        raise InputError(
            sentence(
                "this is no posterior",
                got=f"no {', '.join(missing)}",
                do="give posterior.nc of `sunspin posterior`",
                where=str(path),
            )
        )
    return tree


def window(tree: Any) -> tuple[float, float]:
    """First and last sample (s from the epoch) of a posterior."""
    return float(tree.attrs["t_first_s"]) - 1e-6, float(tree.attrs["t_last_s"]) + 1e-6


def contributions(
    vehicle: Vehicle, telemetry: xr.Dataset, tree: Any, extra: dict[str, Reading] | None = None
) -> list[Line]:
    """The table: everything, without each sample and each panel, with each of `extra` (times after the first sample), with what
    is unknown taken as known."""
    unknown, data, state = best_state(vehicle, telemetry, tree)
    omega = state.omega[0]
    told = Information(unknown, data, state)

    def line(what: str, from_: Information = told, **options: Any) -> Line:
        spread = from_.covariance(**options)
        return Line(what, rate_volume(spread), speed_sigma(spread, omega))

    every, panels = np.arange(len(data)), np.arange(data.value.shape[1])
    table = [line("everything")]
    for i in every:
        lit = ", ".join(np.array(vehicle.panel_names)[data.lit[i]]) or "none"
        table.append(
            line(
                f"without the sample at {data.t_s[i]:.0f} s (lit: {lit})",
                samples=np.delete(every, i),
            )
        )
    table += [
        line(f"without panel {vehicle.panel_names[p]}", panels=np.delete(panels, p)) for p in panels
    ]
    table += [line(f"the first {n} samples", samples=every[:n]) for n in range(6, len(data), 4)]
    for name, observation in (extra or {}).items():
        table.append(
            line(f"with {name}", Information(unknown, replace(data, others=(observation,)), state))
        )
    table += [line(what, fixed=kinds) for what, kinds in FIXED.items()]
    return table


def philae_extras(vehicle: Vehicle, tree: Any) -> dict[str, Reading]:
    """The magnetometer's turn of 13 s before the collision, known to 2 s, as an angular speed; the same to 0.1 s; and a gyro."""
    from sunspin.philae.collision import SIGMA_PERIOD_S

    case = load_case(vehicle.name)
    period = float(case.published["romap_period_before"].value)
    t = float(
        window(tree)[1] - window(tree)[0]
    )  # the last sample: within two minutes of the collision
    rate = np.array([2 * np.pi / period])
    made = {}
    for sigma in (SIGMA_PERIOD_S, 0.1):
        name = f"the magnetometer's {period:g} s, known to {sigma:g} s"
        made[name] = AngularSpeed(t, rate, float(rate[0]) * sigma / period)
    made["a gyro at the last sample, 0.001 rad/s"] = GyroReading(t, np.zeros(3), 1e-3)
    made["a gyro at the first sample, 0.001 rad/s"] = GyroReading(0.0, np.zeros(3), 1e-3)
    return made


def text(table: list[Line]) -> list[str]:
    """The table as lines for a person: changes of log volume, and factors."""
    base = table[0]
    lines = [f"{'':52s} volume, (rad/s)^3   ln change   sigma of |omega|, rad/s"]
    for x in table:
        lines.append(
            f"{x.what:52s} {x.volume:18.3g}   {np.log(x.volume / base.volume):+9.2f}   {x.speed_sigma:.5f}"
        )
    return lines


@command
def main(arguments: list[str] | None = None) -> None:
    """Print what each observation contributes to a posterior written by `sunspin posterior`."""
    parser = argparse.ArgumentParser(
        prog="python -m sunspin.philae.contributions", description=main.__doc__
    )
    parser.add_argument("posterior", type=Path, help="posterior.nc of `sunspin posterior`")
    parser.add_argument("--vehicle", default="philae")
    parser.add_argument("--telemetry", type=Path, help="default: that of the built-in case")
    given = parser.parse_args(arguments)
    craft = load_vehicle(given.vehicle)
    samples = (
        load_case(given.vehicle).telemetry
        if given.telemetry is None
        else read_telemetry(given.telemetry, craft)
    )
    tree = read_posterior(given.posterior)
    extra = philae_extras(craft, tree) if given.vehicle == "philae" else {}
    print("\n".join(text(contributions(craft, samples, tree, extra))))


if __name__ == "__main__":
    sys.exit(main())

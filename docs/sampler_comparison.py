"""The posterior beside samplers that we did not write: python docs/sampler_comparison.py KIND TWIN ...

KIND is one of `known` (Philae; inertia, friction and wheel known), `cubesat` (3U, no wheel), `unknown` (Philae, everything
unknown) and `mirror` (a 1U with side panels only: a motion and its mirror image). Needs nautilus-sampler 1.0 and emcee 3.1, on
which sunspin does not depend. Prints what docs/posterior.md, "Other samplers", tells. Only the likelihood and the unknowns'
priors are shared: rates and direction are those at the first sample, where ours are at a reference of its own, and the direction
is mapped otherwise.

nautilus (nested importance sampling with neural networks) fills a box about each mode, `HALF` sigmas to every side along the
axes of the covariance of our draws, of which the box takes only its place and size. emcee (ensembles of walkers) starts from our
draws and runs on from them.
"""

import argparse
import time

import emcee
import numpy as np
from nautilus import Sampler
from scipy.special import logsumexp

import sunspin as ss
from sunspin.cases import load_case
from sunspin.estimate.posterior.brightness import brightness
from sunspin.estimate.posterior.data import readings
from sunspin.estimate.posterior.likelihood import Likelihood
from sunspin.estimate.posterior.model import State, model
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from validation.calibrate import make

HALF = 8.0
"""Sigmas from the mean to the faces of a box."""

LIVE, WANTED = 800, 3000
"""Live points and effective draws that nautilus is asked for."""

WALKERS, STEPS, BURNT = 120, 1500, 500

LOWEST = -1e6
"""In place of minus infinity, with which nautilus cannot train."""


def cubesat():
    """3U, no panel on -z; moments to 1 % and noise of 2 % of the largest panel."""
    faces = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1)}
    panels = [Panel(name, normal, 2.3 if "z" in name else 7.0) for name, normal in faces.items()]
    form = TelemetryForm(quantity="power_W", noise=0.14)
    return Vehicle(
        "3U",
        inertia_kg_m2=np.diag([0.042, 0.040, 0.009]),
        panels=panels,
        gain_unit="W",
        telemetry=form,
    )


def side_panels():
    """1U with panels on its four sides, which cannot tell a motion from its mirror image; noise of 2 %."""
    faces = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0)}
    form = TelemetryForm(quantity="current_A", noise=0.02)
    panels = [Panel(name, normal, 1.0) for name, normal in faces.items()]
    return Vehicle(
        "1U", inertia_kg_m2=np.diag([0.0022, 0.0024, 0.0019]), panels=panels, telemetry=form
    )


TWINS = {  # vehicle, kind of twin, largest rate (rad/s), samples, interval (s)
    "known": (lambda: load_case("philae").vehicle, "known", 0.25, 16, 20.0),
    "cubesat": (cubesat, "unknown", 0.3, 16, 12.0),
    "unknown": (lambda: load_case("philae").vehicle, "unknown", 0.25, 16, 20.0),
    "mirror": (side_panels, "unknown", 0.2, 20, 12.0),
}


class Place:
    """Straight coordinates about the mean of states (equal weights): rates, Lambert's equal-area map of the direction, u."""

    def __init__(self, state, scale=None):
        middle = state.sun.mean(axis=0)
        middle /= np.linalg.norm(middle)
        side = np.linalg.svd(middle[None])[2][1:]
        self.frame = np.stack([*side, middle])
        x = self.flat(state)
        self.mean = x.mean(axis=0)
        self.root = np.linalg.cholesky(np.cov(x.T) + 1e-16 * np.eye(x.shape[1]))

    def flat(self, state):
        across = state.sun @ self.frame.T
        stretch = np.sqrt(2.0 / np.maximum(1.0 + across[:, 2:], 1e-12))
        return np.concatenate([state.omega, stretch * across[:, :2], state.u], axis=1)

    def states(self, y):
        """States of coordinates (n, D) in sigmas, and which of them there are: the map ends at the antipode."""
        x = self.mean + y @ self.root.T
        square = np.sum(x[:, 3:5] ** 2, axis=1)
        there = square < 4.0
        square = np.minimum(square, 4.0)
        across = np.concatenate(
            [np.sqrt(1.0 - square / 4)[:, None] * x[:, 3:5], (1.0 - square / 2)[:, None]], axis=1
        )
        sun = across @ self.frame
        return State(x[:, :3], sun / np.linalg.norm(sun, axis=1, keepdims=True), x[:, 5:]), there

    @property
    def log_volume(self):
        """Of one unit of the coordinates."""
        return float(np.log(np.diag(self.root)).sum())


def log_posterior(likelihood, state, there):
    """Log prior and likelihood (n), `LOWEST` where there is nothing."""
    out = likelihood.model.log_prior(state)
    inside = np.flatnonzero(np.isfinite(out) & there)
    known = np.full(len(state), LOWEST)
    if len(inside):
        known[inside] = out[inside] + likelihood(state.take(inside))
    return np.where(np.isfinite(known), known, LOWEST)


def nested(log_density, dimensions, seed):
    """Log evidence over the unit cube, draws of equal weight in it, calls."""
    sampler = Sampler(
        lambda z: z,
        log_density,
        n_dim=dimensions,
        n_live=LIVE,
        vectorized=True,
        pass_dict=False,
        seed=seed,
        n_networks=1,
    )
    sampler.run(n_eff=WANTED, discard_exploration=True)
    points, weight, _ = sampler.posterior()
    share = np.exp(weight - logsumexp(weight))
    return (
        float(sampler.log_z),
        points[np.random.default_rng(seed).choice(len(points), 8000, p=share)],
        sampler.n_like,
    )


def in_box(likelihood, place):
    """As `nested`, in a box about a mode; draws are states."""
    d = len(place.mean)
    z, points, calls = nested(
        lambda p: log_posterior(likelihood, *place.states((2 * p - 1) * HALF)), d, 1
    )
    return (
        z + d * np.log(2 * HALF) + place.log_volume,
        place.states((2 * points - 1) * HALF)[0],
        calls,
    )


def walked(likelihood, place, state):
    """States that walkers reach from draws of ours, and the longest correlation time in steps."""
    rng = np.random.default_rng(2)
    begin = np.linalg.solve(place.root, (place.flat(state) - place.mean).T).T[
        rng.choice(len(state), WALKERS, replace=False)
    ]
    moves = [
        (emcee.moves.DEMove(), 0.8),
        (emcee.moves.DESnookerMove(), 0.1),
        (emcee.moves.StretchMove(), 0.1),
    ]
    sampler = emcee.EnsembleSampler(
        WALKERS,
        begin.shape[1],
        lambda y: log_posterior(likelihood, *place.states(y)),
        moves=moves,
        vectorize=True,
    )
    sampler.random_state = np.random.RandomState(3).get_state()
    sampler.run_mcmc(begin, STEPS)
    time_ = sampler.get_autocorr_time(discard=BURNT, quiet=True)
    return place.states(sampler.get_chain(discard=BURNT, flat=True, thin=10))[0], float(
        np.max(time_)
    )


def told(omega):
    """5, 50 and 95 % of the angular speed, and the sigmas of the rates, in 1e-3 rad/s."""
    speed = " ".join(
        f"{q:8.2f}" for q in 1e3 * np.quantile(np.linalg.norm(omega, axis=1), [0.05, 0.5, 0.95])
    )
    return f"|omega| {speed}; sigmas {' '.join(f'{s:6.3f}' for s in 1e3 * omega.std(axis=0))}"


def compare(kind, twin, walk):
    craft, drawn, max_rate, samples, interval = TWINS[kind]
    craft = craft()
    telemetry, _, _, priors = make(craft, drawn, max_rate, samples, interval, 0, twin)
    began = time.process_time()
    tree = ss.posterior(craft, telemetry, priors, seed=0, workers=1)
    print(
        f"{kind} {twin}: {tree.attrs['verdict']}; k {tree.attrs['pareto_k']:.2f}; {time.process_time() - began:.0f} s"
    )
    data, _, _ = readings(craft, telemetry)
    likelihood = Likelihood(model(craft, priors, brightness(craft, data))[0], data, 1e-6)
    draws, modes = tree["posterior"], tree["solutions"]
    state = State(
        draws["omega_B"].values[0], draws["sun_B"].values[0], in_sigmas(likelihood.model, draws)
    )
    wider = 3 * np.log(
        tree.attrs["searched_rate_rad_s"] / max_rate
    )  # ours are relative to the ball at the reference
    weight, evidence, of = (
        modes["probability"].values,
        modes["log_evidence"].values + wider,
        draws["solution_id"].values[0],
    )
    listed = np.flatnonzero(weight > 0.01)
    began = time.process_time()
    theirs = []
    for m in listed:
        own = state.take(of == m)
        place = Place(own)
        z, other, calls = in_box(likelihood, place)
        theirs.append(z)
        took = time.process_time() - began
        print(
            f"  mode {m}: log evidence ours {evidence[m]:.2f}, nautilus {z:.2f} ({calls} calls, {took:.0f} s)"
        )
        print(f"    ours     {told(own.omega)}\n    nautilus {told(other.omega)}", flush=True)
        if walk:
            other, long = walked(likelihood, place, own)
            print(f"    emcee    {told(other.omega)}; correlation {long:.0f} steps", flush=True)
    share = np.exp(np.array(theirs) - logsumexp(theirs))
    print(
        f"  weights ours {np.round(weight[listed], 3)}, nautilus {np.round(share, 3)}", flush=True
    )


def in_sigmas(model_, draws):
    """The further unknowns (n, k) of draws, in their prior's sigmas."""
    u = np.zeros((draws.sizes["draw"], len(model_.unknowns)))
    for i, x in enumerate(model_.unknowns):
        value = (
            draws["wheel_speed_rad_s"].values[0, :, x.index]
            if x.kind == "wheel_speed"
            else draws[x.name].values[0]
        )
        u[:, i] = (value - x.centre) / x.sigma
    return u


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("kind", choices=TWINS)
    parser.add_argument("twins", type=int, nargs="+")
    parser.add_argument("--walk", action="store_true", help="emcee too")
    given = parser.parse_args()
    for number in given.twins:
        compare(given.kind, number, given.walk)

"""The posterior against nautilus, a nested sampler that shares only the likelihood: python docs/sampler_comparison.py KIND TWIN ...

Needs nautilus-sampler, which sunspin does not depend on. Prints a row of the table in docs/posterior.md for each twin of KIND.
Nautilus samples a box about each region of the posterior, eight sigmas to every side, in the rates and the direction at the first
sample and all further unknowns; its evidences, regions together, and intervals do not know of modes, bends and weights here.
"""

import sys
import time

import numpy as np
from nautilus import Sampler
from scipy.special import logsumexp
from scipy.stats import norm

import sunspin as ss
from sunspin.cases import load_case
from sunspin.infer.posterior import brightness
from sunspin.infer.posterior_data import readings
from sunspin.infer.posterior_likelihood import Likelihood, moved
from sunspin.infer.posterior_model import State, model
from sunspin.infer.posterior_modes import coordinates
from sunspin.study.calibrate import make

MAX_RATE, SAMPLES, INTERVAL_S, HALF = 0.25, 16, 20.0, 8.0


def box(likelihood, tree, mode):
    """Log evidence in a box about a mode, equal draws of |omega|, and calls."""
    found = tree["posterior"]
    inside = found["mode_id"].values[0] == mode
    omega, sun = found["omega_B"].values[0][inside], found["sun_B"].values[0][inside]
    u = np.zeros((len(omega), len(likelihood.model.unknowns)))
    centre = State(omega.mean(axis=0)[None], (sun.mean(axis=0) / np.linalg.norm(sun.mean(axis=0)))[None], u[:1])
    x = coordinates(State(omega, sun, u), centre)[:, :5]
    root = np.linalg.cholesky(np.cov(x.T))

    def states(z):
        step = (2 * z[:, :5] - 1) * HALF @ root.T
        return State(centre.omega + step[:, :3], moved(np.repeat(centre.sun, len(z), 0), step[:, 3:]), norm.ppf(z[:, 5:]))

    def log_likelihood(z):
        state = states(z)
        angle = np.linalg.norm((2 * z[:, :5] - 1) * HALF @ root.T[:, 3:], axis=1)
        known = likelihood(state) + np.log(np.maximum(np.sinc(angle / np.pi), 1e-12))
        outside = np.linalg.norm(state.omega, axis=1) > likelihood.model.max_rate
        return np.where(outside | ~np.isfinite(known) | (angle > np.pi), -1e6, known)

    sampler = Sampler(lambda z: z, log_likelihood, n_dim=5 + u.shape[1], n_live=1000, vectorized=True, seed=1, pool=None)
    sampler.run(n_eff=2000, discard_exploration=True)
    points, weight, _ = sampler.posterior()
    picked = np.random.default_rng(0).choice(len(points), 4000, p=np.exp(weight - logsumexp(weight)))
    volume = 5 * np.log(2 * HALF) + np.log(np.diag(root)).sum()
    prior = -np.log(4 / 3 * np.pi * likelihood.model.max_rate**3) - np.log(4 * np.pi)
    return sampler.log_z + volume + prior, states(points[picked]).omega, sampler.n_like


def told(omega):
    size = np.linalg.norm(omega, axis=1)
    quantiles = " / ".join(f"{q:.4f}" for q in np.quantile(size, [0.05, 0.5, 0.95]))
    return f"{quantiles}; sigmas {', '.join(f'{s:.1e}' for s in omega.std(axis=0))}"


def compare(kind, twin):
    craft = load_case("philae").vehicle
    telemetry, _, _, priors = make(craft, kind, MAX_RATE, SAMPLES, INTERVAL_S, 0, twin)
    began = time.process_time()
    tree = ss.posterior(craft, telemetry, priors, seed=0, workers=1)
    ours = time.process_time() - began
    data, _, _ = readings(craft, telemetry)
    likelihood = Likelihood(model(craft, priors, brightness(craft, data))[0], data, 1e-6)
    began = time.process_time()
    weights = tree["modes"]["weight"].values
    found = [box(likelihood, tree, m) for m in np.flatnonzero(weights > 0.01)]
    evidence = np.array([z for z, _, _ in found])
    share = np.exp(evidence - logsumexp(evidence))
    ball = 3 * np.log(tree.attrs["searched_rate_rad_s"] / MAX_RATE)  # ours are relative to the ball at the reference
    draws = tree["posterior"]
    for m, (z, omega, calls) in enumerate(found):
        own = draws["omega_B"].values[0][draws["mode_id"].values[0] == m]
        told_here = tree["modes"]["log_evidence"].values[m] + ball
        print(f"{kind} {twin} mode {m}: weight {weights[m]:.3f} and {share[m]:.3f}; log evidence {told_here:.2f} and {z:.2f}")
        print(f"  {told(own)}\n  {told(omega)}\n  {calls} calls")
    theirs = time.process_time() - began
    print(f"  processor time {ours:.0f} s and {theirs:.0f} s, k {tree.attrs['pareto_k']:.2f}, {tree.attrs['verdict']}", flush=True)


for number in sys.argv[2:]:
    compare(sys.argv[1], int(number))

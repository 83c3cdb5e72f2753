"""The stated uncertainty of Sun directions over many vehicles: it covers, and the test detects wrong ones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, kstest

import sunspin as ss
from sunspin.telemetry.sun import is_reconstructed

NOISE, N = 1.5, 3000
PHILAE = ss.load_vehicle("philae")


def distances(assumed=PHILAE, noise=NOISE, offset=0.0, seed=0):
    """Squared distance (n) of the truth in the stated tangent covariance: chi-square of two degrees of freedom if all is right."""
    rng = np.random.default_rng(seed)
    sun = rng.normal(size=(N, 3))
    sun /= np.linalg.norm(sun, axis=1)[:, None]
    power = ss.panel_power(PHILAE, sun)
    power = power[clear := (power > 0).sum(axis=1) >= 3]
    power = np.where(power > 0, power + rng.normal(size=power.shape) * NOISE + offset, 0.0)
    enough = (
        np.where(power != 0, power, np.inf).min(axis=1) > 6 * NOISE
    )  # grazing panels are no longer linear
    found = ss.sun_directions(assumed, power, noise=noise, lit_threshold=3 * NOISE)
    use = is_reconstructed(found["status"]) & enough
    truth = sun[clear][use]
    told = found["sun_B"].values[use]
    covariance = found["sun_cov_B"].values[use]
    basis = np.linalg.svd(told[:, None, :])[2][:, 1:]
    tangent = np.einsum("nai,nij,nbj->nab", basis, covariance, basis)
    error = np.einsum("nai,ni->na", basis, truth - told)
    return np.einsum("na,nab,nb->n", error, np.linalg.inv(tangent), error)


def misfit(**change) -> float:
    """Kolmogorov's distance of the distances' distribution from the chi-square law."""
    return float(kstest(distances(**change), chi2(2).cdf).statistic)


def test_direction_covariance_covers_over_all_directions():
    found = distances()
    assert len(found) > 300
    for level in (0.5, 0.68, 0.95):
        held = np.mean(found < chi2(2).ppf(level))
        assert held == pytest.approx(level, abs=4 * np.sqrt(level * (1 - level) / len(found)))
    assert misfit() < 1.95 / np.sqrt(len(found))  # the 0.1 % point


def scaled(factor):
    panels = [
        replace(p, gain=p.gain * (factor if k == 2 else 1.0)) for k, p in enumerate(PHILAE.panels)
    ]
    return replace(PHILAE, panels=panels)


@pytest.mark.parametrize(
    "wrong",
    [
        {"noise": 1.3 * NOISE},
        {"noise": NOISE / 1.3},
        {"assumed": scaled(1.05)},
        {"offset": 2.0 * NOISE},
    ],
    ids=["noise too large", "noise too small", "a gain 5 % off", "an offset"],
)
def test_the_coverage_test_fails_if_the_model_is_wrong(wrong):
    assert misfit(**wrong) > 3.0 / np.sqrt(len(distances()))

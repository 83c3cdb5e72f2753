"""What a verdict owes to its priors: draws weighted anew against the known answer, and said where they cannot tell."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sunspin.estimate.posterior.model import Model, State
from sunspin.estimate.posterior.prior_widths import prior_sentences, prior_widths
from sunspin.estimate.posterior.verdict import Found
from sunspin.estimate.terms.term import Unknown

MODEL = Model(
    None,
    (Unknown("inertia_xx", "inertia", "1", 0.0, 1.0), Unknown("log_noise", "noise", "1", 0.0, 1.0)),
    1.0,
)  # type: ignore[arg-type]
N = 40_000


def found(weight):
    k = len(weight)
    return Found(
        np.array(weight),
        0.3 * np.arange(1, k + 1)[:, None] * [1.0, 0, 0],
        np.full(k, 0.01),
        np.ones(k),
        60.0,
        0.5,
        0.0,
        [],
        0.1,
        5000.0,
        [],
        0.3 * np.arange(1, k + 1),
    )


def drawn(sigma=1.0, centre=0.0, far=0.0) -> Any:
    """Draws from a wide proposal; the data say u = `centre` +- `sigma`, and a rate that goes with u by 0.01 rad/s. With `far`, a
    second region of that weight which only u near 2 prior sigmas allows."""
    rng = np.random.default_rng(4)
    u = rng.normal(0, 3, (N, 2))
    region = (rng.random(N) < 0.5 * (far > 0)).astype(int)
    middle = np.where(region == 1, 2.0, centre)
    log_likelihood = -0.5 * ((u[:, 0] - middle) / np.where(region == 1, 0.3, sigma)) ** 2
    log_likelihood += np.where(region == 1, np.log(far + 1e-9), 0)
    log_weight = -0.5 * (u**2).sum(axis=1) + log_likelihood + 0.5 * (u**2).sum(axis=1) / 9
    omega = np.stack(
        [0.3 + 0.3 * region + 0.01 * u[:, 0] + rng.normal(0, 0.001, N), 0 * u[:, 0], 0 * u[:, 0]],
        axis=1,
    )
    omega[:, 1:] += rng.normal(0, 0.001, (N, 2))
    return SimpleNamespace(state=State(omega, omega, u), log_weight=log_weight, region=region)


def told(drawn, of):
    return {(one["prior"], one["factor"]): one for one in prior_widths(MODEL, drawn, of)}


@pytest.mark.parametrize(("factor", "prior"), [(0.5, 0.5), (2.0, 2.0)])
def test_a_shift_and_a_width_are_those_of_the_product_of_two_normals(factor, prior):
    one = told(drawn(1.0, 1.0), found([1.0]))["inertia", factor]

    def product(width):
        return 1 / (1 + width**-2), (1 + width**-2) ** -0.5

    (mean, sigma), (new, then) = product(1.0), product(prior)
    small = np.hypot(0.01 * sigma, 0.001)
    assert one["told"] and one["word"] == "unique"
    assert one["shift"] == pytest.approx(abs(0.01 * (new - mean)) / small, rel=0.05)
    assert one["width"] == pytest.approx(np.hypot(0.01 * then, 0.001) / small, rel=0.03)


def test_a_verdict_that_hangs_on_a_prior_is_said():
    """A second region that the prior alone keeps down comes up when it is doubled."""
    draws = drawn(0.3, 0.0, far=0.05)
    share = [np.exp(draws.log_weight)[draws.region == k].sum() for k in range(2)]
    of = found(np.array(share) / np.sum(share))
    assert of.is_unique
    each = told(draws, of)
    assert each["inertia", 2.0]["word"] == "aliases" and each["inertia", 0.5]["word"] == "unique"
    assert each["noise", 2.0]["word"] == each["noise", 0.5]["word"] == "unique"
    words = " ".join(prior_sentences("unique", list(each.values())))
    assert 'the verdict changes with inertia doubled ("aliases")' in words
    assert "these draws do not reach so far: the verdict with max_rate_rad_s doubled" in words


def test_draws_that_cannot_tell_say_so():
    narrow = drawn()
    narrow.state.u[:, 0] *= (
        0.001  # all draws at the centre of the prior, as if the proposal had been this narrow
    )
    narrow.log_weight = np.where(np.arange(N) < 150, 0.0, -50.0)
    each = told(narrow, found([1.0]))
    assert not any(one["told"] for one in each.values())
    assert "inertia doubled" in prior_sentences("unique", list(each.values()))[0]

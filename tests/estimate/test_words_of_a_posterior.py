"""What a posterior says and lists: by the probabilities of solutions, the quality of the draws, and the predictive check."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sunspin.estimate.lander.mixture import FirstStates
from sunspin.estimate.lander.motions import Doubt
from sunspin.estimate.lander.tree import _listed, _proposed_covariance
from sunspin.estimate.lander.verdict import (
    PosteriorFindings,
    accused_panels,
    dark_stretch,
    posterior_words,
)
from sunspin.estimate.model import AS_STATED
from sunspin.estimate.posterior import _verdict_attributes

GOOD = PosteriorFindings(
    probability=np.array([1.0]),
    rate=np.array([[0.1, 0.0, 0.0]]),
    longest_sigma=np.array([1e-3]),
    speed=np.array([0.1]),
    interval_s=20.0,
    p_value=0.5,
    noise_sigmas=0.0,
    accused=[],
    pareto_k=0.1,
    effective=3000.0,
    doubts=[],
    dark="",
)
NONE_FITS = replace(GOOD, p_value=0.001, doubts=[Doubt("doubt", left_out=True)])


def aliases(*probability: float, apart: float = 0.1) -> PosteriorFindings:
    """Return findings of solutions with these probabilities, `apart` (rad/s) from one to the next along x."""
    count = len(probability)
    rate = np.stack([apart * np.arange(1, count + 1), np.zeros(count), np.zeros(count)], axis=1)
    lengths, speed = np.full(count, 1e-3), np.linalg.norm(rate, axis=1)
    share = np.array(probability)
    return replace(GOOD, probability=share, rate=rate, longest_sigma=lengths, speed=speed)


@pytest.mark.parametrize(
    ("findings", "word", "text"),
    [
        (GOOD, "unique", "a single solution, with an angular speed of 5.73 deg/s"),
        (aliases(0.995, 0.005), "unique", "a single solution"),
        (aliases(0.7, 0.3), "aliases", "2 aliases, 5.73 deg/s apart"),
        (aliases(0.985, 0.008, 0.007), "aliases", "98.5% of the probability, 2 others"),
        (aliases(0.985), "aliases", "has 98.5% of the probability"),
        (
            aliases(*[1 / 150] * 150, apart=1e-3),
            "aliases",
            "has 0.7% of the probability, 149 others",
        ),
        (replace(GOOD, longest_sigma=np.array([0.2])), "line", "a line of solutions over 23 deg/s"),
        (aliases(*[0.04] * 25, apart=1e-3), "line", "the data do not select one"),
        (replace(GOOD, p_value=0.001), "not explained", "residuals as large as these"),
        (replace(GOOD, p_value=0.001), "not explained", "(--wheel-mode, if a motor holds"),
        (
            replace(GOOD, noise_sigmas=4.0, noise_factor=3.32),
            "not explained",
            "far more than assumed (+4.0 sigma, 3.3 times)",
        ),
        (replace(GOOD, noise_sigmas=-4.0), "not explained", "far less than assumed"),
        (NONE_FITS, "not sure", "doubt; none of the solutions searched"),
        (replace(GOOD, doubts=[Doubt("a doubt")]), "not sure", "a doubt; result so far: unique"),
        (replace(GOOD, pareto_k=0.6), "not sure", "approximate"),
        (replace(GOOD, effective=600.0), "not sure", "effective sample size only 600"),
        (replace(GOOD, accused=["panel a: bad"]), "unique", "; panel a: bad"),
        (replace(GOOD, p_value=0.0, dark="no panel lit"), "not explained", "If this is an eclipse"),
        (replace(GOOD, pareto_k=0.6, dark="no panel lit"), "not sure", "If this is an eclipse"),
        (replace(NONE_FITS, dark="no panel lit"), "not sure", "If this is an eclipse"),
        (replace(GOOD, p_value=0.001, part="motions fit 9"), "not sure", "searched fits; motions"),
    ],
)
def test_word_and_sentence_follow_from_the_findings(findings, word, text):
    told, sentence = posterior_words(findings)
    assert told == word and text in sentence


def test_symmetric_solutions_are_named_unless_one_solution_is_unique():
    """They are fitted too: if one solution has all the probability, the others do not fit."""
    several, single = (replace(x, alike="3 symmetric ones") for x in (aliases(0.5, 0.5), GOOD))
    assert posterior_words(several)[1].endswith("; 3 symmetric ones")
    assert "symmetric" not in posterior_words(single)[1]


def test_a_panel_is_accused_for_three_outliers_that_are_much_of_its_readings():
    lit = np.ones((10, 2), dtype=bool)
    outliers = np.zeros((10, 2))
    outliers[:5, 0] = 0.95
    outliers[:2, 1] = 1.0
    (sentence,) = accused_panels(("a", "b"), outliers, lit)
    assert sentence.startswith("panel a: about 5 outliers")
    # as many of more readings are chance
    assert not accused_panels(
        ("a", "b"), np.vstack([outliers, np.zeros((5, 2))]), np.ones((15, 2), bool)
    )


def test_the_longest_stretch_without_light_is_named_from_three_samples_on():
    t_s = 10.0 * np.arange(8)
    lit = np.array([True, False, False, True, False, False, False, True])
    assert dark_stretch(t_s, lit) == "no panel lit from 40 to 60 s (3 samples)"
    assert dark_stretch(t_s, lit | (t_s == 50.0)) == ""


@pytest.mark.parametrize(
    ("share", "effective", "count"),
    [(0.005, 5.0, 1), (0.005, 11.0, 2), (0.02, 5.0, 2), (5e-5, 400.0, 1)],
)
def test_a_solution_of_few_draws_is_listed_only_with_a_large_probability(share, effective, count):
    """At least 1e-4; below 1 % it must rest on ten draws."""
    mix: Any = SimpleNamespace(
        share=np.array([1 - share, share]), effective=lambda region: (500.0, effective)[region]
    )
    assert _listed(mix) == count


def test_a_solution_with_too_few_draws_has_the_spread_of_the_proposal():
    """One draw alone would have a sigma of zero; where next to nothing was proposed, that of the prior is left."""
    omega = 0.02 * np.random.default_rng(0).standard_normal((3000, 3))
    none = np.zeros((3000, 0))
    mix: Any = SimpleNamespace(
        first_states=lambda index: FirstStates(omega[index], omega[index], none, none)
    )
    spread = _proposed_covariance(mix, np.arange(3000), np.array([0.01, 0.0, 0.0]), 0.5)
    expected = 0.02**2 * np.eye(3)
    expected[0, 0] += 0.01**2
    np.testing.assert_allclose(spread, expected, atol=3e-5)
    few = _proposed_covariance(mix, np.arange(9), np.zeros(3), 0.5)
    np.testing.assert_allclose(few, 0.25 * np.eye(3))


@pytest.mark.parametrize(
    ("p_value", "text"),
    [(0.5, "an alternative model fits better: a torque"), (0.0, "a torque that turns does not")],
)
def test_a_torque_under_which_nothing_fits_is_not_said_to_fit_better(p_value, text):
    fits = [SimpleNamespace(model=SimpleNamespace(what=what)) for what in (AS_STATED, "a torque")]
    draws = SimpleNamespace(log_evidence=0.0)
    mix: Any = SimpleNamespace(fits=fits, probability=np.array([0.0, 1.0]), draws=draws)
    window, words = SimpleNamespace(remarks=()), {"steady_torque": "turns"}
    nominal: Any = SimpleNamespace(window=window, prior_words=words)
    tree: Any = SimpleNamespace(attrs={"searched_rate_rad_s": 0.3})
    findings = replace(GOOD, p_value=p_value)
    assert text in _verdict_attributes(tree, mix, findings, nominal, np.zeros((1, 1)))["verdict"]

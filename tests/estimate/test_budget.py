"""The computing budget: limits, and values that are refused."""

import numpy as np
import pytest
from click.testing import CliRunner

import sunspin as ss
from sunspin.cli.rates import rates as command
from sunspin.estimate.budget import USUAL, Budget


def test_a_budget_that_is_spent_says_that_something_was_left_out():
    budget = Budget.of(2.0)
    budget.spend(USUAL)
    assert not budget.exhausted() and not budget.cut
    budget.spend(USUAL)
    assert budget.exhausted() and budget.cut
    assert Budget.of(np.inf).most == np.inf


@pytest.mark.parametrize("given", [0, -1, np.nan, True, "ten", None])
def test_an_effort_that_is_not_positive_is_refused(given):
    with pytest.raises(ss.InputError, match="effort must be a positive number"):
        Budget.of(given)


@pytest.mark.parametrize("given", ["0", "nan", "-3"])
def test_the_option_effort_refuses_what_is_not_positive(given):
    done = CliRunner().invoke(command, ["vehicle", "telemetry", "--effort", given])
    assert isinstance(done.exception, ss.InputError)
    assert "--effort must be a positive number or inf" in str(done.exception)

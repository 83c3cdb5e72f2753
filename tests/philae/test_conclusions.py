"""Conclusions from telemetry compared with its true motion, and negative controls."""

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.dynamics.batch import Rows
from sunspin.philae import candidates, data_check, touchdown
from sunspin.philae import rebound as rb
from validation import controls
from validation.controls import run_chain

CASE = ss.load_case("philae")


@pytest.fixture(scope="module")
def quick():
    """Fewer random orders of the descent's directions: its margin is a factor of hundreds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(data_check, "SHUFFLES", 3)
        yield


@pytest.fixture(scope="module")
def found(quick):
    """Each control once: name -> what the chain makes of it."""
    kept = {}

    def of(name):
        if name not in kept:
            kept[name] = run_chain(controls.CONTROLS[name](CASE))
        return kept[name]

    return of


def truth_of(omega, found):
    """Smaller and larger angle of the momentum (rad) and the speed at the touchdown of a known motion."""
    # what the panels show is some degrees away from it
    sun = np.array(rb.read_truth(CASE)["sun_B"])
    states = replace(found.chain.rebound.states(np.array([omega])), sun_B=sun[None])
    theta, alpha, _ = rb.momentum_angles(CASE.vehicle, states)
    back = ss.propagate(CASE.vehicle, omega, sun, 865.0, [0.0, -found.chain.rebound.lead_s])
    speed = float(np.linalg.norm(back["omega_B"].values[-1]))
    return min(theta[0], alpha[0]), max(theta[0], alpha[0]), speed


@pytest.mark.long
@pytest.mark.evidence("reproduce", "verified", "the true motions of simulated telemetry")
@pytest.mark.parametrize(
    ("name", "omega"),
    [
        ("as it is", None),
        ("never tumbled", controls.STILL),
        pytest.param("spins about z", (0.0, 0.0, 0.3), marks=pytest.mark.slow),
        pytest.param("another motion", controls.TUMBLING, marks=pytest.mark.slow),
    ],
)
def test_conclusions_from_telemetry_contain_the_truth(found, name, omega):
    one = found(name)
    assert one.check.consistent_with_sun and one.chain is not None, one.why
    chosen = one.chain.chosen
    small, large, speed = truth_of(
        np.array(rb.read_truth(CASE)["omega_B"] if omega is None else omega), one
    )
    for which, value in enumerate((small, large)):
        low, high = chosen.angle_range(which)
        assert low <= value <= high, (name, np.degrees([low, value, high]))
    assert one.chain.chosen.speed_range()[0] <= speed


@pytest.mark.long
def test_a_lander_that_never_tumbled_is_distinguished_from_one_that_did(found):
    """Its r_z is constant: the momentum lies along z or along the Sun; it may have stood still, and no upper bound follows."""
    still, tumbled = found("never tumbled"), found("another motion")
    small = [np.degrees(one.chain.chosen.angle_range(0)) for one in (still, tumbled)]
    # 7 of the 30 degrees are the coarse grid's cells
    assert small[0][0] < 3 and small[0][1] < 35 and small[1][1] > 60
    bounds = [one.chain.chosen.speed_range()[0] for one in (still, tumbled)]
    assert bounds[0] < 0.01 and bounds[1] > 0.07
    words = " ".join(touchdown.describe_motion(still.chain))
    assert "may have stood still" in words and f"is below {small[0][1]:.0f} degrees (90%)" in words
    assert "at least" in " ".join(touchdown.describe_motion(tumbled.chain))
    assert still.rows["lines_found"].ours == 0 and still.rows["lines_found"].agrees is False
    for one in (still, tumbled):
        assert one.rows["rate_at_touchdown_max"].informative is False
        assert "does not depend on the size" in one.rows["rate_at_touchdown_max"].note


def candidates_with_smaller_angle(low_deg, high_deg):
    """Two motions at the touchdown whose smaller angle of the momentum lies between these limits; the larger one is 150 degrees."""
    pair = np.zeros(2)
    return candidates.Candidates(
        source="mine.csv",
        about="two motions",
        states=Rows(np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 1))),
        speed_touchdown=pair,
        theta=np.radians([low_deg, high_deg]),
        alpha=np.radians([150.0, 150.0]),
        speed_collision=pair,
        sun_elevation=np.zeros((2, 2)),
        angle_cell_rad=0.0,
    )


@pytest.mark.parametrize(
    ("chosen_deg", "possible_deg", "words"),
    [
        ((30, 85), (0, 90), "is above 30 degrees (90%)"),
        ((0, 60), (0, 90), "is below 60 degrees (90%)"),
        ((30, 60), (0, 90), "is above 30 degrees and below 60 degrees (90%)"),
        ((0, 15), (0, 90), "is below 15 degrees (90%); the momentum lies within 15 degrees of z"),
        ((0, 85), (0, 90), "is hardly constrained"),
        # nothing smaller was possible before the data: no lower limit follows from them
        ((10, 60), (10, 90), "is below 60 degrees (90%)"),
        ((10.5, 85), (10, 90), "is hardly constrained"),
    ],
)
def test_a_limit_of_the_smaller_angle_is_what_the_data_exclude(chosen_deg, possible_deg, words):
    chosen, possible = (
        candidates_with_smaller_angle(*limits) for limits in (chosen_deg, possible_deg)
    )
    sets = candidates.CandidateSets(CASE, None, chosen, possible, possible, None, float("nan"))
    assert f"the smaller one {words}" in touchdown.describe_motion(sets)[0]


@pytest.mark.long
def test_readings_without_sunlight_give_no_conclusion(found):
    """Each panel shuffled in time, two columns exchanged: Delta and forbidden patterns catch it, and no conclusion is left."""
    for name in ("each panel shuffled", "panels 1 and 2 exchanged"):
        one = found(name)
        assert not one.check.consistent_with_sun and one.chain is None, name
        assert (
            "NOT CONSISTENT WITH SUNLIGHT" in one.check.first_line
            and "nothing can be concluded" in one.why
            or one.scan is None
        )
        assert any("lit pattern" in reason for reason in one.check.reasons)


@pytest.mark.parametrize(("first", "second"), [("1", "5"), ("2", "4"), ("3", "6")])
def test_an_exchange_of_any_two_panels_is_detected(first, second):
    case = rb.with_telemetry(CASE, controls.exchange_panels(CASE, first, second))
    sun = ss.sun_directions(case.vehicle, case.telemetry)
    assert not data_check.compute(case, sun, None).consistent_with_sun


def test_panel_misalignment_within_its_sigma_does_not_reject_a_file():
    """Six samples of this simulated file have patterns forbidden to panels as drawn, more than 2 %; with the stated sigmas one."""
    case = rb.with_telemetry(CASE, ss.twin("philae", seed=8))
    found = data_check.compute(case, ss.sun_directions(case.vehicle, case.telemetry), None)
    assert found.impossible > data_check.MOST_IMPOSSIBLE * found.early
    assert found.unexplained <= 1
    assert found.consistent_with_sun


@pytest.mark.long
def test_telemetry_that_no_motion_explains_is_refused(quick):
    """The Sun stands high at the first sample and low ever after, as in no free motion: the smallest EMD is far beyond noise."""
    data = controls.simulate_motion(CASE, controls.STILL)
    later = np.flatnonzero(data["phase"].values == "first_rebound")[1:]
    low = np.array([0.8, 0.5, 0.2])
    power = 0.02 * ss.panel_power(CASE.vehicle, low / np.linalg.norm(low))
    # with some noise: readings that repeat exactly are those of a frozen frame
    noisy = power * (1 + 1e-3 * np.random.default_rng(0).normal(size=(len(later), len(power))))
    data["power_W"].values[later] = np.where(power > 0, noisy, 0.0)
    one = run_chain(data, coarser=20)
    assert one.chain is None and "no motion of the model fits" in one.why


@pytest.mark.long
def test_candidates_are_read_from_a_table(tmp_path, quick):
    path = tmp_path / "mine.csv"
    path.write_text("omega_x,omega_y,omega_z\n0.1,0.2,0.1\n0.11,0.2,0.1\n", "utf-8")
    one = run_chain(source=str(path), coarser=20)
    assert one.chain.source == "mine.csv" and len(one.chain.chosen) == 2
    assert one.rows["rate_at_touchdown_bound"].chain == "mine.csv"
    for text, said in (
        ("a,b\n1,2\n", "columns omega_x"),
        ("omega_x,omega_y,omega_z\n1,x,2\n", "finite rates"),
        ("omega_x,omega_y,omega_z\n1,inf,2\n", "finite rates"),
    ):
        path.write_text(text, "utf-8")
        with pytest.raises(InputError, match=said):
            candidates.read_rates(path)
    with pytest.raises(InputError, match="there is no such file"):
        candidates.read_rates(tmp_path / "none.csv")


def test_without_a_calibration_there_is_no_conclusion(quick):
    one = run_chain(None, coarser=20, simulations=0)
    assert one.chain is None and "not calibrated for these data" in one.why

"""Where the paper contradicts itself: every known item has its row, with figures checked by hand or by other programs."""

import csv

import numpy as np
import pytest

from sunspin.cases import load_case
from sunspin.study import contradictions as co
from sunspin.study.row import STATEMENT

CASE = load_case("philae")


@pytest.fixture(scope="module")
def rows():
    return {row.id.removeprefix(STATEMENT): row for row in co.rows(co.compute(CASE))}


BY_HAND = {
    # sqrt(0.1918^2 + 0.6274^2 + 0.7071^2)
    "first_direction_length": (0.96458, 1e-5, False),
    "first_direction_twice": (5.99, 0.01, False),
    # 2.6811e-6 / 4.643e-4
    "mu_1": (0.0057745, 1e-7, False),
    # (1.0473e-3 + 2.693e-6 * 865), and 5.0 N m s instead
    "final_torque": (3.3767e-3, 1e-7, False),
    # over three legs of 1.594 m on average
    "final_force": (7.06e-4, 1e-6, False),
    # 6.5 h / 133
    "sampling_descent": (2.932, 1e-3, False),
    # 65 min / 17
    "sampling_after_collision": (3.824, 1e-3, False),
    # 15:34:03.98 less 15:20:30
    "descent_end": (13.566, 1e-2, False),
    "descent_start": (-10.5, 1e-9, False),
    # Table 1: 16:20:00 less 15:34:04
    "window": (45.93, 0.01, False),
    "kernel_times": (0.02, 1e-6, True),
    # 1 - 97.63 * 0.33^2 / 2 / 50
    "energy_absorbed": (89.37, 0.01, False),
    # (1271 + 0) exp(-4.643e-4 * 56) ... of a wheel begun at 865: a loss of 32 rad/s
    "wheel_speed_twice": (832.8, 0.1, False),
    "wheel_stop_printed": (43.26, 0.01, False),
    # 1.1e-3 - 1.0473e-3
    "study_mu_0": (5.27e-5, 1e-7, False),
    "path": (852.0, 1.0, False),
    "emd_names": (0.0, 1e-15, True),
    "round_mass": (97.63, 1e-9, True),
    # 2 arcsin sqrt(0.0028) = 6.07 degrees
    "two_errors": (6.07, 0.01, None),
}


@pytest.mark.parametrize("name", BY_HAND)
def test_by_hand(rows, name):
    value, tolerance, stands = BY_HAND[name]
    assert rows[name].ours == pytest.approx(value, abs=tolerance)
    assert rows[name].agrees is stands


def test_the_cubic_has_the_range_of_its_extremes(rows):
    """Its derivative 5.161e-8 - 6.378e-9 t + ... vanishes at 9324 s."""
    low, high = rows["cubic_range"].ours
    assert (low, high) == (pytest.approx(0.01201, abs=5e-6), pytest.approx(0.01239, abs=5e-6))
    assert "9324 s" in rows["cubic_range"].note and rows["cubic_range"].agrees is False


def test_the_aliases_tie(rows):
    assert rows["descent_alias"].ours == pytest.approx([-0.0402, 0.01216, 0.0645], abs=5e-5)
    assert float(rows["descent_alias"].note.split()[1]) < 1e-12


def test_the_swing_of_the_axis_at_the_printed_points(rows):
    """Twice (47.5, 46.9, 31.7, 31.6) degrees, found with another program."""
    assert rows["axis_swing"].ours == pytest.approx([95.0, 93.8, 63.4, 63.2], abs=0.3)
    assert "61, 61, 63, 63" in rows["axis_swing"].note


def test_rates_at_the_collision_exceed_the_published(rows):
    assert all(0.44 <= mean <= 0.59 for mean in rows["rate_at_collision"].ours)
    assert rows["rate_at_collision"].agrees is False and "0.304" in rows["rate_at_collision"].note


def test_the_leg_tip_speeds(rows):
    note = rows["speed_twice"].note
    assert all(text in note for text in ("0.559", "0.775", "1.025"))


def test_the_distances_of_figure_8_from_the_lines(rows):
    assert min(rows["study_lines"].ours) > 0.17 and rows["study_omega"].ours == pytest.approx([0, 0.02, 0])
    assert rows["study_theta"].ours == [12.603, 13.905]


def test_the_sign_of_friction(rows):
    wrong, right = rows["friction_sign"].published, rows["friction_sign"].ours
    assert right == pytest.approx(-0.582, abs=1e-3) and wrong == pytest.approx(-right, rel=1e-6)


def test_every_row_says_where_and_what_it_changes(rows):
    assert len(rows) >= 30
    for row in rows.values():
        assert row.note and row.source.startswith("paper, ") and row.what
    announced = ("promised_probability", "section_5", "own_section")
    assert all(name in rows for name in announced)


@pytest.mark.real_data
def test_the_speed_after_the_touchdown_is_that_of_the_kernel(data_dir):
    with open(data_dir / "philae_spk" / "philae_rebound_states.csv", encoding="utf-8") as file:
        first = next(csv.DictReader(file))
    speed = 1e3 * np.linalg.norm([float(first[key]) for key in ("vx_km_s", "vy_km_s", "vz_km_s")])
    assert speed == pytest.approx(CASE.published["trajectory_speed_after_touchdown"].value, abs=5e-4)

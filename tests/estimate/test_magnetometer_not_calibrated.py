"""Magnetometers of whose zero the file says nothing, in passes without an orbit, and the Earth's light beside them. Synthetic."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sunspin.estimate.alternatives import another_zero
from sunspin.estimate.budget import Budget
from sunspin.estimate.chain import fit
from sunspin.estimate.dense import residuals_by_sensor
from sunspin.estimate.evidence import best_cost, rescale_unknowns
from sunspin.estimate.field_led import prepare_fit
from sunspin.estimate.model import Body, Model, Noise, Track
from sunspin.estimate.observe import observe
from sunspin.estimate.one_pass import fit_tracks, search_motions
from sunspin.estimate.rates import rates
from sunspin.estimate.settings import RATES
from sunspin.estimate.terms.field import LARGEST_ZERO_SHARE, MATRIX_SIGMA, FieldChange
from sunspin.telemetry.assess import assess
from tests.support.orbit_cases import one_pass, pass_against_truth, rates_case

ANOTHER = "another zero offset of the magnetometer"


def pass_and_truth(seed: int, i: int, which: int):
    """Return vehicle, telemetry and true motion of a pass in orbit, whose elements nobody knows."""
    vehicle, data, _, truth, about = rates_case(seed, i)
    telemetry = one_pass(data, about["begin_s"][which])
    return vehicle, telemetry, truth


def nominal_model(vehicle, telemetry) -> Model:
    """Return the nominal model of all samples of a pass, with the unknowns that it has in `rates`."""
    obs = observe(assess(vehicle, telemetry)).obs
    return Model(obs.of_pass(np.arange(len(obs))), Body.of(vehicle), Noise(1e-4), 0.1)


def true_motion(truth, t_s) -> Track:
    """Return the true motion at times (n), in axes with z to the Sun."""
    there = truth.sel(time=t_s, method="nearest")
    sun = there["sun_N"].values[0]
    to_sun, _ = Rotation.align_vectors([sun], [[0.0, 0.0, 1.0]])
    attitude = Rotation.from_quat(there["B_from_N"].values) * to_sun
    return Track.unfitted(attitude.as_matrix()[None], there["omega_B"].values[None])


@pytest.fixture(scope="module")
def uncalibrated():
    """Return a pass whose magnetometer has a zero of a tenth of the field, which its file does not state."""
    return pass_and_truth(100, 1, 1)


def test_a_zero_of_which_the_file_says_nothing_is_an_alternative(uncalibrated):
    vehicle, telemetry, _ = uncalibrated
    nominal = nominal_model(vehicle, telemetry)
    (other,) = another_zero(nominal, RATES.alternatives)
    assert other.what == ANOTHER and other.log_prior == nominal.log_prior
    size = np.median(np.linalg.norm(telemetry["field_B"].values, axis=1))
    sizes = {unknown.kind: unknown.sigma for unknown in other.unknowns}
    assert sizes["field_zero"] == pytest.approx(LARGEST_ZERO_SHARE * size)
    assert sizes["field_matrix"] == MATRIX_SIGMA
    # a file that states a sigma has these unknowns already
    assert not list(another_zero(other, RATES.alternatives))


def test_unknowns_that_stand_elsewhere_in_another_model_keep_their_values(uncalibrated):
    vehicle, telemetry, _ = uncalibrated
    nominal = nominal_model(vehicle, telemetry)
    (other,) = another_zero(nominal, RATES.alternatives)
    u = np.arange(1.0, 1 + len(nominal.unknowns))[None]
    motions = Track(np.zeros((1, 1, 3, 3)), np.zeros((1, 1, 3)), u)
    there = rescale_unknowns(motions, nominal, other)
    by_name = dict(zip((x.name for x in other.unknowns), there.u[0].tolist(), strict=True))
    assert all(by_name[x.name] == pytest.approx(u[0, k]) for k, x in enumerate(nominal.unknowns))
    assert by_name["field_zero_0"] == 0.0 and len(by_name) == len(nominal.unknowns) + 12
    np.testing.assert_allclose(rescale_unknowns(there, other, nominal).u, u)


def test_a_magnetometer_fits_with_the_zero_that_the_alternative_estimates(uncalibrated):
    vehicle, telemetry, truth = uncalibrated
    nominal = nominal_model(vehicle, telemetry)
    (other,) = another_zero(nominal, RATES.alternatives)
    begin = prepare_fit(other, true_motion(truth, nominal.obs.t_s))
    motions = fit(other, begin, 30).motions
    kept = np.arange(len(nominal.obs))
    magnetometer = residuals_by_sensor(nominal.obs, other, motions, kept)["magnetometer"]
    assert np.nanmax(magnetometer) < 3.0
    field = next(k for k, x in enumerate(other.obs.terms) if isinstance(x, FieldChange))
    without = motions.u.copy()
    without[:, other.term_slices[field]][:, 6:9] = 0.0
    assert np.nanmax(magnetometer) < np.nanmax(
        residuals_by_sensor(nominal.obs, other, replace(motions, u=without), kept)["magnetometer"]
    )


@pytest.mark.slow
def test_a_pass_with_an_uncalibrated_magnetometer_is_decided_and_right(uncalibrated):
    """With its readings believed it was decided 7.7 sigma off."""
    vehicle, telemetry, truth = uncalibrated
    result = rates(vehicle, telemetry, column_tests=False)
    row = pass_against_truth(result, truth, 0)
    assert row["decided"] and np.abs(row["pulls"]).max() < 4
    assert result["model"].values[0] == ANOTHER


@pytest.mark.slow
def test_a_motion_that_is_lost_by_believing_an_uncalibrated_magnetometer_is_searched_again():
    """The search that believed it left an alias 12 deg/s off, which the alternative model decided."""
    vehicle, telemetry, truth = pass_and_truth(0, 2, 1)
    row = pass_against_truth(rates(vehicle, telemetry, column_tests=False), truth, 0)
    assert row["listed"] and not row["wrong"] and np.abs(row["pulls"]).max() < 4


@pytest.mark.long
def test_a_fit_ends_at_the_minimum_of_the_truth_under_the_earths_light():
    """The first guess of the light leads to a second minimum, which costs 11 more."""
    vehicle, telemetry, truth = pass_and_truth(11, 5, 0)
    nominal = nominal_model(vehicle, telemetry)
    tracks = search_motions(nominal, 1e-4, RATES.search, Budget.of(1.0))
    fits = fit_tracks(nominal, tracks, 1e-4, RATES)
    begin = prepare_fit(nominal, true_motion(truth, nominal.obs.t_s))
    of_truth = fit(nominal, begin, 30).motions.cost[0]
    of_same_torques = [x for x in fits if x.model.noise.acceleration == 1e-4]
    assert best_cost(of_same_torques) < of_truth + 1.0

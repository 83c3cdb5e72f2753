"""The descent: which samples are fitted, and the published cubic."""

import numpy as np
import pytest

import sunspin as ss
from sunspin.philae import descent
from tests.support.philae import AS_DRAWN, CASE, SUN, SUN_AS_DRAWN


@pytest.fixture(scope="module")
def result():
    return descent.compute(CASE, SUN)


def test_the_samples_of_the_fit_are_those_of_the_paper(result):
    """Samples 10 to 143 (paper, section 3.1), recognised by Delta, though the phases of the telemetry are not read."""
    assert result.number == (10, 143)
    for sun in (SUN_AS_DRAWN, SUN_AS_DRAWN.drop_vars("phase")):
        result = descent.compute(AS_DRAWN, sun)
        assert result.number == (10, 143)
    height = {row.id: row for row in descent.rows(result)}["nz_descent"]
    assert height.agrees
    low, high = CASE.published["delta_max"].value, CASE.published["delta_shadowed"].value[0]
    assert low < result.delta_limit < high * 1.01


@pytest.mark.parametrize("sigmas", [3.0, 6.0])
def test_the_choice_of_descent_samples_does_not_depend_on_its_threshold(sigmas, monkeypatch):
    monkeypatch.setattr(descent, "DELTA_SIGMAS", sigmas)
    assert descent.find_first_clean_sample(SUN_AS_DRAWN.isel(time=slice(0, 147)))[0] == 9


def test_telemetry_without_shadow_keeps_all_descent_samples():
    """Negative control: the same telemetry without its first nine samples, and with single outliers."""
    clean = SUN.isel(time=slice(9, 147))
    assert descent.find_first_clean_sample(clean)[0] == 0
    outlier = clean.copy(deep=True)
    outlier["delta"][{"time": [0, 40, 80]}] = 0.3
    outlier["status"][{"time": [0, 40, 80]}] = 0
    assert descent.find_first_clean_sample(outlier)[0] == 0


@pytest.mark.evidence(
    "reproduce", "validated", "the paper's fit of the descent, on synthetic telemetry"
)
def test_the_descent_fit_recovers_the_published_cubic(result):
    rows = {row.id: row for row in descent.rows(result)}
    assert rows["descent_rate_cubic"].agrees and rows["descent_unique"].agrees
    assert rows["descent_behind"].ours > 0.95
    assert rows["descent_rate_romap"].agrees
    assert "twenty seeds" in rows["descent_E"].note and rows["descent_E"].holds is True
    # PHYSICS, derived from the printed coefficients: 0.01201 to 0.01239, which is not the printed range
    low, high = result.rate_range(np.array(CASE.published["descent_rate_cubic"].value))
    assert (low, high) == (pytest.approx(0.01201, abs=6e-6), pytest.approx(0.01239, abs=6e-6))
    assert rows["descent_rate_range"].agrees is False


def test_telemetry_with_another_cubic_differs_from_the_published_one(result):
    """Negative control of the comparison: directions turned by a drift of 0.5 rad over the descent."""
    t = CASE.telemetry["time"].values - CASE.telemetry["time"].values[9]
    angle = 0.5 * np.clip(t / 23400.0, 0, None) ** 2
    moved, (x, y, z) = SUN.copy(deep=True), SUN["sun_B"].values.T
    drifted = (x + 1j * y) * np.exp(-1j * angle)
    moved["sun_B"].values[:] = np.stack([drifted.real, drifted.imag, z], axis=1)
    rows = {row.id: row for row in descent.rows(descent.compute(CASE, moved))}
    assert rows["descent_rate_cubic"].agrees is False


def test_the_descent_figure_states_that_the_telemetry_is_synthetic(result):
    assert "synthetic telemetry" in descent.descent_figure(result)._suptitle.get_text()
    real = result._replace(sun=result.sun.assign_attrs(synthetic=0))
    assert "synthetic" not in descent.descent_figure(real)._suptitle.get_text()


def test_telemetry_without_a_descent_is_refused():
    late = SUN.isel(time=slice(200, None))
    with pytest.raises(ss.SunspinError, match="no sample before the first touchdown"):
        descent.compute(CASE, late)

"""Periods found in a column: of noise alone hardly any, of light curves the rotation with its error and what it may be instead."""

import numpy as np
import pytest

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.telemetry.column_periods import describe_periods, read_column_periods
from sunspin.telemetry.periodicity import FALSE_ALARM, find_period, find_periods
from sunspin.vehicle.file import parse_vehicle
from tests.support.vehicles import SUN_VECTOR_FILE

TRUE_S = 47.0
SHORTEST_S = 15.0


def times(rng, count=60, span_s=1200.0):
    """Return uneven times (s)."""
    return np.sort(rng.uniform(0.0, span_s, count))


def light_curve(seed, noise=0.5, count=60):
    """Return times and a curve with two unequal flashes in a rotation, on a slow trend."""
    rng = np.random.default_rng(seed)
    t_s = times(rng, count)
    phase = 2 * np.pi * t_s / TRUE_S + rng.uniform(0, 2 * np.pi)
    value = 0.4 * np.sin(phase) + np.sin(2 * phase + 1) + 3e-6 * (t_s - 500.0) ** 2 - 90.0
    return t_s, value + noise * rng.normal(size=count)


def test_noise_alone_has_no_period_in_99_of_100():
    """White noise and noise that wanders, by turns."""
    found = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        t_s, noise = times(rng, 30), rng.normal(size=30)
        values = noise.cumsum() if seed % 2 else noise
        found += find_period(t_s, values, SHORTEST_S).found is not None
    assert found <= 1


def test_a_light_curve_with_a_strong_second_harmonic_has_the_period_of_its_rotation():
    normalised = []
    for seed in range(10):
        stretch = find_period(*light_curve(seed), SHORTEST_S)
        assert stretch.found is not None and stretch.false_alarm <= FALSE_ALARM
        every = stretch.found.every
        probabilities = [one.probability for one in every]
        assert sum(probabilities) == pytest.approx(1.0)
        assert probabilities == sorted(probabilities, reverse=True)
        near = [one for one in every if abs(one.period_s - TRUE_S) < 0.03 * TRUE_S]
        normalised.append((near[0].period_s - TRUE_S) / near[0].sigma_s)
    assert 0.6 < np.sqrt(np.mean(np.square(normalised))) < 1.5


def test_a_pure_sine_may_be_that_of_half_a_rotation():
    rng = np.random.default_rng(1)
    t_s = times(rng)
    value = np.sin(2 * np.pi * t_s / TRUE_S) + 0.3 * rng.normal(size=len(t_s))
    found = find_period(t_s, value, SHORTEST_S).found
    assert found.period_s == pytest.approx(TRUE_S, abs=4 * found.sigma_s)
    double = [one for one in found.aliases if abs(one.period_s - 2 * TRUE_S) < 4 * one.sigma_s]
    assert len(double) == 1 and 0.2 < double[0].probability < 0.45


def test_even_samples_leave_aliases_above_half_the_sampling_rate():
    rng = np.random.default_rng(2)
    t_s = 20.0 * np.arange(60)
    value = np.sin(2 * np.pi * t_s / 47.0) + 0.2 * rng.normal(size=60)
    found = find_period(t_s, value, 15.0).found
    alias = 1 / (1 / 20.0 - 1 / 47.0)
    assert any(abs(one.period_s - alias) < 4 * one.sigma_s for one in found.every)


@pytest.mark.parametrize("noise", [0.0, 0.02], ids=["exact", "clean"])
def test_a_clean_sine_is_listed_whatever_its_place_between_the_trial_frequencies(noise):
    """The peaks of clean readings are narrower than the steps of the trial frequencies."""
    rng = np.random.default_rng(3)
    for even in (True, True, False) if noise else (True, False):
        t = np.arange(60) * 10.0 if even else np.sort(rng.uniform(0, 600, 60))
        period = rng.uniform(60, 250)
        curve = np.sin(2 * np.pi * t / period + rng.uniform(0, 6)) + noise * rng.normal(size=60)
        found = find_period(t, curve, 6.28).found
        assert found is not None
        assert min(abs(one.period_s - period) for one in found.every) < 0.01 * period
        assert even or len(found.every) < 5


def test_stretches_between_gaps_are_searched_by_themselves():
    t_s, value = light_curve(3)
    gap = np.concatenate([t_s, t_s + 1e5, t_s[:5] + 2e5])
    noise = np.random.default_rng(0).normal(size=len(t_s))
    values = np.concatenate([value, noise, value[:5]])
    values[7] = np.nan
    order = np.random.default_rng(1).permutation(len(gap))
    first, second = find_periods(gap[order], values[order], SHORTEST_S)
    assert first.readings == 59 and first.found is not None and second.found is None
    assert first.found.t_s == pytest.approx((t_s[0] + t_s[-1]) / 2)
    # a column that does not change has no period, and eight readings are no stretch
    (one,) = find_periods(t_s, np.full(len(t_s), 7.0), SHORTEST_S)
    assert one.found is None and one.false_alarm == 1.0
    assert find_periods(t_s[:8], t_s[:8], SHORTEST_S) == []
    for shortest_s, words in ((0.0, "shortest period"), (1e-3, "too many periods")):
        with pytest.raises(InputError, match=words):
            find_periods(t_s, np.sin(t_s), shortest_s)


def test_columns_of_a_file_that_no_sensor_reads_are_read_and_have_periods(tmp_path):
    """A signal strength with a period and a column that is always the same; only the part that is used counts."""
    t_s, value = light_curve(3)
    rows = [f"{t:.3f},1,0,0,{v:.4f},7" for t, v in zip(t_s, value, strict=True)]
    path, craft = tmp_path / "telemetry.csv", parse_vehicle(SUN_VECTOR_FILE, "v.toml")
    path.write_text("\n".join(["time,sx,sy,sz,rssi,same", *rows]), "utf-8")
    data = ss.read_telemetry(path, craft, columns=["rssi"])
    assert data["column_reading"].dims == ("time", "column")
    assert np.allclose(data["column_reading"].values[:, 0], value, atol=1e-3)
    assert data.attrs["unused_columns"] == "same"
    with pytest.raises(ss.TelemetryError, match=r"'rsi'.* did you mean 'rssi'"):
        ss.read_telemetry(path, craft, columns=["rsi"])
    everything = -np.inf, np.inf
    found = read_column_periods(path, craft, ["rssi", "same"], 0.4, everything)
    lines = describe_periods(found, "{:.0f} s".format)
    assert " 47." in lines[0] and "(60 readings)" in lines[0]
    assert "no significant period" in lines[1] and "unchanged" in lines[1]
    none = read_column_periods(path, craft, ["rssi"], 0.4, (0.0, 100.0))
    assert "no stretch has enough readings" in describe_periods(none, str)[0]
    with pytest.raises(InputError, match="which the estimate uses already"):
        read_column_periods(path, craft, ["sx"], 0.4, everything)

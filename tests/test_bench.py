"""The benchmarks run, write what they say they write, and their contestants integrate the problem that sunspin integrates.

No time is tested here.
"""

import json

import numpy as np
import pytest

import sunspin as ss
from bench.__main__ import NAMES, benchmark, main
from bench.baselines import DormandPrince, TaylorBatch, TaylorScalar, fixed_body_stop_s
from bench.peak import TYPES, accumulators, burner, widths
from bench.problem import AXES, grid_sample, philae
from bench.scan import last_sun, reference_emd
from bench.table import Table
from bench.timing import Timing, medians

PHILAE = philae()
RATES = grid_sample(PHILAE.axes(51, 51, 21), 3)


@pytest.fixture(scope="module")
def reference() -> list:
    starts = PHILAE.starts(RATES)
    args = PHILAE.sun_B, PHILAE.wheel_speed_rad_s, [0.0, PHILAE.window_s]
    return [ss.propagate(PHILAE.vehicle, omega, *args) for omega in PHILAE.rates(starts)]


def test_the_cheap_ones_run_and_are_written_down(tmp_path, capsys):
    path = main(["--quick", "--only", "emd", "--json", str(tmp_path / "new" / "result.json")])
    result = json.loads(path.read_text("utf-8"))
    assert set(result) == {"machine", "quick", "seconds", "tables"}
    assert (
        result["quick"] is True
        and result["machine"]["cores"] >= 1
        and result["machine"]["libraries"]["numba"]
    )
    assert list(result["tables"]) == ["emd"]
    for table in result["tables"].values():
        assert table["rows"] and all(list(row) == table["columns"] for row in table["rows"])
    differences = [row["largest difference"] for row in result["tables"]["emd"]["rows"]]
    assert max(d for d in differences if d is not None) < 1e-9
    out, err = capsys.readouterr()
    assert "largest difference" in out and "bench: results" in err


@pytest.mark.parametrize("arguments", [["--only", "moon"], ["--fast"]])
def test_unknown_arguments_are_refused(arguments, capsys):
    with pytest.raises(SystemExit):
        main(arguments)
    assert "usage" in capsys.readouterr().err


def test_every_benchmark_is_there():
    assert all(callable(benchmark(name)) for name in NAMES)


@pytest.mark.parametrize(
    ("make", "rows", "error"),
    [
        (
            lambda problem: TaylorBatch(problem, 1e-9, 2),
            3,
            1e-4,
        ),  # two batches, the second not full
        (lambda problem: TaylorScalar(problem, 1e-9), 3, 1e-4),
        (lambda problem: DormandPrince(problem, 1e-6), 1, 1e-2),
    ],
    ids=["batch", "scalar", "scipy"],
)
def test_contestants_agree_with_the_reference(make, rows, error, reference):
    end = make(PHILAE)(PHILAE.starts(RATES)[:rows])
    stops = [run["event_time_s"].values for run in reference[:rows]]
    np.testing.assert_allclose(end.stop_s, np.concatenate(stops), atol=error)
    np.testing.assert_allclose(
        end.sun_B, [run["sun_B"].values[-1] for run in reference[:rows]], atol=error
    )


def test_the_wheel_stops_inside_the_window_and_its_stop_matters(reference):
    """A negative control: a contestant that let the wheel turn on would be found out."""
    assert fixed_body_stop_s(PHILAE) < PHILAE.window_s
    omega = reference[0]["omega_B"].values[0]
    start = PHILAE.starts(omega[None])
    batch = TaylorBatch(PHILAE, 1e-9, 1)
    batch.free.set_time(0.0)
    batch.free.state[:] = start.T
    batch.free.propagate_until(PHILAE.window_s)
    assert np.linalg.norm(batch.free.state[4:, 0] - last_sun(PHILAE, omega)) > 1e-2


def test_states_go_back_to_their_rates():
    back = PHILAE.rates(PHILAE.starts(RATES))
    np.testing.assert_allclose(back[np.lexsort(back.T)], RATES[np.lexsort(RATES.T)], atol=1e-12)


def test_the_distance_the_long_way_is_that_of_the_scan():
    scanned = PHILAE.scan(dict(zip(AXES, RATES[0][:, None], strict=True)), workers=1)
    assert abs(scanned.item() - reference_emd(PHILAE, RATES[0])) < 1e-3


@pytest.mark.parametrize("kind", TYPES)
def test_the_accumulators_compute_what_the_peak_counts(kind):
    """x = a x + b from x = (k + 1) b, in every lane of every accumulator: one of each is checked through their sum."""
    n, a, b = 7, 0.999, 0.001
    for bits in widths():
        burn, operations = burner(kind, bits)
        count = accumulators(bits)
        assert operations == 2 * count * bits // TYPES[kind][2]
        x = b * np.arange(1.0, count + 1)
        for _ in range(n):
            x = a * x + b
        assert burn(n) == pytest.approx(x.sum(), rel=1e-5)


def test_medians_take_turns_and_leave_out_the_warm_round():
    calls = []
    seconds = medians({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, 2)
    assert calls == ["a", "b"] * 3
    assert set(seconds) == {"a", "b"} and all(value >= 0 for value in seconds.values())


def test_ratios_are_taken_round_by_round():
    assert Timing([1.0, 9.0, 6.0]).against(Timing([2.0, 3.0, 2.0])) == 3.0
    assert Timing([1.0, 3.0], [2.0, 4.0]).cores_used == 1.5


def test_a_table_is_aligned_and_keeps_its_notes():
    table = Table("name", "title", ("what", "s"), notes=["note"])
    table.add("long word", 12345.6)
    table.add("x", None)
    assert table.text().splitlines() == [
        "name: title",
        "",
        "what            s",
        "---------  ------",
        "long word  12,346",
        "x               -",
        "",
        "note",
    ]
    assert table.row("x") == {"what": "x", "s": None}


def test_without_pot_its_rows_are_left_out_and_a_line_says_so(monkeypatch):
    monkeypatch.setattr("bench.emd._has_pot", lambda: False)
    table = benchmark("emd")(True)
    assert not any("POT" in row["by"] for row in table.rows)
    assert any("POT is not installed" in note for note in table.notes)

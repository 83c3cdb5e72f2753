"""Comparison of two results: each change relative to its error, the largest first."""

import json
from hashlib import sha256

import numpy as np
import pytest
from click.testing import CliRunner

import sunspin as ss
from sunspin.base.errors import InputError, SunspinError
from sunspin.cli.common import Group
from sunspin.output.folder import MANIFEST, MARKER


def write(path, summary):
    """The summary of a folder, and the manifest with its hash."""
    (path / "summary.json").write_text(summary)
    digests = {"summary.json": sha256(summary.encode()).hexdigest()}
    manifest = {"data": [], "figures": [], "tables": [], "sha256": digests}
    (path / MANIFEST).write_text(json.dumps(manifest))


def folder(path, command, /, **summary):
    path.mkdir()
    (path / MARKER).write_text(f"{command}\n")
    write(path, json.dumps(summary))
    return path


def pair(tmp_path, command, key, a, b):
    """Two results folders whose summaries differ in one entry."""
    return [folder(tmp_path / name, command, **{key: x}) for name, x in (("a", a), ("b", b))]


def entry(name, ours, low=None, high=None, agrees=None, **more):
    about = {"id": name, "what": f"what {name} is", "unit": "rad/s", "agrees": agrees}
    return about | {"ours": ours, "low": low, "high": high} | more


@pytest.fixture
def studies(tmp_path):
    a = [
        entry("far", 1.0, 0.9, 1.1, True),
        entry("near", 1.0, 0.9, 1.1),
        entry("pair", [1.0, 2.0], [0.5, 1.5], [1.5, 2.5]),
        entry("tolerated", 2.0, tolerance=0.5),
        entry("bare", 4.0),
        entry("input", 30.0, tolerance=1e-6, kind="put_in"),
        entry("rounded", 1.0),
        entry("text", "no"),
        entry("figure_3", "a.png"),
        entry("mine", 1.0),
    ]
    b = [
        entry("bare", 5.0),
        entry("far", 2.0, 1.7, 2.3, False),
        entry("near", 3.0, 0.91, 1.11),  # the value of few motions, outside of its interval
        entry("pair", [1.0, 3.5], [0.5, 3.0], [1.5, 4.0]),
        entry("tolerated", 2.1, tolerance=0.5),
        entry("input", 33.0, tolerance=1e-6, kind="put_in"),
        entry("rounded", 1.0 - 2e-16),
        entry("text", "yes"),
        entry("figure_3", "b.png"),
    ]
    inputs = [{"what": "telemetry", "sha256": "x"}]
    headlines = [
        ["It turned once in 8.6 min.", f"It fits {share}% of 2.5 or so.", "Same."]
        for share in (73, 58)
    ]
    second = {"headline": headlines[1], "changes": ["wheel.speed_rad_s = 833"]}
    return (
        folder(tmp_path / "a", "reproduce", figures=a, inputs=inputs, headline=headlines[0]),
        folder(tmp_path / "b", "reproduce", figures=b, inputs=inputs, **second),
    )


def test_entries_of_two_studies_are_compared_with_the_wider_interval(studies):
    data = ss.compare(*studies)
    size = dict(zip(data["row"].values.tolist(), data["size"].values, strict=True))
    known = {"far": 1.2 / 0.3, "pair": 1.5 / 0.5, "tolerated": 0.1 / 0.5, "near": 0.1}
    unknown = {"bare": 1 / 5, "input": 3 / 33, "rounded": 0.0, "text": 0.0}
    assert size == pytest.approx(known | unknown) and [*size] == [*known, *unknown]
    rows = data.set_index(row="row")
    changed = {"far", "pair", "bare", "input", "text"}
    assert {str(row) for row in data["row"].values[data["beyond"].values]} == changed
    assert rows.sel(row="far")["words"] == "agrees, now differs"
    assert rows.sel(row="far")["b"] == "2 (1.7 to 2.3)" and rows.sel(row="pair")["change"] == 1.5
    same = ss.compare(studies[0], studies[0])
    assert not same["beyond"].values.any() and not same["change"].values.any()


def test_a_comparison_is_printed_drawn_and_saved(studies, tmp_path):
    out = tmp_path / "out"
    run = CliRunner().invoke(Group("sunspin"), ["compare", *map(str, studies), "--out", str(out)])
    assert run.exit_code == 0
    assert "2 of 4 rows with a known error changed by more than it" in run.output
    assert "of 4 without one 3 changed; both are of the same telemetry" in run.output
    assert run.output.index("far:") < run.output.index("pair:") < run.output.index("bare:")
    assert "wheel.speed_rad_s = 833" in run.output and "alone: mine" in run.output
    assert run.output.count("concludes: It fits") == 2 and "8.6 min" not in run.output
    names = {"comparison.csv", "comparison.nc", "comparison.png", "summary.json"}
    assert names <= {path.name for path in out.iterdir()}
    numbers = json.loads((out / "summary.json").read_text())
    assert numbers["beyond"] == 2 and numbers["moved"][0]["row"] == "far"
    axes = ss.compare(*studies).sunspin.plot().axes[0]
    labels = [label.get_text().split()[1] for label in axes.get_yticklabels()]
    assert labels == ["far", "pair", "tolerated", "near"]


def a_pass(number, hour, rate, **more):
    solution = {f"omega_{axis}_deg_s": rate for axis in "xyz"}
    solution |= {f"sigma_{axis}_deg_s": 0.1 for axis in "xyz"}
    speeds = {"low": rate - 0.1645, "median": rate, "high": rate + 0.1645}
    solution |= {f"speed_{name}_deg_s": speed for name, speed in speeds.items()}
    solution["probability"] = 0.9
    utc = [f"2026-01-01T{hour:02d}:{minute:02d}:00.000Z" for minute in (0, 10)]
    row = {"pass_id": number, "utc_start": utc[0], "utc_end": utc[1], "utc_at": utc[0]}
    return row | {"decided": True, "columns_checked": "as_stated", "solutions": [solution]} | more


@pytest.mark.parametrize("command", ["rates", "posterior"])
def test_passes_that_overlap_are_compared_in_sigmas_of_both(tmp_path, command):
    """Of two passes within one of the other result the first is compared."""
    parts = [a_pass(2, 4, 1.5, decided=False, utc_at="2026-01-01T04:05:00.000Z"), a_pass(3, 4, 9.0)]
    a = [a_pass(0, 1, 1.0), a_pass(1, 2, 1.0), a_pass(2, 4, 1.0)]
    b = [a_pass(0, 2, 1.3), a_pass(1, 3, 9.0), *parts]
    data = ss.compare(*pair(tmp_path, command, "passes", a, b)).set_index(row="row")
    assert {name[:6] for name in data["row"].values} == {"pass 1", "pass 2"}
    assert not any("pass 2 omega" in name for name in data["row"].values)  # at another instant
    for name in ("omega_x at 2026-01-01T02:00:00.000Z", "speed"):
        assert data.sel(row=f"pass 1 {name}")["size"] == pytest.approx(0.3 / np.hypot(0.1, 0.1))
    assert data.sel(row="pass 1 speed")["a"] == "1.00 ± 0.10"
    assert data.sel(row="pass 2 speed")["b"] == "1.50 ± 0.10"
    assert data.sel(row="pass 2 probability")["words"] == "decided, now not decided"
    # the speed of a tumbling body changes over a pass: at another instant its range counts
    b[2]["speed_deg_s"], a[2]["speed_deg_s"] = [0.0, 1.0, 2.0], [0.5, 1.0, 1.5]
    (tmp_path / "range").mkdir()
    data = ss.compare(*pair(tmp_path / "range", command, "passes", a, b)).set_index(row="row")
    error = np.sqrt(0.1**2 + 1.0**2 + 0.1**2 + 0.5**2)
    assert data.sel(row="pass 2 speed")["size"] == pytest.approx(0.5 / error)


@pytest.mark.parametrize("decided", [True, False])
def test_a_new_likeliest_solution_does_not_change_an_undecided_pass(tmp_path, decided):
    """Two solutions 8 deg/s apart, each known to 0.1, whose probabilities of 0.5 and 0.4 change places."""
    slow, fast = (a_pass(0, 1, rate)["solutions"][0] for rate in (1.0, 9.0))
    lesser = {"probability": 0.4}
    passes = [
        [a_pass(0, 1, 0, decided=decided, solutions=[x | {"probability": 0.5}, y])]
        for x, y in ((slow, fast | lesser), (fast, slow | lesser))
    ]
    data = ss.compare(*pair(tmp_path, "rates", "passes", *passes)).set_index(row="row")
    for row in ("pass 0 omega_x at 2026-01-01T01:00:00.000Z", "pass 0 speed"):
        assert bool(data.sel(row=row)["beyond"]) is decided


def test_comparisons_of_outcomes_use_the_strategies_in_common(tmp_path):
    def strategies(value, *more):
        estimates = {"touch_leg": {"value": value, "error": 0.03}}
        estimates["rate_after"] = {"value": np.radians(10.0), "error": np.radians(0.5)}
        return dict.fromkeys(("off", *more), estimates)

    folders = pair(tmp_path, "outcomes", "strategies", strategies(0.8, "held"), strategies(0.6))
    data = ss.compare(*folders)
    assert data["row"].values.tolist() == ["wheels off touch_leg", "wheels off rate_after"]
    assert data["size"].values == pytest.approx([0.2 / (0.03 * 2**0.5), 0.0])
    assert data["a"].values[1] == "10.00 ± 0.50" and data["unit"].values[1] == "deg/s"
    assert data["what"].values[0] == "a leg touches first"
    assert "telemetry" not in str(data.sunspin.summary())


def test_results_with_nothing_in_common_are_refused(studies, tmp_path):
    rates = folder(tmp_path / "rates", "rates", passes=[a_pass(0, 1, 1.0)])
    others = folder(tmp_path / "others", "rates", passes=[a_pass(0, 9, 1.0)])
    simulated = folder(tmp_path / "simulated", "simulate")
    (tmp_path / "plain").mkdir()
    for a, b, words in (
        (studies[0], rates, "reproduce and rates.*two of reproduce or rates or"),
        (simulated, simulated, "only two results of one command"),
        (rates, tmp_path / "plain", "not a results folder|no such folder"),
        (rates, others, "nothing in common"),
    ):
        with pytest.raises(InputError, match=words):
            ss.compare(a, b)
    (tmp_path / "attitude.bc").touch()
    out = ["--out", str(tmp_path / "out")]
    for b, words in (("attitude.bc", "--frame is missing"), ("absent", "no such file or folder")):
        for more in ([], out) if b == "absent" else ([],):
            command = ["compare", str(studies[0]), str(tmp_path / b), *more]
            error = CliRunner().invoke(Group("sunspin"), command).exception
            assert isinstance(error, SunspinError) and words in str(error)
    for option in (["--frame", "B"], ["--base", "J2000"], ["--epoch", "2026-01-01"]):
        command = ["compare", str(rates), str(rates), *option]
        error = CliRunner().invoke(Group("sunspin"), command).exception
        assert f"{option[0]} belongs to kernels" in str(error)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["reproduce", "rates", "posterior", "outcomes"])
@pytest.mark.parametrize("key", ["strategies", "figures", "passes", "inputs", "changes"])
def test_summaries_of_any_content_are_compared_or_refused_in_one_sentence(tmp_path, command, key):
    estimate = {"off": {"touch_leg": {"value": "x", "error": 1e-300}}}
    damaged = [entry("x", 1e300, [[1], 2], 1, unit="\ud800", agrees=[])]
    lists = [[], [3], [{"id": 1}], [a_pass({}, 1, 1.0, solutions=[{"probability": "x"}])], damaged]
    for i, value in enumerate((None, 3, "x", True, {}, {"off": 3}, estimate, *lists)):
        a, b = (folder(tmp_path / f"{i}{side}", command, **{key: value}) for side in "ab")
        with pytest.raises(InputError, match="nothing in common|something else than") as error:
            ss.compare(a, b)
        assert str(error.value).isprintable()
    for text in ("", "{", "3", "[" * 100_000, "1" * 5000):
        write(a, text)
        with pytest.raises(InputError, match="something else than"):
            ss.compare(a, b)

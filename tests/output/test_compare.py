"""What moved between two results: each change against its error, the largest first."""

import json
import re

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import sunspin as ss
from sunspin.base.errors import InputError, SunspinError
from sunspin.cli.common import Group
from sunspin.output.compare import _pass as one_pass
from sunspin.output.folder import MARKER, write_netcdf


def folder(path, command, **summary):
    path.mkdir()
    (path / MARKER).write_text(f"{command}\n")
    (path / "summary.json").write_text(json.dumps(summary))
    return path


def row(name, ours, low=None, high=None, agrees=None, tolerance=None, **more):
    return {
        "id": name,
        "what": f"what {name} is",
        "ours": ours,
        "low": low,
        "high": high,
        "agrees": agrees,
        "unit": "rad/s",
        "tolerance": tolerance,
    } | more


@pytest.fixture
def studies(tmp_path):
    a = [
        row("far", 1.0, 0.9, 1.1, True),
        row("near", 1.0, 0.9, 1.1),
        row("pair", [1.0, 2.0], [0.5, 1.5], [1.5, 2.5]),
        row("tolerated", 2.0, tolerance=0.5),
        row("bare", 4.0),
        row("text", "no"),
        row("ends", 1.0, 0.0, 2.0),
        row("figure_3", "a.png"),
        row("mine", 1.0),
    ]
    b = [
        row("bare", 5.0),
        row("far", 2.0, 1.7, 2.3, False),
        row("near", 1.01, 0.91, 1.11),
        row("pair", [1.0, 3.5], [0.5, 3.0], [1.5, 4.0]),
        row("tolerated", 2.1, tolerance=0.5),
        row("text", "yes"),
        row("ends", 1.0, 0.0, 8.0),
        row("figure_3", "b.png"),
        row("theirs", 1.0),
    ]
    inputs = [{"what": "telemetry", "sha256": "x"}]
    return (
        folder(tmp_path / "a", "reproduce", figures=a, inputs=inputs),
        folder(
            tmp_path / "b",
            "reproduce",
            figures=b,
            inputs=inputs,
            changes=["wheel.speed_rad_s = 833"],
        ),
    )


def test_rows_of_the_study_against_the_wider_of_two_intervals(studies):
    found = ss.compare(*studies)
    size = dict(zip(found["row"].values.tolist(), found["size"].values, strict=True))
    assert size == pytest.approx(
        {
            "far": 1.2 / 0.3,
            "near": 0.1,
            "pair": 1.5 / 0.5,
            "tolerated": 0.2,
            "bare": 0.2,
            "text": 1e-9,
            "ends": 6 / 4,
        }
    )
    assert found["row"].values.tolist()[:3] == ["far", "pair", "ends"]
    assert set(found["row"].values[found["beyond"].values]) == {
        "far",
        "pair",
        "ends",
        "bare",
        "text",
    }
    assert (
        found.sel(row="far")["words"] == "agrees, now differs"
        and found.sel(row="far")["b"] == "2 (1.7 to 2.3)"
    )
    assert (
        found.attrs["same_telemetry"] == 1 and found.attrs["changes_b"] == "wheel.speed_rad_s = 833"
    )
    same = ss.compare(studies[0], studies[0])
    assert not same["beyond"].values.any() and not same["change"].values.any()


def test_a_value_outside_of_its_interval_scatters_by_more_than_the_interval_says(tmp_path):
    a = folder(
        tmp_path / "a",
        "reproduce",
        figures=[row("nearest", 0.38, 0.22, 0.25), row("held", 0.24, 0.22, 0.25)],
    )
    b = folder(
        tmp_path / "b",
        "reproduce",
        figures=[row("nearest", 0.17, 0.21, 0.24), row("held", 0.30, 0.28, 0.31)],
    )
    found = ss.compare(a, b)
    size = dict(zip(found["row"].values.tolist(), found["size"].values, strict=True))
    assert size == pytest.approx({"nearest": 0.01 / 0.015, "held": 0.06 / 0.015})


def test_it_is_printed_drawn_and_written(studies, tmp_path):
    ran = CliRunner().invoke(
        Group("sunspin"), ["compare", *map(str, studies), "--out", str(tmp_path / "out")]
    )
    assert (
        ran.exit_code == 0
        and "3 of 5 rows with a known error moved beyond it; of 2 without one 2 changed"
        in ran.output
    )
    assert ran.output.index("far:") < ran.output.index("pair:") < ran.output.index("bare:")
    assert {"comparison.csv", "comparison.nc", "comparison.png", "summary.json"} <= {
        p.name for p in (tmp_path / "out").iterdir()
    }
    told = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert told["beyond"] == 3 and told["moved"][0]["row"] == "far"
    axes = ss.compare(*studies).sunspin.plot().axes[0]
    assert [label.get_text().split()[1] for label in axes.get_yticklabels()] == [
        "far",
        "pair",
        "ends",
        "tolerated",
        "near",
    ]


def test_what_one_study_alone_has_or_concludes_is_said(tmp_path):
    """A part that does not fit changed assumptions leaves no row: its absence is a difference too."""
    told = [
        [f"It turned once in 8.6 min. It fits {share}% of 2.5 or so.", "Same."]
        for share in (73, 58)
    ]
    rows = [row("both", 1.0), row("sun_height", 2.0)], [row("both", 1.0)]
    a, b = (
        folder(tmp_path / name, "reproduce", figures=r, headline=t)
        for name, r, t in zip("ab", rows, told, strict=True)
    )
    lines = str(ss.compare(a, b).sunspin.summary())
    assert "alone has 1 rows: sun_height" in lines
    assert (
        "concludes: It fits 73% of 2.5 or so." in lines
        and "concludes: It fits 58%" in lines
        and "8.6 min" not in lines
    )


def test_what_differs_by_rounding_is_the_same(tmp_path):
    """Weights of passes, of which no error is known, are sums in another order where a run had other options."""
    made = [
        folder(tmp_path / name, "reproduce", figures=[row("share", share)])
        for name, share in (("a", 1.0), ("b", 1.0 - 2e-16))
    ]
    made.append(folder(tmp_path / "c", "reproduce", figures=[row("share", 1.0 - 1e-9)]))
    assert [ss.compare(made[0], other)["beyond"].values.tolist() for other in made[1:]] == [
        [False],
        [True],
    ]


def a_pass(number, start, x, sigma=0.1, **more):
    motion = {f"omega_{axis}_deg_s": x for axis in "xyz"} | {
        f"sigma_{axis}_deg_s": sigma for axis in "xyz"
    }
    motion |= {
        "speed_low_deg_s": x,
        "speed_median_deg_s": x + 0.1,
        "speed_high_deg_s": x + 0.2,
        "weight": 0.9,
    }
    utc = [f"2026-01-01T{start:02d}:{minute:02d}:00Z" for minute in (0, 10)]
    return {
        "pass_id": number,
        "utc_start": utc[0],
        "utc_end": utc[1],
        "utc_at": utc[0],
        "decided": True,
        "wiring": "as_stated",
        "modes": [motion],
    } | more


def test_passes_in_common_are_compared_in_sigmas_of_both(tmp_path):
    a = folder(
        tmp_path / "a", "rates", passes=[a_pass(0, 1, 1.0), a_pass(1, 2, 1.0), a_pass(2, 4, 1.0)]
    )
    later = a_pass(1, 3, 9.0), a_pass(2, 4, 1.5, decided=False, utc_at="2026-01-01T04:05:00Z")
    b = folder(tmp_path / "b", "rates", passes=[a_pass(0, 2, 1.3), *later])
    found = ss.compare(a, b)
    assert {name.rpartition(" ")[0] for name in found["row"].values} == {"pass 1", "pass 2"}
    assert found.sel(row="pass 1 omega_x")["size"] == pytest.approx(0.3 / np.hypot(0.1, 0.1))
    assert "pass 2 omega_x" not in found["row"].values  # given for another instant
    assert "decided yes, now no" in str(found.sel(row="pass 2 speed")["words"].values)
    assert found.sel(row="pass 1 speed")["a"] == "1.1 (1 to 1.2)"


@pytest.mark.parametrize(("decided", "beyond"), [(True, True), (False, False)])
def test_which_of_several_motions_is_likeliest_is_no_move(tmp_path, decided, beyond):
    """Two motions 8 deg/s apart, each known to 0.1, whose weights of 0.5 and 0.4 change places."""
    one, other = (a_pass(0, 1, x)["modes"][0] for x in (1.0, 9.0))
    folders = [
        folder(
            tmp_path / name,
            "rates",
            passes=[
                a_pass(
                    0,
                    1,
                    0.0,
                    decided=decided,
                    modes=[first | {"weight": 0.5}, second | {"weight": 0.4}],
                )
            ],
        )
        for name, first, second in (("a", one, other), ("b", other, one))
    ]
    found = ss.compare(*folders)
    assert {bool(found.sel(row=f"pass 0 {what}")["beyond"]) for what in ("omega_x", "speed")} == {
        beyond
    }


def test_a_figure_put_in_has_no_error_to_be_counted_in(tmp_path):
    figures = [[row("cone", value, tolerance=1e-6, kind="put_in")] for value in (30.0, 33.0)]
    a, b = (
        folder(tmp_path / name, "reproduce", figures=one)
        for name, one in zip("ab", figures, strict=True)
    )
    found = ss.compare(a, b).sel(row="cone")
    assert (
        not np.isfinite(found["error"])
        and found["size"] == pytest.approx(3 / 33)
        and found["beyond"]
    )


def test_medians_of_two_posteriors_in_sigmas(tmp_path):
    def made(name, shift, word):
        path = folder(tmp_path / name, "posterior", verdict_word=word)
        draws = np.random.default_rng(1).normal(size=(1, 4000, 3)) + [shift, 0, 0]
        group = xr.Dataset({"omega_B": (("chain", "draw", "axis"), draws, {"units": "rad s-1"})})
        write_netcdf(
            path / "posterior.nc", xr.DataTree.from_dict({"/": xr.Dataset(), "posterior": group})
        )
        return path

    found = ss.compare(made("a", 0.0, "unique"), made("b", 3.0, "aliases"))
    assert found["row"].values[0] == "omega_B_x" and found["size"].values[0] == pytest.approx(
        3 / np.sqrt(2), rel=0.05
    )
    assert (
        found["words"].values[0] == "verdict_word unique, now aliases"
        and not found["beyond"].values[1:].any()
    )


def test_shares_of_runs_of_the_strategies_in_common(tmp_path):
    def made(name, value, *more):
        told = {"touch_leg": {"value": value, "error": 0.03}, "up_z": {"value": 0.5, "error": 0.04}}
        told |= {"rate_after": {"value": np.radians(10.0), "error": np.radians(0.5)}}
        return folder(
            tmp_path / name, "outcomes", strategies=dict.fromkeys(("off", *more), told), inputs=[]
        )

    found = ss.compare(made("a", 0.8, "held"), made("b", 0.6))
    assert found["row"].values.tolist() == [
        "wheels off touch_leg",
        "wheels off up_z",
        "wheels off rate_after",
    ]
    rate = found.isel(row=2)
    assert (rate["a"].item(), rate["unit"].item()) == ("10", "deg/s")  # files have rad/s
    assert found["size"].values == pytest.approx([0.2 / (0.03 * 2**0.5), 0.0, 0.0])
    assert found["what"].values[0] == "a leg touches first"
    assert "telemetry" not in str(found.sunspin.summary())


def test_what_has_nothing_in_common_is_refused(studies, tmp_path):
    rates = folder(tmp_path / "rates", "rates", passes=[a_pass(0, 1, 1.0)])
    other = folder(tmp_path / "other", "rates", passes=[a_pass(0, 9, 1.0)])
    (tmp_path / "plain").mkdir()
    for b, words in ((rates, "different commands"), (tmp_path / "plain", "no results folder")):
        with pytest.raises(InputError, match=words):
            ss.compare(studies[0], b)
    with pytest.raises(InputError, match="nothing in common"):
        ss.compare(rates, other)
    with pytest.raises(InputError, match="cannot be compared"):
        ss.compare(*[folder(tmp_path / name, "simulate") for name in ("s", "t")])
    (other / "summary.json").write_text("{")
    with pytest.raises(InputError, match="summary cannot be read"):
        ss.compare(rates, other)
    (tmp_path / "attitude.bc").touch()
    for b, words in (
        (tmp_path / "attitude.bc", "--frame is missing"),
        ("absent.bc", "no such file"),
    ):
        told = CliRunner().invoke(Group("sunspin"), ["compare", str(studies[0]), str(b)])
        assert isinstance(told.exception, SunspinError) and words in str(told.exception)


def test_a_folder_that_is_not_there_is_said_to_be_missing(studies, tmp_path):
    for more in ([], ["--out", str(tmp_path / "moved")]):
        done = CliRunner().invoke(
            Group("sunspin"), ["compare", str(studies[0]), str(tmp_path / "nowhere"), *more]
        )
        assert (
            "there is no such file or folder" in str(done.exception)
            and not (tmp_path / "moved").exists()
        )


ODD = (
    None,
    3,
    -1.5,
    "x",
    [],
    [3],
    {},
    {"off": 3},
    {"off": {"touch_leg": 3}},
    {"off": {"touch_leg": {"value": "x"}}},
    [{"id": 1}],
    [{"modes": [3]}],
    [{"modes": [{"weight": "x"}]}],
    True,
)
"""Values that an entry of a summary may have when somebody has changed it."""


@pytest.mark.parametrize("command", ["reproduce", "rates", "outcomes"])
@pytest.mark.parametrize("key", ["strategies", "figures", "passes", "inputs", "changes"])
def test_summaries_of_any_content_end_in_a_sentence(tmp_path, command, key):
    for i, value in enumerate(ODD):
        pair = [folder(tmp_path / f"{i}{side}", command, **{key: value}) for side in "ab"]
        try:
            assert not ss.compare(*pair)["beyond"].values.any()  # two of the same
        except InputError as error:
            assert (
                re.search("nothing in common|something else than", str(error))
                and str(error).isprintable()
            )


def test_a_time_with_other_decimals_is_the_same_time():
    """Versions before this wrote 58.200000 where this one writes 58.200: their rates are compared at that instant all the same."""
    old, new = (a_pass(1, 3, 9.0, utc_at=f"2026-01-01T04:05:58.200{more}Z") for more in ("000", ""))
    assert all("utc_at" not in str(moved) for moved in one_pass(old, new))
    assert any("omega_x" in moved.name for moved in one_pass(old, new))

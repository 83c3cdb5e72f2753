"""`rates --period COLUMN` finds the period itself and says what it found; passes that do not fit are given in short windows."""

import json
from datetime import datetime

import numpy as np
import pytest
from click.testing import CliRunner

from sunspin.base.errors import SunspinError
from sunspin.cli import cli
from sunspin.estimate import rates as estimation
from sunspin.output.template import write_templates

pytestmark = pytest.mark.usefixtures("framed")

PERIOD_S = 61.0
QUICK = "--workers", "1", "--effort", "0.1"


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Return a folder with the template, whose telemetry has a light curve and a column of noise too."""
    monkeypatch.chdir(tmp_path)
    write_templates(tmp_path)
    rng, lines = np.random.default_rng(0), []
    for line in (tmp_path / "telemetry.csv").read_text("utf-8").splitlines():
        if line.startswith("#"):
            lines.append(line)
        elif line.startswith("time"):
            lines.append(f"{line},light,noise")
        else:
            t_s = datetime.fromisoformat(line.split(",")[0]).timestamp()
            light = np.sin(2 * np.pi * t_s / PERIOD_S) + 0.2 * rng.normal()
            lines.append(f"{line},{light:.4f},{rng.normal():.4f}")
    (tmp_path / "telemetry.csv").write_text("\n".join(lines) + "\n", "utf-8")
    return tmp_path


def run(*options):
    """Run `rates` on the template."""
    return CliRunner().invoke(cli, ["rates", "vehicle.toml", "telemetry.csv", *options])


def test_periods_of_columns_are_printed_and_weigh_solutions(place):
    done = run(
        "--period",
        "light",
        "--period",
        "noise",
        *QUICK,
        "--out",
        "out",
    )
    assert done.exit_code == 0, done.output
    (light,) = [line for line in done.stdout.splitlines() if "column light" in line]
    (noise,) = [line for line in done.stdout.splitlines() if "column noise" in line]
    assert "(40 readings): period" in light and " 61" in light and "in noise alone" in light
    assert "no significant period" in noise and "unchanged" in noise
    summary = json.loads((place / "out" / "summary.json").read_text("utf-8"))
    # the column with a period weighs, the other does not
    assert len(summary["periods"]) == 1


REFUSED = [("lihgt", "did you mean 'light'"), ("px", "which the estimate uses already")]
REFUSED += [("13+-x@100", "--period")]


@pytest.mark.parametrize(("column", "words"), REFUSED)
def test_a_column_that_cannot_be_used_is_refused(place, column, words):
    done = run("--period", column)
    assert isinstance(done.exception, SunspinError) and words in str(done.exception)


def test_a_pass_that_does_not_fit_is_written_in_windows(place, monkeypatch):
    estimate = estimation.rates

    made = []

    def without_fit(*arguments, **options):  # the second command asks for the same estimate
        if not made:
            result = estimate(*arguments, **options)
            made.append(result.assign(fits=("pass_id", [False] * result.sizes["pass_id"])))
        return made[0]

    monkeypatch.setattr(estimation, "rates", without_fit)
    done = run(*QUICK, "--no-column-tests", "--out", "out")
    assert done.exit_code == 0, done.output
    assert "the rate is estimated in short windows" in done.stderr
    assert "windows.csv has the rate in" in done.stdout
    rows = (place / "out" / "windows.csv").read_text("utf-8").splitlines()
    assert rows[0].startswith("pass_id,time_s,utc,begin_s") and len(rows) > 4
    summary = json.loads((place / "out" / "summary.json").read_text("utf-8"))
    assert [one["samples"] for one in summary["windows"]] and summary["controlled"] == []
    assert (place / "out" / "windows.png").exists()
    page = CliRunner().invoke(cli, ["report", "out"])
    assert page.exit_code == 0, page.output
    (html,) = (place / "out").glob("*.html")
    assert "Rate in short windows" in html.read_text("utf-8")
    again = run(*QUICK, "--no-column-tests", "--no-windows", "--out", "none")
    assert again.exit_code == 0 and not (place / "none" / "windows.csv").exists()

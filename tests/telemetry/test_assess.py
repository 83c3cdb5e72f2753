"""Telemetry is assessed once: a command asks each question about a file a single time."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from click.testing import CliRunner

import sunspin as ss
from sunspin.cli.check import check
from sunspin.cli.init import init
from sunspin.cli.rates import rates
from sunspin.cli.sun import sun
from sunspin.telemetry import assess as module
from sunspin.telemetry.assess import Assessment, assess
from sunspin.telemetry.signals import signals
from tests.support.orbit_cases import with_few_copies
from validation.spinners import cases, make

QUESTIONS = ("judge_readings", "sun_directions", "panel_unit", "panel_health", "wrong_units")


@pytest.fixture
def asked(monkeypatch) -> Counter:
    """How often each question was asked about each file: vehicle and readings."""
    counts: Counter = Counter()

    def counted(name, ask):
        def question(vehicle, telemetry, *arguments, **options):
            values = telemetry if isinstance(telemetry, np.ndarray) else signals(telemetry)
            normals = vehicle.panel_normals_B.tobytes()
            counts[name, vehicle.input_names, normals, values.tobytes()] += 1
            return ask(vehicle, telemetry, *arguments, **options)

        return question

    for name in QUESTIONS:
        monkeypatch.setattr(module, name, counted(name, getattr(module, name)))
    return counts


@pytest.fixture
def files(tmp_path):
    """The template of `sunspin init`."""
    assert CliRunner().invoke(init, [str(tmp_path / "cube")]).exit_code == 0
    return tmp_path / "cube" / "vehicle.toml", tmp_path / "cube" / "telemetry.csv"


@pytest.mark.parametrize("command", [check, sun, rates], ids=lambda command: command.name)
def test_a_command_asks_each_question_about_a_file_once(command, files, asked, tmp_path, undrawn):
    out = [] if command is check else ["--out", str(tmp_path / "out")]
    few = ["--to", "120", "--effort", "0.1"] if command is rates else []
    done = CliRunner().invoke(command, [*map(str, files), "--quiet", *out, *few])
    assert done.exit_code == 0, done.output
    assert asked and max(asked.values()) == 1, asked.most_common(3)


@pytest.mark.long
@pytest.mark.parametrize("command", [check, rates], ids=lambda command: command.name)
def test_a_command_with_elements_asks_each_question_about_a_file_once(
    command, tmp_path, asked, monkeypatch
):
    with_few_copies(monkeypatch, 3)
    make(cases(7, 4)[3], tmp_path)
    files = [str(tmp_path / name) for name in ("vehicle.toml", "telemetry.csv")]
    done = CliRunner().invoke(command, [*files, "--tle", str(tmp_path / "right.tle"), "--quiet"])
    assert done.exit_code == 0, done.output
    assert asked and max(asked.values()) == 1, asked.most_common(3)


def test_an_assessment_is_kept_for_its_vehicle_and_made_again_for_another(files):
    vehicle = ss.load_vehicle(files[0])
    telemetry = ss.read_telemetry(files[1], vehicle)
    assessment = assess(vehicle, telemetry)
    assert assess(vehicle, assessment) is assessment
    other = assess(ss.load_vehicle(files[0]), assessment)
    assert isinstance(other, Assessment) and other is not assessment
    assert other.telemetry is telemetry
    assert ss.panel_quality(vehicle, telemetry).identical(assessment.quality)

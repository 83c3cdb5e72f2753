"""A refused command leaves no files and prints one sentence."""

import os
import subprocess
import sys

import click
import pytest
from click.testing import CliRunner

from sunspin.base.errors import InputError
from sunspin.cli import cli
from sunspin.cli.common import COMMANDS
from sunspin.output import folder as folders
from sunspin.output.template import write_templates
from sunspin.philae import reproduction
from tests.support import commands

PLAIN = "vehicle.toml telemetry.csv"
RATE = "--omega-deg-s 1,0,2 --sun 1,0,0 --duration 60"

RUNS = {
    **dict.fromkeys(("sun", "calibrate-sensors", "rates", "posterior"), PLAIN),
    "export": "run --epoch 2026-01-01T00:00:00Z",
    **{"compare": "run run", "history": "run", "pointing": "run"},
    "plan": "vehicle.toml --every 10 --samples 6 --passes 1",
    "simulate": f"vehicle.toml {RATE}",
    "scan": f"{PLAIN} --to 160 --omega-x-deg-s=-6:6:6 --omega-y-deg-s=-6:6:6 --omega-z-deg-s=0:6:6",
    "outcomes": "philae --runs 10 --omega-deg-s 6,0,12",
    **{"reproduce": "", "decode": "frames"},
}
"""A right run of each command with --out, in a folder with example files, a results folder and raw frames."""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    place = tmp_path_factory.mktemp("refused")
    write_templates(place)
    (place / "frames").mkdir()
    (place / "frames" / "1498677480_OM3KAA_x").write_bytes(bytes(18) + b"\x63\x01\x02")
    back = os.getcwd()
    os.chdir(place)
    done = CliRunner().invoke(cli, ["simulate", "vehicle.toml", *RATE.split(), "--out", "run"])
    yield place
    os.chdir(back)
    assert done.exit_code == 0


def test_the_refused_runs_cover_every_command_with_a_results_folder():
    with_out = set()
    for name in COMMANDS:
        command = cli.get_command(click.Context(cli), name)
        if any("--out" in parameter.opts for parameter in command.params):
            with_out.add(name)
    assert with_out == set(RUNS)


@pytest.mark.parametrize("name", RUNS)
def test_a_refused_run_leaves_no_empty_folder(place, name, monkeypatch):
    claim, asked = folders.results_folder, []

    def refuse(path, command):
        asked.append(claim(path, command))
        raise InputError("refused after the folder was claimed")

    monkeypatch.setattr(folders, "results_folder", refuse)
    monkeypatch.setattr(reproduction, "results_folder", refuse)
    before = sorted(path.name for path in place.iterdir())
    done = CliRunner().invoke(cli, [name, *RUNS[name].split(), "--out", "deep/results"])
    assert "refused after" in str(done.exception) and asked
    assert sorted(path.name for path in place.iterdir()) == before

    (place / "empty").mkdir()  # a folder that was there stays, as it was
    done = CliRunner().invoke(cli, [name, *RUNS[name].split(), "--out", "empty"])
    assert "refused after" in str(done.exception) and not list((place / "empty").iterdir())
    (place / "empty").rmdir()


def test_a_refused_run_keeps_earlier_results(place):
    held = sorted(path.name for path in (place / "run").iterdir())
    bad = ["simulate", "vehicle.toml", "--omega-deg-s", "1,0,2", "--sun", "1,0,0"]
    done = CliRunner().invoke(cli, [*bad, "--duration", "1e15", "--out", "run"])
    assert done.exit_code != 0 and sorted(p.name for p in (place / "run").iterdir()) == held


def test_decode_refuses_a_file_without_a_readable_frame(place):
    (place / "notes").mkdir()
    (place / "notes" / "readme.txt").write_text("no frame")
    done = commands.sunspin("decode", "notes", "--out", "decoded", code=2)
    assert not (place / "decoded").exists()
    assert "none of 1 frames can be read" in done.err and "receive time" in done.err
    # the advice: a name with the receive time
    (place / "notes" / "readme.txt").unlink()
    (place / "notes" / "1498677480_OM3KAA").write_bytes(bytes(18) + b"\x63\x01\x02")
    commands.sunspin("decode", "notes", "--out", "decoded")


def test_names_of_a_hundred_characters_print_no_warning_of_matplotlib(place):
    text = (place / "vehicle.toml").read_text()
    for k, name in enumerate(("+X", "-X", "+Y", "-Y", "+Z")):
        text = text.replace(f'"{name}"', f'"{"p" * 98}{k:02d}"')
    (place / "long.toml").write_text(text)
    # the program mutes warnings of libraries; as errors they would end it
    clean = os.environ | {"PYTHONWARNINGS": "error::UserWarning"}
    run = [
        sys.executable,
        "-m",
        "sunspin.cli",
        "sun",
        "long.toml",
        "telemetry.csv",
        "--out",
        "long",
    ]
    done = subprocess.run(run, capture_output=True, text=True, check=False, env=clean)
    assert done.returncode == 0 and done.stderr == ""


def test_commands_show_no_warning_of_a_library(place):
    code = "import sys, warnings\nimport sunspin.output.template as t\n"
    code += "t.write_templates = lambda folder: warnings.warn('for programmers') or [1, 2]\n"
    code += "sys.argv = ['sunspin', 'init', 'new']\nfrom sunspin.cli import main\nmain()"
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONWARNINGS"}
    run = [sys.executable, "-c", code]
    done = subprocess.run(run, capture_output=True, text=True, check=False, env=clean)
    assert done.returncode == 0 and done.stderr == ""
    asked = clean | {"PYTHONWARNINGS": "always"}  # somebody wants them
    done = subprocess.run(run, capture_output=True, text=True, check=False, env=asked)
    assert "for programmers" in done.stderr

"""What earlier versions accepted is refused in a sentence that names it and what to do instead; nothing is written."""

import subprocess
import sys

import pytest

import sunspin as ss
from sunspin.cli import gone

NEEDED = {
    "--interpolate": ("scan",),
    "--device": ("scan", "posterior"),
    "--data": ("reproduce",),
    "--best-delay": ("outcomes",),
    "--noise": ("rates",),
    "--no-wirings": ("rates",),
    "--printed-lines": ("outcomes",),
    "--omega": ("simulate", "outcomes"),
    "--omega-x": ("scan",),
    "--omega-y": ("scan",),
    "--omega-z": ("scan",),
    "--rate": ("posterior",),
    "--gyro": ("posterior",),
    "--max-rate": ("rates",),
}
"""Option -> commands that had it."""


def run(folder, *arguments):
    return subprocess.run(
        [sys.executable, "-m", "sunspin.cli", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
    )


@pytest.mark.parametrize("option", gone.OPTIONS)
def test_an_option_that_is_gone_is_named(option, tmp_path):
    for command in NEEDED[option]:
        case = [] if command == "reproduce" else ["philae", "philae"]
        done = run(tmp_path, command, *case, option, "1", "--out", "results")
        assert done.returncode == 2 and gone.OPTIONS[option] in done.stderr, done.stderr
        assert done.stderr.count("\n") == 1 and not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", gone.COMMANDS)
def test_a_command_that_is_gone_is_named(command, tmp_path):
    done = run(tmp_path, command, "philae", "philae")
    assert done.returncode == 2 and gone.COMMANDS[command] in done.stderr


@pytest.mark.parametrize("name", ss._GONE)
def test_a_name_that_is_gone_is_named(name):
    with pytest.raises(AttributeError) as raised:
        getattr(ss, name)
    assert str(raised.value) == ss._GONE[name]

"""What earlier versions accepted is refused in a sentence that names it and what to do instead; nothing is written."""

import pytest
from test_cli import sunspin

import sunspin as ss
from sunspin.cli.common import GONE_COMMANDS, GONE_OPTIONS

NEEDED = {
    "--interpolate": ("scan",),
    "--device": ("scan", "posterior"),
    "--data": ("reproduce",),
    "--best-delay": ("outcomes",),
    "--noise": ("rates",),
    "--no-wirings": ("rates",),
    "--printed-lines": ("outcomes",),
    "--omega": ("simulate", "outcomes"),
    "--rate": ("posterior",),
    "--gyro": ("posterior",),
    "--max-rate": ("rates",),
} | dict.fromkeys(("--omega-x", "--omega-y", "--omega-z"), ("scan",))
"""Option -> commands that had it."""


@pytest.mark.parametrize("option", GONE_OPTIONS)
def test_an_option_that_is_gone_is_named(option, tmp_path):
    for command in NEEDED[option]:
        case = [] if command == "reproduce" else ["philae", "philae"]
        done = sunspin(command, *case, option, "1", "--out", "results", cwd=tmp_path, code=2)
        assert GONE_OPTIONS[option] in done.err and done.err.count("\n") == 1
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", GONE_COMMANDS)
def test_a_command_that_is_gone_is_named(command):
    assert GONE_COMMANDS[command] in sunspin(command, "philae", "philae", code=2).err


@pytest.mark.parametrize("name", ss._GONE)
def test_a_name_that_is_gone_is_named(name):
    with pytest.raises(AttributeError) as raised:
        getattr(ss, name)
    assert str(raised.value) == ss._GONE[name]

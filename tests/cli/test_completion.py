"""Completion on Tab for each shell."""

import os
import subprocess
import sys

import pytest


def program(**environment: str) -> str:
    command = [sys.executable, "-c", "from sunspin.cli import main; main()"]
    options = {"capture_output": True, "text": True, "timeout": 60}
    return subprocess.run(command, env=os.environ | environment, **options).stdout


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_offered_for_each_shell(shell):
    text = program(_SUNSPIN_COMPLETE=f"{shell}_source")
    assert "_SUNSPIN_COMPLETE" in text


@pytest.mark.parametrize(
    ("words", "expected"), [("sunspin sim", "simulate"), ("sunspin export --format a", "aem-xml")]
)
def test_completion_offers_commands_and_choices(words, expected):
    text = program(
        _SUNSPIN_COMPLETE="bash_complete", COMP_WORDS=words, COMP_CWORD=str(len(words.split()) - 1)
    )
    assert expected in text

"""The help of the commands, whose examples are parsed and the cheap ones run; completion on Tab; answers to unknown names."""

import os
import re
import shlex
import subprocess
import sys

import click
import pytest
from click.testing import CliRunner

import sunspin as ss
from sunspin.cli import cli
from sunspin.cli.common import COMMANDS
from tests.support.commands import sunspin

ELSEWHERE = {
    "rates": "minutes, or other people's data; the documents run it",
    "decode": "other people's data",
    "compare": "other people's kernels",
    "reproduce": "minutes; it has tests of its own",
    "posterior": "minutes; it has tests of its own",
    "pointing": "the rates of its example take seconds; it has tests of its own",
    "plan": "a minute; it has tests of its own",
    "history": "the rates of its example take seconds; it has tests of its own",
    "report": "needs the results of another command; it has tests of its own",
}
SMALLER = {"--runs": "100"} | {f"--omega-{axis}-deg-s": "-6:6:6" for axis in "xyz"}
"""Options that say how much is computed, and what stands in their place when an example is run: the same lines are printed."""


def examples(name: str) -> list[list[str]]:
    """The words of each example of a command's help."""
    command = cli.get_command(click.Context(cli), name)
    text = re.split(r"Examples?\b", command.help or "")[-1]
    return [
        shlex.split(line)[1:] for line in text.splitlines() if line.strip().startswith("sunspin ")
    ]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_example_of_the_help_is_parsed(name):
    """Parsed as the command line would, without running: names of options, choices, ranges, number of arguments."""
    given = examples(name)
    assert any(words[0] == name for words in given)
    for words in given:
        command = cli.get_command(click.Context(cli), words[0])
        command.make_context(words[0], words[1:], resilient_parsing=False)


def smaller(words: list[str]) -> list[str]:
    """An example as it stands but for its size, whichever way an option is joined to its value; grids are always given."""
    joined = [word.split("=", 1) if word.split("=")[0] in SMALLER else [word] for word in words]
    words = [part for parts in joined for part in parts]
    words = [SMALLER.get(before, word) for before, word in zip(["", *words], words, strict=False)]
    grids = [f"{name}={size}" for name, size in SMALLER.items() if name not in ("--runs", *words)]
    return words + (grids if words[0] == "scan" else [])


@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in ELSEWHERE])
def test_cheap_examples_of_the_help_run_in_the_folder_of_init(name, undrawn, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runner = CliRunner()
    if name != "init":
        assert runner.invoke(cli, ["init", "."]).exit_code == 0
    for words in examples(name):
        done = runner.invoke(cli, smaller(words), catch_exceptions=False)
        assert done.exit_code == 0, done.output


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_has_a_help_text(name):
    """And every command has the options --json and --quiet."""
    command = cli.get_command(click.Context(cli), name)
    options = [one for one in command.params if isinstance(one, click.Option)]
    assert not [option.name for option in options if not option.help]
    assert {"as_json", "quiet"} <= {option.name for option in command.params}


def test_the_help_describes_every_command_in_one_line():
    text = CliRunner().invoke(cli, ["--help"]).output
    assert all(re.search(rf"^  {name} ", text, re.MULTILINE) for name in COMMANDS)
    assert all(len(line) < 80 for _, line in COMMANDS.values())


def test_the_name_of_a_case_can_replace_its_telemetry_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(cli, ["sun", "philae", "philae", "--json"], catch_exceptions=False)
    assert '"synthetic_telemetry": true' in done.output
    (tmp_path / "philae").write_text("time_utc\n")  # a file of that name goes first
    assert CliRunner().invoke(cli, ["sun", "philae", "philae"]).exit_code != 0


def program(**environment: str) -> str:
    command = [sys.executable, "-c", "from sunspin.cli import main; main()"]
    options = {"capture_output": True, "text": True, "timeout": 60}
    return subprocess.run(command, env=os.environ | environment, **options).stdout


@pytest.mark.parametrize(
    ("words", "expected"), [("sunspin sim", "simulate"), ("sunspin export --format a", "aem-xml")]
)
def test_completion_offers_commands_and_choices(words, expected):
    text = program(
        _SUNSPIN_COMPLETE="bash_complete", COMP_WORDS=words, COMP_CWORD=str(len(words.split()) - 1)
    )
    assert expected in text


def test_an_unknown_command_option_or_name_is_answered_with_the_nearest_one(tmp_path):
    assert "did you mean rates" in sunspin("ratse", cwd=tmp_path, code=2).err
    done = sunspin("rates", "v.toml", "t.csv", "--max-rate", "1", cwd=tmp_path, code=2)
    assert "--max-rate-deg-s" in done.err and done.err.count("\n") == 1
    said = "no attribute 'posteriors'; did you mean 'posterior'?"
    with pytest.raises(AttributeError, match=said):
        _ = ss.posteriors
    with pytest.raises(AttributeError, match="no attribute 'xyzzy'$"):
        _ = ss.xyzzy

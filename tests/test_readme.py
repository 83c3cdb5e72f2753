"""The README does what it says: its Python block prints what it shows, its commands run."""

import contextlib
import io
import re
import shlex
from pathlib import Path

from click.testing import CliRunner

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text("utf-8")


def test_python_blocks_print_what_is_shown():
    pairs = re.findall(r"```python\n(.*?)```\s*```text\n(.*?)```", README, re.DOTALL)
    assert pairs
    for code, expected in pairs:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(code, "README.md", "exec"), {})  # our own file
        assert printed.getvalue() == expected


def test_the_satellite_commands_run_as_written(tmp_path, monkeypatch):
    from sunspin.cli import cli

    section = README.split("## Your satellite")[1].split("Real telemetry")[0].replace("\\\n", " ")
    commands = [line.split("#")[0].strip() for line in section.splitlines() if line.startswith("    ")]
    assert len(commands) == 8
    monkeypatch.chdir(tmp_path)
    for command in commands:
        words = shlex.split(command)
        if words[0] == "cd":
            monkeypatch.chdir(words[1])
            continue
        result = CliRunner().invoke(cli, words[1:], catch_exceptions=False)
        assert result.exit_code == 0, result.output


def test_links_lead_somewhere():
    for link in re.findall(r"\]\(([^)]+)\)", README):
        assert (ROOT / link).exists(), link

"""Code blocks of the documents, run as a reader would: one folder and one Python session to a page, blocks in their order.

- ``python``: executed; a ``text`` block right after it is what it prints.
- ``console``: lines that begin with ``$`` are commands; what stands below a command, if anything, is what it prints. `sunspin` runs
  in this process (its start would cost more than its work), `cd` changes the folder, everything else goes to a shell.
- ``toml``, ``csv`` whose first line is ``# file: NAME``: written to that file.

In what is printed, ``...`` stands for anything, within a line or for lines. A block that cannot run here says so in the line
above it, in a comment that readers of the page do not see: ``<!-- not run: reason -->``. A block below ``<!-- long -->`` or
``<!-- slow -->`` runs with the tests of that mark only.
"""

from __future__ import annotations

import contextlib
import doctest
import io
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

from click.testing import CliRunner

ROOT = Path(__file__).parents[2]
WRITTEN = {"believe.md", "cli.md", "examples.md", "variables.md"}
"""Pages that the build of the site writes."""

NOT_RUN = re.compile(r"<!-- not run: .{10,} -->")
MARKS = {"<!-- long -->": "long", "<!-- slow -->": "slow"}
LANGUAGES = {"python", "console", "text", "toml", "csv", "html"}


class Block(NamedTuple):
    language: str
    text: str
    line: int
    skipped: bool
    mark: str
    printed: str | None


def pages() -> list[Path]:
    """Return all documents but those that the build of the site writes."""
    written = {ROOT / "docs" / name for name in WRITTEN}
    paths = {*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")} - written
    return sorted(path for path in paths if "build" not in path.parts)


def blocks(text: str) -> list[Block]:
    """The fenced blocks of a page; directives such as ``{toctree}`` are not code."""
    found: list[Block] = []
    lines = text.splitlines()
    at, above, after = 0, "", False
    while at < len(lines):
        fence = re.match(r"(`{3,}|:{3,})(\S*)", lines[at])
        if not fence:
            above, after = (lines[at].strip(), False) if lines[at].strip() else (above, after)
            at += 1
            continue
        end = next(k for k in range(at + 1, len(lines)) if lines[k].strip() == fence[1])
        body = "\n".join(lines[at + 1 : end]) + "\n"
        if fence[2] == "text" and after:
            found[-1] = found[-1]._replace(printed=body)
        elif not fence[2].startswith("{"):
            skipped, mark = bool(NOT_RUN.search(above)), MARKS.get(above, "")
            found.append(Block(fence[2], body, at + 1, skipped, mark, None))
        after, above = fence[2] == "python", ""
        at = end + 1
    return found


class Reader:
    """Somebody who follows a page in a folder."""

    def __init__(self, page: Path, folder: Path) -> None:
        self.page, self.folder, self.names = page, folder, {"__name__": "__main__"}

    def follow(self, block: Block) -> None:
        if block.language == "python":
            self._same(self._python(block), block.printed, block.line)
        elif block.language == "console":
            for command, printed in commands(block.text):
                self._same(self._command(command), printed, block.line)
        elif block.language in ("toml", "csv"):
            if name := re.match(r"# file: (\S+)\n", block.text):
                (self.folder / name[1]).write_text(block.text, "utf-8")

    def _same(self, got: str, want: str | None, line: int) -> None:
        if want is not None:
            same = doctest.OutputChecker().check_output(want, got, doctest.ELLIPSIS)
            assert same, f"{self.page.name}, block at line {line}: printed\n{got}"

    def _python(self, block: Block) -> str:
        printed, code = io.StringIO(), "\n" * block.line + block.text
        with contextlib.redirect_stdout(printed), contextlib.chdir(self.folder):
            exec(compile(code, str(self.page), "exec"), self.names)  # our own file
        return printed.getvalue()

    def _command(self, command: str) -> str:
        words = shlex.split(command, comments=True)
        if words[0] == "cd":
            self.folder = self.folder / words[1]
            return ""
        if words[0] == "sunspin":
            from sunspin.cli import cli

            with contextlib.chdir(self.folder):
                how: dict[str, Any] = {"prog_name": "sunspin", "terminal_width": 100}
                done = CliRunner().invoke(cli, words[1:], catch_exceptions=False, **how)
            assert done.exit_code == 0, f"{self.page.name}: {command}\n{done.output}"
            return done.stdout
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
        env, kept = os.environ | {"PATH": path}, {"capture_output": True, "text": True}
        ran = subprocess.run(command, shell=True, cwd=self.folder, env=env, **kept)
        assert ran.returncode == 0, f"{self.page.name}: {command}\n{ran.stdout}{ran.stderr}"
        return ran.stdout


def commands(text: str) -> list[tuple[str, str | None]]:
    """The commands of a console block, each with what is shown below it, or None."""
    found: list[tuple[str, str | None]] = []
    for line in text.replace("\\\n", " ").splitlines():
        if line.startswith("$ "):
            found.append((line[2:], None))
        elif found and line:
            command, printed = found[-1]
            found[-1] = (command, (printed or "") + line + "\n")
    return found

"""The page "Evidence": the evidence that the tests declare, with the figures that they reached.

A test declares what it is evidence for by ``@pytest.mark.evidence(capability, kind, against)`` and records figures by the
fixture ``reached`` (tests/support/evidence.py). The declarations are read from the tests' text, so that none is lost where a
test was not run; outcomes and figures come from the file that a run of the tests has written.
"""

from __future__ import annotations

import ast
import inspect
import json
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]

KINDS = {
    "validated": "compared with an external source: the paper, published values, real telemetry or another library",
    "verified": "compared with mathematics: invariants, closed forms, order of accuracy, or a second method of sunspin",
    "modelled": "compared with sunspin itself only: synthetic data of its own model, or a repetition",
}


class Declared(NamedTuple):
    """A test that is evidence: its id as pytest gives it (without parameters) and what it says of itself."""

    test: str
    capability: str
    kind: str
    against: str
    marks: tuple[str, ...]


def declared(folder: Path = ROOT / "tests") -> list[Declared]:
    """All evidence that the tests under a folder declare, in their order."""
    found = []
    for path in sorted(folder.rglob("test_*.py")):
        text = path.read_text("utf-8")
        for node in ast.parse(text).body if "mark.evidence" in text else ():
            if not isinstance(node, ast.FunctionDef):
                continue
            marks = [_mark(decorator) for decorator in node.decorator_list]
            names = tuple(name for name, _ in marks if name)
            test = f"{path.relative_to(folder.parent).as_posix()}::{node.name}"
            found += [
                Declared(test, *arguments, names) for name, arguments in marks if name == "evidence"
            ]
    return found


def _mark(decorator: ast.expr) -> tuple[str, tuple[Any, ...]]:
    """Name and constant arguments of a decorator ``pytest.mark.name(...)``; an empty name for any other."""
    call = decorator if isinstance(decorator, ast.Call) else None
    target = call.func if call else decorator
    text = ast.unparse(target)
    if not text.startswith("pytest.mark."):
        return "", ()
    name = text.removeprefix("pytest.mark.")
    arguments = call.args if call is not None and name == "evidence" else []
    return name, tuple(ast.literal_eval(argument) for argument in arguments)


def capabilities() -> dict[str, str]:
    """Return what the public face can do, each with one line: functions of `sunspin` and commands."""
    import sunspin
    from sunspin.cli.common import COMMANDS

    able = {
        name: (inspect.getdoc(thing) or "").splitlines()[0]
        for name in sunspin.__all__
        if inspect.isfunction(thing := getattr(sunspin, name))
    }
    return able | {
        name: line for name, (_, line) in COMMANDS.items() if name.replace("-", "_") not in able
    }


def page(file: str | None) -> str:
    """Return the page in Markdown; `file` is what the tests have written, if they have run."""
    run = (
        json.loads(Path(file).read_text("utf-8"))
        if file and Path(file).is_file()
        else {"tests": {}}
    )
    found, able = declared(), capabilities()
    unknown = {item.capability for item in found} - set(able)
    if unknown:
        raise ValueError(f"evidence for what the public face does not have: {sorted(unknown)}")
    lines = [*_head(run), *_overview(found, able, run)]
    for name, about in sorted(able.items()):
        lines += _section(
            name, about, [item for item in found if item.capability == name], run["tests"]
        )
    return "\n".join(lines) + "\n"


def _head(run: dict) -> list[str]:
    made = (
        f"Results of the tests of version {run['version']}, run with Python {run['python']} on {run['machine']}."
        if run["tests"]
        else "**The tests were not run before this page was built, so it lists the tests without their results.** "
        "`make test` runs the tests and builds the page again."
    )
    return [
        "# Evidence",
        "",
        "This page lists the capabilities of sunspin and the tests of each. All numbers on it are written by the tests.",
        "",
        *(f"- **{kind}**: {meaning};" for kind, meaning in KINDS.items()),
        "- **none**: no test is marked as evidence for the capability.",
        "",
        made,
        "",
    ]


def _overview(found: list[Declared], able: dict[str, str], run: dict) -> list[str]:
    lines = ["| capability | " + " | ".join(KINDS) + " |", "|---|" + "---|" * len(KINDS)]
    for name in sorted(able):
        counts = [
            sum(item.capability == name and item.kind == kind for item in found) for kind in KINDS
        ]
        cells = [str(n) if n else "–" for n in counts] if any(counts) else ["**none**", "", ""]
        lines.append(f"| [{name}](#{name.replace('_', '-')}) | " + " | ".join(cells) + " |")
    return [*lines, ""]


def _section(name: str, about: str, items: list[Declared], runs: dict) -> list[str]:
    lines = [f"({name.replace('_', '-')})=", f"## {name}", "", about, ""]
    if not items:
        return [*lines, "**No evidence**: no test is marked as evidence.", ""]
    lines += ["| kind | what the test shows | compared with | result |", "|---|---|---|---|"]
    for kind in KINDS:
        for item in (item for item in items if item.kind == kind):
            claim = item.test.split("::test_")[1].replace("_", " ")
            path = item.test.split("::")[0].removeprefix("tests/")
            lines.append(
                f"| {kind} | {claim} (`{path}`) | {_cell(item.against)} | {_reached(item, runs.get(item.test))} |"
            )
    return [*lines, ""]


def _reached(item: Declared, run: dict | None) -> str:
    """Return what a run gave: the figures that the test recorded, else that it passed, or why it did not run."""
    if run is None:
        return "not run (a long test)" if {"slow", "long"} & set(item.marks) else "not run"
    if run["failed"]:
        return "**fails**"
    if not run["passed"]:
        return _cell(f"not run: {run['skipped']}")
    figures = []
    for label, figure in run["figures"].items():
        low, high, unit = figure["low"], figure["high"], figure["unit"]
        shown = f"{high:.3g}" if f"{low:.3g}" == f"{high:.3g}" else f"{low:.3g} to {high:.3g}"
        allowed = "" if figure["limit"] is None else f" (allowed {figure['limit']:.3g})"
        figures.append(_cell(f"{label} {shown}{' ' + unit if unit else ''}{allowed}"))
    return "; ".join(figures) or (
        "passes" if run["passed"] == 1 else f"passes, {run['passed']} cases"
    )


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")

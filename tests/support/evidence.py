"""Tests as evidence: the mark that declares it, the fixture that records figures, the file that the documentation reads.

    @pytest.mark.evidence("emd", "validated", "SciPy's linear programming")
    def test_...(reached):
        reached("largest difference", 3e-16, limit=1e-12)

A test that says nothing of figures counts as passed or not. ``pytest --evidence FILE`` writes the file; what other runs have
written there of the same version is kept, so that the long tests add to the short ones.
"""

from __future__ import annotations

import json
import platform
import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from docs.evidence_page import KINDS

FIGURES = pytest.StashKey[dict]()


def pytest_addoption(parser: pytest.Parser) -> None:
    about = "write what the tests have shown, for the documentation"
    parser.addoption("--evidence", metavar="FILE", help=about)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        for mark in item.iter_markers("evidence"):
            if len(mark.args) != 3 or mark.kwargs or mark.args[1] not in KINDS:
                wanted = f"a capability, one of {', '.join(KINDS)}, and against what"
                raise pytest.UsageError(f"{item.nodeid}: evidence takes {wanted}")


@pytest.fixture
def reached(request: pytest.FixtureRequest):
    """Record a figure: `reached(label, value, unit="", limit=None)`; an array counts with its largest value."""
    figures = request.node.stash.setdefault(FIGURES, {})

    def record(label: str, value, unit: str = "", limit: float | None = None) -> None:
        bound = None if limit is None else float(limit)
        figures[label] = {"value": float(np.max(value)), "unit": unit, "limit": bound}

    return record


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo):
    report = yield
    if any(item.iter_markers("evidence")) and (report.when == "call" or report.outcome != "passed"):
        report.user_properties.append(("evidence", item.stash.get(FIGURES, {})))
    return report


class Collector:
    """Takes what the tests reached from their reports, whichever process ran them."""

    def __init__(self) -> None:
        self.results: dict[str, dict] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        for name, figures in report.user_properties:
            if name == "evidence":
                note(self.results, report.nodeid.split("[")[0], report, figures)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        file = session.config.getoption("--evidence")
        if file and self.results:
            write(Path(file), self.results)


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):  # a worker of pytest-xdist only reports
        config.pluginmanager.register(Collector(), "evidence-collector")


def note(results: dict, test: str, report: pytest.TestReport, figures: dict) -> None:
    """Add one report to the results of its test; the cases of a parametrised test are one entry with the range of figures."""
    entry = results.setdefault(test, {"passed": 0, "failed": 0, "skipped": "", "figures": {}})
    if report.outcome == "skipped":
        why = report.longrepr[2] if isinstance(report.longrepr, tuple) else "skipped"
        entry["skipped"] = why.removeprefix("Skipped: ")
        return
    entry[report.outcome] += 1
    for label, figure in figures.items():
        value = figure["value"]
        known = entry["figures"].setdefault(label, {**figure, "low": value, "high": value})
        known["low"], known["high"] = min(known["low"], value), max(known["high"], value)


def write(path: Path, results: dict) -> None:
    head = {"version": metadata.version("sunspin"), "python": platform.python_version()}
    head["machine"] = f"{sys.platform} {platform.machine()}"
    earlier = json.loads(path.read_text("utf-8")) if path.is_file() else {}
    if {key: earlier.get(key) for key in head} == head:
        known = earlier["tests"]
        run = {t: e for t, e in results.items() if e["passed"] or e["failed"] or t not in known}
        results = known | run
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(head | {"tests": results}, indent=1, sort_keys=True), "utf-8")

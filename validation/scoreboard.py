"""Scoreboard: the quantities that must not get worse, in one table over cases of every kind.

A case has an area ("rates"), a kind within it ("steady torque") and a number. It gives a row with its outcome, one of `OUTCOMES`,
and measured values. Rows are kept by the version of the package that gave them. So an interrupted run resumes, and two versions are
compared case by case.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import os
import platform
import subprocess
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sunspin.base import atomic_write
from validation.campaign import load_or_make, rows_folder

ROOT = Path(__file__).parents[1]

OUTCOMES = ("right", "not run", "open", "undecided", "wrong", "defect")
"""Outcomes from best to worst.

"open": not decided, and rightly so, as the best solution is not the true one or is not constrained. "undecided": not decided
although the best solution is right. "wrong": a confident but false result, or a right file accused. "defect": a traceback.
"""


@dataclass(frozen=True)
class Task:
    """One case.

    `run` returns a row with "outcome". It may add: errors "off" and their "sigma" in one unit; "level", the share of a posterior
    that is likelier than the truth; "listed", whether the truth is among the solutions; other figures, "measured". A run that
    judges many cases at once returns "cases", a row for each. `run_timed` adds "processor_s".
    """

    area: str
    kind: str
    case: str
    run: Callable[[], dict[str, Any]]

    @property
    def name(self) -> str:
        """Name of the set that the case belongs to."""
        return f"{self.area}: {self.kind}"


def package_state() -> str:
    """Return the commit, followed by a digest of the package's and the campaigns' files if the tree is not clean."""
    commit = _git("rev-parse", "--short=12", "HEAD")
    if commit and not _git("status", "--porcelain", "--", "src", "validation"):
        return commit
    digest = hashlib.sha256()
    for folder in ("src", "validation"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return f"{commit or 'no-commit'}-{digest.hexdigest()[:12]}"


def _git(*arguments: str) -> str:
    """Return the output of a git command; empty if it fails."""
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else ""


def run_tasks(
    tasks: list[Task],
    folder: Path,
    workers: int,
    say: Callable[[str], None],
) -> dict[str, dict[str, dict[str, Any]]]:
    """Run the tasks without a row in `folder` and return the rows by set and case.

    Rows are kept in `folder`, so an interruption loses only the cases in progress.
    """
    paths = {}  # file of each row -> its task
    for task in tasks:
        set_folder = rows_folder(folder / _as_file(task.name))
        paths[set_folder / f"{_as_file(task.case)}.json"] = task
    missing = [path for path in paths if not path.is_file()]
    begin = time.monotonic()
    # each case in a process that starts afresh: none inherits what another has computed
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_prepare) as pool:
        waiting = {pool.submit(_load_or_run, path, paths[path].run): path for path in missing}
        for count, future in enumerate(as_completed(waiting), 1):
            task, row = paths[waiting[future]], future.result()
            took = time.monotonic() - begin
            say(
                f"{count} of {len(missing)}, {took:.0f} s: {task.name}, case {task.case}: {row['outcome']}"
            )
    rows: dict[str, dict[str, dict[str, Any]]] = {}
    for path, task in paths.items():
        row = json.loads(path.read_text("utf-8"))
        # a run that judges many cases has a row for each, all with the processor time of the run
        rows_of_cases = {
            case: {"processor_s": row["processor_s"]} | each
            for case, each in row.get("cases", {}).items()
        }
        rows.setdefault(task.name, {}).update(rows_of_cases or {task.case: row})
    return rows


def _prepare() -> None:
    """Limit linear algebra to one thread."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"


def _as_file(name: str) -> str:
    """Return a name in the characters of a file name."""
    return "".join(letter if letter.isalnum() or letter in "-_" else "-" for letter in name)


def _load_or_run(path: Path, run: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return the row at `path`; run the case if there is none."""
    return load_or_make(path, partial(run_timed, run))


def run_timed(run: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Run a case and return its row with the processor time; for a case that raises, the error."""
    begin = time.process_time()
    try:
        row = run()
    # any error is a defect of the package, and must not end the campaign
    except Exception as error:
        row = {"outcome": "defect", "says": "".join(traceback.format_exception(error))[-800:]}
    return {"processor_s": time.process_time() - begin} | row


def figures(rows: Iterable[dict[str, Any]]) -> dict[str, float]:
    """Return the figures of a set.

    They are counts of outcomes; for decided cases the shares of `off` within one and two sigma, rms normalised error and median
    sigma; shares of truths in the 50 and 90 % regions; counts of listed truths; median processor time.
    """
    rows = list(rows)
    counts = Counter(row["outcome"] for row in rows)
    numbers: dict[str, float] = {
        outcome: counts[outcome] for outcome in OUTCOMES if counts[outcome]
    }
    decided = [row for row in rows if row["outcome"] in ("right", "wrong") and row.get("sigma")]
    if decided:
        off, sigma = (
            np.abs(np.concatenate([np.ravel(row[name]) for row in decided]))
            for name in ("off", "sigma")
        )
        pull = off / sigma
        numbers |= {"in_68": float((pull < 1).mean()), "in_95": float((pull < 2).mean())}
        numbers |= {"rms_pull": float(np.sqrt((pull**2).mean())), "sigma": float(np.median(sigma))}
    levels = np.array([row["level"] for row in rows if "level" in row])
    if levels.size:
        numbers |= {"in_50": float((levels <= 0.5).mean()), "in_90": float((levels <= 0.9).mean())}
    listed = [row["listed"] for row in rows if "listed" in row]
    if listed:
        numbers |= {"listed": sum(listed), "not_listed": len(listed) - sum(listed)}
    numbers["processor_s"] = float(np.median([row["processor_s"] for row in rows]))
    return numbers


def make_board(
    rows: dict[str, dict[str, dict[str, Any]]], state: str, level: str, seeds: Iterable[int]
) -> dict[str, Any]:
    """Return the content of the board: figures of each set and the outcome of each case, for a `state` of the package."""
    return {
        "state": state,
        "level": level,
        "seeds": list(seeds),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "sets": {
            name: {
                "figures": {
                    key: float(f"{value:.4g}") for key, value in figures(each.values()).items()
                },
                "cases": {case: row["outcome"] for case, row in each.items()},
                "listed": {case: row["listed"] for case, row in each.items() if "listed" in row},
                "measured": {
                    case: row["measured"] for case, row in each.items() if "measured" in row
                },
            }
            for name, each in rows.items()
        },
    }


def changed_outcomes(before: dict[str, Any], now: dict[str, Any]) -> list[tuple[int, str]]:
    """Return the cases whose outcome differs between two boards, worst first: by how many ranks it got worse, and a sentence."""
    changes = []
    for name, each in now["sets"].items():
        old = before["sets"].get(name, {}).get("cases", {})
        for case, outcome in each["cases"].items():
            if case in old and old[case] != outcome:
                worse = OUTCOMES.index(outcome) - OUTCOMES.index(old[case])
                changes.append((worse, f"{name}, case {case}: {old[case]} -> {outcome}"))
    return sorted(changes, key=lambda change: (-change[0], change[1]))


def lost_truths(before: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Return a sentence for each case whose truth was listed in the earlier board and is not any more."""
    return [
        f"{name}, case {case}: the truth is no longer listed"
        for name, each in now["sets"].items()
        for case, listed in each["listed"].items()
        if not listed and before["sets"].get(name, {}).get("listed", {}).get(case)
    ]


JUDGED_BY_STUDY = (
    "contradiction_",
    "cited_",
    "last_section",
    "window_",
    "trajectory_s",
    "touchdown_energy_",
)
"""Beginnings of the names of cases that `studies/contradictions.py` judges instead of the scoreboard."""


def missing_cases(before: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Return a sentence for each case of the earlier board that this one, of the same level and seeds, has not run."""
    if any(before[key] != now[key] for key in ("level", "seeds")):
        return []
    return [
        f"{name}, case {case}: not run"
        for name, each in before["sets"].items()
        for case in each["cases"]
        # sets that were not asked for are not missing
        if name in now["sets"] and case not in now["sets"][name]["cases"]
        if not case.startswith(JUDGED_BY_STUDY)
    ]


def table(now: dict[str, Any], before: dict[str, Any] | None = None) -> str:
    """Return the board as a table: a line for each set. With an earlier board counts are over the cases of both."""
    heads = [
        "set",
        "cases",
        *OUTCOMES,
        "listed",
        "in 68",
        "in 95",
        "pull",
        "sigma",
        "in 50",
        "in 90",
        "s",
    ]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for name, each in now["sets"].items():
        old = (before or {"sets": {}})["sets"].get(name)
        common = [case for case in each["cases"] if old is None or case in old["cases"]]
        states = [each] if old is None else [old, each]  # versions of this set
        cells = [name, str(len(common))]
        for key in OUTCOMES:
            counts = [sum(state["cases"][case] == key for case in common) for state in states]
            cells.append(" / ".join(map(str, counts)))
        cells.append(" / ".join(_count_listed(state, common) for state in states))
        for key in ("in_68", "in_95", "rms_pull", "sigma", "in_50", "in_90", "processor_s"):
            cells.append(" / ".join(_format_figure(state["figures"], key) for state in states))
        lines.append("| " + " | ".join(cells) + " |")
        for case, measured in each["measured"].items():
            for key, value in measured.items():
                past = (old or {}).get("measured", {}).get(case, {}).get(key)
                lines.append(
                    f"| {name}, {case}: {key} | {'' if past is None else f'{past:.4g} / '}{value:.4g} |"
                )
    return "\n".join(lines)


def _count_listed(board_set: dict[str, Any], cases: list[str]) -> str:
    """Return in how many of these cases of a set the truth is listed, of those that have one truth, as text; else a dash."""
    listed_or_none = [board_set.get("listed", {}).get(case) for case in cases]
    known = [listed for listed in listed_or_none if listed is not None]
    return f"{sum(known)} of {len(known)}" if known else "-"


def _format_figure(numbers: dict[str, float], key: str) -> str:
    """Return a figure as text, shares ("in_68") in percent; a dash if there is none."""
    value = numbers.get(key)
    if value is None:
        return "-"
    return f"{value:.0%}" if key.startswith("in_") else f"{value:.3g}"


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this campaign."""
    from validation.areas import AREAS

    level = parser.add_mutually_exclusive_group()
    level.add_argument(
        "--quick",
        dest="level",
        action="store_const",
        const="quick",
        help="20 minutes of two cores (default)",
    )
    level.add_argument(
        "--full",
        dest="level",
        action="store_const",
        const="full",
        help="at most 150 minutes of two cores",
    )
    parser.add_argument(
        "--only", choices=list(AREAS), action="append", help="repeatable; all unless given"
    )
    parser.add_argument(
        "--seed",
        type=int,
        action="append",
        help="repeatable; unless given 0, and with --full 7 too; 11 is kept for the end of a work",
    )
    parser.add_argument(
        "--rows",
        type=Path,
        default=ROOT / "results" / "scoreboard",
        help="where rows are kept: the run goes on there",
    )
    parser.add_argument(
        "--out", type=Path, default=ROOT / "validation" / "scoreboard.json", help="what is written"
    )
    parser.add_argument(
        "--against",
        type=Path,
        help="an earlier board: both side by side, and every case whose outcome differs",
    )
    parser.add_argument(
        "--before",
        metavar="COMMIT",
        help="measure processor times too, beside this commit in an environment of its own",
    )
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.set_defaults(level="quick")


def main(options: argparse.Namespace) -> int:
    """Print the table and the changed outcomes.

    Return 1 if any case is worse than in the earlier board; without one, if any case is wrong or a defect.
    """
    from validation import speed
    from validation.areas import AREAS

    seeds = options.seed or ([0] if options.level == "quick" else [0, 7])
    tasks = [
        task
        for name in options.only or AREAS
        for seed in seeds
        for task in AREAS[name](options.level, seed)
    ]
    state = package_state()
    folder = options.rows / state
    rows = run_tasks(tasks, folder, options.workers, lambda text: print(text, flush=True))
    if options.before is not None:  # alone on the machine, after all else
        path = folder / f"speed-{options.level}-{options.before}.json"
        run = partial(speed.make_row, options.before, options.level, options.rows / "environments")
        rows["speed: processor time"] = {"commands": load_or_make(path, partial(run_timed, run))}
    now = make_board(rows, state, options.level, seeds)
    text = json.dumps(now, indent=1)
    atomic_write.write_atomically(options.out, lambda part: part.write_text(text + "\n", "utf-8"))
    before = None if options.against is None else json.loads(options.against.read_text("utf-8"))
    print(table(now, before))
    if before is None:
        return int(
            any(
                outcome in ("wrong", "defect")
                for each in now["sets"].values()
                for outcome in each["cases"].values()
            )
        )
    changes = changed_outcomes(before, now)
    print(f"{len(changes)} cases differ from {before['state']}")
    print("\n".join(sentence for _, sentence in changes))
    missing = missing_cases(before, now) + lost_truths(before, now)
    print("\n".join(missing))
    return int(bool(missing) or any(worse > 0 for worse, _ in changes))

"""``python -m validation verdicts``: how often a decided pass is wrong, and one that could be decided is not, before and now."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sunspin.base.errors import SunspinError
from sunspin.compute.campaign import kept, rows_folder
from sunspin.estimate.rates.estimate import rates
from sunspin.estimate.rates.result import DECIDED
from sunspin.estimate.verdict import NARROWER
from validation.passes import KINDS, Made, make

WRONG_SIGMAS, WRONG_RAD_S = 5.0, np.radians(0.1)
"""A decided pass is wrong where a component of its rate is off by more than both."""


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "out", type=Path, help="where rows are kept: the same command goes on where it stopped"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--kind", choices=KINDS, action="append", help="repeatable; all unless given"
    )


def run(options: Any) -> int:
    """Print the table, worst first; one if a decided pass is wrong."""
    folder = rows_folder(options.out / f"verdicts-{options.seed}")
    rows = {}
    for kind in options.kind or KINDS:
        name = kind.replace(" ", "-")
        rows[kind] = [
            kept(folder / f"{name}-{i:03d}.json", partial(judge, kind, options.seed, i))
            for i in range(KINDS[kind])
        ]
        print(f"{kind}: {len(rows[kind])} passes", flush=True)
    print(table(rows))
    return int(any(row["decided"] and row["wrong"] for each in rows.values() for row in each))


def judge(kind: str, seed: int, i: int) -> dict[str, Any]:
    """What is said of a simulated pass, now and by the rule of before, and whether it is true."""
    made = make(kind, seed, i)
    try:
        result = rates(made.vehicle, made.telemetry, max_rate_rad_s=made.max_rate_rad_s)
    except SunspinError as error:
        return {
            "decided": False,
            "before": False,
            "wrong": False,
            "mirrored": False,
            "empty": False,
            "why": str(error),
        }
    return judged(result, made)


def judged(result: Any, made: Made) -> dict[str, Any]:
    """The first pass against the truth."""
    t = result["time"].values[result["pass_of"].values == 0]
    at = t[np.argmin(np.abs(t - (t[0] + t[-1]) / 2))]
    truth = made.omega[np.argmin(np.abs(made.telemetry["time"].values - at))]
    omega, sigma = (
        np.array([result[f"{name}_{axis}"].values[0, 0] for axis in "xyz"])
        for name in ("omega", "sigma")
    )
    miss = np.abs(omega - truth)
    wrong = _beyond(miss, sigma)
    mirrored = wrong and any(
        not _beyond(np.abs(omega - (2 * keep - 1) * truth), sigma) for keep in np.eye(3)
    )
    fitted = result["cost"].values[0, 0] <= result["cost_limit"].values[0]
    return {
        "decided": bool(result["decided"].values[0]),
        "before": bool(result["weight"].values[0, 0] >= DECIDED and fitted),
        "wrong": wrong and not mirrored,
        "mirrored": mirrored,
        "empty": bool((sigma > NARROWER * result.attrs["max_rate_rad_s"] / 2).any()),
        "off_deg_s": np.degrees(omega - truth).tolist(),
        "sigma_deg_s": np.degrees(sigma).tolist(),
        "pull": float((miss / sigma).max()),
        "miss_deg_s": float(np.degrees(miss.max())),
        "why": str(result["why_not_decided"].values[0]),
    }


def _beyond(miss: np.ndarray, sigma: np.ndarray) -> bool:
    return bool(((miss > WRONG_SIGMAS * sigma) & (miss > WRONG_RAD_S)).any())


def table(rows: dict[str, list[dict[str, Any]]]) -> str:
    """Both error rates by kind, worst first: before / now."""

    def key(kind: str) -> tuple[float, ...]:
        return tuple(
            -float(np.mean([row[what] and any(row[why] for why in bad) for row in rows[kind]]))
            for bad in (("wrong",), ("wrong", "mirrored", "empty"))
            for what in ("decided", "before")
        )

    lines = [
        "| kind of pass | passes | decided | of these wrong | mirror images | not informed | decidable and not decided |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind in sorted(rows, key=key):
        each, cells = rows[kind], []
        for what in ("before", "decided"):
            sure = [row for row in each if row[what]]
            # those that either rule decides rightly are decidable
            right = [row for row in each if not (row["wrong"] or row["mirrored"] or row["empty"])]
            able = [row for row in right if row["before"] or row["decided"]]
            counts = [sum(row[why] for row in sure) for why in ("wrong", "mirrored", "empty")]
            cells.append(
                (len(sure), *counts, f"{sum(not row[what] for row in able)} of {len(able)}")
            )
        lines.append(
            f"| {kind} | {len(each)} | "
            + " | ".join(f"{a} / {b}" for a, b in zip(*cells, strict=True))
            + " |"
        )
    return "\n".join(lines)

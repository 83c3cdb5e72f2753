"""What the paper's answer is worth: its method repeated on twins whose truth is known (section 2.3, 3.2; its factor of 1.1).

The near-minimum set is a level set of EMD with a threshold that was chosen, not derived. On twins it can be seen how often the
truth lies in it, which threshold would hold the truth with a given probability, and what the lower bound on the angular speed
at the touchdown becomes with that threshold. Thresholds are taken both on EMD and on its ratio to the smallest EMD.
"""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binom, norm

from sunspin.base.errors import InputError, sentence
from sunspin.base.provenance import version
from sunspin.compute.rows import ensemble
from sunspin.philae.coverage_rows import FACTORS, LEVELS, PRIORS, TwinRows
from sunspin.telemetry.case import Case
from sunspin.vehicle.changes import Change, Changes, changes_of

CONFIDENCE = 0.9

QUANTILES = (0.05, 0.5, 0.95)

CHUNK = 4
"""Twins between two looks at the clock: a twin takes half a second."""

SHIPPED = "worth.json"
"""The result that comes with the case: made by `command`, 400 twins of each kind on the paper's whole grid."""

PER_TWIN = ("truth_touchdown_speed", "n_told", "emd_min", "emd_truth", "points", "truth_to_set", "truth_to_line", "line_angle",
            "line_distance", "bound_set", "bound_lines")  # fmt: skip


@dataclass(frozen=True)
class Share:
    """A share k of n with its 95 % interval (Wilson's, which stays inside 0..1)."""

    k: int
    n: int

    @property
    def value(self) -> float:
        return self.k / self.n if self.n else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        if not self.n:
            return 0.0, 1.0
        z, p = float(norm.ppf(0.975)), self.value
        centre, half = p + z**2 / (2 * self.n), z * np.sqrt(p * (1 - p) / self.n + z**2 / (4 * self.n**2))
        return float((centre - half) / (1 + z**2 / self.n)), float((centre + half) / (1 + z**2 / self.n))

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.value:.1%} ({low:.1%} to {high:.1%})"


@dataclass(frozen=True)
class Twins:
    """The method on n twins of one prior.

    Attributes
    ----------
    prior : "lines" or "grid"
    twin : name of `PER_TWIN` -> (n, ...); speeds in rad/s, angles in rad, distances in rad/s
    levels, factors : "at" (m), thresholds on EMD or on its ratio to the smallest; "count" and "speed" (m, 3), quantiles 5, 50
        and 95 % over the twins of the size of the level set and of its smallest angular speed at the touchdown (rad/s);
        "holds" (m), number of twins whose true speed is no smaller than that
    """

    prior: str
    twin: dict[str, np.ndarray]
    levels: dict[str, np.ndarray]
    factors: dict[str, np.ndarray]

    @property
    def n(self) -> int:
        return len(self.twin["emd_min"])

    @property
    def ratio(self) -> np.ndarray:
        """EMD of the truth over the smallest of the scan, (n)."""
        return self.twin["emd_truth"] / self.twin["emd_min"]

    def in_set(self, factor: float) -> Share:
        """How often the truth lies in the level set of this factor."""
        return Share(int((self.ratio < factor).sum()), self.n)

    def threshold(self, confidence: float, relative: bool) -> tuple[float, float, float]:
        """Threshold that holds the truth with this probability, and its 95 % interval: on EMD, or relative to the smallest.

        The value is the order statistic ceil(c (n + 1)), which holds a further twin's truth with probability c or a
        little more whatever the distribution; the interval is that of the quantile (binomial order statistics).
        """
        values = np.sort(self.ratio if relative else self.twin["emd_truth"])
        at = check_confidence(self.n, confidence)
        low, high = binom.ppf([0.025, 0.975], self.n, confidence).astype(int)
        return float(values[at]), float(values[max(low - 1, 0)]), float(values[min(high, self.n - 1)])

    def at(self, threshold: float, relative: bool) -> dict[str, Any]:
        """Size, smallest speed (5, 50, 95 %) and how often it is a bound, at the kept threshold next above."""
        table = self.factors if relative else self.levels
        k = min(int(np.searchsorted(table["at"], threshold)), len(table["at"]) - 1)
        return {
            "threshold": float(table["at"][k]), "count": table["count"][k], "speed": table["speed"][k],
            "holds": Share(int(table["holds"][k]), self.n),
        }  # fmt: skip

    def bound_threshold(self, confidence: float, relative: bool) -> float | None:
        """Smallest kept threshold from which on the level set's smallest speed is a bound with this probability."""
        table = self.factors if relative else self.levels
        fails = np.flatnonzero(table["holds"] < confidence * self.n)
        k = 0 if fails.size == 0 else int(fails[-1]) + 1
        return float(table["at"][k]) if k < len(table["at"]) else None


@dataclass(frozen=True)
class Worth:
    """Twins of every prior, and how they were made."""

    twins: dict[str, Twins]
    seed: int
    coarser: int
    factor: float
    version: str
    grid_points: int
    changes: tuple[Change, ...] = ()

    @property
    def command(self) -> str:
        n = next(iter(self.twins.values())).n
        more = "" if self.coarser == 1 else f" --coarser {self.coarser}"
        more += "" if self.factor == 1.1 else f" --factor {self.factor:g}"
        more += "".join(f" --set {shlex.quote(str(change))}" for change in self.changes)
        return f"sunspin worth --twins {n} --seed {self.seed}{more}"


def check_confidence(n: int, confidence: float) -> int:
    """Which of n ordered twins, from 0, sets the threshold of this confidence; refuses what n twins cannot tell."""
    if not 0 < confidence < 1:
        raise InputError(sentence("a confidence must lie between 0 and 1", got=confidence))
    at = ceil(confidence * (n + 1)) - 1
    if at >= n:
        raise InputError(sentence("too few twins for this confidence", got=f"{n} twins, {confidence:g}", do="ask for more twins"))
    return at


def compute(
    case: Case,
    n: int = 400,
    *,
    seed: int = 0,
    coarser: int = 1,
    factor: float = 1.1,
    workers: int | None = None,
    store: str | Path | None = None,
    progress: bool = False,
    changes: Changes = None,
) -> Worth:
    """Repeat the method on n twins of each prior.

    Parameters
    ----------
    changes : dict or list of str, optional
        With which the case was loaded.
    coarser : int
        Use every n-th point of the paper's grid.
    factor : float
        The method's near-minimum factor (paper, eq. 14: 1.1).
    store : path, optional
        Folder in which finished twins are kept, as in :func:`sunspin.compute.rows.ensemble`; a part of it per prior.
    """
    found, points, asked = {}, 0, changes_of(changes)
    for prior in PRIORS:
        rows = TwinRows(case.name, prior, n, seed, coarser, factor, asked)
        points = len(rows.ground(workers, progress).points)
        kept = None if store is None else Path(store) / prior
        out = ensemble(rows, workers=workers, chunk=CHUNK, store=kept, progress=progress, label=f"twins, {prior}")
        found[prior] = _condensed(prior, out)
    return Worth(found, seed, coarser, factor, version(), points, asked)


def _condensed(prior: str, out: dict[str, np.ndarray]) -> Twins:
    truth = out["truth_touchdown_speed"]
    tables = []
    for name, at in (("level", LEVELS), ("factor", FACTORS)):
        count, speed = out[f"{name}_count"], out[f"{name}_speed"]
        empty = np.where(np.isnan(speed), np.inf, speed)  # an empty set bounds nothing: it counts as a bound that fails
        tables.append(
            {
                "at": at, "count": np.quantile(count, QUANTILES, axis=0).T,
                "speed": np.quantile(empty, QUANTILES, axis=0, method="higher").T,
                "holds": (empty <= truth[:, None]).sum(axis=0),
            }
        )  # fmt: skip
    return Twins(prior, {name: out[name] for name in PER_TWIN}, *tables)


def to_json(worth: Worth) -> dict[str, Any]:
    """Plain data; numbers with six digits, enough for anything said of them."""

    def listed(values: np.ndarray) -> Any:
        return [listed(v) for v in values] if np.ndim(values) else _six(values)

    return {
        "what": "the paper's method repeated on synthetic rebounds of known truth (sunspin.philae.coverage)",
        "synthetic": True, "command": worth.command, "sunspin_version": worth.version, "seed": worth.seed,
        "coarser": worth.coarser, "factor": worth.factor, "grid_points": worth.grid_points,
        "twins": {
            prior: {part: {name: listed(v) for name, v in getattr(twins, part).items()} for part in ("twin", "levels", "factors")}
            for prior, twins in worth.twins.items()
        },
    }  # fmt: skip


def _six(value: Any) -> Any:
    number = value.item()
    return (float(f"{number:.6g}") if np.isfinite(number) else None) if isinstance(number, float) else number


def from_json(text: str, where: str) -> Worth:
    """What `to_json` wrote."""
    try:
        data = json.loads(text)
        twins = {
            prior: Twins(prior, *({k: np.array(v, dtype=np.float64) for k, v in parts[name].items()}
                                  for name in ("twin", "levels", "factors")))
            for prior, parts in data["twins"].items()
        }  # fmt: skip
        return Worth(twins, data["seed"], data["coarser"], data["factor"], data["sunspin_version"], data["grid_points"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(sentence(f"this is no result of `sunspin worth` ({error})", where=where)) from None


def shipped(case: Case) -> Worth | None:
    """The result that comes with the case, if one does."""
    path = case.folder / SHIPPED
    return from_json(path.read_text("utf-8"), str(path)) if path.is_file() else None

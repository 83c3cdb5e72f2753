"""How often a level set of EMD holds the truth, from twins whose truth is known: thresholds, shares and their errors.

The level set has a threshold that was chosen, not derived. On twins it can be seen how often the truth lies in it, which threshold
would hold the truth with a given probability, and what the smallest angular speed of the set becomes with that threshold.
Thresholds are taken both on EMD and on its ratio to the smallest EMD.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np
import xarray as xr
from scipy.special import ndtri

from sunspin.base.errors import InputError, sentence
from sunspin.base.provenance import provenance

QUANTILES = (0.05, 0.5, 0.95)

UNITS = {
    "truth_touchdown_speed": "rad s-1",
    "n_told": "1",
    "emd_min": "1",
    "emd_truth": "1",
    "points": "1",
    "truth_to_set": "rad s-1",
    "truth_to_line": "rad s-1",
    "line_angle": "rad",
    "line_distance": "rad s-1",
    "bound_set": "rad s-1",
    "bound_lines": "rad s-1",
}
"""What is kept of each twin."""

PARTS = {"levels": "level", "factors": "factor"}
"""Tables over thresholds on EMD, and on its ratio to the smallest; their names in a Dataset."""

TABLE = {"count": "1", "speed": "rad s-1", "holds": "1"}


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
        z, p = float(ndtri(0.975)), self.value
        centre, half = (
            p + z**2 / (2 * self.n),
            z * np.sqrt(p * (1 - p) / self.n + z**2 / (4 * self.n**2)),
        )
        return float((centre - half) / (1 + z**2 / self.n)), float(
            (centre + half) / (1 + z**2 / self.n)
        )

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.value:.1%} ({low:.1%} to {high:.1%})"


@dataclass(frozen=True)
class Twins:
    """The method on n twins of one prior.

    Attributes
    ----------
    twin : name of `UNITS` -> (n, ...); speeds in rad/s, angles in rad, distances in rad/s
    levels, factors : "at" (m), thresholds on EMD or on its ratio to the smallest; "count" and "speed" (m, 3), quantiles 5, 50
        and 95 % over the twins of the size of the level set and of its smallest angular speed at the touchdown (rad/s);
        "holds" (m), number of twins whose true speed is no smaller than that
    """

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
        """Threshold that holds the truth with this probability, and its 95 % interval: on EMD, or relative to the smallest."""
        return holding(self.ratio if relative else self.twin["emd_truth"], confidence)

    def at(self, threshold: float, relative: bool) -> dict[str, Any]:
        """Size, smallest speed (5, 50, 95 %) and how often it is a bound, at the kept threshold next above."""
        table = self.factors if relative else self.levels
        k = min(int(np.searchsorted(table["at"], threshold)), len(table["at"]) - 1)
        return {
            "threshold": float(table["at"][k]),
            "count": table["count"][k],
            "speed": table["speed"][k],
            "holds": Share(int(table["holds"][k]), self.n),
        }

    def bound_threshold(self, confidence: float, relative: bool) -> float | None:
        """Smallest kept threshold from which on the level set's smallest speed is a bound with this probability."""
        table = self.factors if relative else self.levels
        fails = np.flatnonzero(table["holds"] < confidence * self.n)
        k = 0 if fails.size == 0 else int(fails[-1]) + 1
        return float(table["at"][k]) if k < len(table["at"]) else None


def holding(values: np.ndarray, confidence: float) -> tuple[float, float, float]:
    """Threshold below which a further one of the `values` (n) lies with this probability, and its 95 % interval.

    The order statistic ceil(c (n + 1)), which holds it with probability c or a little more whatever the distribution; the interval
    is that of the quantile (binomial order statistics).
    """
    n, ordered = len(values), np.sort(values)
    at = check_confidence(n, confidence)
    from scipy.stats import binom

    low, high = binom.ppf([0.025, 0.975], n, confidence).astype(int)
    return float(ordered[at]), float(ordered[max(low - 1, 0)]), float(ordered[min(high, n - 1)])


def check_confidence(n: int, confidence: float) -> int:
    """Which of n ordered twins, from 0, sets the threshold of this confidence; refuses what n twins cannot tell."""
    if not 0 < confidence < 1:
        raise InputError(sentence("a confidence must lie between 0 and 1", got=confidence))
    at = ceil(confidence * (n + 1)) - 1
    if at >= n:
        raise InputError(
            sentence(
                "too few twins for this confidence",
                got=f"{n} twins, {confidence:g}",
                do="ask for more twins",
            )
        )
    return at


def coverage_dataset(twins: Mapping[str, Twins], **said: Any) -> xr.Dataset:
    """Twins of every prior as a result of kind "coverage"; `said`: its attributes (seed, coarser, factor, grid_points, command)."""
    each = list(twins.values())
    data = {
        name: (
            ("prior", "twin", "line")[: each[0].twin[name].ndim + 1],
            np.stack([t.twin[name] for t in each]),
            {"units": unit},
        )
        for name, unit in UNITS.items()
    }
    coords: dict[str, Any] = {"prior": list(twins), "quantile": list(QUANTILES)}
    for part, over in PARTS.items():
        tables = [getattr(t, part) for t in each]
        coords[over] = over, tables[0]["at"], {"units": "1"}
        for name, unit in TABLE.items():
            dims = ("prior", over, "quantile")[: tables[0][name].ndim + 1]
            data[f"{over}_{name}"] = (
                dims,
                np.stack([table[name] for table in tables]),
                {"units": unit},
            )
    return xr.Dataset(data, coords, provenance("coverage", synthetic=1) | said)


def twins_of(found: xr.Dataset) -> dict[str, Twins]:
    """The twins of a coverage by their prior."""

    def table(one: xr.Dataset, over: str) -> dict[str, np.ndarray]:
        return {"at": one[over].values} | {name: one[f"{over}_{name}"].values for name in TABLE}

    return {
        str(prior): Twins(
            {name: one[name].values for name in UNITS},
            *(table(one, over) for over in PARTS.values()),
        )
        for prior in found["prior"].values
        for one in [found.sel(prior=prior)]
    }


SAID = ("seed", "coarser", "factor", "grid_points", "sunspin_version")


def to_json(found: xr.Dataset) -> dict[str, Any]:
    """Plain data; numbers with six digits, enough for anything said of them."""

    def listed(values: np.ndarray) -> Any:
        return [listed(v) for v in values] if np.ndim(values) else _six(values)

    return {
        "what": "the paper's method repeated on synthetic rebounds of known truth (sunspin.philae.coverage)",
        "synthetic": True,
        "command": found.attrs["command"],
        **{key: _six(found.attrs[key]) for key in SAID},
        "twins": {
            prior: {
                part: {name: listed(v) for name, v in getattr(twins, part).items()}
                for part in ("twin", *PARTS)
            }
            for prior, twins in twins_of(found).items()
        },
    }


def _six(value: Any) -> Any:
    number = value.item() if isinstance(value, np.generic | np.ndarray) else value
    return (
        (float(f"{number:.6g}") if np.isfinite(number) else None)
        if isinstance(number, float)
        else number
    )


def from_json(text: str, where: str) -> xr.Dataset:
    """What `to_json` wrote."""
    try:
        data = json.loads(text)
        twins = {
            prior: Twins(
                *(
                    {
                        name: np.array(values, dtype=np.float64)
                        for name, values in parts[part].items()
                    }
                    for part in ("twin", *PARTS)
                )
            )
            for prior, parts in data["twins"].items()
        }
        return coverage_dataset(twins, command=data["command"], **{key: data[key] for key in SAID})
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            sentence(f"this is no result of `sunspin coverage` ({error})", where=where)
        ) from None

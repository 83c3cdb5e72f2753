"""The posterior: which motions the telemetry allows and with what weight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sunspin.estimate.posterior.predict import intervals
from sunspin.estimate.posterior.verdict import TOO_FEW
from sunspin.output.report.drawn import drawn
from sunspin.output.report.read import Results
from sunspin.output.report.section import (
    COLOURS,
    SYMBOLS,
    Plot,
    Section,
    Table,
    camera,
    packed,
    thin,
    utc_text,
)
from sunspin.output.text import with_sigma
from sunspin.solve.weights import effective_draws

MOST = 4000
SHOWN = 7
"""Regions drawn, one colour each."""

PREDICTED = {
    "rate": ("angular speed", "deg/s"),
    "z_to_momentum": ("angle of z from the angular momentum", "deg"),
    "z_to_sun": ("angle of z from the Sun", "deg"),
    "sun_off": ("angle of the Sun from its mean direction in the body", "deg"),
}
"""Predicted quantities shown, in words, and their unit on the page."""


@dataclass(frozen=True)
class Draws:
    """Draws (n): rates (n, 3) in rad/s, number of the region of each, weights that add to one; regions, heaviest first."""

    omega: np.ndarray
    region: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, results: Results) -> Draws | None:
        """Those of the folder, chains one after the other; None where there are none."""
        data = results.first("omega_B", "log_weight", "mode_id")
        if data is None or "axis" not in data["omega_B"].dims:
            return None
        each = data["mode_id"].dims
        omega = data["omega_B"].transpose(*each, "axis").values.reshape(-1, 3).astype(float)
        log = np.nan_to_num(
            data["log_weight"].transpose(*each).values.astype(float).ravel(), nan=-np.inf
        )
        if not len(omega):
            return None
        known = np.isfinite(log)
        weight = np.exp(log - log[known].max()) if known.any() else np.ones(log.size)
        return cls(omega, data["mode_id"].values.ravel(), weight / weight.sum())

    @property
    def regions(self) -> list[tuple[int, float]]:
        """(number, weight) of each region."""
        numbers = np.unique(self.region)
        found = [(int(k), float(self.weight[self.region == k].sum())) for k in numbers]
        return sorted(found, key=lambda item: -item[1])


def section(results: Results) -> Section | None:
    """Draws of the initial rate by region, the table of regions, and what is predicted for other times."""
    draws = Draws.of(results)
    if draws is None:
        return None
    tables = [
        _regions(draws, results),
        _believed(results),
        _judged(results),
        _hypotheses(results),
        _predicted(results),
    ]
    known = [table for table in tables if table is not None]
    return Section(
        "posterior", "The posterior", [], [_cloud(draws), *drawn(results, "posterior"), *known]
    )


MODE_NUMBERS = (("chi_square", ".4g"), ("lit_readings", ".0f"), ("starts", ".0f"))
"""What is said of a region beside its rates, and how its numbers are written."""


def _regions(draws: Draws, results: Results) -> Table:
    modes = next(
        (data for _, data in results.having("log_evidence", "chi_square", "starts", "weight")), None
    )
    rows = []
    for k, share in draws.regions[:50]:
        inside = draws.region == k
        part, weight = np.degrees(draws.omega[inside]), draws.weight[inside]
        mean = np.average(part, axis=0, weights=weight if share > 0 else None)
        sigma = np.sqrt(
            np.average((part - mean) ** 2, axis=0, weights=weight if share > 0 else None)
        )
        few = _effective(part, weight) < TOO_FEW
        rates = [f"{m:.4g}" if few else with_sigma(m, s) for m, s in zip(mean, sigma, strict=True)]
        row = [str(k + 1), f"{share:.3g}", *rates[:2], rates[2] + ", no sigma: too few draws" * few]
        more = ["", "", ""]
        if modes is not None and k < modes.sizes["mode"]:
            more = [f"{float(modes[name].values[k]):{form}}" for name, form in MODE_NUMBERS]
        rows.append(row + more)
    head = [
        "region",
        "weight",
        *(f"ω{axis} (deg/s)" for axis in "xyz"),
        "chi-square",
        "lit readings",
        "starts that led to it",
    ]
    return Table(
        head,
        rows,
        "Regions of motions, heaviest first: rates at the first sample, body axes, and one sigma",
    )


def _effective(omega: np.ndarray, weight: np.ndarray) -> float:
    """How many different draws (n, 3) of equal weight these are worth: some stand there several times."""
    _, which = np.unique(omega, axis=0, return_inverse=True)
    each = np.bincount(which.ravel(), weight)
    return round(effective_draws(each), 6) if each.any() else 0.0


ASKED = {
    "unique": "one region of motions is left",
    "informed_x": "the data inform ωx",
    "informed_y": "the data inform ωy",
    "informed_z": "the data inform ωz",
    "fits": "it fits the readings",
    "search_complete": "the search left nothing out",
    "decided": "decided: all of these",
}


def _believed(results: Results) -> Table | None:
    """The three questions and their answers."""
    found = results.first(*ASKED)
    if found is None:
        return None
    rows = [
        [what, "yes" if bool(found[name].values.ravel()[0]) else "no"]
        for name, what in ASKED.items()
    ]
    return Table(["question", "answer"], rows, "What may be believed")


def _judged(results: Results) -> Table | None:
    """What the verdict rests on."""
    s = results.summary
    said = {
        "p_value": (
            "chance of readings as far from the best motion as these",
            "below 0.002 no motion found explains them",
        ),
        "effective_draws": (
            "draws that the sample is worth",
            "below 700 widths and weights are rough",
        ),
        "pareto_k": ("Pareto's k of the weights", "above 0.55 widths and weights are rough"),
    }
    rows = [
        [what, f"{s[key]:.3g}" if s[key] < 1000 else f"{s[key]:.0f}", limit]
        for key, (what, limit) in said.items()
        if isinstance(s.get(key), int | float)
    ]
    return (
        Table(["what", "value", "limit"], rows, "What the verdict rests on", closed=True)
        if rows
        else None
    )


def _hypotheses(results: Results) -> Table | None:
    """What may move the body, by evidence."""
    found = results.summary.get("hypotheses")
    known = found.items() if isinstance(found, dict) else ()
    rows = [[what, f"{weight:.2f}"] for what, weight in known if isinstance(weight, int | float)]
    return (
        Table(
            ["model of the motion", "weight"],
            rows,
            "What may move the body; the draws of all are mixed",
        )
        if rows
        else None
    )


def _predicted(results: Results) -> Table | None:
    found = next(
        (data for _, data in results.having("z_to_sun", "z_to_momentum", "rate", "predicted_s")),
        None,
    )
    if found is None:
        return None
    rows = []
    for row in intervals(found):
        if row["quantity"] in PREDICTED:
            name, unit = PREDICTED[row["quantity"]]
            values = [f"{np.degrees(row[key]):.4g}" for key in ("median", "low_90", "high_90")]
            rows.append(
                [utc_text(row["t_s"], results.epoch_utc, date=True), f"{name} ({unit})", *values]
            )
    return Table(
        ["time", "what", "median", "90 % from", "to"], rows, "What the body did at other times"
    )


def _cloud(draws: Draws) -> Plot:
    data, chosen = [], draws.regions[:SHOWN]
    for k, (number, share) in enumerate(chosen):
        at = np.flatnonzero(draws.region == number)
        at = at[thin(at.size, MOST // len(chosen))]
        x, y, z = np.degrees(draws.omega[at]).T
        data.append(
            {
                "type": "scatter3d",
                "mode": "markers",
                "x": packed(x),
                "y": packed(y),
                "z": packed(z),
                "showlegend": True,
                "name": f"region {number + 1}, weight {share:.2g}",
                "marker": {"size": 3, "color": COLOURS[k], "symbol": SYMBOLS[k % 4]},
            }
        )
    layout: dict[str, Any] = {
        "scene": {
            **{
                f"{d}axis": {"title": {"text": f"ω{d} (deg/s)"}, "showspikes": False} for d in "xyz"
            },
            "camera": camera(1.6, 1.6, 1.1),
        },
        "legend": {"orientation": "h", "y": 0, "yanchor": "top"},
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
    }
    return Plot(
        "posterior",
        data,
        layout,
        "Draws of the posterior in the space of the three components of the initial body rate, marked "
        "by region.",
        "Draws of the rate at the first sample, body axes. Drag or use the arrow keys to turn.",
        560,
        narrow={"scene.camera.eye": {"x": 2.1, "y": 2.1, "z": 1.4}, "font.size": 11},
    )

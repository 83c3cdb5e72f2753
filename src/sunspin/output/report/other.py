"""What the page knows nothing special about, the findings in full, and where it all comes from."""

from __future__ import annotations

import numpy as np
import xarray as xr

from sunspin.output.folder import CITE
from sunspin.output.report.read import Results
from sunspin.output.report.section import Section, Special, Table
from sunspin.output.text import number_text

SEEN = {
    "version",
    "title",
    "seed",
    "synthetic_telemetry",
    "seconds",
    "missing",
    "headline",
    "conclusions",
    "command",
    "inputs",
    "cite",
    "figures",
    "chain",
    "carries",
    "noise",
    "calibration",
    "score",
    "counts",
    "contradictions",
}
"""Keys of a summary that have a place of their own."""

STATED = (
    ("chain", "candidate motions from"),
    ("noise", "readings"),
    ("calibration", "threshold of the 90 % set"),
)
"""Entries of a study's summary that belong to where its results come from, and their names."""

SEEN_OF = {
    "rates": {
        "verdict",
        "source",
        "passes",
        "acceleration_noise",
        "max_rate_deg_s",
        "samples",
        "wrong_units",
        "wrong_axes",
        "panels_left_out",
        "orbit",
    },
    "simulate": {"t_s", "omega_B", "sun_B", "wheel_speed_rad_s", "events"},
    "sun": {"samples", "reconstructed", "status", "median_sigma_deg", "noise_from"},
    "outcomes": {"runs", "candidates", "candidates_from", "strategies", "not_told"},
    "scan": {"metric", "rows", "minimum", "best_omega_B", "near_minimum_points", "lines"},
    "posterior": {
        "verdict",
        "verdict_word",
        "rate_rad_s",
        "modes",
        "passes",
        "p_value",
        "effective_draws",
        "pareto_k",
        "predicted",
        "hypotheses",
    },
}
"""The same, for one command's summary."""

MOST_ROWS = 100
"""Of a list in the summary."""

MOST_TEXT = 400


def conclusions(results: Results) -> Section | None:
    """The findings of a study, in full."""
    told = results.summary.get("conclusions")
    if not isinstance(told, list) or not told:
        return None
    return Section("findings", "Findings in full", [str(text) for text in told])


def unknown(results: Results) -> Section | None:
    """Every variable of files that no other part has shown, and the summary's other entries."""
    items = []
    seen = SEEN | SEEN_OF.get(results.command, set())
    found = {
        key.replace("_", " "): value for key, value in results.summary.items() if key not in seen
    }
    lists = {key: value for key, value in found.items() if _is_table(value)}
    rows = [[key, _short(value) or "–"] for key, value in found.items() if key not in lists]
    if rows:
        items.append(
            Table(["entry", "value"], rows, "Entries of the summary", closed=len(rows) > 12)
        )
    items += [
        Table(
            list(value[0]),
            [[_short(each) for each in one.values()] for one in value[:MOST_ROWS]],
            key,
            closed=len(value) > 12,
        )
        for key, value in lists.items()
    ]
    for name, data in results.data.items():
        if name not in results.used:
            items.append(
                Table(
                    ["variable", "over", "unit", "values"],
                    [_line(data, v) for v in data.data_vars],
                    f"{name}: variables",
                    closed=True,
                )
            )
    return Section("more", "More results in this folder", [], items) if items else None


def _is_table(value: object) -> bool:
    """Whether an entry is a list of things with the same keys."""
    if not isinstance(value, list) or not value or not isinstance(value[0], dict):
        return False
    return bool(value[0]) and all(
        isinstance(one, dict) and list(one) == list(value[0]) for one in value
    )


def _short(value: object) -> str:
    text = number_text(value, 4)
    return text if len(text) <= MOST_TEXT else text[: MOST_TEXT - 1] + "…"


def _line(data: xr.Dataset, name: object) -> list[str]:
    array = data[name]
    over = " × ".join(f"{d} ({n})" for d, n in array.sizes.items()) or "one value"
    told = "text" if array.dtype.kind in "US" else "–"
    if array.dtype.kind in "fiub" and array.size:
        values = array.values.astype(float)
        known = values[np.isfinite(values)]
        told = (
            "nothing known"
            if not known.size
            else f"{known.min():.4g} to {known.max():.4g}, mean {known.mean():.4g}"
        )
    unit = str(array.attrs.get("units", ""))
    return [str(name), over, "" if unit == "1" else unit, told]


def provenance(results: Results) -> Section:
    """Version, seed, inputs with hashes, what is synthetic, how to cite, the command."""
    s = results.summary
    facts = [
        ["made by", f"sunspin {s.get('version', 'of unknown version')}, command {results.command}"]
    ]
    if "seed" in s:
        facts.append(["seed of all random choices", str(s["seed"])])
    if "seconds" in s:
        facts.append(["computing time", f"{s['seconds']} s"])
    made = (
        "made by a computer, not measured"
        if results.synthetic
        else "no file calls itself synthetic"
    )
    facts.append(["synthetic data", made])
    if results.vehicle is not None:
        facts.append(["vehicle", results.vehicle.name])
    facts += [[label, str(s[key])] for key, label in STATED if s.get(key)]
    for data in results.data.values():
        if data.attrs.get("sha256") and not s.get("inputs"):
            facts.append(
                ["telemetry", f"{data.attrs.get('file', '')}, SHA-256 {data.attrs['sha256']}"]
            )
            break
    inputs = [entry for entry in s.get("inputs", []) if isinstance(entry, dict)]
    items: list = [Table(["", ""], facts)]
    if inputs:
        rows = [
            [str(e.get("what", "")), str(e.get("file", "")), str(e.get("sha256", ""))]
            for e in inputs
        ]
        items.append(Table(["input", "file", "SHA-256"], rows, "Inputs"))
    sources = (
        sorted({str(fact.source) for fact in results.vehicle.facts.values() if fact.source})
        if results.vehicle
        else []
    )
    if sources:
        items.append(
            Table(
                ["source"],
                [[source] for source in sources],
                "Where the vehicle's numbers come from",
                closed=True,
            )
        )
    lines = [
        "Please cite the model's source: "
        + str(s.get("cite", CITE))
        + "; and sunspin with its version."
    ]
    command = s.get("command")
    items.append(
        Special(
            "command",
            {
                "command": str(command) if command else "",
                "report": f"sunspin report {results.folder.name}",
            },
        )
    )
    return Section("provenance", "Where this comes from", lines, items)

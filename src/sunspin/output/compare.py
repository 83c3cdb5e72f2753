"""What changed between two results folders of one command: the numbers of both summaries, each against its error."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from sunspin.base.errors import InputError, printable
from sunspin.base.provenance import provenance
from sunspin.base.untrusted import LARGEST, SMALLEST
from sunspin.landing.tally import quantity
from sunspin.output.folder import MARKER, as_written, maker, read_manifest
from sunspin.output.text import number_text, with_sigma

ROUNDING = 1e-12  # relative difference of values that are the same
SIGMA = "one sigma of both together"
INTERVAL = "half of the wider interval"
TOLERANCE = "tolerance of the row"


class Number(NamedTuple):
    """A quantity of a summary: its values (n), their `error` (NaN: not known), `of` which kind that is, what is printed, and facts
    whose changes are reported in words."""

    what: str
    unit: str
    values: list[float]
    error: float
    of: str
    text: str
    facts: tuple[str, ...] = ()


def compare(a: str | Path, b: str | Path) -> xr.Dataset:
    """What changed from one results folder to another of `reproduce`, `rates`, `posterior` or `outcomes`.

    Parameters
    ----------
    a, b : path
        Folders that the same command wrote. Of each, `summary.json` is read.

    Returns
    -------
    xarray.Dataset
        Over `row`, the largest change first: `what` it is, both values as text (`a`, `b`), `change` (B less A) and `error` in
        `unit`; `of` names the error, NaN if none is known; `size` is the change over the error, or without one over the value;
        `beyond`: whether size exceeds 1, or without an error whether anything changed; `words`: what else changed. Attributes:
        rows of one result alone (`only_a`, `only_b`), conclusions that the other does not draw (`said_a`, `said_b`).

    Raises
    ------
    InputError
        Folders of different commands, of others than these, or with nothing in common.
    """
    folders, got, do = [Path(a), Path(b)], f"{a} and {b}", "run the command again"
    manifests = [read_manifest(folder) for folder in folders]
    command, second = (maker(folder / MARKER) for folder in folders)
    if command != second or command not in NUMBERS:
        what, known = "only two results of one command can be compared", " or ".join(NUMBERS)
        raise InputError(what, got=f"{command} and {second}", do=f"give two of {known}")
    both = zip(folders, manifests, strict=True)
    files = [as_written(folder, manifest, "summary.json") for folder, manifest in both]
    try:
        with np.errstate(all="ignore"):
            summaries = [json.loads(path.read_text("utf-8")) for path in files]
            passes_a, passes_b = (summary.get("passes") or () for summary in summaries)
            for row in passes_b:
                # named as a pass of the first result that overlaps it, rather as one of its own name
                start, end = row["utc_start"], row["utc_end"]
                early = [p for p in passes_a if p["utc_start"] <= end]
                names = [p["pass_id"] for p in early if start <= p["utc_end"]]
                if row["pass_id"] not in names:
                    row["pass_id"] = names[0] if names else f"{row['pass_id']} of B"
            ours, theirs = tables = [NUMBERS[command](summary) for summary in summaries]
            rows = [_change(name, ours[name], theirs[name]) for name in ours if name in theirs]
            attrs = _attributes(folders, summaries, tables)
    except InputError:
        raise
    except (LookupError, OverflowError, RecursionError, TypeError, ValueError, AttributeError) as e:
        what = f"a summary holds something else than `sunspin {command}` writes"
        raise InputError(f"{what} ({type(e).__name__}: {e})", got=got, do=do) from None
    if not rows:
        what, same = "the two results have nothing in common", "compare results of the same data"
        raise InputError(what, got=got, do=same)
    rows.sort(key=lambda row: (np.isnan(row["error"]), -row["size"]))
    columns = {name: ("row", np.array([row[name] for row in rows])) for name in rows[0]}
    return xr.Dataset(columns, attrs=provenance("comparison", command=command, **attrs))


def _change(name: str, a: Number, b: Number) -> dict[str, Any]:
    """The change from `a` to `b`, of several values the largest, over the error or without one over the values."""
    words = [f"{old}, now {new}" for old, new in zip(a.facts, b.facts, strict=True) if old != new]
    change, largest = 0.0, 0.0
    if a.values and len(a.values) == len(b.values):
        changes = np.subtract(b.values, a.values)
        change, largest = changes[np.argmax(np.abs(changes))], np.max(np.abs([a.values, b.values]))
    elif a.text != b.text:
        words.append("another value")
    error = np.hypot(a.error, b.error) if a.of == SIGMA else max(a.error, b.error)
    known = a.of == b.of and SMALLEST <= error <= LARGEST
    size = abs(change) / (error if known else largest) if abs(change) > ROUNDING * largest else 0.0
    return {
        "row": printable(name),
        "what": printable(a.what),
        "a": printable(a.text),
        "b": printable(b.text),
        "unit": printable(a.unit),
        "change": float(change),
        "error": float(error) if known else np.nan,
        "of": a.of if known else "none known",
        "size": float(size),
        "beyond": bool(size > 1 if known else size > 0 or words),
        "words": printable("; ".join(words)),
    }


def _attributes(folders: list[Path], summaries: list[dict], tables: list[dict]) -> dict[str, Any]:
    """What concerns the results as wholes: telemetry, changes made for the run, and rows and sentences of one alone."""
    inputs = [summary.get("inputs") or () for summary in summaries]
    hashes = [{row["sha256"] for row in rows if row["what"] == "telemetry"} for rows in inputs]
    said = [[str(line) for line in summary.get("headline") or ()] for summary in summaries]
    attrs: dict[str, Any] = {"same_telemetry": int(bool(hashes[0]) and hashes[0] == hashes[1])}
    attrs["synthetic"] = int(any(bool(each.get("synthetic_telemetry")) for each in summaries))
    for letter, i in (("a", 0), ("b", 1)):
        lines = {"folder": [folders[i]], "changes": summaries[i].get("changes") or ()}
        lines["said"] = [line for line in said[i] if line not in said[1 - i]]
        lines["only"] = [name for name in tables[i] if name not in tables[1 - i]]
        for name, texts in lines.items():
            attrs[f"{name}_{letter}"] = "\n".join(printable(str(text)) for text in texts)
    return attrs


def _study_numbers(summary: dict[str, Any]) -> dict[str, Number]:
    """Entries of `reproduce`. If there is an interval, its ends are compared and not the printed value: that one comes from few
    motions and scatters by more than the interval."""
    table = {}
    for entry in summary.get("figures") or ():
        if str(entry["id"]).startswith("figure_"):
            continue
        text, values = number_text(entry["ours"], 4), _numbers(entry["ours"])
        of, error = TOLERANCE, entry.get("tolerance")
        low, high = (np.array(_numbers(entry.get(end))) for end in ("low", "high"))
        if low.size and low.shape == high.shape:
            text += f" ({number_text(entry['low'], 4)} to {number_text(entry['high'], 4)})"
            values, of, error = [*low, *high], INTERVAL, np.max(np.abs(high - low)) / 2
        elif entry.get("kind") == "put_in" or not isinstance(error, int | float):
            error = np.nan
        judged = {True: "agrees", False: "differs"}.get(entry.get("agrees"), "not judged")
        about, unit = str(entry.get("what")), str(entry.get("unit") or "").removeprefix("1")
        table[str(entry["id"])] = Number(about, unit, values, error, of, text, (judged,))
    return table


def _pass_numbers(summary: dict[str, Any]) -> dict[str, Number]:
    """Speed, rates and probability of the likeliest solution of each pass. If the pass is not decided, which one is the likeliest
    is chance: speed and rates are means over all its solutions, and the sigmas include their spread."""
    table = {}
    for row in summary.get("passes") or ():
        name, decided, at = f"pass {row['pass_id']}", row["decided"] is not False, row["utc_at"]
        used = pd.DataFrame(row["solutions"][:1] if decided else row["solutions"])
        share = used["probability"] / used["probability"].sum()
        of = "likeliest solution" if len(used) == 1 else "mean of all solutions, not decided"
        half = (used["speed_high_deg_s"] - used["speed_low_deg_s"]) / 2  # of a 90 % interval
        estimates = {"speed": (used["speed_median_deg_s"], half / 1.645)}
        for axis in "xyz":
            sigma = used[f"sigma_{axis}_deg_s"]
            estimates[f"omega_{axis} at {at}"] = used[f"omega_{axis}_deg_s"], sigma
        for what, (value, sigma) in estimates.items():
            mean = share @ value
            spread = np.sqrt(share @ (sigma**2 + (value - mean) ** 2))
            table[f"{name} {what}"] = _estimate(f"{what}: {of}", "deg/s", mean, spread)
        what, likeliest = "probability of the likeliest solution", row["solutions"][0]
        facts = ["decided" if decided else "not decided", f"{len(row['solutions'])} solutions"]
        facts += [f"columns {row['columns_checked']}", f"{summary.get('verdict_word')}"]
        probability = _estimate(what, "", likeliest["probability"], np.nan)
        table[f"{name} probability"] = probability._replace(facts=tuple(facts))
    return table


def _outcome_numbers(summary: dict[str, Any]) -> dict[str, Number]:
    """Means and shares over the runs of each strategy; the same seed draws the same runs."""
    table = {}
    for strategy, estimates in (summary.get("strategies") or {}).items():
        for name, estimate in estimates.items():
            what, unit, scale = quantity(name)
            value, error = scale * estimate["value"], scale * (estimate["error"] or np.nan)
            table[f"wheels {strategy} {name}"] = _estimate(what, unit, value, error)
    return table


def _estimate(what: str, unit: str, value: float, sigma: float) -> Number:
    return Number(what, unit, _numbers(value), float(sigma), SIGMA, with_sigma(value, sigma))


def _numbers(value: Any) -> list[float]:
    """The numbers in a JSON value, in their order."""
    if isinstance(value, list | dict):
        items = value.values() if isinstance(value, dict) else value
        return [number for item in items for number in _numbers(item)]
    return [float(value)] if isinstance(value, int | float) and abs(value) <= LARGEST else []


NUMBERS = {
    "reproduce": _study_numbers,
    "rates": _pass_numbers,
    "posterior": _pass_numbers,
    "outcomes": _outcome_numbers,
}
"""Commands whose results can be compared -> the numbers of their summaries, by name."""

"""Comparison of two results folders of one command: the change of each number of the summaries, relative to its error."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from sunspin.base.errors import InputError, printable
from sunspin.base.provenance import provenance
from sunspin.base.untrusted import LARGEST, SMALLEST
from sunspin.landing.tally import quantity
from sunspin.output.folder import MARKER, read_command, read_manifest, verify_file
from sunspin.output.text import number_text, with_sigma

ROUNDING = 1e-12
"""Relative difference below which two values count as equal."""

SIGMA = "one sigma of both together"
INTERVAL = "half of the wider interval"
TOLERANCE = "tolerance of the row"
"""Kinds of error with which a change is compared, as the column `of` names them."""


class Number(NamedTuple):
    """A quantity of a summary that is compared with the same quantity of another result.

    Attributes
    ----------
    what : name of the quantity, for people
    values : its numbers (n), in `unit`
    error : error of the values in `unit`, NaN if not known
    error_kind : `SIGMA`, `INTERVAL` or `TOLERANCE`
    text : the values as they are printed
    facts : words such as "decided"; a change of one is reported in words
    """

    what: str
    unit: str
    values: list[float]
    error: float
    error_kind: str
    text: str
    facts: tuple[str, ...] = ()


def compare(a: str | Path, b: str | Path) -> xr.Dataset:
    """Compare two results folders of `reproduce`, `rates`, `posterior` or `outcomes`, number by number.

    Parameters
    ----------
    a, b : path
        Folders that the same command wrote. Only their `summary.json` is read.

    Returns
    -------
    xarray.Dataset
        Over `row`, the largest change first: `what` it is, both values as text (`a`, `b`), `change` (B minus A) and `error` in
        `unit`. `error` is NaN if none is known; `of` names its kind. `size` is the change divided by the error, or by the value if
        there is no error. `beyond` is true if `size` exceeds 1, or without an error if anything changed. `words` lists other
        changes. Attributes: names of rows in one result only (`only_a`, `only_b`), conclusions in one only (`said_a`, `said_b`).

    Raises
    ------
    InputError
        The folders are of different commands, of a command without comparison, or have no row in common.
    """
    folders, got, do = [Path(a), Path(b)], f"{a} and {b}", "run the command again"
    manifests = [read_manifest(folder) for folder in folders]
    command, second = (read_command(folder / MARKER) for folder in folders)
    if command != second or command not in NUMBERS:
        what, commands = "only two results of one command can be compared", " or ".join(NUMBERS)
        raise InputError(what, got=f"{command} and {second}", do=f"give two of {commands}")
    files = [
        verify_file(folder, manifest, "summary.json")
        for folder, manifest in zip(folders, manifests, strict=True)
    ]
    try:
        with np.errstate(all="ignore"):
            summaries = [json.loads(path.read_text("utf-8")) for path in files]
            _match_passes(*(summary.get("passes") or () for summary in summaries))
            numbers_a, numbers_b = (NUMBERS[command](summary) for summary in summaries)
            rows = [
                _compare_numbers(name, number, numbers_b[name])
                for name, number in numbers_a.items()
                if name in numbers_b
            ]
            attrs = _attributes(folders, summaries, [numbers_a, numbers_b])
    except InputError:
        raise
    except (LookupError, OverflowError, RecursionError, TypeError, ValueError, AttributeError) as e:
        what = f"a summary holds something else than `sunspin {command}` writes"
        raise InputError(f"{what} ({type(e).__name__}: {e})", got=got, do=do) from None
    if not rows:
        what, advice = "the two results have nothing in common", "compare results of the same data"
        raise InputError(what, got=got, do=advice)
    # the largest change first; rows without a known error are last
    rows.sort(key=lambda row: (np.isnan(row["error"]), -row["size"]))
    columns = {name: ("row", np.array([row[name] for row in rows])) for name in rows[0]}
    return xr.Dataset(columns, attrs=provenance("comparison", command=command, **attrs))


def _match_passes(passes_a: Sequence[dict[str, Any]], passes_b: Sequence[dict[str, Any]]) -> None:
    """Renumber the passes of B, in place, so that each has the number of the pass of A that overlaps it in time.

    The two runs may number passes differently. If several passes of A overlap a pass of B and one has its number, the pass of B
    keeps it. No two passes of B get the same number. A pass of B without one in A is named "N of B". If the middle of a pass is at
    another time in B, both rows get the entry `moved`: its speed is then not the same.
    """
    taken = set()
    for row in passes_b:
        start, end = row["utc_start"], row["utc_end"]
        overlapping = [
            row_a["pass_id"]
            for row_a in passes_a
            if row_a["utc_start"] <= end
            and start <= row_a["utc_end"]
            and row_a["pass_id"] not in taken
        ]
        if row["pass_id"] not in overlapping:
            row["pass_id"] = overlapping[0] if overlapping else f"{row['pass_id']} of B"
        taken.add(row["pass_id"])
        for row_a in passes_a:
            if row_a["pass_id"] == row["pass_id"] and row_a["utc_at"] != row["utc_at"]:
                row_a["moved"] = row["moved"] = True


def _compare_numbers(name: str, a: Number, b: Number) -> dict[str, Any]:
    """Return the row of the comparison from `a` to `b`, with the columns of :func:`compare`.

    Of several values, the one that changes most is compared. If their number differs, only the texts are.
    """
    words = [f"{old}, now {new}" for old, new in zip(a.facts, b.facts, strict=True) if old != new]
    change, largest_value = 0.0, 0.0
    if a.values and len(a.values) == len(b.values):
        changes = np.subtract(b.values, a.values)
        change = changes[np.argmax(np.abs(changes))]
        largest_value = np.max(np.abs([a.values, b.values]))
    elif a.text != b.text:
        words.append("another value")
    # two estimates have independent sigmas; intervals and tolerances are limits, of which the wider counts
    error = np.hypot(a.error, b.error) if a.error_kind == SIGMA else max(a.error, b.error)
    has_error = a.error_kind == b.error_kind and SMALLEST <= error <= LARGEST
    size = 0.0
    if abs(change) > ROUNDING * largest_value:
        size = abs(change) / (error if has_error else largest_value)
    return {
        "row": printable(name),
        "what": printable(a.what),
        "a": printable(a.text),
        "b": printable(b.text),
        "unit": printable(a.unit),
        "change": float(change),
        "error": float(error) if has_error else np.nan,
        "of": a.error_kind if has_error else "none known",
        "size": float(size),
        "beyond": bool(size > 1 if has_error else size > 0 or words),
        "words": printable("; ".join(words)),
    }


def _attributes(
    folders: list[Path], summaries: list[dict], numbers: list[dict[str, Number]]
) -> dict[str, Any]:
    """Return the attributes of a comparison: same telemetry or not, `--set` changes, rows and conclusions in one result only.

    The arguments are those of results A and B. Attributes of lists have an entry in each line.
    """
    inputs = [summary.get("inputs") or () for summary in summaries]
    hashes = [{row["sha256"] for row in rows if row["what"] == "telemetry"} for rows in inputs]
    conclusions = [[str(line) for line in summary.get("headline") or ()] for summary in summaries]
    attrs: dict[str, Any] = {"same_telemetry": int(bool(hashes[0]) and hashes[0] == hashes[1])}
    attrs["synthetic"] = int(any(bool(summary.get("synthetic_telemetry")) for summary in summaries))
    for letter, this, other in (("a", 0, 1), ("b", 1, 0)):
        lines = {"folder": [folders[this]], "changes": summaries[this].get("changes") or ()}
        lines["said"] = [line for line in conclusions[this] if line not in conclusions[other]]
        lines["only"] = [name for name in numbers[this] if name not in numbers[other]]
        for name, texts in lines.items():
            attrs[f"{name}_{letter}"] = "\n".join(printable(str(text)) for text in texts)
    return attrs


def _study_numbers(summary: dict[str, Any]) -> dict[str, Number]:
    """Return the entries of a summary of `reproduce` by id, without those that only name figures.

    If an entry has an interval, its ends are compared and not the value. The value comes from few motions and scatters by more
    than the interval.
    """
    numbers = {}
    for entry in summary.get("figures") or ():
        if str(entry["id"]).startswith("figure_"):
            continue
        text, values = number_text(entry["ours"], 4), _numbers(entry["ours"])
        error_kind, error = TOLERANCE, entry.get("tolerance")
        low, high = (np.array(_numbers(entry.get(end))) for end in ("low", "high"))
        if low.size and low.shape == high.shape:
            text += f" ({number_text(entry['low'], 4)} to {number_text(entry['high'], 4)})"
            values, error_kind = [*low, *high], INTERVAL
            error = np.max(np.abs(high - low)) / 2
        elif entry.get("kind") == "put_in" or not isinstance(error, int | float):
            error = np.nan  # an input of the study has no error of the result
        verdict = {True: "agrees", False: "differs"}.get(entry.get("agrees"), "not judged")
        what = str(entry.get("what"))
        unit = str(entry.get("unit") or "").removeprefix("1")  # "1": a number without unit
        numbers[str(entry["id"])] = Number(what, unit, values, error, error_kind, text, (verdict,))
    return numbers


def _pass_numbers(summary: dict[str, Any]) -> dict[str, Number]:
    """Return speed, rates (deg/s) and probability of the likeliest solution of each pass, by "pass N quantity".

    In a pass that is not decided, the likeliest solution may be another in each run. Speed and rates are then means over all
    solutions, weighted by probability, and their sigmas include the spread of the solutions. The sigma of the speed includes half
    of its range over the pass, if the other result has it at another time.
    """
    numbers = {}
    for row in summary.get("passes") or ():
        name, decided, at = f"pass {row['pass_id']}", row["decided"] is not False, row["utc_at"]
        # solutions are in order of falling probability
        used = pd.DataFrame(row["solutions"][:1] if decided else row["solutions"])
        share = used["probability"] / used["probability"].sum()
        source = "likeliest solution" if len(used) == 1 else "mean of all solutions, not decided"
        half_width = (used["speed_high_deg_s"] - used["speed_low_deg_s"]) / 2
        # a 90 % interval of a normal distribution is 1.645 sigmas wide to each side
        estimates = {"speed": (used["speed_median_deg_s"], half_width / 1.645)}
        for axis in "xyz":
            sigma = used[f"sigma_{axis}_deg_s"]
            estimates[f"omega_{axis} at {at}"] = used[f"omega_{axis}_deg_s"], sigma
        for what, (value, sigma) in estimates.items():
            mean = share @ value
            total_sigma = np.sqrt(share @ (sigma**2 + (value - mean) ** 2))
            if what == "speed" and row.get("moved"):
                total_sigma = np.hypot(total_sigma, np.ptp(row.get("speed_deg_s") or [0.0]) / 2)
            numbers[f"{name} {what}"] = _estimate(f"{what}: {source}", "deg/s", mean, total_sigma)
        what, likeliest = "probability of the likeliest solution", row["solutions"][0]
        facts = ["decided" if decided else "not decided", f"{len(row['solutions'])} solutions"]
        facts += [f"columns {row['columns_checked']}", f"{summary.get('verdict_word')}"]
        probability = _estimate(what, "", likeliest["probability"], np.nan)
        numbers[f"{name} probability"] = probability._replace(facts=tuple(facts))
    return numbers


def _outcome_numbers(summary: dict[str, Any]) -> dict[str, Number]:
    """Return means and shares over the runs of each strategy, by "wheels STRATEGY QUANTITY"."""
    numbers = {}
    for strategy, estimates in (summary.get("strategies") or {}).items():
        for name, estimate in estimates.items():
            what, unit, scale = quantity(name)
            # an error of 0, as of a share of 0 in all runs, says nothing
            value, error = scale * estimate["value"], scale * (estimate["error"] or np.nan)
            numbers[f"wheels {strategy} {name}"] = _estimate(what, unit, value, error)
    return numbers


def _estimate(what: str, unit: str, value: float, sigma: float) -> Number:
    """Return a quantity whose error is a sigma, NaN if not known."""
    return Number(what, unit, _numbers(value), float(sigma), SIGMA, with_sigma(value, sigma))


def _numbers(value: Any) -> list[float]:
    """Return the numbers in a JSON value, nested or not, in their order; too large ones are left out."""
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
"""Command whose results can be compared -> function that reads the numbers of its summary, by name."""

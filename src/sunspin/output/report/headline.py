"""Title, the first sentences and the key figures: from the summary where it has them, else from what the command left."""

from __future__ import annotations

from typing import Any

import numpy as np

from sunspin.output.kinds.rate_words import rate_at
from sunspin.output.report.landing import strategy_name
from sunspin.output.report.read import Results
from sunspin.output.report.rows import between
from sunspin.output.text import capital, counted, number_text, rate_text
from sunspin.telemetry.case import case_names

TITLES = {
    "rates": "How {vehicle} turns",
    "sun": "Where {vehicle} saw the Sun",
    "simulate": "A motion of {vehicle}",
    "scan": "Which motions of {vehicle} fit",
    "outcomes": "What the motion of {vehicle} leads to",
    "posterior": "How {vehicle} turned: the posterior",
}


def title(results: Results) -> str:
    """The summary's own title, or one after the command."""
    own = results.summary.get("title")
    if isinstance(own, str) and own:
        return own
    vehicle = results.vehicle.name if results.vehicle else "the vehicle"
    vehicle = vehicle.capitalize() if vehicle in case_names() else vehicle
    return TITLES.get(results.command, f"Results of sunspin {results.command}").format(
        vehicle=vehicle
    )


def sentences(results: Results) -> list[str]:
    """At most three sentences for the first screen."""
    own = results.summary.get("headline")
    if isinstance(own, list):
        return [str(sentence) for sentence in own][:3]
    make = {
        "rates": _rates,
        "sun": _sun,
        "simulate": _simulate,
        "scan": _scan,
        "outcomes": _outcomes,
        "posterior": _posterior,
    }
    told = make.get(results.command, _verdict)(results)
    for key, what in (("wrong_axes", "Wrong axes"), ("wrong_units", "Wrong unit")):
        if isinstance(wrong := results.summary.get(key), list):
            told = [*(_sentence(f"{what}: {text}") for text in wrong), *told]
    return told or [
        f"This folder holds results of `sunspin {results.command}`; below is what is in it."
    ]


def _verdict(results: Results) -> list[str]:
    if isinstance(results.summary.get("sentences"), list):
        return [str(text) for text in results.summary["sentences"]][:3]
    said = [
        results.summary.get("verdict"),
        *(data.attrs.get("verdict") for data in results.data.values()),
    ]
    return [_sentence(str(text)) for text in dict.fromkeys(said) if text][:3]


def _sentence(text: str) -> str:
    return capital(text) + ("" if text.endswith(".") else ".")


def _rates(results: Results) -> list[str]:
    told = _verdict(results)[:1]
    found = results.first("omega_B", "pass_of", "decided", "fits")
    passes = [p for p in results.summary.get("passes", []) if p.get("modes")]
    if found is None or len(passes) != found.sizes["pass_id"]:
        return told
    if not found["fits"].values.any():
        return [
            *told,
            "So the rates below describe no motion that the samples support, and should not be used.",
        ]
    sound = [p for p, decided in zip(passes, found["decided"].values, strict=True) if decided]
    if not sound:
        return [
            *told,
            "No pass is decided: of each, only the components that are said to be informed may be used.",
        ]
    best = max(sound, key=lambda p: (p["modes"][0]["weight"], -max(p["sigma_deg_s"])))
    rate = rate_at(found, passes.index(best))
    speed = rate.mean
    return [
        *told,
        f"In the pass that is best known ({counted(int(best['samples']), 'sample')} in {best['end_s'] - best['start_s']:.0f} s) "
        f"it turned at {speed:.3g} deg/s ({rate.low:.3g} to {rate.high:.3g} over the pass), one turn in "
        f"{360 / speed if speed else np.inf:.3g} s; each component's mean over the pass is known "
        f"to {number_text(max(best['sigma_deg_s']), 2)} deg/s (one sigma over all motions that fit), and the best motion there has "
        f"a weight of {best['modes'][0]['weight']:.2f}.",
    ]


def _posterior(results: Results) -> list[str]:
    told, s = _verdict(results)[:1], results.summary
    rate, modes = s.get("rate_rad_s"), s.get("modes")
    if not isinstance(rate, dict) or not modes or s.get("verdict_word") == "not explained":
        return told
    low, middle, high = (np.degrees(rate[key]) for key in ("low_90", "median", "high_90"))
    share = f"The likeliest of {len(modes)} regions of motions holds {modes[0]['weight']:.1%} of the probability."
    sigma = f"Each component of the rate is known to {np.degrees(max(modes[0]['sigma'])):.2g} deg/s (one sigma) or better."
    return [
        *told,
        f"At the first sample it turned at {middle:.4g} deg/s, one turn in {360 / middle if middle else np.inf:.3g} s; with a "
        f"probability of 90 % it was between {low:.4g} and {high:.4g} deg/s.",
        share if len(modes) > 1 else sigma,
    ]


def _sun(results: Results) -> list[str]:
    s = results.summary
    told = [
        f"{s['reconstructed']} of {counted(int(s['samples']), 'sample')} give a direction to the Sun."
    ]
    if s.get("median_sigma_deg") is not None:
        told.append(
            f"Half of these directions are known to {s['median_sigma_deg']:.2g} degrees or better (noise: {s['noise_from']})."
        )
    why = [f"{count} × {text}" for text, count in list(s.get("status", {}).items())[:3]]
    return (
        [*told, "The most frequent verdicts on a sample: " + "; ".join(why) + "."] if why else told
    )


def _simulate(results: Results) -> list[str]:
    s, run = results.summary, results.first("omega_B", "sun_B")
    told = []
    if run is not None:
        speed = np.degrees(np.linalg.norm(run["omega_B"].values, axis=1))
        told.append(
            f"A simulation, not a measurement: over {abs(s['t_s']):.6g} s the vehicle turns at {speed.min():.3g} to "
            f"{speed.max():.3g} deg/s, and ends at {rate_text(s['omega_B'])}."
        )
    events = s.get("events", [])
    first = "; ".join(f"{e['wheel']} {e['what']} after {e['t_s']:.4g} s" for e in events[:3])
    return [
        *told,
        f"Events: {first}." if events else "No wheel stops or starts by itself in this time.",
    ]


def _scan(results: Results) -> list[str]:
    s = results.summary
    worst = (
        "none of them fits well"
        if s["metric"] == "emd" and s["minimum"] > 0.1
        else "the best of them"
    )
    told = [
        f"Of {counted(int(s['rows']), 'simulated motion')} {worst} begins at {rate_text(s['best_omega_B'])}, with "
        f"{s['metric'].upper() if s['metric'] == 'emd' else 'E'} {s['minimum']:.4f} (0: its Sun stands as the panels saw it).",
        f"Motions that fit nearly as well: {int(s['near_minimum_points'])}; this set alone is no confidence region, and a "
        "threshold that makes it one has to be calibrated on data of known truth.",
    ]
    lines = s.get("lines")
    return (
        [*told, f"{counted(len(lines), 'line')} through the set say which rates go together."]
        if lines
        else told
    )


def _outcomes(results: Results) -> list[str]:
    origin = results.summary.get("candidates_from")
    told = [
        f"{counted(int(results.summary['runs']), 'simulated run')} per strategy, from {results.summary['candidates']} candidate "
        f"motions{f': {origin}' if origin else ''}."
    ]
    parts = []
    for name, found in results.summary.get("strategies", {}).items():
        if "touch_leg" in found:
            leg = found["touch_leg"]
            parts.append(f"{strategy_name(name)} {leg['value']:.1%} ± {leg['error']:.1%}")
    if parts:
        told.append(
            "A leg touches the ground first with a probability of: wheel "
            + ", ".join(parts)
            + " (one standard error)."
        )
    missing = results.summary.get("not_told")
    return [*told, str(missing)] if missing else told


def first_line(results: Results) -> str:
    """What the telemetry file can carry: the first line of a study's page."""
    told = results.summary.get("carries")
    return told if isinstance(told, str) else ""


def changes(results: Results) -> list[str]:
    """What was set for this run beside the files, a line each."""
    told = results.summary.get("changes")
    return [str(line) for line in told] if isinstance(told, list) else []


def score(results: Results) -> list[str]:
    """The study's score, a line for each kind of row."""
    told = results.summary.get("score")
    return [str(line) for line in told] if isinstance(told, list) else []


def facts(results: Results) -> list[tuple[str, str, str]]:
    """A few figures in a row under the first sentences: label, value, what to hold it against."""
    found = []
    for name, label in FACTS:
        row = results.row(name)
        if results.why_nothing and name not in OF_READINGS:
            continue
        if (
            row is None
            or isinstance(row.get("ours"), bool)
            or not isinstance(row.get("ours"), int | float)
        ):
            continue
        unit = "" if row.get("unit") == "1" else f" {row.get('unit', '')}"
        value, told = (
            f"{row['ours']:.4g}{unit}",
            [f"published {number_text(row.get('published'), 4)}"],
        )
        if name == BOUND:
            label += f" {_level(row)}"
        if row.get("informative") is False:
            value = "not known from these data"
            left = between(row.get("low"), row.get("high"))
            told.insert(
                0,
                "uninformative: nearly all that was possible is left"
                + (f", {left}{unit}" if left else ""),
            )
        if row.get("kind") == "put_in":
            told.append("put in: the telemetry was made from it")
        if row.get("chain") == "none":
            told.append("no telemetry enters")
        found.append((label, value, "; ".join(told)))
    return found


def _level(row: dict[str, Any]) -> str:
    """How sure a lower bound is, by what made it."""
    sure = {
        "scan": "(90 %)",
        "posterior": "(95 %)",
        "published": "(of the printed lines, whatever this telemetry says)",
    }
    return sure.get(str(row.get("chain")), f"(of the motions of {row.get('chain')})")


OF_READINGS = ("delta_mean",)
"""Facts of the readings themselves, which stand where nothing is concluded from them."""

BOUND = "rate_at_touchdown_bound"

FACTS = (
    (BOUND, "angular speed after the touchdown, at least"),
    ("emd_min", "smallest misfit of the Sun's heights (EMD)"),
    ("delta_mean", "mean misfit of a sample (Delta)"),
    ("wheel_stop", "time in which the wheel runs down"),
)
"""Rows of the study shown first, in plain words."""

"""Results of `sunspin rates` and `sunspin simulate`."""

from __future__ import annotations

import numpy as np
import xarray as xr

from sunspin.output.figures.rates import sources
from sunspin.output.kinds.rate_words import rate_at
from sunspin.output.kinds.rates import AS_STATED
from sunspin.output.report.drawn import drawn
from sunspin.output.report.read import Results
from sunspin.output.report.section import Section, Table, utc_text
from sunspin.output.text import number_text, rate_text, with_sigma


def rates(results: Results) -> Section | None:
    """Modes of every pass, and the body rates."""
    found = results.first("omega_B", "omega_cov_B", "pass_of", "weight")
    if found is None:
        return None
    rows, said = [], [""] * found.sizes["pass_id"]
    if "why_not_decided" in found:
        said = [str(why) or "decided" for why in found["why_not_decided"].values]
    if "model" in found:
        said = [
            f"{text}; likeliest: {model}" if model != AS_STATED else text
            for text, model in zip(said, found["model"].values.astype(str), strict=True)
        ]
    for k in range(found.sizes["pass_id"]):
        at = np.flatnonzero(found["pass_of"].values == k)
        weight, rate = found["weight"].values[k], rate_at(found, k)
        for mode in np.flatnonzero(np.isfinite(weight)):
            mean, sigma = (
                np.degrees(found[name].values[k, mode])
                for name in ("omega_mean_B", "omega_sigma_B")
            )
            speed, at_s = ("", "") if mode else (rate.speed, utc_text(rate.at_s, results.epoch_utc))
            if not mode:  # of the others only the mean over the pass is kept
                mean, sigma = rate.omega, rate.sigma
            begin = utc_text(float(found["time"].values[at[0]]), results.epoch_utc, date=True)
            rows.append(
                [
                    str(int(found["pass_id"].values[k])),
                    begin,
                    str(at.size),
                    str(mode + 1),
                    f"{weight[mode]:.3f}",
                    speed,
                    at_s or "mean of the pass",
                    *(with_sigma(m, s) for m, s in zip(mean, sigma, strict=True)),
                    "" if mode else said[k],
                ]
            )
    table = Table(
        [
            "pass",
            "begins",
            "samples",
            "motion",
            "weight",
            "speed and its range (deg/s)",
            "components at",
            *(f"ω{axis} (deg/s)" for axis in "xyz"),
            "may be believed",
        ],
        rows,
        "Every motion that fits, by pass",
        closed=len(rows) > 30,
    )
    lead = [
        "Each pass may allow several motions, mostly whole turns more or less between samples; their weights add to one."
    ]
    return Section(
        "rates", "Body rates", lead, [*drawn(results, "rates"), table, _rests_on(results, found)]
    )


def _rests_on(results: Results, found: xr.Dataset) -> Table:
    """What the rates were found from, and what became of the samples."""
    s = results.summary
    rows = [["found from", sources(found)]]
    if isinstance(noise := s.get("acceleration_noise"), int | float):
        rows.append(
            [
                "acceleration noise (rad/s^1.5)",
                f"{noise:.3g}, {found.attrs.get('acceleration_noise_from', 'given')}",
            ]
        )
    if isinstance(fastest := s.get("max_rate_deg_s"), int | float):
        rows.append(["no rate is faster than (deg/s)", f"{fastest:.4g}"])
    samples = s.get("samples")
    for text, count in samples.items() if isinstance(samples, dict) else ():
        rows.append(["samples", f"{count} {text}"])
    if isinstance(silent := s.get("panels_left_out"), list) and silent:
        rows.append(["panels left out, as they never read anything", ", ".join(map(str, silent))])
    return Table(["what", "value"], rows, "What the rates rest on")


END = {
    "omega_B": ("body rate", rate_text),
    "sun_B": ("direction to the Sun, body axes", number_text),
    "wheel_speed_rad_s": ("wheel speeds (rad/s)", number_text),
}
"""What `simulate` says of the last instant, by its key in the summary."""


def trajectory(results: Results) -> Section | None:
    """Rates and wheel speeds of simulated motions that are no candidates of a study."""
    if not any(
        not name.startswith("motion-")
        for name, _ in results.having("omega_B", "momentum_B", "wheel_speed_rad_s")
    ):
        return None
    s = results.summary
    rows = [
        [what, text(s[key])]
        for key, (what, text) in END.items()
        if isinstance(s.get(key), list) and s[key]
    ]
    end = (
        [Table(["what", "components"], rows, f"At the end, after {number_text(s.get('t_s'))} s")]
        if rows
        else []
    )
    return Section(
        "trajectory", "Rates and wheel speeds", [], [*drawn(results, "trajectory"), *end]
    )

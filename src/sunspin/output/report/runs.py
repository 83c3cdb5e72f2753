"""Results of `sunspin rates` and `sunspin simulate`."""

from __future__ import annotations

import numpy as np

from sunspin.output.report.drawn import drawn
from sunspin.output.report.read import Results
from sunspin.output.report.section import Section, Table, utc_text
from sunspin.output.text import with_sigma


def rates(results: Results) -> Section | None:
    """Modes of every pass, and the body rates."""
    found = results.first("omega_B", "omega_cov_B", "pass_of", "weight")
    if found is None:
        return None
    rows, said = [], [""] * found.sizes["pass_id"]
    if "why_not_decided" in found:
        said = [str(why) or "decided" for why in found["why_not_decided"].values]
    for k in range(found.sizes["pass_id"]):
        at = np.flatnonzero(found["pass_of"].values == k)
        weight = found["weight"].values[k]
        for mode in np.flatnonzero(np.isfinite(weight)):
            mean, sigma = (np.degrees(found[name].values[k, mode]) for name in ("omega_mean_B", "omega_sigma_B"))
            rows.append([
                str(k + 1), utc_text(float(found["time"].values[at[0]]), results.epoch_utc, date=True), str(at.size), str(mode + 1),
                f"{weight[mode]:.3f}", *(with_sigma(m, s) for m, s in zip(mean, sigma, strict=True)), said[k],
            ])  # fmt: skip
    table = Table(
        ["pass", "begins", "samples", "motion", "weight (1)", "ωx (deg/s)", "ωy (deg/s)", "ωz (deg/s)", "may be believed"], rows,
        "Every motion that fits, by pass", closed=len(rows) > 30,
    )  # fmt: skip
    lead = ["Each pass may allow several motions, mostly whole turns more or less between samples; their weights add to one."]
    return Section("rates", "Body rates", lead, [*drawn(results, "rates"), table])


def trajectory(results: Results) -> Section | None:
    """Rates and wheel speeds of simulated motions that are no candidates of a study."""
    if not any(not name.startswith("motion-") for name, _ in results.having("omega_B", "momentum_B", "wheel_speed_rad_s")):
        return None
    return Section("trajectory", "Rates and wheel speeds", [], [*drawn(results, "trajectory")])

"""Results of `sunspin rates` and `sunspin simulate`."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from sunspin.output.report.read import Results
from sunspin.output.report.section import COLOURS, Plot, Section, Table, clock, packed, thin, time_axis, utc_text
from sunspin.output.text import with_sigma

MOST = 4000
SIGMAS = 2.0
"""Half-width of the bands in standard deviations."""


def rates(results: Results) -> Section | None:
    """Modes of every pass, and the body rates."""
    found = results.first("omega_B", "omega_cov_B", "pass_of", "weight")
    if found is None:
        return None
    rows = []
    for k in range(found.sizes["pass_id"]):
        at = np.flatnonzero(found["pass_of"].values == k)
        weight = found["weight"].values[k]
        for mode in np.flatnonzero(np.isfinite(weight)):
            mean, sigma = (np.degrees(found[name].values[k, mode]) for name in ("omega_mean_B", "omega_sigma_B"))
            rows.append([
                str(k + 1), utc_text(float(found["time"].values[at[0]]), results.epoch_utc, date=True), str(at.size), str(mode + 1),
                f"{weight[mode]:.3f}", *(with_sigma(m, s) for m, s in zip(mean, sigma, strict=True)),
            ])  # fmt: skip
    table = Table(
        ["pass", "begins", "samples", "motion", "weight (1)", "ωx (deg/s)", "ωy (deg/s)", "ωz (deg/s)"], rows,
        "Every motion that fits, by pass", closed=len(rows) > 30,
    )  # fmt: skip
    lead = ["Each pass may allow several motions, mostly whole turns more or less between samples; their weights add to one."]
    return Section("rates", "Body rates", lead, [_rates_plot(results, found, "rates"), table])


def rates_picture(results: Results) -> Plot | None:
    """The rates as the first picture, with what the other motions allow."""
    found = results.first("omega_B", "omega_cov_B", "pass_of", "weight")
    return None if found is None else _rates_plot(results, found, "first-rates")


def _rates_plot(results: Results, found: xr.Dataset, id: str) -> Plot:
    data: list[dict[str, Any]] = []
    t, pass_of = found["time"].values, found["pass_of"].values
    omega = np.degrees(found["omega_B"].values)
    sigma = np.degrees(np.sqrt(np.maximum(np.einsum("nii->ni", found["omega_cov_B"].values), 0.0)))
    weight = np.nan_to_num(found["weight"].values[:, 0])
    starts = np.flatnonzero(np.diff(pass_of)) + 1
    keep = thin(t.size, MOST)
    keep = np.unique(np.concatenate([keep, starts, starts - 1]))
    gaps = np.flatnonzero(np.diff(pass_of[keep])) + 1
    when = np.insert(t[keep], gaps, np.nan)
    for k, axis in enumerate("xyz"):
        middle, wide = (np.insert(a[keep, k], gaps, np.nan) for a in (omega, SIGMAS * sigma))
        for part in np.split(keep, gaps):
            ring = np.concatenate([t[part], t[part][::-1]])
            edge = np.concatenate([omega[part, k] + SIGMAS * sigma[part, k], (omega[part, k] - SIGMAS * sigma[part, k])[::-1]])
            data.append({
                "type": "scatter", "mode": "lines", "x": clock(ring, results.epoch_utc), "y": packed(edge), "fill": "toself",
                "fillcolor": f"{COLOURS[k]}:0.2", "line": {"width": 0}, "hoverinfo": "skip", "showlegend": False,
                "legendgroup": axis,
            })  # fmt: skip
        data.append({
            "type": "scatter", "mode": "lines+markers", "x": clock(when, results.epoch_utc), "y": packed(middle),
            "name": f"ω{axis}",
            "legendgroup": axis, "line": {"color": COLOURS[k], "width": 2, "dash": ("solid", "dash", "dot")[k]},
            "marker": {"size": 3},
            "connectgaps": False,
        })  # fmt: skip
        del wide
    layout = {
        "xaxis": time_axis(results.epoch_utc, t), "yaxis": {"title": {"text": "body rate (deg/s)"}},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom"}, "margin": {"l": 60, "r": 16, "t": 46, "b": 54},
    }  # fmt: skip
    sure = int((weight >= 0.9).sum())
    return Plot(
        id, data, layout, "The three components of the body rate against time, each with a band of two standard deviations.",
        f"Body rate of the likeliest motion of each pass, body axes; bands: {SIGMAS:g} standard deviations of that motion. It "
        f"holds at least 90 % of the weight in {sure} of {weight.size} passes; in the others look at the list of motions too."
        + (" Synthetic telemetry." if results.synthetic else ""), 400, narrow={"margin.l": 48},
    )  # fmt: skip


def trajectory(results: Results) -> Section | None:
    """Rates and wheel speeds of simulated motions that are no candidates of a study."""
    items: list[Any] = []
    for name, run in results.having("omega_B", "momentum_B", "wheel_speed_rad_s"):
        if not name.startswith("motion-"):
            items += [_rate_plot(results, run, name), *_wheel_plot(results, run, name)]
    if not items:
        return None
    return Section("trajectory", "Rates and wheel speeds", [], items)


def motion_picture(results: Results) -> Plot | None:
    """The rates of a simulated motion as the first picture."""
    for name, run in results.having("omega_B", "momentum_B", "wheel_speed_rad_s"):
        return _rate_plot(results, run, name)
    return None


def _rate_plot(results: Results, run: xr.Dataset, name: str) -> Plot:
    keep = thin(run.sizes["time"], MOST)
    t = run["time"].values[keep]
    data = [
        {"type": "scatter", "mode": "lines", "x": packed(t, "f8"), "y": packed(run["omega_B"].values[keep, k]), "name": f"ω{axis}",
         "line": {"color": COLOURS[k], "width": 1.8, "dash": ("solid", "dash", "dot")[k]}}
        for k, axis in enumerate("xyz")
    ]  # fmt: skip
    data.append({
        "type": "scatter", "mode": "lines", "x": packed(t, "f8"), "y": packed(np.linalg.norm(run["omega_B"].values[keep], axis=1)),
        "name": "|ω|",
        "line": {"color": "@ink", "width": 2.2},
    })  # fmt: skip
    layout = {
        "xaxis": {"title": {"text": "time (s)"}}, "yaxis": {"title": {"text": "body rate (rad/s)"}},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom"}, "margin": {"l": 60, "r": 16, "t": 46, "b": 54},
    }  # fmt: skip
    return Plot(
        f"run-{name}", data, layout, "Components and size of the body rate against time.",
        "Simulated body rate, body axes. A simulation has no error bar: it is as sure as the state that it was started from.", 400,
    )  # fmt: skip


def _wheel_plot(results: Results, run: xr.Dataset, name: str) -> list[Plot]:
    if not run.sizes.get("wheel"):
        return []
    keep = thin(run.sizes["time"], MOST)
    data = [
        {"type": "scatter", "mode": "lines", "x": packed(run["time"].values[keep], "f8"),
        "y": packed(run["wheel_speed_rad_s"].values[keep, k]),
         "name": str(wheel), "line": {"color": COLOURS[k % 7], "width": 2}, "showlegend": True}
        for k, wheel in enumerate(run["wheel"].values)
    ]  # fmt: skip
    layout = {
        "xaxis": {"title": {"text": "time (s)"}}, "yaxis": {"title": {"text": "wheel speed (rad/s)"}},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom"}, "margin": {"l": 60, "r": 16, "t": 46, "b": 54},
    }  # fmt: skip
    return [Plot(f"wheel-{name}", data, layout, "Speed of each wheel against time.", "Wheel speeds relative to the body.", 280)]

"""Why a direct fit fails after the touchdown: how E reacts to small changes, how EMD does, and why (paper, section 2.3, Fig. 8)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from scipy.signal import find_peaks

from sunspin.estimate.scan import error_growth as gr
from sunspin.estimate.scan.parameters import nominal
from sunspin.estimate.scan.volume import scan
from sunspin.output.figures import COLOURS, titled
from sunspin.philae import rebound as rb
from sunspin.philae.row import Row, row
from sunspin.telemetry.case import Case

MAP_POINTS = (151, 91)
"""Points of the map over rates: 3.3e-4 rad/s apart, a third of what turns a phase by one radian in 45 min."""

PARAMETER_POINTS = (71, 71)
"""Points of the map over mu_0 and theta_xx: phases differ by about 1.4 radian between neighbours. Each point is a vehicle of
its own and takes 4 ms, 30 times a point of the other map."""

VALLEY_RANGE_RAD_S = 0.05
VALLEY_POINTS = 1001
VALLEY_WINDOWS_MIN = (5.0, 15.0, 45.0)

VALLEY_DEPTH = 0.03
"""A minimum of E along a walk across a map is a valley if it is deeper than this: a tenth of what E ranges over."""

NEAR_POWER = 0.3
"""A power of time within this of 1 or 2 counts as linear or quadratic."""

LINE_OMEGA_Z = 0.1
"""rad/s at the first sample of the points of the published lines on which changes of one percent are tried."""


@dataclass(frozen=True)
class Sensitivity:
    """Maps of E as the paper draws them, and what they follow from.

    Attributes
    ----------
    rates : DataArray (omega_x, omega_y), panel A; `parameters`: DataArray (mu_0, theta_xx), panel B. E against the measured
        directions, with the direction at the start as the paper quotes it, whose length `start_length` is not one
    growth : list of Datasets of `error_growth.growth`: the rate of panel B, then a point of each published line
    changes : list of Datasets of `error_growth.one_percent`, of the same motions
    names : names of these motions
    valley : DataArray (window, change) of `error_growth.valleys`, for the rate of panel B
    """

    case: Case
    synthetic: bool
    n_samples: int
    start_length: float
    rates: xr.DataArray
    parameters: xr.DataArray
    growth: list[xr.Dataset]
    changes: list[xr.Dataset]
    names: list[str]
    valley: xr.DataArray


def compute(
    case: Case, sun: xr.Dataset, workers: int | None = None, coarser: int = 1
) -> Sensitivity:
    """Maps of E against the rebound's samples in `sun` (of `sun_directions`, whole landing); growth of errors.

    `coarser`: use every so many-th point of the maps.
    """
    published = {key: figure.value for key, figure in case.published.items()}
    vehicle, samples = case.vehicle, rb.rebound_samples(case, sun)
    speed, window = rb.nominal_speed(vehicle), rb.window_s(case)
    quoted = np.array(published["first_sun_E_study"])
    length = float(np.linalg.norm(quoted))
    box, omega = published["E_study_box"], np.array(published["E_study_omega"])
    counts = [max(n // coarser, 2) for n in (*MAP_POINTS, *PARAMETER_POINTS)]
    spans = (*box[:2], published["E_study_coulomb"], published["E_study_inertia"])
    omega_x, omega_y, mu_0, theta_xx = map(lambda span, n: np.linspace(*span, n), spans, counts)
    axes = [omega_x, omega_y, np.array(box[2][:1])]
    rates = scan(
        vehicle, samples, quoted / length, *axes, wheel_speed_rad_s=speed, workers=workers
    ).isel(omega_z=0)
    ranges = {"mu_0": mu_0, "theta_xx": theta_xx}
    study = gr.Motion.of(vehicle, omega, quoted, speed, window)
    parameters = gr.parameter_map(study, samples, ranges, workers)
    points = rb.on_lines(rb.published_lines(case), [LINE_OMEGA_Z])[:, 0]
    motions = {"Fig. 8 B": study} | {
        f"L{k}": gr.Motion.of(vehicle, start, rb.first_sun(case), speed, window)
        for k, start in enumerate(points, 1)
    }
    interval, windows = 60.0 * published["sampling_interval"], 60.0 * np.array(VALLEY_WINDOWS_MIN)
    n_changes = VALLEY_POINTS // coarser // 2 * 2 + 1
    change = np.linspace(-VALLEY_RANGE_RAD_S, VALLEY_RANGE_RAD_S, n_changes)
    return Sensitivity(
        case,
        bool(sun.attrs.get("synthetic")),
        int(np.isfinite(samples["sun_B"].values[:, 0]).sum()),
        length,
        gr.of_length(rates, length).assign_attrs(units="1"),
        gr.of_length(parameters, length).assign_attrs(units="1"),
        [gr.growth(motion) for motion in motions.values()],
        [gr.one_percent(motion, interval) for motion in motions.values()],
        list(motions),
        gr.valleys(study, change, windows, interval, workers),
    )


def valleys_crossed(values: np.ndarray) -> list[float]:
    """Valleys that a straight walk across a map (n, m) crosses along each axis: median over the walks.

    Minima of the map itself would count the steps of a grid over slanted valleys.
    """
    return [
        float(np.median([len(find_peaks(-walk, prominence=VALLEY_DEPTH)[0]) for walk in walks]))
        for walks in (values.T, values)
    ]


def rows(result: Sensitivity) -> list[Row]:
    """What the paper says of E and EMD in section 2.3, in numbers."""
    return [*_map_rows(result), *_change_rows(result)]


def _map_rows(r: Sensitivity) -> list[Row]:
    case, twin = r.case, "synthetic telemetry; " if r.synthetic else ""
    first, quoted = rb.first_sun(case), np.array(case.published["first_sun_E_study"].value)
    cosine = first @ quoted / np.linalg.norm(first) / np.linalg.norm(quoted)
    box, lines = np.mean(case.published["E_study_box"].value, axis=1), rb.published_lines(case)
    from_lines = [
        min(float(np.linalg.norm(np.cross(omega - point, along))) for point, along in lines)
        for omega in (box, np.array(case.published["E_study_omega"].value))
    ]
    of_rates, of_parameters = (
        [float(error.min()), float(error.max()), *valleys_crossed(error.values)]
        for error in (r.rates, r.parameters)
    )
    return [
        row(
            case,
            "E_map_rates",
            of_rates,
            twin=twin,
            directions=r.n_samples,
            motions=r.rates.size,
            apart=from_lines[0],
        ),
        row(
            case,
            "E_map_parameters",
            of_parameters,
            twin=twin,
            outside=nominal(case.vehicle, "mu_0"),
            apart=from_lines[1],
        ),
        row(
            case,
            "E_study_bound",
            (1 - r.start_length) / 2,
            length=r.start_length,
            apart=float(np.degrees(np.arccos(cosine))),
        ),
    ]


def _change_rows(r: Sensitivity) -> list[Row]:
    case, emd_min = r.case, r.case.published["emd_min"].value
    of_E, of_emd = ([float(table[of].max()) for table in r.changes] for of in ("E", "emd"))
    in_E, in_emd = min(of_E), max(of_emd)
    of_each = "; ".join(
        f"{name} {e:.2f} and {m:.4f}" for name, e, m in zip(r.names, of_E, of_emd, strict=True)
    )
    powers = np.array([table["power"].sel(input=list(gr.RATES)).values for table in r.growth])
    friction = np.array([float(table["power"].sel(input="mu_0")) for table in r.growth])
    linear, square = np.abs(powers - 1).max(), np.abs(friction - 2).max()
    last = [table["error_rad"].isel(time=-1) for table in r.growth]
    at_end = [float(error.max()) * gr.ONE_PERCENT for error in last]
    per_rate = np.array(
        [
            error.sel(input=list(gr.RATES)).values / table.attrs["angular_speed_rad_s"]
            for error, table in zip(last, r.growth, strict=True)
        ]
    )
    windows = ", ".join(f"{seconds / 60:g}" for seconds in r.valley["window"].values)
    return [
        row(case, "one_percent_E", in_E, agrees=in_E > 0.1, of_each=of_each),
        row(case, "one_percent_emd", in_emd, tolerance=emd_min, agrees=in_emd < emd_min),
        row(
            case,
            "phase_growth",
            [float(powers.mean()), float(friction.mean())],
            tolerance=NEAR_POWER,
            agrees=bool(max(linear, square) < NEAR_POWER),
            at_end=[min(at_end), max(at_end)],
            per_rate=[float(per_rate.min()), float(per_rate.max())],
        ),
        row(case, "valley_width", gr.valley_width(r.valley).tolist(), windows=windows),
    ]


def symbol(name: str) -> str:
    """An input as the paper writes it."""
    letter, index = name.replace("wheel_speed", "omega_rot").split("_")
    return f"$\\{letter}_{{{index}}}$"


def draw_maps(result: Sensitivity) -> Figure:
    """E over (omega_x, omega_y) and over (mu_0, theta_xx), the axes of the paper's Fig. 8."""
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    omega = ", ".join(f"{x:g}" for x in result.case.published["E_study_omega"].value)
    omega_z = float(result.rates["omega_z"])
    panels = (
        (result.rates, 1.0, rf"A: initial rates, $\omega_z$ = {omega_z:g} rad/s"),
        (result.parameters, 1e3, rf"B: parameters, $\omega(0)$ = [{omega}] rad/s"),
    )
    units = {"mu_0": "$10^{-3}$ N m", "theta_xx": "kg m$^2$"}
    for axes, (error, scale, title) in zip(figure.subplots(1, 2), panels, strict=True):
        x, y = map(str, error.dims)
        points = error[x].values * scale, error[y].values, error.transpose(y, x).values
        image = axes.pcolormesh(*points, shading="nearest", cmap="cividis_r", rasterized=True)
        figure.colorbar(image, ax=axes, label="E")
        labels = (f"{symbol(name)} ({units.get(name, 'rad/s')})" for name in (x, y))
        axes.set(**dict(zip(("xlabel", "ylabel"), labels, strict=True)))
        axes.set_title(title, fontsize=10)
    length = f"$|r(0)|$ = {result.start_length:.4f} as quoted"
    title = f"E against {result.n_samples} directions of the telemetry, {length}"
    figure.suptitle(titled(title, result.synthetic), fontsize=10)
    return figure


def draw_growth(result: Sensitivity) -> Figure:
    """Why the direct fit fails: errors grow with the window, the valley of E narrows, and EMD does not follow."""
    figure = Figure(figsize=(9.5, 9.0), layout="constrained")
    (grow, valley), (changes, width) = figure.subplots(2, 2)
    names, published = result.names, result.case.published
    emd_min, step = published["emd_min"].value, published["scan_step"].value

    table = result.growth[0]
    inputs, minutes = table["input"].values.tolist(), table["time"].values[1:] / 60
    for k, name in enumerate(inputs):
        error = gr.ONE_PERCENT * table["error_rad"].sel(input=name).values[1:]
        style = "-" if name in gr.RATES else "--" if name.startswith("theta") else ":"
        label = f"{symbol(name)}, power {float(table['power'].sel(input=name)):.1f}"
        colour = COLOURS[k] if k < len(COLOURS) else "#555555"
        grow.loglog(minutes, error, style, lw=1.3, color=colour, label=label)
    grow.axhline(1.0, lw=0.8, color=COLOURS[7])
    grow.text(0.13, 1.1, "one radian", fontsize=9, color="#555555")
    grow.set(xlabel="length of the window (min)", xlim=(0.1, None), ylim=(1e-4, 60))
    grow.set_ylabel("direction error of 1 %, to first order (rad)")
    below: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.16)}
    grow.legend(fontsize=9, ncols=2, frameon=False, **below)
    grow.set_title(f"growth of errors, rates of {names[0]}", fontsize=10)

    windows, change = result.valley["window"].values / 60, 1e3 * result.valley["change"].values
    for k, (window, error) in enumerate(zip(windows, result.valley.values, strict=True)):
        style = {"lw": 1.6 - 0.45 * k, "color": COLOURS[(5, 1, 6)[k % 3]], "zorder": 3 - k}
        valley.plot(change, error, label=f"{window:g} min", **style)
    valley.set(xlabel=r"change of $\omega_x$ (mrad/s)", ylabel="E")
    valley.set_ylim(0, 1.25 * float(result.valley.max()))
    inside: dict[str, Any] = {"title": "window", "title_fontsize": 9, "loc": "upper center"}
    valley.legend(fontsize=9, ncols=3, frameon=False, **inside)
    valley.set_title("E against the motion's own\ndirections, every 2 min", fontsize=10)

    for k, name in enumerate(names):
        place = np.arange(len(inputs)) + (k - (len(names) - 1) / 2) * 0.15
        in_E, in_emd = (result.changes[k][of].values for of in ("E", "emd"))
        changes.semilogy(place, in_E, "o", ms=5, color=COLOURS[k], label=name)
        changes.semilogy(place, in_emd, "^", ms=5, mfc="none", color=COLOURS[k])
        # of a rate: one radian over the growth of the error, both ways
        table = result.growth[k]
        steepest = table["error_rad"].sel(input=list(gr.RATES)).max("input").values[1:]
        narrow = 2 / (steepest / table.attrs["angular_speed_rad_s"])
        width.loglog(minutes, narrow, lw=1.2, color=COLOURS[k], label=name)
    changes.set_xticks(np.arange(len(inputs)), [symbol(name) for name in inputs])
    changes.axhline(emd_min, ls="--", lw=1, color=COLOURS[7])
    text = "smallest EMD of the paper's scan"
    changes.text(len(inputs) - 0.5, 1.1 * emd_min, text, ha="right", fontsize=9)
    changes.set(xlabel="input changed by 1 %", ylabel="E (filled), EMD (open)", ylim=(5e-4, 2.5))
    changes.legend(fontsize=9, ncols=len(names), loc="upper center")
    changes.set_title("E and EMD between a motion\nand the changed one, 45 min", fontsize=10)

    width.axhline(step, ls="--", lw=1, color=COLOURS[7])
    at: dict[str, Any] = {"ha": "right", "transform": width.get_yaxis_transform()}
    width.text(0.98, 1.12 * step, "step of the paper's scan", fontsize=9, **at)
    width.set(xlabel="length of the window (min)", xlim=(0.5, 50), ylim=(5e-4, 1))
    width.set_ylabel("width of one radian in a rate (rad/s)")
    width.legend(fontsize=9)
    width.set_title("how near a rate must be\nto fit the whole window", fontsize=10)
    title = "Why a direct fit fails after the touchdown (simulated motions only)"
    figure.suptitle(title, fontsize=11)
    return figure

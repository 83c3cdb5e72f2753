"""Philae after the first touchdown: how E reacts to small changes, how EMD does, and why (paper, section 2.3, Fig. 8)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.signal import find_peaks

from sunspin.estimate.scan import error_growth as gr
from sunspin.estimate.scan.parameters import nominal
from sunspin.estimate.scan.volume import scan
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
        directions, with the direction at the start as the paper quotes it, whose length is not one
    growth : list of Datasets of `growth.growth`: the rate of panel B, then a point of each published line
    changes : list of Datasets of `growth.one_percent`, of the same motions
    names : names of these motions
    valley : DataArray (window, change) of `growth.valleys`, for the rate of panel B
    """

    case: Case
    synthetic: bool
    n_samples: int
    rates: xr.DataArray
    parameters: xr.DataArray
    growth: list[xr.Dataset]
    changes: list[xr.Dataset]
    names: list[str]
    valley: xr.DataArray

    @property
    def start_length(self) -> float:
        """Length of the direction at the start as quoted."""
        return float(np.linalg.norm(self.case.published["first_sun_E_study"].value))


def compute(
    case: Case, sun: xr.Dataset, workers: int | None = None, coarser: int = 1
) -> Sensitivity:
    """Maps of E against the rebound's samples in `sun` (of `sun_directions`, whole landing); growth of errors.

    `coarser`: use every so many-th point of the maps.
    """
    published = {key: figure.value for key, figure in case.published.items()}
    vehicle, samples = case.vehicle, rb.rebound_samples(case, sun)
    quoted = np.array(published["first_sun_E_study"])
    length = float(np.linalg.norm(quoted))
    speed, window = rb.nominal_speed(vehicle), rb.window_s(case)
    box, omega = published["E_study_box"], np.array(published["E_study_omega"])
    counts = [max(n // coarser, 2) for n in (*MAP_POINTS, *PARAMETER_POINTS)]
    axes = [_even(box[0], counts[0]), _even(box[1], counts[1]), np.array(box[2][:1])]
    rates = scan(
        vehicle, samples, quoted / length, *axes, wheel_speed_rad_s=speed, workers=workers
    ).isel(omega_z=0)
    ranges = {
        "mu_0": _even(published["E_study_coulomb"], counts[2]),
        "theta_xx": _even(published["E_study_inertia"], counts[3]),
    }
    motions = {"Fig. 8 B": gr.Motion.of(vehicle, omega, quoted, speed, window)}
    parameters = gr.parameter_map(motions["Fig. 8 B"], samples, ranges, workers)
    for k, (point, direction) in enumerate(rb.published_lines(case)):
        start = rb.point_at(point, direction, 2, np.array([LINE_OMEGA_Z]))[0]
        motions[f"L{k + 1}"] = gr.Motion.of(vehicle, start, rb.first_sun(case), speed, window)
    interval = 60.0 * published["sampling_interval"]
    change = np.linspace(
        -VALLEY_RANGE_RAD_S, VALLEY_RANGE_RAD_S, VALLEY_POINTS // coarser // 2 * 2 + 1
    )
    return Sensitivity(
        case,
        bool(sun.attrs.get("synthetic")),
        int(np.isfinite(samples["sun_B"].values[:, 0]).sum()),
        gr.of_length(rates, length).assign_attrs(units="1"),
        gr.of_length(parameters, length).assign_attrs(units="1"),
        [gr.growth(motion) for motion in motions.values()],
        [gr.one_percent(motion, interval) for motion in motions.values()],
        list(motions),
        gr.valleys(
            motions["Fig. 8 B"], change, 60.0 * np.array(VALLEY_WINDOWS_MIN), interval, workers
        ),
    )


def _even(span: tuple[float, float], count: int) -> np.ndarray:
    low, high = span
    return np.linspace(low, high, count)


def valleys_crossed(values: np.ndarray) -> list[float]:
    """Valleys that a straight walk across a map (n, m) crosses along each axis: median over the walks.

    Minima of the map itself would count the steps of a grid over slanted valleys.
    """
    walks = values.T, values
    return [
        float(np.median([len(find_peaks(-walk, prominence=VALLEY_DEPTH)[0]) for walk in along]))
        for along in walks
    ]


def rows(result: Sensitivity) -> list[Row]:
    """What the paper says of E and EMD in section 2.3, in numbers."""
    return [*_map_rows(result), *_change_rows(result)]


def _map_rows(r: Sensitivity) -> list[Row]:
    case, rates, parameters = r.case, r.rates.values, r.parameters.values
    twin = "synthetic telemetry; " if r.synthetic else ""
    bound, published = (
        (1 - r.start_length) / 2,
        {key: figure.value for key, figure in case.published.items()},
    )
    studied = np.mean(published["E_study_box"], axis=1), np.array(published["E_study_omega"])
    from_lines = [_distance_from_lines(case, omega) for omega in studied]
    return [
        row(
            case,
            "E_map_rates",
            [float(rates.min()), float(rates.max()), *valleys_crossed(rates)],
            twin=twin,
            directions=r.n_samples,
            motions=rates.size,
            apart=from_lines[0],
        ),
        row(
            case,
            "E_map_parameters",
            [float(parameters.min()), float(parameters.max()), *valleys_crossed(parameters)],
            twin=twin,
            outside=nominal(case.vehicle, "mu_0"),
            apart=from_lines[1],
        ),
        row(case, "E_study_bound", bound, length=r.start_length, apart=_angle_between_starts(case)),
    ]


def _distance_from_lines(case: Case, omega_B: np.ndarray) -> float:
    distances = [
        np.linalg.norm(np.cross(np.asarray(omega_B) - point, along))
        for point, along in rb.published_lines(case)
    ]
    return float(min(distances))


def _angle_between_starts(case: Case) -> float:
    first, quoted = rb.first_sun(case), np.array(case.published["first_sun_E_study"].value)
    return float(
        np.degrees(np.arccos(first @ quoted / np.linalg.norm(first) / np.linalg.norm(quoted)))
    )


def _change_rows(r: Sensitivity) -> list[Row]:
    largest_E = [float(table["E"].max()) for table in r.changes]
    largest_emd = [float(table["emd"].max()) for table in r.changes]
    in_E, in_emd = min(largest_E), max(largest_emd)
    at_end = [float(table["error_rad"].isel(time=-1).max()) * gr.ONE_PERCENT for table in r.growth]
    powers = np.array(
        [[float(table["power"].sel(input=name)) for name in gr.RATES] for table in r.growth]
    )
    friction = np.array([float(table["power"].sel(input="mu_0")) for table in r.growth])
    widths = gr.valley_width(r.valley)
    window = r.valley["window"].values / 60
    per_rate = [
        float(table["error_rad"].sel(input=name).isel(time=-1)) / table.attrs["angular_speed_rad_s"]
        for table in r.growth
        for name in gr.RATES
    ]
    of_each = "; ".join(
        f"{n} {e:.2f} and {m:.4f}" for n, e, m in zip(r.names, largest_E, largest_emd, strict=True)
    )
    case, emd_min = r.case, r.case.published["emd_min"].value
    return [
        row(case, "one_percent_E", in_E, agrees=in_E > 0.1, of_each=of_each),
        row(case, "one_percent_emd", in_emd, tolerance=emd_min, agrees=in_emd < emd_min),
        row(
            case,
            "phase_growth",
            [float(powers.mean()), float(friction.mean())],
            tolerance=NEAR_POWER,
            agrees=bool(
                np.abs(powers - 1).max() < NEAR_POWER and np.abs(friction - 2).max() < NEAR_POWER
            ),
            at_end=[min(at_end), max(at_end)],
            per_rate=[min(per_rate), max(per_rate)],
        ),
        row(case, "valley_width", widths.tolist(), windows=", ".join(f"{w:g}" for w in window)),
    ]

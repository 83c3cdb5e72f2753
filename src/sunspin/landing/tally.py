"""Probabilities and densities of runs, each with its standard error; runs may have weights.

Collisions weighted by their known speeds are a Dataset of their own (kind "collision").
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.landing.contact import KINDS

LOW_RZ = (-0.5, -0.2, 0.0)
"""Bounds of r_z that the paper uses."""

TRUTHS = ("touch_", "rest_", "rz_ever_", "antenna_at_")
"""Prefixes of quantities of `per_run` that are true or false in each run."""


class Quantity(NamedTuple):
    """Text for a quantity: its meaning in words, its unit (empty: a probability or a share), and displayed over stored value."""

    text: str
    unit: str = ""
    scale: float = 1.0

    @property
    def heading(self) -> str:
        """Meaning and unit."""
        return f"{self.text}, {self.unit}" if self.unit else self.text


DEGREES = 180.0 / np.pi

QUANTITIES = {
    "touch_leg": Quantity("a leg touches first"),
    "touch_panel": Quantity("a panel touches first"),
    "touch_body": Quantity("the bare body touches first"),
    "rest_leg": Quantity("comes to rest on its legs"),
    "rest_panel": Quantity("comes to rest on a panel"),
    "rest_body": Quantity("comes to rest on the bare body"),
    "leg_tip_speed": Quantity("fastest leg tip at first contact", "m/s"),
    "leg_tip_bound": Quantity("bound on the speed of a leg tip", "m/s"),
    "contact_speed": Quantity("speed of the point that touches first", "m/s"),
    "velocity_change": Quantity("change of velocity at the collision", "m/s"),
    "speed_after": Quantity("speed after the collision", "m/s"),
    "up_z": Quantity("cosine of the z axis to the ground's normal at contact"),
    "antenna_share": Quantity("orbiter in the antenna cone, share of the time"),
    "antenna_at_contact": Quantity("orbiter in the antenna cone at contact"),
    "antenna_at_rest": Quantity("orbiter in the antenna cone at rest"),
    "rz_time_below_-0.5": Quantity(
        "Sun more than 120 deg from the z axis (r_z below -0.5), share of the time"
    ),
    "rz_time_below_-0.2": Quantity("r_z below -0.2, share of the time"),
    "rz_time_below_0": Quantity("Sun below the body's equator (r_z below 0), share of the time"),
    "rz_ever_below_-0.5": Quantity("r_z ever below -0.5"),
    "rz_ever_below_-0.2": Quantity("r_z ever below -0.2"),
    "rz_ever_below_0": Quantity("r_z ever below 0"),
    "rate_before": Quantity("angular speed before the collision", "deg/s", DEGREES),
    "rate_after": Quantity("angular speed after the collision", "deg/s", DEGREES),
}
"""Quantity of `per_run` -> its text, in the order in which they are listed; files have angular speeds in rad/s."""

ONE_PANEL = "touch_panel_"
"""Prefix of the quantity of a single panel; the name of the panel follows."""


def quantity(name: str) -> Quantity:
    """Return the text for a quantity of `per_run`."""
    if name.startswith(ONE_PANEL):
        return Quantity(f"panel {name.removeprefix(ONE_PANEL)} touches first")
    return QUANTITIES.get(name, Quantity(name.replace("_", " ")))


class Estimate(NamedTuple):
    """A mean over runs and its standard error."""

    value: float
    error: float

    def __str__(self) -> str:
        return f"{self.value:.4f} +- {self.error:.4f}"


def estimate(values: npt.ArrayLike, weights: npt.ArrayLike | None = None) -> Estimate:
    """Return the weighted mean of values (n) and its standard error sqrt(sum w^2 (x - mean)^2) / sum w, without values NaN.

    For equal weights the error is that of the mean of n runs (with n, not n - 1); for truth values sqrt(p (1 - p) / n). The error
    of a single value is NaN.
    """
    x = np.asarray(values, dtype=np.float64)
    w = np.ones_like(x) if weights is None else np.asarray(weights, dtype=np.float64)
    if x.shape != w.shape or x.ndim != 1 or np.any(w < 0):
        what = "an estimate needs values (n) and as many weights, none negative"
        raise InputError(what, got=(x.shape, w.shape))
    use = np.isfinite(x) & (w > 0)
    if not use.any():
        return Estimate(np.nan, np.nan)
    x, w = x[use], w[use]
    mean = float(w @ x / w.sum())
    error = float(np.sqrt(w**2 @ (x - mean) ** 2) / w.sum())
    return Estimate(mean, error if x.size > 1 else np.nan)


def probability(happened: npt.ArrayLike, weights: npt.ArrayLike | None = None) -> Estimate:
    """Return the weighted share of truth values (n), without values NaN, and its standard error.

    The error is that of `estimate`, unless the event happened in all runs or in none. It is then not certain: the error is that of
    a share of (k + 1) / (n + 2) for k of n runs (rule of succession), which is about 1 / n.
    """
    x = np.asarray(happened, dtype=np.float64)
    share = estimate(x, weights)
    if share.value not in (0.0, 1.0):
        return share
    n = effective_runs(np.isfinite(x) * (1.0 if weights is None else np.asarray(weights)))
    # p = 1 / (n + 2) or (n + 1) / (n + 2): both have sqrt(p (1 - p) / n)
    return Estimate(share.value, float(np.sqrt((n + 1) / n) / (n + 2)))


def effective_runs(weights: npt.ArrayLike) -> float:
    """Return the effective sample size of weighted runs, (sum w)^2 / sum w^2 (Kish); 0 without a positive weight."""
    w = np.asarray(weights, dtype=np.float64)
    return float(w.sum() ** 2 / np.sum(w**2)) if np.any(w > 0) else 0.0


def density(runs: xr.Dataset, merge: int = 1) -> xr.Dataset:
    """Return the probability density of r_z over time and runs (area 1; paper, Fig. 13).

    Parameters
    ----------
    merge : int
        Number of bins of the runs that become one bin; a divisor of their number.

    Returns
    -------
    xarray.Dataset
        `density (rz)` and its Monte Carlo standard error `error (rz)`. Runs, not instants, are independent: the error is
        that of a mean over runs. Errors of neighbouring bins are correlated.
    """
    share = runs["rz_share"].values.astype(np.float64)
    share = share.reshape(len(share), -1, merge).sum(axis=2)  # (run, merged bin)
    width = 2.0 / share.shape[1]
    value, error = np.array([estimate(column) for column in share.T]).T / width
    return xr.Dataset(
        {
            "density": ("rz", value, {"units": "1"}),
            "error": ("rz", error, {"units": "1"}),
        },
        coords={"rz": ("rz", runs["rz"].values.reshape(-1, merge).mean(axis=1), runs["rz"].attrs)},
        attrs={"strategy": runs.attrs["strategy"], "runs": runs.sizes["run"]},
    )


def tally(runs: xr.Dataset, weights: npt.ArrayLike | None = None) -> dict[str, Estimate]:
    """Return the probability or mean of each quantity of `per_run`; quantities that are unknown in all runs are left out."""
    estimates = {
        name: (probability if name.startswith(TRUTHS) else estimate)(values, weights)
        for name, values in per_run(runs).items()
    }
    return {name: each for name, each in estimates.items() if np.isfinite(each.value)}


def per_run(runs: xr.Dataset) -> dict[str, np.ndarray]:
    """Return the quantities of each run: name -> values (n), which are truth values, shares of time or numbers; NaN if unknown.

    `touch_leg`, `touch_panel`, `touch_body`: the part that touches the ground first; `touch_panel_NAME`: the panel that does (a
    corner shared by panels counts for each); `rest_leg`, `rest_panel`, `rest_body`: the part on which the vehicle rests;
    `rz_time_below_X`: share of the time; `rz_ever_below_X`; `antenna_share`, `antenna_at_contact`, `antenna_at_rest`; speeds
    (m/s); `rate_before`, `rate_after` (rad/s).
    """
    values: dict[str, np.ndarray] = {}
    share = runs["rz_share"].values.astype(np.float64)
    upper_edges = (
        runs["rz"].values + 1.0 / share.shape[1]
    )  # middles plus half a width: [-1, 1] over the number of bins
    for bound in LOW_RZ:
        share_below = share[:, upper_edges <= bound + 1e-9].sum(axis=1)
        share_below = np.where(np.isfinite(share).all(axis=1), share_below, np.nan)
        values[f"rz_time_below_{bound:g}"] = share_below
        values[f"rz_ever_below_{bound:g}"] = np.where(
            np.isnan(share_below), np.nan, share_below > 0
        )
    for when in ("before", "after"):
        values[f"rate_{when}"] = np.linalg.norm(runs[f"omega_{when}_B"].values, axis=1)
    for name in (str(name) for name in runs.data_vars if name in QUANTITIES):
        stored = runs[name].values
        # whole numbers mark unknown values by -1
        unknown = np.isnan(stored) if stored.dtype.kind == "f" else stored < 0
        values[name] = np.where(unknown, np.nan, stored)
    for prefix, number, kind_coordinate in (
        ("touch", "contact_point", "point_kind"),
        ("rest", "rest_facet", "facet_kind"),
    ):
        if kind_coordinate in runs.coords:
            index, kinds = runs[number].values, runs[kind_coordinate].values
            for kind in (kind for kind in KINDS if kind in kinds):
                values[f"{prefix}_{kind}"] = np.where(index < 0, np.nan, kinds[index] == kind)
    if "point_on_panel" in runs.coords:
        index = runs["contact_point"].values
        on_panel = runs["point_on_panel"].values[index].astype(float)
        for panel, touches in zip(runs["panel"].values, on_panel.T, strict=True):
            values[f"{ONE_PANEL}{panel}"] = np.where(index < 0, np.nan, touches)
    return values


def lowest_rz(runs: xr.Dataset) -> np.ndarray:
    """Return the lower edge (n) of the lowest bin of r_z that each run reaches; NaN if the run has no r_z."""
    share = runs["rz_share"].values
    half_width = 1.0 / share.shape[1]  # of the bins that divide [-1, 1]
    edge = runs["rz"].values[np.argmax(share > 0, axis=1)] - half_width
    return np.where(np.isnan(share[:, 0]), np.nan, edge)


def read_facts(tally: Any) -> dict[str, float]:
    """Return the values that the trajectory kernel gives for the collision (name -> value), from a Dataset of kind "collision"."""
    values = tally["fact_value"].values.tolist()
    return dict(zip(tally["fact"].values.tolist(), values, strict=True))


def read_weightings(tally: Any) -> list[dict[str, Any]]:
    """Return a dict for each weighting of a Dataset of kind "collision": its `name`, and each quantity as an `Estimate`.

    Quantities that are not means are plain numbers.
    """
    without_error = ("effective_runs", "median_period_after")
    weightings = []
    for i, name in enumerate(tally["weighting"].values):
        weighting: dict[str, Any] = {"name": str(name)}
        for j, key in enumerate(tally["quantity"].values.tolist()):
            value, error = float(tally["value"][i, j]), float(tally["error"][i, j])
            weighting[key] = value if key in without_error else Estimate(value, error)
        weightings.append(weighting)
    return weightings


def read_explained_share(tally: Any) -> Estimate:
    """Return the share of the drawn collisions that come near the trajectory's speeds, from a Dataset of kind "collision"."""
    return Estimate(float(tally["explained"]), float(tally["explained_error"]))

"""Verdicts of `rates` on satellites with wings, cants and wheels whose file has two panel columns exchanged, or a wheel reversed.

The simulator shares no code with the package: it has its own Runge-Kutta integration of a rigid body with wheels of constant speed,
and flat panels of cosine response. Each satellite is also estimated with its right columns; then nothing may be accused.
"""

from __future__ import annotations

import json
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

import sunspin as ss
from sunspin.base.errors import SunspinError
from sunspin.vehicle import TelemetryForm
from validation.truths import is_wrong

EXCHANGES, SAMPLES = 2, 32
"""Number of exchanges drawn for each satellite, and of samples in each file."""

WHEEL_REVERSED = -2
"""Number of the exchange that stands for a first wheel whose axis the file has the other way round."""

HIDDEN = -3
"""Number of the exchange that stands for that of :func:`hidden_exchange`."""

QUICK = tuple(range(0, 60, 5))
"""A dozen satellites for a quick run."""

NOISE = 0.01
"""One sigma of a reading, as a part of the full signal of a panel of gain one; also the relative error of the gains."""

ALIKE = 0.02
"""Largest difference of normals (unit vectors), moments and wheels (relative) that are judged as equal."""

LIT = 0.08
"""Least reading, as a part of full Sun, of a column that is judged as lit."""

FACES = np.vstack([np.eye(3), -np.eye(3)])
NAMES = ("+X", "+Y", "+Z", "-X", "-Y", "-Z")


class Satellite(NamedTuple):
    """A simulated satellite: `names`, `normals` (n_panel, 3) and `gains` (n_panel) of the panels; `inertia` (3, 3) of the file, kg
    m2.

    `momenta` (n_wheel, 3) of the wheels, N m s; times `t_s` (n), s; `readings` (n, n_panel) of the panels in the file's order; true
    rates `omega` (n, 3), rad/s.
    """

    names: tuple[str, ...]
    normals: np.ndarray
    gains: np.ndarray
    inertia: np.ndarray
    momenta: np.ndarray
    t_s: np.ndarray
    readings: np.ndarray
    omega: np.ndarray


def _unit(vector: Any) -> np.ndarray:
    """Return the unit vector along a vector."""
    return np.asarray(vector, dtype=float) / np.linalg.norm(vector)


def _panels(rng: np.random.Generator) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Draw names, normals (n, 3) and gains (n) of 4 to 9 panels: sides, some missing and some canted, and mirrored pairs of wings.

    Sides are named by axis or "S" and a number, wings "W".
    """
    wings = int(rng.choice([0, 0, 1, 2]))
    count = int(rng.integers(max(4, 3 + 2 * wings), 10))
    kept = np.sort(rng.permutation(6)[: min(count - 2 * wings, 6)])
    names, normals = [NAMES[k] for k in kept], [FACES[k] for k in kept]
    while len(names) + 2 * wings < count:  # more than six: sides of an octagon
        side = _unit([*rng.choice([-1.0, 1.0], 2), 0.0])
        is_new = np.abs(np.array(normals) - side).max(axis=1).min() >= 0.1
        if is_new:
            normals.append(side)
            names.append(f"S{len(names)}")
    if rng.uniform() < 0.4:
        for k in range(len(normals)):
            if rng.uniform() < 0.4:
                normals[k] = _unit(
                    normals[k] + np.tan(np.radians(rng.uniform(10, 30))) * _unit(rng.normal(size=3))
                )
    for k in range(wings):
        # axes: across the plane between the two wings, along the hinge, and that which the wings face most
        side, along, up = rng.permutation(3)
        wing = np.zeros(3)
        wing[side], wing[along], wing[up] = (
            rng.uniform(0.3, 0.7),
            rng.uniform(-0.2, 0.2),
            rng.choice([-1, 1]) * rng.uniform(0.6, 1),
        )
        mirror = np.ones(3)
        mirror[side] = -1
        normals += [_unit(wing), _unit(wing * mirror)]
        names += [f"W{k}a", f"W{k}b"]
    # half of the satellites have other gains on each pair of opposite sides
    gain_of_axis = rng.uniform(1.0, 3.0, 3) if rng.uniform() < 0.5 else np.ones(3)
    gains = np.array(
        [
            gain_of_axis[np.argmax(np.abs(normal))] if name[0] in "+-" else 2.0
            for name, normal in zip(names, normals, strict=True)
        ]
    )
    return names, np.array(normals), gains


def _integrate(
    inertia: np.ndarray, wheel: np.ndarray, omega: np.ndarray, sun: np.ndarray, t_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return rates and Sun directions (n, 3) at times (n), from `omega` and `sun` (3) at the first.

    The wheels' momentum `wheel` (3) is constant in the body. Runge-Kutta steps of 0.25 s: dH/dt = H x omega, ds/dt = s x omega.
    """
    inverse = np.linalg.inv(inertia)

    def slope(y: np.ndarray) -> np.ndarray:
        """Return the derivatives (2, 3) of H and s."""
        rate = inverse @ (y[0] - wheel)
        return np.stack([np.cross(y[0], rate), np.cross(y[1], rate)])

    y, rates, suns = np.stack([inertia @ omega + wheel, sun]), [], []
    for k, t in enumerate(t_s):
        span = t - (t_s[k - 1] if k else t)
        for _ in range(int(np.ceil(span / 0.25))):
            h = span / np.ceil(span / 0.25)
            a = slope(y)
            b = slope(y + h / 2 * a)
            c = slope(y + h / 2 * b)
            y = y + h / 6 * (a + 2 * b + 2 * c + slope(y + h * c))
        rates.append(inverse @ (y[0] - wheel))
        suns.append(_unit(y[1]))
    return np.array(rates), np.array(suns)


def draw_satellite(seed: int, i: int) -> Satellite:
    """Draw satellite number `i` and its telemetry; every second one has a wheel, every eighth two.

    It is drawn again if its panels are nearly in one plane, its moments are hardly possible, or too few samples have two lit
    panels. The true inertia differs from that of the file by 1 % and a rotation of about a degree.
    """
    for attempt in range(100):
        rng = np.random.default_rng([43, seed, i, attempt])
        names, normals, gains = _panels(rng)
        if np.linalg.svd(normals, compute_uv=False)[2] < 0.3:
            continue
        moments = 0.04 * rng.uniform(0.5, 1.0, 3)
        moments[2] = moments[1] if rng.uniform() < 0.2 else moments[2]
        if moments.max() > 0.95 * (moments.sum() - moments.max()):  # triangle inequality
            continue
        omega = np.radians(10 ** rng.uniform(-0.2, 0.6)) * _unit(rng.normal(size=3))
        count = 2 if i % 8 == 7 else i % 2
        axes = [
            np.eye(3)[rng.integers(3)] if rng.uniform() < 0.7 else _unit(rng.normal(size=3))
            for _ in range(count)
        ]
        momenta = np.array(
            [moments.mean() * np.radians(rng.uniform(2, 8)) * axis for axis in axes]
        ).reshape(-1, 3)
        small_rotation = np.cross(np.eye(3), np.radians(1.0) * rng.normal(size=3)) + np.eye(3)
        q, r = np.linalg.qr(small_rotation)
        rotation = q * np.sign(np.diag(r))  # the nearby orthogonal matrix
        true_moments = np.diag(moments * (1 + 0.01 * rng.normal(size=3)))
        true_inertia = rotation @ true_moments @ rotation.T
        t_s = np.round(np.cumsum(rng.uniform(8.0, 16.0, SAMPLES)), 1)
        rates, sun = _integrate(
            true_inertia, momenta.sum(axis=0), omega, _unit(rng.normal(size=3)), t_s - t_s[0]
        )
        light = gains * (1 + NOISE * rng.normal(size=len(gains))) * np.maximum(sun @ normals.T, 0.0)
        readings = np.maximum(light + NOISE * rng.normal(size=light.shape), 0.0)
        if ((readings > LIT * gains).sum(axis=1) >= 2).mean() > 0.7:  # enough to see a motion
            return Satellite(
                tuple(names),
                normals,
                gains,
                np.diag(moments),
                momenta,
                t_s - t_s[0],
                readings,
                rates,
            )
    raise RuntimeError(f"satellite {i} of seed {seed} could not be drawn")


def draw_exchanges(seed: int, i: int, normals: np.ndarray) -> list[tuple[int, int]]:
    """Draw two pairs of columns, exchanged one at a time: any two, and two that are mirror images along an axis."""
    pairs = list(combinations(range(len(normals)), 2))
    drawn = [pairs[k] for k in np.random.default_rng([44, seed, i]).permutation(len(pairs))]
    # normals of mirror images differ in one component
    mirrored = [(a, b) for a, b in drawn if (np.abs(normals[a] - normals[b]) > ALIKE).sum() == 1]
    second = next(pair for pair in [*mirrored, *drawn] if pair != drawn[0])
    return [drawn[0], second]


def hidden_exchange(craft: Satellite) -> tuple[int, int]:
    """Return the two columns whose exchange the samples, each by itself, show least, of those that are not equivalent.

    A sample shows an exchange by the least squared distance of its readings from those that any direction of the Sun gives.
    """
    sun = np.random.default_rng(45).normal(size=(2000, 3))
    sun /= np.linalg.norm(sun, axis=1, keepdims=True)
    light = np.maximum(sun @ craft.normals.T, 0.0)
    shown = {}
    for a, b in combinations(range(len(craft.names)), 2):
        order = np.arange(len(craft.names))
        order[[a, b]] = b, a
        if not equivalents(craft, order, craft.momenta):
            read = craft.readings[:, order] / craft.gains
            square = ((read[:, None] - light) ** 2).sum(axis=2)  # (n, direction)
            shown[a, b] = float(square.min(axis=1).sum())
    return min(shown, key=lambda pair: shown[pair])


def files(
    craft: Satellite, order: np.ndarray, momenta: np.ndarray
) -> tuple[ss.Vehicle, xr.Dataset]:
    """Return vehicle and telemetry of a satellite as its files have them.

    `order` (n_panel): panel whose readings stand in each column; `momenta` (n_wheel, 3): of the wheels as the file states them.
    """
    vehicle = ss.Vehicle(
        "satellite",
        inertia_kg_m2=craft.inertia,
        gain_unit="W",
        panels=[
            ss.Panel(*panel) for panel in zip(craft.names, craft.normals, craft.gains, strict=True)
        ],
        wheels=[
            ss.Wheel(f"wheel {k}", _unit(h), 1e-4, float(np.linalg.norm(h)) / 1e-4)
            for k, h in enumerate(momenta)
        ],
        telemetry=TelemetryForm(noise=NOISE),
    )
    data = xr.Dataset(
        {
            "power_W": (("time", "panel"), craft.readings[:, order], {"units": "W"}),
            "flag": ("time", np.zeros(SAMPLES, dtype=int)),
        },
        {"time": craft.t_s, "panel": list(craft.names)},
        {"synthetic": 1},
    )
    return vehicle, data


def run(case: tuple[int, int, int]) -> dict[str, Any]:
    """Run `rates` on a case (seed, satellite, exchange) and return its verdict and whether that is true.

    Exchange -1 is the right file, `WHEEL_REVERSED` one with a reversed wheel, `HIDDEN` that of :func:`hidden_exchange`. Outcomes
    are the keys of `validation.areas._EXCHANGES`.
    """
    seed, i, which = case
    craft = draw_satellite(seed, i)
    pair = None if which < 0 else draw_exchanges(seed, i, craft.normals)[which]
    if which == HIDDEN:
        pair = hidden_exchange(craft)
    order = np.arange(len(craft.names))
    if pair is not None:
        order[list(pair)] = order[list(pair)][::-1]
    momenta = craft.momenta.copy()  # as the file states them
    if which == WHEEL_REVERSED:
        momenta[0] *= -1
    vehicle, data = files(craft, order, momenta)
    row: dict[str, Any] = {"pair": None if pair is None else [craft.names[k] for k in pair]}
    try:
        # column tests try reversed wheels too: without them the set sees whether each wheel's sign is tried by itself
        tested = which != WHEEL_REVERSED
        result = ss.rates(vehicle, data, max_rate_rad_s=0.09, column_tests=tested)
    except SunspinError as error:
        return row | {"outcome": "refused", "verdict": str(error)}
    row |= {
        "verdict": result.attrs["verdict"],
        "fits": bool(result["fits"].values[0]),
        "decided": bool(result["decided"].values[0]),
    }
    changes = json.loads(result.attrs.get("columns_changes", "[]"))
    row["named"] = [change["what"] for change in changes]
    truth = None
    if which == WHEEL_REVERSED:
        truth = "wheel wheel 0 turning the other way"
    elif pair is not None:
        a, b = (craft.names[k] for k in pair)
        truth = f"the columns of panels {a} and {b} exchanged"
    return row | _classify(craft, order, momenta, truth, result, row)


def _classify(
    craft: Satellite,
    order: np.ndarray,
    momenta: np.ndarray,
    truth: str | None,
    result: Any,
    row: dict[str, Any],
) -> dict[str, Any]:
    """Return the outcome, and "pull", the least normalised error of the rate against the truth and equivalent motions.

    `order`: panel that each column reads; `momenta` (n_wheel, 3) of the wheels in the file; `truth`: what is wrong with the file,
    None for a right one; `row`: verdict and named changes.
    """
    omega, sigma = (
        np.array([result[f"{name}_{axis}"].values[0, 0] for axis in "xyz"])
        for name in ("omega", "sigma")
    )
    # the rates of a pass are those at the sample nearest to its middle
    t = result["time"].values[result["pass_of"].values == 0]
    middle_s = t[np.argmin(np.abs(t - (t[0] + t[-1]) / 2))]
    true_rate = craft.omega[int(np.argmin(np.abs(craft.t_s - middle_s)))]
    alike = equivalents(craft, order, momenta)
    # rates are an axial vector: a mirror also changes their sign
    motions = [true_rate, *(np.linalg.det(m) * m @ true_rate for m in alike)]
    wrong = [is_wrong(omega, sigma, motion) for motion in motions]
    pulls = [float((np.abs(omega - motion) / sigma).max()) for motion in motions]
    named, accused = row["named"], "CHECK" in row["verdict"]
    if row["decided"] and all(wrong):
        outcome = "decided wrongly"
    elif truth is None:
        if named or accused:
            outcome = "accused"
        else:
            outcome = "decided" if row["decided"] else "undecided"
    elif named:
        if truth not in named:
            outcome = "a false change named"
        else:
            outcome = "named rightly" if named == [truth] else "named among several"
    elif accused:
        outcome = "named rightly" if truth in row["verdict"] else "a false change named"
    else:
        within = "decided, and right within its errors" if row["decided"] else "undecided"
        outcome = "equivalent" if alike else within
    return {"outcome": outcome, "pull": min(pulls)}


def equivalents(craft: Satellite, order: np.ndarray, momenta: np.ndarray) -> list[np.ndarray]:
    """Return rotations and mirrors (3, 3) that make the true satellite look like the one that the file describes.

    Column k reads panel `order[k]`, and the file takes it for panel k; it has wheels of these `momenta` (n_wheel, 3). Only panels
    that are lit at some sample count. Each matrix takes the true normals, inertia and wheels to those of the file within `ALIKE`
    (3 % for the inertia, 15 % for gains).
    """
    lit = (craft.readings[:, order] > LIT * craft.gains[order]).any(axis=0)
    true, stated = craft.normals[order][lit], craft.normals[lit]
    if np.abs(craft.gains[order][lit] / craft.gains[lit] - 1).max() > 0.15:
        return []
    # orthogonal matrix that fits the normals best (Procrustes); for normals in one plane its mirror fits as well
    u, singular, v = np.linalg.svd(stated.T @ true)
    signs = [1.0, -1.0] if singular[2] < 0.05 else [1.0]
    result = []
    for sign in signs:
        m = u @ np.diag([1.0, 1.0, sign]) @ v
        handedness = np.linalg.det(
            m
        )  # -1 for a mirror, under which angular momentum changes its sign
        h = craft.momenta.sum(axis=0)
        if np.abs(true @ m.T - stated).max() > ALIKE:
            continue
        if (
            np.abs(m @ craft.inertia @ m.T - craft.inertia).max()
            > 0.03 * np.trace(craft.inertia) / 3
        ):
            continue
        if np.linalg.norm(handedness * m @ h - momenta.sum(axis=0)) > ALIKE * max(
            np.linalg.norm(h), 1e-12
        ):
            continue
        result.append(m)
    return result

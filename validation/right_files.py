"""Run `check` and `rates` on right files of every form; each accusation is a false alarm."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.cli.check import check
from sunspin.cli.rates import rates
from sunspin.solve.rotations import components_after_rotation
from sunspin.vehicle.file import parse_vehicle
from validation.passes import unit

FACES = np.vstack([np.eye(3), -np.eye(3)])
NAMES = ("+X", "+Y", "+Z", "-X", "-Y", "-Z")
START_UNIX_S = 1_767_225_600
"""1 January 2026, in Unix seconds."""

PARTS = ("vector", "gyro", "field", "turn", "mean", "stations", "backward", "clocks")
"""Features, each of which half of the files have: sensors; panels read one after the other, or averaged; repeats by a second
station; newest rows first; an onboard clock that begins at zero.
"""

ACCUSED = (
    "CHECK THE COLUMNS",
    "look at its zero",
    "does not see what they see",
    "SEEM LATE",
    "NO SOLUTION FITS",
)
"""Words in the verdict of `rates` that accuse the file."""


def _accusations(verdict: str) -> list[str]:
    """Return the accusations in a verdict of `rates`."""
    return [words for words in ACCUSED if words in verdict]


def judge(folder: Path, seed: int, i: int, command: str) -> dict[str, Any]:
    """Return the accusations of one file by the command "check" or "rates": "form" has its features, "accused" the texts."""
    vehicle, telemetry, form = make(folder, seed, i)
    arguments = [str(vehicle), str(telemetry), "--json"]
    done = CliRunner().invoke(
        check if command == "check" else rates, arguments, catch_exceptions=False
    )
    report = json.loads(done.stdout)
    if command == "rates":
        return {"form": form, "accused": _accusations(report["verdict"])}
    about = report["telemetry"]
    # readings that sunlight cannot give are no accusation if the file says that it is synthetic
    kinds = (
        "wrong_units",
        "wrong_axes",
        "dead_panels",
        "weak_panels",
        "missing_sensors",
        *(() if about["made_by"] else ("impossible",)),
    )
    return {
        "form": form,
        "accused": [f"{kind}: {about[kind]}" for kind in kinds if about.get(kind)],
    }


class RightFile(NamedTuple):
    """Paths of a vehicle file and of its telemetry, and their features in words."""

    vehicle: Path
    telemetry: Path
    features: str


def make(folder: Path, seed: int, i: int) -> RightFile:
    """Write a right vehicle file and telemetry in JSON lines, and return both paths and the features."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
    features = {name: bool(rng.random() < 0.5) for name in PARTS}
    normals = (
        FACES
        if rng.random() < 0.6
        else np.vstack([FACES[:5], [unit(rng) for _ in range(rng.integers(1, 4))]])
    )
    names = [*NAMES, "p6", "p7", "p8"][: len(normals)]
    # of each panel, and common to all: s, zero without the feature
    offset = np.round(rng.uniform(0, 2, len(normals)), 1) * features["turn"]
    averaged = round(float(rng.uniform(0.5, 2.0)), 1) * features["mean"]
    moments = np.array([0.04, 0.045, 0.02]) * rng.uniform(0.9, 1.1, 3)
    text = _vehicle(features, names, normals, offset, averaged, moments)
    craft = parse_vehicle(text, "right")
    n, apart = int(rng.integers(15, 41)), rng.uniform(5, 15)
    t = np.round(np.cumsum(apart * rng.uniform(0.8, 1.2, n)), 2)
    motion = ss.propagate(
        craft, np.radians(10 ** rng.uniform(-0.5, 0.5)) * unit(rng), unit(rng), None, t
    )
    omega, sun = motion["omega_B"].values, motion["sun_B"].values
    # each panel is averaged over 21 instants about the one at which it is read
    shares = np.linspace(-0.5, 0.5, 21)
    light = [
        [
            ss.panel_power(
                craft, components_after_rotation(sun, (offset_s + averaged * share) * omega)
            )[:, k]
            for share in shares
        ]
        for k, offset_s in enumerate(offset)
    ]
    # noise of 2 % of the full signal, 7 W
    power = 7 * (np.mean(light, axis=1).T / 7 + 0.02 * rng.normal(size=(n, len(names))))
    rows = [
        {
            "rx": START_UNIX_S + 1000 + s + rng.uniform(0, 1),
            "station": "A",
            "time": s if features["clocks"] else START_UNIX_S + s,
        }
        | {f"i.{name}": round(float(p), 4) for name, p in zip(names, each, strict=True)}
        for s, each in zip(t.tolist(), power, strict=True)
    ]
    field = Rotation.from_quat(motion["B_from_N"].values).apply(unit(rng)) + 0.03 * rng.normal(
        size=(n, 3)
    )
    gyro = np.degrees(omega + 1e-3 * rng.normal(size=3) + 1e-3 * rng.normal(size=(n, 3)))
    vector = 400 * (sun + 0.02 * rng.normal(size=(n, 3)))
    for name, value in (("vector", vector), ("gyro", gyro), ("field", field)):
        for row, each in zip(rows, value, strict=True):
            row |= {name: [round(float(x), 5) for x in each]} if features[name] else {}
    if features["stations"]:
        rows += [
            row | {"station": "B", "rx": row["rx"] + 0.5}
            for row in rows[:: int(rng.integers(2, 5))]
        ]
    rows = rows[::-1] if features["backward"] else rows
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "vehicle.toml").write_text(text, "utf-8")
    (folder / "telemetry.jsonl").write_text(
        "".join(json.dumps(row) + "\n" for row in rows), "utf-8"
    )
    about = ", ".join(name for name, present in features.items() if present)
    return RightFile(folder / "vehicle.toml", folder / "telemetry.jsonl", about)


def _vehicle(
    features: dict[str, bool],
    names: list[str],
    normals: np.ndarray,
    offset: np.ndarray,
    averaged: float,
    moments: np.ndarray,
) -> str:
    """Return the text of the vehicle file."""
    lines = ['name = "right"', "[body]", f"inertia_kg_m2 = {np.diag(moments).tolist()}"]
    for name, normal in zip(names, normals, strict=True):
        lines += ["[[panel]]", f'name = "{name}"', f"normal_B = {normal.tolist()}", "gain_W = 7"]
    lines += [
        "[telemetry]",
        'time_column = "time"',
        'bad_rows = "flag"',
        "noise = 0.14",
        f"averaged_s = {averaged}",
    ]
    clocks = [
        'time_format = "elapsed"',
        'receive_time_column = "rx"',
        'receive_time_format = "unix"',
    ]
    lines += clocks if features["clocks"] else ['time_format = "unix"']
    lines += ["[telemetry.columns]", *(f'"{name}" = "i.{name}"' for name in names)]
    if features["turn"]:
        lines += [
            "[telemetry.offset_s]",
            *(f'"{name}" = {offset_s}' for name, offset_s in zip(names, offset, strict=True)),
        ]

    def columns(name: str) -> str:
        """Return the line that names the three columns of a sensor."""
        return f'columns = ["{name}.0", "{name}.1", "{name}.2"]'

    if features["vector"]:
        lines += ["[sun_vector]", columns("vector"), "sigma_rad = 0.02"]
    if features["gyro"]:
        lines += [
            "[gyro]",
            columns("gyro"),
            "scale_rad_s = 0.0174533",
            "noise_rad_s = 1e-3",
            "zero = { value = [0, 0, 0], sigma = 0.06 }",
        ]
    if features["field"]:
        lines += ["[magnetometer]", columns("field"), "noise = 0.03"]
    lines += ["[disturbance]", "max_rate_rad_s = 0.1"]
    return "\n".join(lines) + "\n"

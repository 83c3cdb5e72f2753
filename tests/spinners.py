"""Files of a satellite that spins in an orbit: vehicle file, telemetry and elements, with or without what a file may state.

Nothing of the package's environment or panel model makes them: Sun and field are those of `tle_twins`. All of it is synthetic.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from tle_twins import EPOCH, lines, sky

NORMALS = {
    "-X": (-1, 0, 0),
    "-Y": (0, -1, 0),
    "-Z": (0, 0, -1),
    "+X": (1, 0, 0),
    "+Y": (0, 1, 0),
    "+Z": (0, 0, 1),
}
KEYS = ("relative_gain", "gain_A", "gain_W")
AXIS = np.array([0.1, 0.05, 1.0]) / np.linalg.norm([0.1, 0.05, 1.0])


@dataclass(frozen=True)
class Spinner:
    """What is drawn: `faces` with panels, `samples` so many s apart, spin about nearly z, noise as a share of full Sun, the key and
    size of the gains, the noise stated (share of full Sun, None: none), whether readings may be negative, missing or zero, whether
    there is a magnetometer, whether the vehicle file has the elements, and whether the Sun is up."""

    faces: tuple[str, ...] = ("-X", "-Y", "-Z")
    samples: int = 60
    interval_s: float = 1.0
    rate_deg_s: float = 40.0
    noise: float = 0.0
    key: str = "relative_gain"
    gain: float = 1.0
    stated: float | None = None
    negative: bool = False
    spoilt: bool = False
    magnetometer: bool = True
    orbit: bool = False
    lit: bool = True

    @classmethod
    def drawn(cls, seed: int) -> Self:
        """One of all kinds."""
        rng = np.random.default_rng(seed)
        faces = tuple(rng.permutation(list(NORMALS))[: rng.integers(1, 7)].tolist())
        yes = rng.random(6) < [0.5, 0.3, 0.7, 0.5, 0.85, 0.5]
        return cls(
            faces,
            int(rng.choice([1, 3, 6, 12, 25])),
            float(rng.choice([1.0, 10.0])),
            float(rng.choice([3.0, 40.0])),
            float(rng.choice([0.0, 0.01])),
            str(rng.choice(KEYS)),
            float(rng.choice([1.0, 2.5e-3, 900.0])),
            0.015 if yes[5] else None,
            *map(bool, yes[:5]),
        )

    def write(self, folder: Path, seed: int = 0) -> tuple[str, str, str]:
        """Its vehicle file, telemetry and elements in a folder."""
        rng, n = np.random.default_rng(seed), self.samples
        elements, t = lines(rng), self.interval_s * np.arange(n)
        for begin in np.arange(0.0, 6000.0, 200.0):
            sun, field, up, _ = sky(elements, begin, t, 0.0)
            if (up == self.lit).all():
                break
        body = Rotation.from_rotvec(
            -t[:, None] * np.radians(self.rate_deg_s) * AXIS
        ) * Rotation.random(random_state=seed)
        full = np.maximum(
            body.apply(sun) @ np.array([NORMALS[face] for face in self.faces], dtype=float).T, 0
        )
        light = full * up[:, None] + self.noise * rng.normal(size=full.shape)
        light += 0.03 * np.abs(rng.normal(size=full.shape)) * up[:, None]  # stray light
        power = self.gain * (light if self.negative else np.maximum(light, 0))
        zero = (
            np.array([0.6, -2.0, 2.2]) * np.linalg.norm(field, axis=1).mean()
        )  # three times the field
        reading = body.apply(field) + zero + 200 * rng.normal(size=field.shape)
        if self.spoilt:
            power[rng.random(power.shape) < 0.1], reading[rng.random(n) < 0.15] = np.nan, 0.0
            reading[rng.random(n) < 0.1] = np.nan
        columns = {face: power[:, k] for k, face in enumerate(self.faces)}
        columns |= {f"m{axis}": reading[:, k] for k, axis in enumerate("xyz") if self.magnetometer}
        rows = [",".join(["time_utc", *columns])]
        for k in range(n):
            utc = (EPOCH + timedelta(seconds=float(begin + t[k]))).isoformat() + "Z"
            rows.append(
                ",".join(
                    [
                        utc,
                        *(
                            "" if np.isnan(column[k]) else f"{column[k]:.6g}"
                            for column in columns.values()
                        ),
                    ]
                )
            )
        contents = {
            "vehicle.toml": self._vehicle(elements),
            "telemetry.csv": "\n".join(rows),
            "my.tle": "\n".join(elements),
        }
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in contents.items():
            (folder / name).write_text(text + "\n", "utf-8")
        return str(folder / "vehicle.toml"), str(folder / "telemetry.csv"), str(folder / "my.tle")

    def _vehicle(self, elements: tuple[str, str]) -> str:
        gain = 1.0 if self.key == "relative_gain" else self.gain
        parts = [
            'name = "spinner"',
            "[body]",
            "inertia_kg_m2 = [[0.042, 0, 0], [0, 0.041, 0], [0, 0, 0.008]]",
        ]
        for face in self.faces:
            parts += [
                "[[panel]]",
                f'name = "{face}"',
                f"normal_B = {list(NORMALS[face])}",
                f"{self.key} = {gain}",
            ]
        quantity = "current_A" if self.key == "gain_A" else "power_W"
        parts += [
            "[telemetry]",
            f'quantity = "{quantity}"',
            'time_column = "time_utc"',
            'bad_rows = "flag"',
        ]
        parts += [] if self.stated is None else [f"noise = {self.stated * self.gain:.6g}"]
        parts += ["[telemetry.columns]", *(f'"{face}" = "{face}"' for face in self.faces)]
        parts += (
            ["[magnetometer]", 'columns = ["mx", "my", "mz"]', "scale_T = 1e-9"]
            if self.magnetometer
            else []
        )
        parts += ["[disturbance]", f"max_rate_rad_s = {1.5 * np.radians(self.rate_deg_s):.4f}"]
        return "\n".join(
            parts + (["[orbit]", f"tle = {list(elements)}".replace("'", '"')] if self.orbit else [])
        )


UNSTATED = Spinner()
"""Coarse Sun sensors on three faces, no noise stated, no reading below zero, no sample with more than three panels lit."""
